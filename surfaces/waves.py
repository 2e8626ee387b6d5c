"""Plane waves: their dispersion, and sums of them, by points and on tensor grids.

z = sum_i a_i cos(omega_i t - kx_i x - ky_i y + phase_i)

Every function of the dispersion takes `depth=None` for deep water and `capillary=True` to add
surface tension, omega^2 = (g k + T k^3) tanh(k depth).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused
from meshtrace.kernels.jit import entry

from .parameters import DEPTH, Floats, finite_array, points

GRAVITY = 9.81
"""Gravity g [m s-2]."""

CAPILLARY_WAVENUMBER = 370.0
"""Wavenumber k_m of the slowest wave [rad m-1] (Elfouhaily et al. 1997)."""

# 7.17e-5 m3 s-2 is clean sea water near 20 deg C: 0.0735 N/m over 1026 kg/m3.
KINEMATIC_TENSION = GRAVITY / CAPILLARY_WAVENUMBER**2
"""Surface tension over density T [m3 s-2]."""

_NEWTON_STEPS = 60


def angular_frequency(k: ArrayLike, depth: float | None = None, capillary: bool = False) -> Floats:
    """Return the angular frequency of a wave.

    omega = sqrt((g k + T k^3) tanh(k depth))

    Parameters
    ----------
    k : array_like
        Wavenumber [rad m-1], k >= 0.
    depth : float, optional
        Water depth [m]; None is deep water, tanh = 1.
    capillary : bool
        Add the surface tension T; it matters above some 30 rad/s.

    Returns
    -------
    ndarray
        Angular frequency [rad s-1], shape of `k`.

    Raises
    ------
    Refused
        If a wavenumber is negative or not finite, or the depth is not positive.

    Notes
    -----
    The default is the paper's approximation omega^2 = g k.

    Examples
    --------
    >>> round(float(angular_frequency(0.3907)), 4)
    1.9577
    """
    squared, _ = _squared_frequency(finite_array("k", k, 0.0), _checked(depth), capillary)
    return np.sqrt(squared)


def wavenumber(omega: ArrayLike, depth: float | None = None, capillary: bool = False) -> Floats:
    """Return the wavenumber of a wave, the inverse of `angular_frequency`.

    Parameters
    ----------
    omega : array_like
        Angular frequency [rad s-1], omega >= 0.
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Add the surface tension.

    Returns
    -------
    ndarray
        Wavenumber [rad m-1], shape of `omega`, to 1e-14 relative.

    Raises
    ------
    Refused
        If a frequency is negative or not finite, or the depth is not positive.

    Notes
    -----
    Newton's method from the start of Eckart (1952), k = k_deep / sqrt(tanh(k_deep depth)).

    Examples
    --------
    >>> round(float(wavenumber(1.0, depth=2.0)), 6)
    0.233726
    """
    omega = finite_array("omega", omega, 0.0)
    depth = _checked(depth)
    gravity_wave = omega**2 / GRAVITY
    if depth is None and not capillary:
        return gravity_wave
    moving = gravity_wave > 0.0
    target = omega[moving] ** 2
    k = gravity_wave[moving]
    if capillary:
        k = np.minimum(k, np.cbrt(target / KINEMATIC_TENSION))
    if depth is not None:
        k = k / np.sqrt(np.tanh(k * depth))
    result = np.zeros_like(omega)

    def step(k: Floats) -> Floats:
        squared, slope = _squared_frequency(k, depth, capillary)
        return (squared - target) / slope

    result[moving] = _newton(k, step)
    return result


def wavenumber_in_current(
    omega: ArrayLike,
    theta: ArrayLike,
    current: tuple[float, float] | None = None,
    depth: float | None = None,
    capillary: bool = False,
) -> Floats:
    """Return the wavenumber of a wave in a uniform current.

    sigma(k) + k (U_x cos theta + U_y sin theta) = omega, sigma(k) of `angular_frequency`

    Parameters
    ----------
    omega : array_like
        Angular frequency at a fixed point [rad s-1], omega >= 0.
    theta : array_like
        Direction the wave travels to, counter-clockwise from +x [rad]; broadcasts with `omega`.
    current : (float, float), optional
        Velocity (U_x, U_y) [m s-1]; None is still water.
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Add the surface tension.

    Returns
    -------
    ndarray
        Wavenumber [rad m-1], broadcast shape: the root that still water continues to, where
        the group speed over ground c_g + U.k / k is positive.

    Raises
    ------
    Refused
        If an opposing current stops a wave: there is no such root.

    Notes
    -----
    Newton's method from the root of still water. In deep water an opposing current stops waves
    beyond omega = -g / (4 U.k / k).

    Examples
    --------
    >>> float(wavenumber_in_current(1.0, 0.0, current=(1.0, 0.0)).round(6))
    0.08529
    """
    still = wavenumber(omega, depth, capillary)
    if current is None:
        return still
    omega, theta, k = np.broadcast_arrays(finite_array("omega", omega, 0.0), theta, still)
    along = current[0] * np.cos(theta) + current[1] * np.sin(theta)
    tiny = np.finfo(float).tiny

    def step(k: Floats) -> Floats:
        squared, slope = _squared_frequency(k, depth, capillary)
        sigma = np.sqrt(squared)
        rate = 0.5 * slope / np.maximum(sigma, tiny) + along
        stopped = (rate <= 0.0) & (k > 0.0)
        if stopped.any():
            first = np.argmax(stopped)
            wave = float(omega.flat[first]), np.degrees(np.asarray(theta).flat[first])
            problem = Described(f"{current} m/s")
            allowed = "a current that the wave of {:g} rad/s towards {:g} deg can pass"
            raise Refused("current", problem, allowed.format(*wave))
        return np.where(k > 0.0, (sigma + k * along - omega) / rate, 0.0)

    return _newton(k, step)


def phase_speed(k: ArrayLike, depth: float | None = None, capillary: bool = False) -> Floats:
    """Return the phase speed c = omega / k [m s-1] of waves of wavenumber `k` > 0 [rad m-1].

    Examples
    --------
    >>> round(float(phase_speed(370.0, capillary=True)), 4)  # the slowest wave
    0.2303
    """
    k = finite_array("k", k, np.finfo(float).tiny)
    return angular_frequency(k, depth, capillary) / k


def group_speed(k: ArrayLike, depth: float | None = None, capillary: bool = False) -> Floats:
    """Return the group speed c_g = d omega / d k [m s-1] of waves of wavenumber `k` > 0 [rad m-1].

    Examples
    --------
    >>> round(float(group_speed(0.4) / phase_speed(0.4)), 12)  # deep water
    0.5
    """
    k = finite_array("k", k, np.finfo(float).tiny)
    squared, slope = _squared_frequency(k, _checked(depth), capillary)
    return slope / (2.0 * np.sqrt(squared))


def _checked(depth: float | None) -> float | None:
    return None if depth is None else DEPTH.check(depth)


def _squared_frequency(k: Floats, depth: float | None, capillary: bool) -> tuple[Floats, Floats]:
    """Return omega^2 and its derivative by k."""
    tension = KINEMATIC_TENSION if capillary else 0.0
    deep = (GRAVITY + tension * k**2) * k
    deep_slope = GRAVITY + 3.0 * tension * k**2
    if depth is None:
        return deep, deep_slope
    tanh = np.tanh(k * depth)
    return deep * tanh, deep_slope * tanh + deep * depth * (1.0 - tanh**2)


def _newton(k: Floats, step: Callable[[Floats], Floats]) -> Floats:
    """Return k less the steps of Newton's method, until these are of rounding."""
    for _ in range(_NEWTON_STEPS):
        last = step(k)
        k = k - last
        if (np.abs(last) <= 1e-15 * k).all():
            break
    return k


