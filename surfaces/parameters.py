"""Ranges of the physical parameters, shared by functions and models."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from meshtrace.errors import SMALLEST, Described, Refused, require_between, require_range
from meshtrace.models import Finite as Finite
from meshtrace.models import Floats as Floats
from meshtrace.models import Model
from meshtrace.models import Positive as Positive


def in_range(
    name: str, low: float, high: float = math.inf, unit: str = "", closed: bool = False
) -> Callable[[float], float]:
    """Return a function that refuses all but low < value <= high (low <= value with `closed`)."""
    below, above = "<=" if closed else "<", "<=" if math.isfinite(high) else "<"
    allowed = f"{low:g} {below} {name} {above} {high:g} {unit}".rstrip()
    ends = f"{'[' if closed else '('}{']' if math.isfinite(high) else ')'}"

    def check(value: float) -> float:
        # formulas divide by such numbers, and the squares of the quotients may overflow
        if 0.0 == low < value < SMALLEST and not closed:
            raise Refused(name, value, f"at least {SMALLEST:g} {unit}".rstrip())
        return require_between(value, low, high, name, ends, allowed)

    return check


WindSpeed = Annotated[float, AfterValidator(in_range("wind_speed", 0.0, 60.0, "m/s"))]
Fetch = Annotated[float, AfterValidator(in_range("fetch", 0.0, unit="m"))]
Depth = Annotated[float, AfterValidator(in_range("depth", 0.0, unit="m"))]
Gamma = Annotated[float, AfterValidator(in_range("gamma", 1.0, 20.0, closed=True))]
Alpha = Annotated[float, AfterValidator(in_range("alpha", 0.0))]
Current = tuple[Finite, Finite]
Mss = Literal["cox-munk", "elfouhaily", "band"]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Variances = Annotated[tuple[float, float], Field(ge=0.0)]
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
    allowed = f"{minimum:g} {'<=' if closed else '<'} {name} < inf, all finite"
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
