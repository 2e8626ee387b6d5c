"""Result of an optimisation: best link, its flatness, history and validation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from meshtrace.fields import attrs
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.stored import Stored
from meshtrace.tables import text_table

if TYPE_CHECKING:
    import xarray as xr


class Validation(NamedTuple):
    """Best link and start over fresh seas, hover errors and chains.

    Attributes
    ----------
    best, start : float
        The quantity of either.
    difference, stderr : float
        Cost of the start minus that of the best, and its standard error: logarithms, or m.
    improved : bool
        Whether the difference is at least two standard errors.
    """

    best: float
    start: float
    difference: float
    stderr: float
    improved: bool


@dataclass(frozen=True, eq=False, repr=False)
class Optimum(Stored):
    """Best link of an optimisation.

    Attributes
    ----------
    best : Link
        The best link.
    objective : str
        "gain", "outage", "range", "margin" or "custom".
    value : float
        The quantity of the best link over the common seas: mean gain, outage, range [m], margin
        [dB]; of "custom" the minimum.
    stderr : float
        Standard error of the value; of an outage that of `cost`.
    cost : float
        What was minimised: -ln(gain), the quantile of -ln(gain / need), -range [m].
    variables : tuple of str
        Names of the variables.
    values, start : ndarray, shape (n,)
        Variables of the best link and of the start.
    bounds, flatness : ndarray, shape (n, 2)
        Bounds, and the interval of each variable in which the cost is within one standard error
        of the best.
    history : ndarray, shape (m, n + 1)
        Variables and cost of all candidates, in their order.
    validation : Validation
        Comparison on fresh seeds.
    notes : tuple of str
        Variables at a bound, and whether there is an improvement.
    provenance : dict
        Versions and configuration.
    """

    best: Link
    objective: str
    value: float
    stderr: float
    cost: float
    variables: tuple[str, ...]
    values: Floats
    start: Floats
    bounds: Floats
    flatness: Floats
    history: Floats
    validation: Validation
    notes: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "optimum"
    title: ClassVar[str] = "meshtrace optimum"

    def _headline(self) -> str:
        shown = ", ".join(
            f"{n} = {v:.4g}" for n, v in zip(self.variables, self.values, strict=True)
        )
        return f"{self.objective} {self.value:.4g} at {shown}"

    def summary(self) -> str:
        """Return variables, values and validation as text for a terminal."""
        head = ("variable", "start", "best", "flat from", "to", "bounds")
        rows = [
            (name, f"{s:.4g}", f"{v:.4g}", f"{f[0]:.4g}", f"{f[1]:.4g}", f"{b[0]:g} .. {b[1]:g}")
            for name, s, v, f, b in zip(
                self.variables, self.start, self.values, self.flatness, self.bounds, strict=True
            )
        ]
        check = self.validation
        gained = f"{check.difference:.3g} +- {check.stderr:.1g}"
        if self.objective in ("gain", "margin", "outage"):
            decibels = 10.0 / math.log(10.0)
            gained = f"{decibels * check.difference:.2f} +- {decibels * check.stderr:.2f} dB"
        lines = [
            f"{self.objective} {self.value:.4g} after {len(self.history)} candidates",
            "",
            text_table(rows, head),
            "",
            f"fresh seeds: best {check.best:.4g}, start {check.start:.4g}, gained {gained}",
            *self.notes,
        ]
        return "\n".join(lines)

    def _content(self) -> xr.Dataset:
        import xarray as xr

        data = {
            "optimum_value": ("variable", self.values),
            "optimum_start": ("variable", self.start),
            "optimum_bounds": (("variable", "end"), self.bounds),
            "optimum_flatness": (("variable", "end"), self.flatness),
            "optimum_history": (("candidate", "variable"), self.history[:, :-1]),
            "optimum_cost": ("candidate", self.history[:, -1]),
            "quantity": ((), self.value),
            "quantity_stderr": ((), self.stderr),
        }
        found = xr.Dataset(data, {"variable": list(self.variables)})
        for name in found.variables:
            found[name].attrs.update(attrs(str(name)))
        return found.assign_attrs(
            objective=self.objective,
            best=self.best.model_dump_json(),
            cost=self.cost,
            notes="\n".join(self.notes),
            **{f"validation_{k}": float(v) for k, v in self.validation._asdict().items()},
        )

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any) -> Optimum:
        best, start, difference, error, improved = (
            float(data.attrs[f"validation_{key}"]) for key in Validation._fields
        )
        return cls(
            best=Link.model_validate_json(data.attrs["best"]),
            objective=data.attrs["objective"],
            value=float(data["quantity"]),
            stderr=float(data["quantity_stderr"]),
            cost=float(data.attrs["cost"]),
            variables=tuple(str(name) for name in data["variable"].values),
            values=data["optimum_value"].values,
            start=data["optimum_start"].values,
            bounds=data["optimum_bounds"].values,
            flatness=data["optimum_flatness"].values,
            history=np.column_stack([data["optimum_history"].values, data["optimum_cost"].values]),
            validation=Validation(best, start, difference, error, bool(improved)),
            notes=tuple(data.attrs["notes"].splitlines()),
            provenance=provenance,
        )
