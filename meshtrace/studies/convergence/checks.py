"""Types and checks that the studies share."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, cast

from meshtrace.errors import Refused, require_array, require_between, require_names
from meshtrace.models import Floats

Normals = Literal["vertex", "facet"]
Unresolved = Literal["tilt", "none"]
Progress = Callable[[int], None]
Parameter = Literal["spacing", "time_step", "omega_max"]

UNITS: dict[Parameter, str] = {"spacing": "m", "time_step": "s", "omega_max": "rad s-1"}


class Costs(NamedTuple):
    """Seconds that one surface took, by kind of normals and step."""

    mesh: Floats
    bvh: Floats
    evaluation: Floats


def descending(name: str, values: Sequence[float]) -> list[float]:
    """Return at least four different positive values from large to small."""
    allowed = "at least four different values"
    numbers = require_array(values, name, allowed)
    if numbers.ndim != 1:
        raise Refused(name, values, allowed)
    given = sorted((positive(name, value) for value in numbers.tolist()), reverse=True)
    if len(given) < 4 or len(set(given)) < len(given):
        raise Refused(name, numbers.tolist(), allowed)
    return given


def normal_kinds(normals: Sequence[Normals]) -> tuple[Normals, ...]:
    """Return the kinds of normals, each once."""
    kinds = tuple(dict.fromkeys(require_names(normals, "normals")))
    if not kinds or not set(kinds) <= {"vertex", "facet"}:
        raise Refused("normals", normals, "vertex and facet")
    return cast(tuple[Normals, ...], kinds)


def positive(name: str, value: float) -> float:
    """Return a number that is finite and > 0."""
    return require_between(value, 0.0, math.inf, name)


def multiple_of(name: str, ratio: float) -> int:
    """Return the integer that a ratio equals up to rounding."""
    if abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise Refused(name, f"{ratio:g} half-steps", "multiples of the shortest step")
    return round(ratio)
