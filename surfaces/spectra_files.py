"""Directional spectra in files: formats, selection of one record, units and conventions.

Whatever a file holds becomes a density [m2 Hz-1 deg-1] over frequency [Hz] and the nautical
direction [deg] that the waves come from, or is refused.
"""

from __future__ import annotations

import gzip
import json
import math
import re
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, date, datetime
from glob import glob
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import (
    LARGEST,
    Described,
    Refused,
    did_you_mean,
    extra,
    refusing,
    require_pair,
    require_whole,
    warn_of_input,
)
from meshtrace.netcdf import (
    check_file,
    convention_of,
    opened,
    require_size,
    unit_of,
    valid_values,
)
from meshtrace.tables import read_columns
from meshtrace.units import convert

from .parameters import Floats

if TYPE_CHECKING:
    import xarray

_DENSITY = "m2 Hz-1 deg-1"
_MOST_BINS = 2**20  # of one record: a sea of more waves does not fit into memory
_MOST_TEXT = 2**28  # [B] of an uncompressed file of text
_STANDARD = ("", "none", "standard", "gregorian", "proleptic_gregorian")  # calendars
_FARTHEST = 1.0  # [deg] from a place to its grid point
_ROUNDED = 1e-6  # of the highest density: packed files round zeros to either sign
_SHARPEST, _NEAREST = 0.99, 0.95  # of maximum entropy: |c1|, and its limit of c2
_POINTS = 400  # within a bin of 10 degrees
_DIRECTIONS = 36  # of buoys that measure two Fourier coefficients
_STATIONS = ("site", "station")
_PLACES = (*_STATIONS, "lon", "lat", "longitude", "latitude")
_FOURIER = ("alpha1", "alpha2", "r1", "r2")


class Spectrum2D(NamedTuple):
    """Density [m2 Hz-1 deg-1] over frequency [Hz] and the direction [deg] waves come from."""

    frequency: Floats
    direction: Floats
    density: Floats
    record: str | None


class _Format(NamedTuple):
    """What the reader of wavespectra takes for granted in the netCDF files of a model."""

    units: dict[str, str]
    direction: str = ""
    convention: str = "from"


_FORMATS = {
    "ww3": _Format(
        {"efth": "m2 s rad-1", "frequency": "Hz", "direction": "deg"}, "direction", "to"
    ),
    "ncswan": _Format(
        {"density": "m2 s rad-1", "frequency": "Hz", "direction": "rad"}, "direction"
    ),
    "wwm": _Format({}),  # its units are remarks
    "era5": _Format({"d2fd": "m2 s rad-1"}),
}
_NDBC = {
    "spectral_wave_density": "efth", "waveEnergyDensity": "efth", "frequency": "freq",
    "waveFrequency": "freq", "waveTime": "time", "mean_wave_dir": "alpha1",
    "principal_wave_dir": "alpha2", "wave_spectrum_r1": "r1", "wave_spectrum_r2": "r2",
    "gpsLatitude": "lat", "gpsLongitude": "lon", "latitude": "lat", "longitude": "lon",
}  # fmt: skip
_OWN = ("netcdf", "wavespectra")  # wavespectra replaces the units of such files by its own
_ANGLE = re.compile(r"(rad|deg|°)\w*\s*[\^*{(]*\s*-?(\d?)", re.IGNORECASE)


def read_spectrum(source: Any, reader: str | None, time: Any, site: Any) -> Spectrum2D:
    """Return one directional spectrum of a file or a dataset; see `from_wavespectra`."""
    with _opened(source, reader) as dataset:
        missing = [name for name in ("efth", "freq") if name not in dataset.variables]
        if missing:
            found = Described(f"without {missing}")
            raise Refused("source", found, 'efth over freq [Hz] and dir [deg], or a reader ("ww3")')
        record, labels = _one_record(dataset, time, site)
        require_size(8 * record["efth"].size, 8 * record["efth"].size, "efth", 8 * _MOST_BINS)
        return Spectrum2D(*_canonical(record.load()), labels)


