"""Files of measured water: SeaBASS, BGC-Argo profiles, text tables."""

from __future__ import annotations

import dataclasses
import re
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from meshtrace.cells import Cells, cells_of_text, text_of
from meshtrace.checks import check_call
from meshtrace.errors import Described, Refused, reads_as_number, refusing, warn_of_input
from meshtrace.models import Floats
from meshtrace.netcdf import valid_values
from meshtrace.optics.constituents import Constituents
from meshtrace.optics.pure_water import pure_water_absorption, zhang_hu_he
from meshtrace.optics.spectra import TABLE_COLUMNS, SpectralTable, WaterSpectrum
from meshtrace.stored import read_dataset
from meshtrace.tables import read_columns
from meshtrace.units import convert, unit_of

_FIELDS = {"a": ("a", "agp"), "b": ("b", "bp"), "c": ("c", "cgp")}
"""Fields of SeaBASS: the whole coefficient, and that without pure water."""

_DEPTHS = ("depth", "bin_depth")
_OTHER_DEPTHS = ("water_depth", "bottom_depth", "depth_of_water", "secchi_depth")
_LIKE_DEPTH = re.compile(r"depth|pressure|^press?$|^z$")  # of values, under another name
# a coefficient, with its wavelength [nm] if it is appended, as in agp440 or c412.5
_COEFFICIENT = re.compile(r"(?:a|agp|b|bp|c|cgp)(?:\d+(?:\.\d+)?)?")
_DELIMITERS = {"": " ", "space": " ", "comma": ",", "tab": "\t", "semicolon": ";"}
# keys of the SeaBASS header whose number stands in the table for "no value"
_NO_VALUES = ("missing", "below_detection_limit", "above_detection_limit")
_GOOD = (b"1", b"2", b"5", b"8")  # flags of Argo: good, probably good, changed, estimated


@check_call
def read_spectrum(path: str | PathLike[str]) -> WaterSpectrum:
    """Read the spectrum of a water from a file.

    Parameters
    ----------
    path : path
        A BGC-Argo profile (netCDF, .nc), a SeaBASS file, or a text table with the columns
        wavelength [nm], a, b [m-1], or depth [m], wavelength, a, b; headings may name them in
        another order and with other units, see `meshtrace.tables.read_columns`.

    Returns
    -------
    WaterSpectrum
        `SpectralTable`, or `Constituents` for a profile of chlorophyll.

    Raises
    ------
    Refused
        If the file cannot be read or has no such columns.

    Notes
    -----
    SeaBASS: fields a, or agp, which lacks pure water; and b, or bp, or c or cgp less a; the
    wavelength appended to the field or in a column of its own. b is linear between its wavelengths.
    Units are converted. Rows of one depth (`depth` or `bin_depth`) are averaged, depths with
    missing values left out; without a field of depth the water is uniform. Pure water, where it is
    lacking, is that of `pure_water_absorption` and `zhang_hu_he` at 20 degrees and 35 g/kg;
    b = c - a is 0 where it would be negative.

    BGC-Argo: PRES (1 dbar as 1 m), CHLA, and BBP700 if it is there, converted to dbar, mg m-3 and
    m-1 by their attribute `units`, of the first profile that has chlorophyll; adjusted values
    before raw ones, of the quality flags 1, 2, 5 and 8; negative values count as 0. TEMP and PSAL
    of the highest level, if they are there and in range. By day chlorophyll near the surface is too
    low where it is not corrected for quenching (flag 5).

    References
    ----------
    SeaBASS, "Metadata headers" and "Standardized fields and units", seabass.gsfc.nasa.gov/wiki;
    Argo user's manual, doi:10.13155/29825.
    """
    file = Path(path)
    if not file.is_file():
        raise Refused(str(path), Described("no such file"), "a file of a water")
    if file.suffix == ".nc":
        return _read_argo(file)
    # names of people and ships in the headers of SeaBASS files are not always UTF-8
    text = text_of(file, errors="replace" if _is_seabass(file) else "strict")
    if _is_seabass(file):
        return _read_seabass(file, text)
    table = read_columns(file, TABLE_COLUMNS)
    return SpectralTable(table=np.column_stack([series.values for series in table.values()]))


