"""Fades of a time series: level-crossing rate and mean duration."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.fading.correlation import series_block
from meshtrace.fading.gains import (
    FloatArray,
    Reference,
    check_bootstrap,
    checked_gain,
    checked_step,
    level_of,
)
from meshtrace.fading.intervals import (
    Estimate,
    block_interval,
    block_means,
    exponential_limits,
    poisson_limits,
)

# Below this number of crossings block bootstraps have too little to work on.
_FEWEST_CROSSINGS = 20


def level_crossing_rate(
    time: ArrayLike,
    gain: ArrayLike,
    threshold: float = 0.5,
    *,
    relative_to: Reference = "mean",
    block: int | None = None,
    confidence: float = 0.95,
    resamples: int = 999,
    seed: int = 1,
) -> Estimate:
    r"""Return the level-crossing rate of a threshold, downwards, with its interval.

    .. math:: N(h_0) = \#\{i : g_i \ge h_0 > g_{i+1}\} / (t_n - t_1)

    Parameters
    ----------
    time : array_like, shape (n,)
        Equally spaced times [s].
    gain : array_like, shape (n,)
        Channel gains [1].
    threshold : float, optional
        Threshold h_0 [1], a multiple of the reference.
    relative_to : {"mean", "median", "absolute"}, optional
        Reference of the threshold; "absolute" takes it as a gain.
    block : int, optional
        Block length [samples] of the bootstrap, by default `block_length(gain)`.
    confidence : float, optional
        Level of the interval [1].
    resamples, seed : int, optional
        Number and seed of the bootstrap replicates.

    Returns
    -------
    Estimate
        Downward crossings per second [s-1] and the limits: moving blocks, or the Poisson limits
        below 20 crossings.

    Raises
    ------
    Refused
        If the times are not equally spaced, the gains are invalid, or an option is out of range.

    Notes
    -----
    Fades shorter than a time step are missed, and independent Monte Carlo errors add crossings
    that no variance correction removes: use common random numbers or a small error. A smooth
    Gaussian process of mean m, deviation s and correlation R has Rice's rate
    sqrt(-R''(0)) / (2 pi) exp(-(h_0 - m)^2 / (2 s^2)).

    References
    ----------
    Rice, S. O. (1945), doi:10.1002/j.1538-7305.1945.tb00453.x. Garwood, F. (1936),
    doi:10.1093/biomet/28.3-4.437.

    Examples
    --------
    >>> t = 0.1 * np.arange(1001)
    >>> level_crossing_rate(t, 1.0 + 0.1 * np.sin(2.0 * np.pi * t / 4.0 + 0.1), 1.0).value
    0.25
    """
    check_bootstrap(confidence, resamples)
    g, step, (fall, _) = _record(time, gain, threshold, relative_to)
    count, duration = float(fall.sum()), step * fall.size
    block = series_block(block, g)
    if count < _FEWEST_CROSSINGS:
        low, high = poisson_limits(count, confidence)
        return Estimate(count / duration, low / duration, high / duration)
    rate = block_means((fall,), min(block, fall.size), resamples, seed)[0] / step
    return block_interval(count / duration, rate, g.size / block, confidence)


def mean_fade_duration(
    time: ArrayLike,
    gain: ArrayLike,
    threshold: float = 0.5,
    *,
    relative_to: Reference = "mean",
    block: int | None = None,
    confidence: float = 0.95,
    resamples: int = 999,
    seed: int = 1,
) -> Estimate:
    r"""Return the mean time the gain stays below a threshold, with the interval.

    .. math:: \bar\tau(h_0) = P(g < h_0) / N(h_0)

    Parameters
    ----------
    time, gain, threshold, relative_to, block, confidence, resamples, seed
        As in `level_crossing_rate`.

    Returns
    -------
    Estimate
        Mean fade duration [s] and the limits: moving blocks, or those of exponential durations
        below 20 fades. NaN without a fade.

    Raises
    ------
    Refused
        As `level_crossing_rate`.

    Notes
    -----
    The whole time below the threshold over the number of downward crossings: fades cut by an
    end of the record count with their visible part, where leaving them out would favour
    short ones. Fades shorter than a time step are missed.

    Examples
    --------
    >>> t = 0.1 * np.arange(1001)
    >>> fade = mean_fade_duration(t, 1.0 + 0.1 * np.sin(2.0 * np.pi * t / 4.0 + 0.1), 1.0)
    >>> round(fade.value, 6)
    2.0
    """
    check_bootstrap(confidence, resamples)
    g, step, (fall, below) = _record(time, gain, threshold, relative_to)
    count = float(fall.sum())
    block = series_block(block, g)
    if count == 0.0:
        return Estimate(math.nan, math.nan, math.nan)
    value = float(below.sum()) * step / count
    if count < _FEWEST_CROSSINGS:
        return exponential_limits(value, count, confidence)
    low, falls = block_means((below, fall), min(block, fall.size), resamples, seed)
    durations = step * np.divide(low, falls, out=np.full_like(low, math.inf), where=falls > 0.0)
    return block_interval(value, durations, g.size / block, confidence)


def _record(
    time: ArrayLike, gain: ArrayLike, threshold: float, relative_to: Reference
) -> tuple[FloatArray, float, tuple[FloatArray, FloatArray]]:
    """Return gains, time step, and the falls through the level and the share below per step."""
    g = checked_gain(gain)
    step = checked_step(time, g.size)
    under = g < level_of(g, threshold, relative_to)
    fall = (~under[:-1] & under[1:]).astype(np.float64)
    return g, step, (fall, 0.5 * under[:-1] + 0.5 * under[1:])
