"""Contributions of each chain to apertures at many places of one plane."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import literal_unroll
from numpy.typing import NDArray

from meshtrace.kernels.aiming import FLAT
from meshtrace.kernels.blurred import sloped_crossing
from meshtrace.kernels.chain_gain import list_paths, weigh
from meshtrace.kernels.crossings import Counter, Search, find_crossings, flat_crossings_of, shot_of
from meshtrace.kernels.facets import Roughness
from meshtrace.kernels.jit import ZERO, entry, inlined, outlined
from meshtrace.kernels.scene import Scene, Target
from meshtrace.kernels.shadow import is_free
from meshtrace.kernels.vectors import Vec3

_MIXED = tuple(name for name in FLAT.names or () if name not in ("branch", "level"))


class Nodes(NamedTuple):
    """Square lattice of places at which the flat crossings of every chain are searched."""

    low: float  # x and y of the first node, from the aperture of the scene [m]
    step: float  # [m]
    n: int  # along each axis


class Way(NamedTuple):
    """Search of crossings of still water."""

    starts: NDArray[np.float64]  # (k, 2) for the aperture of the scene
    shares: NDArray[np.float64]  # (k,) displacement with that of the aperture
    still: Scene
    raised: Scene


class Law(NamedTuple):
    """Search of crossings of the surface, or the law of the proposed ones."""

    search: Search
    spread: Roughness
    blurred: bool


class Room(NamedTuple):
    """Scratch for one chain, and counters."""

    flat: NDArray[np.void]  # FLAT
    starts: NDArray[np.float64]  # (k, 2)
    rays: NDArray[np.void]  # (order + 2,) RAY
    roots: NDArray[np.void]  # ROOT
    counters: NDArray[np.int64]  # by `Counter`
    places: NDArray[np.int64]  # with interpolated and with searched flat crossings


@inlined
def moved(scene, x, y):
    """Return a scene with the aperture displaced in its plane.

    Array twin: `_replace`.
    """
    t = scene.target
    center = Vec3(t.center.x + x, t.center.y + y, t.center.z)
    return Scene(scene.emitter, Target(center, *t[1:]), *scene[2:])


@outlined
def _flat_at(chains, i, x, y, way, scratch, out):
    """Write the flat-sea crossings of chain i to a displaced aperture; return their number."""
    for k in range(len(scratch)):
        scratch[k, 0] = way.starts[k, 0] + way.shares[k] * x
        scratch[k, 1] = way.starts[k, 1] + way.shares[k] * y
    still, raised = moved(way.still, x, y), moved(way.raised, x, y)
    return flat_crossings_of(chains, i, scratch, still, raised, out)


@entry
def node_crossings(chains, nodes, needed, way, room, out):
    """Write the flat-sea crossings of each chain to the needed nodes.

    Array twin: `flat_crossings` of as many apertures.
    """
    for i in range(len(chains.last)):
        for a in range(nodes.n):
            for b in range(nodes.n):
                if needed[a, b]:
                    x, y = nodes.low + a * nodes.step, nodes.low + b * nodes.step
                    _flat_at(chains, i, x, y, way, room.starts, out[i, a, b])


@inlined
def _same(f, g):
    return g[0].branch == f[0].branch and g[1].branch == 0.0 and g[0].level == f[0].level


@inlined
def _mix(f, g, h, k, u, v, out):
    """Write the bilinear interpolant of four flat crossings."""
    for name in literal_unroll(_MIXED):
        low, high = (1.0 - v) * f[name] + v * g[name], (1.0 - v) * h[name] + v * k[name]
        out[name] = (1.0 - u) * low + u * high
    out.branch, out.level = f.branch, f.level


@outlined
def _near_nodes(flats, x, y, nodes, out):
    """Interpolate the flat crossing between nodes; return 1, 0 without any, -1 if they differ."""
    p, q = (x - nodes.low) / nodes.step, (y - nodes.low) / nodes.step
    a = min(max(math.floor(p), 0), nodes.n - 2)
    b = min(max(math.floor(q), 0), nodes.n - 2)
    u, v = p - a, q - b
    f, g, h, k = flats[a, b], flats[a, b + 1], flats[a + 1, b], flats[a + 1, b + 1]
    if f[0].branch == 0.0:
        none = g[0].branch == 0.0 and h[0].branch == 0.0 and k[0].branch == 0.0
        return 0 if none else -1
    if f[1].branch != 0.0 or not (_same(f, g) and _same(f, h) and _same(f, k)):
        return -1
    _mix(f[0], g[0], h[0], k[0], u, v, out[0])
    out[1].branch = 0.0
    return 1


@inlined
def _arrives(chains, i, light, scene, room):
    """Return whether a `Crossing` of chain i brings light, and no wave cuts off its path."""
    if light.steep or not light.weight > 0.0:
        return not light.weight <= 0.0  # a weight that is no number shows in the map
    n = list_paths(chains, i, light, ZERO, scene, room.rays, ZERO)
    for k in range(n):
        r = room.rays[k]
        origin = Vec3(r.origin[0], r.origin[1], r.origin[2])
        way = Vec3(r.direction[0], r.direction[1], r.direction[2])
        if not is_free(origin, way, r.length, scene.surface, scene.locator):
            room.counters[Counter.BLOCKED.value] += 1
            return False
    return True


@outlined
def _rough_light(chains, i, spread, scene, room):
    """Return the light of chain i through a surface with random slopes."""
    total = 0.0
    for k in range(len(room.flat)):
        if room.flat[k].branch == 0.0:
            break
        light = sloped_crossing(chains, i, room.flat, k, spread, scene)
        if _arrives(chains, i, light, scene, room):
            total += light.weight
    return total


@outlined
def _light(chains, i, audit, search, scene, room):
    """Return the light of chain i through all its crossings."""
    total = 0.0
    for k in range(find_crossings(chains, i, room.flat, audit, search, scene, room)):
        root = room.roots[k]
        shot = shot_of(chains, i, scene, root.branch, scene.surface.roughness)
        light = weigh(chains, i, root.x, root.y, root.facet, shot, scene)
        if _arrives(chains, i, light, scene, room):
            total += light.weight * root.multiplicity
    return total


@entry
def cell_scores(chains, audits, shift, flats, nodes, places, way, law, scene, room, score, square):
    """Add the contribution of each chain to apertures at many places.

    Array twin: `contributions` and `blurred_contributions` of as many apertures.
    `score` (shifts, places) adds up the contributions by the shift of the chain, `square` their
    squares. Between nodes whose flat crossings differ in number, branch or level the crossings
    of still water are searched.
    """
    for i in range(len(chains.last)):
        for c in range(len(places)):
            x, y = places[c, 0], places[c, 1]
            n = _near_nodes(flats[i], x, y, nodes, room.flat)
            if n < 0:
                room.places[1] += 1
                n = _flat_at(chains, i, x, y, way, room.starts, room.flat)
            else:
                room.places[0] += n
            if n > 0:
                here = moved(scene, x, y)
                if law.blurred:
                    w = _rough_light(chains, i, law.spread, here, room)
                else:
                    w = _light(chains, i, audits[i], law.search, here, room)
                score[shift[i], c] += w
                square[c] += w * w