def _is_seabass(file: Path) -> bool:
    """Return whether a file begins with a SeaBASS header."""
    with file.open("rb") as stream:
        return b"/begin_header" in stream.read(4096).lower()


def _read_seabass(file: Path, text: str) -> SpectralTable:
    """Read a SeaBASS file."""
    import pandas as pd

    cells, values = _fields_of_seabass(file, text)
    depths = [name for name in values if name in _DEPTHS]
    frame = pd.DataFrame(values, index=range(len(cells.places)))
    depth = frame[depths[0]] if depths else np.zeros(len(frame))
    frame = frame.set_index(pd.Index(depth, name="at"))
    # each a table of the shape (depths, wavelengths), or None
    a, b, c = (_whole(frame, name, file) for name in _FIELDS)
    if a is not None and c is not None and b is None:
        # noise of both instruments can make c less than a
        b = (_at(c, a.columns) - a).clip(lower=0.0)
    if a is None or b is None:
        labels = Described(", ".join(cells.labels))
        raise Refused(str(file), labels, "fields a or agp, and b, bp, c or cgp, with wavelengths")
    b = _at(b, a.columns)
    # leave out first the wavelengths without values of both, then the depths with gaps
    wavelengths = a.columns[a.notna().any() & b.notna().any()]
    full = a.index[(a[wavelengths].notna() & b[wavelengths].notna()).all(axis=1)]
    samples = [(z, w, a.at[z, w], b.at[z, w]) for z in full for w in wavelengths]
    if not samples:
        raise Refused(str(file), Described("missing values"), "a depth with all values")
    cells.warn()
    return SpectralTable(table=samples)


def _fields_of_seabass(file: Path, text: str) -> tuple[Cells, dict[str, Floats]]:
    """Return the cells of a SeaBASS file and the values of the required fields."""
    head, end, body = text.partition("/end_header")
    lines = [line.strip()[1:].partition("=") for line in head.splitlines() if "/" in line[:1]]
    header = {key.strip().lower(): value.strip() for key, _, value in lines}
    fields = [name.strip().lower() for name in header.get("fields", "").strip(",").split(",")]
    delimiter = header.get("delimiter", "").lower()
    if delimiter not in _DELIMITERS:
        raise Refused(f"{file}: delimiter", delimiter, ", ".join(filter(None, _DELIMITERS)))
    if not end:
        raise Refused(str(file), Described("no /end_header"), "a SeaBASS file")
    _require_fields(file, fields)
    # number of the line at which the body begins, for errors: it follows that of /end_header
    first = len(re.findall(r"\r\n|\r|\n", head)) + 2
    body = "".join(re.split(r"\r\n|\r|\n", body, maxsplit=1)[1:])
    cells = cells_of_text(body, str(file), _DELIMITERS[delimiter], 0, first)
    if len(cells.columns) != len(fields):
        count = Described(f"line {cells.places[0]}: {len(cells.columns)} columns")
        raise Refused(str(file), count, f"a column for each of {len(fields)} fields")
    missing = [number for key in _NO_VALUES if (number := _number(file, header, key)) is not None]
    values = {
        name: _values(cells, index, name, missing)
        for index, name in enumerate(fields)
        if _unit_of(name)
    }
    if "units" in header:
        values = _in_wanted_units(
            file, cells, fields, header["units"].strip(",").split(","), values
        )
    return dataclasses.replace(cells, labels=fields), values


def _require_fields(file: Path, fields: list[str]) -> None:
    """Refuse duplicate fields, and depths under unknown or several names."""
    twice = sorted({name for name in fields if fields.count(name) > 1})
    if twice:
        names = Described(f"fields {', '.join(twice)} twice")
        raise Refused(str(file), names, "a SeaBASS file of different fields")
    depths = [name for name in fields if name in _DEPTHS]
    # without a field of depth the water would be taken as uniform
    candidates = depths or [
        name for name in fields if name not in _OTHER_DEPTHS and _LIKE_DEPTH.search(name)
    ]
    if len(depths) != 1 and candidates:
        allowed = f"one field of the depth, {' or '.join(_DEPTHS)}"
        raise Refused(str(file), Described(", ".join(candidates)), allowed)


