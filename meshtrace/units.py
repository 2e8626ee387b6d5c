"""Units as files spell them, converted by pint with angle as a separate dimension."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused

_LONGEST = 80  # characters of a unit (tuned: longer than any in use)

_DEFINITIONS = (
    # pint follows SI, where a radian is 1. That hides the factor 2 pi between densities per Hz and
    # per rad/s, the 57.3 between those per radian and per degree, and that m-1 sr-1 is not m-1
    "radian = [angle] = rad",
    "hertz = turn / second = Hz",
    "dBar = decibar",  # as oceanographic instruments spell it
    "practical_salinity_unit = gram / kilogram = psu = PSU",
)

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-", "{}$\\")  # and without signs of TeX
_SPELLINGS = (  # spelling in files, and what pint reads in its place
    (r"º|°", "deg"),
    (r"\bdeg(?:rees?)?[ _]*(?:c|celsius)\b", "degC"),
    (r"\bdeg(?:rees?|s)?[ _]*(?:true|t|north|n|east|e)?\b", "deg"),
    (r"\bhz\b", "Hz"),
    (r"\s+per\s+", "/"),
    (r"[·⋅×∙]|(?<![\d.])\.|\.(?!\d)", " "),  # signs of a product; other dots are decimal points
)
# an exponent of one digit, as in "^2", "**(-1)" and "-1"; a number and a product of units
_POWER = r"\s*(?:\*\*|\^)?\s*\(?\s*([+-]?\d)\s*\)?"
_UNIT = re.compile(
    r"(?:[\d.]+(?:e[+-]?\d{1,2})?(?![\w.]))?"
    rf"(?:[\s*/()]|[^\W\d_][^\W\d]*+(?:{_POWER}(?![\w.]))?|%)*+"  # possessive, for linear time
)

# by the wanted unit, for errors
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
        "" and "1" for numbers without unit.
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
        If the unit is unknown or does not convert to `target`.

    Notes
    -----
    1 Hz = 2 pi rad/s, so that a density per Hz is 2 pi times the density per rad/s. SI allows the
    angle to be left out, and `target` decides what a bare "s" means: Hz-1 if the target has Hz
    (then "m2 s rad-1" is a density per Hz and radian), s rad-1 if it has rad/s.

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
    source, goal = _quantity(unit, field, target), _quantity(target, field, target)
    if angle := _left_out(source, goal):
        source = source * angle
    if source.dimensionality != goal.dimensionality:
        raise _refusal(field, unit, target)
    if goal.dimensionality == _registry().kelvin.dimensionality:  # deg C has an offset
        in_wanted = _registry().Quantity(array * source.m, source.u).m_as(goal.u)
        return np.asarray(in_wanted, np.float64)
    # logarithmic units do not map 0 to 0: no factor converts them
    zero, factor = (
        float(_registry().Quantity(value * source.m, source.u).m_as(goal.u)) for value in (0.0, 1.0)
    )
    if zero != 0.0:  # such as decibels
        raise _refusal(field, unit, target)
    rounded = float(f"{factor:.12g}")  # 1000 rather than the product 999.9999999999999
    is_decimal = abs(rounded - factor) <= 4.0 * np.finfo(float).eps * factor
    return array * (rounded if is_decimal else factor)


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
    """Return whether a text is a unit that `convert` can convert to another one."""
    try:
        convert(0.0, unit, target, "")
    except Refused:
        return False
    return True


def unit_of(value: Any) -> str:
    """Return the unit of a quantity (pint, astropy) or in an array's attributes, "" if none.

    Parameters
    ----------
    value : object
        Of xarray and pandas, the attribute "units" counts, or else "unit".
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
    """Return a quantity (pint, astropy), also from inside an array of xarray; None if neither."""
    for held in (value, getattr(value, "data", None)):
        if not isinstance(held, type) and (hasattr(held, "m_as") or hasattr(held, "to_value")):
            return held
    return None


def _refusal(field: str, unit: str, target: str) -> Refused:
    kind = _KINDS.get(target, f"the kind of {target or '1'}")
    return Refused(field, Described(f"in {unit}" if unit else "without unit"), f"a unit of {kind}")


def _plain(unit: str) -> str:
    """Return a unit in the spelling that pint reads, "1" for none."""
    text = " ".join(unit.translate(_SUPERSCRIPTS).split())
    for spelling, replacement in _SPELLINGS:
        text = re.sub(spelling, replacement, text, flags=re.IGNORECASE)
    if text.strip(" -").lower() in ("", "none", "unitless", "dimensionless"):
        return "1"
    return re.sub(rf"(?<=[^\W\d_])(?<!\d[eE]){_POWER}(?![\w.])", r"**\1", text)


def _quantity(unit: str, field: str, target: str) -> Any:
    """Return a unit as a quantity of pint, or refuse it."""
    text = _plain(unit)
    # pint evaluates expressions, even 9**9**9**9: only products of units are passed to it
    if len(text) > _LONGEST or not _UNIT.fullmatch(text):
        raise _refusal(field, unit, target)
    # words of three letters or more may begin with a capital: Metre, Rad
    for spelling in (text, re.sub(r"[^\W\d_]{3,}", lambda word: word[0].lower(), text)):
        try:
            quantity: Any = _registry().Quantity(spelling)
            quantity.dimensionality  # noqa: B018  # raises an error if there is none
        except Exception:  # pint raises errors of the tokenizer and of arithmetic as well
            continue
        if np.isfinite(quantity.m) and quantity.m > 0.0:
            return quantity
    raise _refusal(field, unit, target)


def _left_out(source: Any, wanted: Any) -> Any:
    """Return the factor of angle that a unit with time leaves out, such as rad in "s-1" for rad/s.

    None if the unit leaves out none, or not only that.
    """
    missing = wanted.dimensionality / source.dimensionality
    has_time = "[time]" in wanted.dimensionality
    # with cycles or Hz of its own, the source leaves out no angle of a frequency
    if not has_time or set(missing) != {"[angle]"} or _cycles(source):
        return None
    power, target_cycles = missing["[angle]"], _cycles(wanted)
    if target_cycles and power != target_cycles:  # "m2 s" without any direction
        return None
    return _registry().Quantity(1.0, "turn" if target_cycles else "rad") ** power


def is_same(unit: str, target: str) -> bool:
    """Return whether two units are the same, in whatever spelling."""
    return is_convertible(unit, target) and float(convert(1.0, unit, target, "")) == 1.0


def cycles(unit: str | None) -> float | None:
    """Return the power of cycles in a unit: 0 for other angles, None without any angle."""
    if unit is None or not is_unit(unit):
        return None
    quantity = _quantity(unit, "", "")
    return _cycles(quantity) if "[angle]" in quantity.dimensionality else None


def _cycles(quantity: Any) -> float:
    """Return the sum of the powers of Hz and of cycles in a quantity's unit."""
    names = ((str(name), power) for name, power in quantity.unit_items())
    return sum(power for name, power in names if name.endswith(("hertz", "turn")))
