"""Write a Gilbert-Elliott link of a trace for DESERT Underwater: python to_desert.py trace.nc.

The physical layer uwhmmphysical has links `Module/UW/HMMPHYSICAL/MCLINK` with bit error rates and
transition probabilities of a good and a bad state (arguments of mclink.cpp in
https://github.com/signetlabdei/DESERT_Underwater, DESERT_Framework/DESERT/physical/uwhmmphysical):

    set link [new Module/UW/HMMPHYSICAL/MCLINK ber_good ber_bad p_gb p_bg step_period GOOD]
    $phy(1) setMCLink [$mac(0) addr] $link
"""

import argparse

import numpy as np
import xarray as xr

from meshtrace.apps import MarkovChannel
from meshtrace.comms import OokLink
from meshtrace.comms.budget import ber_of_gains

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("trace", help="trace, a file of `meshtrace traces`")
arguments = parser.parse_args()
with xr.open_dataset(arguments.trace, engine="h5netcdf") as trace:
    time, gain = trace["time"].values, trace["gain"].values
model = MarkovChannel.fit(gain, time[1] - time[0], (0.7,))
states = model.states(gain)
bad, good = np.bincount(states, ber_of_gains(OokLink(), gain)) / np.bincount(states)
p_bg, p_gb = model.transition[0, 1], model.transition[1, 0]
link = f"{good:.6g} {bad:.6g} {p_gb:.6g} {p_bg:.6g} {model.time_step:.6g}"
print(f"set link [new Module/UW/HMMPHYSICAL/MCLINK {link} GOOD]")
