"""Crossings of each chain over one surface: Newton from those of a flat sea, and audits.

An audit searches every facet for all crossings near that of a flat sea that land on one point.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.crossing.aiming import Shot, aim_at, flat_crossing, newton
from meshtrace.kernels.facets import SMOOTH, corners, inside_facet, slope_tilt
from meshtrace.kernels.jit import NO, YES, ZERO, entry, inlined, outlined
from meshtrace.kernels.scene import FLAT_SEA, bins_near, height_on, is_first_bin, locate
from meshtrace.kernels.vectors import ORIGIN, UP, Vec2, along, dot, norm, row

MARGIN = 1.3  # on first-order bounds, for the higher orders

ROOT = np.dtype(
    [
        ("x", float),
        ("y", float),
        ("branch", float),
        ("facet", np.int64),
        ("multiplicity", float),  # number of crossings that it stands for
    ]
)
"""A crossing of the surface that lands on the point aimed at."""


@inlined
def is_known(roots, first, last, x, y, branch, tolerance):
    """Return whether a crossing is one of the records first <= k < last.

    Array twin: numpy.abs of differences.
    """
    for k in range(first, last):
        r = roots[k]
        if r.branch == branch and abs(r.x - x) + abs(r.y - y) < tolerance:
            return True
    return False


@outlined
def enumerate_roots(roots, n, flat, radius, shot, scene):
    """Append every crossing near a flat-sea crossing that lands on the point; return the number.

    Array twin: the roots of the analytic sinusoid in the tests.
    Every facet within `radius` is searched.
    """
    grid = scene.locator
    i0, i1, j0, j1 = bins_near(flat.x, flat.y, radius, grid)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(grid.start[i * grid.ny + j], grid.start[i * grid.ny + j + 1]):
                f = np.int64(grid.facet[k])
                if may_hold(scene.facets[f], flat, shot.tilt, 0.0):
                    if is_first_bin(i, j, i0, j0, f, scene.surface, grid):
                        n = _facet_roots(roots, n, f, flat, shot, scene)
    return n


@outlined
def listed_roots(roots, n, flat, facets, shot, scene):
    """Append every crossing on some facets that lands on the point; return the number.

    Array twin: `enumerate_roots`, which searches every facet.
    """
    for k in range(len(facets)):
        f = np.int64(facets[k])
        if may_hold(scene.facets[f], flat, shot.tilt, 0.0):
            n = _facet_roots(roots, n, f, flat, shot, scene)
    return n


@inlined
def may_hold(facet, flat, tilt, slack):
    """Return whether a crossing may lie within `slack` [m] of a facet, to first order.

    Array twin: `_facet_roots` without it finds the same roots.
    The flat crossing moves by dP/dslope and dP/dz; half of the move is left for the
    higher orders, and the facet's size grows by its curvature.
    """
    sx, sy = facet.slope_x + tilt.x, facet.slope_y + tilt.y
    dz = facet.z - flat.level
    mx, my = flat.m11 * sx + flat.m12 * sy, flat.m21 * sx + flat.m22 * sy
    hx, hy = flat.h1 * dz, flat.h2 * dz
    move = abs(mx) + abs(my) + abs(hx) + abs(hy)
    bend = abs(flat.m11) + abs(flat.m12) + abs(flat.m21) + abs(flat.m22)
    reach = 0.5 * move + 2.0 * facet.radius * (1.0 + bend * facet.curvature) + slack
    ex, ey = flat.x + mx + hx - facet.x, flat.y + my + hy - facet.y
    return ex * ex + ey * ey <= reach * reach


@outlined
def corner_shines(f, shot, scene):
    """Return whether light leaves the water at a corner of a facet, but not at its centroid.

    Array twin: fine meshes of the same water in the tests.
    """
    for p in corners(scene.surface.vertices, f, scene.surface.faces):
        if aim_at(p.x, p.y, f, shot, scene).ok:
            return True
    return False


@inlined
def spread_of(facet, flat):
    """Return the largest distance of landing points of a facet from that of its centroid [m].

    Array twin: `_facet_roots` without it finds the same roots.
    """
    return MARGIN * facet.radius * (flat.high + flat.lever * facet.curvature)


@outlined
def _facet_roots(roots, n, f, flat, shot, scene):
    """Add the roots on facet f.

    If its centroid lands farther from the point than |dX/dP| of a curved surface could bring
    over the facet's size, it holds none. Where a fold of the map runs through a facet there
    may be two: Newton starts from its corners too.
    """
    facet = scene.facets[f]
    x, y = facet.x, facet.y
    m = aim_at(x, y, f, shot, scene)
    bend = flat.lever * facet.curvature
    if m.ok:
        if math.hypot(m.at.x - shot.goal.x, m.at.y - shot.goal.y) > spread_of(facet, flat):
            return n
    elif not corner_shines(f, shot, scene):
        return n
    first = n
    n = _add_root(roots, n, first, x, y, f, shot, scene)
    if not m.ok or (scene.surface.interpolate and bend > 0.5 * flat.high):
        for p in corners(scene.surface.vertices, f, scene.surface.faces):
            n = _add_root(roots, n, first, p.x, p.y, f, shot, scene)
    return n


@inlined
def _add_root(roots, n, first, x, y, f, shot, scene):
    found, x, y, _ = newton(x, y, f, YES, 2.0 * scene.facets[f].radius, shot, scene)
    if not found or not inside_facet(x, y, f, scene.surface):
        return n
    return _add(roots, n, first, x, y, f, shot.branch, 1.0)


@inlined
def _add(roots, n, first, x, y, facet, branch, multiplicity):
    """Append a crossing unless it is one of those from `first` on; return their number."""
    if n == len(roots) or is_known(roots, first, n, x, y, branch, 1e-6):
        return n
    r = roots[n]
    r.x, r.y, r.branch, r.facet, r.multiplicity = x, y, branch, facet, multiplicity
    return n + 1


_FOCUSING = 0.5  # change of the landing point by curvature, over that by the way, that is much
_AUDIT_FAILED = 0.25  # share of chains without a solution whose facets are all searched


class Counter(IntEnum):
    """Outcomes of the search that are counted."""

    SOLVED = 0
    NO_FLAT = 1
    ENUMERATED = 2
    EXTRA_ROOTS = 3
    BLOCKED = 4
    LISTED = 5


class Near(NamedTuple):
    """Facets to search for each flat crossing of each chain, see `engine.chains.nearby`."""

    rows: NDArray[np.int64]  # (chains, crossings, 2) of `facet`; first < 0: no list
    facet: NDArray[np.int32]


class Search(NamedTuple):
    """Extent of the search for roots on one surface."""

    audit: float  # share of chains whose facets are all searched; 1 for faceted normals
    slope: float  # steepest slope of the surface
    margin: float  # [m], size of the facets
    widest: float  # [m], no crossing lies farther from the flat one
    curvature: float  # largest change of slope along an edge of the facets [m-1]
    near: Near  # without rows: no lists


@inlined
def start_of(emitter, u, v):
    """Return the start of a chain: the source, or a point (u, v) of the unit disk on its disk."""
    if emitter.radius == 0.0:
        return emitter.position
    side = along(emitter.position, emitter.e1, emitter.radius * u)
    return along(side, emitter.e2, emitter.radius * v)


@inlined
def shot_of(chains, i, scene, branch, roughness):
    """Return the open segment of chain i and the point that it aims at."""
    u, v = chains.disk[i, 0], chains.disk[i, 1]
    goal = Vec2(scene.target.radius * u, scene.target.radius * v)
    tilt = slope_tilt(roughness, chains.tilt[i, 0], chains.tilt[i, 1])
    start = start_of(scene.emitter, u, v)
    return Shot(start, row(chains.tail, i), row(chains.last, i), goal, branch, tilt)


@inlined
def straight_shot(u, v, scene):
    """Return the unscattered light that belongs to a point (u, v) of the unit disk."""
    goal = Vec2(scene.target.radius * u, scene.target.radius * v)
    return Shot(start_of(scene.emitter, u, v), ORIGIN, UP, goal, 1.0, Vec2(0.0, 0.0))


@entry
def flat_crossings(chains, starts, still, raised, out):
    """Write the flat-sea crossings (`FLAT` records) of each chain.

    Array twin: `tests/engine/crossing/test_aiming.py`.
    Flat crossings do not depend on the waves: they are the starts for every surface. `out` has
    room for several of each chain; branch 0 ends them. Chains that turn sharply or reach
    still water before their last scattering are searched from many `starts` (x, y) and on
    both branches; the others have one crossing, found from below the receiver. A chain that
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
    plain = size < 0.95 * depth and dot(q, v) > 0.8 * size
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
    found, x, y, _ = newton(start[0], start[1], FLAT_SEA, YES, longest, shot, scene)
    if not found or is_known(out, ZERO, n, x, y, shot.branch, 1e-4):
        return n
    flat_crossing(out[n], x, y, shot, scene)
    return n + 1


