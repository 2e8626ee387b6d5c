"""Numbers of the explorer as text."""

from __future__ import annotations

import math

BER_FLOOR = 1e-15
"""Bit error rate below which a number says nothing about a device."""

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: ""}


def with_error(value: float, error: float) -> str:
    """Return a number with its error to two digits, as in 5.804 ± 0.012 × 10⁻⁵.

    Examples
    --------
    >>> with_error(5.8047e-05, 8.1e-08)
    '(5.8047 ± 0.0081) × 10⁻⁵'
    >>> with_error(0.0, 0.0)
    '0'
    """
    if value <= 0.0 or not math.isfinite(value):
        return f"{value:g}"
    power = math.floor(math.log10(value))
    value, error = value / 10.0**power, error / 10.0**power
    digits = 4 if error <= 0.0 else min(max(1 - math.floor(math.log10(error)), 0), 6)
    raised = str(power).translate(_RAISED)
    return f"({value:.{digits}f} ± {error:.{digits}f}) × 10{raised}"


def decibels(ratio: float, digits: int = 2) -> str:
    """Return a ratio in decibels.

    Examples
    --------
    >>> decibels(1e-4), decibels(0.0)
    ('−40.00 dB', 'none')
    """
    if ratio <= 0.0:
        return "none"
    return f"{10.0 * math.log10(ratio):.{digits}f} dB".replace("-", "\N{MINUS SIGN}")


def power(watt: float) -> str:
    """Return an optical power with a prefix.

    Examples
    --------
    >>> power(2.5014e-8), power(0.0)
    ('25.01 nW', '0 W')
    """
    if watt <= 0.0:
        return "0 W"
    thousand = max(min(3 * math.floor(math.log10(watt) / 3.0), 0), -15)
    return f"{watt / 10.0**thousand:.4g} {_PREFIXES[thousand]}W"


def rate(per_second: float) -> str:
    """Return a rate of counts.

    Examples
    --------
    >>> rate(1.234e7)
    '1.2e+07 counts/s'
    """
    return f"{per_second:.2g} counts/s"


def bit_error_rate(ber: float) -> str:
    """Return a bit error rate, with a floor.

    Examples
    --------
    >>> bit_error_rate(1.234e-4), bit_error_rate(1e-300)
    ('1.23e-04', '< 1e-15')
    """
    return f"< {BER_FLOOR:g}" if ber < BER_FLOOR else f"{ber:.2e}"