@contextmanager
def _opened(source: Any, reader: str | None) -> Iterator[xarray.Dataset]:
    """Yield the lazy dataset of a source, with variables named as wavespectra does."""
    package = None if reader is None else _package(reader)
    if reader is None and str(source).lower().endswith((".csv", ".txt")):
        yield text_table(source)
    elif reader is None or reader in (*_FORMATS, *_OWN, "ndbc"):
        with ExitStack() as files, refusing("source", "a directional spectrum"):
            dataset = _raw(source, files)
            if reader in _FORMATS:
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
    """Return the lazy dataset of netCDF files, or a given one; missing values become nan."""
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
    packed = ("_FillValue", "missing_value", "scale_factor", "add_offset")
    if any(key in v.attrs for v in source.variables.values() for key in packed):
        return xr.decode_cf(source, decode_times=False, decode_timedelta=False)
    return source


def _package(reader: str) -> Any:
    """Return wavespectra, if it has a reader."""
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
    form = _FORMATS[reader]
    convention = form.convention
    if form.direction in dataset.variables:
        convention = convention_of(dataset[form.direction], dataset.attrs) or convention
    for name, unit in form.units.items():
        own = unit_of(dataset[name]) if name in dataset.variables else ""
        factor = float(convert(1.0, own, unit, name)) if own else 1.0
        if factor != 1.0:
            if reader == "era5":
                raise Refused(name, Described(f"logarithms of {own}"), f"logarithms of {unit}")
            warn_of_input(f"{name}: {own} converted to {unit}")
            dataset = dataset.assign({name: dataset[name] * factor})
    lazy = dataset.chunk()  # else wavespectra computes with all times at once
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
    if convention != form.convention and "dir" in converted.variables:
        bearing = converted["dir"].values - (180.0 if form.convention == "to" else 0.0)
        converted["dir"] = ("dir", _coming_from(bearing, convention))
    return converted


def _without_attributes(dataset: xarray.Dataset) -> xarray.Dataset:
    """Return a dataset that a reader of wavespectra converted, whose old attributes are wrong."""
    dataset = dataset.copy()
    dataset.attrs = {}
    for name in ("efth", "freq", "dir"):
        if name in dataset.variables:
            dataset[name].attrs = {}
    return dataset


def _check_text(source: Any) -> None:
    """Refuse files whose content is too large, compressed ones by their content."""
    for path in source if isinstance(source, list | tuple) else [source]:
        if not isinstance(path, str | PathLike):
            raise Refused("source", path, "a path")
        if not Path(path).is_file():
            continue  # a pattern, or missing: the readers say so
        size = Path(path).stat().st_size
        with open(path, "rb") as file:
            is_gzip = file.read(2) == b"\x1f\x8b"
        if is_gzip:
            size = 0
            with gzip.open(path) as file:
                while size <= _MOST_TEXT and (block := file.read(2**20)):
                    size += len(block)
        require_size(size, size, str(path), _MOST_TEXT)
        check_file(path)


def _by_wavespectra(source: Any, reader: str, package: Any) -> xarray.Dataset:
    """Return the dataset of a text format of wavespectra."""
    dataset = getattr(package, f"read_{reader}")(source)
    if reader == "ww3_station" and dataset.sizes.get("site", 1) > 1:
        # it fills a grid of sorted latitudes and longitudes in the order of the file
        found = Described(f"{dataset.sizes['site']} stations")
        raise Refused("source", found, "a file of one station: wavespectra confuses several")
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
    names = ["efth", *_FOURIER]
    if len(paths) not in (1, len(names)):
        found = Described(f"{len(paths)} files")
        raise Refused(
            "source", found, "the file of densities, or that with swdir, swdir2, swr1, swr2"
        )
    arrays = {}
    for name, path in zip(names, paths, strict=False):
        frame = read_file(str(path)).drop(columns="Sep_Freq", errors="ignore")
        values = frame.to_numpy(np.float64)
        values[values >= 99.0 if name == "efth" else values == 999.0] = np.nan
        freq = np.array([float(column) for column in frame.columns]).round(6)
        arrays[name] = xr.DataArray(
            values, {"time": frame.index.to_numpy("datetime64[us]"), "freq": freq}, ("time", "freq")
        )
    if len(paths) > 1 and float(max(arrays["r1"].max(), arrays["r2"].max())) > 1.5:
        # files of past years have hundredths; r is at most 1
        arrays["r1"], arrays["r2"] = 0.01 * arrays["r1"], 0.01 * arrays["r2"]
    return xr.Dataset(arrays)


