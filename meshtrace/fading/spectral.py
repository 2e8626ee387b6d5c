"""Closed forms for the fading of unscattered light over a Gaussian sea, and its wave band.

In paraxial geometric optics, light that crosses the surface at P lands at P + beta s(P), with the
plane of the receiver projected from the source onto the surface, the slope s of the surface and
the lever beta = (n - 1) h d / (d + n h) of depth d, height h and relative index n. Two crossings at
the distance vector R reach the aperture together with some probability density. Over a homogeneous
Gaussian sea its integral over R, less that of independent crossings, is the covariance of the gains
at two times.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.checks import Infinite, check_call, check_methods
from meshtrace.errors import Described, Refused, require_array, require_between, warn
from meshtrace.mesh import PlaneSurface, require_surface
from meshtrace.models import Floats, Model
from meshtrace.quadrature import gauss_legendre

_DISTANCES = 130  # nodes of R, about, in equal ratios; tuned: error against time
_AZIMUTHS = 24  # Gauss nodes in a quadrant; tuned: error against time
# variances of the Gaussians in `_disk_mixture`, over the squared radius of the disk; tuned: its fit
_DISK_WIDTHS = np.geomspace(0.02, 0.5, 8)


class Lever(NamedTuple):
    """Paraxial geometry of a link."""

    beta: float  # [m], displacement of the landing point per slope, projected onto the surface
    aperture: float  # [m], radius of the aperture, projected onto the surface
    q: float  # [m-1], relative change of the gain per metre of height of the crossing


@check_call
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
        Highest frequency of the waves [rad s-1]; by default all waves down to 1.3 mm.
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
    N(R; m, V) is the density at R of a Gaussian with the mean m and the covariance V. The lever is
    beta = (n - 1) h d / (d + n h) with depth d and height h, a = r / (1 + n h / d) is the radius of
    the aperture projected onto the surface, and D_ij(R) = 2 (C_ij(0) - C_ij(R)) is the structure
    tensor of the slopes, with the spectrum Psi and C_ij(R) = int k_i k_j Psi(k) cos(k . R) d^2k.
    The sum over m is a mixture of Gaussians, of weights w_m and variances v_m a^2, for the
    autocorrelation of the disk (2 % off at its centre, less than 1 % in SI). Caustics are included.
    All slopes are Gaussian, those beyond the band too: `slope_law` of the sea is left out.

    Light through a crest has a longer path in water that absorbs and scatters, and crosses nearer
    to the receiver: at the height eta its weight is exp(q eta), q = -c + 2 (n - 1) / (d + n h).
    With `heights` the integral includes that weight and its correlation with the slopes:

    .. math:: 1 + SI = \int d^2R \sum_m w_m
        N(R + 2 \beta q \nabla\rho; 0, \beta^2 D + v_m a^2 I) \, e^{q^2 \rho(R)}

    with the covariance rho of the elevation. To first order in the waves SI is
    int (beta k^2 + q)^2 S d(omega). Heights reduce an index of 0.0045 by a seventh, and one of
    0.09 by 2 % (c = 0.114 m-1, the default geometry).

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
    # SI is the covariance at lag 0
    return float(
        _covariance(*slopes_seen(link, surface, omega_max, tilts), np.zeros(1), heights)[0]
    )


@check_call
def gain_autocovariance(
    link: Any,
    surface: Any,
    lags: ArrayLike,
    omega_max: Annotated[float, Infinite()] | None = None,
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
        Highest frequency of the waves [rad s-1]; infinite for all waves. By default the sea is
        that of a study of fading (`resolve_band`): the waves chosen in the sea or, where they
        were left open, all that make the light of the link fade.
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

    Warns
    -----
    UserWarning
        As `resolve_band`.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import resolved_sea
    >>> covariance = gain_autocovariance(mt.Link(), resolved_sea(5.0, fetch=30e3), [0.0, 0.07])
    >>> covariance.round(2)
    array([0.31, 0.22])
    """
    tau = require_array(lags, "lags", "finite times [s]")
    if not np.isfinite(tau).all():
        raise Refused("lags", lags, "finite times [s]")
    require_spectrum(surface)
    if omega_max is None:
        paraxial_lever(link)
        surface = open_for_fading(link, surface)
        omega_max = surface.band.omega_max
    require_between(omega_max, 0.0, math.inf, "omega_max", "(]")
    parts = slopes_seen(link, surface, None if omega_max == math.inf else omega_max)
    return _covariance(*parts, tau.ravel(), heights).reshape(tau.shape)


