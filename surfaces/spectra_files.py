"""Directional spectra from files.

Whatever a file holds becomes a density [m2 Hz-1 deg-1] over frequency [Hz] and the nautical
direction [deg] that the waves come from, or is refused.
"""

from __future__ import annotations

import gzip
import json
import re
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from glob import glob
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshtrace.cells import cells_of
from meshtrace.errors import Described, Refused, did_you_mean, extra, refusing, warn_of_input
from meshtrace.netcdf import check_file, check_zarr, convention_of, opened, require_size
from meshtrace.tables import Column, has_other_unit, heading_of, headings_in
from meshtrace.units import convert, is_same, unit_of

from .records import one_record
from .spectral_grid import FOURIER, GriddedSpectrum, coming_from, on_grid

if TYPE_CHECKING:
    import xarray

_MOST_BINS = 2**20  # of one record: a sea of more waves does not fit into memory
_MOST_TEXT = 2**28  # [B] of an uncompressed file of text


_UNITS: dict[str, dict[str, str]] = {
    "ww3": {"efth": "m2 s rad-1", "frequency": "Hz", "direction": "deg"},
    "ncswan": {"density": "m2 s rad-1", "frequency": "Hz", "direction": "rad"},
    "wwm": {},  # its units are remarks
    "era5": {"d2fd": "m2 s rad-1"},
}
"""Units that a reader of wavespectra assumes in the netCDF files of a wave model."""

_NDBC = {
    "spectral_wave_density": "efth", "waveEnergyDensity": "efth", "frequency": "freq",
    "waveFrequency": "freq", "waveTime": "time", "mean_wave_dir": "alpha1",
    "principal_wave_dir": "alpha2", "wave_spectrum_r1": "r1", "wave_spectrum_r2": "r2",
    "gpsLatitude": "lat", "gpsLongitude": "lon", "latitude": "lat", "longitude": "lon",
}  # fmt: skip
_OWN = ("netcdf", "wavespectra")  # wavespectra replaces the units of such files by its own


def read_spectrum(
    source: Any, reader: str | None, time: Any, site: Any
) -> tuple[GriddedSpectrum, str | None]:
    """Return one directional spectrum of a file or a dataset, and the label of its record.

    See `from_wavespectra`.
    """
    with _opened(source, reader) as dataset:
        missing = [name for name in ("efth", "freq") if name not in dataset.variables]
        if missing:
            problem = Described(f"without {missing}")
            allowed = 'efth over freq [Hz] and dir [deg], or a reader ("ww3")'
            raise Refused("source", problem, allowed)
        record, label = one_record(dataset, ("efth", "freq", "dir", *FOURIER), time, site)
        sizes = record["efth"].sizes
        if any(size > 1 for name, size in sizes.items() if name not in ("freq", "dir")):
            allowed = "dimensions (freq, dir); select one time and site first"
            raise Refused("efth", tuple(sizes), allowed)
        require_size(8 * record["efth"].size, 8 * record["efth"].size, "efth", 8 * _MOST_BINS)
        return on_grid(record.load()), label


@contextmanager
def _opened(source: Any, reader: str | None) -> Iterator[xarray.Dataset]:
    """Yield the lazy dataset of a source, with variables named as wavespectra does."""
    package = None if reader is None else _package(reader)
    if reader is None and str(source).lower().endswith((".csv", ".txt")):
        yield text_table(source)
    elif reader is None or reader in (*_UNITS, *_OWN, "ndbc"):
        with ExitStack() as files, refusing("source", "a directional spectrum"):
            dataset = _raw(source, files)
            if reader in _UNITS:
                dataset = _formatted(dataset, str(reader))
            elif reader == "ndbc":
                dataset = dataset.rename({k: v for k, v in _NDBC.items() if k in dataset})
            yield dataset
    else:
        with (
            refusing(str(source), f"a file that read_{reader} reads"),
            warnings.catch_warnings(action="ignore"),  # of what its packages deprecate
        ):
            _check_text(source)
            if reader == "ndbc_ascii":
                dataset = _ndbc_ascii(source)
            else:
                dataset = _by_wavespectra(source, str(reader), package)
        with refusing("source", "a directional spectrum"):
            yield dataset


