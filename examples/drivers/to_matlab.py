"""Write a trace for MATLAB and Octave: python to_matlab.py trace.nc trace.mat.

`load trace.mat` gives a column vector for each variable, `plot(time, gain)` shows the gain.
Format: version 5 by https://docs.scipy.org/doc/scipy/reference/generated/scipy.io.savemat.html
"""

import argparse

import xarray as xr
from scipy.io import savemat

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("source", help="trace, a file of `meshtrace traces`")
parser.add_argument("target", help="file to write")
arguments = parser.parse_args()
with xr.open_dataset(arguments.source, engine="h5netcdf") as trace:
    columns = {name: one.values for name, one in trace.variables.items() if one.dims == ("time",)}
savemat(arguments.target, columns, oned_as="column")
