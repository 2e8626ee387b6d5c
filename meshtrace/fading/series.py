"""Time series of gains: autocorrelation, coherence time, independent samples, fades."""

from __future__ import annotations

import math
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.checks import Probability, Seed, check_call
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.fading.distribution import (
    Estimate,
    Reference,
    Resamples,
    Threshold,
    block_interval,
    block_means,
    checked,
    checked_gain,
    checked_step,
    level_of,
)
from meshtrace.models import Floats

# Blocks of one replicate at most: bounds memory.
_MOST_BLOCKS = 1000


@check_call
def autocorrelation(
    gain: ArrayLike, gain_stderr: ArrayLike | None = None, *, max_lag: int | None = None
) -> Floats:
    r"""Return the autocorrelation of an equally spaced series without its Monte Carlo noise.

    .. math:: \rho_k = C_k / (C_0 - \overline{s^2}), \quad \rho_0 = 1

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1] at equal time steps.
    gain_stderr : array_like, shape () or (n,), optional
        Independent standard error of each gain [1]. Its variance appears at lag 0 only.
    max_lag : int, optional
        Highest lag, by default n // 2.

    Returns
    -------
    ndarray, shape (max_lag + 1,)
        Correlation coefficients at lags 0, 1, ... samples. Noise may make them exceed 1.

    Raises
    ------
    Refused
        If the gains are invalid, `max_lag` is outside 0..n - 1, or no variance is left
        beside the noise.

    Notes
    -----
    C_k is the mean over the n - k pairs of gains at the lag k. It is taken about the mean of the
    record, which makes it low at all lags by about Var / (number of independent samples).

    Examples
    --------
    >>> autocorrelation([1.0, 2.0, 1.0, 2.0], max_lag=2)
    array([ 1., -1.,  1.])
    """
    g, noise = checked(gain, gain_stderr)
    max_lag = g.size // 2 if max_lag is None else max_lag
    require_whole(max_lag, 0, g.size - 1, "max_lag")
    x = g / g.mean()
    floor = float(noise.mean()) / float(g.mean()) ** 2  # variance of the noise of x
    variance = float(x.var()) - floor
    if np.ptp(g) == 0.0 or not variance > 0.0:
        reason = Described(f"variance {x.var():.3g} of gain / mean")
        raise Refused("gain", reason, f"more than that of the Monte Carlo noise, {floor:.3g}")
    rho = _autocovariance(x)[: max_lag + 1] / variance
    # C_0 alone has the noise in it, so that it exceeds the variance of the fading
    rho[0] = 1.0
    return rho


@check_call
def effective_samples(gain: ArrayLike, gain_stderr: ArrayLike | None = None) -> float:
    r"""Return the number of independent samples equivalent to a correlated series.

    .. math:: n_\mathrm{eff} = n / \max(1 + 2 \sum \rho_k,\; 1 + 2 \sum \rho_k^2)

    Parameters
    ----------
    gain, gain_stderr
        As in `autocorrelation`.

    Returns
    -------
    float
        Effective number of samples, 1 <= n_eff <= n.

    Raises
    ------
    Refused
        As `autocorrelation`.

    Notes
    -----
    The first expression holds for the mean, the second for the variance of a Gaussian process (it
    does not cancel where the correlation oscillates, as that of waves does); the larger of the two
    is taken, as the safe choice. Both sums end at the first lag beyond five times the second
    expression: this is Sokal's window with squares, as the first expression can pass through 0.

    References
    ----------
    Sokal, A. (1997), Monte Carlo methods in statistical mechanics,
    doi:10.1007/978-1-4899-0319-8_6.

    Examples
    --------
    >>> t = np.arange(1000)
    >>> round(effective_samples(2.0 + np.sin(2.0 * np.pi * t / 50.0) * np.exp(-t / 100.0)), -1)
    20.0
    """
    rho = autocorrelation(gain, gain_stderr)[1:]
    squares = 1.0 + 2.0 * np.cumsum(rho**2)
    beyond = np.flatnonzero(np.arange(1, rho.size + 1) >= 5.0 * squares)
    window = beyond[0] if beyond.size else rho.size - 1  # index of the last lag in the sums
    inflation = max(1.0 + 2.0 * float(rho[: window + 1].sum()), float(squares[window]))
    # a series that is correlated throughout is still one sample
    return float(np.size(gain) / min(inflation, np.size(gain)))


