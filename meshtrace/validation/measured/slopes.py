"""Slopes of the sea by Elfouhaily's spectrum, and what follows from them alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from meshtrace.surfaces import Jonswap, resolved_sea
from meshtrace.surfaces.statistics import mean_square_slope
from meshtrace.surfaces.waves import angular_frequency

from .suite import MeasuredRow

_ROUGHNESS = 1e-4  # [m], roughness length of a neutral wind over the sea, for its profile
_Values = tuple[list[float], float]


@cache
def variances(wind_speed: float, fetch: float | None, shortest: float) -> tuple[float, float]:
    """Return the slope variances along and across the wind of waves longer than `shortest` [m]."""
    highest = float(angular_frequency(2.0 * math.pi / shortest, None, True))
    spectrum = resolved_sea(wind_speed, fetch).slope_spectrum(highest)
    return spectrum.along_and_across


def mean_square_slopes(
    rows: Sequence[MeasuredRow], photons: float, wind_height: float, fetch: float, shortest: float
) -> _Values:
    """Return slope variances of the series "up" and "cross", or their "ratio", at a wind.

    The wind at `wind_height` [m] is that of a neutral profile; a `fetch` of 0 is a developed sea.
    """
    found = []
    for row in rows:
        u10 = row.at * math.log(10.0 / _ROUGHNESS) / math.log(wind_height / _ROUGHNESS)
        up, cross = variances(u10, fetch or None, shortest)
        found.append({"up": up, "cross": cross, "ratio": up / cross}[row.series])
    return found, 0.0


def law_of_weak_winds(
    rows: Sequence[MeasuredRow], photons: float, fetch: float, shortest: float, lowest_wind: float
) -> _Values:
    """Return d ln(mss) / d ln(U) from `lowest_wind` to 7 m/s: nadir glint goes as 1 / mss."""
    winds = np.geomspace(lowest_wind, 7.0, 6)
    mss = [sum(variances(float(u), fetch or None, shortest)) for u in winds]
    return [float(np.polyfit(np.log(winds), np.log(mss), 1)[0])] * len(rows), 0.0


def beam_wander(
    rows: Sequence[MeasuredRow], photons: float, fetch: float, wind_speed: float, cut: float
) -> _Values:
    """Return the rms deviation (n - 1) / n s of a beam into the water, over that at half the wind.

    Small slopes of JONSWAP waves over the fetch of a tank, up to `cut` times the peak frequency.
    """
    seas = [Jonswap(wind_speed=u, fetch=fetch) for u in (wind_speed, 0.5 * wind_speed)]
    strong, weak = (mean_square_slope(s, cut * s.omega_p, capillary=True) for s in seas)
    return [math.sqrt(strong / weak)] * len(rows), 0.0