def _raw(source: Any, files: ExitStack) -> xarray.Dataset:
    """Return the lazy dataset of netCDF files, or the dataset itself; missing values become nan."""
    import xarray as xr

    if isinstance(source, str | PathLike):
        paths = [str(source)]
        if not Path(source).exists():
            paths = sorted(glob(str(source))) or paths
        parts = [files.enter_context(opened(p, None, decode_times=False)) for p in paths]
        if len(parts) == 1:
            return parts[0]
        source = xr.combine_by_coords(parts, combine_attrs="override")
    if not isinstance(source, xr.Dataset):
        raise Refused("source", source, "a path or an xarray.Dataset")
    check_zarr(source)
    packed = ("_FillValue", "missing_value", "scale_factor", "add_offset")
    if any(key in v.attrs for v in source.variables.values() for key in packed):
        return xr.decode_cf(source, decode_times=False, decode_timedelta=False)
    return source


def _package(reader: str) -> Any:
    """Import wavespectra; refuse an unknown reader."""
    with extra("measured", "reader", reader, "formats of wavespectra: {}"):
        import wavespectra
    names = sorted(n.removeprefix("read_") for n in dir(wavespectra) if n.startswith("read_"))
    if reader not in names:
        raise Refused("reader", reader, ", ".join(names), did_you_mean(reader, names))
    return wavespectra


def _formatted(dataset: xarray.Dataset, reader: str) -> xarray.Dataset:
    """Return the dataset of a wave model in the conventions of wavespectra.

    Its readers take the units of a format for granted: files of other units are converted first.
    """
    lazy = dataset.chunk()  # else all times would be read and computed
    convention = assumed = "to" if reader == "ww3" else "from"
    if "direction" in _UNITS[reader] and "direction" in dataset.variables:
        convention = convention_of(dataset["direction"], dataset.attrs) or assumed
    for name, unit in _UNITS[reader].items():
        stated = unit_of(lazy[name]) if name in lazy.variables else ""
        factor = float(convert(1.0, stated, unit, name)) if stated else 1.0
        if factor != 1.0:
            # logarithms do not scale by a factor
            if reader == "era5":
                raise Refused(name, Described(f"logarithms of {stated}"), f"logarithms of {unit}")
            warn_of_input(f"{name}: {stated} converted to {unit}")
            lazy = lazy.assign({name: lazy[name] * factor})
    if reader == "era5":
        # wavespectra reads missing values as no waves: records on land would be calm
        absent = lazy["d2fd"].isnull()
        absent = absent.all([d for d in absent.dims if "freq" in str(d) or "dir" in str(d)])
    converted = getattr(import_module(f"wavespectra.input.{reader}"), f"from_{reader}")(lazy)
    if reader == "era5":
        names = {"valid_time": "time", "longitude": "lon", "latitude": "lat"}
        absent = absent.rename(
            {k: v for k, v in names.items() if k in absent.coords or k in absent.dims}
        )
        converted["efth"] = converted["efth"].where(~absent.drop_vars(list(absent.coords)))
    converted = _without_attributes(converted)
    if convention != assumed and "dir" in converted.variables:
        # undo the turn of the reader, which took the convention of its format for granted
        bearing = converted["dir"].values - (180.0 if assumed == "to" else 0.0)
        converted["dir"] = ("dir", coming_from(bearing, convention))
    return converted


def _without_attributes(dataset: xarray.Dataset) -> xarray.Dataset:
    """Return a copy of a converted dataset without the attributes of the file, now wrong."""
    dataset = dataset.copy()
    dataset.attrs = {}
    for name in ("efth", "freq", "dir"):
        if name in dataset.variables:
            dataset[name].attrs = {}
    return dataset


def _check_text(source: Any) -> None:
    """Refuse files whose (uncompressed) content is too large."""
    sources = list(source) if isinstance(source, list | tuple) else [source]
    for path in sources:
        if not isinstance(path, str | PathLike):
            raise Refused("source", path, "a path")
    paths = [
        path for item in sources for path in ([item], glob(str(item)))[not Path(item).exists()]
    ]
    for path in paths:
        size, most = Path(path).stat().st_size, 4 * _MOST_TEXT
        with open(path, "rb") as file:
            is_gzip = file.read(2) == b"\x1f\x8b"
        if is_gzip:
            size, most = 0, _MOST_TEXT
            # counted as it unpacks, no further than the limit: a small file may hold any amount
            with gzip.open(path) as file:
                while size <= _MOST_TEXT and (block := file.read(2**20)):
                    size += len(block)
        require_size(size, size, str(path), most)
        check_file(path)