@check_call
def block_length(gain: ArrayLike) -> int:
    r"""Return the block length for resampling a correlated series.

    .. math:: b = 3 \, (2 G^2 / D)^{1/3} n^{1/3}, \quad G = \sum \lambda_k |k| C_k, \quad
              D = \tfrac43 \left(\sum \lambda_k C_k\right)^2

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1] at equal time steps.

    Returns
    -------
    int
        Block length in samples, n / 1000 to n / 4. The lower limit bounds memory, and longer blocks
        cost no accuracy there.

    Raises
    ------
    Refused
        If the gains are invalid.

    Notes
    -----
    This is three times the length of Politis and White: theirs has the least mean square error of
    the variance, but that variance is low by O(1 / b) and its intervals are too narrow. lambda_k is
    their flat-top taper (`flat_top`), and the sums run over lags of both signs. C_k is the
    autocovariance of the squared deviation from the mean, on which the scintillation index rests;
    that of the gain itself can cancel in the sum (waves oscillate).

    References
    ----------
    Politis, D. N. and White, H. (2004), doi:10.1081/ETC-120028836; corrected by Patton,
    Politis and White (2009), doi:10.1080/07474930802459016.

    Examples
    --------
    >>> block_length(np.random.default_rng(1).uniform(1.0, 2.0, 500)) < 10
    True
    """
    g = checked_gain(gain)
    if np.ptp(g) == 0.0:
        return 1
    deviation = g / g.mean() - 1.0
    shortest = max(1, g.size // _MOST_BLOCKS)
    return int(np.clip(round(3.0 * _politis_white(deviation**2)), shortest, max(g.size // 4, 1)))


def _politis_white(x: Floats) -> float:
    """Return the block length of Politis and White for a series (n,) [samples]."""
    n = x.size
    x = x - x.mean()
    # each lag is divided by n, not by its number of pairs, which keeps the estimate positive
    # semidefinite
    covariance = _autocovariance(x) * np.arange(n, 0, -1) / n
    if not covariance[0] > 0.0:
        return 1.0
    taper = flat_top(covariance / covariance[0])[1:]
    k = np.arange(1, taper.size + 1)
    tapered = taper * covariance[1 : taper.size + 1]
    spectrum = covariance[0] + 2.0 * tapered.sum()  # spectral density at frequency 0
    if spectrum == 0.0:
        return float(n)
    # (2 G^2 / D)^(1/3) n^(1/3) with G = 2 sum k C_k over lags > 0 and D = 4/3 spectrum^2
    return float((1.5 * (2.0 * np.sum(k * tapered) / spectrum) ** 2 * n) ** (1.0 / 3.0))


def flat_top(rho: Floats) -> Floats:
    """Return the flat-top taper (m + 1,) of Politis and White for lags 0, 1, ... of a correlation.

    It is 1 up to the lag beyond which the correlation is insignificant, and 0 at twice that lag.
    """
    n = rho.size
    # Politis and White's rules: K_n, m_max, and the bound (c = 2) below which `run` lags in
    # succession make the correlation insignificant
    run = max(5, math.ceil(math.sqrt(math.log10(n))))
    last = min(n - 1, math.ceil(math.sqrt(n)) + run)
    bound = 2.0 * math.sqrt(math.log10(n) / n)
    # lags beyond the last count as insignificant, so that there always is such a run
    quiet = np.append(np.abs(rho[1 : last + 1]) < bound, np.ones(run, dtype=bool))
    window = int(np.argmax(np.lib.stride_tricks.sliding_window_view(quiet, run).all(axis=1)))
    m = min(2 * max(window, 1), last)
    return np.minimum(1.0, 2.0 * (1.0 - np.arange(m + 1) / m))


def _autocovariance(x: Floats) -> Floats:
    """Return the autocovariance at lags 0, ..., n - 1, each divided by its number of pairs."""
    n = x.size
    # padded to twice the length, so that the lags do not wrap around
    spectrum = np.fft.rfft(x - x.mean(), 2 * n)
    return np.fft.irfft(np.abs(spectrum) ** 2)[:n] / np.arange(n, 0, -1)


@check_call
def coherence_time(
    time: ArrayLike,
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    block: int | None = None,
    confidence: Probability = 0.95,
    resamples: Resamples = 999,
    seed: Seed = 1,
) -> Estimate:
    r"""Return the time in which the autocorrelation falls to 1/e, with its interval.

    .. math:: \rho(\tau_c) = 1 / e

    Parameters
    ----------
    time : array_like, shape (n,)
        Equally spaced times [s].
    gain : array_like, shape (n,)
        Channel gains [1].
    gain_stderr : array_like, shape () or (n,), optional
        Independent standard error of each gain [1].
    block : int, optional
        Block length [samples] of the bootstrap, by default `block_length(gain)`.
    confidence : float, optional
        Level of the interval [1].
    resamples, seed : int, optional
        Number and seed of the bootstrap replicates.

    Returns
    -------
    Estimate
        Coherence time [s] and its limits, interpolated between lags; infinite if the
        autocorrelation stays above 1/e up to lag n // 2.

    Raises
    ------
    Refused
        If the times are not equally spaced, the gains are invalid, or no variance is left
        beside the noise.

    Notes
    -----
    Below one time step the value is only an upper bound: use shorter steps. For the interval blocks
    of the lagged products are resampled (Künsch's blocks of blocks).

    References
    ----------
    Künsch, H. R. (1989), doi:10.1214/aos/1176347265.

    Examples
    --------
    >>> t = 0.1 * np.arange(400)
    >>> tau = coherence_time(t, 1.0 + 0.1 * np.cos(2.0 * np.pi * t / 8.0)).value
    >>> round(tau, 1)  # arccos(1 / e) / (2 pi / 8 s)
    1.5
    """
    g, noise = checked(gain, gain_stderr)
    step = checked_step(time, g.size)
    rho = autocorrelation(g, gain_stderr)
    crossing = float(_first_crossing(rho[:, None])[0])
    if math.isinf(crossing):
        # the time is longer than the largest lag
        return Estimate(math.inf, (rho.size - 1) * step, math.inf)
    # four times the lag of the record's crossing leaves room for replicates that cross later
    lags = min(rho.size, 4 * math.ceil(crossing) + 2)
    block = series_block(block, g)
    # a replicate without variance beside the noise counts as one that never falls below 1/e
    replicates = _first_crossing(correlation_replicates(g, lags, block, resamples, seed, noise))
    interval = block_interval(crossing, replicates, g.size / block, confidence)
    return Estimate(interval.value * step, interval.low * step, interval.high * step)


def correlation_replicates(
    g: Floats, lags: int, block: int, resamples: int, seed: int, noise: Floats | float = 0.0
) -> Floats:
    """Return the autocorrelations (lags, resamples) of replicates over random moving blocks.

    `noise` are the variances of the Monte Carlo errors. Replicates without variance beside them
    have the autocorrelation 1.
    """
    x, pairs = g / g.mean() - 1.0, g.size - lags + 1
    products = (x[:pairs] * x[lag : lag + pairs] for lag in range(lags))
    # the first column is the deviation itself, then the products at lags 0, 1, ...
    means = block_means(chain((x[:pairs],), products), block, resamples, seed)
    covariance = means[1:] - means[0] ** 2
    # the noise is in lag 0 alone
    variance = covariance[0] - np.mean(noise) / g.mean() ** 2
    covariance[0] = variance
    return np.divide(covariance, variance, out=np.ones_like(covariance), where=variance > 0.0)


def _first_crossing(rho: Floats) -> Floats:
    """Return the first lag [samples] at which each column falls to 1/e, interpolated, or inf."""
    level = math.exp(-1.0)
    below = rho <= level
    after = np.maximum(below.argmax(axis=0), 1)
    column = np.arange(rho.shape[1])
    high, low = rho[after - 1, column], rho[after, column]
    drop = np.where(below.any(axis=0), high - low, 1.0)  # not 0, which it may be without a crossing
    return np.where(below.any(axis=0), after - 1 + (high - level) / drop, math.inf)


def series_block(block: int | None, g: Floats) -> int:
    """Return the block length of a series, by default `block_length`; refuse one above n / 2."""
    block = block_length(g) if block is None else block
    require_whole(block, 1, max(1, g.size // 2), "block")
    return block


# With fewer crossings block bootstraps are unreliable: limits of a Poisson process instead.
_FEWEST_CROSSINGS = 20


@check_call
def level_crossing_rate(
    time: ArrayLike,
    gain: ArrayLike,
    threshold: Threshold = 0.5,
    *,
    relative_to: Reference = "mean",
    block: int | None = None,
    confidence: Probability = 0.95,
    resamples: Resamples = 999,
    seed: Seed = 1,
) -> Estimate:
    r"""Return the rate of downward crossings of a threshold, with its interval.

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
        Downward crossings per second [s-1] and their limits: by moving blocks, or those of a
        Poisson law below 20 crossings.

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
    from scipy import special

    g, step, under = _record(time, gain, threshold, relative_to)
    fall = (~under[:-1] & under[1:]).astype(np.float64)
    count, duration = float(fall.sum()), step * fall.size
    block = series_block(block, g)
    if count < _FEWEST_CROSSINGS:
        tail = 0.5 - 0.5 * confidence
        # Garwood's limits of a Poisson mean
        low = float(special.gammaincinv(count, tail)) if count else 0.0
        high = float(special.gammainccinv(count + 1.0, tail))
        return Estimate(count / duration, low / duration, high / duration)
    rate = block_means((fall,), min(block, fall.size), resamples, seed)[0] / step
    return block_interval(count / duration, rate, g.size / block, confidence)


@check_call
def mean_fade_duration(
    time: ArrayLike,
    gain: ArrayLike,
    threshold: Threshold = 0.5,
    *,
    relative_to: Reference = "mean",
    block: int | None = None,
    confidence: Probability = 0.95,
    resamples: Resamples = 999,
    seed: Seed = 1,
) -> Estimate:
    r"""Return the mean time for which the gain stays below a threshold, with its interval.

    .. math:: \bar\tau(h_0) = P(g < h_0) / N(h_0)

    Parameters
    ----------
    time, gain, threshold, relative_to, block, confidence, resamples, seed
        As in `level_crossing_rate`.

    Returns
    -------
    Estimate
        Mean fade duration [s] and its limits: by moving blocks, or those of exponential durations
        below 20 fades. NaN without a fade.

    Raises
    ------
    Refused
        As `level_crossing_rate`.

    Notes
    -----
    This is the whole time below the threshold over the number of downward crossings: fades cut by
    an end of the record count with their visible part, since leaving them out would favour short
    ones. Fades shorter than a time step are missed.

    Examples
    --------
    >>> t = 0.1 * np.arange(1001)
    >>> fade = mean_fade_duration(t, 1.0 + 0.1 * np.sin(2.0 * np.pi * t / 4.0 + 0.1), 1.0)
    >>> round(fade.value, 6)
    2.0
    """
    from scipy import special

    g, step, under = _record(time, gain, threshold, relative_to)
    fall = (~under[:-1] & under[1:]).astype(np.float64)
    # share of each step below the threshold, by trapezoids: half of a step that crosses it
    below = 0.5 * under[:-1] + 0.5 * under[1:]
    count = float(fall.sum())
    block = series_block(block, g)
    if count == 0.0:
        return Estimate(math.nan, math.nan, math.nan)
    value = float(below.sum()) * step / count
    if count < _FEWEST_CROSSINGS:
        tail = 0.5 - 0.5 * confidence
        # n exponential durations add up to a gamma variable of shape n: its quantiles
        least, most = special.gammaincinv(count, tail), special.gammainccinv(count, tail)
        return Estimate(value, float(count * value / most), float(count * value / least))
    share, falls = block_means((below, fall), min(block, fall.size), resamples, seed)
    durations = step * np.divide(share, falls, out=np.full_like(share, math.inf), where=falls > 0.0)
    return block_interval(value, durations, g.size / block, confidence)


@check_call
def fade_durations(
    time: ArrayLike, gain: ArrayLike, threshold: float = 0.5, *, relative_to: Reference = "mean"
) -> Floats:
    """Return the durations of all whole fades below a threshold.

    Parameters
    ----------
    time, gain, threshold, relative_to
        As in `level_crossing_rate`.

    Returns
    -------
    ndarray, shape (m,)
        Durations [s], whole numbers of steps. Fades cut by an end of the record are left out,
        which favours short ones in a record of few fades: compare records of equal length, or see
        `mean_fade_duration`.

    Raises
    ------
    Refused
        As `level_crossing_rate`.

    Examples
    --------
    >>> fade_durations([0.0, 0.1, 0.2, 0.3, 0.4], [1.0, 0.3, 0.2, 1.0, 1.2], 0.5).round(3)
    array([0.2])
    """
    _, step, under = _record(time, gain, threshold, relative_to)
    change = np.diff(under.astype(np.int8))
    falls, rises = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
    # a rise before the first fall ends a fade that began before the record
    rises = rises[rises > falls[0]] if falls.size else falls
    return np.asarray(step * (rises - falls[: rises.size]), dtype=np.float64)


def _record(
    time: ArrayLike, gain: ArrayLike, threshold: float, relative_to: Reference
) -> tuple[Floats, float, NDArray[np.bool_]]:
    """Return gains, time step, and whether each gain is below the level."""
    g = checked_gain(gain)
    return g, checked_step(time, g.size), g < level_of(g, threshold, relative_to)
