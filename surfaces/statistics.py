"""Statistics of the sea surface: moments, heights, resolved and unresolved slopes."""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise

import numpy as np

from meshtrace.errors import Refused
from meshtrace.mesh import TriangleMesh

from .dispersion import angular_frequency, wavenumber
from .parameters import WIND_SPEED, Floats, Mss, Range, Variances
from .slope_spectrum import SHORTEST
from .spectra import Elfouhaily, Spectrum, elfouhaily_delta
from .waves import WaveComponents

_LOWEST = 0.05
_HIGHEST = 1e6
_PANELS_PER_E_FOLD = 32
_NODES = 8


def spectral_moment(
    spectrum: Spectrum,
    order: float,
    omega_min: float = 0.0,
    omega_max: float | None = None,
) -> float:
    """Return the moment of a frequency spectrum.

    m_n = int omega^n S(omega) d omega

    Parameters
    ----------
    spectrum : Spectrum
        The spectrum.
    order : float
        Order n.
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
    >>> round(4 * m0**0.5 * 9.81 / 10.26**2, 4)  # 2 sqrt(0.0081 / 0.74)
    0.2092
    """
    omega, weights = _quadrature(spectrum, order, omega_min, omega_max)
    return float(np.sum(weights * omega**order * spectrum(omega)))


def hs(spectrum: Spectrum, omega_min: float = 0.0, omega_max: float | None = None) -> float:
    """Return the significant wave height Hs = 4 sqrt(m_0) [m] of a spectrum, or of a band of it.

    Examples
    --------
    >>> from meshtrace.surfaces import Jonswap
    >>> sea = Jonswap(wind_speed=5.0, fetch=30e3)
    >>> round(hs(sea), 3), round(hs(sea, 1.2, 4.0), 3)
    (0.552, 0.54)
    """
    return 4.0 * math.sqrt(spectral_moment(spectrum, 0, omega_min, omega_max))


def tp(spectrum: Spectrum) -> float:
    """Return the peak period Tp = 2 pi / omega_p [s] of a spectrum.

    Examples
    --------
    >>> from meshtrace.surfaces import Jonswap
    >>> round(tp(Jonswap(wind_speed=13.0)), 3)
    4.442
    """
    return 2.0 * math.pi / spectrum.omega_p


