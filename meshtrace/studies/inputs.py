"""Uncertain inputs of a link: laws of scipy.stats or samples of files, of the year or by month."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from meshtrace.errors import Described, Refused, refusing, require_array, require_keys, require_pair
from meshtrace.models import Floats
from meshtrace.netcdf import reading
from meshtrace.scenario.files import parse_toml, read_text
from meshtrace.stored import read_dataset

MONTHS = 12

# a law becomes its quantiles at the middles of so many equal shares of the time; tuned: the tail
# beyond the outermost ones is a share of 3e-5
_QUANTILES = 2**14
_RARE = 0.002  # shares at the ends of an input where the surface is continued as a constant
_OF_FILES = ("file", "variable", "time")
_ALLOWED = "a law of scipy.stats, samples, or a table with distribution, samples or file"


class Input:
    """An input and its values, of equal shares of the time.

    Parameters
    ----------
    name : str
        Its key.
    values : tuple of ndarray
        Values of the year, or of each month.
    record : str
        Inputs of one text have their values at the same times, and are drawn together.
    """

    def __init__(self, name: str, values: tuple[Floats, ...], record: str) -> None:
        self.name, self.values, self.record = name, values, record

    def of_month(self, month: int) -> Floats:
        """Return the values of a month, or of the year for inputs without months."""
        return self.values[month % len(self.values)]

    def ppf(self, shares: Any) -> Any:
        """Return quantiles over the year, with months of equal weight, as laws of scipy do."""
        each = [_quantiles(v, np.linspace(0.0, 1.0, _QUANTILES)) for v in self.values]
        return np.quantile(np.concatenate(each), shares)

    def axis(self) -> Axis:
        """Return the axis along which runs are placed, without the rarest values."""
        values = self.ppf(np.linspace(_RARE, 1.0 - _RARE, 999))
        low, high = values[[0, -1]].tolist()
        if not low < high:
            raise Refused(f"inputs.{self.name}", low, "values that differ")
        # wind acts about linearly and chlorophyll by its logarithm, and so they are distributed
        log = low > 0.0 and abs(stats.skew(np.log(values))) < abs(stats.skew(values))
        return Axis(self.name, low, high, bool(log))


def _quantiles(values: Floats, shares: Floats) -> Floats:
    """Return the quantiles of `numpy.quantile`, bit by bit, faster for many shares.

    It partitions the values about each share anew; here they are sorted once.
    """
    ordered = np.sort(values)
    places = shares * (len(ordered) - 1)
    below = places.astype(np.intp)
    low, high = ordered[below], ordered[np.minimum(below + 1, len(ordered) - 1)]
    step, part = high - low, places - below
    return np.where(part < 0.5, low + step * part, high - step * (1.0 - part))


class Axis(NamedTuple):
    """Range of a key, mapped to 0 ... 1 linearly or by the logarithm."""

    name: str
    low: float
    high: float
    log: bool

    def place(self, values: Floats) -> Floats:
        """Return the places of values, limited to 0 ... 1."""
        within = np.clip(values, self.low, self.high)
        if self.log:
            return np.log(within / self.low) / math.log(self.high / self.low)
        return (within - self.low) / (self.high - self.low)

    def value(self, place: Any) -> Any:
        """Return the values at places."""
        if self.log:
            return self.low * (self.high / self.low) ** place
        return self.low + place * (self.high - self.low)


def read_inputs(inputs: Mapping[str, Any] | str | Path) -> list[Input]:
    """Read uncertain inputs from tables by key, or from a TOML file of such tables.

    Paths inside a file are relative to its folder.

    Raises
    ------
    Refused
        If there is none, or one of them is no law and no samples.
    """
    folder = Path()
    if isinstance(inputs, str | Path):
        folder = Path(inputs).parent
        try:
            inputs = _by_key(parse_toml(read_text(inputs)))
        except Refused as error:
            raise error.in_file(str(inputs)) from error.__cause__
    if not isinstance(inputs, Mapping) or not inputs:
        raise Refused("inputs", inputs, "tables of laws or samples by dotted keys")
    return [_read(str(name), source, folder) for name, source in inputs.items()]


def _by_key(table: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return the tables of inputs inside nested tables by dotted key."""
    tables: dict[str, Any] = {}
    for name, item in table.items():
        key = f"{path}.{name}" if path else name
        is_input = not isinstance(item, Mapping) or {"distribution", "samples", "file"} & {*item}
        tables |= {key: item} if is_input else _by_key(item, key)
    return tables


