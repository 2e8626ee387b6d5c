"""Packet error rate of a coded modem over a trace: python modem.py trace.nc.

OOK at hard decisions, a convolutional code of rate 1/2 (5, 7) of commpy (pip install
scikit-commpy), and an interleaver that sends the bits of a packet in random order over its depth.
Beside it the outage of an ideal code of that rate, without interleaver and for independent fades.
"""

import argparse
import warnings

import numpy as np
import xarray as xr

from meshtrace.comms import OokLink
from meshtrace.comms.budget import ber_of_gains
from meshtrace.comms.interleaving import interleaved_outage

with warnings.catch_warnings(action="ignore"):
    from commpy.channelcoding import Trellis, conv_encode, viterbi_decode

BITS, PACKETS, DEPTHS = 128, 100, {0.0: 1, 1.0: 17}  # depth [s]: independent fades

link, rng = OokLink(), np.random.default_rng(1)
code = Trellis(np.array([2]), np.array([[5, 7]]))
parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("trace", help="trace, a file of `meshtrace traces`")
arguments = parser.parse_args()
with xr.open_dataset(arguments.trace, engine="h5netcdf") as trace:
    time, gain = trace["time"].values, trace["gain"].values
needed = link.required_power(0.11) / float(link.received_power(1.0))  # capacity 1/2 at BER 0.11


def lost(gains, depth):
    """Return whether a packet is lost that begins at a random time."""
    bits = rng.integers(0, 2, BITS)
    sent = conv_encode(bits, code)
    at = rng.uniform(time[0], time[-1] - depth) + depth * rng.permutation(sent.size) / sent.size
    flipped = rng.random(sent.size) < ber_of_gains(link, np.interp(at, time, gains))
    return (viterbi_decode((sent ^ flipped).astype(float), code)[:BITS] != bits).any()


print("margin [dB], then packet error rate and outage of an ideal code without and with 1 s")
for margin in (0.0, 2.0, 4.0, 6.0, 8.0):
    gains = needed * 10.0 ** (0.1 * margin) * gain / gain.mean()
    found = [(np.mean([lost(gains, depth) for _ in range(PACKETS)]), fades)
             for depth, fades in DEPTHS.items()]  # fmt: skip
    texts = [f"{p:.2f} {interleaved_outage(link, gains, 0.5, m):.1e}" for p, m in found]
    print(f"{margin:4.1f}  " + "  ".join(texts))