def mean_square_slope(
    spectrum: Spectrum,
    omega_max: float,
    omega_min: float = 0.0,
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


def components_hs(waves: WaveComponents) -> float:
    """Return the significant wave height 4 sqrt(sum a^2 / 2) [m] of a wave sum, over all phases.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea
    >>> round(components_hs(JonswapSea(band="paper").components), 3)
    0.54
    """
    return 4.0 * math.sqrt(0.5 * float(np.sum(waves.amplitude**2)))


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
    >>> along, across = components_slope_variance(JonswapSea(band="paper").components)
    >>> round(along**0.5, 3), round(across**0.5, 3)
    (0.069, 0.04)
    """
    return _mean_squares(0.5 * waves.amplitude**2, waves.kx, waves.ky, wind_direction_deg)


def sampled_hs(mesh: TriangleMesh) -> float:
    """Return the significant wave height [m] of one mesh, 4 standard deviations of its elevation.

    Vertices count by the area around them, so that graded meshes are not biased.
    """
    share = _vertex_share(mesh)
    z = mesh.vertices[:, 2]
    return 4.0 * math.sqrt(float(np.sum(share * (z - np.sum(share * z)) ** 2)))


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
    return _mean_squares(_vertex_share(mesh), *slopes, wind_direction_deg)


def cox_munk(wind_speed: float) -> Variances:
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
    WIND_SPEED.check(wind_speed)
    return 3.16e-3 * wind_speed, 0.003 + 1.92e-3 * wind_speed


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
    >>> resolved = components_slope_variance(JonswapSea(band="paper").components)
    >>> [round(v, 4) for v in unresolved_slope_variance(cox_munk(5.0), resolved)]
    [0.011, 0.011]
    """
    wanted, allowed = Range("target", 0.0, closed=True), Range("resolved", 0.0, closed=True)
    along, across = (
        max(0.0, wanted.check(whole) - allowed.check(found))
        for whole, found in zip(target, resolved, strict=True)
    )
    return along, across


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
    mss = weights * k**2 * spectrum(omega)
    delta = elfouhaily_delta(k, wind_speed, spectrum.omega_p)
    return float(np.sum(mss * (0.5 + 0.25 * delta))), float(np.sum(mss * (0.5 - 0.25 * delta)))


def real_slope_variance(
    mss: Mss, wind_speed: float, fetch: float | None = None
) -> Variances | None:
    """Return the slope variances of the real sea along and across the wind, None for "band"."""
    if mss == "band":
        return None
    if mss == "cox-munk":
        return cox_munk(wind_speed)
    return elfouhaily_slope_variance(wind_speed, fetch)


def meshed_slope_variance(
    waves: WaveComponents, spacing: float, wind_direction_deg: float = 0.0
) -> tuple[Variances, Variances]:
    """Return the slope variances of a wave sum on a triangle mesh.

    Normals interpolated between corners with exact slopes keep, of the variance of a wave k,

        1/2 + (cos(kx h) + cos(ky h) + cos(kx h) cos(ky h)) / 6,

    the mean over both diagonals. The slopes of the facets are differences of corners: they keep
    sinc^2(kx h / 2) along x and sinc^2(ky h / 2) along y, and since the two edges of a facet
    lie half a cell apart, cos(kx h / 2) cos(ky h / 2) of the product of both.

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
    >>> waves = JonswapSea(band="paper").components
    >>> vertex, facet = meshed_slope_variance(waves, 0.5)
    >>> round(sum(vertex), 5), round(sum(facet), 5), round(sum(components_slope_variance(waves)), 5)
    (0.00615, 0.00629, 0.00638)
    """
    h = Range("spacing", 0.0, unit="m").check(spacing)
    power = 0.5 * waves.amplitude**2
    cx, cy = np.cos(waves.kx * h), np.cos(waves.ky * h)
    kept = 0.5 + (cx + cy + cx * cy) / 6.0
    vertex = _mean_squares(power * kept, waves.kx, waves.ky, wind_direction_deg)
    sx = waves.kx * np.sinc(waves.kx * h / (2.0 * math.pi))
    sy = waves.ky * np.sinc(waves.ky * h / (2.0 * math.pi))
    both = sx * sy * np.cos(0.5 * waves.kx * h) * np.cos(0.5 * waves.ky * h)
    xx, yy, xy = (float(np.sum(power * term)) for term in (sx**2, sy**2, both))
    turn = math.radians(wind_direction_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    cross = 2.0 * cos * sin * xy
    return vertex, (cos**2 * xx + sin**2 * yy + cross, sin**2 * xx + cos**2 * yy - cross)


def _quadrature(
    spectrum: Spectrum, order: float, omega_min: float, omega_max: float | None
) -> tuple[Floats, Floats]:
    """Return Gauss-Legendre nodes and weights in log(omega), with a joint at the peak."""
    if omega_max is None and order >= 3:
        raise Refused("omega_max", None, f"a finite limit [rad/s] for order {order:g}")
    peak = spectrum.omega_p
    Range("omega_min", 0.0, unit="rad/s", closed=True).check(omega_min)
    top = _HIGHEST * peak if omega_max is None else omega_max
    Range("omega_max", omega_min, unit="rad/s").check(top)
    # Every spectrum has underflowed to zero below a twentieth of its peak.
    low = max(omega_min, min(_LOWEST * peak, 0.5 * top))
    joints = np.log(sorted({low, min(max(low, peak), top), top}))
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    panels = [
        np.linspace(a, b, math.ceil((b - a) * _PANELS_PER_E_FOLD) + 1) for a, b in pairwise(joints)
    ]
    middle = np.concatenate([0.5 * (p[1:] + p[:-1]) for p in panels])[:, None]
    half = np.concatenate([0.5 * np.diff(p) for p in panels])[:, None]
    omega = np.exp(middle + half * nodes).ravel()
    return omega, (half * weights).ravel() * omega


def _mean_squares(weight: Floats, x: Floats, y: Floats, wind_direction_deg: float) -> Variances:
    """Return the weighted squares of the parts of vectors along and across the wind."""
    Range("wind_direction_deg", unit="deg").check(wind_direction_deg)
    turn = math.radians(wind_direction_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    along, across = cos * x + sin * y, cos * y - sin * x
    return float(np.sum(weight * along**2)), float(np.sum(weight * across**2))


def _vertex_share(mesh: TriangleMesh) -> Floats:
    """Return each vertex's share of the area seen from above, summing to one."""
    a, b, c = (mesh.vertices[mesh.faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    # A third of each facet belongs to each of its corners.
    corners = mesh.faces.ravel()
    around = np.bincount(corners, weights=np.repeat(area, 3), minlength=len(mesh.vertices))
    return around / area.sum() / 3.0
