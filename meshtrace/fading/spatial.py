"""Closed-form correlation of the fading of separate receivers or lamps."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.checks import check_call
from meshtrace.errors import Refused, require_array
from meshtrace.fading import spectral
from meshtrace.models import Floats

_DISTANCES, _AZIMUTHS = 160, 96  # nodes about a place; tuned: error against time
_WIDTHS = 25.0  # beyond so many widths of the blur all densities have vanished


@check_call
def gain_correlation(
    link: Any,
    surface: Any,
    distances: ArrayLike,
    azimuth_deg: float = 0.0,
    *,
    end: Literal["receiver", "transmitter"] = "receiver",
    heights: bool = False,
) -> Floats:
    r"""Compute the correlation of the unscattered gains of two receivers, or of two lamps.

    .. math:: \rho(D) = \frac{C(\delta)}{C(0)}, \quad C(\delta) = \int d^2R \sum_m w_m
        [N(R - \delta; 0, \beta^2 D_{ij}(R) + v_m a^2)
        - N(R - \delta; 0, 2 \beta^2 C_{ij}(0) + v_m a^2)]

    Parameters
    ----------
    link : Link
        As for `scintillation_of_spectrum`: one of the two links, on its axis.
    surface : JonswapSea or SpectralSea
        The sea of a study of fading, as for `gain_autocovariance`.
    distances : array_like
        Distances D between the two ends [m], >= 0.
    azimuth_deg : float
        Direction from one end to the other, counter-clockwise from +x [deg]; the wind blows to
        `surface.wind_direction_deg`.
    end : {"receiver", "transmitter"}
        Which end there are two of, of equal heights or depths; the other one is common to both.
    heights : bool
        Whether crests change absorption and distance, as in `scintillation_of_spectrum`.

    Returns
    -------
    ndarray
        Correlation [1], in the shape of `distances`; 1 at distance 0. Below 0 where light that
        misses one end is likely to meet the other.

    Raises
    ------
    Refused
        As `scintillation_of_spectrum`, or if a distance is negative or not finite.

    Notes
    -----
    Straight light from the lamp to receivers that lie D apart crosses still water at points
    delta = D d / (d + n h) apart, with depth d, height h and relative index n; light of lamps that
    lie D apart to one receiver at delta = D n h / (d + n h). For downlinks the factors change
    places. Two crossings at the distance R reach the two apertures with the density of
    `scintillation_of_spectrum` at R - delta in place of R; its terms are explained there. The mean
    gain is taken as the same at both ends: the distance is small against height and depth.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import sea_in_wind
    >>> gain_correlation(mt.Link(), sea_in_wind(5.0), [0.0, 0.1, 0.4]).round(2)
    array([1.  , 0.87, 0.08])
    """
    allowed = "finite distances >= 0 [m]"
    apart = require_array(distances, "distances", allowed)
    if not (np.isfinite(apart) & (apart >= 0.0)).all():
        raise Refused("distances", distances, allowed)
    if not math.isfinite(azimuth_deg):
        raise Refused("azimuth_deg", azimuth_deg, "a finite angle [deg]")
    spectral.require_spectrum(surface)
    surface = spectral.open_for_fading(link, surface)
    lever, spectrum, missing = spectral.slopes_seen(link, surface, surface.band.omega_max)
    share = lever.aperture / link.receivers[0].radius  # of the way from the lamp to the surface
    share = share if end == "receiver" else 1.0 - share
    azimuth = math.radians(azimuth_deg - surface.wind_direction_deg)
    way = share * np.append(0.0, apart.ravel())
    places = np.outer(way, [math.cos(azimuth), math.sin(azimuth)])
    covariances = _covariances(lever, spectrum, missing, places, heights)
    return (covariances[1:] / covariances[0]).reshape(apart.shape)


def _covariances(
    lever: spectral.Lever,
    spectrum: Any,
    missing: tuple[float, float],
    places: Floats,
    heights: bool,
) -> Floats:
    """Return the covariances of gains with separate crossings, over their squared mean.

    `places` (n, 2) are the distances of the crossings of still water along and across the wind.
    """
    from scipy.interpolate import RectBivariateSpline

    variance = np.array(spectrum.along_and_across)
    scale = math.sqrt(lever.beta**2 * (variance.max() + max(missing)) + lever.aperture**2)
    low, reach = 1e-4 * min(scale, lever.aperture), _WIDTHS * scale
    farthest = reach + float(np.hypot(*places.T).max())
    grid, lag = spectrum.distances(low, farthest, _DISTANCES), np.zeros(1)
    azimuth = np.linspace(-math.pi, math.pi, _AZIMUTHS + 1)
    tables = list(spectrum.covariance(grid, azimuth, lag)[:, 0])
    if heights:
        tables += list(spectrum.elevation(grid, azimuth, lag)[:, 0])
    splines = [RectBivariateSpline(np.log(grid), azimuth, table) for table in tables]
    far = 2.0 * (variance + np.array(missing))
    # Polar nodes about the place, where the density of the pair is narrow in weak fading. At the
    # origin, where the tensor vanishes, the pair has light within the aperture alone.
    radius = np.geomspace(low, reach, _DISTANCES)
    angle = 2.0 * math.pi / _AZIMUTHS * np.arange(_AZIMUTHS)
    offset = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)])[:, None]
    covariances = []
    for place in places:
        x, y = place[:, None, None] + offset
        at = np.log(np.maximum(np.hypot(x, y), low)), np.arctan2(y, x)
        xx, yy, xy, *elevation = (spline.ev(*at) for spline in splines)
        near = far[0] - 2.0 * xx, far[1] - 2.0 * yy, -2.0 * xy
        waves = np.stack(elevation) if heights else None
        excess = spectral.excess_density(lever, offset, near, far, waves)
        # d^2R = r^2 d(ln r) d(angle)
        over_angle = excess.mean(axis=1) * 2.0 * math.pi * radius**2
        covariances.append(np.trapezoid(over_angle, np.log(radius)))
    return np.array(covariances)
