"""Sea surfaces: the base class with its mesh, planes, and sums of plane waves, linear or not.

Each point of a choppy sheet moves on its orbit about a label r = (x0, y0):

    x = r + D(r, t),  z = eta(r, t) + s,  D = sum a k^ sin(phi) = grad sum (a / k) cos(phi)

with the elevation eta = sum a cos(phi) of the linear sea, phi = omega t - k . r + phase, and
k^ = k / |k|. Under crests the labels are drawn together: crests are sharp and troughs are flat.

Bound waves are the second order of a deep-water sea at fixed points, as further plane waves.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PrivateAttr

from meshtrace.errors import Described, Refused, require_pair
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes
from meshtrace.models import Family
from meshtrace.parallel import announce

from .parameters import TIME, Depth, Finite, Floats, Positive, grid_lines, points
from .triangulate import GridLines, height_field, mesh_of_sheet
from .waves import (
    WaveComponents,
    WaveGrid,
    angular_frequency,
    elevation_and_slopes,
    grid_store,
    sum_elevation,
    sum_second_derivatives,
    sum_slopes,
)

_TOLERANCE = 1e-12  # [m], of a label
_ROUNDING = 1e-14  # of a position, relative
_STEPS = 60
_RARE = 6.0  # standard deviations that no displacement exceeds


class Sheet(NamedTuple):
    """The sheet at some labels: positions and their derivatives.

    Parameters
    ----------
    x, y, z : ndarray
        Positions [m].
    zx, zy : ndarray
        Derivatives of the elevation by the labels.
    dxx, dxy, dyy : ndarray
        Derivatives of the displacement D by the labels.
    """

    x: Floats
    y: Floats
    z: Floats
    zx: Floats
    zy: Floats
    dxx: Floats
    dxy: Floats
    dyy: Floats

    @property
    def jacobian(self) -> Floats:
        """Ratio of horizontal areas, map over labels, J = (1 + Dxx)(1 + Dyy) - Dxy^2."""
        return (1.0 + self.dxx) * (1.0 + self.dyy) - self.dxy**2

    @property
    def slopes(self) -> tuple[Floats, Floats]:
        """Slopes dz/dx and dz/dy at the positions, -N_x / J and -N_y / J."""
        area = self.jacobian
        along_x, along_y = _adjugate(self.dxx, self.dxy, self.dyy, self.zx, self.zy)
        return along_x / area, along_y / area

    @property
    def normals(self) -> Floats:
        """Unit normals, shape (..., 3), of the cross product of both tangents.

        N = (Dxy zy - zx (1 + Dyy), Dxy zx - zy (1 + Dxx), J)
        """
        along_x, along_y = _adjugate(self.dxx, self.dxy, self.dyy, self.zx, self.zy)
        normal = np.stack([-along_x, -along_y, self.jacobian], axis=-1)
        return normal / np.linalg.norm(normal, axis=-1, keepdims=True)

    def require_single(self) -> Sheet:
        """Return the sheet; refuse a self-intersecting one."""
        area = self.jacobian
        lowest = int(np.argmin(area)) if area.size else 0
        if area.size and not area.flat[lowest] > 0.0:
            place = f"({self.x.flat[lowest]:.6g}, {self.y.flat[lowest]:.6g}) m"
            found = Described(f"J = {area.flat[lowest]:.3g} at {place}")
            allowed = "J > 0: the waves are too steep; lower omega_max or choppy = false"
            raise Refused("choppy", found, allowed)
        return self


class ChoppyWaves:
    """A sum of plane waves of first order in Lagrangian coordinates.

    Parameters
    ----------
    waves : WaveComponents
        The plane waves, over the labels.
    depth : float, optional
        Water depth [m]: orbits are a / tanh(k depth) wide; None is deep water, circles.

    Notes
    -----
    The mean of eta over the *map*, where a label counts by its area J, is -sum a^2 k / 2: points
    under crests are closer together. `rise` adds it, so that still water stays at z = 0.
    """

    def __init__(self, waves: WaveComponents, depth: float | None = None) -> None:
        k = np.hypot(waves.kx, waves.ky)
        width = waves.amplitude if depth is None else waves.amplitude / np.tanh(k * depth)
        self._waves = waves
        self._potential = waves._replace(amplitude=width / k)
        self._towards_x = self._potential.amplitude * waves.kx
        self._towards_y = self._potential.amplitude * waves.ky
        self.rise = 0.5 * float(np.sum(waves.amplitude * width * k))
        rms = math.sqrt(0.5 * float(np.sum(width**2)))
        self.reach = min(_RARE * rms, float(np.sum(np.abs(width))))

    def on_grid(self, grid: WaveGrid, x_axis: Floats, y_axis: Floats, time: float) -> Sheet:
        """Return the sheet of the labels of a tensor grid, shapes (nx, ny)."""
        kx, ky = self._waves.kx, self._waves.ky
        turn = np.exp(1j * (self._waves.omega * time + self._waves.phase))
        towards_x, towards_y = self._towards_x * turn, self._towards_y * turn
        # d/dx cos(phi) = kx sin(phi) = Re(-i kx exp(i phi))
        moved = -1j * towards_x, -1j * towards_y, -kx * towards_x, -ky * towards_x, -ky * towards_y
        weights = np.concatenate([elevation_and_slopes(self._waves, time), moved])
        z, zx, zy, dx, dy, dxx, dxy, dyy = grid.sum(weights)
        x, y = x_axis[:, None] + dx, y_axis + dy
        return Sheet(x, y, z + self.rise, zx, zy, dxx, dxy, dyy).require_single()

    def at(self, x: Floats, y: Floats, time: float) -> Sheet:
        """Return the sheet at fixed points of the map, shape of x."""
        r = self.labels(x, y, time)
        return self._over(*r, time).require_single()

    def _over(self, x: Floats, y: Floats, time: float) -> Sheet:
        """Return the sheet of some labels."""
        dx, dy = sum_slopes(self._potential, x, y, time)
        z = sum_elevation(self._waves, x, y, time) + self.rise
        slopes = sum_slopes(self._waves, x, y, time)
        return Sheet(
            x + dx, y + dy, z, *slopes, *sum_second_derivatives(self._potential, x, y, time)
        )

    def second_derivatives(
        self, x: Floats, y: Floats, time: float
    ) -> tuple[Floats, Floats, Floats]:
        """Return the second derivatives zxx, zxy, zyy [m-1] at fixed points of the map.

        H = M^-1 (Hess eta - s_x Hess D_x - s_y Hess D_y) M^-1,  M = I + grad D
        """
        r = self.labels(x, y, time)
        sheet = self._over(*r, time).require_single()
        quarter = self._potential.phase - 0.5 * math.pi  # d/dx cos(phi) = kx cos(phi - pi/2)
        bent = np.stack(sum_second_derivatives(self._waves, *r, time))
        for slope, towards in zip(sheet.slopes, (self._towards_x, self._towards_y), strict=True):
            part = self._potential._replace(amplitude=towards, phase=quarter)
            bent = bent - slope * np.stack(sum_second_derivatives(part, *r, time))
        p, q, o = 1.0 + sheet.dyy, 1.0 + sheet.dxx, -sheet.dxy  # of the inverse of M, times J
        xx, xy, yy = bent / sheet.jacobian**2
        return (
            p * p * xx + 2.0 * p * o * xy + o * o * yy,
            p * o * xx + (p * q + o * o) * xy + o * q * yy,
            o * o * xx + 2.0 * o * q * xy + q * q * yy,
        )

    def labels(self, x: Floats, y: Floats, time: float) -> tuple[Floats, Floats]:
        """Return the labels of fixed points, r + D(r) = (x, y).

        Raises
        ------
        Refused
            If there is no label within 1e-12 m after 60 steps.

        Notes
        -----
        r <- (x, y) - D(r) once, then Newton's method; a step that leads away is halved. Where
        J > 0, grad D is symmetric and I + grad D positive definite, hence the label unique.
        """
        target = np.stack([np.ravel(x), np.ravel(y)], axis=1)
        r, step = target.copy(), self._displacement(target, time)
        error = np.full(len(r), np.inf)
        enough = _TOLERANCE + _ROUNDING * np.abs(target).max(axis=1, initial=0.0)
        open_ = np.arange(len(r))
        for _ in range(_STEPS):
            trial = r[open_] - step[open_]
            miss = trial + self._displacement(trial, time) - target[open_]
            size = np.hypot(*miss.T)
            nearer = size < error[open_]
            ahead = open_[nearer]
            r[ahead], error[ahead] = trial[nearer], size[nearer]
            step[ahead] = self._newton_step(trial[nearer], miss[nearer], time)
            step[open_[~nearer]] *= 0.5
            open_ = open_[error[open_] > enough[open_]]
            if not open_.size:
                return r[:, 0].reshape(np.shape(x)), r[:, 1].reshape(np.shape(x))
        place = f"({target[open_[0], 0]:.6g}, {target[open_[0], 1]:.6g}) m"
        allowed = "waves with one point of the sheet over each place; lower omega_max"
        raise Refused("choppy", Described(f"no label of {place}"), allowed)

    def _displacement(self, r: Floats, time: float) -> Floats:
        return np.stack(sum_slopes(self._potential, r[:, 0], r[:, 1], time), axis=1)

    def _newton_step(self, r: Floats, miss: Floats, time: float) -> Floats:
        """Return (I + grad D)^-1 miss, or the miss itself for a folded sheet."""
        dxx, dxy, dyy = sum_second_derivatives(self._potential, r[:, 0], r[:, 1], time)
        area = (1.0 + dxx) * (1.0 + dyy) - dxy**2
        upright = (area > 0.0) & (dxx > -1.0)
        newton = np.stack(_adjugate(dxx, dxy, dyy, *miss.T), axis=1)
        return np.where(upright[:, None], newton / np.where(upright, area, 1.0)[:, None], miss)


def _adjugate(dxx: Floats, dxy: Floats, dyy: Floats, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the adjugate of I + grad D times a vector."""
    return (1.0 + dyy) * x - dxy * y, (1.0 + dxx) * y - dxy * x