def text_table(path: str | PathLike[str]) -> xarray.Dataset:
    """Return the dataset of a text file with directions in its header."""
    import xarray as xr

    header, values = read_columns(path)
    try:
        directions = [float(word) for word in header[1:]]
    except ValueError:
        directions = []
    if len(directions) != values.shape[1] - 1:
        found = Described(" ".join(header) or "no header")
        raise Refused(str(path), found, "a header with a direction [deg] for each column but one")
    coords = {"freq": values[:, 0], "dir": directions}
    return xr.Dataset({"efth": (("freq", "dir"), values[:, 1:])}, coords)


def _one_record(dataset: xarray.Dataset, time: Any, site: Any) -> tuple[xarray.Dataset, str | None]:
    """Return the lazy spectrum of a time and a place, and its label."""
    names = ("efth", "freq", "dir", "time", *_FOURIER, *_PLACES)
    data = dataset[[name for name in names if name in dataset.variables]].assign_attrs(
        dataset.attrs
    )
    if time is not None:
        data = _at_time(data, time)
    if site is not None:
        data = _at_site(data, site)
    labels = []
    for name in ("time", "site", "station", "lon", "lat") if (time, site) != (None, None) else ():
        if name in data.variables and data[name].size == 1:
            value = np.ravel(data[name].values)[0]
            if name == "time" and time is not None:
                value = _shown(_times(data[name]).ravel()[0])
            labels.append(f"{name} {value}")
    return data, ", ".join(labels) or None


def _at_time(data: xarray.Dataset, time: Any) -> xarray.Dataset:
    """Return the record nearest to a time, within half a step of the record."""
    if "time" not in data.variables:
        raise Refused("time", time, "a record with times")
    times = np.ravel(_times(data["time"]))
    dated = times[~np.isnat(times)]
    if not dated.size:
        raise Refused("time", Described("no dates in the record"), "a record with times")
    dates = f"{_shown(dated.min())} to {_shown(dated.max())}"
    distance = np.abs(times - _date(time, f"a date from {dates}"))
    distance[np.isnat(distance)] = np.timedelta64(2**62, "us")
    # the usual step: a gap in the record is no reason to take what is far away
    steps = np.diff(np.unique(dated))
    step = np.median(steps.astype(np.int64)) if steps.size else 0.0
    if float(distance.min().astype(np.int64)) > 0.5 * step:
        raise Refused("time", time, f"within half a step of {dates}")
    i = int(distance.argmin())
    if (times == times[i]).sum() > 1:
        raise Refused(
            "time", Described(f"{_shown(times[i])} twice in the record"), "one spectrum at a time"
        )
    dims = data["time"].dims
    return data.isel({dims[0]: i}) if dims else data


def _shown(time: np.datetime64) -> str:
    """Return a date as text, without empty seconds."""
    return str(np.datetime_as_string(time, "s")).removesuffix(":00")


