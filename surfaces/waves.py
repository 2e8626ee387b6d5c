"""Sums of plane waves: point by point, and as matrix products on tensor grids.

z = sum_i a_i cos(omega_i t - kx_i x - ky_i y + phase_i)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.kernels.jit import entry

from .parameters import Floats, points

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
    """Cache of grid factors for seas with the same wave vectors."""

    def __init__(self) -> None:
        self._factors: dict[tuple[bytes, bytes], GridFactors] = {}

    def get(self, waves: WaveComponents, x_axis: Floats, y_axis: Floats) -> GridFactors:
        """Return the factors of a grid, computed on first use."""
        key = x_axis.tobytes(), y_axis.tobytes()
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
