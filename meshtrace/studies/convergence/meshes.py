"""Meshes of a study, nested or moved by parts of a cell; types and checks of all studies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, cast

import numpy as np

from meshtrace.errors import Refused, require_array, require_between, require_names
from meshtrace.models import Floats
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import mesh_for

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import SurfaceModel, TriangleMesh

_MARGIN = 2.0  # [m], mesh beyond the farthest crossing to the receiver
_PROBES = 64  # per axis: where slopes are compared

Normals = Literal["vertex", "facet"]
Unresolved = Literal["tilt", "none"]
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


def nested_mesh(
    link: Link, sea: SurfaceModel, time: float, spacing: float, shift: Floats
) -> TriangleMesh:
    """Return a uniform mesh over all crossings, `shift` in periods of its triangles off the origin.

    Without a shift the lines lie at the multiples of the spacing, so that they nest when it halves.
    """
    cells = math.ceil((crossing_reach(link) + _MARGIN) / spacing) + 1
    x, y = 2.0 * spacing * shift
    mesh = sea.mesh(time, cells * spacing, spacing, center=(float(x), float(y)))
    return mesh_for(link, mesh)[0]  # refuses one that does not suit the link


def crest_of(link: Link, sea: SurfaceModel, time: float) -> float:
    """Return the approximate height [m] of the sea in the region of the crossings."""
    return float(nested_mesh(link, sea, time, 0.5, np.zeros(2)).bounds[1, 2])


def probes(reach: float) -> tuple[Floats, Floats]:
    """Return the points (x, y) for the comparison of slopes."""
    axis = reach * ((2.0 * np.arange(_PROBES) + 1.0) / _PROBES - 1.0)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return x.ravel(), y.ravel()


def placement_shifts(n: int) -> Floats:
    """Return shifts of a mesh in periods of its triangles (two cells), (n, 2): a lattice.

    The diagonals alternate: a shift by one cell along both axes gives the same triangles, so
    that the lattice fills half a square of two cells.
    """
    if n == 1:
        return np.zeros((1, 2))
    step = next(a for a in range(round(n / 1.618), n + 1) if math.gcd(a, n) == 1)
    k = np.arange(n)
    along, across = (k + 0.5) / n, (step * k / n + 0.5 / n) % 1.0
    return 0.5 * np.stack([along + across - 1.0, along - across], axis=1)
