"""Nonlinear waves: choppy seas, and the bound waves of second order.

Each point of a choppy sheet moves on its orbit about a label r = (x0, y0):

    x = r + D(r, t),  z = eta(r, t) + s,  D = sum a k^ sin(phi) = grad sum (a / k) cos(phi)

with the elevation eta = sum a cos(phi) of the linear sea, phi = omega t - k . r + phase, and
k^ = k / |k|. Under crests the labels are drawn together: crests are sharp and troughs are flat.

Bound waves are the second order of a deep-water sea at fixed points, as further plane waves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.checks import check_call
from meshtrace.errors import Described, Refused

from .parameters import Floats
from .waves import WaveComponents, WaveGrid, elevation_and_slopes, sum_waves, wave_weights

_TOLERANCE = 1e-12  # [m], of a label
_ROUNDING = 1e-14  # of a position, relative
_STEPS = 60
_RARE = 6.0  # standard deviations that no displacement exceeds


class Sheet(NamedTuple):
    """Sheet of a choppy sea at given labels: positions and their derivatives.

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
            reason = Described(f"J = {area.flat[lowest]:.3g} at {place}")
            allowed = "J > 0: the waves are too steep; lower omega_max or choppy = false"
            raise Refused("choppy", reason, allowed)
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
        self.rise = 0.5 * float(np.sum(waves.amplitude * width * k))
        rms = math.sqrt(0.5 * float(np.sum(width**2)))
        self.reach = min(_RARE * rms, float(np.sum(np.abs(width))))

    def on_grid(self, grid: WaveGrid, x_axis: Floats, y_axis: Floats, time: float) -> Sheet:
        """Return the sheet of the labels of a tensor grid, shapes (nx, ny)."""
        moved = (wave_weights(self._potential, order, time) for order in (1, 2))
        weights = np.concatenate([elevation_and_slopes(self._waves, time), *moved])
        z, zx, zy, dx, dy, dxx, dxy, dyy = grid.sum(weights)
        x, y = x_axis[:, None] + dx, y_axis + dy
        return Sheet(x, y, z + self.rise, zx, zy, dxx, dxy, dyy).require_single()

    def at(self, x: Floats, y: Floats, time: float) -> Sheet:
        """Return the sheet at fixed points of the map, shape of x."""
        r = self.labels(x, y, time)
        return self._over(*r, time).require_single()

    def _over(self, x: Floats, y: Floats, time: float) -> Sheet:
        """Return the sheet at labels."""
        dx, dy = sum_waves(self._potential, 1, x, y, time)
        (z,), slopes = (sum_waves(self._waves, order, x, y, time) for order in (0, 1))
        bent = sum_waves(self._potential, 2, x, y, time)
        return Sheet(x + dx, y + dy, z + self.rise, *slopes, *bent)

    def second_derivatives(
        self, x: Floats, y: Floats, time: float
    ) -> tuple[Floats, Floats, Floats]:
        """Return the second derivatives zxx, zxy, zyy [m-1] at fixed points of the map.

        H = M^-1 (Hess eta - s_x Hess D_x - s_y Hess D_y) M^-1,  M = I + grad D
        """
        r = self.labels(x, y, time)
        sheet = self._over(*r, time).require_single()
        quarter = self._potential.phase - 0.5 * math.pi  # d/dx cos(phi) = kx cos(phi - pi/2)
        bent = np.stack(sum_waves(self._waves, 2, *r, time))
        for slope, k in zip(sheet.slopes, (self._waves.kx, self._waves.ky), strict=True):
            towards = self._potential.amplitude * k
            part = self._potential._replace(amplitude=towards, phase=quarter)
            bent = bent - slope * np.stack(sum_waves(part, 2, *r, time))
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
        # far from the origin positions are rounded by more than the tolerance
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
            # a step that leads away is halved from the same point
            step[open_[~nearer]] *= 0.5
            open_ = open_[error[open_] > enough[open_]]
            if not open_.size:
                return r[:, 0].reshape(np.shape(x)), r[:, 1].reshape(np.shape(x))
        place = f"({target[open_[0], 0]:.6g}, {target[open_[0], 1]:.6g}) m"
        allowed = "waves with one point of the sheet over each place; lower omega_max"
        raise Refused("choppy", Described(f"no label of {place}"), allowed)

    def _displacement(self, r: Floats, time: float) -> Floats:
        return np.stack(sum_waves(self._potential, 1, r[:, 0], r[:, 1], time), axis=1)

    def _newton_step(self, r: Floats, miss: Floats, time: float) -> Floats:
        """Return (I + grad D)^-1 miss, or the miss itself for a folded sheet."""
        dxx, dxy, dyy = sum_waves(self._potential, 2, r[:, 0], r[:, 1], time)
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
        lines = np.moveaxis(points, axis, 0)
        lines[0, :, axis], lines[-1, :, axis] = lines[..., axis].min(), lines[..., axis].max()
    return points


NEGLIGIBLE = 1e-4
"""Share of the variance of the bound waves, in elevation and in curvature, that is left out."""

MOST_PAIRS = 4_000_000
"""Bound waves before the small ones are left out, beyond which a sea is refused."""


@check_call
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


@check_call
def with_bound_waves(free: WaveComponents, omega_max: float, most: int) -> WaveComponents:
    r"""Add the bound waves of all pairs up to a frequency.

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
    # n (n + 1) / 2 pairs, each with a sum and a difference
    if n * (n + 1) > MOST_PAIRS:
        reason = Described(f"{omega_max:g} rad/s makes {n * (n + 1)} bound waves")
        raise Refused("order_omega_max", reason, f"at most {MOST_PAIRS}, small ones included")
    first, second = (chosen[index] for index in np.triu_indices(n))
    k_minus, k_plus = interaction_kernels(
        free.kx[first], free.ky[first], free.kx[second], free.ky[second]
    )
    product = 0.5 * free.amplitude[first] * free.amplitude[second]
    # a pair stands for (i, j) and (j, i) of the equation; a wave with itself occurs once
    pairs = (1.0, np.where(first == second, 0.5, 1.0) * k_plus), (-1.0, k_minus)
    parts = []
    for sign, kernel in pairs:
        bound = WaveComponents(product * kernel, *(a[first] + sign * a[second] for a in free[1:]))
        # cos is even: the frequency of a difference wave is made positive
        turn = np.where(bound.omega < 0.0, -1.0, 1.0)
        parts.append(WaveComponents(bound.amplitude, *(turn * a for a in bound[1:])))
    bound = WaveComponents(*(np.concatenate(pair) for pair in zip(*parts, strict=True)))
    relevant = np.zeros(len(bound.amplitude), dtype=bool)
    # in elevation and in curvature: a^2 and a^2 k^4
    for power in (0, 2):
        share = bound.amplitude**2 * (bound.kx**2 + bound.ky**2) ** power
        order = np.argsort(share, kind="stable")
        small = np.cumsum(share[order]) <= NEGLIGIBLE * share.sum()
        relevant[order[~small]] = True
    relevant_pairs = np.flatnonzero(relevant & (bound.amplitude != 0.0))
    if len(relevant_pairs) > most:
        reason = Described(f"{omega_max:g} rad/s makes {len(relevant_pairs)} bound waves")
        raise Refused("order_omega_max", reason, f"at most {most} bound waves")
    return WaveComponents(
        *(np.concatenate([a, b[relevant_pairs]]) for a, b in zip(free, bound, strict=True))
    )