def _by_wavespectra(source: Any, reader: str, package: Any) -> xarray.Dataset:
    """Return the dataset of a text format of wavespectra."""
    dataset = getattr(package, f"read_{reader}")(source)
    if reader == "ww3_station" and dataset.sizes.get("site", 1) > 1:
        # it fills a grid of sorted latitudes and longitudes in the order of the file
        problem = Described(f"{dataset.sizes['site']} stations")
        raise Refused("source", problem, "a file of one station: wavespectra confuses several")
    dataset = _without_attributes(dataset)
    if reader == "json":
        with open(source) as file:
            content = json.load(file)
        for part in (content["coords"], content["data_vars"]):
            for name in ("efth", "freq", "dir"):
                if name in part:
                    dataset[name].attrs = dict(part[name].get("attrs", {}))
    return dataset


def _ndbc_ascii(source: Any) -> xarray.Dataset:
    """Return the spectrum and the two Fourier coefficients of text files of NDBC."""
    import xarray as xr
    from wavespectra.input.ndbc_ascii import read_file

    paths = list(source) if isinstance(source, list | tuple) else [source]
    names = ["efth", *FOURIER]
    if len(paths) not in (1, len(names)):
        problem = Described(f"{len(paths)} files")
        allowed = "the file of densities, or that with swdir, swdir2, swr1, swr2"
        raise Refused("source", problem, allowed)
    arrays = {}
    for name, path in zip(names, paths, strict=False):
        frame = read_file(str(path)).drop(columns="Sep_Freq", errors="ignore")
        values = frame.to_numpy(np.float64)
        # NDBC writes missing values so
        values[values == 999.0] = np.nan
        freq = np.array([float(column) for column in frame.columns]).round(6)
        arrays[name] = xr.DataArray(
            values, {"time": frame.index.to_numpy("datetime64[us]"), "freq": freq}, ("time", "freq")
        )
    if len(paths) > 1 and float(max(arrays["r1"].max(), arrays["r2"].max())) > 1.5:
        # files of past years have hundredths; r is at most 1
        arrays["r1"], arrays["r2"] = 0.01 * arrays["r1"], 0.01 * arrays["r2"]
    return xr.Dataset(arrays)


_FREQUENCY = Column("f", "Hz", ("freq", "frequency"))
_DIRECTION = re.compile(
    r"(?:dir(?:ection)?)?[\s_]*(-?\d+(?:\.\d*)?)[\s_]*\[?(?:deg(?:ree)?s?T?|°)?\]?"
)


def text_table(path: str | PathLike[str]) -> xarray.Dataset:
    """Return the dataset of a text file with directions in its header."""
    import xarray as xr

    cells = cells_of(path, "source")
    if not cells.heads and cells.columns[0][0] == "":  # an index without name
        cells = cells_of(path, "source", heads=1)
    allowed = "a header with a direction [deg] for each column but one, f [Hz]"
    lines = [headings_in(line, cells) for line in cells.heads or cells.remarks]
    header, directions, first = list[str](), list[float](), 0
    for words in lines if len(cells.heads) < 2 else ():
        matches = [_DIRECTION.fullmatch(word) for word in words]
        start = 1 if len(words) < 2 or matches[1] else 2  # an index before the frequencies
        if len(words) == len(cells.columns) and all(matches[start:]):
            header, first = words, start
            directions = [float(match[1]) for match in matches[start:] if match]
    index_before = first == 2 and header[0] in ("", "index") and cells.counts(0)
    if not directions or (first == 2 and not index_before) or (first == 1 and cells.counts(0)):
        reason = Described(" ".join(lines[0]) if lines else "no header")
        raise Refused(str(path), reason, allowed)
    heading = heading_of(header[first - 1], (_FREQUENCY,))
    if heading.unit is not None and not is_same(heading.unit, "Hz"):
        raise Refused(str(path), Described(header[first - 1]), allowed)
    if heading.unit is None and heading.name and not heading.name.startswith("f"):
        raise Refused(str(path), Described(header[first - 1]), allowed)
    for remark in cells.remarks:
        columns = _FREQUENCY, Column("dir", "deg"), Column("efth", "m2 Hz-1 deg-1")
        if has_other_unit(remark, columns):
            raise Refused(str(path), Described(f"# {remark}"), "density [m2 Hz-1 deg-1], f [Hz]")
    freq, *densities = (cells.finite(i) for i in range(first - 1, len(cells.columns)))
    coords = {"freq": freq, "dir": directions}
    return xr.Dataset({"efth": (("freq", "dir"), np.column_stack(densities))}, coords)