_BLOCK = 2**20
_GRIDS_KEPT = 4
_PANEL = 128


class WaveComponents(NamedTuple):
    """Plane waves as plain arrays of one length, for compiled code.

    Parameters
    ----------
    amplitude : ndarray, shape (n,)
        Amplitudes a [m].
    omega : ndarray, shape (n,)
        Angular frequencies [rad s-1].
    kx, ky : ndarray, shape (n,)
        Wave vectors [rad m-1].
    phase : ndarray, shape (n,)
        Phases at the origin and time 0 [rad].
    """

    amplitude: Floats
    omega: Floats
    kx: Floats
    ky: Floats
    phase: Floats


def flat_components(
    amplitude: Floats,
    omega: Floats,
    k: Floats,
    heading: Floats,
    phase: Floats,
    current: tuple[float, float] | None = None,
) -> WaveComponents:
    """Return tables over frequency and direction as plain arrays.

    Parameters
    ----------
    amplitude, phase : ndarray
        Amplitudes [m] and phases [rad].
    omega : ndarray
        Frequencies seen by an observer who moves with the current [rad s-1].
    k, heading : ndarray
        Wavenumbers [rad m-1] and directions of travel from +x [rad].
    current : (float, float), optional
        Velocity (U_x, U_y) [m s-1]; None is still water.
    """
    kx, ky = k * np.cos(heading), k * np.sin(heading)
    if current is not None:
        omega = omega + kx * current[0] + ky * current[1]
    return WaveComponents(*(np.ravel(a).copy() for a in (amplitude, omega, kx, ky, phase)))


