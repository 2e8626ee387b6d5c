"""Use a trace as channel of Sionna: python to_sionna.py trace.nc.

CIRDataset takes a generator of coefficients a [num_rx, num_rx_ant, num_tx, num_tx_ant, num_paths,
num_time_steps] and delays tau [num_rx, num_tx, num_paths]
(https://nvlabs.github.io/sionna/phy/api/channel/wireless/cir_dataset.html). The signal is the
emitted power, so that a is the gain itself, real and not its root.
"""

import argparse

import torch
import xarray as xr
from sionna.phy.channel import CIRDataset

STEPS, BATCH = 50, 4

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("trace", help="trace, a file of `meshtrace traces`")
arguments = parser.parse_args()
with xr.open_dataset(arguments.trace, engine="h5netcdf") as trace:
    gain, time = torch.from_numpy(trace["gain"].values), trace["time"].values


def windows():
    """Yield windows of the trace, from its start again at its end."""
    while True:
        for a in gain.to(torch.complex64).unfold(0, STEPS, STEPS):
            yield a.reshape(1, 1, 1, 1, 1, STEPS), torch.zeros(1, 1, 1)


one = {name: 1 for name in ("num_rx", "num_rx_ant", "num_tx", "num_tx_ant", "num_paths")}
channel = CIRDataset(windows, batch_size=BATCH, num_time_steps=STEPS, **one)
a, tau = channel(BATCH, STEPS, 1.0 / (time[1] - time[0]))
print(f"a {tuple(a.shape)}, tau {tuple(tau.shape)}, mean gain {a.real.mean():.4e}")
