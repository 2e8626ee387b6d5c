"""Closed forms of the fading of unscattered light over a Gaussian sea of any spectrum.

In paraxial geometric optics, light that crosses the surface at P lands at P + beta s(P), in
coordinates of the surface, with the slope s and the lever beta = (n - 1) h d / (d + n h). Over a
homogeneous Gaussian sea the covariance of the gains at two times is an integral over the
distance R of two crossings of the density with which both reach the aperture.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import Described, Refused, require_array, require_between
from meshtrace.models import Floats

_DISTANCES = 130
_AZIMUTHS = 24  # Gauss nodes in a quadrant
_DISK_WIDTHS = np.geomspace(0.02, 0.5, 8)


class Lever(NamedTuple):
    """Paraxial geometry of a link."""

    beta: float  # [m], displacement of the landing point per slope, at the surface
    aperture: float  # [m], radius of the aperture, at the surface
    height: float  # [m-1], relative change of the gain with the height of the crossing


def scintillation_of_spectrum(
    link: Any,
    surface: Any,
    omega_max: float | None = None,
    tilts: bool = True,
    heights: bool = False,
) -> float:
    r"""Compute the scintillation index of unscattered light from the spectrum of the sea.

    .. math:: 1 + SI = \int d^2R \sum_m w_m N(R; 0, \beta^2 D(R) + v_m a^2 I)

    Parameters
    ----------
    link : Link
        One source under water that points upwards, and one receiver above it that looks down.
    surface : JonswapSea or SpectralSea
        The sea; its seed and its mesh do not matter. The index is that of the linear sea: `choppy`
        and `order` are left out (docs/nonlinear.md).
    omega_max : float, optional
        Highest frequency of the waves [rad s-1]; all waves down to 1.3 mm by default.
    tilts : bool
        Whether slopes beyond `omega_max`, up to those of `surface.mss`, tilt the surface at random
        at every crossing, as in `Physics(unresolved="tilt")`.
    heights : bool
        Whether crests change absorption and distance, see Notes.

    Returns
    -------
    float
        Variance of the unscattered gain over its squared mean.

    Raises
    ------
    Refused
        If the link is off its axis, has several sources or receivers, or a field of view that
        cuts the footprint; if the sea has no spectrum; if `omega_max` is not positive.

    See Also
    --------
    gain_autocovariance : The same at a time lag.

    Notes
    -----
    beta = (n - 1) h d / (d + n h) with depth d and height h, a = r / (1 + n h / d) is the
    aperture at the surface, and D_ij(R) = 2 (C_ij(0) - C_ij(R)) is the structure tensor of the
    slopes, with C_ij(R) = int k_i k_j Psi(k) cos(k . R) d^2k. The sum is a mixture of Gaussians
    for the autocorrelation of the disk (2 % off at its centre, less than 1 % in SI). Caustics
    are included. All slopes are Gaussian, those beyond the band too: `slope_law` of the sea is left
    out.

    A crest is a longer way through water that absorbs and scatters, and nearer to the receiver:
    light that crosses at the height eta has the weight exp(q eta), q = -c + 2 (n - 1) / (d + n h).
    With `heights` the integral holds that weight, by its correlation with the slopes:

    .. math:: 1 + SI = \int d^2R \sum_m w_m
        N(R + 2 \beta q \nabla\rho; 0, \beta^2 D + v_m a^2 I) \, e^{q^2 \rho(R)}

    with the covariance rho of the elevation. To first order in the waves it is
    int (beta k^2 + q)^2 S d(omega). Heights take a seventh of an index as small as 0.0045, and
    2 % at 0.09 (c = 0.114 m-1, the default geometry).

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import Elfouhaily, SpectralSea
    >>> spectrum = Elfouhaily(wind_speed=5.0, fetch=30e3)
    >>> sea = SpectralSea(spectrum=spectrum, spreading="elfouhaily", mss="elfouhaily")
    >>> round(scintillation_of_spectrum(mt.Link(), sea), 2)
    0.32
    """
    if omega_max is not None:
        require_between(omega_max, 0.0, math.inf, "omega_max")
    return float(
        _covariance(*_slopes_seen(link, surface, omega_max, tilts), np.zeros(1), heights)[0]
    )


def gain_autocovariance(
    link: Any,
    surface: Any,
    lags: ArrayLike,
    omega_max: float | None = None,
    heights: bool = False,
) -> Floats:
    r"""Compute the autocovariance of the unscattered gain over time, over its squared mean.

    The integral of `scintillation_of_spectrum` with C_ij(R, tau) = int k_i k_j Psi(k)
    cos(k . R - omega tau) d^2k. Waves up to `omega_max` are resolved; slopes beyond it tilt the
    surface as `surface.mss` says.

    Parameters
    ----------
    link : Link
        As for `scintillation_of_spectrum`.
    surface : JonswapSea or SpectralSea
        The sea; `choppy` and `order` are left out.
    lags : array_like
        Time lags tau [s].
    omega_max : float, optional
        Highest frequency of the waves [rad s-1], by default that of the sea's band; infinite for
        all waves.
    heights : bool
        Whether crests change absorption and distance, as in `scintillation_of_spectrum`, with the
        covariance rho(R, tau) of the elevation: to first order in the waves the covariance of the
        gain is int (beta k^2 + q)^2 S cos(omega tau) d(omega).

    Returns
    -------
    ndarray
        Covariance of gain(t) and gain(t + tau) over the squared mean, in the shape of `lags`; at
        lag 0 it is the scintillation index.

    Raises
    ------
    Refused
        As `scintillation_of_spectrum`, or if a lag is not finite.
    """
    tau = require_array(lags, "lags", "finite times [s]")
    if not np.isfinite(tau).all():
        raise Refused("lags", lags, "finite times [s]")
    _require_spectrum(surface)
    limit = surface.band.omega_max if omega_max is None else omega_max
    parts = _slopes_seen(link, surface, None if limit == math.inf else limit)
    return _covariance(*parts, tau.ravel(), heights).reshape(tau.shape)


def paraxial_lever(link: Any) -> Lever:
    """Return the paraxial geometry of a link on its axis."""
    if not hasattr(link, "transmitters"):
        raise Refused("link", Described(type(link).__name__), "a Link")
    down = getattr(link, "direction", "up") == "down"
    side, other = ("height", "depth") if down else ("depth", "height")
    places = {"depth": "under water", "height": "in the air"}
    if len(link.transmitters) != 1 or not hasattr(link.transmitters[0], side):
        raise Refused("transmitter", link.transmitter, f"one source {places[side]}")
    if len(link.receivers) != 1 or not hasattr(link.receivers[0], other):
        raise Refused("receiver", link.receiver, f"one receiver {places[other]}")
    source, receiver = link.transmitters[0], link.receivers[0]
    if tuple(source.position) != tuple(receiver.position):
        raise Refused(
            "receiver.position", receiver.position, f"that of the source, {source.position}"
        )
    leans = "tilt_deg" if down else "zenith_deg"
    if getattr(source, leans) != 0.0:
        paraxial = "0: the closed form is paraxial"
        raise Refused(f"transmitter.{leans}", getattr(source, leans), paraxial)
    if receiver.tilt_deg != 0.0:
        raise Refused("receiver.tilt_deg", receiver.tilt_deg, "0: the closed form is paraxial")
    n = link.water.n / link.n_air
    d, h = (receiver.depth, source.height) if down else (source.depth, receiver.height)
    height = -link.water.c + 2.0 * (n - 1.0) / (d + n * h)
    seen = n * h if down else d  # share of the aperture's radius at the surface
    beta = (n - 1.0) * h * d / (d + n * h)
    return Lever(beta, receiver.radius * seen / (d + n * h), height)


def _slopes_seen(
    link: Any, surface: Any, omega_max: float | None, tilts: bool = True
) -> tuple[Lever, Any, tuple[float, float]]:
    """Return geometry, slope spectrum, and slope variances of the waves beyond a band."""
    _require_spectrum(surface)
    lever, spectrum = paraxial_lever(link), surface.slope_spectrum(omega_max)
    missing = (0.0, 0.0)
    if tilts and omega_max is not None:
        missing = surface.slopes_beyond(omega_max)
    _require_view(link, lever, math.sqrt(max(spectrum.along_and_across) + max(missing)))
    return lever, spectrum, missing


def _require_spectrum(surface: Any) -> None:
    """Require a sea with a spectrum and a spreading."""
    if not hasattr(surface, "slope_spectrum"):
        raise Refused(
            "surface", type(surface).__name__, "a sea with a spectrum: JonswapSea, SpectralSea"
        )


def _require_view(link: Any, lever: Lever, slope: float) -> None:
    """Require a field of view wide enough for light deflected by waves of an rms slope."""
    receiver = link.receivers[0]
    away = receiver.height if hasattr(receiver, "height") else receiver.depth
    edge = (3.0 * lever.beta * slope + lever.aperture) / away
    if math.tan(math.radians(min(receiver.fov_deg, 179.0)) / 2.0) < edge:
        least = 2.0 * math.degrees(math.atan(edge))
        raise Refused("receiver.fov_deg", receiver.fov_deg, f">= {least:.3g}, the whole footprint")


def _covariance(
    lever: Lever, spectrum: Any, missing: tuple[float, float], lags: Floats, heights: bool = False
) -> Floats:
    """Integrate the density of pairs of crossings minus the density of independent pairs over R."""
    variance = np.array(spectrum.along_and_across)
    scale = math.sqrt(lever.beta**2 * (variance.max() + max(missing)) + lever.aperture**2)
    low = 1e-4 * min(scale, lever.aperture)
    distance = spectrum.distances(low, 25.0 * scale, _DISTANCES)
    nodes, weights = np.polynomial.legendre.leggauss(_AZIMUTHS)
    # the sea is symmetric about the wind; at a lag it has a forward direction
    span = 0.5 * math.pi if not lags.any() else math.pi
    repeat = round(span / (0.5 * math.pi))
    azimuth = np.concatenate(
        [0.25 * math.pi * (nodes + 1.0) + i * 0.5 * math.pi for i in range(repeat)]
    )
    weight = np.tile(weights, repeat) * 0.25 * math.pi * 2.0 * math.pi / span
    covariance = spectrum.covariance(distance, azimuth, lags)
    still = 2.0 * (variance + np.array(missing))
    spread = [still[0] - 2.0 * covariance[0], still[1] - 2.0 * covariance[1], -2.0 * covariance[2]]
    x = distance[:, None] * np.cos(azimuth)
    y = distance[:, None] * np.sin(azimuth)
    moved_x, moved_y, weight_of_pair = x, y, 1.0
    if heights:
        rho, slope_x, slope_y = spectrum.elevation(distance, azimuth, lags)
        shift = 2.0 * lever.beta * lever.height
        moved_x, moved_y = x + shift * slope_x, y + shift * slope_y
        weight_of_pair = np.exp(lever.height**2 * rho)
    b2, share, width = lever.beta**2, *_disk_mixture()
    excess = np.zeros(covariance.shape[1:])
    for w, v in zip(share, width * lever.aperture**2, strict=True):
        widths = b2 * spread[0] + v, b2 * spread[1] + v, b2 * spread[2]
        pair = weight_of_pair * _normal_density(moved_x, moved_y, *widths)
        alone = _normal_density(x, y, b2 * still[0] + v, b2 * still[1] + v, 0.0)
        excess += w * (pair - alone)
    # d^2R = R^2 d(ln R) dp
    over_azimuth = (excess * weight).sum(axis=2) * distance**2
    return np.trapezoid(over_azimuth, np.log(distance), axis=1)


def _normal_density(x: Floats, y: Floats, xx: Any, yy: Any, xy: Any) -> Floats:
    """Return the density of a normal law of mean 0 and the covariance (xx, yy, xy)."""
    det = np.maximum(xx * yy - xy * xy, 1e-300)
    form = (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / det
    return np.exp(-0.5 * form) / (2.0 * math.pi * np.sqrt(det))


@cache
def _disk_mixture() -> tuple[Floats, Floats]:
    """Return weights and variances of Gaussians that sum to the autocorrelation of the unit disk.

    Least squares over 0 < r < 2, with the integral 1 and the second moment 1/2 of each axis.
    """
    r = np.linspace(0.0, 2.0, 401)
    disk = 2.0 / math.pi**2 * (np.arccos(r / 2.0) - r / 2.0 * np.sqrt(1.0 - r**2 / 4.0))
    v = _DISK_WIDTHS
    basis = np.exp(-0.5 * r[:, None] ** 2 / v) / (2.0 * math.pi * v)
    weight = r[:, None] + 0.05  # area elements, without losing the centre
    gram = basis.T @ (weight * basis)
    constraint = np.stack([np.ones_like(v), v])
    system = np.block([[gram, constraint.T], [constraint, np.zeros((2, 2))]])
    right = np.concatenate([basis.T @ (weight[:, 0] * disk), [1.0, 0.5]])
    return np.linalg.lstsq(system, right, rcond=1e-12)[0][: len(v)], v