def sum_elevation(waves: WaveComponents, x: ArrayLike, y: ArrayLike, time: float) -> Floats:
    """Return the elevation [m] at points x, y [m] (broadcast) and a time [s]."""
    return _sum(waves, waves.amplitude[:, None], np.cos, x, y, time)[0]


def sum_slopes(
    waves: WaveComponents, x: ArrayLike, y: ArrayLike, time: float
) -> tuple[Floats, Floats]:
    """Return the slopes dz/dx and dz/dy, the exact derivatives of `sum_elevation`."""
    weights = waves.amplitude[:, None] * np.stack([waves.kx, waves.ky], axis=1)
    zx, zy = _sum(waves, weights, np.sin, x, y, time)
    return zx, zy


def sum_second_derivatives(
    waves: WaveComponents, x: ArrayLike, y: ArrayLike, time: float
) -> tuple[Floats, Floats, Floats]:
    """Return the second derivatives zxx, zxy, zyy [m-1] of `sum_elevation`."""
    kx, ky = waves.kx, waves.ky
    weights = -waves.amplitude[:, None] * np.stack([kx * kx, kx * ky, ky * ky], axis=1)
    zxx, zxy, zyy = _sum(waves, weights, np.cos, x, y, time)
    return zxx, zxy, zyy


def _sum(
    waves: WaveComponents,
    weights: Floats,
    trigonometric: np.ufunc,
    x: ArrayLike,
    y: ArrayLike,
    time: float,
) -> list[Floats]:
    """Sum weighted cosines or sines of the phase at every point, in blocks that fit the cache."""
    x, y = points(x, y)
    px, py = x.reshape(-1, 1), y.reshape(-1, 1)
    at_origin = waves.omega * time + waves.phase
    sums = np.empty((len(px), weights.shape[1]))
    step = max(1, _BLOCK // max(1, len(at_origin)))
    for start in range(0, len(px), step):
        block = slice(start, start + step)
        phase = at_origin - px[block] * waves.kx - py[block] * waves.ky
        # Not a BLAS product, whose last digits change with its number of threads.
        sums[block] = np.einsum("pi,iw->pw", trigonometric(phase), weights)
    return [column.reshape(x.shape) for column in sums.T]


def _real_product(left: NDArray[np.complex128], real: Floats, imag: Floats) -> Floats:
    """Return the real part of a complex matrix product, left @ (real + i imag)."""
    product = np.empty((len(left), real.shape[1]))
    _multiply(left, real, imag, np.empty((4, _PANEL)), product)
    return product


@entry
def _multiply(
    left: NDArray[np.complex128], real: Floats, imag: Floats, sums: Floats, product: Floats
) -> None:
    """Write the real part of a complex matrix product, left @ (real + i imag).

    Array twin: `left.real @ real - left.imag @ imag`.
    Why so: BLAS changes the last digits with its number of threads, and so would every photon;
    here each sum runs in one order. Four rows at a time over narrow columns stay in the cache.
    """
    rows, inner = left.shape
    columns = real.shape[1]
    for start in range(0, columns, _PANEL):
        width = min(_PANEL, columns - start)
        for i in range(0, rows, 4):
            for k in range(4):
                for j in range(width):
                    sums[k, j] = 0.0
            s0, s1, s2, s3 = sums[0], sums[1], sums[2], sums[3]
            last = rows - 1
            i1, i2, i3 = min(i + 1, last), min(i + 2, last), min(i + 3, last)
            for n in range(inner):
                a0, a1, a2, a3 = left[i, n], left[i1, n], left[i2, n], left[i3, n]
                re, im = real[n, start : start + width], imag[n, start : start + width]
                for j in range(width):
                    u, v = re[j], im[j]
                    s0[j] += a0.real * u - a0.imag * v
                    s1[j] += a1.real * u - a1.imag * v
                    s2[j] += a2.real * u - a2.imag * v
                    s3[j] += a3.real * u - a3.imag * v
            for row in range(min(4, rows - i)):
                for j in range(width):
                    product[i + row, start + j] = sums[row, j]


class GridFactors:
    """Factors of a wave sum on a tensor grid, independent of time and phase.

    z(x_m, y_n) = Re sum_i A_mi w_i B_in, A = exp(-i kx x), B = exp(-i ky y),
    w = a exp(i (omega t + phase))

    Parameters
    ----------
    kx, ky : ndarray, shape (n,)
        Wave vectors [rad m-1].
    x_axis : ndarray, shape (nx,)
        Grid lines [m].
    y_axis : ndarray, shape (ny,)
        Grid lines [m].

    Notes
    -----
    Slopes carry the further factors -i kx on the x side and -i ky on the y side.
    """

    def __init__(self, kx: Floats, ky: Floats, x_axis: Floats, y_axis: Floats) -> None:
        self._a = np.exp(-1j * x_axis[:, None] * kx)
        self._minus_i_kx = -1j * kx
        b = np.exp(-1j * ky[:, None] * y_axis)
        b_y = b * (-1j * ky[:, None])
        self._b = b.real.copy(), b.imag.copy()
        self._b_y = b_y.real.copy(), b_y.imag.copy()

    def evaluate(self, weights: NDArray[np.complex128]) -> tuple[Floats, Floats, Floats]:
        """Return elevation [m] and slopes dz/dx, dz/dy, each of shape (nx, ny)."""
        left = self._a * weights
        z = _real_product(left, *self._b)
        zy = _real_product(left, *self._b_y)
        left *= self._minus_i_kx  # in place: megabytes
        return z, _real_product(left, *self._b), zy


class FactorCache:
    """Cache of grid factors by wave vectors and grid lines, shared by the seeds of a sea."""

    def __init__(self) -> None:
        self._factors: dict[tuple[bytes, ...], GridFactors] = {}

    def get(self, waves: WaveComponents, x_axis: Floats, y_axis: Floats) -> GridFactors:
        """Return the factors of a grid, computed on first use."""
        key = tuple(array.tobytes() for array in (waves.kx, waves.ky, x_axis, y_axis))
        factors = self._factors.get(key)
        if factors is None:
            factors = GridFactors(waves.kx, waves.ky, x_axis, y_axis)
            # other threads may add grids meanwhile
            for old in list(self._factors)[: 1 - _GRIDS_KEPT]:
                self._factors.pop(old, None)
            self._factors[key] = factors
        return factors

    def share(self, other: FactorCache) -> None:
        """Use one store with `other` from now on."""
        self._factors = other._factors
