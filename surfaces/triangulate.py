"""Tensor grids, uniform or fine at the light, and the triangle meshes of sheets over them."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes

from .parameters import Floats, Range

MAX_LINES = 20_001
"""Most lines of one axis; a finer grid is most likely a typing error."""

GROWTH = 1.1
"""Ratio of neighbouring steps in the coarsening part of a graded grid."""

DEFAULT_COARSENING = 10.0
"""Largest step of a graded grid over its finest, unless given."""


class GridLines(NamedTuple):
    """Extent and spacing of the lines of an axis.

    Parameters
    ----------
    extent : float
        Half-length of the axis [m].
    spacing : float
        Largest distance of neighbouring lines [m], or of those in the fine part.
    fine_extent : float, optional
        Half-length of a fine part [m], outside of which the lines move apart.
    coarse_spacing : float, optional
        Largest distance of neighbouring lines outside of it [m], at least `spacing`; by default
        `DEFAULT_COARSENING` times `spacing`.
    """

    extent: float
    spacing: float
    fine_extent: float | None = None
    coarse_spacing: float | None = None

    def widened(self, reach: float) -> GridLines:
        """Return lines that reach farther by a length [m]."""
        fine = None if self.fine_extent is None else self.fine_extent + reach
        return self._replace(extent=self.extent + reach, fine_extent=fine)

    def axis(self, center: float = 0.0) -> Floats:
        """Return the grid lines about a centre [m].

        Returns
        -------
        ndarray, shape (n,)
            Increasing positions [m], symmetric about `center`, with lines at center -+ extent and
            at center -+ fine_extent. Equally spaced lines number ceil(2 extent / spacing) + 1;
            a fine part that is as long as the axis has them as well.

        Raises
        ------
        Refused
            If a number is out of range, `coarse_spacing` comes without `fine_extent`, or the axis
            would have more than `MAX_LINES` lines.

        Notes
        -----
        Where 2 extent / spacing is not an integer the lines move closer than `spacing`, never
        apart, so that the boundary is met. The steps outside the fine part follow
        spacing `GROWTH`^i up to `coarse_spacing` and are then shrunk by one common factor so
        that the last line meets the boundary.

        Examples
        --------
        >>> GridLines(1.0, 0.5).axis()
        array([-1. , -0.5,  0. ,  0.5,  1. ])
        >>> GridLines(2.0, 0.5, fine_extent=0.5).axis().round(2)
        array([-2.  , -1.45, -0.95, -0.5 ,  0.  ,  0.5 ,  0.95,  1.45,  2.  ])
        """
        extent, spacing, fine_extent, coarse_spacing = self
        for name, value, low in (("center", center, -math.inf), ("extent", extent, 0.0)):
            Range(name, low, unit="m").check(value)
        Range("spacing", 0.0, unit="m").check(spacing)
        if fine_extent is None and coarse_spacing is not None:
            raise Refused("coarse_spacing", coarse_spacing, "only with fine_extent")
        if fine_extent is not None:
            Range("fine_extent", 0.0, unit="m").check(fine_extent)
            coarse = DEFAULT_COARSENING * spacing if coarse_spacing is None else coarse_spacing
            Range("coarse_spacing", spacing, unit="m", closed=True).check(coarse)
            if fine_extent < extent:
                half = _graded(fine_extent, extent, spacing, coarse)
                return center + np.concatenate([-half[:0:-1], half])
        steps = _step_count(2.0 * extent, spacing)
        return center + extent * ((2.0 * np.arange(steps + 1) - steps) / steps)


@lru_cache(maxsize=8)
def _graded(fine_extent: float, extent: float, spacing: float, coarse_spacing: float) -> Floats:
    """Return the lines of a graded axis from its centre to its end [m]."""
    fine_steps = _step_count(fine_extent, spacing)
    inner = fine_extent * (np.arange(fine_steps + 1) / fine_steps)
    rest = extent - fine_extent
    ceiling = math.log(coarse_spacing / spacing) / math.log(GROWTH)
    # beyond the ceiling every step is a coarse one, which bounds their number
    most = _step_count(rest, spacing, ceiling + 1.0 + rest / coarse_spacing)
    outer = spacing * GROWTH ** np.minimum(np.arange(1, most + 1), ceiling)
    reach = np.cumsum(outer)
    needed = int(np.searchsorted(reach, rest * (1.0 - 1e-12))) + 1
    half = np.concatenate([inner, fine_extent + reach[:needed] * (rest / reach[needed - 1])])
    half[-1] = extent
    half.flags.writeable = False  # shared by the meshes of a series
    return half


def _step_count(length: float, spacing: float, enough: float = math.inf) -> int:
    """Return the number of steps over a length, or `enough` if that is fewer."""
    # The tolerance keeps 2 * 20 / 0.1 at 400 steps whatever the last bit of the quotient.
    steps = min(length / spacing * (1.0 - 1e-12), enough)
    if not steps < MAX_LINES - 1:
        allowed = f"at most {MAX_LINES} grid lines over {length:g} m"
        raise Refused("spacing", spacing, allowed)
    return max(1, math.ceil(steps))


def triangulate(
    x_axis: ArrayLike,
    y_axis: ArrayLike,
    z: ArrayLike,
    sx: ArrayLike,
    sy: ArrayLike,
    unresolved: UnresolvedSlopes | None = None,
) -> TriangleMesh:
    """Triangulate a height field on a tensor grid.

    Parameters
    ----------
    x_axis : array_like, shape (nx,)
        Increasing grid lines [m].
    y_axis : array_like, shape (ny,)
        Increasing grid lines [m].
    z : array_like, shape (nx, ny)
        Elevation [m] at (x_axis[i], y_axis[j]).
    sx, sy : array_like, shape (nx, ny)
        Slopes dz/dx and dz/dy.
    unresolved : UnresolvedSlopes, optional
        Slopes that the grid leaves out.

    Returns
    -------
    TriangleMesh
        nx ny vertices, vertex i ny + j at (x_axis[i], y_axis[j]), and 2 (nx - 1)(ny - 1) facets,
        counter-clockwise seen from the air; vertex normals (-sx, -sy, 1) / norm.

    Raises
    ------
    Refused
        If an axis is not strictly increasing or has fewer than two lines, or a shape is wrong.

    Notes
    -----
    Cell (i, j) is cut from (i, j) to (i + 1, j + 1) if i + j is even, and across otherwise. With
    one diagonal throughout, every cell would have its slope error of second order in the same
    direction, and a mirrored sea would not give the mirrored mesh; alternating cells do.

    Examples
    --------
    >>> flat = np.zeros((3, 2))
    >>> triangulate([0.0, 1.0, 2.0], [0.0, 1.0], flat, flat, flat).faces.tolist()
    [[0, 2, 3], [0, 3, 1], [2, 4, 3], [4, 5, 3]]
    """
    return mesh_of_sheet(*height_field(x_axis, y_axis, z, sx, sy), unresolved)


def height_field(
    x_axis: ArrayLike, y_axis: ArrayLike, z: ArrayLike, sx: ArrayLike, sy: ArrayLike
) -> tuple[Floats, Floats]:
    """Return points and unit normals, shapes (nx, ny, 3), of a height field; see `triangulate`."""
    x_axis, y_axis = increasing("x_axis", x_axis), increasing("y_axis", y_axis)
    shape = len(x_axis), len(y_axis)
    z, sx, sy = (np.asarray(a, dtype=np.float64) for a in (z, sx, sy))
    for name, array in (("z", z), ("sx", sx), ("sy", sy)):
        if array.shape != shape:
            raise Refused(name, array.shape, f"the shape {shape} of these axes")
    upward = 1.0 / np.sqrt(1.0 + sx**2 + sy**2)
    normals = np.stack([-sx * upward, -sy * upward, upward], axis=-1)
    return grid_points(x_axis, y_axis, z), normals


def mesh_of_sheet(
    points: Floats,
    normals: Floats,
    unresolved: UnresolvedSlopes | None = None,
    overhangs: bool = False,
) -> TriangleMesh:
    """Return the mesh of points and unit normals, shapes (nx, ny, 3); see `triangulate`."""
    faces = grid_faces(*points.shape[:2])
    flat = points.reshape(-1, 3), faces, normals.reshape(-1, 3)
    return TriangleMesh(*flat, unresolved, overhangs)


@lru_cache(maxsize=8)
def grid_faces(nx: int, ny: int) -> NDArray[np.int32]:
    """Return the facets of an nx by ny grid, shape (2 (nx - 1)(ny - 1), 3), see `triangulate`.

    The array is shared between meshes of one shape and therefore read-only.
    """
    corner = np.arange(nx * ny, dtype=np.int32).reshape(nx, ny)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    even = (np.add.outer(np.arange(nx - 1), np.arange(ny - 1)) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(even, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    faces = np.stack([first, second], axis=2).reshape(-1, 3)
    faces.flags.writeable = False
    return faces


def increasing(name: str, axis: ArrayLike) -> Floats:
    """Return grid lines as an array; refuse others than two or more increasing ones."""
    axis = np.asarray(axis, dtype=np.float64)
    if axis.ndim != 1 or len(axis) < 2 or not (np.diff(axis) > 0.0).all():
        raise Refused(name, Described(f"shape {axis.shape}"), "two or more increasing numbers [m]")
    return axis


def grid_points(x_axis: Floats, y_axis: Floats, z: Floats) -> Floats:
    """Return the points of a height field, shape (nx, ny, 3)."""
    return np.stack(np.broadcast_arrays(x_axis[:, None], y_axis, z), axis=-1)
