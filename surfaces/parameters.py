"""Ranges of the physical parameters, shared by functions and models."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from meshtrace.errors import SMALLEST, Described, Refused, require_between, require_range
from meshtrace.models import Finite as Finite
from meshtrace.models import Floats as Floats
from meshtrace.models import Model
from meshtrace.models import Positive as Positive


class Range(NamedTuple):
    """An interval low < value <= high (low <= value with `closed`) with a name and a unit."""

    name: str
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    closed: bool = False

    def check(self, value: float) -> float:
        """Return `value` unchanged; raise `Refused` outside of the interval."""
        # formulas divide by such numbers, and the squares of the quotients may overflow
        if 0.0 == self.low < value < SMALLEST and not self.closed:
            raise Refused(self.name, value, f"at least {SMALLEST:g} {self.unit}".rstrip())
        ends = f"{'[' if self.closed else '('}{']' if math.isfinite(self.high) else ')'}"
        require_between(value, self.low, self.high, self.name, ends, str(self))
        return value

    def __str__(self) -> str:
        """Return the interval as text, such as `0 < wind_speed <= 60 m/s`."""
        below = "<=" if self.closed else "<"
        above = "<=" if math.isfinite(self.high) else "<"
        return f"{self.low:g} {below} {self.name} {above} {self.high:g} {self.unit}".rstrip()


WIND_SPEED = Range("wind_speed", 0.0, 60.0, "m/s")
FETCH = Range("fetch", 0.0, unit="m")
DEPTH = Range("depth", 0.0, unit="m")
GAMMA = Range("gamma", 1.0, 20.0, closed=True)
ALPHA = Range("alpha", 0.0)
TIME = Range("time", unit="s")

WindSpeed = Annotated[float, AfterValidator(WIND_SPEED.check)]
Fetch = Annotated[float, AfterValidator(FETCH.check)]
Depth = Annotated[float, AfterValidator(DEPTH.check)]
Gamma = Annotated[float, AfterValidator(GAMMA.check)]
Alpha = Annotated[float, AfterValidator(ALPHA.check)]
Current = tuple[Finite, Finite]
Mss = Literal["cox-munk", "elfouhaily", "band"]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Variances = tuple[float, float]
"""Slope variances along and across the wind."""


def named_or_given(
    kind: type[Model], names: tuple[str, ...], field: str, value: Any, *, more: str = ""
) -> Any:
    """Validate a name, a model or plain data; `more` names further allowed values."""
    if isinstance(value, kind) or (isinstance(value, str) and value in names):
        return value
    if isinstance(value, Mapping):
        return kind.model_validate(value)
    raise Refused(field, value, f"{', '.join(names)}{more} or a {kind.__name__}")


def finite_array(name: str, value: ArrayLike, minimum: float = -math.inf) -> Floats:
    """Return `value` as float64; raise `Refused` if not finite or below `minimum`."""
    closed = minimum > -math.inf
    allowed = f"{Range(name, minimum, closed=closed)}, all finite"
    return require_range(value, minimum, math.inf, name, "[)" if closed else "()", allowed)


def grid_lines(x_axis: ArrayLike, y_axis: ArrayLike) -> tuple[Floats, Floats]:
    """Return the lines of a tensor grid as float64, one or more along each axis."""
    axes = {"x_axis": finite_array("x_axis", x_axis), "y_axis": finite_array("y_axis", y_axis)}
    for name, axis in axes.items():
        if axis.ndim > 1 or not axis.size:
            raise Refused(name, Described(f"shape {axis.shape}"), "grid lines (n,), one or more")
    x, y = map(np.atleast_1d, axes.values())
    return x, y


def points(x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Return the broadcast coordinates of points as float64; raise `Refused` for unequal shapes."""
    arrays = finite_array("x", x), finite_array("y", y)
    try:
        px, py = np.broadcast_arrays(*arrays)
    except ValueError as error:
        shapes = Described(f"shape {arrays[1].shape}")
        raise Refused("y", shapes, f"one that fits that of x, {arrays[0].shape}") from error
    return px, py