def _in_wanted_units(
    file: Path, cells: Cells, fields: list[str], units: list[str], values: dict[str, Floats]
) -> dict[str, Floats]:
    """Return the values of fields in m, nm and m-1."""
    if len(units) != len(fields):
        counts = Described(f"{len(fields)} fields and {len(units)} units")
        raise Refused(str(file), counts, "a SeaBASS file with a unit for each field")
    stated, converted = dict(zip(fields, map(str.strip, units), strict=True)), dict[str, Floats]()
    for name, numbers in values.items():
        wanted = _unit_of(name)
        converted[name] = convert(numbers, stated[name], wanted, f"{file}: field {name}")
        if not np.array_equal(converted[name], numbers, equal_nan=True):
            cells.notes.append(f"{name} in {stated[name]} converted to {wanted}")
    return converted


def _unit_of(field: str) -> str:
    """Return the required unit of a SeaBASS field, "" for other fields."""
    if field in _DEPTHS:
        return "m"
    if field == "wavelength":
        return "nm"
    return "m-1" if _COEFFICIENT.fullmatch(field) else ""


def _number(file: Path, header: dict[str, str], key: str) -> float | None:
    """Return the number of a key of the header; None if it has none."""
    if key not in header or header[key].lower() in ("", "na", "nan", "none"):
        return None
    if not reads_as_number(header[key]):
        raise Refused(f"{file}: {key}", header[key], "a number")
    return float(header[key])


def _values(cells: Cells, index: int, name: str, missing: list[float]) -> Floats:
    """Return the values of a field, nan for missing ones."""
    values = cells.numbers(index, name)
    values = np.where(np.isin(values, missing), np.nan, values)
    # Noise may carry a coefficient below zero, but not by more than 1 m-1: less is a number for a
    # missing value that the header does not name, such as -999.
    wrong = np.isinf(values) | (values < -1.0)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise cells.refused(row, index, name, f"{values[row]:g}", "or /missing with this value")
    return values


def _whole(frame: Any, name: str, file: Path) -> Any:
    """Return a total coefficient (depths, wavelengths), pure water included; None if absent."""
    for field, lacks_water in zip(_FIELDS[name], (False, True), strict=True):
        if "wavelength" in frame and field in frame:
            table = frame.pivot_table(index="at", columns="wavelength", values=field)
        else:
            number = re.compile(rf"{field}(\d+(?:\.\d+)?)$")
            nm_of = {f: float(m[1]) for f in frame.columns if (m := number.match(f))}
            if len(set(nm_of.values())) < len(nm_of):
                names = Described(", ".join(nm_of))
                raise Refused(str(file), names, "each wavelength of a field once")
            table = frame[list(nm_of)].rename(columns=nm_of).groupby(level=0).mean()
        if table.shape[1] and lacks_water:
            w = np.asarray(table.columns, np.float64)
            water = {"a": pure_water_absorption, "b": zhang_hu_he}
            # cgp lacks both the absorption and the scattering of pure water
            parts = water.values() if name == "c" else (water[name],)
            table = table + sum(part(w) for part in parts)
        if table.shape[1]:
            return table.sort_index(axis=1)
    return None


def _at(table: Any, wavelengths: Any) -> Any:
    """Interpolate a table linearly to other wavelengths; nan outside its own."""
    table_nm = np.asarray(table.columns, np.float64)
    new = np.asarray(wavelengths, np.float64)
    values = [np.interp(new, table_nm, row, left=np.nan, right=np.nan) for row in table.to_numpy()]
    return type(table)(values, index=table.index, columns=wavelengths)


