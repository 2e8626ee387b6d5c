"""Band of waves that has to be resolved for the fading of a link."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from meshtrace.errors import Described, Refused
from meshtrace.fading.spectral import paraxial_lever, scintillation_of_spectrum
from meshtrace.mesh import PlaneSurface, require_surface

WITHIN = 0.03
"""Relative error of the scintillation index up to which a band counts as resolved."""

SHORT = 0.10
"""Relative error of the scintillation index beyond which a warning is issued."""

FADING = "fading"
"""Name of all waves that make the light of a link fade."""

_START = 3.5  # k_max times the blur where the search begins
_STEP = 2.0**0.5
_FINEST = 2.0 ** (1.0 / 32)
_HIGHEST = 128.0  # rad/s: waves of 1.2 cm


class BandFading(NamedTuple):
    """Scintillation indices of unscattered light in closed form, over one band and all waves.

    Attributes
    ----------
    omega_max : float
        Highest frequency of the band [rad s-1].
    index_of_band : float
        Scintillation index over the band, with tilts beyond it as in `surface.mss`.
    index_of_all : float
        Scintillation index over all waves, of Elfouhaily's spectrum where the tail of the sea's
        own is no model of short waves (JONSWAP, Pierson and Moskowitz).
    needed : float or None
        `omega_max` for the index of all waves [rad s-1], if the band omits more than a tenth of it.
    """

    omega_max: float
    index_of_band: float
    index_of_all: float
    needed: float | None = None

    def warning(self) -> str | None:
        """Return the warning of a band that omits more than a tenth of the fading."""
        if self.needed is None:
            return None
        return (
            f"waves: those up to {self.omega_max:.3g} rad/s give a scintillation index of "
            f"{self.index_of_band:.2g}, all waves {self.index_of_all:.2g}; for fading use "
            f'waves = "fading", here up to {self.needed:.3g} rad/s'
        )


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
        whole = surface.short_waves
        found = BandFading(
            omega_max,
            scintillation_of_spectrum(link, surface, omega_max, heights=True),
            scintillation_of_spectrum(link, whole, heights=True),
        )
        if found.index_of_band >= (1.0 - SHORT) * found.index_of_all:
            return found
        return found._replace(needed=_cached_band(link, whole))
    except Refused:
        return None


def fading_band(link: Any, surface: Any, within: float = WITHIN) -> float:
    """Return the smallest `omega_max` with the fading of all waves.

    Parameters
    ----------
    link : Link
        As for `scintillation_of_spectrum`.
    surface : JonswapSea or SpectralSea
        The sea; its own `omega_max` does not matter.
    within : float
        Relative error of the scintillation index of unscattered light that is allowed, > 0.

    Returns
    -------
    float
        Highest frequency [rad s-1], to 2 % above the smallest one.

    Raises
    ------
    Refused
        If there is no closed form for the link or the sea, its spectrum is no model of short
        waves, the waves beyond the band do not tilt the surface, or no band will do.

    Notes
    -----
    The search starts from the waves that the blur of the light just leaves visible, k_max s = 3.5
    with s^2 = beta^2 sigma_t^2 + a^2 / 4 and sigma_t^2 half the slope variance beyond the band, and
    compares `scintillation_of_spectrum` with tilts to that of all waves.
    """
    if getattr(surface, "mss", None) == "band":
        raise Refused("waves", FADING, 'others with mss = "band"')
    if getattr(surface, "short_waves", surface) is not surface:
        found = Described(f'"{FADING}" over a spectrum whose tail is no model of short waves')
        allowed = 'others, or Elfouhaily\'s spectrum with spreading and mss = "elfouhaily"'
        raise Refused("waves", found, allowed)
    target = scintillation_of_spectrum(link, surface)

    def resolved(omega: float) -> bool:
        return abs(scintillation_of_spectrum(link, surface, omega) - target) <= within * target

    high = _start(link, surface)
    while not resolved(high):
        high *= _STEP
        if high > _HIGHEST:
            found = Described(f'"{FADING}" with mss = "{surface.mss}", which no band follows')
            raise Refused("waves", found, 'others, or mss = "elfouhaily"')
    low = high / _STEP
    while resolved(low):
        low, high = low / _STEP, low
    while high > low * _FINEST:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if resolved(middle) else (middle, high)
    return float(f"{high:.4g}")


def resolve_band(link: Any, surface: Any, waves: Any = None, fading: bool = False) -> Any:
    """Return a sea with the waves that a mesh for a link holds.

    Parameters
    ----------
    link : Link
        The link. A link off its axis has the band of its first source and its first receiver on
        one axis.
    surface : Surface
        Any surface.
    waves : {"mean", "fading", "paper", "scaled"}, float or Band, optional
        Waves of the mesh, see `Meshing`, in place of those of the sea. Of a sum of seas "fading"
        is for the windiest part, the others for all parts of a spectrum.
    fading : bool
        Whether an answer is about fading: a random sea whose waves were left open (`for_fading`),
        or the windiest part of a sum, then has those of "fading", to 10 % of the index where no
        band has it to 3 %. Not without random slopes (`Physics.unresolved`), where the index of a
        band overshoots that of all waves.

    Raises
    ------
    Refused
        If it is no surface or has no such waves, or no band has the fading (`fading_band`).

    Warns
    -----
    UserWarning
        If open waves stay because no band will do.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import JonswapSea, resolved_sea
    >>> resolved = resolve_band(mt.Link(), resolved_sea(5.0, fetch=30e3), "fading")
    >>> 16.0 < resolved.omega_max < 32.0
    True
    >>> resolve_band(mt.Link(), JonswapSea(wind_speed=5.0), fading=True) == resolved
    True
    """
    require_surface(surface)
    if waves is not None:
        return _chosen(link, surface, waves)
    if not fading or link.physics.unresolved == "none":
        return surface
    if hasattr(surface, "windiest"):
        return _with_windiest(surface, lambda part: resolve_band(link, part, fading=True))
    for within in (WITHIN, SHORT):
        try:
            opened = getattr(surface, "for_fading", None)
            return surface if opened is None else _resolved(link, opened, within)
        except Refused as error:
            reason = str(error)
    warnings.warn(f"the fading of short waves is left out: {reason}", stacklevel=2)
    return surface


def _chosen(link: Any, surface: Any, waves: Any) -> Any:
    """Return a sea with chosen waves in place of its present ones."""
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
    return hasattr(type(surface), "band")


def _with_windiest(surface: Any, changed: Callable[[Any], Any]) -> Any:
    """Return a sum of seas with its windiest part changed."""
    whole = surface.windiest
    parts = [changed(part) if part is whole else part for part in surface.parts]
    return surface if parts == list(surface.parts) else surface.model_copy(update={"parts": parts})


def _resolved(link: Any, surface: Any, within: float = WITHIN) -> Any:
    """Return a sea with all waves that make the light of a link fade."""
    try:
        return surface.model_copy(
            update={"omega_max": _cached_band(_on_axis(link), surface, within)}
        )
    except Refused as error:
        if error.field == "waves":
            raise
        found = Described(f'"{FADING}" with {error.field} {error.value}')
        raise Refused("waves", found, f"others, or {error.field} {error.allowed}") from None


def _on_axis(link: Any) -> Any:
    """Return the first source and the first receiver of a link, face to face with a full view."""
    if not (link.transmitters and link.receivers):
        raise Refused("receiver", link.receiver, "one receiver")
    straight = {"position": (0.0, 0.0), "tilt_deg": 0.0, "zenith_deg": 0.0, "fov_deg": 180.0}
    ends = {"transmitter": link.transmitters[0], "receiver": link.receivers[0]}
    return link.replace(
        **{
            name: end.replace(**{k: v for k, v in straight.items() if k in type(end).model_fields})
            for name, end in ends.items()
        }
    )


_bands: dict[tuple[Any, ...], float] = {}


def _cached_band(link: Any, surface: Any, within: float = WITHIN) -> float:
    """Return `fading_band`, searched once for the same geometry and sea."""
    lever, receiver = paraxial_lever(link), link.receivers[0]
    config = {key: value for key, value in surface.to_config().items() if key != "seed"}
    place = receiver.fov_deg, abs(receiver.center[2])
    key = (lever, *place, within, json.dumps(config, sort_keys=True))
    if key not in _bands:
        _bands[key] = fading_band(link, surface, within)
    return _bands[key]


def _start(link: Any, surface: Any) -> float:
    """Return the frequency of the shortest waves that the blur leaves visible [rad s-1]."""
    lever, slopes = paraxial_lever(link), surface.slope_spectrum()
    beyond = np.cumsum(slopes.variance[::-1])[::-1]
    blur = np.sqrt(lever.beta**2 * 0.5 * beyond + 0.25 * lever.aperture**2)
    visible = np.flatnonzero(slopes.k * blur >= _START)
    return float(slopes.omega[visible[0]]) if len(visible) else _HIGHEST / _STEP
