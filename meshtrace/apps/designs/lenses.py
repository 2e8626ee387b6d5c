"""Diversity gain of two lenses in place of one, by their distance."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from meshtrace.apps.designs.page import TwoLenses
from meshtrace.errors import Refused
from meshtrace.fading import gain_correlation
from meshtrace.fading.laws import probability_in_log
from meshtrace.link import Link
from meshtrace.studies.neighbours import DECIBELS

_SPAN = np.geomspace(1.0, 64.0, 25)  # distances over the diameter of the lens
_SHOWN = slice(0, None, 4)  # of these, the doublings
_MOST = 0.9  # share of the diversity gain of independent lenses that counts as most of it
_Z = np.linspace(-9.0, 9.0, 541)  # standard normal deviates, of which copulas are integrals
# correlations of the deviates between which the diversity gain is interpolated; tuned: 0.002 dB
_COPULAS = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.75, 0.85, 0.92, 0.97, 0.99)
_AZIMUTHS = {"along the wind": 0.0, "across the wind": 90.0}


def two_lenses(link: Link, surface: object, spread: float, outage: float) -> tuple[TwoLenses, ...]:
    """Return the diversity gain of a second lens along and across the wind; empty without a law.

    Parameters
    ----------
    link : Link
        Link of one lens.
    surface : SurfaceModel
        Its sea.
    spread : float
        Standard deviation of ln g, g the gain of one lens.
    outage : float
        Share of the time that may fail.
    """
    gain = diversity_gain(spread, outage)
    distances = 2.0 * link.receivers[0].radius * _SPAN
    wind, table = getattr(surface, "wind_direction_deg", 0.0), list[TwoLenses]()
    most = gain(0.0)
    for name, azimuth in _AZIMUTHS.items():
        try:
            rho = gain_correlation(link, surface, distances, wind + azimuth)
        except Refused:  # off the axis, a narrow view, or a sea without a spectrum
            return ()
        gains = np.array([gain(r) for r in rho.tolist()])
        enough = np.flatnonzero(gains >= _MOST * most)
        apart = math.nan
        if len(enough):
            # linear in ln(distance) between the two distances that the gain passes, if any
            pair = slice(max(enough[0] - 1, 0), enough[0] + 1)
            apart = math.exp(np.interp(_MOST * most, gains[pair], np.log(distances[pair])))
        shown = zip(*(x[_SHOWN].tolist() for x in (distances, rho, gains)), strict=True)
        table += [TwoLenses(name, d, r, g, apart) for d, r, g in shown]
    return tuple(table)


def diversity_gain(spread: float, outage: float) -> Callable[[float], float]:
    """Return a function from the correlation of two gains to their diversity gain [dB].

    q_2 / q_1 with P(g_1 < q_1) = outage = P((g_1 + g_2) / 2 < q_2): what two lenses need less power
    than one of their joint area in its place, at equal mean light. ln g has the law of
    `probability_in_log`, and g_1 and g_2 a Gaussian copula, of the correlation r of the normal
    deviates with which g_1 and g_2 have the given one.
    """
    below, standard = probability_in_log(spread), np.linspace(-30.0, 12.0, 4001)
    # ln g as a function of a normal deviate z, F(ln g) = Phi(z)
    deviates = ndtri(np.clip(below(standard), 1e-290, 1.0 - 1e-15))
    rising = np.flatnonzero(np.diff(deviates, prepend=-np.inf) > 0.0)
    logs = spread * np.interp(_Z, deviates[rising], standard[rising])
    gains, weight = np.exp(logs), np.exp(-0.5 * _Z**2)
    weight /= weight.sum()
    mean = float(weight @ gains)
    variance = float(weight @ gains**2) - mean**2
    single = math.exp(np.interp(ndtri(outage), _Z, logs))

    correlations, diversities = [], []
    for r in _COPULAS:
        aside = math.sqrt(1.0 - r * r)
        other = np.interp(r * _Z[:, None] + aside * _Z, _Z, gains)
        joint = float(weight @ (gains[:, None] * other) @ weight)
        correlations.append((joint - mean**2) / variance)

        def excess(log_half: float, r: float = r, aside: float = aside) -> float:
            rest = np.log(np.maximum(2.0 * math.exp(log_half) - gains, 1e-300))
            second = np.interp(rest, logs, _Z, left=-np.inf)
            return float(weight @ ndtr((second - r * _Z) / aside)) - outage

        start = math.log(single)
        half = brentq(excess, start - 1e-3, start + 6.0 * spread + 1.0, xtol=1e-8)
        diversities.append(DECIBELS * (half - start))
    curve = PchipInterpolator([*correlations, 1.0], [*diversities, 0.0])
    return lambda rho: float(curve(min(max(rho, correlations[0]), 1.0)))