@entry
def direct_crossings(points, starts, scene, found, out):
    """Write the crossings of unscattered light that lands on points of the unit disk.

    Array twin: `meshtrace.engine.forced.ForcedDetection`, by the images of the facets.
    """
    for i in range(len(points)):
        shot = straight_shot(points[i, 0], points[i, 1], scene)
        x, y = starts[i, 0], starts[i, 1]
        facet = locate(scene.locator, scene.surface, x, y)
        if facet >= 0:
            found[i], x, y, facet = newton(x, y, facet, NO, 1.0, shot, scene)
        out[i, 0], out[i, 1], out[i, 2] = x, y, height_on(x, y, facet, scene.surface)


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
        first, last = ZERO - 1, ZERO
        if len(search.near.rows) > 0:
            first, last = search.near.rows[i, k, 0], search.near.rows[i, k, 1]
        listed = search.near.facet[max(first, 0) : last]
        n = _near(
            n, flat[k], audit, search, first >= 0, listed, shot, scene, out.roots, out.counters
        )
    return n


@outlined
def _near(n, flat, audit, search, is_listed, listed, shot, scene, roots, counters):
    """Append the crossings that belong to one flat crossing."""
    surface, target, tilt = scene.surface, scene.target, shot.tilt
    radius = radius_of(flat, search, shot, scene)
    off = math.hypot(flat.x - target.center.x, flat.y - target.center.y)
    if off > target.reach + radius:
        return n  # outside the field of view for any waves
    if shot.branch > 0.0 and not _reaches(flat, radius, shot, scene):
        return n
    first, share = n, 1.0
    if surface.interpolate:
        x0 = flat.x + flat.m11 * tilt.x + flat.m12 * tilt.y
        y0 = flat.y + flat.m21 * tilt.x + flat.m22 * tilt.y
        found, x, y, facet = root_from(x0, y0, radius, shot, scene)
        if found:
            counters[Counter.SOLVED.value] += 1
            n = _add(roots, n, ZERO, x, y, facet, shot.branch, 1.0)
        # most chains that Newton gives up have no crossing: a quarter of them shows it
        audited = 1.0 if search.curvature * flat.lever > _FOCUSING else search.audit
        share = audited if found else max(audited, _AUDIT_FAILED)
        if audit >= share:
            return n
    kept = n
    if is_listed:
        counters[Counter.LISTED.value] += 1
        last = listed_roots(roots, n, flat, listed, shot, scene)
    else:
        counters[Counter.ENUMERATED.value] += 1
        last = enumerate_roots(roots, n, flat, radius, shot, scene)
    for k in range(n, last):
        r = roots[k]
        kept = _add(roots, kept, ZERO, r.x, r.y, r.facet, shot.branch, 1.0 / share)
    counters[Counter.EXTRA_ROOTS.value] += kept - max(n, first)
    return kept


@inlined
def root_from(x0, y0, radius, shot, scene):
    """Return (found, x, y, facet): the crossing that Newton finds from a point.

    Array twin: `enumerate_roots`, which searches every facet.
    """
    found, x, y, facet = False, x0, y0, locate(scene.locator, scene.surface, x0, y0)
    start = facet
    for step in (0.5, 0.1):  # the second time more carefully
        if start >= 0 and not found:
            found, x, y, facet = newton(x0, y0, start, NO, step * radius, shot, scene)
            found = found and inside_facet(x, y, facet, scene.surface)
    return found, x, y, facet


@inlined
def radius_of(flat, search, shot, scene):
    """Return the largest distance of crossings of the wavy sea from a flat one [m].

    Array twin: `enumerate_roots` over all of the sea finds no others.
    """
    surface = scene.surface
    waves = max(abs(surface.high[2] - flat.level), abs(surface.low[2] - flat.level))
    slope = search.slope + math.hypot(shot.tilt.x, shot.tilt.y)
    move = MARGIN * (slope * flat.lever + waves * flat.lift) / max(flat.low, 1e-3)
    return min(move + search.margin, search.widest)


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
