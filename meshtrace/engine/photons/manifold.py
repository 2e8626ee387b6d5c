"""Manifold next-event estimation: crossings of smooth waves that join two points.

Without random slopes the light of a point in the water reaches a point of an aperture only where
the mesh refracts it there. Newton from the crossing of still water finds one such crossing [1]_.
Others are found from a start drawn about it [2]_: a crossing r that is drawn so with the chance
p(r) counts 1 / p(r), the mean number of further draws up to that which finds r again. So all
crossings are counted, at the cost of one draw more than there are crossings. With faceted normals
all facets are searched, as those of scattering chains (`meshtrace.engine.crossing`).

References
----------
.. [1] J. Hanika, M. Droske and L. Fascione, "Manifold next event estimation", Computer Graphics
   Forum 34 (2015), doi:10.1111/cgf.12681.
.. [2] T. Zeltner, I. Georgiev and W. Jakob, "Specular manifold sampling for rendering
   high-frequency caustics and glints", ACM Transactions on Graphics 39 (2020),
   doi:10.1145/3386569.3392408, section 4.1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.kernels.interface import MeshArrays
from meshtrace.kernels.jit import ONE, ZERO, inlined, outlined
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.scene import Scene
from meshtrace.kernels.vectors import on_circle


class Manifold(NamedTuple):
    """Search for crossings with the buffers of one thread."""

    search: crossing.Search  # for targets without bounds
    flat: NDArray[np.void]  # (1,) FLAT
    roots: NDArray[np.void]  # ROOT


class Drawn(NamedTuple):
    """Random numbers of one event, and the widths of the law of starts [m]."""

    seed: np.uint64
    photon: int
    event: int
    along: float
    across: float


_SAME = 3e-4  # [m], distance of two results of Newton for one crossing
_MOST_TRIALS = 100_000
_CLOSE = 1.0  # depths over the size of the facets up to which each is searched
_STREAMS = 64  # purposes between those of two trials


@outlined
def crossings_between(still, shot, drawn, scene, manifold):
    """Write the crossings from the start of a shot to its goal (`roots`); return their number.

    Array twin: `crossing.enumerate_roots`, which searches every facet.
    `still` is the crossing of still water, at the height of the waves over a start near them.
    """
    surface, target = scene.surface, scene.target
    side = math.hypot(still.x - shot.start.x, still.y - shot.start.y)
    move = crossing.MARGIN * surface.max_slope * max(still.along, still.across)
    move += (
        crossing.MARGIN * (surface.high[2] - surface.low[2]) * side / still.depth
        + manifold.search.margin
    )
    if math.hypot(still.x - target.center.x, still.y - target.center.y) > target.reach + move:
        return ZERO  # outside the field of view for any waves
    if not surface.interpolate:
        return _on_all_facets(still, shot, scene, manifold)
    step = drawn.along + drawn.across
    found, x, y, facet = crossing.root_from(still.x, still.y, step, shot, scene)
    n = ZERO
    if found:
        n = _append(n, x, y, facet, 1.0, shot, manifold)
    found, rx, ry, facet = _trial(ZERO, still, step, shot, drawn, scene)
    if not found or (n == 1 and _is_same(rx, ry, x, y)):
        return n
    trials, again = ONE, False
    while not again and trials < _MOST_TRIALS:
        again, x, y, _ = _trial(trials, still, step, shot, drawn, scene)
        again = again and _is_same(rx, ry, x, y)
        trials += 1
    return _append(n, rx, ry, facet, float(trials - 1), shot, manifold)


@inlined
def _is_same(x, y, other_x, other_y):
    return abs(x - other_x) + abs(y - other_y) < _SAME


@inlined
def _append(n, x, y, facet, multiplicity, shot, manifold):
    root = manifold.roots[n]
    root.x, root.y, root.facet = x, y, facet
    root.branch, root.multiplicity = shot.branch, multiplicity
    return n + 1


@outlined
def _trial(k, still, step, shot, drawn, scene):
    """Return (found, x, y, facet) from a drawn start.

    Starts have a Student law of four degrees of freedom: far crossings are not too rare.
    """
    purpose = Purpose.TRIAL.value + _STREAMS * k
    u, v, _, _ = uniforms(drawn.seed, drawn.photon, drawn.event, purpose)
    r = 2.0 * math.sqrt(1.0 / math.sqrt(u) - 1.0)
    c, s = on_circle(v)
    a, b = r * c * drawn.along, r * s * drawn.across
    x, y = still.x + a * still.ux - b * still.uy, still.y + a * still.uy + b * still.ux
    return crossing.root_from(x, y, step, shot, scene)


@outlined
def _on_all_facets(still, shot, scene, manifold):
    """Write the crossings on all facets near the flat-sea crossing; return their number."""
    search, flat = manifold.search, manifold.flat[0]
    crossing.flat_crossing(flat, still.x, still.y, shot, _raised(shot.start.z + still.depth, scene))
    if flat.low <= 0.0:
        return ZERO
    bounded = crossing.Search(
        search.audit, search.slope, search.margin, scene.target.reach + search.widest,
        search.curvature,
    )  # fmt: skip
    radius = crossing.radius_of(flat, bounded, shot, scene)
    close = still.depth <= _CLOSE * search.margin
    return crossing.enumerate_roots(manifold.roots, ZERO, flat, radius, close, shot, scene)


@inlined
def _raised(level, scene):
    """Return a scene whose flat sea has another height."""
    s = scene.surface
    surface = MeshArrays(
        s.vertices, s.faces, s.face_normals, s.vertex_normals, s.low, s.high, s.max_slope,
        s.interpolate, s.roughness, level,
    )  # fmt: skip
    return Scene(
        scene.emitter, scene.target, surface, scene.locator, scene.facets, scene.medium,
        scene.interface, scene.mirrored,
    )  # fmt: skip