def _times(time: xarray.DataArray) -> NDArray[np.datetime64]:
    """Return times as dates, or refuse other calendars than the standard one."""
    import xarray as xr

    values = np.asarray(time.values)
    if values.dtype.kind == "O" and values.size:  # cftime
        calendar = str(getattr(values.flat[0], "calendar", "none")).lower()
    else:
        calendar = str(time.attrs.get("calendar", "")).lower()
    if values.ndim > 1 or (values.dtype.kind != "M" and calendar not in _STANDARD):
        found = Described(f"calendar {calendar}" if values.ndim < 2 else f"shape {values.shape}")
        allowed = "dates of the standard calendar; or select a record by isel and give no time"
        raise Refused("time", found, allowed)
    if values.dtype.kind == "O":
        values = np.array([np.datetime64(str(t.isoformat())) for t in values.flat]).reshape(
            values.shape
        )
    elif values.dtype.kind != "M":
        if "since" not in unit_of(time):
            raise Refused("time", Described("no units"), 'units such as "hours since 2024-01-01"')
        with refusing("time", "dates of the standard calendar"):
            encoded = xr.Dataset({"dates": (time.dims and ("record",), values, time.attrs)})
            values = xr.decode_cf(encoded)["dates"].to_numpy()
    return np.asarray(values, "datetime64[us]")


def _date(time: Any, allowed: str) -> np.datetime64:
    """Return a date in ISO 8601, or of a library, as universal time."""
    value = time
    try:
        if isinstance(time, str):
            value = f"{time}-01-01"[:10] if re.fullmatch(r"\d{4}(-\d\d)?", time) else time
            value = datetime.fromisoformat(value)
        elif not isinstance(time, date | np.datetime64):
            raise TypeError(type(time).__name__)
        if isinstance(value, datetime) and value.tzinfo is not None:
            value = value.astimezone(UTC).replace(tzinfo=None)
        found = np.datetime64(value, "us")
    except (TypeError, ValueError, OverflowError) as error:
        raise Refused("time", time, allowed) from error
    if np.isnat(found):
        raise Refused("time", time, allowed)
    return found


def _at_site(data: xarray.Dataset, site: Any) -> xarray.Dataset:
    """Return the record of a station, by its label, or next to a place."""
    if isinstance(site, str) or np.ndim(site) == 0:
        return _at_station(data, site)
    lon, lat = require_pair(site, "site", "a station, or its longitude and latitude [deg]")
    coordinates = []
    for name, long_name in (("lon", "longitude"), ("lat", "latitude")):
        known = next((n for n in (name, long_name) if n in data.variables), None)
        if known is None:
            raise Refused("site", site, "a record with lon and lat")
        if unit := unit_of(data[known]):
            convert(1.0, unit, "deg", known)  # refuses metres
        coordinates.append(np.radians(data[known].astype(np.float64)))
    x, y, x0, y0 = *coordinates, math.radians(lon), math.radians(lat)
    haversine = np.sin(0.5 * (y - y0)) ** 2 + np.cos(y) * math.cos(y0) * np.sin(0.5 * (x - x0)) ** 2
    distance: Any = np.degrees(2.0 * np.arcsin(np.sqrt(np.minimum(haversine, 1.0)))).fillna(np.inf)
    if distance.size == 0 or float(distance.min()) > _FARTHEST:
        raise Refused("site", site, "within 1 deg of a station or grid point")
    if int((distance == distance.min()).sum()) > 1:
        raise Refused("site", site, "one station there: select it by its label, or first a time")
    place = {d: int(i) for d, i in distance.argmin(dim=...).items()} if distance.ndim else {}
    return data.isel(place)


def _at_station(data: xarray.Dataset, site: Any) -> xarray.Dataset:
    """Return the record of a station: by its label, or its number if there are no labels."""
    name = next((n for n in _STATIONS if n in data.variables or n in data.dims), None)
    if name is None or isinstance(site, bool | np.bool):
        raise Refused("site", site, "a label of a record with stations")
    if name not in data.variables:
        require_whole(site, 0, data.sizes[name] - 1, "site",
                      f"0 to {data.sizes[name] - 1}, of {data.sizes[name]} stations")  # fmt: skip
        return data.isel({name: site})
    labels = [_text(label) for label in np.ravel(data[name].values).tolist()]
    wanted = _text(site.item() if hasattr(site, "item") else site)
    matches = [i for i, label in enumerate(labels) if label == wanted]
    if not matches and len(labels) == 1 and wanted == "0":
        matches = [0]  # the only one
    if len(matches) != 1:
        hint = f"{len(matches)} stations of this label" if matches else ""
        shown = ", ".join(labels[:9]) + ", ..." * (len(labels) > 9)
        raise Refused("site", site, f"a label: {shown}; a number by isel", hint)
    dims = data[name].dims
    return data.isel({dims[0]: matches[0]}) if dims else data


