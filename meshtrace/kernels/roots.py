"""All crossings near that of a flat sea that land on one point: a search of every facet."""

from __future__ import annotations

import math

import numpy as np

from meshtrace.kernels.aiming import aim_at, newton
from meshtrace.kernels.facets import inside_facet
from meshtrace.kernels.jit import YES, inlined, outlined
from meshtrace.kernels.scene import bins_near, is_first_bin
from meshtrace.kernels.vectors import row

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
    for k in range(3):
        p = row(scene.surface.vertices, scene.surface.faces[f, k])
        if aim_at(p.x, p.y, f, shot, scene).ok:
            return True
    return False


@inlined
def spread_of(facet, flat):
    """Return how far from that of its centroid light may land that crosses on a facet [m].

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
        for k in range(3):
            p = row(scene.surface.vertices, scene.surface.faces[f, k])
            n = _add_root(roots, n, first, p.x, p.y, f, shot, scene)
    return n


@inlined
def _add_root(roots, n, first, x, y, f, shot, scene):
    found, x, y, _ = newton(x, y, f, YES, 2.0 * scene.facets[f].radius, shot, scene)
    if not found or n >= len(roots) or not inside_facet(x, y, f, scene.surface):
        return n
    if is_known(roots, first, n, x, y, shot.branch, 1e-6):
        return n
    roots[n].x, roots[n].y, roots[n].branch, roots[n].facet = x, y, shot.branch, f
    return n + 1