def _read(name: str, source: Any, folder: Path) -> Input:
    """Return the input that a law, samples or a table describes."""
    field, record, clip = f"inputs.{name}", "", None
    if isinstance(source, Mapping):
        table = dict(source)
        clip = table.pop("clip", None)
        if "file" in table:
            require_keys(table, _OF_FILES, field)
            record = str(folder / str(table["file"]))
            source = _samples_of(record, table, field)
        elif "samples" in table:
            require_keys(table, ("samples",), field)
            source = table["samples"]
        else:
            source = _law(table, field)
    by_month = _of_law(source, field) if hasattr(source, "ppf") else _by_month(source, field)
    if clip is not None:
        low, high = require_pair(clip, f"{field}.clip", "[low, high], low < high")
        if not low < high:
            raise Refused(f"{field}.clip", clip, "[low, high], low < high")
        by_month = tuple(np.clip(values, low, high) for values in by_month)
    return Input(name, by_month, record)


def _law(table: dict[str, Any], field: str) -> Any:
    """Return the frozen law that a table describes; a list of a parameter is by month."""
    law = table.pop("distribution", None)
    if hasattr(law, "ppf") and not table:
        return law
    kind = getattr(stats, law, None) if isinstance(law, str) else None
    if not isinstance(kind, stats.rv_continuous):
        raise Refused(f"{field}.distribution", law, "a continuous law of scipy.stats by its name")
    shapes = kind.shapes.split(", ") if kind.shapes else []
    require_keys(table, ("distribution", "clip", *shapes, "loc", "scale"), field)
    parameters = {
        key: require_array(value, f"{field}.{key}", "a number, or one for each month")
        for key, value in table.items()
    }
    with refusing(field, f"the parameters of {law}: {', '.join([*shapes, 'loc', 'scale'])}"):
        return kind(**parameters)


def _of_law(law: Any, field: str) -> tuple[Floats, ...]:
    """Return the quantiles of a frozen law, for each month if its parameters have twelve values."""
    shares = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    with refusing(field, "a law with one parameter, or one for each month"):
        values = np.asarray(law.ppf(shares[:, None]), float)
    if values.shape[1] not in (1, MONTHS) or not np.isfinite(values).all():
        raise Refused(field, Described("no finite quantiles"), "parameters of the law in range")
    return tuple(values.T)


def _by_month(source: Any, field: str) -> tuple[Floats, ...]:
    """Return samples, by month if their times have all months; nan are left out."""
    months = None
    if hasattr(source, "to_series"):  # an xarray.DataArray
        source = source.squeeze().to_series()
    index: Any = getattr(source, "index", None)  # of a pandas.Series
    if hasattr(index, "month"):
        months = np.asarray(index.month)
    values = require_array(source, field, _ALLOWED)
    if values.ndim != 1 or np.isinf(values).any() or np.isfinite(values).sum() < 2:
        shape = Described(f"samples of shape {values.shape}")
        raise Refused(field, shape, "two finite ones or more")
    if months is None or {*months[np.isfinite(values)].tolist()} != {*range(1, MONTHS + 1)}:
        return (values[np.isfinite(values)],)
    return tuple(values[(months == m) & np.isfinite(values)] for m in range(1, MONTHS + 1))


def _samples_of(path: str, table: Mapping[str, Any], field: str) -> Any:
    """Return the samples in a column of a CSV file, or in a variable of a netCDF file."""
    import pandas as pd

    name, time = table.get("variable"), table.get("time", "time")
    if Path(path).suffix.lower() in (".nc", ".nc4", ".cdf"):
        frame = read_dataset(path)
        columns = [str(key) for key in frame.data_vars]
    else:
        with reading(path, "a CSV or netCDF file"):
            frame = pd.read_csv(path, skipinitialspace=True)
            columns = [str(key) for key in frame.columns]
            if time in columns:
                frame.index = pd.DatetimeIndex(pd.to_datetime(frame[time]))
    if name not in columns:
        raise Refused(f"{field}.variable", name, ", ".join(columns))
    return frame[name]
