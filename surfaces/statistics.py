"""Statistics of the sea surface: moments, heights, slopes, and the slopes left unresolved."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from meshtrace.mesh import TriangleMesh

from .dispersion import wavenumber
from .parameters import WIND_SPEED, Range
from .spectra import SpectrumModel
from .waves import WaveComponents

_LOWEST = 0.05
_HIGHEST = 1e6
_PANELS_PER_E_FOLD = 32
_NODES = 8


def spectral_moment(
    spectrum: SpectrumModel,
    order: float,
    omega_min: float = 0.0,
    omega_max: float | None = None,
) -> float:
    """Moment of a frequency spectrum.

    m_n = int omega^n S(omega) d omega

    Parameters
    ----------
    spectrum : SpectrumModel
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
    ValueError
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


def hs(spectrum: SpectrumModel, omega_min: float = 0.0, omega_max: float | None = None) -> float:
    """Significant wave height Hs = 4 sqrt(m_0) [m] of a spectrum, or of a band of it.

    Examples
    --------
    >>> from meshtrace.surfaces import Jonswap
    >>> sea = Jonswap(wind_speed=5.0, fetch=30e3)
    >>> round(hs(sea), 3), round(hs(sea, 1.2, 4.0), 3)
    (0.552, 0.54)
    """
    return 4.0 * math.sqrt(spectral_moment(spectrum, 0, omega_min, omega_max))


def tp(spectrum: SpectrumModel) -> float:
    """Peak period Tp = 2 pi / omega_p [s] of a spectrum.

    Examples
    --------
    >>> from meshtrace.surfaces import Jonswap
    >>> round(tp(Jonswap(wind_speed=13.0)), 3)
    4.442
    """
    return 2.0 * math.pi / spectrum.omega_p


def mean_square_slope(
    spectrum: SpectrumModel,
    omega_max: float,
    omega_min: float = 0.0,
    depth: float | None = None,
    capillary: bool = False,
) -> float:
    """Mean square slope of the waves in a band.

    mss = int k(omega)^2 S(omega) d omega

    Parameters
    ----------
    spectrum : SpectrumModel
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
    ValueError
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
    """Significant wave height 4 sqrt(sum a^2 / 2) [m] of a sum of waves, over all phases.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea
    >>> round(components_hs(JonswapSea(wind_speed=5.0).components), 3)
    0.54
    """
    return 4.0 * math.sqrt(0.5 * float(np.sum(waves.amplitude**2)))


def components_slope_variance(
    waves: WaveComponents, wind_direction_deg: float = 0.0
) -> tuple[float, float]:
    """Slope variances along and across the wind of a sum of waves, over all phases.

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
    >>> along, across = components_slope_variance(JonswapSea(wind_speed=5.0).components)
    >>> round(along**0.5, 3), round(across**0.5, 3)
    (0.069, 0.04)
    """
    along, across = _turned(waves.kx, waves.ky, wind_direction_deg)
    power = 0.5 * waves.amplitude**2
    return float(np.sum(power * along**2)), float(np.sum(power * across**2))


def sampled_hs(mesh: TriangleMesh) -> float:
    """Significant wave height [m] of one mesh, 4 standard deviations of its elevation.

    Vertices count by the area around them, so that graded meshes are not biased.
    """
    share = _vertex_share(mesh)
    z = mesh.vertices[:, 2]
    return 4.0 * math.sqrt(float(np.sum(share * (z - np.sum(share * z)) ** 2)))


def sampled_slope_variance(
    mesh: TriangleMesh, wind_direction_deg: float = 0.0
) -> tuple[float, float]:
    """Mean square slopes along and across the wind of one mesh, from its vertex normals.

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
    along, across = _turned(*slopes, wind_direction_deg)
    share = _vertex_share(mesh)
    return float(np.sum(share * along**2)), float(np.sum(share * across**2))


def cox_munk(wind_speed: float) -> tuple[float, float]:
    """Slope variances along and across the wind of a clean sea.

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
    ValueError
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


def unresolved_slope_variance(
    wind_speed: float, resolved: tuple[float, float]
) -> tuple[float, float]:
    """Slope variances that the waves of a surface lack of those of Cox and Munk.

    Parameters
    ----------
    wind_speed : float
        Wind speed [m s-1].
    resolved : (float, float)
        Slope variances along and across the wind of the surface, for instance from
        `components_slope_variance`.

    Returns
    -------
    along, across : float
        Missing slope variances, zero where the surface has more than the measured ones.

    Raises
    ------
    ValueError
        If the wind speed or a variance is out of range.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea
    >>> resolved = components_slope_variance(JonswapSea(wind_speed=5.0).components)
    >>> [round(v, 4) for v in unresolved_slope_variance(5.0, resolved)]
    [0.011, 0.011]
    """
    allowed = Range("resolved", 0.0, closed=True)
    targets = zip(cox_munk(wind_speed), resolved, strict=True)
    along, across = (max(0.0, target - allowed.check(found)) for target, found in targets)
    return along, across


def _quadrature(
    spectrum: SpectrumModel, order: float, omega_min: float, omega_max: float | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Gauss-Legendre nodes and weights in log(omega), with a joint at the peak."""
    if omega_max is None and order >= 3:
        raise ValueError(f"omega_max: None with order {order:g}, allowed a finite limit [rad/s]")
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


def _turned(
    x: NDArray[np.float64], y: NDArray[np.float64], wind_direction_deg: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the parts of vectors along and across the wind."""
    Range("wind_direction_deg", unit="deg").check(wind_direction_deg)
    turn = math.radians(wind_direction_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    return cos * x + sin * y, cos * y - sin * x


def _vertex_share(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Return each vertex's share of the area seen from above, summing to one."""
    a, b, c = (mesh.vertices[mesh.faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    # A third of each facet belongs to each of its corners.
    corners = mesh.faces.ravel()
    around = np.bincount(corners, weights=np.repeat(area, 3), minlength=len(mesh.vertices))
    return around / area.sum() / 3.0
