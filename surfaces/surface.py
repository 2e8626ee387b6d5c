"""Sea surfaces: the base class, planes, and sums of plane waves, linear or choppy."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PrivateAttr

from meshtrace.errors import Described, Refused, require_pair
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes
from meshtrace.models import Family
from meshtrace.parallel import announce

from .nonlinear import ChoppyWaves, Sheet, with_straight_rim
from .parameters import Depth, Finite, Floats, Positive, grid_lines, points
from .triangulate import GridLines, height_field, mesh_of_sheet
from .waves import (
    WaveComponents,
    WaveGrid,
    angular_frequency,
    elevation_and_slopes,
    flat_components,
    grid_store,
    sum_waves,
)

MOST_VERTICES = 10_000_000
"""Vertices of a mesh beyond which it is refused."""

VERTEX_BYTES = 500
"""Memory that a mesh and its creation take for a vertex."""

_LONG = 20.0  # [s]
_SUMS, _CHOPPY_SUMS = 3, 8  # of a mesh


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
        x_axis, y_axis = map(lines.axis, center)
        reach = self._reach(spacing)
        if reach is not None:
            # points of a choppy sea come in from labels beyond the square
            x_axis, y_axis = map(lines.widened(reach).axis, center)
        self._require_modest(x_axis, y_axis)
        vertices, normals = self.sheet(x_axis, y_axis, time)
        if reach is not None:
            _require_upward(vertices, spacing)
            vertices = with_straight_rim(vertices)
        return mesh_of_sheet(vertices, normals, self.unresolved_slopes(spacing))

    def _reach(self, spacing: float) -> float | None:
        """Return the largest horizontal displacement of labels [m], None if they stay."""
        return None

    def _require_modest(self, x_axis: Floats, y_axis: Floats) -> None:
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
        """Slopes (dz/dx, dz/dy) of the plane; 0 by default."""
        return 0.0, 0.0

    def elevation(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> Floats:
        """Return z [m]; see `Surface.elevation`."""
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


class WaveSurface(Surface, frozen=True):
    """Base of the sums of plane waves: a subclass defines the components.

    z = sum a cos(omega t - kx x - ky y + phase)

    Parameters
    ----------
    choppy : bool
        Take the sum as first order in Lagrangian coordinates: points move sideways on their
        orbits, too, which sharpens the crests. See Notes.

    Raises
    ------
    Refused
        By `mesh`, `elevation` and `slopes`, if the sheet of a choppy sea passes through itself.

    Notes
    -----
    With `choppy` the point of the label r = (x0, y0) sits at (r + D, eta(r) + s) with
    D = sum a k^ sin(phi), the sum eta of all waves and s = sum a^2 k / 2, by which still water
    stays at z = 0 (k^ = k / |k|; in water of finite depth D is wider by 1 / tanh(k depth)). To
    second order in the slopes the elevation of a random sea has the mean 0, the variance of the
    linear sea and no skewness: sets of waves lie deeper. Crests are sharper rather than higher: the
    curvature at the crest of one wave is -a k^2 / (1 - a k)^2. The spectrum at fixed points differs
    a little from that of the components, and is not corrected: the slope variance is larger by
    0.4 % in the paper's band at 5 m/s, and by 2 % at 13 m/s up to 9 rad/s. The sheet is single as
    long as J > 0, the ratio of an area of the map to that of its labels; else it is refused.
    The labels of its meshes reach farther than `extent` and `fine_extent`, by the largest
    displacement (the sum of the amplitudes, or 6 standard deviations), so that a mesh covers
    both; the outermost points are moved onto a rectangle.

    On tensor grids (`grid`, `mesh`) the sum is a non-uniform FFT, see `waves.WaveGrid`. The
    plans that depend on the grid alone are kept for the last grids used, so that time steps
    and new phases are cheap. The digits of a mesh do not depend on the number of threads.

    References
    ----------
    Nouguier, Guerin and Chapron (2009), doi:10.1029/2008JC004984.
    """

    choppy: bool = False

    _grids: Callable[..., WaveGrid] = PrivateAttr(default_factory=grid_store)

    @property
    @abstractmethod
    def components(self) -> WaveComponents:
        """The plane waves as plain arrays."""

    def _water_depth(self) -> float | None:
        return getattr(self, "depth", None)

    def _grid(self, x_axis: Floats, y_axis: Floats) -> WaveGrid:
        """Return the sums of these waves on a tensor grid, planned on first use."""
        # bytes, since arrays are no keys of a cache
        arrays = self.components.kx, self.components.ky, x_axis, y_axis
        return self._grids(*(array.tobytes() for array in arrays))

    @cached_property
    def _sheet(self) -> ChoppyWaves:
        return ChoppyWaves(self.components, self._water_depth())

    def _at(self, x: ArrayLike, y: ArrayLike, time: float) -> Sheet:
        """Return the choppy sheet at fixed points."""
        return self._sheet.at(*points(x, y), time)

    def elevation(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> Floats:
        """Return z [m]; see `Surface.elevation`."""
        if self.choppy:
            return self._at(x, y, time).z
        return sum_waves(self.components, 0, x, y, time)[0]

    def slopes(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> tuple[Floats, Floats]:
        """Return dz/dx and dz/dy; see `Surface.slopes`."""
        if self.choppy:
            return self._at(x, y, time).slopes
        zx, zy = sum_waves(self.components, 1, x, y, time)
        return zx, zy

    def second_derivatives(
        self, x: ArrayLike, y: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return the second derivatives zxx, zxy, zyy [m-1]; arguments as for `elevation`."""
        if self.choppy:
            return self._sheet.second_derivatives(*points(x, y), time)
        zxx, zxy, zyy = sum_waves(self.components, 2, x, y, time)
        return zxx, zxy, zyy

    def grid(
        self, x_axis: ArrayLike, y_axis: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return z [m], dz/dx and dz/dy on a tensor grid; see `Surface.grid`."""
        if self.choppy:
            # fixed points have labels that lie on no tensor grid: the sums are taken point by point
            at = self._at(*np.meshgrid(*grid_lines(x_axis, y_axis), indexing="ij"), time)
            return at.z, *at.slopes
        weights = elevation_and_slopes(self.components, time)
        z, zx, zy = self._grid(*grid_lines(x_axis, y_axis)).sum(weights)
        return z, zx, zy

    def sheet(
        self, x_axis: ArrayLike, y_axis: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats]:
        """Return points and normals; see `Surface.sheet`. A choppy sea moves the labels."""
        if not self.choppy:
            return super().sheet(x_axis, y_axis, time)
        x_axis, y_axis = grid_lines(x_axis, y_axis)
        grid = self._grid(x_axis, y_axis)
        sheet = self._sheet.on_grid(grid, x_axis, y_axis, time)
        return np.stack([sheet.x, sheet.y, sheet.z], axis=-1), sheet.normals

    def _require_modest(self, x_axis: Floats, y_axis: Floats) -> None:
        """Refuse a mesh too large for memory; announce a slow one."""
        super()._require_modest(x_axis, y_axis)
        waves, nx, ny = len(self.components.amplitude), len(x_axis), len(y_axis)
        seconds = self._grid(x_axis, y_axis).seconds
        memory = VERTEX_BYTES * nx * ny / 1e9
        size = f"{nx:,} by {ny:,} vertices from {waves:,} waves, some {memory:.2g} GB"
        announce((_CHOPPY_SUMS if self.choppy else _SUMS) * seconds, f"mesh of {size}", _LONG)

    def _reach(self, spacing: float) -> float | None:
        if not self.choppy:
            return None
        # whole spacings: the lines of meshes of half the spacing nest
        return math.ceil(self._sheet.reach / spacing) * spacing


def _require_upward(points: Floats, spacing: float) -> None:
    """Refuse a choppy sheet whose facets are so large that some face down."""
    x, y = points[..., 0], points[..., 1]
    ax, ay, bx, by = np.diff(x, axis=0), np.diff(y, axis=0), np.diff(x), np.diff(y)
    # twice the area of the triangles at each corner of the cells
    least = min(
        (ax[:, i] * by[j] - ay[:, i] * bx[j]).min()
        for i in (slice(None, -1), slice(1, None))
        for j in (slice(None, -1), slice(1, None))
    )
    if not least > 0.0:
        allowed = f"less than {spacing:g} m: facets of this choppy sea face down"
        raise Refused("spacing", Described(f"{spacing:g} m"), allowed)


class SinusoidalSea(WaveSurface, frozen=True):
    """One plane wave, z = amplitude cos(omega t - k (x cos d + y sin d) + phase).

    With `choppy` it is the wave of Gerstner, a trochoid.

    Parameters
    ----------
    amplitude : float
        Half the wave height [m], >= 0.
    wavelength : float
        Wavelength 2 pi / k [m].
    direction_deg : float
        Direction d the wave travels to, counter-clockwise from +x [deg].
    phase : float
        Phase at the origin and time 0 [rad].
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Add the surface tension to the dispersion.
    choppy : bool
        Trochoid, see `WaveSurface`: crests have the curvature -a k^2 / (1 - a k)^2, the steepest
        slope is a k / sqrt(1 - a^2 k^2), for a k < 1.

    Examples
    --------
    >>> wave = SinusoidalSea(amplitude=0.1, wavelength=2.0)
    >>> wave.elevation([0.0, 1.0, 2.0], 0.0).round(12)
    array([ 0.1, -0.1,  0.1])
    """

    kind: Literal["sinusoid"] = "sinusoid"
    amplitude: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    wavelength: Positive
    direction_deg: Finite = 0.0
    phase: Finite = 0.0
    depth: Depth | None = None
    capillary: bool = False

    @cached_property
    def components(self) -> WaveComponents:
        """The wave, as arrays of length one."""
        k = 2.0 * math.pi / self.wavelength
        omega = angular_frequency(k, self.depth, self.capillary)
        heading = math.radians(self.direction_deg)
        return flat_components(self.amplitude, omega, k, heading, self.phase)
