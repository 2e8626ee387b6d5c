"""Facets near the crossings of a base link: all that can hold those of its neighbours.

The search of every facet leaves a facet out by two tests: how far the flat crossing is moved by
the facet's slope and height, and how far from the point aimed at light lands that crosses at its
centroid. For the base link both tests are passed by some `slack`; the facets that pass are
listed. A neighbour that moves flat crossings and landing points by less than the slack has
crossings on listed facets only, new ones at folds included: these alone are tested by its
own search. Any other chain is searched over every facet.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.chains.gain import shot_of
from meshtrace.engine.crossing import MARGIN, aim_at, land_sloped, may_hold, radius_of, spread_of
from meshtrace.kernels.jit import ZERO, entry, inlined, outlined
from meshtrace.kernels.scene import bins_near, is_first_bin
from meshtrace.kernels.vectors import Vec3

LONGEST = 256  # facets of a list; a chain with more has none
PROBES = 4  # points around a flat crossing where landings are compared


class Lists(NamedTuple):
    """Facets of each flat crossing of the chains of a base link."""

    flat: NDArray[np.void]  # (chains, crossings) FLAT
    rows: NDArray[np.int64]  # (chains, crossings, 2) of `facet`; first < 0: no list
    facet: NDArray[np.int32]
    radius: NDArray[np.float64]  # (chains, crossings), of the search [m]
    miss: NDArray[np.float64]  # (chains, crossings, PROBES, 2), landings less the point [m]


@entry
def list_facets(chains, search, slack, scene, out):
    """Write the `Lists` of a base link, with room for `LONGEST` facets of each chain.

    Returns the number of facets.

    Array twin: the search of every facet for neighbouring links.
    `slack` [m] is that of the landing points.
    """
    n = ZERO
    for i in range(len(chains.last)):
        for k in range(out.flat.shape[1]):
            flat = out.flat[i, k]
            out.rows[i, k, 0] = -1
            if flat.branch == 0.0:
                break
            shot = shot_of(chains, i, scene, flat.branch, scene.surface.roughness)
            radius = radius_of(flat, search, shot, scene)
            out.radius[i, k] = radius
            if not _probe(flat, radius, shot, scene, out.miss[i, k]):
                continue
            room = out.facet[n : n + LONGEST]
            found = _facets_near(flat, radius, slack, shot, scene, room)
            if found <= len(room):
                out.rows[i, k, 0], out.rows[i, k, 1] = n, n + found
                n += found
    return n


@inlined
def _slack_of_crossing(flat, slack):
    """Return the slack of a flat crossing for one of its landing point."""
    return slack / max(flat.low, 0.5)


@outlined
def _facets_near(flat, radius, slack, shot, scene, out):
    """Write the facets that pass both tests by the slack; return their number, or too many."""
    grid, n, hair = scene.locator, ZERO, _slack_of_crossing(flat, slack)
    i0, i1, j0, j1 = bins_near(flat.x, flat.y, radius + hair, grid)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(grid.start[i * grid.ny + j], grid.start[i * grid.ny + j + 1]):
                f = np.int64(grid.facet[k])
                if not _passes(f, flat, slack, hair, shot, scene):
                    continue
                if is_first_bin(i, j, i0, j0, f, scene.surface, grid):
                    if n == len(out):
                        return n + 1
                    out[n] = f
                    n += 1
    return n


@inlined
def _passes(f, flat, slack, hair, shot, scene):
    """Return whether a facet holds a crossing of a neighbour; total reflection may end."""
    facet = scene.facets[f]
    if not may_hold(facet, flat, shot.tilt, hair):
        return False
    m = aim_at(facet.x, facet.y, f, shot, scene)
    miss = math.hypot(m.at.x - shot.goal.x, m.at.y - shot.goal.y)
    return not m.ok or miss <= spread_of(facet, flat) + slack


@inlined
def _probe(flat, radius, shot, scene, out):
    """Write landings less the point around a flat crossing; return whether all land."""
    for k in range(PROBES):
        m = _probed(k, flat, radius, shot, scene)
        if not m.ok:
            return False
        out[k, 0], out[k, 1] = m.at.x - shot.goal.x, m.at.y - shot.goal.y
    return True


@inlined
def _probed(k, flat, radius, shot, scene):
    """Return the `Aim` of point k around a flat crossing."""
    side = radius if k % 2 == 0 else -radius
    x, y = (flat.x + side, flat.y) if k < 2 else (flat.x, flat.y + side)
    return land_sloped(Vec3(x, y, flat.level), 0.0, 0.0, shot, scene)


@entry
def near_rows(chains, flats, lists, search, slack, scene, out):
    """Write the rows of the lists that hold all crossings of a neighbouring link.

    Array twin: the search of every facet.
    """
    for i in range(len(chains.last)):
        for k in range(flats.shape[1]):
            out[i, k, 0] = -1
            f, g = flats[i, k], lists.flat[i, k]
            if f.branch == 0.0:
                break
            if lists.rows[i, k, 0] < 0 or f.branch != g.branch or f.level != g.level:
                continue
            shot = shot_of(chains, i, scene, f.branch, scene.surface.roughness)
            grown = radius_of(f, search, shot, scene) - lists.radius[i, k]
            crossing = _displaced(f, g, search, shot, scene) + max(grown, 0.0)
            landing = _landing(f, g, lists, i, k, search, shot, scene)
            if crossing <= _slack_of_crossing(g, slack) and landing <= slack:
                out[i, k, 0], out[i, k, 1] = lists.rows[i, k, 0], lists.rows[i, k, 1]


@inlined
def _displaced(f, g, search, shot, scene):
    """Return a bound on the displacement of a flat crossing moved by slopes and heights."""
    surface = scene.surface
    waves = max(abs(surface.high[2] - f.level), abs(surface.low[2] - f.level))
    slope = search.slope + math.hypot(shot.tilt.x, shot.tilt.y)
    by_slope = abs(f.m11 - g.m11) + abs(f.m12 - g.m12) + abs(f.m21 - g.m21) + abs(f.m22 - g.m22)
    by_height = abs(f.h1 - g.h1) + abs(f.h2 - g.h2)
    bend = search.margin * search.curvature * by_slope  # margin: twice the largest radius
    return math.hypot(f.x - g.x, f.y - g.y) + 1.5 * (slope * by_slope + waves * by_height) + bend


@inlined
def _landing(f, g, lists, i, k, search, shot, scene):
    """Return a bound on the displacement of a landing point, and on the growth of its spread.

    Twice the largest displacement on still water, for the slopes of the waves.
    """
    worst = 0.0
    for c in range(PROBES):
        m = _probed(c, g, lists.radius[i, k], shot, scene)
        if not m.ok:
            return math.inf
        dx = m.at.x - shot.goal.x - lists.miss[i, k, c, 0]
        dy = m.at.y - shot.goal.y - lists.miss[i, k, c, 1]
        worst = max(worst, math.hypot(dx, dy))
    spread = f.high - g.high + (f.lever - g.lever) * search.curvature
    return 2.0 * worst + 0.5 * search.margin * MARGIN * max(spread, 0.0)
