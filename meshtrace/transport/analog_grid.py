"""Grids of height fields as arrays, for the shortcut of the analog photons."""

from __future__ import annotations

import numpy as np

from meshtrace.kernels.photon_grid import Axis, Grid, is_grid
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats

_SINGLE = 2.0**-24
_ROUNDINGS = 128.0  # of single precision, between a facet's edge and light that is surely on it
_MOST_MARGIN = 0.02  # of an edge: beyond, single precision decides too often
_SLOPES = 2.0  # steepness of the rays over that of the facets: at most this many slopes
_LEAST_STEEP = 0.2  # vertical over horizontal components, above a flat sea
_BINS = 4  # of the search for a grid line, for each line at most

_NONE = Axis(np.zeros(0), np.zeros(0, np.int64), 0.0)
NO_GRID = Grid(_NONE, _NONE, 0.0, np.inf, 0.0, 0.0)
"""Grid that answers no ray."""


def grid_arrays(mesh: TriangleMesh) -> Grid:
    """Return the grid of a height field made by `triangulate`, `NO_GRID` for another mesh.

    The margin covers the single precision of Embree: the facets found are its facets.
    """
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    ny = int(np.argmax(x != x[0]))  # vertices of the first line; 0 if there is but one
    nx = len(x) // ny if ny > 1 else 0
    if nx < 2 or nx * ny != len(x) or len(mesh.faces) != 2 * (nx - 1) * (ny - 1):
        return NO_GRID
    if not mesh.single_valued or not is_grid(mesh.vertices, mesh.faces, nx, ny):
        return NO_GRID
    lines = x[::ny].copy(), y[:ny].copy()
    edge = min(float(np.diff(line).min()) for line in lines)
    error = _ROUNDINGS * _SINGLE * float(np.abs(mesh.vertices).max())
    if not edge > 0.0 or error > _MOST_MARGIN * edge:
        return NO_GRID
    return Grid(
        *(_axis(line) for line in lines),
        level=float(mesh.bounds[:, 2].mean()),
        steep=max(_SLOPES * mesh.max_slope, _LEAST_STEEP) ** 2,
        margin=error / edge,
        clear=error,
    )


def _axis(line: Floats) -> Axis:
    """Return grid lines with bins as fine as their smallest distance, within reason."""
    span = float(line[-1] - line[0])
    bins = int(min(round(span / np.diff(line).min()), _BINS * len(line)))
    edges = line[0] + span * (np.arange(bins) / bins + 1e-9 / bins)
    guide = np.searchsorted(line, edges, side="right") - 1
    return Axis(line, guide.astype(np.int64), bins / span)