def paraxial_lever(link: Any) -> Lever:
    """Return the paraxial geometry of a link; refuse one whose ends do not face each other."""
    if not hasattr(link, "transmitters"):
        raise Refused("link", Described(type(link).__name__), "a Link")
    down = getattr(link, "direction", "up") == "down"
    # an end in the water has a depth, one in the air a height
    side, other = ("height", "depth") if down else ("depth", "height")
    places = {"depth": "under water", "height": "in the air"}
    if len(link.transmitters) != 1 or not hasattr(link.transmitters[0], side):
        raise Refused("transmitter", link.transmitter, f"one source {places[side]}")
    if len(link.receivers) != 1 or not hasattr(link.receivers[0], other):
        raise Refused("receiver", link.receiver, f"one receiver {places[other]}")
    source, receiver = link.transmitters[0], link.receivers[0]
    if tuple(source.position) != tuple(receiver.position):
        allowed = f"that of the source, {source.position}"
        raise Refused("receiver.position", receiver.position, allowed)
    # sources in the air have a tilt, those in the water a zenith angle
    leans = "tilt_deg" if down else "zenith_deg"
    tilts = {f"transmitter.{leans}": getattr(source, leans), "receiver.tilt_deg": receiver.tilt_deg}
    for name, tilt in tilts.items():
        if tilt != 0.0:
            raise Refused(name, tilt, "0: the closed form is paraxial")
    n = link.water.n / link.n_air
    d, h = (receiver.depth, source.height) if down else (source.depth, receiver.height)
    # at a crest d grows and h shrinks by its height; the gain goes as exp(-c d) / (d + n h)^2
    q = -link.water.c + 2.0 * (n - 1.0) / (d + n * h)
    # Paraxial rays pass a height h in air as n h of water: the path from the source to the surface,
    # over the whole path d + n h, scales the aperture projected onto the surface.
    to_surface = n * h if down else d
    beta = (n - 1.0) * h * d / (d + n * h)
    return Lever(beta, receiver.radius * to_surface / (d + n * h), q)


def slopes_seen(
    link: Any, surface: Any, omega_max: float | None, tilts: bool = True
) -> tuple[Lever, Any, tuple[float, float]]:
    """Return the geometry, the slope spectrum, and the variances of slopes beyond a band.

    Variances are those along and across the wind. Refuse a field of view too narrow for light that
    the slopes deflect.
    """
    require_spectrum(surface)
    lever, spectrum = paraxial_lever(link), surface.slope_spectrum(omega_max)
    missing = (0.0, 0.0)
    if tilts and omega_max is not None:
        missing = surface.slopes_beyond(omega_max)
    slope = math.sqrt(max(spectrum.along_and_across) + max(missing))
    receiver = link.receivers[0]
    distance = receiver.height if hasattr(receiver, "height") else receiver.depth
    # tangent of the angle to the edge of the footprint on the surface: three standard deviations of
    # the slope times the lever, plus the aperture
    edge = (3.0 * lever.beta * slope + lever.aperture) / distance
    # tan(fov / 2) has its pole at 180 degrees
    if math.tan(math.radians(min(receiver.fov_deg, 179.0)) / 2.0) < edge:
        least = 2.0 * math.degrees(math.atan(edge))
        raise Refused("receiver.fov_deg", receiver.fov_deg, f">= {least:.3g}, the whole footprint")
    return lever, spectrum, missing


def require_spectrum(surface: Any) -> None:
    """Refuse a surface without a spectrum."""
    if not hasattr(surface, "slope_spectrum"):
        allowed = "a sea with a spectrum: JonswapSea, SpectralSea"
        raise Refused("surface", type(surface).__name__, allowed)