def with_straight_rim(points: Floats) -> Floats:
    """Return the points of a sheet, shape (nx, ny, 3), with the rim moved out to a rectangle.

    The mesh then covers its bounds: no light passes between both. Facets at the rim are stretched.
    """
    points = points.copy()
    for axis in (0, 1):
        rows = np.moveaxis(points, axis, 0)
        rows[0, :, axis], rows[-1, :, axis] = rows[..., axis].min(), rows[..., axis].max()
    return points


NEGLIGIBLE = 1e-4
"""Share of the variance of the bound waves, in elevation and in curvature, that is left out."""

MOST_PAIRS = 4_000_000
"""Bound waves before the small ones are left out, beyond which a sea is refused."""


def interaction_kernels(
    kx: ArrayLike, ky: ArrayLike, other_kx: ArrayLike, other_ky: ArrayLike
) -> tuple[Floats, Floats]:
    r"""Return the kernels K- and K+ [rad m-1] of pairs of deep-water waves.

    .. math::

       K^\mp = (D^\mp - (k_i \cdot k_j \pm k_i k_j)) / \sqrt{k_i k_j} + k_i + k_j, \quad
       D^\mp = \frac{2 (\sqrt{k_i} \mp \sqrt{k_j})^2 (k_i \cdot k_j \pm k_i k_j)}
                    {(\sqrt{k_i} \mp \sqrt{k_j})^2 - |\vec k_i \mp \vec k_j|}

    Parameters
    ----------
    kx, ky : array_like
        Wave vectors of the first waves [rad m-1], not zero.
    other_kx, other_ky : array_like
        Wave vectors of the second waves [rad m-1], not zero; all are broadcast.

    Returns
    -------
    k_minus, k_plus : ndarray
        Kernels of the difference and of the sum wave. K- is 0 for equal wave vectors: there is
        no change of the mean level. Waves of one direction have K+ = ki + kj and
        K- = -\|ki - kj\|.

    Notes
    -----
    Gravity waves, omega^2 = g k.

    References
    ----------
    Longuet-Higgins (1963), J. Fluid Mech. 17, 459-480. Sharma and Dean (1981), Soc. Petroleum
    Eng. J. 21, 129-140.

    Examples
    --------
    >>> minus, plus = interaction_kernels(1.0, 0.0, 0.5, 0.0)
    >>> round(float(minus), 12), round(float(plus), 12)
    (-0.5, 1.5)
    """
    kx, ky, px, py = (np.asarray(a, dtype=np.float64) for a in (kx, ky, other_kx, other_ky))
    ki, kj = np.hypot(kx, ky), np.hypot(px, py)
    dot, product = kx * px + ky * py, ki * kj
    root, linear = np.sqrt(product), ki + kj
    kernels = []
    for sign in (-1.0, 1.0):
        beat = (np.sqrt(ki) + sign * np.sqrt(kj)) ** 2
        bottom = beat - np.hypot(kx + sign * px, ky + sign * py)
        projected = dot - sign * product
        # equal waves: 0 / 0, whose limit is 0
        ratio = np.divide(beat, bottom, out=np.zeros_like(bottom), where=bottom != 0.0)
        kernels.append((2.0 * ratio - 1.0) * projected / root + linear)
    return kernels[0], kernels[1]