def _text(label: Any) -> str:
    """Return a label of a station as text."""
    if isinstance(label, bytes):
        label = label.decode("latin-1")
    if isinstance(label, float) and label.is_integer():
        label = int(label)
    return str(label).strip("\0 ")


def _canonical(data: xarray.Dataset) -> tuple[Floats, Floats, Floats]:
    """Return frequency, direction and density of one record in the units of `Spectrum2D`."""
    efth = data["efth"]
    is_fourier = all(name in data.variables for name in _FOURIER)
    axes = ("freq",) if is_fourier else ("freq", "dir")
    efth = efth.squeeze([d for d in efth.dims if d not in axes and efth.sizes[d] == 1], drop=True)
    if not is_fourier and efth.sizes.get("dir", 1) == 1 and set(efth.dims) <= {"freq", "dir"}:
        raise Refused(
            "efth",
            Described("no directions"),
            'directions, or spectrum = "tabulated" with a spreading',
        )
    if not is_fourier and "dir" not in data.variables:
        raise Refused("dir", Described("missing"), "directions [deg]")
    if set(efth.dims) != set(axes) or not efth.size:
        raise Refused("efth", efth.dims, f"dimensions {axes}; select one time and site first")
    freq = _frequencies(data["freq"], unit_of(efth))
    values = valid_values(efth.transpose(*axes))
    if is_fourier:
        unit = unit_of(efth)
        values = convert(values, unit, "m2 Hz-1", "efth") if unit else values
        coefficients = [_coefficient(data[name], name) for name in _FOURIER]
        order = np.argsort(freq, kind="stable")
        direction = np.arange(_DIRECTIONS) * 360.0 / _DIRECTIONS
        density = _from_fourier(values, direction, *coefficients)
        return _checked(freq[order], direction, density[order])
    unit = unit_of(efth)
    is_angular = unit_of(data["dir"]).lower().startswith("rad")
    if (unit or is_angular) and not _ANGLE.search(unit):
        found = Described(f"in {unit}" if unit else "without units over radians")
        raise Refused("efth", found, f"units that name the angle, such as {_DENSITY}")
    if unit:
        per_degree = convert(values, unit, _DENSITY, "efth")
        if not np.array_equal(per_degree, values, equal_nan=True):
            warn_of_input(f"efth: {unit} converted to {_DENSITY}")
        values = per_degree
    direction = _directions(data, values)
    order = np.argsort(freq, kind="stable")
    return _checked(freq[order], *_round_the_circle(direction, values[order]))


def _frequencies(variable: xarray.DataArray, density_unit: str) -> Floats:
    """Return frequencies [Hz]; over angular ones the unit of densities names the frequency."""
    unit = unit_of(variable)
    freq = valid_values(variable)
    if unit:
        if _ANGLE.search(unit):
            angles = _ANGLE.findall(density_unit)
            if (
                "hz" not in density_unit.lower()
                and len(angles) < 2
                and not any(p == "2" for _, p in angles)
            ):
                found = Described(f"in {density_unit or 'no unit'} over {unit}")
                raise Refused(
                    "efth", found, f"units with Hz-1 or s rad-1, such as {_DENSITY} or m2 s rad-2"
                )
        freq = convert(freq, unit, "Hz", "freq")
    return freq