_MISSING = 99999.0  # of Argo
_ARGO = {"PRES": "dbar", "CHLA": "mg m-3", "BBP700": "m-1", "TEMP": "degC", "PSAL": "psu"}


def _read_argo(file: Path) -> Constituents:
    """Read a BGC-Argo profile."""
    levels = read_dataset(file, decode_times=False)
    with refusing(str(file), "a BGC-Argo profile"):
        for profile in range(levels.sizes.get("N_PROF", 1)):
            pressure = _good(levels, "PRES", profile)
            profiles = {
                name: _over_depth(pressure, _good(levels, name, profile), name) for name in _ARGO
            }
            if profiles["CHLA"] is not None:
                break
        else:
            names = Described(", ".join(map(str, levels.data_vars)) or "no variables")
            raise Refused(str(file), names, "PRES and CHLA with good values (flags 1, 2, 5, 8)")
    constituents: dict[str, Any] = {"chlorophyll": profiles["CHLA"]}
    if profiles["BBP700"] is not None:
        constituents["bbp700"] = profiles["BBP700"]
    # the ranges that `Constituents` allows; outside of them its defaults serve
    for field, name, most in (("temperature_c", "TEMP", 30.0), ("salinity", "PSAL", 40.0)):
        profile_rows = profiles[name]
        # value at the highest level
        if profile_rows is not None and 0.0 <= profile_rows[0][1] <= most:
            constituents[field] = profile_rows[0][1]
    return Constituents.model_validate(constituents)


def _good(data: Any, name: str, profile: int) -> Floats:
    """Return the values of a profile in the units of `_ARGO`, nan where of bad quality."""
    # adjusted values are calibrated; raw ones stand in where a profile has none
    for variable in (f"{name}_ADJUSTED", name):
        if variable not in data:
            continue
        part = data[[v for v in (variable, f"{variable}_QC") if v in data]]
        part = part.isel(N_PROF=profile) if "N_PROF" in part.dims else part
        values = valid_values(part[variable])
        if values.ndim > 1:
            dims = Described(f"dimensions {part[variable].dims}")
            raise Refused(variable, dims, "levels of a profile")
        if f"{variable}_QC" in part:
            flags = np.asarray(part[f"{variable}_QC"]).astype("S1")
            if flags.shape != values.shape:
                lengths = Described(f"{values.size} values with {flags.size} flags")
                raise Refused(variable, lengths, "a flag for each value")
            values = np.where(np.isin(flags, _GOOD), values, np.nan)
        values = np.where((values == _MISSING) | ~np.isfinite(values), np.nan, values)
        if np.isfinite(values).any():
            unit = unit_of(part[variable])
            if name == "PSAL" and unit in ("1", "1e-3"):  # the practical scale has no unit
                unit = ""
            converted = convert(values, unit, _ARGO[name], variable) if unit else values
            if not np.array_equal(converted, values, equal_nan=True):
                warn_of_input(f"{variable}: {unit} converted to {_ARGO[name]}")
            return np.atleast_1d(np.where(np.abs(converted) < _MISSING, converted, np.nan))
    return np.full(data.sizes.get("N_LEVELS", 1), np.nan)


def _over_depth(
    pressure: Floats, values: Floats, name: str
) -> tuple[tuple[float, float], ...] | None:
    """Return pairs (depth, value) from 0 m downwards, 1 dbar as 1 m; None without good values."""
    if np.isnan(values).all():
        return None
    if pressure.shape != values.shape:
        lengths = Described(f"{values.size} values over {pressure.size} pressures")
        raise Refused(name, lengths, "a value for each pressure")
    good = np.isfinite(pressure) & np.isfinite(values)
    if not good.any():
        return None
    # of levels at the same pressure the first counts
    depth, first = np.unique(np.maximum(pressure[good], 0.0), return_index=True)
    # the highest level stands for the water above it
    depth[0] = 0.0
    # negative values count as 0
    profile = np.column_stack([depth, np.maximum(values[good][first], 0.0)])
    return tuple(map(tuple, profile.tolist()))
