"""Statistics of the sea surface: moments, heights, slopes and their covariance."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from pydantic import Field

from meshtrace.checks import check_call
from meshtrace.errors import Refused, require_between
from meshtrace.mesh import TriangleMesh
from meshtrace.models import NonNegative
from meshtrace.quadrature import gauss_legendre

from .parameters import Floats, Mss, Positive, Variances, WindSpeed
from .spectra import Elfouhaily, Spectrum, elfouhaily_delta
from .spreadings import Spreading
from .waves import GRAVITY, WaveComponents, angular_frequency, wavenumber

SHORTEST = 5000.0
"""Largest wavenumber [rad m-1]: waves of 1.3 mm, beyond which no spectrum has slopes."""

# Tuned: the numbers of nodes trade accuracy for time.
_WAVENUMBERS = 6_000  # nodes of a slope spectrum
_HARMONICS = 12  # last harmonic of the spreading that the covariances take into account
_COARSER = 6  # nodes of a slope spectrum that one node of the elevation stands for
_NEGLIGIBLE = 1e-6  # harmonics of a spreading below this are left out; that of order 0 is 1
_SPREADING_NODES = 720  # of the angle to the wind
_SPREADING_WAVENUMBERS = 400  # at which the spreading is evaluated: it changes slowly with k


class SlopeSpectrum(NamedTuple):
    """Slope variance over wavenumber, with the cosine harmonics of the spreading.

    Attributes
    ----------
    k, omega : ndarray, shape (n,)
        Wavenumber [rad m-1] and angular frequency [rad s-1] of the nodes.
    variance : ndarray, shape (n,)
        Slope variance of each node, k^2 S d(omega).
    harmonics : ndarray, shape (15, n)
        int D(theta) cos(m theta) d(theta) for m = 0, 1, ..., with theta from the wind; two more
        than the covariances use, since squares of slopes shift the order by 2.
    """

    k: Floats
    omega: Floats
    variance: Floats
    harmonics: Floats

    @classmethod
    def from_spectrum(
        cls,
        spectrum: Spectrum,
        spreading: Spreading,
        omega_max: float | None,
        depth: float | None,
        capillary: bool,
    ) -> SlopeSpectrum:
        """Return the slopes of waves up to a frequency, or of all waves down to 1.3 mm."""
        # A hundredth of the peak's wavenumber is a tenth of its frequency (omega^2 = g k), where a
        # single peak has underflowed. The slopes of a swell that is lower still are negligible:
        # k^2 is 1e-4 of that at the peak.
        low = 1e-2 * spectrum.omega_p**2 / GRAVITY
        k = np.geomspace(low, SHORTEST, _WAVENUMBERS)
        omega = angular_frequency(k, depth, capillary)
        if omega_max is not None:
            require_between(omega_max, 0.0, math.inf, "omega_max")
            k = np.geomspace(low, np.interp(omega_max, omega, k), _WAVENUMBERS)
            omega = angular_frequency(k, depth, capillary)
        # trapezoidal rule in ln k: S(omega) d(omega) = S(omega) d(omega)/d(ln k) d(ln k)
        weight = np.full(len(k), math.log(k[1] / k[0]))
        weight[[0, -1]] *= 0.5
        variance = weight * np.gradient(omega, np.log(k)) * k**2 * spectrum(omega)
        theta = (np.arange(_SPREADING_NODES) + 0.5) * 2.0 * math.pi / _SPREADING_NODES - math.pi
        sampled = np.unique(np.linspace(0, len(k) - 1, _SPREADING_WAVENUMBERS).astype(int))
        wind_speed, omega_p = spectrum.wind_speed, spectrum.omega_p
        density = spreading.density(
            omega[sampled, None], theta, omega_p=omega_p, wind_speed=wind_speed
        )
        # normalized on the nodes, so that the harmonic of order 0 is 1 to rounding
        density = density / density.sum(axis=1, keepdims=True)
        at_sampled = _product(np.cos(np.arange(_HARMONICS + 3)[:, None] * theta), density)
        harmonics = np.stack([np.interp(np.log(k), np.log(k[sampled]), row) for row in at_sampled])
        return cls(k, omega, variance, harmonics)

    @property
    def along_and_across(self) -> Variances:
        """Slope variances along and across the wind."""
        # the mean of cos^2 theta = (1 + cos 2 theta) / 2 over the spreading
        along = 0.5 * float(np.sum(self.variance * (1.0 + self.harmonics[2])))
        return along, float(np.sum(self.variance)) - along

    def distances(self, low: float, high: float, number: int) -> Floats:
        """Return about `number` geometric distances from `low` to at least `high` [m].

        Their ratio is a power of that of the wavenumbers, so that few products of the two differ.
        """
        span = math.log(high / low)
        # a whole number of steps of the wavenumbers of `elevation`, and so of `covariance`
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
        With z = k R, theta the direction of a wave and p the azimuth of the distance, the expansion
        of Jacobi and Anger gives cos(z cos(theta - p) - omega tau) = sum_n e_n
        Re(i^n exp(-i omega tau)) J_n(z) cos n(theta - p), e_0 = 1 and e_n = 2: even orders carry
        cos(omega tau), odd ones sin(omega tau). The integral over theta leaves the harmonics of the
        spreading, which is even about the wind.
        """
        phase = np.outer(lags, self.omega)
        in_phase, out_of_phase = np.cos(phase), np.sin(phase)
        parts = np.zeros((3, len(lags), len(distance), len(azimuth)))
        bessel = _bessel_functions(distance, self.k)
        for n in range(_HARMONICS + 1):
            in_time = out_of_phase if n % 2 else in_phase
            # k_x^2 + k_y^2, k_x^2 - k_y^2 and 2 k_x k_y are k^2 times 1, cos(2 theta) and
            # sin(2 theta), which shift the order by 2: cos(2 theta) cos(n theta) is the mean of the
            # cosines of n - 2 and n + 2
            lower, upper = self.harmonics[abs(n - 2)], self.harmonics[n + 2]
            terms = np.stack([self.harmonics[n], 0.5 * (lower + upper), 0.5 * (lower - upper)])
            # at lag 0 all odd orders vanish
            if not in_time.any() or np.abs(terms).max() < _NEGLIGIBLE:
                continue
            # (-1)^(n//2) is the sign of Re(i^n exp(-i omega tau)), 2 or 1 is e_n
            weight = (-1.0) ** (n // 2) * (2.0 if n else 1.0) * self.variance
            in_azimuth = np.cos(n * azimuth), np.cos(n * azimuth), np.sin(n * azimuth)
            weighted = np.vstack([weight * term * in_time for term in terms])
            moments = _product(weighted, bessel(n)).reshape(3, len(lags), len(distance))
            for i in range(3):
                parts[i] += moments[i][:, :, None] * in_azimuth[i]
        total, difference, cross = parts  # xx + yy, xx - yy and 2 xy
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
        coarser = slice(None, None, _COARSER)  # short waves have little elevation
        k, omega = self.k[coarser], self.omega[coarser]
        # of the elevation: k^2 less than that of the slopes
        variance = np.add.reduceat(self.variance / self.k**2, np.arange(0, len(self.k), _COARSER))
        # d(rho) by distance, and by azimuth over the distance; orders as in `covariance`
        in_time = np.cos(np.outer(lags, omega)), np.sin(np.outer(lags, omega))
        rho, radial, around = (np.zeros((len(lags), len(distance), len(azimuth))) for _ in range(3))
        bessel = _bessel_functions(distance, k)
        for n in range(_HARMONICS + 1):
            weight = (
                (-1.0) ** (n // 2) * (2.0 if n else 1.0) * variance * self.harmonics[n][coarser]
            )
            weighted = weight * in_time[n % 2]
            if np.abs(weighted).max() < _NEGLIGIBLE * variance.max():
                continue
            # dJ_n/dz = n J_n / z - J_(n+1) (DLMF 10.6.2), with z = k R and d/dR = k d/dz
            value = _product(weighted, bessel(n))[:, :, None]
            slope = -_product(k * weighted, bessel(n + 1))[:, :, None]
            slope = slope + n * value / distance[:, None]
            rho += value * np.cos(n * azimuth)
            radial += slope * np.cos(n * azimuth)
            around += -n * value / distance[:, None] * np.sin(n * azimuth)
        # from the radial and the azimuthal direction to x and y
        c, s = np.cos(azimuth), np.sin(azimuth)
        return np.stack([rho, radial * c - around * s, radial * s + around * c])


def _product(few: Floats, many: Floats) -> Floats:
    """Return few @ many.T, for one array with few rows and one with many.

    Below 16 rows (tuned) without BLAS, as starting its threads takes longer than the product.
    """
    if len(few) < 16:
        return np.einsum("ik,jk->ij", few, many)
    return few @ np.ascontiguousarray(many).T


def _bessel_functions(distance: Floats, k: Floats) -> Callable[[int], Floats]:
    """Return n -> J_n(z) for the products z of distances and wavenumbers.

    The result has the shape (distances, wavenumbers). Both are geometric progressions, and so are
    their products: all are windows of one progression z, which starts later for each distance.
    Upward recurrence (DLMF 10.6.1) where z > n, the power series (DLMF 10.2.2) below 1/2, and scipy
    between.
    """
    from scipy.special import j0, j1, jv

    step = math.log(k[1] / k[0])
    # steps of z from one distance to the next
    apart = round(math.log(distance[1] / distance[0]) / step)
    steps = np.arange(len(k) + apart * (len(distance) - 1))
    z = distance[0] * k[0] * np.exp(step * steps)

    @cache
    def value(n: int) -> Floats:
        if n < 2:
            return (j0, j1)[n](z)
        half = 0.5 * z
        # upward recurrence J_n = 2 (n - 1) / z J_(n-1) - J_(n-2), stable where z > n
        values = (n - 1) / half * value(n - 1) - value(n - 2)
        # J_n(z) = (z/2)^n / n! (1 - q / (n+1) + q^2 / (2 (n+1) (n+2)) - ...), q = (z/2)^2
        # the first term left out is below 2e-9
        small = z < 0.5
        q = half[small] ** 2
        series = 1.0 - q / (n + 1) * (1.0 - q / (2.0 * (n + 2)) * (1.0 - q / (3.0 * (n + 3))))
        values[small] = half[small] ** n / math.factorial(n) * series
        between = ~small & (z < n + 1)
        values[between] = jv(n, z[between])
        return values

    def products(n: int) -> Floats:
        return sliding_window_view(value(n), len(k))[::apart]

    return products


# Limits of integrals over whole spectra, over the peak's frequency: below the first no spectrum has
# energy, beyond the second the tail omega^-5 adds some (1e6)^(n - 4) to a moment of order n < 3.
_LOWEST = 0.05
_HIGHEST = 1e6
# Tuned: panels of Gauss-Legendre rules in ln(omega), and nodes of each.
_PANELS_PER_E_FOLD = 32
_NODES = 8


@check_call
def spectral_moment(
    spectrum: Spectrum,
    order: Annotated[float, Field(ge=-10.0, le=10.0)],
    omega_min: NonNegative = 0.0,
    omega_max: float | None = None,
) -> float:
    """Return the moment of a frequency spectrum.

    m_n = int omega^n S(omega) d omega

    Parameters
    ----------
    spectrum : Spectrum
        The spectrum.
    order : float
        Order n, -10 to 10.
    omega_min : float
        Lower limit [rad s-1].
    omega_max : float, optional
        Upper limit [rad s-1]; None is the whole spectrum, for n < 3 only: with the tail
        omega^-5 the fourth moment diverges.

    Returns
    -------
    float
        m_n [m2 (rad s-1)^n].

    Raises
    ------
    Refused
        If the limits are out of order, or missing where the moment diverges.

    Examples
    --------
    >>> from meshtrace.surfaces import PiersonMoskowitz
    >>> m0 = spectral_moment(PiersonMoskowitz(wind_speed=10.0), 0)
    >>> round(4 * m0**0.5 * 9.81 / 10.26**2, 4)  # Hs g / U_19.5^2 is 2 sqrt(0.0081 / 0.74)
    0.2092
    """
    omega, weights = _quadrature(spectrum, order, omega_min, omega_max)
    return float(np.sum(weights * omega**order * spectrum(omega)))


@check_call
def hs(spectrum: Spectrum, omega_min: NonNegative = 0.0, omega_max: float | None = None) -> float:
    """Return the significant wave height Hs = 4 sqrt(m_0) [m] of a spectrum, or within a band.

    Examples
    --------
    >>> from meshtrace.surfaces import Jonswap
    >>> sea = Jonswap(wind_speed=5.0, fetch=30e3)
    >>> round(hs(sea), 3), round(hs(sea, 1.2, 4.0), 3)
    (0.552, 0.54)
    """
    return 4.0 * math.sqrt(spectral_moment(spectrum, 0, omega_min, omega_max))


@check_call
def tp(spectrum: Spectrum) -> float:
    """Return the peak period Tp = 2 pi / omega_p [s] of a spectrum.

    Examples
    --------
    >>> from meshtrace.surfaces import Jonswap
    >>> round(tp(Jonswap(wind_speed=13.0)), 3)
    4.442
    """
    return 2.0 * math.pi / spectrum.omega_p


@check_call
def mean_square_slope(
    spectrum: Spectrum,
    omega_max: float,
    omega_min: NonNegative = 0.0,
    depth: float | None = None,
    capillary: bool = False,
) -> float:
    """Return the mean square slope of the waves in a band.

    mss = int k(omega)^2 S(omega) d omega

    Parameters
    ----------
    spectrum : Spectrum
        The spectrum.
    omega_max : float
        Upper limit [rad s-1]; the integral grows with it.
    omega_min : float
        Lower limit [rad s-1].
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Surface tension in k(omega).

    Returns
    -------
    float
        Mean square slope, along plus across the wind.

    Raises
    ------
    Refused
        If the limits are out of order.

    Examples
    --------
    >>> from meshtrace.surfaces import Jonswap
    >>> round(mean_square_slope(Jonswap(wind_speed=5.0), omega_max=10.0), 4)
    0.0147
    """
    omega, weights = _quadrature(spectrum, 4, omega_min, omega_max)
    k = wavenumber(omega, depth, capillary)
    return float(np.sum(weights * k**2 * spectrum(omega)))


@check_call
def components_hs(waves: WaveComponents) -> float:
    """Return the significant wave height 4 sqrt(sum a^2 / 2) [m] of a wave sum, over all phases.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea
    >>> round(components_hs(JonswapSea(waves="paper").components), 3)
    0.54
    """
    return 4.0 * math.sqrt(0.5 * float(np.sum(waves.amplitude**2)))


@check_call
def components_slope_variance(waves: WaveComponents, wind_direction_deg: float = 0.0) -> Variances:
    """Return the slope variances along and across the wind of a sum of waves, over all phases.

    sigma^2 = sum (a k_along)^2 / 2, and k_across alike

    Parameters
    ----------
    waves : WaveComponents
        The waves.
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg].

    Returns
    -------
    along, across : float
        Slope variances.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea
    >>> along, across = components_slope_variance(JonswapSea(waves="paper").components)
    >>> round(along**0.5, 3), round(across**0.5, 3)
    (0.069, 0.04)
    """
    return _mean_squares(0.5 * waves.amplitude**2, waves.kx, waves.ky, wind_direction_deg)


@check_call
def sampled_hs(mesh: TriangleMesh) -> float:
    """Return the significant wave height [m] of one mesh, 4 standard deviations of its elevation.

    Vertices count by the area around them, so that graded meshes are not biased.
    """
    weight = _vertex_weights(mesh)
    z = mesh.vertices[:, 2]
    return 4.0 * math.sqrt(float(np.sum(weight * (z - np.sum(weight * z)) ** 2)))


@check_call
def sampled_slope_variance(mesh: TriangleMesh, wind_direction_deg: float = 0.0) -> Variances:
    """Return the mean square slopes along and across the wind of one mesh, from its vertex normals.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface; vertices count by the area around them.
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg].

    Returns
    -------
    along, across : float
        Mean square slopes about zero.
    """
    normal = mesh.vertex_normals
    slopes = -normal[:, 0] / normal[:, 2], -normal[:, 1] / normal[:, 2]
    return _mean_squares(_vertex_weights(mesh), *slopes, wind_direction_deg)


@check_call
def cox_munk(wind_speed: WindSpeed) -> Variances:
    """Return the slope variances along and across the wind of a clean sea.

    sigma_along^2 = 3.16e-3 U, sigma_across^2 = 0.003 + 1.92e-3 U

    Parameters
    ----------
    wind_speed : float
        Wind speed U [m s-1].

    Returns
    -------
    along, across : float
        Slope variances.

    Raises
    ------
    Refused
        If the wind speed is out of range.

    Notes
    -----
    Measured between 1 and 14 m/s, with a spread of 0.004 along and 0.002 across; U at 12.5 m is
    taken for U at 10 m. The fit to the sum, 0.003 + 5.12e-3 U, was made separately and
    differs by 4e-5 U.

    References
    ----------
    Cox and Munk (1954), doi:10.1364/JOSA.44.000838.

    Examples
    --------
    >>> cox_munk(10.0)
    (0.0316, 0.0222)
    """
    return 3.16e-3 * wind_speed, 0.003 + 1.92e-3 * wind_speed


@check_call
def unresolved_slope_variance(target: Variances, resolved: Variances) -> Variances:
    """Return the slope variances missing from a surface.

    Parameters
    ----------
    target : (float, float)
        Slope variances along and across the wind of the real sea, as from `cox_munk`.
    resolved : (float, float)
        Those of the surface, for instance from `meshed_slope_variance`.

    Returns
    -------
    along, across : float
        Missing slope variances, zero where the surface has more than the real sea.

    Raises
    ------
    Refused
        If a variance is out of range.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea
    >>> resolved = components_slope_variance(JonswapSea(waves="paper").components)
    >>> [round(v, 4) for v in unresolved_slope_variance(cox_munk(5.0), resolved)]
    [0.011, 0.011]
    """
    return max(0.0, target[0] - resolved[0]), max(0.0, target[1] - resolved[1])


@check_call
@cache
def elfouhaily_slope_variance(wind_speed: float, fetch: float | None = None) -> Variances:
    """Return the slope variances of the Elfouhaily spectrum, capillaries included.

    sigma_along^2, sigma_across^2 = int k^2 S(omega) (1 +- Delta(k) / 2) / 2 d omega

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1].
    fetch : float, optional
        Fetch [m]; None is the fully developed sea.

    Returns
    -------
    along, across : float
        Slope variances.

    Raises
    ------
    Refused
        If an argument is out of range.

    Notes
    -----
    Integrated up to k = 5000 rad m-1 (waves of 1.3 mm), beyond which the spectrum has no slopes
    left.

    References
    ----------
    Elfouhaily et al. (1997), doi:10.1029/97JC00467, eqs. 57 and 60.

    Examples
    --------
    >>> along, across = elfouhaily_slope_variance(10.0)
    >>> round(along, 3), round(across, 3)
    (0.036, 0.025)
    """
    spectrum = Elfouhaily(wind_speed=wind_speed, fetch=fetch)
    top = float(angular_frequency(SHORTEST, capillary=True))
    omega, weights = _quadrature(spectrum, 4, 0.0, top)
    k = wavenumber(omega, capillary=True)
    mss = weights * k**2 * spectrum(omega)  # of the waves of each node
    delta = elfouhaily_delta(k, wind_speed, spectrum.omega_p)
    return float(np.sum(mss * (0.5 + 0.25 * delta))), float(np.sum(mss * (0.5 - 0.25 * delta)))


@check_call
def real_slope_variance(
    mss: Mss, wind_speed: float, fetch: float | None = None
) -> Variances | None:
    """Return the slope variances of the real sea along and across the wind, None for "band"."""
    if mss == "band":
        return None
    if mss == "cox-munk":
        return cox_munk(wind_speed)
    return elfouhaily_slope_variance(wind_speed, fetch)


@check_call
def meshed_slope_variance(
    waves: WaveComponents, spacing: Positive, wind_direction_deg: float = 0.0
) -> tuple[Variances, Variances]:
    """Return the slope variances of a wave sum on a triangle mesh.

    Normals interpolated between corners with exact slopes have the variance of a wave k times

        1/2 + (cos(kx h) + cos(ky h) + cos(kx h) cos(ky h)) / 6,

    the mean over both diagonals. The slopes of the facets are differences of corners: their
    variances have the factors sinc^2(kx h / 2) along x and sinc^2(ky h / 2) along y. The two edges
    of a facet lie half a cell apart, so that the product of the slopes along x and y has, beside
    both sincs, the factor cos(kx h / 2) cos(ky h / 2).

    Parameters
    ----------
    waves : WaveComponents
        The waves.
    spacing : float
        Distance h of the grid lines [m].
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg].

    Returns
    -------
    vertex, facet : tuple of float
        Slope variances along and across the wind with interpolated normals, and of the facets.

    Raises
    ------
    Refused
        If the spacing or the direction is out of range.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea
    >>> waves = JonswapSea(waves="paper").components
    >>> vertex, facet = meshed_slope_variance(waves, 0.5)
    >>> round(sum(vertex), 5), round(sum(facet), 5), round(sum(components_slope_variance(waves)), 5)
    (0.00615, 0.00629, 0.00638)
    """
    h, power = spacing, 0.5 * waves.amplitude**2
    # The mean square of a function that is linear on a facet is ((sum c)^2 + sum c^2) / 12 over its
    # values c at the corners; of a wave the mean of c_i c_j over all places is cos(k.d) / 2 for
    # corners a vector d apart: h along x, h along y, and a diagonal.
    cx, cy = np.cos(waves.kx * h), np.cos(waves.ky * h)
    factor = 0.5 + (cx + cy + cx * cy) / 6.0
    vertex = _mean_squares(power * factor, waves.kx, waves.ky, wind_direction_deg)
    # np.sinc(x) is sin(pi x) / (pi x)
    sx = waves.kx * np.sinc(waves.kx * h / (2.0 * math.pi))
    sy = waves.ky * np.sinc(waves.ky * h / (2.0 * math.pi))
    both = sx * sy * np.cos(0.5 * waves.kx * h) * np.cos(0.5 * waves.ky * h)
    xx, yy, xy = (float(np.sum(power * term)) for term in (sx**2, sy**2, both))
    # turn the covariance of the slopes from x and y to along and across the wind
    wind = math.radians(wind_direction_deg)
    cos, sin = math.cos(wind), math.sin(wind)
    cross = 2.0 * cos * sin * xy
    return vertex, (cos**2 * xx + sin**2 * yy + cross, sin**2 * xx + cos**2 * yy - cross)


def _quadrature(
    spectrum: Spectrum, order: float, omega_min: float, omega_max: float | None
) -> tuple[Floats, Floats]:
    """Return nodes omega and weights of int d(omega), by Gauss-Legendre panels in ln(omega).

    The peak is an edge of a panel. A moment of an order that diverges without `omega_max` is
    refused.
    """
    if omega_max is None and order >= 3:
        raise Refused("omega_max", None, f"a finite limit [rad/s] for order {order:g}")
    peak = spectrum.omega_p
    top = _HIGHEST * peak if omega_max is None else omega_max
    require_between(top, omega_min, math.inf, "omega_max")
    # Every spectrum has underflowed to zero below a twentieth of its lowest peak; an upper limit
    # that is lower still leaves a panel.
    low = max(omega_min, min(_LOWEST * spectrum.lowest_peak, 0.5 * top))
    # a set, since a limit may be the peak, where the enhancement has its kink
    joints = np.log(sorted({low, min(max(low, peak), top), top}))
    nodes, weights = gauss_legendre(_NODES)
    panels = [
        np.linspace(a, b, math.ceil((b - a) * _PANELS_PER_E_FOLD) + 1) for a, b in pairwise(joints)
    ]
    middle = np.concatenate([0.5 * (p[1:] + p[:-1]) for p in panels])[:, None]
    half = np.concatenate([0.5 * np.diff(p) for p in panels])[:, None]
    omega = np.exp(middle + half * nodes).ravel()
    # d(omega) = omega d(ln omega)
    return omega, (half * weights).ravel() * omega


def _mean_squares(weight: Floats, x: Floats, y: Floats, wind_direction_deg: float) -> Variances:
    """Return the weighted sums of squares of the components of (x, y) along and across the wind."""
    wind = math.radians(wind_direction_deg)
    cos, sin = math.cos(wind), math.sin(wind)
    along, across = cos * x + sin * y, cos * y - sin * x
    return float(np.sum(weight * along**2)), float(np.sum(weight * across**2))


def _vertex_weights(mesh: TriangleMesh) -> Floats:
    """Return each vertex's fraction of the area seen from above; they sum to 1."""
    a, b, c = (mesh.vertices[mesh.faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    # twice the area, which cancels below
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    # a third of each facet belongs to each of its corners
    corners = mesh.faces.ravel()
    around = np.bincount(corners, weights=np.repeat(area, 3), minlength=len(mesh.vertices))
    return around / area.sum() / 3.0
