"""Write a trace as comma-separated values: python to_csv.py trace.nc trace.csv.

A heading of names, then one row for each time [s]; all digits are kept.
"""

import argparse

import xarray as xr

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("source", help="trace, a file of `meshtrace traces`")
parser.add_argument("target", help="file to write")
arguments = parser.parse_args()
with xr.open_dataset(arguments.source, engine="h5netcdf") as trace:
    columns = trace[[name for name, one in trace.data_vars.items() if one.dims == ("time",)]]
    columns.to_dataframe().to_csv(arguments.target)