def _covariance(
    lever: Lever, spectrum: Any, missing: tuple[float, float], lags: Floats, heights: bool = False
) -> Floats:
    """Return the covariance of the gain over its squared mean at time lags (nt,) [s].

    This is the integral over R of the density with which two crossings reach the aperture minus
    that of independent crossings, see `scintillation_of_spectrum`.
    """
    variance = np.array(spectrum.along_and_across)
    # width of the density of the landing points, projected onto the surface
    scale = math.sqrt(lever.beta**2 * (variance.max() + max(missing)) + lever.aperture**2)
    # the disk within is left out: both densities hardly vary over it, so that its share is 1e-8
    low = 1e-4 * min(scale, lever.aperture)
    # both densities have vanished beyond 25 of their widths
    distance = spectrum.distances(low, 25.0 * scale, _DISTANCES)
    nodes, weights = gauss_legendre(_AZIMUTHS)
    # All four quadrants about the wind are alike at lag 0. At a lag waves have moved forward, and
    # only the two sides of the wind are alike.
    span = 0.5 * math.pi if not lags.any() else math.pi
    repeat = round(span / (0.5 * math.pi))
    azimuth = np.concatenate(
        [0.25 * math.pi * (nodes + 1.0) + i * 0.5 * math.pi for i in range(repeat)]
    )
    # Gauss weights over a quadrant (factor pi / 4), times the number of alike parts of the circle
    weight = np.tile(weights, repeat) * 0.25 * math.pi * 2.0 * math.pi / span
    # xx, yy, xy at lags, distances and azimuths, (3, nt, nr, np)
    covariance = spectrum.covariance(distance, azimuth, lags)
    # D = 2 (C(0) - C(R)), of independent crossings 2 C(0); D_xy is 0 there, as x is along the wind.
    # Slopes beyond the band are independent at two crossings: they are part of C(0) alone.
    far = 2.0 * (variance + np.array(missing))
    near = [far[0] - 2.0 * covariance[0], far[1] - 2.0 * covariance[1], -2.0 * covariance[2]]
    place = distance[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)])[:, None]
    elevation = spectrum.elevation(distance, azimuth, lags) if heights else None
    excess = excess_density(lever, place, near, far, elevation)
    # d^2R = R^2 d(ln R) d(azimuth)
    over_azimuth = (excess * weight).sum(axis=2) * distance**2
    return np.trapezoid(over_azimuth, np.log(distance), axis=1)


def excess_density(
    lever: Lever, place: Floats, near: Sequence[Any], far: Floats, elevation: Floats | None = None
) -> Floats:
    """Return the excess density of pairs of crossings over independent crossings.

    Parameters
    ----------
    lever : Lever
        Geometry of the link.
    place : ndarray, shape (2, ...)
        Places (x, y) [m] at which the density of the landing points of a pair is taken.
    near, far : sequence of ndarray
        Structure tensor of the slopes at the pair (xx, yy, xy) and for independent crossings
        (xx, yy).
    elevation : ndarray, shape (3, ...), optional
        Covariance of the elevation of the pair and its gradient; heights then weigh it.
    """
    (x, y), weight_of_pair = place, 1.0
    moved_x, moved_y = x, y
    if elevation is not None:
        # R + 2 beta q grad rho, and exp(q^2 rho)
        rho, rho_x, rho_y = elevation
        shift = 2.0 * lever.beta * lever.q
        moved_x, moved_y = x + shift * rho_x, y + shift * rho_y
        weight_of_pair = np.exp(lever.q**2 * rho)
    b2, weights, variances = lever.beta**2, *_disk_mixture()
    excess = np.zeros(near[0].shape)
    for w, v in zip(weights, variances * lever.aperture**2, strict=True):
        pair_variances = b2 * near[0] + v, b2 * near[1] + v, b2 * near[2]
        pair = weight_of_pair * _normal_density(moved_x, moved_y, *pair_variances)
        independent = _normal_density(x, y, b2 * far[0] + v, b2 * far[1] + v, 0.0)
        excess += w * (pair - independent)
    return excess


