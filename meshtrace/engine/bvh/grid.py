"""Facets that steep light meets on a height field over a grid, found without ray casting.

A ray that climbs or falls much faster than the steepest facet meets a height field once, and Newton
steps from cell to cell find that point. A point close to an edge is left to the intersector: the
facet that single precision would choose there is not known, and results are the same bit for bit
with and without this shortcut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import entry, inlined

UNKNOWN = np.int64(-2)
"""Facet of a ray that the intersector must answer."""

_STEPS = 8  # cells visited at most


class Axis(NamedTuple):
    """Increasing grid lines, and for equal bins the line at or before each."""

    line: NDArray[np.float64]  # (n,) the last one replaced by infinity
    per_edge: NDArray[np.float64]  # (n - 1,) [m-1]
    guide: NDArray[np.int64]  # (bins,) no bin has more than one line inside
    per_bin: float  # [m-1]


class Grid(NamedTuple):
    """Height field on a tensor grid, cut as by `meshtrace.surfaces.triangulate`."""

    x: Axis
    y: Axis
    level: float  # height of the first guess [m]
    steep: float  # least squared ratio of vertical to horizontal components of a ray
    rounding: float  # of a coordinate, relative
    height: float  # largest coordinate across the grid [m]
    clear: float  # least distance of the facet [m]


@inlined
def cell_of(axis, x):
    """Return the index of the grid cell that holds a coordinate, -1 outside.

    Array twin: numpy.searchsorted.
    """
    at = (x - axis.line[0]) * axis.per_bin
    if not 0.0 <= at < len(axis.guide):
        return -1
    i = axis.guide[int(at)]
    return i + np.int64(axis.line[i + 1] <= x)


@inlined
def grid_facet(grid, vertices, p, d):
    """Return the facet that a ray meets, `UNKNOWN` if it is not steep or passes close to an edge.

    Array twin: `BruteForceIntersector`.
    """
    if d.z * d.z < grid.steep * (d.x * d.x + d.y * d.y):
        return UNKNOWN
    ny = len(grid.y.line)
    t = (grid.level - p.z) / d.z
    i, j = cell_of(grid.x, p.x + t * d.x), cell_of(grid.y, p.y + t * d.y)
    if i < 0 or j < 0:
        return UNKNOWN
    t = (vertices[i * ny + j, 2] - p.z) / d.z
    for _ in range(_STEPS):
        x, y, z = p.x + t * d.x, p.y + t * d.y, p.z + t * d.z
        i, j = cell_of(grid.x, x), cell_of(grid.y, y)
        if i < 0 or j < 0:
            return UNKNOWN
        # the diagonal is u = v, in odd cells after a reflection of u; without branches, of which
        # half would be predicted wrongly
        odd = (i + j) & 1
        sign, left = 1.0 - 2.0 * odd, i * ny + j
        a, b = left + odd * ny, left + (1 - odd) * ny
        za, zb, zc, zd = vertices[a, 2], vertices[b, 2], vertices[b + 1, 2], vertices[a + 1, 2]
        per_x, per_y = grid.x.per_edge[i], grid.y.per_edge[j]
        u = odd + sign * (x - grid.x.line[i]) * per_x
        v = (y - grid.y.line[j]) * per_y
        du, dv = sign * d.x * per_x, d.y * per_y
        first = u > v
        rise_u = zb - za if first else zc - zd
        rise_v = zc - zb if first else zd - za
        step = (za + u * rise_u + v * rise_v - z) / (d.z - du * rise_u - dv * rise_v)
        t += step
        u, v = u + step * du, v + step * dv
        inside = min(min(u, 1.0 - u), min(v, 1.0 - v))
        inside = min(inside, u - v if first else v - u)
        margin = grid.rounding * (abs(x) + abs(y) + grid.height) * max(per_x, per_y)
        if inside > margin:
            facet = 2 * (left - i) + np.int64(u <= v)
            return facet if t > grid.clear else UNKNOWN
        if inside > -margin:
            return UNKNOWN
    return UNKNOWN


@inlined
def facet_over(grid, x, y):
    """Return the facet of a grid over (x, y), -1 outside.

    Array twin: `scene.locate`.
    """
    i, j = cell_of(grid.x, x), cell_of(grid.y, y)
    if i < 0 or j < 0:
        return np.int64(-1)
    u = (x - grid.x.line[i]) * grid.x.per_edge[i]
    v = (y - grid.y.line[j]) * grid.y.per_edge[j]
    if (i + j) & 1:
        u = 1.0 - u
    return 2 * (i * (len(grid.y.line) - 1) + j) + np.int64(u <= v)


@entry
def is_grid(vertices, faces, nx, ny):
    """Return whether a mesh is a height field on an nx by ny tensor grid, cut as by `triangulate`.

    Array twin: `grid_faces`.
    """
    for i in range(nx):
        for j in range(ny):
            a = i * ny + j
            if vertices[a, 0] != vertices[i * ny, 0] or vertices[a, 1] != vertices[j, 1]:
                return False
            if i == nx - 1 or j == ny - 1:
                continue
            b, c, d = a + ny, a + ny + 1, a + 1
            f = 2 * (i * (ny - 1) + j)
            even = (i + j) % 2 == 0
            if faces[f, 0] != a or faces[f, 1] != b or faces[f, 2] != (c if even else d):
                return False
            if faces[f + 1, 0] != (a if even else b) or faces[f + 1, 1] != c:
                return False
            if faces[f + 1, 2] != d:
                return False
    return True
