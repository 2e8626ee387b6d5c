"""Selection of one record by date, station or place."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, date, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused, refusing, require_pair, require_whole
from meshtrace.units import convert, unit_of

if TYPE_CHECKING:
    import xarray

_STANDARD = ("", "none", "standard", "gregorian", "proleptic_gregorian")  # calendars
_FARTHEST = 1.0  # [deg] from a place to its grid point
_STATIONS = ("site", "station")
_PLACES = (*_STATIONS, "lon", "lat", "longitude", "latitude")


def one_record(
    dataset: xarray.Dataset, names: Sequence[str], time: Any, site: Any
) -> tuple[xarray.Dataset, str | None]:
    """Return the lazy variables of these names at a time and a place, and the label of both."""
    names = (*names, "time", *_PLACES)
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
    # a missing date is never the nearest one
    distance[np.isnat(distance)] = np.timedelta64(2**62, "us")
    # the usual step: a gap in the record is no reason to take what is far away
    steps = np.diff(np.unique(dated))
    step = np.median(steps.astype(np.int64)) if steps.size else 0.0
    if float(distance.min().astype(np.int64)) > 0.5 * step:
        raise Refused("time", time, f"within half a step of {dates}")
    i = int(distance.argmin())
    if (times == times[i]).sum() > 1:
        twice = Described(f"{_shown(times[i])} twice in the record")
        raise Refused("time", twice, "one spectrum at a time")
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
        problem = Described(f"calendar {calendar}" if values.ndim < 2 else f"shape {values.shape}")
        allowed = "dates of the standard calendar; or select a record by isel and give no time"
        raise Refused("time", problem, allowed)
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
            # a year or a month stands for its first day
            value = f"{time}-01-01"[:10] if re.fullmatch(r"\d{4}(-\d\d)?", time) else time
            value = datetime.fromisoformat(value)
        elif not isinstance(time, date | np.datetime64):
            raise TypeError(type(time).__name__)
        if isinstance(value, datetime) and value.tzinfo is not None:
            value = value.astimezone(UTC).replace(tzinfo=None)
        instant = np.datetime64(value, "us")
    except (TypeError, ValueError, OverflowError) as error:
        raise Refused("time", time, allowed) from error
    if np.isnat(instant):
        raise Refused("time", time, allowed)
    return instant


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
    # the haversine keeps the digits of short distances, which an arccosine loses
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
        # never fails, whatever encoding a file has
        label = label.decode("latin-1")
    if isinstance(label, float) and label.is_integer():
        label = int(label)
    return str(label).strip("\0 ")
