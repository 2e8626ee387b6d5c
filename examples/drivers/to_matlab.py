"""Write a trace for MATLAB and Octave: python to_matlab.py trace.nc trace.mat.

`load trace.mat` gives a column vector for each variable, `plot(time, gain)` shows the gain.
Format: version 5 by https://docs.scipy.org/doc/scipy/reference/generated/scipy.io.savemat.html
"""

import sys

import xarray as xr
from scipy.io import savemat

source, target = sys.argv[1:]
with xr.open_dataset(source, engine="h5netcdf") as trace:
    columns = {name: one.values for name, one in trace.variables.items() if one.dims == ("time",)}
savemat(target, columns, oned_as="column")
