"""Forced detection: crossings of each chain over one surface, and its contribution to the aperture.

Newton starts from the crossings of a flat sea, which do not depend on the waves. An audit searches
every facet for all crossings near that of a flat sea that land on one point.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.kernels.interface import SMOOTH, normal_at, over_gaussian, slope_tilt
from meshtrace.kernels.jit import NO, YES, ZERO, entry, inlined, outlined
from meshtrace.kernels.medium import (
    absorption_path,
    bubble_scattering,
    is_uniform,
    scattering_path,
    water_coefficients,
)
from meshtrace.kernels.scene import FLAT_SEA, height_on
from meshtrace.kernels.sources import intensity
from meshtrace.kernels.vectors import UP, Vec2, Vec3, along, dot, minus, norm, plus, row, write

_FOCUSING = 0.5  # change of the landing point by curvature, over that by the way, that is much
_AUDIT_FAILED = 0.25  # share of chains without a solution whose facets are all searched

RAY = np.dtype(
    [
        ("crossing", np.int64),  # row of `Output.doubtful`
        ("origin", float, (3,)),
        ("direction", float, (3,)),
        ("length", float),
    ]
)
"""A straight part of a path that a wave may cut."""

DOUBT = np.dtype([("chain", np.int64), ("weight", float)])
"""A crossing that counts only if no wave cuts its path."""

ARRIVAL = np.dtype(
    [
        ("chain", np.int64),
        ("weight", float),
        ("water", float),  # path in the water [m]
        ("air", float),
        ("doubt", np.int64),  # row of `Output.doubtful`, or -1
        ("point", float, (3,)),  # crossing [m]
        ("emission", float, (3,)),  # direction
    ]
)
"""Contribution of a chain to the aperture."""


class Output(NamedTuple):
    """Results of `contributions`, and a buffer for the crossings of one chain."""

    score: NDArray[np.float64]  # (chains,)
    doubtful: NDArray[np.void]  # DOUBT
    rays: NDArray[np.void]  # RAY
    arrivals: NDArray[np.void]  # ARRIVAL; no rows: not kept
    counters: NDArray[np.int64]  # by `Counter`
    roots: NDArray[np.void]  # ROOT


class Crossing(NamedTuple):
    """Crossing of a chain, and the light that it brings."""

    weight: float
    steep: bool  # no wave can cut its paths off
    aim: crossing.Aim
    point: Vec3
    start: Vec3  # of the chain


class Counter(IntEnum):
    """Outcomes of the search that are counted."""

    SOLVED = 0
    NO_FLAT = 1
    ENUMERATED = 2
    EXTRA_ROOTS = 3
    BLOCKED = 4


@inlined
def shot_of(chains, i, scene, branch, roughness):
    """Return the open segment of chain i and the point that it aims at."""
    u, v = chains.disk[i, 0], chains.disk[i, 1]
    goal = Vec2(scene.target.radius * u, scene.target.radius * v)
    tilt = slope_tilt(roughness, chains.tilt[i, 0], chains.tilt[i, 1])
    start = crossing.start_of(scene.emitter, u, v)
    return crossing.Shot(start, row(chains.tail, i), row(chains.last, i), goal, branch, tilt)


@entry
def flat_crossings(chains, starts, still, raised, out):
    """Write the flat-sea crossings (`FLAT` records) of each chain.

    Array twin: `tests/engine/test_crossing.py`.
    Flat crossings do not depend on the waves: they are the starts for every surface. `out` has
    room for several of each chain; branch 0 ends them. Chains that turn by more than 66 degrees
    or reach still water before their last scattering are searched from many `starts` (x, y) and
    on both branches; the others have one crossing, found from below the receiver. A chain that
    ends above still water is searched on a sea `raised` above every crest.
    """
    for i in range(len(chains.last)):
        flat_crossings_of(chains, i, starts, still, raised, out[i])


@outlined
def flat_crossings_of(chains, i, starts, still, raised, out):
    """Write the flat-sea crossings of chain i; return their number.

    Array twin: see `flat_crossings`.
    """
    depth = -still.emitter.position.z
    q, v = row(chains.tail, i), row(chains.last, i)
    size = norm(q)
    plain = size < 0.95 * depth and dot(q, v) >= 0.4 * size
    n = ZERO
    for scene in (still, raised):
        for side in range(1 if size < depth else 2):
            for k in range(len(starts)):
                if n < len(out) and not (n > 0 and plain):
                    shot = shot_of(chains, i, scene, 1.0 - 2.0 * side, SMOOTH)
                    n = _flat_root(n, starts[k], shot, scene, out)
        if n > 0:
            break
    if n < len(out):
        out[n].branch = 0.0
    return n


@outlined
def _flat_root(n, start, shot, scene, out):
    """Add the flat-sea crossing that Newton finds from a start, if it is new."""
    longest = scene.target.center.z
    found, x, y, _ = crossing.newton(start[0], start[1], FLAT_SEA, YES, longest, shot, scene)
    if not found or crossing.is_known(out, ZERO, n, x, y, shot.branch, 1e-4):
        return n
    crossing.flat_crossing(out[n], x, y, shot, scene)
    return n + 1


@inlined
def find_crossings(chains, i, flat, audit, search, scene, out):
    """Write the crossings of chain i (`Output.roots`); return their number.

    Newton starts from the flat crossings. More roots, if the sea focuses, are searched in a
    share of the chains and count by the inverse of that share: unbiased.
    """
    n = ZERO
    for k in range(len(flat)):
        if flat[k].branch == 0.0:
            if k == 0:
                out.counters[Counter.NO_FLAT.value] += 1
            break
        shot = shot_of(chains, i, scene, flat[k].branch, scene.surface.roughness)
        n = _near(n, flat[k], audit, search, shot, scene, out.roots, out.counters)
    return n


@outlined
def _near(n, flat, audit, search, shot, scene, roots, counters):
    """Append the crossings that belong to one flat crossing."""
    surface, target, tilt = scene.surface, scene.target, shot.tilt
    radius = crossing.radius_of(flat, search, shot, scene)
    off = math.hypot(flat.x - target.center.x, flat.y - target.center.y)
    if off > target.reach + radius:
        return n  # outside the field of view for any waves
    if shot.branch > 0.0 and not _reaches(flat, radius, shot, scene):
        return n
    first, share = n, 1.0
    if surface.interpolate:
        x0 = flat.x + flat.m11 * tilt.x + flat.m12 * tilt.y
        y0 = flat.y + flat.m21 * tilt.x + flat.m22 * tilt.y
        found, x, y, facet = crossing.root_from(x0, y0, radius, shot, scene)
        if found:
            counters[Counter.SOLVED.value] += 1
            n = crossing.add_root(roots, n, ZERO, x, y, facet, shot.branch, 1.0)
        # most chains that Newton gives up have no crossing: a quarter of them shows it
        audited = 1.0 if search.curvature * flat.lever > _FOCUSING else search.audit
        share = audited if found else max(audited, _AUDIT_FAILED)
        if audit >= share:
            return n
    kept = n
    counters[Counter.ENUMERATED.value] += 1
    last = crossing.enumerate_roots(roots, n, flat, radius, NO, shot, scene)
    for k in range(n, last):
        r = roots[k]
        kept = crossing.add_root(roots, kept, ZERO, r.x, r.y, r.facet, shot.branch, 1.0 / share)
    counters[Counter.EXTRA_ROOTS.value] += kept - max(n, first)
    return kept


@inlined
def _reaches(flat, radius, shot, scene):
    """Return whether the open segment of a chain can end on the surface near a flat crossing.

    A segment that goes outwards must start nearer to the source than the surface lies.
    """
    if dot(shot.q, shot.v) < 0.0:
        return True
    source = shot.start
    side = math.hypot(flat.x - source.x, flat.y - source.y) + radius
    rise = scene.surface.high[2] - source.z
    return dot(shot.q, shot.q) < side * side + rise * rise


@entry
def contributions(chains, flat, audits, search, scene, out):
    """Write the contribution of each chain to the aperture.

    Returns (doubtful crossings, rays, arrivals).

    Array twin: the analog estimator.
    Crossings that a wave may cut off before or behind are not scored but listed as doubtful,
    with the rays of their paths, which the caller checks by Embree.
    """
    counts = ZERO, ZERO, ZERO
    for i in range(len(chains.last)):
        for k in range(find_crossings(chains, i, flat[i], audits[i], search, scene, out)):
            root = out.roots[k]
            shot = shot_of(chains, i, scene, root.branch, scene.surface.roughness)
            light = weigh(chains, i, root.x, root.y, root.facet, shot, scene)
            w = light.weight * root.multiplicity
            if w <= 0.0:
                continue
            counts = keep(chains, i, w, light, counts, scene, out)
    return counts


@entry
def flat_contributions(chains, flat, scene, score):
    """Write the contribution of each chain to the aperture over still water.

    Array twin: `contributions` over a flat mesh.
    The crossings are known; still water cuts off a path with a vertex above it.
    """
    for i in range(len(chains.last)):
        score[i] = 0.0
        for k in range(len(flat[i])):
            f = flat[i, k]
            if f.branch == 0.0:
                break
            if f.level != scene.surface.level:
                continue
            shot = shot_of(chains, i, scene, f.branch, SMOOTH)
            j = crossing.jacobian(f.x, f.y, FLAT_SEA, shot, scene)
            p = Vec3(f.x, f.y, f.level)
            w, deep = weight_of(chains, i, p, j, FLAT_SEA, shot, scene)
            if deep:
                score[i] += w


@inlined
def keep(chains, i, w, light, counts, scene, out):
    """Score the light w of chain i by its `Crossing`, or list it as doubtful with its rays.

    Array twin: none, a list for Embree.
    `counts` are those of `contributions`, returned with what is added.
    """
    n_doubt, n_rays, n_arrivals = counts
    first, aim = n_rays, light.aim
    if not light.steep:
        n_rays = list_paths(chains, i, light, n_doubt, scene, out.rays, n_rays)
    if n_arrivals < len(out.arrivals):
        a = out.arrivals[n_arrivals]
        a.chain, a.weight = i, w
        a.water, a.air = chains.path[i] + aim.length, aim.flight
        a.doubt = n_doubt if n_rays > first else -1
        write(a.point, light.point)
        write(a.emission, aim.w)
        n_arrivals += 1
    if n_rays > first:
        out.doubtful[n_doubt].chain, out.doubtful[n_doubt].weight = i, w
        n_doubt += 1
    else:
        out.score[i] += w
    return n_doubt, n_rays, n_arrivals


@inlined
def is_steep(m, scene):
    """Return whether no wave can block a path before or after its crossing.

    Array twin: `_cut` of `meshtrace.engine.forced`, by Embree.
    """
    slope = scene.surface.max_slope
    return m.d.z > slope * math.hypot(m.d.x, m.d.y) and (
        not scene.interface.follow_second_hit or m.r.z > slope * math.hypot(m.r.x, m.r.y)
    )


@inlined
def weigh(chains, i, x, y, facet, shot, scene):
    """Return the `Crossing` of chain i over (x, y) on a facet.

    The random slope of a chain is Gaussian: another density is in the weight.
    """
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))
    j = crossing.jacobian(x, y, facet, shot, scene)
    weight, deep = weight_of(chains, i, p, j, facet, shot, scene)
    weight *= over_gaussian(scene.surface.roughness.series, chains.tilt[i, 0], chains.tilt[i, 1])
    return Crossing(weight, is_steep(j.aim, scene) and deep, j.aim, p, shot.start)


@inlined
def weight_of(chains, i, p, j, facet, shot, scene):
    """Return (|A| I(w) W / |det dX/dOmega|, all vertices deep) of chain i through a crossing.

    The random slope is that of `shot`.
    """
    m, spread = j.aim, abs(j.a * j.d - j.b * j.c)
    if not j.ok or m.w.z <= -0.999999 or spread == 0.0:
        return 0.0, True
    n = normal_at(p.x, p.y, facet, scene.surface) if facet >= 0 else UP
    light = crossing.passed(intensity(scene.emitter, m.w), m, p, n, facet, shot.tilt, scene)
    if light == 0.0:
        return 0.0, True
    solid_angle = abs(j.wa * j.wd - j.wb * j.wc) / (abs(m.w.z) * spread)
    w, deep = _transmit(chains, i, m, p, shot.start, scene)
    area = scene.target.area * scene.emitter.power
    return area * light * solid_angle * w * chains.weight[i], deep


@inlined
def turned(w, p):
    """Rotate a vector by the minimal rotation from e_z to the emission direction.

    Array twin: the rotation matrix of the tests.
    """
    along = (-w.y * p.x + w.x * p.y) / (1.0 + w.z)
    return Vec3(
        p.x * w.z + w.x * p.z - w.y * along,
        p.y * w.z + w.y * p.z + w.x * along,
        p.z * w.z - w.x * p.x - w.y * p.y,
    )


@inlined
def _vertex(chains, i, k, m, start):
    """Return vertex k of chain i."""
    return plus(turned(m.w, row(chains.vertex[i], k)), start)


@inlined
def _transmit(chains, i, m, p, start, scene):
    """Return (coefficients of the scatterings times transmittance, all vertices deep)."""
    medium = scene.medium
    before = start
    simple = is_uniform(medium)
    weight, tau, deep = 1.0, 0.0, True
    for k in range(chains.vertex.shape[1]):
        v = _vertex(chains, i, k, m, start)
        if v.z > scene.surface.low[2]:
            deep = False
        if simple:
            weight *= medium.b
        else:
            if chains.kind[i, k] == 1:
                weight *= bubble_scattering(medium, v)
            else:
                weight *= water_coefficients(medium, v.z)[1]
            length = norm(minus(v, before))
            tau += absorption_path(medium, before.z, v.z, length)
            tau += scattering_path(medium, before, v, length)
        before = v
    if simple:
        tau = (medium.a + medium.b) * (chains.path[i] + m.length)
    else:
        tau += absorption_path(medium, before.z, p.z, m.length)
        tau += scattering_path(medium, before, p, m.length)
    return weight * math.exp(-tau), deep


@outlined
def list_paths(chains, i, light, doubt, scene, rays, n):
    """List the straight parts of a `Crossing`'s path that a wave may block; return the rays.

    Array twin: none, a list for Embree.
    A vertex above the highest crest needs no ray of its own: the path to it or from it is cut.
    """
    low, high, slope = scene.surface.low[2], scene.surface.high[2], scene.surface.max_slope
    m, p, start = light.aim, light.point, light.start
    order = chains.vertex.shape[1]
    for k in range(order + (2 if scene.interface.follow_second_hit else 1)):
        if k < order:
            end = _vertex(chains, i, k, m, light.start)
        elif k == order:
            end = p
        else:
            end = along(p, m.r, m.flight)
        way = minus(end, start)
        length = norm(way)
        level = max(start.z, end.z) > low and min(start.z, end.z) < high
        climbs = way.z > slope * math.hypot(way.x, way.y) and k >= order
        if length > 0.0 and level and not climbs and n < len(rays):
            rays[n].crossing, rays[n].length = doubt, length
            write(rays[n].origin, start)
            write(rays[n].direction, Vec3(way.x / length, way.y / length, way.z / length))
            n += 1
        start = end
    return n
