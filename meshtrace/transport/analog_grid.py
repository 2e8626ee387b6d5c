"""Grids of height fields as arrays, for the shortcut of the analog photons."""

from __future__ import annotations

import numpy as np

from meshtrace.kernels.photon_grid import Axis, Grid, is_grid
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats

_ROUNDING = 128 * 2.0**-24
"""Relative rounding of coordinates that leaves a facet in single precision in no doubt."""

_SLOPES = 2.0  # steepness of the rays over that of the facets
_LEAST_STEEP = 0.2  # vertical over horizontal components, above a flat sea
_MOST_BINS = 2**17

_NONE = Axis(np.zeros(0), np.zeros(0), np.zeros(0, np.int64), 0.0)
NO_GRID = Grid(_NONE, _NONE, 0.0, np.inf, 0.0, 0.0, 0.0)
"""Grid that answers no ray."""


def grid_arrays(mesh: TriangleMesh) -> Grid:
    """Return the grid of a height field made by `triangulate`, `NO_GRID` for another mesh.

    Facets are found with a margin for the single precision of Embree: they are its facets.
    """
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    ny = int(np.argmax(x != x[0]))  # vertices of the first line; 0 if there is but one
    nx = len(x) // ny if ny > 1 else 0
    if nx < 2 or nx * ny != len(x) or len(mesh.faces) != 2 * (nx - 1) * (ny - 1):
        return NO_GRID
    if not mesh.single_valued or not is_grid(mesh.vertices, mesh.faces, nx, ny):
        return NO_GRID
    lines = x[::ny].copy(), y[:ny].copy()
    if any((np.diff(line) <= 0.0).any() for line in lines):  # a grid that was turned
        return NO_GRID
    along_x, along_y = (_axis(line) for line in lines)
    if max(len(along_x.guide), len(along_y.guide)) > _MOST_BINS:
        return NO_GRID
    low, high = mesh.bounds
    return Grid(
        along_x,
        along_y,
        level=float(0.5 * (low[2] + high[2])),
        steep=max(_SLOPES * mesh.max_slope, _LEAST_STEEP) ** 2,
        rounding=_ROUNDING,
        height=float(high[2] - low[2] + max(high[2], -low[2])),
        clear=_ROUNDING * float(np.abs(mesh.bounds).max()),
    )


def _axis(line: Floats) -> Axis:
    """Return grid lines with bins somewhat narrower than their smallest distance."""
    edges = np.diff(line)
    span = float(line[-1] - line[0])
    bins = min(int(1.01 * span / edges.min()) + 1, _MOST_BINS + 1)
    starts = line[0] + span * np.arange(bins) / bins
    guide = np.searchsorted(line, starts, side="right") - 1
    return Axis(np.append(line[:-1], np.inf), 1.0 / edges, guide.astype(np.int64), bins / span)
