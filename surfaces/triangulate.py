"""Triangle meshes from height fields and other sheets of points."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes

from .parameters import Floats


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
