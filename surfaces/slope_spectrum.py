"""Covariance of the slopes of a Gaussian sea, from its spectrum and its spreading."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from meshtrace.errors import require_between

from .dispersion import GRAVITY, angular_frequency
from .parameters import Floats, Variances
from .spectra import Spectrum, sea_state
from .spreading import Spreading

SHORTEST = 5000.0
"""Largest wavenumber [rad m-1]: waves of 1.3 mm, beyond which no spectrum has slopes."""

_WAVENUMBERS = 6_000
_HARMONICS = 12  # of the spreading, beyond which the covariance of the slopes has no share
_COARSER = 6  # wavenumbers of the elevation are so much fewer than those of the slopes
_NEGLIGIBLE = 1e-6  # harmonic of a spreading that is left out
_SPREADING_NODES = 720
_SPREADING_WAVENUMBERS = 400  # the spreading changes slowly with k


class SlopeSpectrum(NamedTuple):
    """Slope variance over wavenumber, with the cosine harmonics of the spreading.

    Attributes
    ----------
    k, omega : ndarray, shape (n,)
        Wavenumber [rad m-1] and angular frequency [rad s-1] of the nodes.
    variance : ndarray, shape (n,)
        Slope variance of each node, k^2 S d(omega).
    harmonics : ndarray, shape (15, n)
        int D(theta) cos(m theta) d(theta) for m = 0, 1, ..., with theta from the wind.
    """

    k: Floats
    omega: Floats
    variance: Floats
    harmonics: Floats

    @classmethod
    def of(
        cls,
        spectrum: Spectrum,
        spreading: Spreading,
        omega_max: float | None = None,
        depth: float | None = None,
        capillary: bool = True,
    ) -> SlopeSpectrum:
        """Return the slopes of waves up to a frequency, or of all waves down to 1.3 mm."""
        low = 1e-2 * spectrum.omega_p**2 / GRAVITY
        k = np.geomspace(low, SHORTEST, _WAVENUMBERS)
        omega = angular_frequency(k, depth, capillary)
        if omega_max is not None:
            require_between(omega_max, 0.0, math.inf, "omega_max")
            k = np.geomspace(low, np.interp(omega_max, omega, k), _WAVENUMBERS)
            omega = angular_frequency(k, depth, capillary)
        weight = np.full(len(k), math.log(k[1] / k[0]))
        weight[[0, -1]] *= 0.5
        variance = weight * np.gradient(omega, np.log(k)) * k**2 * spectrum(omega)
        theta = (np.arange(_SPREADING_NODES) + 0.5) * 2.0 * math.pi / _SPREADING_NODES - math.pi
        some = np.unique(np.linspace(0, len(k) - 1, _SPREADING_WAVENUMBERS).astype(int))
        density = spreading.density(omega[some, None], theta, **sea_state(spectrum))
        density = density / density.sum(axis=1, keepdims=True)
        rows = _product(np.cos(np.arange(_HARMONICS + 3)[:, None] * theta), density)
        harmonics = np.stack([np.interp(np.log(k), np.log(k[some]), row) for row in rows])
        return cls(k, omega, variance, harmonics)

    @property
    def along_and_across(self) -> Variances:
        """Slope variances along and across the wind."""
        along = 0.5 * float(np.sum(self.variance * (1.0 + self.harmonics[2])))
        return along, float(np.sum(self.variance)) - along

    def distances(self, low: float, high: float, number: int) -> Floats:
        """Return some `number` of geometric distances from `low` to at least `high` [m].

        Their ratio is a power of that of the wavenumbers, so that few products of the two differ.
        """
        span = math.log(high / low)
        step = _COARSER * math.log(self.k[1] / self.k[0])
        step *= max(1, round(span / (number - 1) / step))
        return low * np.exp(step * np.arange(math.ceil(span / step) + 1))

    def covariance(self, distance: Floats, azimuth: Floats, lags: Floats) -> Floats:
        r"""Compute the covariance of the slopes at two places and times.

        .. math:: C_{ij}(R, \tau) = \int k_i k_j \Psi(k) \cos(k \cdot R - \omega \tau) d^2k

        Parameters
        ----------
        distance : ndarray, shape (nr,)
            Distances [m], those of `distances`.
        azimuth : ndarray, shape (np,)
            Azimuths of the distance from the direction of the wind [rad].
        lags : ndarray, shape (nt,)
            Time lags [s].

        Returns
        -------
        ndarray, shape (3, nt, nr, np)
            Components xx, yy, xy with x along the wind.

        Notes
        -----
        With z = k R, cos(z cos(theta - p) - omega tau) = sum_n e_n Re(i^n exp(-i omega tau))
        J_n(z) cos n(theta - p), e_0 = 1 and e_n = 2: even orders carry cos(omega tau), odd ones
        sin(omega tau).
        """
        in_phase = np.cos(np.outer(lags, self.omega))
        quadrature = np.sin(np.outer(lags, self.omega))
        parts = np.zeros((3, len(lags), len(distance), len(azimuth)))
        bessel = _bessel_functions(distance, self.k)
        for n in range(_HARMONICS + 1):
            turn = quadrature if n % 2 else in_phase
            lower, upper = self.harmonics[abs(n - 2)], self.harmonics[n + 2]
            shares = np.stack([self.harmonics[n], 0.5 * (lower + upper), 0.5 * (lower - upper)])
            if not turn.any() or np.abs(shares).max() < _NEGLIGIBLE:
                continue
            weight = (-1.0) ** (n // 2) * (2.0 if n else 1.0) * self.variance
            around = np.cos(n * azimuth), np.cos(n * azimuth), np.sin(n * azimuth)
            rows = np.vstack([weight * share * turn for share in shares])
            moments = _product(rows, bessel(n)).reshape(3, len(lags), len(distance))
            for i in range(3):
                parts[i] += moments[i][:, :, None] * around[i]
        total, difference, cross = parts
        return np.stack([0.5 * (total + difference), 0.5 * (total - difference), 0.5 * cross])

    def elevation(self, distance: Floats, azimuth: Floats, lags: Floats) -> Floats:
        """Compute the covariance rho of the elevation at two places and times, and its gradient.

        Parameters
        ----------
        distance, azimuth, lags
            As for `covariance`.

        Returns
        -------
        ndarray, shape (3, nt, nr, np)
            rho [m2], d(rho)/dx and d(rho)/dy [m] with x along the wind.
        """
        some = slice(None, None, _COARSER)  # the elevation has no short waves
        k, omega = self.k[some], self.omega[some]
        variance = np.add.reduceat(self.variance / self.k**2, np.arange(0, len(self.k), _COARSER))
        turns = np.cos(np.outer(lags, omega)), np.sin(np.outer(lags, omega))
        rho, radial, around = (np.zeros((len(lags), len(distance), len(azimuth))) for _ in range(3))
        bessel = _bessel_functions(distance, k)
        for n in range(_HARMONICS + 1):
            weight = (-1.0) ** (n // 2) * (2.0 if n else 1.0) * variance * self.harmonics[n][some]
            rows = weight * turns[n % 2]
            if np.abs(rows).max() < _NEGLIGIBLE * variance.max():
                continue
            # dJ_n/dz = n J_n / z - J_(n+1)
            value = _product(rows, bessel(n))[:, :, None]
            slope = -_product(k * rows, bessel(n + 1))[:, :, None]
            slope = slope + n * value / distance[:, None]
            rho += value * np.cos(n * azimuth)
            radial += slope * np.cos(n * azimuth)
            around += -n * value / distance[:, None] * np.sin(n * azimuth)
        c, s = np.cos(azimuth), np.sin(azimuth)
        return np.stack([rho, radial * c - around * s, radial * s + around * c])


def _product(few: Floats, many: Floats) -> Floats:
    """Return few @ many.T; below 16 rows without the threads of BLAS, which cost more than that."""
    if len(few) < 16:
        return np.einsum("ik,jk->ij", few, many)
    product: Floats = few @ np.ascontiguousarray(many).T
    return product


def _bessel_functions(distance: Floats, k: Floats) -> Callable[[int], Floats]:
    """Return n -> J_n(z) for the products z of distances and wavenumbers.

    The products of two geometric rows are one row, of which each distance sees a window.
    Upward recurrence where z > n, the series below 1/2, and scipy between.
    """
    from scipy.special import j0, j1, jv

    step = math.log(k[1] / k[0])
    apart = round(math.log(distance[1] / distance[0]) / step)
    steps = np.arange(len(k) + apart * (len(distance) - 1))
    z = distance[0] * k[0] * np.exp(step * steps)
    known: dict[int, Floats] = {}

    def value(n: int) -> Floats:
        if n in known:
            return known[n]
        if n < 2:
            found: Floats = (j0, j1)[n](z)
        else:
            half = 0.5 * z
            found = (n - 1) / half * value(n - 1) - value(n - 2)
            near = z < 0.5
            q = half[near] ** 2
            series = 1.0 - q / (n + 1) * (1.0 - q / (2.0 * (n + 2)) * (1.0 - q / (3.0 * (n + 3))))
            found[near] = half[near] ** n / math.factorial(n) * series
            between = ~near & (z < n + 1)
            found[between] = jv(n, z[between])
        known[n] = found
        return found

    def products(n: int) -> Floats:
        return sliding_window_view(value(n), len(k))[::apart]

    return products
