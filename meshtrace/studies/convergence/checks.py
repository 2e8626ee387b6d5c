"""What studies may be asked for, and types that they share."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Normals = Literal["vertex", "facet"]
Unresolved = Literal["tilt", "none"]
Progress = Callable[[int], None]


def falling(name: str, values: Sequence[float]) -> list[float]:
    """Return values from large to small."""
    given = sorted((positive(name, value) for value in values), reverse=True)
    if len(given) < 4 or len(set(given)) < len(given):
        raise ValueError(f"{name}: {list(values)}, allowed at least four different values")
    return given


def kinds_of(normals: Sequence[Normals]) -> tuple[Normals, ...]:
    """Return the kinds of normals, each once."""
    kinds = tuple(dict.fromkeys(normals))
    if not kinds or not set(kinds) <= {"vertex", "facet"}:
        raise ValueError(f"normals: {normals!r}, allowed vertex and facet")
    return kinds


def unresolved_in(name: str) -> Unresolved:
    """Return what is done about slopes that a mesh leaves out; refuse other words."""
    if name not in get_args(Unresolved):
        raise ValueError(f"unresolved: {name!r}, allowed tilt or none")
    return cast(Unresolved, name)


def positive(name: str, value: float) -> float:
    """Return a number that is finite and > 0."""
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name}: {value!r}, allowed finite, > 0")
    return float(value)


def whole(name: str, ratio: float) -> int:
    """Return the integer that a ratio is up to rounding."""
    if abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise ValueError(f"{name}: {ratio:g} half-steps, allowed multiples of the shortest step")
    return round(ratio)
