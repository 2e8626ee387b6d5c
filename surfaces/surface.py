"""Sea surfaces as height fields: the base class with its mesh, and the planes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import Described, Refused, require_pair
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes
from meshtrace.models import Family

from .parameters import TIME, Finite, Floats, grid_lines, points
from .triangulate import GridLines, height_field, mesh_of_sheet

MOST_VERTICES = 10_000_000
"""Vertices of a mesh beyond which it is refused."""

VERTEX_BYTES = 500
"""Memory that a mesh and its creation take for a vertex."""


class Surface(Family, ABC, frozen=True):
    """Base of the sea surfaces: a subclass defines elevation and slopes.

    The tensor grid, the mesh with its grading, and the conversion to and from plain data follow.

    Notes
    -----
    A subclass declares its parameters as annotated class attributes; see the guide
    "A surface of your own". Its slopes must be the exact derivatives of its elevation.
    """

    @abstractmethod
    def elevation(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> Floats:
        """Return the elevation z.

        Parameters
        ----------
        x, y : array_like
            Position [m], broadcast together.
        time : float
            Time [s].

        Returns
        -------
        ndarray
            z [m], broadcast shape.

        Raises
        ------
        Refused
            If an argument is not finite.
        """

    @abstractmethod
    def slopes(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> tuple[Floats, Floats]:
        """Return the slopes dz/dx and dz/dy; arguments as for `elevation`."""

    def grid(
        self, x_axis: ArrayLike, y_axis: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return elevation and slopes on a tensor grid.

        Parameters
        ----------
        x_axis : array_like, shape (nx,)
            Grid lines [m].
        y_axis : array_like, shape (ny,)
            Grid lines [m].
        time : float
            Time [s].

        Returns
        -------
        z, sx, sy : ndarray, shape (nx, ny)
            Elevation [m] and slopes at (x_axis[i], y_axis[j]).

        Raises
        ------
        Refused
            If an axis is not finite or has two dimensions.
        """
        x_axis, y_axis = grid_lines(x_axis, y_axis)
        x, y = np.meshgrid(x_axis, y_axis, indexing="ij")
        return self.elevation(x, y, time), *self.slopes(x, y, time)

    def sheet(
        self, x_axis: ArrayLike, y_axis: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats]:
        """Return the points of the surface and their normals for a tensor grid of labels.

        Parameters
        ----------
        x_axis : array_like, shape (nx,)
            Labels [m]; of a height field the positions themselves.
        y_axis : array_like, shape (ny,)
            Labels [m].
        time : float
            Time [s].

        Returns
        -------
        points, normals : ndarray, shape (nx, ny, 3)
            Positions [m], and unit normals that point to the air.
        """
        return height_field(x_axis, y_axis, *self.grid(x_axis, y_axis, time))

    def mesh(
        self,
        time: float = 0.0,
        extent: float = 20.0,
        spacing: float = 0.1,
        *,
        center: tuple[float, float] = (0.0, 0.0),
        fine_extent: float | None = None,
        coarse_spacing: float | None = None,
    ) -> TriangleMesh:
        """Triangulate the surface.

        Parameters
        ----------
        time : float
            Time [s].
        extent : float
            Half-length of the square |x - xc|, |y - yc| <= extent [m], covered exactly.
        spacing : float
            Largest distance of neighbouring grid lines [m].
        center : (float, float)
            Middle (xc, yc) of the square [m].
        fine_extent : float, optional
            Half-length [m] of the inner square where `spacing` holds; outside, the lines move
            apart by 10 % each. None keeps `spacing` everywhere.
        coarse_spacing : float, optional
            Largest distance of lines outside the inner square [m], by default 10 `spacing`.

        Returns
        -------
        TriangleMesh
            With n^2 vertices, n = ceil(2 extent / spacing) + 1 for a uniform grid, and the
            normals of the exact slopes at the vertices.

        Raises
        ------
        Refused
            If an argument is out of range, or there are more than 10 million vertices.

        Warns
        -----
        LongWork
            If a sum of waves will take more than 20 s, with the time and the memory.

        Examples
        --------
        >>> FlatSea().mesh(extent=1.0, spacing=0.5).vertices.shape
        (25, 3)
        """
        lines = GridLines(extent, spacing, fine_extent, coarse_spacing)
        require_pair(center, "center", "two coordinates [m]")
        return self._triangulated(time, center, lines)

    def _triangulated(
        self, time: float, center: tuple[float, float], lines: GridLines
    ) -> TriangleMesh:
        """Return the mesh of `mesh`."""
        x_axis, y_axis = map(lines.axis, center)
        self._require_modest(x_axis, y_axis, time)
        unresolved = self.unresolved_slopes(lines.spacing)
        return mesh_of_sheet(*self.sheet(x_axis, y_axis, time), unresolved)

    def _require_modest(self, x_axis: Floats, y_axis: Floats, time: float) -> None:
        """Refuse a mesh that would fill the memory, before its creation."""
        vertices = len(x_axis) * len(y_axis)
        if vertices > MOST_VERTICES:
            memory = VERTEX_BYTES * vertices / 1e9
            size = Described(f"{vertices:.3g} vertices, some {memory:.2g} GB")
            allowed = f"at most {MOST_VERTICES:,}; larger spacing or smaller extent"
            raise Refused("mesh", size, allowed)

    def unresolved_slopes(self, spacing: float) -> UnresolvedSlopes | None:
        """Return the slope variances not resolved by a mesh of this spacing [m].

        None, the default, refracts light at the mesh alone.
        """
        return None

    def to_config(self) -> dict[str, Any]:
        """Return kind and parameters as plain data for JSON or TOML; see `sea_from_config`."""
        return self.model_dump(mode="json", exclude_none=True)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a validated copy with some parameters replaced, and nothing cached."""
        return type(self).model_validate({**self.model_dump(), **(update or {})})

    def __eq__(self, other: object) -> bool:
        # cached factors are no part of a sea
        return isinstance(other, Surface) and self.model_dump() == other.model_dump()

    def __reduce__(self) -> tuple[Any, ...]:
        # parameters only, without megabytes of cached grid factors
        return type(self).model_validate, (self.to_config(),)


class _Plane(Surface, frozen=True):
    height: Finite = 0.0

    @property
    def gradient(self) -> tuple[float, float]:
        """Slopes (dz/dx, dz/dy) of the plane, level unless it has some."""
        return 0.0, 0.0

    def elevation(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> Floats:
        """Return z [m]; see `Surface.elevation`."""
        TIME.check(time)
        slope_x, slope_y = self.gradient
        x, y = points(x, y)
        return np.asarray(self.height + slope_x * x + slope_y * y)

    def slopes(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> tuple[Floats, Floats]:
        """Return the constant slopes dz/dx and dz/dy, in the shape of the elevation."""
        zero = np.zeros_like(self.elevation(x, y, time))
        return zero + self.gradient[0], zero + self.gradient[1]


class FlatSea(_Plane, frozen=True):
    """Still water, z = height.

    Parameters
    ----------
    height : float
        Elevation [m].

    Examples
    --------
    >>> float(FlatSea(height=0.5).elevation(3.0, -1.0))
    0.5
    """

    kind: Literal["flat"] = "flat"


class TiltedPlane(_Plane, frozen=True):
    """A plane at rest, z = height + slope_x x + slope_y y.

    Parameters
    ----------
    slope_x, slope_y : float
        Slopes dz/dx and dz/dy.
    height : float
        Elevation at the origin [m].

    Examples
    --------
    >>> float(TiltedPlane(slope_x=0.25).elevation(2.0, 5.0))
    0.5
    """

    kind: Literal["plane"] = "plane"
    slope_x: Finite
    slope_y: Finite = 0.0

    @property
    def gradient(self) -> tuple[float, float]:
        """Slopes (slope_x, slope_y)."""
        return self.slope_x, self.slope_y