def _coefficient(variable: xarray.DataArray, name: str) -> Floats:
    """Return a direction [rad] or a ratio of the Fourier coefficients of a buoy."""
    values, unit = np.ravel(valid_values(variable.squeeze(drop=True))), unit_of(variable)
    if name.startswith("alpha"):
        bearing = convert(values, unit, "deg", name) if unit else values
        return np.radians(_coming_from(bearing, convention_of(variable, {}) or "from"))
    return convert(values, unit, "1", name) if unit else values


def _directions(data: xarray.Dataset, values: Floats) -> Floats:
    """Return the bearing [deg] that waves come from."""
    variable = data["dir"]
    direction, unit = np.asarray(variable.values, np.float64), unit_of(variable)
    if unit:
        direction = convert(direction, unit, "deg", "dir")
    convention = convention_of(variable, data.attrs) or "from"
    if convention != "from":
        warn_of_input(f"dir: {convention} converted to the bearing that waves come from")
    return _coming_from(direction, convention)


def _coming_from(direction: Floats, convention: str) -> Floats:
    """Return the nautical direction of origin [deg] of a direction in another convention."""
    turned = {
        "from": direction,
        "to": direction + 180.0,
        "cartesian": 270.0 - direction,  # travel, counter-clockwise from east
        "cartesian from": 90.0 - direction,
    }[convention]
    return np.mod(turned, 360.0)


def _round_the_circle(direction: Floats, density: Floats) -> tuple[Floats, Floats]:
    """Return densities over sorted directions in equal steps round the circle, 0 <= dir < 360."""
    if not np.isfinite(direction).all():
        raise Refused("dir", Described("not finite"), "finite directions [deg]")
    direction = np.mod(np.round(np.mod(direction, 360.0), 9), 360.0)
    order = np.argsort(direction, kind="stable")
    direction, density = direction[order], density[:, order]
    is_double = np.diff(direction, append=np.inf) < 1e-3
    if direction[0] + 360.0 - direction[-1] < 1e-3 and len(direction) > 1:  # 359.9999 and 0
        is_double[-1] = True
    for i in np.flatnonzero(is_double):  # 0 and 360, as buoys write a closed circle
        if not np.allclose(
            density[:, i], density[:, (i + 1) % len(direction)], rtol=1e-4, equal_nan=True
        ):
            raise Refused(
                "dir", Described(f"{direction[i]:g} deg twice"), "one density a direction"
            )
    direction, density = direction[~is_double], density[:, ~is_double]
    n = len(direction)
    width = 360.0 / n
    offset = direction - width * np.arange(n)
    # radians of three digits are wrong by 0.29 deg, whole degrees by 0.5
    rounding = 0.5 if (direction == np.round(direction)).all() else 0.3
    if n < 2 or np.ptp(offset) > 2.0 * min(max(rounding, 1e-3 * width), 0.25 * width):
        turn = np.diff(direction, append=direction[0] + 360.0)
        found = Described(f"steps of {turn.min():g} to {turn.max():g} deg")
        raise Refused("dir", found, "equal steps round the circle; radians need units = radian")
    if np.ptp(offset) > 1e-3 * width:
        direction = offset.mean() + width * np.arange(n)
    return direction, density


def _checked(freq: Floats, direction: Floats, density: Floats) -> tuple[Floats, Floats, Floats]:
    """Return a spectrum of positive frequencies whose densities are finite, not negative, not 0."""
    is_zero = (freq == 0.0) & ~(np.nan_to_num(density) > 0.0).any(axis=1)  # the mean level
    freq, density = freq[~is_zero], density[~is_zero]
    measured = np.flatnonzero(~np.isnan(density).all(axis=1))
    if 0 < len(measured) and measured[-1] - measured[0] + 1 < len(freq):  # of another buoy's band
        freq = freq[measured[0] : measured[-1] + 1]
        density = density[measured[0] : measured[-1] + 1]
        warn_of_input(f"efth: values from {freq[0]:.3g} to {freq[-1]:.3g} Hz alone")
    if len(freq) < 2 or not (np.isfinite(freq) & (freq > 0.0)).all():
        raise Refused("freq", Described("not positive"), "two or more finite numbers > 0 [Hz]")
    if not (np.diff(freq) > 0.0).all():
        raise Refused(
            "freq", Described("a frequency twice"), "one spectrum of different frequencies"
        )
    missing = int((~np.isfinite(density) | (np.abs(density) > LARGEST)).sum())
    if missing:
        found = Described(f"{missing} of {density.size} values missing or not finite")
        raise Refused("efth", found, "finite variance densities >= 0")
    most = float(density.max())
    if most <= 0.0 and float(density.min()) == 0.0:
        raise Refused("efth", Described("zero everywhere"), "a record with waves")
    if float(density.min()) < -_ROUNDED * most:
        raise Refused("efth", Described("negative"), "finite variance densities >= 0")
    return freq, direction, np.maximum(density, 0.0)


