"""Units of other people's files, converted by pint with the angle as a dimension of its own."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused

_LONGEST = 80  # characters of a unit: no text of an honest file is longer

_DEFINITIONS = (
    # SI counts radians as 1, which hides the 2 pi between densities per Hz and per rad/s, the 57.3
    # between those per degree and per radian, and the difference of m-1 sr-1 from m-1
    "radian = [angle] = rad",
    "hertz = turn / second = Hz",
    "dBar = decibar",
    "practical_salinity_unit = gram / kilogram = psu = PSU",
)

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-", "{}$\\")
_SPELLINGS = (  # as files have them, and as pint reads them
    (r"º|°", "deg"),
    (r"\bdeg(?:rees?)?[ _]*(?:c|celsius)\b", "degC"),
    (r"\bdeg(?:rees?|s)?[ _]*(?:true|t|north|n|east|e)?\b", "deg"),
    (r"\bhz\b", "Hz"),
    (r"\s+per\s+", "/"),
    (r"[·⋅×∙]|(?<![\d.])\.|\.(?!\d)", " "),
)
_POWER = r"\s*(?:\*\*|\^)?\s*\(?\s*([+-]?\d)\s*\)?"
_UNIT = re.compile(
    r"(?:[\d.]+(?:e[+-]?\d{1,2})?(?![\w.]))?"
    rf"(?:[\s*/()]|[^\W\d_][^\W\d]*+(?:{_POWER}(?![\w.]))?|%)*+"  # in linear time
)

_KINDS = {
    "m": "length, such as m, cm or mm",
    "nm": "length, such as nm, um or m",
    "s": "time, such as s or min",
    "rad": "an angle, such as rad or deg",
    "deg": "an angle, such as deg or rad",
    "Hz": "frequency, such as Hz or rad/s",
    "rad s-1": "frequency, such as rad/s or Hz",
    "m-1": "a coefficient, such as m-1 or cm-1",
    "m-1 sr-1": "a volume scattering function, such as m-1 sr-1",
    "m2 Hz-1": "a density over frequency, such as m2/Hz or m2 s rad-1",
    "m2 s rad-1": "a density over frequency, such as m2 s rad-1 or m2/Hz",
    "m2 Hz-1 deg-1": "a density over frequency and direction, such as m2/Hz/deg or m2/Hz/rad",
    "1": "a ratio, such as 1 or %",
}


@functools.cache
def _registry() -> Any:
    import pint

    units: Any = pint.UnitRegistry(None, on_redefinition="ignore")
    units.load_definitions(Path(pint.__file__).parent / "default_en.txt")
    for definition in _DEFINITIONS:
        units.define(definition)
    return units


def convert(values: ArrayLike, unit: str, target: str, field: str) -> NDArray[np.float64]:
    """Return values in another unit.

    Parameters
    ----------
    values : array_like
        Values in `unit`, any shape.
    unit : str
        Unit as files spell it: "m2 s rad-1", "m^2/Hz", "cm2 s degree-1", "m² Hz⁻¹", "%", "degT";
        "" and "1" are without unit.
    target : str
        Wanted unit, in the same spellings.
    field : str
        Name of the values, for the error.

    Returns
    -------
    ndarray of float64

    Raises
    ------
    Refused
        If the unit is unknown or of another kind.

    Notes
    -----
    1 Hz = 2 pi rad/s, so that a density per Hz is 2 pi times that per rad/s. A bare "s" beside a
    target in Hz is Hz-1 ("m2 s rad-1" is a density per Hz and radian, as SI allows), beside a
    target in rad/s s rad-1.

    Examples
    --------
    >>> convert([1.0, 2.0], "cm", "m", "eta").round(6).tolist()
    [0.01, 0.02]
    >>> round(float(convert(1.0, "m2/Hz", "m2 s rad-1", "density")), 6)
    0.159155
    """
    array = np.asarray(values, np.float64)
    if _plain(unit) == _plain(target):
        return array
    source, wanted = _quantity(unit, field, target), _quantity(target, field, target)
    if angle := _left_out(source, wanted):
        source = source * angle
    if source.dimensionality != wanted.dimensionality:
        raise _refusal(field, unit, target)
    if wanted.dimensionality == _registry().kelvin.dimensionality:  # has offsets
        in_wanted = _registry().Quantity(array * source.m, source.u).m_as(wanted.u)
        return np.asarray(in_wanted, np.float64)
    # a unit with an offset or of a logarithm maps 0 elsewhere: no factor converts it
    zero, factor = (
        float(_registry().Quantity(value * source.m, source.u).m_as(wanted.u))
        for value in (0.0, 1.0)
    )
    if zero != 0.0:  # decibels
        raise _refusal(field, unit, target)
    decimal = float(f"{factor:.12g}")  # 1000 rather than the product 999.9999999999999
    exact = abs(decimal - factor) <= 4.0 * np.finfo(float).eps * factor
    return array * (decimal if exact else factor)


@functools.lru_cache(maxsize=1024)
def is_unit(text: str) -> bool:
    """Return whether a text is a unit of any kind."""
    try:
        _quantity(text, "", "")
    except Refused:
        return False
    return True


@functools.lru_cache(maxsize=1024)
def is_convertible(unit: str, target: str) -> bool:
    """Return whether a text is a unit that converts to another one."""
    try:
        convert(0.0, unit, target, "")
    except Refused:
        return False
    return True


def unit_of(value: Any) -> str:
    """Return the unit of a quantity (pint, astropy) or in the attributes of an array, "" if none.

    Parameters
    ----------
    value : object
        Attributes are those of xarray and pandas: "units", or else "unit".
    """
    quantity = _quantity_in(value)
    if quantity is not None:
        return str(quantity.units if hasattr(quantity, "m_as") else quantity.unit) or "1"
    attributes = getattr(value, "attrs", None)
    if not isinstance(attributes, Mapping):
        return ""
    unit = attributes.get("units", attributes.get("unit", ""))
    unit = unit.decode("latin-1") if isinstance(unit, bytes) else str(unit)
    return "" if unit.strip().lower() in ("", "none", "unknown", "unk") else unit.strip()


def without_unit(value: Any) -> Any:
    """Return the numbers of a quantity; other values are returned unchanged."""
    quantity = _quantity_in(value)
    if quantity is None:
        return value
    return quantity.magnitude if hasattr(quantity, "m_as") else quantity.value


def _quantity_in(value: Any) -> Any:
    """Return the quantity that a value is, or that an array of xarray holds; None without one."""
    for part in (value, getattr(value, "data", None)):
        if not isinstance(part, type) and (hasattr(part, "m_as") or hasattr(part, "to_value")):
            return part
    return None


def _refusal(field: str, unit: str, target: str) -> Refused:
    kind = _KINDS.get(target, f"the kind of {target or '1'}")
    return Refused(field, Described(f"in {unit}" if unit else "without unit"), f"a unit of {kind}")


def _plain(unit: str) -> str:
    """Return a unit with the powers and products of pint."""
    text = " ".join(unit.translate(_SUPERSCRIPTS).split())
    for spelling, replacement in _SPELLINGS:
        text = re.sub(spelling, replacement, text, flags=re.IGNORECASE)
    if text.strip(" -").lower() in ("", "none", "unitless", "dimensionless"):
        return "1"
    return re.sub(rf"(?<=[^\W\d_])(?<!\d[eE]){_POWER}(?![\w.])", r"**\1", text)


def _quantity(unit: str, field: str, target: str) -> Any:
    """Return a unit as a quantity of pint, or refuse it."""
    text = _plain(unit)
    # pint evaluates what it reads, powers of powers included
    if len(text) > _LONGEST or not _UNIT.fullmatch(text):
        raise _refusal(field, unit, target)
    # words of three letters or more may begin with a capital: Metre, Rad
    for spelled in (text, re.sub(r"[^\W\d_]{3,}", lambda word: word[0].lower(), text)):
        try:
            quantity: Any = _registry().Quantity(spelled)
            quantity.dimensionality  # noqa: B018
        except Exception:  # pint raises errors of the tokenizer and of arithmetic as well
            continue
        if np.isfinite(quantity.m) and quantity.m > 0.0:
            return quantity
    raise _refusal(field, unit, target)


def _left_out(source: Any, wanted: Any) -> Any:
    """Return the power of the angle that a unit beside seconds leaves out; None if it has all."""
    lacking = wanted.dimensionality / source.dimensionality
    timed = "[time]" in wanted.dimensionality
    if not timed or set(lacking) != {"[angle]"} or _cycles(source):
        return None
    power, cycles = lacking["[angle]"], _cycles(wanted)
    if cycles and power != cycles:  # "m2 s" without any direction
        return None
    return _registry().Quantity(1.0, "turn" if cycles else "rad") ** power


def is_same(unit: str, target: str) -> bool:
    """Return whether values in a unit are those in another one."""
    return is_convertible(unit, target) and float(convert(1.0, unit, target, "")) == 1.0


def cycles(unit: str | None) -> float | None:
    """Return the power of cycles in a unit, 0 for one in radians or degrees; None without angle."""
    if unit is None or not is_unit(unit):
        return None
    quantity = _quantity(unit, "", "")
    return _cycles(quantity) if "[angle]" in quantity.dimensionality else None


def _cycles(quantity: Any) -> float:
    """Return the power of Hz and of cycles in a unit."""
    names = ((str(name), power) for name, power in quantity.unit_items())
    return sum(power for name, power in names if name.endswith(("hertz", "turn")))
