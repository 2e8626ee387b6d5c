"""Fit of the law g_0 + C h^p: order and limit with confidence intervals."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from meshtrace.fading import Estimate
from meshtrace.models import Floats

_REPLICATES = 2000  # of the bootstrap
_LEVEL = 0.95
_REWEIGHTINGS = 4  # of the fit by its own misfit
_ORDERS = np.linspace(0.5, 6.0, 1101)  # of the fit


class Fit(NamedTuple):
    """The law g_0 + C h^p fitted to a study."""

    order: Estimate
    gain: Estimate
    coefficient: float


def fit_law(step: Floats, differences: Floats, anchor: float, spread: Floats | None = None) -> Fit:
    """Fit g_0 + C h^p to differences from an anchor, with 95 % intervals.

    Parameters
    ----------
    step : ndarray, shape (n,)
        Steps h, from coarse to fine, n >= 4.
    differences : ndarray, shape (n, shifts)
        Gains less the anchor, of each shift of the chains.
    anchor : float
        Reference of the differences.
    spread : ndarray, shape (n,), optional
        Further error of each mean, absolute and in proportion; by default the law leaves
        out something in proportion to h^2.

    Returns
    -------
    Fit
    """
    n, shifts = differences.shape
    h = step / step[0]
    y, noise = differences.mean(axis=1), stderr(differences)
    shape, least = (h**2, 0.0) if spread is None else (spread, 1.0)
    sigma = h**2
    for _ in range(_REWEIGHTINGS):
        order, offset, slope = _least_squares(h, y[None], sigma)
        misfit = max(_misfit(y - offset - slope * h**order, noise, shape), least)
        sigma = np.hypot(noise, misfit * shape) + 1e-300
    order, offset, slope = _least_squares(h, y[None], sigma)
    rng = np.random.default_rng(n * shifts)
    resampled = differences[:, rng.integers(shifts, size=(_REPLICATES, shifts))].mean(axis=2).T
    # a misfit that was fitted is itself known from n - 3 residuals only: Student's distribution
    fitted = misfit > least
    scale = np.sqrt((n - 3) / rng.chisquare(n - 3, (_REPLICATES, 1))) if fitted else 1.0
    left = misfit * shape * scale * rng.standard_normal((_REPLICATES, n))
    orders, offsets, _ = _least_squares(h, offset + slope * h**order + resampled - y + left, sigma)
    tail = 0.5 * (1.0 - _LEVEL)
    limits = np.quantile([orders, offsets], (tail, 1.0 - tail), axis=1)
    return Fit(
        Estimate(float(order[0]), *map(float, limits[:, 0])),
        Estimate(anchor + float(offset[0]), *(anchor + float(v) for v in limits[:, 1])),
        float(slope[0] * step[0] ** -order[0]),
    )


def _misfit(residual: Floats, noise: Floats, shape: Floats) -> float:
    """Return the m >= 0 of errors hypot(noise, m shape) that the residuals of the fit have.

    sum r^2 / (noise^2 + m^2 shape^2) = n - 3, as R. C. Paule and J. Mandel, J. Res. Natl.
    Bur. Stand. 87, 377 (1982), doi:10.6028/jres.087.022: noise is not counted twice.
    """
    freedom = len(residual) - 3

    def excess(m: float) -> float:
        return float(np.sum(residual**2 / (noise**2 + (m * shape) ** 2 + 1e-300))) - freedom

    most = math.sqrt(float(np.sum((residual / shape) ** 2)) / freedom)
    if excess(0.0) <= 0.0 or excess(most) >= 0.0:
        return 0.0 if excess(0.0) <= 0.0 else most
    return float(brentq(excess, 0.0, most))


def _least_squares(h: Floats, y: Floats, sigma: Floats) -> tuple[Floats, Floats, Floats]:
    """Return p, g_0 and C for each row of y (rows, n), errors in proportion to sigma.

    For a given order the law is linear: the best order is looked up on a fine grid.
    """
    weight = (sigma / sigma.max()) ** -2
    weight /= weight.sum()
    power = h ** _ORDERS[:, None]
    power_mean = power @ weight
    power = power - power_mean[:, None]
    mean = y @ weight
    covariance = (weight * (y - mean[:, None])) @ power.T  # (rows, orders)
    variance = (weight * power**2).sum(axis=1)
    best = np.argmax(covariance**2 / variance, axis=1)
    slope = covariance[np.arange(len(y)), best] / variance[best]
    return _ORDERS[best], mean - slope * power_mean[best], slope


def largest_step(step: Floats, error: Floats, limit: float) -> float:
    """Return the largest step with all errors from there on below a limit, or nan."""
    worst = np.maximum(np.maximum.accumulate(error[::-1])[::-1], 1e-300)
    if not worst[-1] <= limit:
        return math.nan
    if worst[0] <= limit:
        return float(step[0])
    j = int(np.argmax(worst <= limit))
    share = math.log(limit / worst[j]) / math.log(worst[j - 1] / worst[j])
    return float(step[j] * (step[j - 1] / step[j]) ** share)


def stderr(samples: Floats) -> Floats:
    """Return the standard error of the mean over the shifts, the last axis."""
    return samples.std(axis=-1, ddof=1) / math.sqrt(samples.shape[-1])