def _normal_density(x: Floats, y: Floats, xx: Any, yy: Any, xy: Any) -> Floats:
    """Return the density at (x, y) of a normal law of mean 0 and the covariance (xx, yy, xy)."""
    det = np.maximum(xx * yy - xy * xy, 1e-300)  # rounding may leave it at 0 or below
    # r V^-1 r with the inverse of the covariance V
    form = (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / det
    return np.exp(-0.5 * form) / (2.0 * math.pi * np.sqrt(det))


@cache
def _disk_mixture() -> tuple[Floats, Floats]:
    """Return weights and variances of Gaussians that sum to the autocorrelation of the unit disk.

    They are a least-squares fit over 0 < r < 2, with the exact integral 1 and second moment 1/2
    along each axis.
    """
    r = np.linspace(0.0, 2.0, 401)
    # common area of two unit disks at the distance r, over the product of their areas
    disk = 2.0 / math.pi**2 * (np.arccos(r / 2.0) - r / 2.0 * np.sqrt(1.0 - r**2 / 4.0))
    v = _DISK_WIDTHS
    basis = np.exp(-0.5 * r[:, None] ** 2 / v) / (2.0 * math.pi * v)
    weight = r[:, None] + 0.05  # element of area, plus a constant that keeps the centre in the fit
    gram = basis.T @ (weight * basis)
    constraint = np.stack([np.ones_like(v), v])
    # Lagrange's equations of least squares with two constraints
    system = np.block([[gram, constraint.T], [constraint, np.zeros((2, 2))]])
    right = np.concatenate([basis.T @ (weight[:, 0] * disk), [1.0, 0.5]])
    # Gaussians of neighbouring widths are nearly dependent, so that the system is near-singular:
    # its pseudo-inverse in place of a plain solution
    return np.linalg.lstsq(system, right, rcond=1e-12)[0][: len(v)], v


WITHIN = 0.03
"""Relative error of the scintillation index up to which a band counts as resolved."""

SHORT = 0.10
"""Relative error of the scintillation index beyond which a warning is issued."""

FADING = "fading"
"""Name of all waves that make the light of a link fade."""

_START = 3.5  # k_max times the blur where the search begins; tuned: steps to the band
_STEP = 2.0**0.5  # factor between the frequencies that bracket the band
_FINEST = 2.0 ** (1.0 / 32)  # factor between the ends of the bracket when the search ends: 2 %
# [rad s-1]: waves of 1.2 cm, for which a mesh of 10 m has some 10^7 facets
_HIGHEST_OF_MESH = 128.0


@check_methods
class BandFading(NamedTuple):
    """Scintillation indices of unscattered light in closed form, over one band and all waves.

    Attributes
    ----------
    omega_max : float
        Highest frequency of the band [rad s-1].
    index_of_band : float
        Scintillation index over the band, with tilts beyond it as in `surface.mss`.
    index_of_all : float
        Scintillation index over all waves. Elfouhaily's spectrum replaces one whose tail is no
        model of short waves (JONSWAP, Pierson and Moskowitz).
    needed : float or None
        `omega_max` for the index of all waves [rad s-1], if the band omits more than a tenth of it.
    """

    omega_max: float
    index_of_band: float
    index_of_all: float
    needed: float | None = None

    def warning(self, down: bool = False) -> str | None:
        """Return the warning of a band that omits more than a tenth of the fading.

        For a downlink it states the number: by name a downlink has the waves of its uplink.
        """
        if self.needed is None:
            return None
        waves = f"{self.needed:.4g}" if down else f'"{FADING}", here up to {self.needed:.3g} rad/s'
        return (
            f"waves: those up to {self.omega_max:.3g} rad/s give a scintillation index of "
            f"{self.index_of_band:.2g}, all waves {self.index_of_all:.2g}; for fading use "
            f"waves = {waves}"
        )


@check_call
def band_fading(link: Any, surface: Any) -> BandFading | None:
    """Compute the closed forms of the fading over the band of a sea and over all waves.

    Parameters
    ----------
    link, surface
        As for `scintillation_of_spectrum`.

    Returns
    -------
    BandFading or None
        None where there is no closed form: a link off its axis, a sea without spectrum.
    """
    if not hasattr(surface, "slope_spectrum"):
        return None
    omega_max = surface.band.omega_max
    try:
        all_waves = surface.short_waves  # with a spectrum that is a model of short waves
        result = BandFading(
            omega_max,
            scintillation_of_spectrum(link, surface, omega_max, heights=True),
            scintillation_of_spectrum(link, all_waves, heights=True),
        )
        if result.index_of_band >= (1.0 - SHORT) * result.index_of_all:
            return result
        return result._replace(needed=_cached_band(link, all_waves))
    except Refused:
        return None


@check_call
def fading_band(link: Any, surface: Any, within: float = WITHIN) -> float:
    """Return the smallest `omega_max` that reproduces the fading of all waves.

    Parameters
    ----------
    link : Link
        As for `scintillation_of_spectrum`.
    surface : JonswapSea or SpectralSea
        The sea; its own `omega_max` does not matter.
    within : float
        Largest relative error of the scintillation index of unscattered light, > 0.

    Returns
    -------
    float
        Highest frequency [rad s-1], at most 2 % above the smallest one.

    Raises
    ------
    Refused
        If there is no closed form for the link or the sea, its spectrum is no model of short
        waves, the waves beyond the band do not tilt the surface, or no band will do.

    Notes
    -----
    The search compares `scintillation_of_spectrum` with tilts to that of all waves. It starts from
    the shortest waves that the blur s of the light leaves visible, k_max s = 3.5 with
    s^2 = beta^2 sigma_t^2 + a^2 / 4: sigma_t^2 is half the slope variance beyond the band, and
    a^2 / 4 the variance of the aperture along an axis.
    """
    if getattr(surface, "mss", None) == "band":
        raise Refused("waves", FADING, 'others with mss = "band"')
    if getattr(surface, "short_waves", surface) is not surface:
        reason = Described(f'"{FADING}" over a spectrum whose tail is no model of short waves')
        allowed = 'others, or Elfouhaily\'s spectrum with spreading and mss = "elfouhaily"'
        raise Refused("waves", reason, allowed)
    target = scintillation_of_spectrum(link, surface)

    def resolved(omega: float) -> bool:
        return abs(scintillation_of_spectrum(link, surface, omega) - target) <= within * target

    # the first guess: waves that the blur of Notes leaves visible
    lever, slopes = paraxial_lever(link), surface.slope_spectrum()
    highest = float(slopes.omega[-1])  # capillary waves included, which small apertures resolve
    beyond = np.cumsum(slopes.variance[::-1])[::-1]  # slope variance of waves from each k on
    blur = np.sqrt(lever.beta**2 * 0.5 * beyond + 0.25 * lever.aperture**2)
    visible = np.flatnonzero(slopes.k * blur >= _START)
    high = float(slopes.omega[visible[0]]) if len(visible) else highest
    while not resolved(high):
        if high >= highest:
            # where `mss` differs from the slopes of the spectrum, even all waves with the tilts it
            # adds miss the target
            law = f'mss = "{surface.mss}", which no band follows'
            reason = Described(f'"{FADING}" with {law} with spreading "{surface.spreading.kind}"')
            allowed = 'others, or Elfouhaily\'s spectrum with spreading and mss = "elfouhaily"'
            raise Refused("waves", reason, allowed)
        high = min(high * _STEP, highest)
    # The first guess may be wider than needed: go down until a band is too narrow, which one
    # without waves is, over which light does not fade.
    low = high / _STEP
    while resolved(low):
        low, high = low / _STEP, low
    while high > low * _FINEST:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if resolved(middle) else (middle, high)
    # four digits, as texts show it, are more than the search resolves
    return float(f"{high:.4g}")


@check_call
def resolve_band(
    link: Any, surface: Any, waves: str | float | Model | None = None, fading: bool = True
) -> Any:
    """Return a sea with the wave band that a link needs.

    Parameters
    ----------
    link : Link
        The link. A link off its axis has the band of its first source and receiver facing each
        other on one axis; a downlink that of the uplink between the same places (`Link.mirrored`).
    surface : Surface
        Any surface.
    waves : {"mean", "fading", "paper", "scaled"}, float or Band, optional
        Waves of the mesh, see `Meshing`, in place of those of the sea. In a sum of seas "fading"
        applies to the windiest part, and other waves to all parts with a spectrum.
    fading : bool
        Whether the result is about fading, as by default: a random sea whose waves were left open
        (`for_fading`), or the windiest part of a sum, then has those of "fading", within 10 % of
        the index where no band is within 3 %. It stays as it is without random slopes
        (`Physics.unresolved`), where the index of a band overshoots that of all waves.

    Raises
    ------
    Refused
        If `surface` is no surface or has no such waves, or no band has the fading (`fading_band`).

    Warns
    -----
    UserWarning
        If waves left open stay so because no band has the fading.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import JonswapSea, resolved_sea
    >>> resolved = resolve_band(mt.Link(), resolved_sea(5.0, fetch=30e3), "fading")
    >>> 16.0 < resolved.omega_max < 32.0
    True
    >>> resolve_band(mt.Link(), JonswapSea(wind_speed=5.0)) == resolved
    True
    """
    require_surface(surface)
    if waves is not None:
        return _chosen(link, surface, waves)
    if not fading or link.physics.unresolved == "none":
        return surface
    if hasattr(surface, "windiest"):
        return _with_windiest(surface, lambda part: open_for_fading(link, part))
    return open_for_fading(link, surface)


def open_for_fading(link: Any, surface: Any) -> Any:
    """Return a sea with the wave band that the fading of a link needs, if its band is left open.

    The index of the band is within 3 % of that of all waves or, where no band is, within 10 %.
    """
    for within in (WITHIN, SHORT):
        try:
            opened = getattr(surface, "for_fading", None)
            return surface if opened is None else _resolved(link, opened, within)
        except Refused as error:
            reason = str(error)  # of the wider tolerance, which is the last word
    warn(f"the fading of short waves is left out: {reason}")
    return surface


def _chosen(link: Any, surface: Any, waves: Any) -> Any:
    """Replace the waves of a sea by a named, numeric or explicit band."""
    if hasattr(surface, "windiest"):
        if waves == FADING:
            return _with_windiest(surface, lambda part: _chosen(link, part, waves))
        parts = [_chosen(link, p, waves) if _has_waves(p) else p for p in surface.parts]
        return surface.model_copy(update={"parts": parts})
    if not _has_waves(surface):
        if waves == "mean" or isinstance(surface, PlaneSurface):
            return surface
        raise Refused("waves", waves, "over a sea of a spectrum: JonswapSea, SpectralSea")
    if waves == FADING:
        free = surface.model_copy(update={"omega_max": None, "waves": None})
        return _resolved(link, free.for_fading or free)
    return surface.model_copy(update={"omega_max" if isinstance(waves, float) else "waves": waves})


def _has_waves(surface: Any) -> bool:
    """Return whether a surface is a sea whose waves can be chosen."""
    # by its class: on the sea itself `hasattr` would compute the band
    return hasattr(type(surface), "band")


def _with_windiest(surface: Any, changed: Callable[[Any], Any]) -> Any:
    """Change the windiest part of a sum of seas."""
    whole = surface.windiest
    parts = [changed(part) if part is whole else part for part in surface.parts]
    return surface if parts == list(surface.parts) else surface.model_copy(update={"parts": parts})


def _resolved(link: Any, surface: Any, within: float = WITHIN) -> Any:
    """Return a sea with the wave band that the fading of a link needs; refuse too short waves."""
    try:
        highest = _cached_band(_on_axis(link), surface, within)
        if highest > _HIGHEST_OF_MESH:
            reason = Described(f'"{FADING}", with waves up to {highest:.3g} rad/s')
            raise Refused("waves", reason, f"others: a mesh holds those up to {_HIGHEST_OF_MESH:g}")
        return surface.model_copy(update={"omega_max": highest})
    except Refused as error:
        if error.field == "waves":
            raise
        reason = Described(f'"{FADING}" with {error.field} {error.value}')
        raise Refused("waves", reason, f"others, or {error.field} {error.allowed}") from None


def _on_axis(link: Any) -> Any:
    """Align the first source and receiver of a link, with a full field of view.

    Those of a downlink change places, so that one sea has one band, that of the uplink, for both
    directions and for traces.
    """
    if not (link.transmitters and link.receivers):
        raise Refused("receiver", link.receiver, "one receiver")
    # values that a link on its axis has, of the fields that an end has
    straight = {
        "position": (0.0, 0.0), "tilt_deg": 0.0, "zenith_deg": 0.0, "fov_deg": 180.0, "pixels": 1,
    }  # fmt: skip
    lamp, aperture = (
        end.replace(**{key: straight[key] for key in straight.keys() & type(end).model_fields})
        for end in (link.transmitters[0], link.receivers[0])
    )
    facing = link.replace(transmitter=lamp, receiver=aperture)
    return facing.replace(planes=None).mirrored() if facing.direction == "down" else facing


_bands: dict[tuple[Any, ...], float] = {}


def _cached_band(link: Any, surface: Any, within: float = WITHIN) -> float:
    """Return `fading_band`, searched once for the same geometry and sea."""
    # all that the search depends on: besides the lever the place and the view of the receiver, by
    # which a footprint wider than the view is refused
    lever, receiver = paraxial_lever(link), link.receivers[0]
    # seas that differ in their seed alone have the same spectrum
    config = {key: value for key, value in surface.to_config().items() if key != "seed"}
    view = receiver.fov_deg, abs(receiver.center[2])
    key = (lever, *view, within, json.dumps(config, sort_keys=True))
    if key not in _bands:
        _bands[key] = fading_band(link, surface, within)
    return _bands[key]
