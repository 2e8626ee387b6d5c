"""Shadows of waves on straight paths, by a walk over the bins of the locator."""

from __future__ import annotations

import math

import numpy as np

from meshtrace.kernels.facets import inside_facet, plane_distance
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.vectors import along, row

FREE, CUT, BESIDE = range(3)
"""Outcomes for a path; one beside the bins has to be checked by other means."""

_HAIR = 1e-4  # by which a path is shortened at its ends, over 1 + its length


@entry
def shadows(origins, directions, lengths, surface, grid, outcome):
    """Write whether the surface cuts straight paths off, `FREE`, `CUT` or `BESIDE`.

    Array twin: `EmbreeIntersector.intersect`.
    A path may start or end on the surface: it is shortened by a hair at both ends. Only its part
    between the lowest trough and the highest crest is searched.
    """
    for i in range(len(lengths)):
        p, d, hair = row(origins, i), row(directions, i), _HAIR * (1.0 + lengths[i])
        first, last = _between(p.z, d.z, hair, lengths[i] - 2.0 * hair, surface)
        outcome[i] = FREE if first >= last else _walk(p, d, first, last, surface, grid)


@outlined
def is_free(p, d, length, surface, grid):
    """Return whether a straight path is free, over bins that hold all facets.

    Array twin: `shadows`.
    """
    hair = _HAIR * (1.0 + length)
    first, last = _between(p.z, d.z, hair, length - 2.0 * hair, surface)
    edge = 1e-9 * grid.step
    for o, s, low, n in ((p.x, d.x, grid.x, grid.nx), (p.y, d.y, grid.y, grid.ny)):
        a, b = low + edge, low + n * grid.step - edge
        if s != 0.0:
            t, u = (a - o) / s, (b - o) / s
            first, last = max(first, min(t, u)), min(last, max(t, u))
        elif not a <= o <= b:
            return True
    return first >= last or _walk(p, d, first, last, surface, grid) != CUT


@inlined
def _between(z, rise, first, last, surface):
    """Return the part of a path that lies between the lowest trough and the highest crest."""
    low, high = surface.low[2], surface.high[2]
    if rise == 0.0:
        return first, (last if low <= z <= high else -math.inf)
    a, b = (low - z) / rise, (high - z) / rise
    return max(first, min(a, b)), min(last, max(a, b))


@outlined
def _walk(p, d, first, last, surface, grid):
    """Return the outcome for the part first <= t <= last of a path, column by column of bins."""
    a, b = along(p, d, first), along(p, d, last)
    west, east = (min(a.x, b.x) - grid.x) / grid.step, (max(a.x, b.x) - grid.x) / grid.step
    south, north = (min(a.y, b.y) - grid.y) / grid.step, (max(a.y, b.y) - grid.y) / grid.step
    if west < 0.0 or south < 0.0 or east >= grid.nx or north >= grid.ny:
        return BESIDE
    for i in range(math.floor(west), math.floor(east) + 1):
        t0, t1 = first, last
        if d.x != 0.0:
            enter = (grid.x + i * grid.step - p.x) / d.x
            leave = (grid.x + (i + 1) * grid.step - p.x) / d.x
            t0, t1 = max(t0, min(enter, leave)), min(t1, max(enter, leave))
        y0, y1 = p.y + t0 * d.y, p.y + t1 * d.y
        j0 = max(math.floor((min(y0, y1) - grid.y) / grid.step - 1e-6), 0)
        j1 = min(math.floor((max(y0, y1) - grid.y) / grid.step + 1e-6), grid.ny - 1)
        for j in range(j0, j1 + 1):
            cell = i * grid.ny + j
            for k in range(grid.start[cell], grid.start[cell + 1]):
                f = np.int64(grid.facet[k])
                t = plane_distance(p, d, f, surface)
                if first <= t <= last:
                    q = along(p, d, t)
                    if inside_facet(q.x, q.y, f, surface):
                        return CUT
    return FREE
