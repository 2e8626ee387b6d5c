"""Contributions of each chain to apertures at many places of one plane."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.blurred import proposed, weigh_sloped
from meshtrace.kernels.chain_gain import list_paths, weigh
from meshtrace.kernels.crossings import (
    Counter,
    Search,
    find_crossings,
    flat_crossings_of,
    shot_of,
)
from meshtrace.kernels.facets import Roughness
from meshtrace.kernels.jit import ZERO, entry, inlined, outlined
from meshtrace.kernels.scene import Scene, Target, height_on, locate
from meshtrace.kernels.shadow import is_free
from meshtrace.kernels.vectors import Vec3


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
    target = Target(
        center, t.axis, t.e1, t.e2, t.area, t.radius, t.cos_half_fov, t.tan_half_fov, t.reach,
        t.sin_widest, t.is_lamp, t.lamp,
    )  # fmt: skip
    return Scene(
        scene.emitter, target, scene.surface, scene.locator, scene.facets, scene.medium,
        scene.interface, scene.mirrored,
    )  # fmt: skip


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
def _mix(a, b, c, d, u, v):
    return (1.0 - u) * ((1.0 - v) * a + v * b) + u * ((1.0 - v) * c + v * d)


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
    o, f, g, h, k = out[0], f[0], g[0], h[0], k[0]
    o.x = _mix(f.x, g.x, h.x, k.x, u, v)
    o.y = _mix(f.y, g.y, h.y, k.y, u, v)
    o.low = _mix(f.low, g.low, h.low, k.low, u, v)
    o.high = _mix(f.high, g.high, h.high, k.high, u, v)
    o.lever = _mix(f.lever, g.lever, h.lever, k.lever, u, v)
    o.lift = _mix(f.lift, g.lift, h.lift, k.lift, u, v)
    o.m11 = _mix(f.m11, g.m11, h.m11, k.m11, u, v)
    o.m12 = _mix(f.m12, g.m12, h.m12, k.m12, u, v)
    o.m21 = _mix(f.m21, g.m21, h.m21, k.m21, u, v)
    o.m22 = _mix(f.m22, g.m22, h.m22, k.m22, u, v)
    o.h1 = _mix(f.h1, g.h1, h.h1, k.h1, u, v)
    o.h2 = _mix(f.h2, g.h2, h.h2, k.h2, u, v)
    o.branch, o.level = f.branch, f.level
    out[1].branch = 0.0
    return 1


@inlined
def _arrives(chains, i, p, steep, aim, start, scene, room):
    """Return whether no wave cuts off the path of chain i that crosses at p."""
    if steep:
        return True
    n = list_paths(chains, i, aim, p, start, ZERO, scene, room.rays, ZERO)
    for k in range(n):
        r = room.rays[k]
        origin = Vec3(r.origin[0], r.origin[1], r.origin[2])
        way = Vec3(r.direction[0], r.direction[1], r.direction[2])
        if not is_free(origin, way, r.length, scene.surface, scene.locator):
            room.counters[Counter.BLOCKED] += 1
            return False
    return True


@outlined
def _rough_light(chains, i, spread, scene, room):
    """Return the light of chain i through a surface with random slopes."""
    total = 0.0
    for k in range(len(room.flat)):
        flat = room.flat[k]
        if flat.branch == 0.0:
            break
        x, y = proposed(flat, chains.tilt[i, 0], chains.tilt[i, 1], spread, scene)
        facet = locate(scene.locator, scene.surface, x, y)
        if facet < 0:
            continue
        p = Vec3(x, y, height_on(x, y, facet, scene.surface))
        shot = shot_of(chains, i, scene, flat.branch, scene.surface.roughness)
        w, steep, aim = weigh_sloped(chains, i, room.flat, p, facet, shot, spread, scene)
        if w > 0.0 and _arrives(chains, i, p, steep, aim, shot.start, scene, room):
            total += w
    return total


@outlined
def _light(chains, i, audit, search, scene, room):
    """Return the light of chain i through all its crossings."""
    total = 0.0
    for k in range(find_crossings(chains, i, room.flat, audit, search, scene, room)):
        root = room.roots[k]
        shot = shot_of(chains, i, scene, root.branch, scene.surface.roughness)
        p = Vec3(root.x, root.y, height_on(root.x, root.y, root.facet, scene.surface))
        w, steep, aim = weigh(chains, i, p, root.facet, shot, scene)
        if w > 0.0 and _arrives(chains, i, p, steep, aim, shot.start, scene, room):
            total += w * root.multiplicity
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
