"""Files of measured water: SeaBASS, BGC-Argo profiles, text tables."""

from __future__ import annotations

import re
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from meshtrace.errors import Described, Refused, refusing, warn_of_input
from meshtrace.models import Floats
from meshtrace.netcdf import unit_of, valid_values
from meshtrace.optics.constituents import Constituents
from meshtrace.optics.pure_water import pure_water_absorption, zhang_hu_he
from meshtrace.optics.spectra import SpectralTable, WaterSpectrum
from meshtrace.stored import read_dataset
from meshtrace.tables import read_columns
from meshtrace.units import convert

_COLUMNS = ("depth", "wavelength", "a", "b")
_FIELDS = {"a": ("a", "agp"), "b": ("b", "bp"), "c": ("c", "cgp")}
"""Fields of SeaBASS: the whole coefficient, and that without pure water."""

_NO_VALUES = ("missing", "below_detection_limit", "above_detection_limit")
_GOOD = (b"1", b"2", b"5", b"8")  # flags of Argo: good, probably good, changed, estimated


def read_spectrum(path: str | PathLike[str]) -> WaterSpectrum:
    """Read the spectrum of a water from a file.

    Parameters
    ----------
    path : path
        A BGC-Argo profile (netCDF, .nc), a SeaBASS file, or a text table with the columns
        wavelength [nm], a, b [m-1], or depth [m], wavelength, a, b; a header may name them in
        another order.

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
    Rows of one depth are averaged, depths with missing values left out; without a column of depth
    the water is uniform. Pure water, where it is lacking, is that of `pure_water_absorption` and
    `zhang_hu_he` at 20 degrees and 35 g/kg; b = c - a is 0 where it would be negative.

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
    text = file.read_text("utf-8-sig", errors="replace")
    if "/begin_header" in text[:4096].lower():
        return _read_seabass(file, text)
    found = read_columns(file, 3)
    values = found.values
    if found.header:
        words = [re.split(r"[\s_(\[]", word.strip().lower())[0] for word in found.header]
        names = [name for name in _COLUMNS if name in words]
        if names[-3:] != list(_COLUMNS[1:]):
            header = Described(", ".join(found.header))
            raise Refused(str(path), header, "columns depth (if any), wavelength, a, b")
        values = values[:, [words.index(name) for name in names]]
    return SpectralTable(table=values[:, :4])


def _read_seabass(file: Path, text: str) -> SpectralTable:
    """Read a SeaBASS file."""
    import pandas as pd

    head, _, body = text.partition("/end_header")
    lines = [line[1:].partition("=") for line in head.splitlines() if line.startswith("/")]
    header = {key.strip().lower(): value.strip() for key, _, value in lines}
    fields = [name.strip().lower() for name in header.get("fields", "").split(",")]
    frame = pd.read_csv(
        StringIO(body.partition("\n")[2]),
        sep={"comma": ",", "tab": "\t"}.get(header.get("delimiter", "").lower(), r"\s+"),
        names=fields,
        na_values=[header[key] for key in _NO_VALUES if key in header],
        skipinitialspace=True,
    ).apply(pd.to_numeric, errors="coerce")
    depth = frame["depth"] if "depth" in frame else np.zeros(len(frame))
    frame = frame.set_index(pd.Index(depth, name="at"))
    whole = {name: _whole(frame, name) for name in _FIELDS}
    a, b, c = whole.values()
    if a is not None and c is not None and b is None:
        b = (_at(c, a.columns) - a).clip(lower=0.0)
    if a is None or b is None:
        found = Described(", ".join(fields))
        raise Refused(str(file), found, "fields a or agp, and b, bp, c or cgp, with wavelengths")
    b = _at(b, a.columns)
    common = a.columns[a.notna().any() & b.notna().any()]
    full = a.index[(a[common].notna() & b[common].notna()).all(axis=1)]
    rows = [(z, w, a.at[z, w], b.at[z, w]) for z in full for w in common]
    if not rows:
        raise Refused(str(file), Described("missing values"), "a depth with all values")
    return SpectralTable(table=rows)


def _whole(frame: Any, name: str) -> Any:
    """Return a coefficient with pure water, depths by wavelengths; None if it is missing."""
    for field, pure in zip(_FIELDS[name], (False, True), strict=True):
        if "wavelength" in frame and field in frame:
            table = frame.pivot_table(index="at", columns="wavelength", values=field)
        else:
            number = re.compile(rf"{field}(\d+(?:\.\d+)?)$")
            known = {f: float(m[1]) for f in frame.columns if (m := number.match(f))}
            table = frame[list(known)].rename(columns=known).groupby(level=0).mean()
        if table.shape[1] and pure:
            w = np.asarray(table.columns, np.float64)
            water = {"a": pure_water_absorption, "b": zhang_hu_he}
            parts = water.values() if name == "c" else (water[name],)
            table = table + sum(part(w) for part in parts)
        if table.shape[1]:
            return table.sort_index(axis=1)
    return None


def _at(table: Any, wavelengths: Any) -> Any:
    """Return a table at other wavelengths, linear between its own, missing outside."""
    own = np.asarray(table.columns, np.float64)
    new = np.asarray(wavelengths, np.float64)
    values = [np.interp(new, own, row, left=np.nan, right=np.nan) for row in table.to_numpy()]
    return type(table)(values, index=table.index, columns=wavelengths)


_MISSING = 99999.0  # of Argo
_ARGO = {"PRES": "dbar", "CHLA": "mg m-3", "BBP700": "m-1", "TEMP": "degC", "PSAL": "psu"}


def _read_argo(file: Path) -> Constituents:
    """Read a BGC-Argo profile."""
    levels = read_dataset(file, decode_times=False)
    with refusing(str(file), "a BGC-Argo profile"):
        for profile in range(levels.sizes.get("N_PROF", 1)):
            pressure = _good(levels, "PRES", profile)
            rows = {
                name: _over_depth(pressure, _good(levels, name, profile), name) for name in _ARGO
            }
            if rows["CHLA"] is not None:
                break
        else:
            names = Described(", ".join(map(str, levels.data_vars)) or "no variables")
            raise Refused(str(file), names, "PRES and CHLA with good values (flags 1, 2, 5, 8)")
    given: dict[str, Any] = {"chlorophyll": rows["CHLA"]}
    if rows["BBP700"] is not None:
        given["bbp700"] = rows["BBP700"]
    for field, name, most in (("temperature_c", "TEMP", 30.0), ("salinity", "PSAL", 40.0)):
        profile_rows = rows[name]
        if profile_rows is not None and 0.0 <= profile_rows[0][1] <= most:
            given[field] = profile_rows[0][1]
    return Constituents(**given)


def _good(data: Any, name: str, profile: int) -> Floats:
    """Return good values of a variable of a profile in the unit of Argo, nan for all others."""
    for variable in (f"{name}_ADJUSTED", name):
        if variable not in data:
            continue
        part = data[[v for v in (variable, f"{variable}_QC") if v in data]]
        part = part.isel(N_PROF=profile) if "N_PROF" in part.dims else part
        values = valid_values(part[variable])
        if values.ndim > 1:
            raise Refused(
                variable, Described(f"dimensions {part[variable].dims}"), "levels of a profile"
            )
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
    """Return rows (depth, value) from 0 m downwards; None without good values."""
    if np.isnan(values).all():
        return None
    if pressure.shape != values.shape:
        lengths = Described(f"{values.size} values over {pressure.size} pressures")
        raise Refused(name, lengths, "a value for each pressure")
    good = np.isfinite(pressure) & np.isfinite(values)
    if not good.any():
        return None
    depth, first = np.unique(np.maximum(pressure[good], 0.0), return_index=True)
    depth[0] = 0.0
    rows = np.column_stack([depth, np.maximum(values[good][first], 0.0)])
    return tuple(map(tuple, rows.tolist()))
