"""Write a trace for GNU Radio: python to_gnuradio.py trace.nc gain.f32.

A File Source of type float reads the gain over its mean, 32 bits a value without any heading
(https://wiki.gnuradio.org/index.php/File_Sink). Repeat it by sample rate / rate of the trace, and
Multiply the intensity of the transmitter with it.
"""

import argparse

import xarray as xr

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("source", help="trace, a file of `meshtrace traces`")
parser.add_argument("target", help="file to write")
arguments = parser.parse_args()
with xr.open_dataset(arguments.source, engine="h5netcdf") as trace:
    gain, time = trace["gain"].values, trace["time"].values
(gain / gain.mean()).astype("<f4").tofile(arguments.target)
print(
    f"{gain.size} values at {(gain.size - 1) / (time[-1] - time[0]):g} Hz, mean {gain.mean():.6g}"
)
