"""One line of a validation: a quantity, its reference, and their difference."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, SupportsFloat

from meshtrace.tables import text_table

if TYPE_CHECKING:
    from meshtrace.results.gain import GainResult

LIMIT = 4.0
"""Largest |z| with which a check passes: 6e-5 of right estimates are beyond."""


@dataclass(frozen=True)
class Check:
    """A quantity beside its reference.

    Parameters
    ----------
    quantity : str
        Quantity compared.
    source : str
        Source of the reference.
    expected, got : float
        Reference, and the value found.
    stderr : float
        Monte Carlo standard error of the difference, 0 for deterministic quantities.
    tolerance : float
        Uncertainty of the reference: its last printed digit, its own standard error, or, for
        deterministic quantities, the claimed accuracy.
    """

    quantity: str
    source: str
    expected: float
    got: float
    stderr: float = 0.0
    tolerance: float = 0.0

    @property
    def z(self) -> float:
        """(got - expected) / hypot(stderr, tolerance), infinite if either is not finite."""
        error = math.hypot(self.stderr, self.tolerance)
        difference = self.got - self.expected
        return difference / error if math.isfinite(difference) and error > 0.0 else math.inf

    @property
    def passed(self) -> bool:
        """True if |z| <= LIMIT."""
        return abs(self.z) <= LIMIT

    def as_data(self) -> dict[str, Any]:
        """Return the check as plain data."""
        return {**asdict(self), "z": self.z, "passed": self.passed}


def half_digit(printed: str) -> float:
    """Return half a unit of the last digit of a published number.

    Parameters
    ----------
    printed : str
        Number as printed, as in "0.09739" or "1.07e-3".

    Returns
    -------
    float

    Examples
    --------
    >>> half_digit("1.07e-3")
    5e-06
    """
    mantissa, _, exponent = printed.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(f"5e{int(exponent or 0) - decimals - 1}")


def printed(quantity: str, source: str, text: str, got: float, stderr: float = 0.0) -> Check:
    """Return the check of a value against a published number, good to half of its last digit."""
    return Check(quantity, source, float(text), float(got), stderr, half_digit(text))


def exact(quantity: str, source: str, expected: float, got: SupportsFloat, rtol: float) -> Check:
    """Return the check of a deterministic value against a reference of a relative accuracy."""
    return Check(quantity, source, expected, float(got), tolerance=rtol * expected)


def simulated(
    quantity: str, source: str, expected: float, result: GainResult, tolerance: float = 0.0
) -> Check:
    """Return the check of a simulated gain against a reference."""
    gain, stderr = float(result.gain), float(result.gain_stderr)
    return Check(quantity, source, expected, gain, stderr, tolerance)


def format_table(checks: Iterable[Check]) -> str:
    """Return checks as a table in text; `|z| > 4` is marked.

    Parameters
    ----------
    checks : iterable of Check
        Rows of the table.

    Returns
    -------
    str
    """
    head = ("quantity", "source", "expected", "got", "std. error", "tolerance", "z")
    return text_table(map(_row, checks), head)


def _row(check: Check) -> tuple[str, ...]:
    mark = "" if check.passed else "  FAILED"
    return (
        check.quantity,
        check.source,
        f"{check.expected:.6g}",
        f"{check.got:.6g}",
        f"{check.stderr:.1e}" if check.stderr else "-",
        f"{check.tolerance:.1e}" if check.tolerance else "-",
        f"{check.z:+.2f}{mark}",
    )
