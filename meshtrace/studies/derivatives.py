"""Sensitivities of a link's quantity: their table, forecasts and covariance, with errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple, overload

import numpy as np

from meshtrace.errors import Refused, require_keys
from meshtrace.models import Floats
from meshtrace.stored import Columns, Stored, Variable
from meshtrace.studies.neighbours import DECIBELS
from meshtrace.tables import text_table

_MOST_FORECAST = 0.3  # tuned: |change of ln p, or of ln q| up to which the first order may be used


class Value(NamedTuple):
    """A number with its standard error."""

    value: float
    stderr: float


@dataclass(frozen=True)
class Row:
    """Sensitivity to one parameter.

    Attributes
    ----------
    name : str
        Parameter, a key of a link file.
    base : float
        Its value.
    unit : str
        Its unit.
    elasticity : float
        d ln q / d ln p of the quantity q; of a margin that of the power ratio. For the indices of
        the phase function p is n - 1 and mu - 3. nan for an offset or an angle whose base is 0.
    stderr : float
        Standard error of the elasticity, or of `relative` where that is nan.
    relative : float
        (dq / dp) / q [1 / unit]; of a margin that of the power ratio.
    derivative, derivative_stderr : float
        dq / dp and its standard error.
    second : float
        (d^2 q / dp^2) / q of offsets and angles [1 / unit^2], else nan.
    method : {"moment", "difference", "angle"}
        Estimator.
    suspicious : bool
        Whether a difference over thrice the step disagrees.
    notes : str
        Remarks.
    """

    name: str
    base: float
    unit: str
    elasticity: float
    stderr: float
    relative: float
    derivative: float
    derivative_stderr: float
    second: float
    method: str
    suspicious: bool
    notes: str

    def __getitem__(self, key: str) -> Any:
        return getattr(self, key)

    @property
    def log(self) -> float:
        """Logarithmic derivative: the elasticity, or `relative` if the elasticity is nan."""
        return self.relative if math.isnan(self.elasticity) else self.elasticity


class Table(tuple[Row, ...]):
    """Rows, by number or by the name of the parameter."""

    @overload  # type: ignore[override]
    def __getitem__(self, key: int | str) -> Row: ...
    @overload
    def __getitem__(self, key: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, key: Any) -> Any:
        """Return a row by its number or by the name of its parameter."""
        if not isinstance(key, str):
            return super().__getitem__(key)
        names = [row.name for row in self]
        if key not in names:
            raise Refused("wrt", key, ", ".join(names))
        return super().__getitem__(names.index(key))


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivities(Stored, kind="sensitivity", title="meshtrace sensitivities"):
    """Sensitivities of a quantity of a link.

    Attributes
    ----------
    quantity : str
        "gain", "ber", "outage", "range", "margin" or "capacity".
    value, stderr : float
        The quantity and its standard error, from the spread over chains and seas.
    unit : str
        Its unit.
    table : Table
        One `Row` a parameter, by number or name.
    logs : ndarray, shape (n, n)
        Covariance of the logarithmic derivatives: of `elasticity`, or `relative` where that
        is nan.
    provenance : dict
        Versions and configuration.
    background_light : str
        Light of error rates, outages, ranges and margins; empty for the gain.
    """

    quantity: str
    value: Annotated[float, Variable(name="quantity")]
    stderr: Annotated[float, Variable(name="quantity_stderr")]
    unit: str
    table: Annotated[Table, Columns(Row, "sensitivity", "parameter")]
    logs: Annotated[Floats, Variable("parameter", "parameter_too", name="sensitivity_covariance")]
    provenance: dict[str, Any] = field(default_factory=dict)
    background_light: str = ""

    def _headline(self) -> str:
        largest = max(self.table, key=lambda row: abs(np.nan_to_num(row.elasticity)))
        shown = f"{self.value:.4g} {self.unit}".removesuffix(" 1")
        return (
            f"{self.quantity} {shown}, most sensitive to {largest.name} ({largest.elasticity:.3g})"
        )

    def summary(self) -> str:
        """Return the table as text for a terminal."""
        shown = f"{self.value:.5g} +- {self.stderr:.1g} {self.unit}".removesuffix(" 1")
        head = ("parameter", "base", "unit", "elasticity", "std. error", "derivative", "method")
        table = [
            (
                row.name,
                f"{row.base:g}",
                row.unit,
                "-" if math.isnan(row.elasticity) else f"{row.elasticity:.5f}",
                f"{row.stderr:.1e}",
                f"{row.derivative:.4g}",
                row.method + (" (suspicious)" if row.suspicious else ""),
            )
            for row in self.table
        ]
        notes = [f"{row.name}: {row.notes}" for row in self.table if row.notes]
        lines = [f"background light: {self.background_light}"] if self.background_light else []
        return "\n".join([f"{self.quantity} {shown}", "", text_table(table, head), *notes, *lines])

    def derivative(self, name: str) -> Value:
        """Return d quantity / d parameter with its standard error, in their units."""
        row = self.table[name]
        return Value(row.derivative, row.derivative_stderr)

    def covariance(self) -> Floats:
        """Return the covariance of the derivatives in the order of the table, shape (n, n).

        They are correlated, as all come from the same chains and seas.
        """
        # a derivative is its logarithmic derivative times a factor that has no error
        factor = [row.derivative / row.log if row.log != 0.0 else 0.0 for row in self.table]
        return self.logs * np.outer(factor, factor)

    def predict(self, changes: Mapping[str, float]) -> Value:
        """Return a first-order forecast of the quantity for other values of parameters.

        ln q' = ln q + sum E ln(p' / p), and q' = q + sum (dq / dp) (p' - p) for margin and range

        Parameters
        ----------
        changes : mapping of str to float
            New values by parameter, such as {"water.a": 0.12}. An offset or an angle whose base
            is 0 acts by its second derivative, too.

        Returns
        -------
        Value
            With the standard error of the change joined to that of the quantity.

        Raises
        ------
        Refused
            If a parameter is not in the table or changes by more than |ln(p' / p)| = 0.3.
        """
        require_keys(changes, [row.name for row in self.table])
        # steps in ln p, or in p of offsets and angles; 0 for parameters that do not change
        steps, second_order = np.zeros(len(self.table)), 0.0
        for i, row in enumerate(self.table):
            if row.name in changes:
                steps[i], bend = _step(row, changes[row.name])
                second_order += bend
        # change of ln q and its standard error sigma
        change = float(steps @ np.array([row.log for row in self.table])) + second_order
        sigma = math.sqrt(steps @ self.logs @ steps)
        if self.quantity == "margin":  # in dB it is a logarithm already
            error = math.hypot(self.stderr, DECIBELS * sigma)
            return Value(self.value + DECIBELS * change, error)
        if self.quantity == "range":
            return Value(self.value * (1.0 + change), math.hypot(self.stderr, self.value * sigma))
        value = self.value * math.exp(change)
        return Value(value, value * math.hypot(self.stderr / self.value, sigma))


def _step(row: Row, value: float) -> tuple[float, float]:
    """Return the step in p or ln p, and the second-order part of the change of ln q.

    The step multiplies `Row.log`. Too large a change is refused.
    """
    if math.isnan(row.elasticity):
        step = value - row.base
        bend = 0.5 * np.nan_to_num(row.second) * step**2
        # "not <=" refuses nan, too
        if not abs(row.relative * step + bend) <= _MOST_FORECAST:
            raise Refused(row.name, value, f"a change of the logarithm up to {_MOST_FORECAST:g}")
        return step, float(bend)
    # p of an elasticity may be measured from an origin (`Parameter.origin`): n - 1 of the particles
    scale = row.elasticity / row.relative if row.relative != 0.0 else row.base
    ratio = 1.0 + (value - row.base) / scale
    if not ratio > 0.0 or abs(math.log(ratio)) > _MOST_FORECAST:
        low, high = (row.base + scale * math.expm1(s * _MOST_FORECAST) for s in (-1.0, 1.0))
        raise Refused(row.name, value, f"{low:.4g} <= {row.name} <= {high:.4g}")
    return math.log(ratio), 0.0