def with_bound_waves(free: WaveComponents, omega_max: float, most: int) -> WaveComponents:
    r"""Return waves with the bound waves of all pairs of them up to a frequency.

    .. math::

       \eta_2 = \tfrac14 \sum_{ij} a_i a_j [K^-_{ij} \cos(\phi_i - \phi_j)
                + K^+_{ij} \cos(\phi_i + \phi_j)]

    Parameters
    ----------
    free : WaveComponents
        The waves of first order.
    omega_max : float
        Highest frequency of a wave of a pair [rad s-1].
    most : int
        Largest number of bound waves.

    Returns
    -------
    WaveComponents
        The free waves and then the bound ones, with signed amplitudes.

    Raises
    ------
    Refused
        If there are too many bound waves.

    Notes
    -----
    The smallest bound waves are left out, as long as they carry 1e-4 of the variance of the
    elevation *and* of the curvature (a^2 and a^2 k^4) of all bound waves. This depends on the
    amplitudes alone: seas that differ in phases have the same bound waves.
    """
    chosen = np.flatnonzero((free.amplitude != 0.0) & (free.omega <= omega_max))
    n = len(chosen)
    if n * (n + 1) > MOST_PAIRS:
        found = Described(f"{omega_max:g} rad/s makes {n * (n + 1)} bound waves")
        raise Refused("order_omega_max", found, f"at most {MOST_PAIRS}, small ones included")
    first, second = (chosen[index] for index in np.triu_indices(n))
    k_minus, k_plus = interaction_kernels(
        free.kx[first], free.ky[first], free.kx[second], free.ky[second]
    )
    product = 0.5 * free.amplitude[first] * free.amplitude[second]
    pairs = (1.0, np.where(first == second, 0.5, 1.0) * k_plus), (-1.0, k_minus)
    parts = []
    for sign, kernel in pairs:
        bound = WaveComponents(product * kernel, *(a[first] + sign * a[second] for a in free[1:]))
        # cos is even: the frequency of a difference wave is made positive
        turn = np.where(bound.omega < 0.0, -1.0, 1.0)
        parts.append(WaveComponents(bound.amplitude, *(turn * a for a in bound[1:])))
    bound = WaveComponents(*(np.concatenate(pair) for pair in zip(*parts, strict=True)))
    relevant = np.zeros(len(bound.amplitude), dtype=bool)
    for power in (0, 2):
        share = bound.amplitude**2 * (bound.kx**2 + bound.ky**2) ** power
        order = np.argsort(share, kind="stable")
        small = np.cumsum(share[order]) <= NEGLIGIBLE * share.sum()
        relevant[order[~small]] = True
    kept = np.flatnonzero(relevant & (bound.amplitude != 0.0))
    if len(kept) > most:
        found = Described(f"{omega_max:g} rad/s makes {len(kept)} bound waves")
        raise Refused("order_omega_max", found, f"at most {most} bound waves")
    return WaveComponents(*(np.concatenate([a, b[kept]]) for a, b in zip(free, bound, strict=True)))


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
            x_axis, y_axis = map(lines.widened(reach).axis, center)
        self._require_modest(x_axis, y_axis)
        vertices, normals = self.sheet(x_axis, y_axis, time)
        if reach is not None:
            _require_upward(vertices, spacing)
            vertices = with_straight_rim(vertices)
        return mesh_of_sheet(vertices, normals, self.unresolved_slopes(spacing))

    def _reach(self, spacing: float) -> float | None:
        """Return how far labels move sideways at most [m], None if they do not."""
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
        arrays = self.components.kx, self.components.ky, x_axis, y_axis
        return self._grids(*(array.tobytes() for array in arrays))

    @cached_property
    def _sheet(self) -> ChoppyWaves:
        return ChoppyWaves(self.components, self._water_depth())

    def _at(self, x: ArrayLike, y: ArrayLike, time: float) -> Sheet:
        """Return the choppy sheet at fixed points."""
        x, y = points(x, y)
        return self._sheet.at(x, y, TIME.check(time))

    def elevation(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> Floats:
        """Return z [m]; see `Surface.elevation`."""
        if self.choppy:
            return self._at(x, y, time).z
        return sum_elevation(self.components, x, y, TIME.check(time))

    def slopes(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> tuple[Floats, Floats]:
        """Return dz/dx and dz/dy; see `Surface.slopes`."""
        if self.choppy:
            return self._at(x, y, time).slopes
        return sum_slopes(self.components, x, y, TIME.check(time))

    def second_derivatives(
        self, x: ArrayLike, y: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return the second derivatives zxx, zxy, zyy [m-1]; arguments as for `elevation`."""
        if self.choppy:
            x, y = points(x, y)
            return self._sheet.second_derivatives(x, y, TIME.check(time))
        return sum_second_derivatives(self.components, x, y, TIME.check(time))

    def grid(
        self, x_axis: ArrayLike, y_axis: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return z [m], dz/dx and dz/dy on a tensor grid; see `Surface.grid`."""
        if self.choppy:
            at = self._at(*np.meshgrid(*grid_lines(x_axis, y_axis), indexing="ij"), time)
            return at.z, *at.slopes
        weights = elevation_and_slopes(self.components, TIME.check(time))
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
        sheet = self._sheet.on_grid(grid, x_axis, y_axis, TIME.check(time))
        return np.stack([sheet.x, sheet.y, sheet.z], axis=-1), sheet.normals

    def _require_modest(self, x_axis: Floats, y_axis: Floats) -> None:
        """Refuse a mesh that would fill the memory; announce one that takes long."""
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
    """Refuse a single sheet with facets too large to face up."""
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
        """The one wave as arrays of length one."""
        k = 2.0 * math.pi / self.wavelength
        omega = float(angular_frequency(k, self.depth, self.capillary))
        heading = math.radians(self.direction_deg)
        wave = self.amplitude, omega, k * math.cos(heading), k * math.sin(heading), self.phase
        return WaveComponents(*(np.array([value]) for value in wave))
