"""Write a trace as comma-separated values: python to_csv.py trace.nc trace.csv.

A heading of names, then one row for each time [s]; all digits are kept.
"""

import sys

import xarray as xr

source, target = sys.argv[1:]
with xr.open_dataset(source, engine="h5netcdf") as trace:
    columns = trace[[name for name, one in trace.data_vars.items() if one.dims == ("time",)]]
    columns.to_dataframe().to_csv(target)
