"""Write lost packets of a trace for ns-3: python to_ns3.py trace.nc lost.txt per.csv.

lost.txt has the numbers of the lost packets, from 0, for `ReceiveListErrorModel::SetList`, which
counts the packets that a device receives (https://www.nsnam.org/docs/models/html/error-model.html):

    std::ifstream file("lost.txt");
    std::list<uint32_t> lost{std::istream_iterator<uint32_t>(file), {}};
    auto model = CreateObject<ReceiveListErrorModel>();
    model->SetList(lost);
    device->SetAttribute("ReceiveErrorModel", PointerValue(model));

per.csv has the packet error rate over time, for a model of your own.
"""

import argparse

import numpy as np
import xarray as xr

from meshtrace.comms import OokLink
from meshtrace.comms.budget import ber_of_gains

BITS, PACKETS_PER_S = 8192, 100.0

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("source", help="trace, a file of `meshtrace traces`")
parser.add_argument("lost", help="file of the lost packets")
parser.add_argument("table", help="file of the packet error rates")
arguments = parser.parse_args()
with xr.open_dataset(arguments.source, engine="h5netcdf") as trace:
    time, gain = trace["time"].values, trace["gain"].values
per = -np.expm1(BITS * np.log1p(-ber_of_gains(OokLink(), gain)))
sent = np.arange(time[0], time[-1], 1.0 / PACKETS_PER_S)
error = np.random.default_rng(1).random(sent.size) < np.interp(sent, time, per)
np.savetxt(arguments.lost, np.flatnonzero(error), "%d")
np.savetxt(
    arguments.table, np.column_stack([time, per]), delimiter=",", header="time,per", comments=""
)
print(f"{error.sum()} of {sent.size} packets lost, mean packet error rate {per.mean():.4g}")