def _from_fourier(
    spectrum: Floats, direction: Floats, alpha1: Floats, alpha2: Floats, r1: Floats, r2: Floats
) -> Floats:
    """Return the density over directions of a buoy's first two Fourier coefficients.

    The truncated series S (1/2 + r1 cos(theta - alpha1) + r2 cos 2 (theta - alpha2)) / pi is
    negative in places. The maximum entropy form has these coefficients and is positive.
    """
    calm = (spectrum == 0.0) | np.isnan(spectrum)
    lacking = np.isnan(alpha1 + alpha2 + r1 + r2) & ~calm
    if lacking.any():
        found = Described(
            f"no directions at {lacking.sum()} of {len(spectrum)} frequencies with waves"
        )
        raise Refused("efth", found, "directions at all frequencies with waves")
    c1 = np.where(calm, 0.0, r1 * np.exp(1j * alpha1))
    c2 = np.where(calm, 0.0, r2 * np.exp(2j * alpha2))
    shares = maximum_entropy(c1, c2, np.radians(direction))
    warn_of_input("efth: directions by the maximum entropy form of the buoy's Fourier coefficients")
    return spectrum[:, None] * shares * len(direction) / 360.0


def maximum_entropy(c1: NDArray[Any], c2: NDArray[Any], theta: Floats) -> Floats:
    """Return shares of direction bins of the maximum entropy distribution.

    D = (1 - phi1 c1* - phi2 c2*) / (2 pi |1 - phi1 exp(-i theta) - phi2 exp(-2 i theta)|^2),
    phi1 = (c1 - c2 c1*) / (1 - |c1|^2), phi2 = c2 - c1 phi1; Lygre and Krogstad (1986),
    doi:10.1175/1520-0485(1986)016<2052:MEEOTD>2.0.CO;2, eqs. 12 and 13.

    Parameters
    ----------
    c1, c2 : ndarray of complex, shape (m,)
        First and second Fourier coefficient, the means of exp(i theta) and exp(2 i theta).
    theta : ndarray, shape (n,)
        Centres of bins in equal steps round the circle [rad].

    Returns
    -------
    ndarray, shape (m, n)
    """
    # noise makes coefficients that no density has: the nearest possible ones keep the mean
    # direction. At the limit the density is a line, which points within a bin would miss
    c1 = c1 * np.minimum(1.0, _SHARPEST / np.maximum(np.abs(c1), 1e-12))
    apart, most = c2 - c1**2, _NEAREST * (1.0 - np.abs(c1) ** 2)
    c2 = c1**2 + apart * np.minimum(1.0, most / np.maximum(np.abs(apart), 1e-12))
    phi1 = (c1 - c2 * c1.conj()) / (1.0 - np.abs(c1) ** 2)
    phi2 = c2 - c1 * phi1
    width = 2.0 * math.pi / len(theta)
    inside = width * ((np.arange(_POINTS) + 0.5) / _POINTS - 0.5)
    z = np.exp(-1j * (theta[:, None] + inside))[..., None]
    density = np.mean(np.abs(1.0 - phi1 * z - phi2 * z**2) ** -2, axis=1).T
    return density / density.sum(axis=1, keepdims=True)
