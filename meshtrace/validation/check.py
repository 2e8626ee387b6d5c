"""One line of a validation: a quantity, its reference, and their difference."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, SupportsFloat

from meshtrace.tables import text_table

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
        Uncertainty of the reference, or, for deterministic quantities, the claimed accuracy.
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


def exact(quantity: str, source: str, expected: float, got: SupportsFloat, rtol: float) -> Check:
    """Return the check of a deterministic value against a reference of a relative accuracy."""
    return Check(quantity, source, expected, float(got), tolerance=rtol * expected)


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
