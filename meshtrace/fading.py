"""Fading statistics of channel gains: ensembles of realizations and time series.

Every function takes the gains as an array. `gain_stderr` is the Monte Carlo standard error of
each gain, independent from one gain to the next; its variance is removed from what is measured.
An error that all gains share (common random numbers) neither adds to their spread nor cancels in
their mean: leave `gain_stderr` out, or tell `fading_statistics` that ``noise="common"``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace import fields

if TYPE_CHECKING:
    import xarray

FloatArray = NDArray[np.float64]
Model = Literal["lognormal", "gamma-gamma"]
Reference = Literal["mean", "median", "absolute"]
Noise = Literal["independent", "common"]

# The log-skewness of gamma-gamma laws of equal scintillation index spans sigma / 2; it takes
# n sigma^2 = 96 samples to see that span at two standard errors sqrt(6 / n).
_SAMPLES_TIMES_SI = 96.0
# 4 alpha beta / (alpha + beta)^2 at alpha = 1000 beta.
_LEAST_BALANCE = 4.0 * 1e3 / 1001.0**2
# Below these numbers a method has too little to work on, and another one or none is used:
# jackknife of the BCa bootstrap, block bootstrap of crossings, intervals of a series, test of fit.
_FEWEST_ACCELERATED = 8
_FEWEST_CROSSINGS = 20
_FEWEST_EFFECTIVE = 20.0
_FEWEST_TESTED = 20
# With fewer replicates all may lie on one side of the estimate, and BCa divides by zero.
_FEWEST_RESAMPLES = 50
# Bounds of memory: gains resampled at a time, and blocks of one replicate.
_BATCH_ELEMENTS = 1_000_000
_MOST_BLOCKS = 1000


class Estimate(NamedTuple):
    """A value with its confidence interval; ``float(estimate)`` is the value."""

    value: float
    low: float
    high: float

    def __float__(self) -> float:
        return float(self.value)


class Histogram(NamedTuple):
    """A probability density over bins: edges (m + 1,), density (m,) and its stderr (m,)."""

    edges: FloatArray
    density: FloatArray
    density_stderr: FloatArray


class Distribution(NamedTuple):
    """An empirical CDF: sorted gains (n,), P(gain <= x) (n,) and its confidence limits (n,)."""

    gain: FloatArray
    probability: FloatArray
    low: FloatArray
    high: FloatArray


class GoodnessOfFit(NamedTuple):
    """Kolmogorov-Smirnov distance `ks` of a fitted law from `n` samples, and its p-value."""

    model: Model
    ks: float
    p_value: float
    n: int


# --- input ---------------------------------------------------------------------------------


def _checked_gain(gain: ArrayLike) -> FloatArray:
    g = np.asarray(gain, dtype=np.float64)
    if g.ndim != 1 or g.size < 2:
        raise ValueError(f"gain: shape {g.shape}, allowed (n,) with n >= 2")
    _check_values("gain", g)
    if not g.any():
        raise ValueError("gain: all 0, allowed at least one gain > 0")
    return g


def _checked(gain: ArrayLike, gain_stderr: ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    """Return the gains and the variance of the Monte Carlo error of each."""
    g = _checked_gain(gain)
    if gain_stderr is None:
        return g, np.zeros_like(g)
    stderr = np.asarray(gain_stderr, dtype=np.float64)
    if stderr.shape not in ((), g.shape):
        raise ValueError(f"gain_stderr: shape {stderr.shape}, allowed () or {g.shape}")
    stderr = np.broadcast_to(stderr, g.shape)
    _check_values("gain_stderr", stderr)
    return g, stderr**2


def _check_values(name: str, values: FloatArray) -> None:
    bad = np.flatnonzero(~(np.isfinite(values) & (values >= 0.0)))
    if bad.size:
        raise ValueError(f"{name}: {values[bad[0]]} at index {bad[0]}, allowed finite values >= 0")


def _checked_step(time: ArrayLike, n: int) -> float:
    t = np.asarray(time, dtype=np.float64)
    if t.shape != (n,):
        raise ValueError(f"time: shape {t.shape}, allowed ({n},), one time [s] per gain")
    if not np.isfinite(t).all():
        raise ValueError("time: not all finite, allowed finite times [s]")
    step = (t[-1] - t[0]) / (n - 1)
    if not step > 0.0 or np.abs(np.diff(t) - step).max() > 1e-6 * step + 1e-12 * np.abs(t).max():
        raise ValueError("time: not equally spaced and increasing, allowed a constant step > 0 s")
    return float(step)


def _check_bootstrap(confidence: float, resamples: int = _FEWEST_RESAMPLES) -> None:
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: {confidence}, allowed 0 < confidence < 1")
    if resamples < _FEWEST_RESAMPLES:
        raise ValueError(f"resamples: {resamples}, allowed resamples >= {_FEWEST_RESAMPLES}")


def _level(gain: FloatArray, threshold: float, relative_to: Reference) -> float:
    """Return the threshold as a gain."""
    if not (math.isfinite(threshold) and threshold > 0.0):
        raise ValueError(f"threshold: {threshold}, allowed finite > 0")
    if relative_to not in ("mean", "median", "absolute"):
        raise ValueError(f"relative_to: {relative_to!r}, allowed 'mean', 'median', 'absolute'")
    if relative_to == "absolute":
        return threshold
    return threshold * float(gain.mean() if relative_to == "mean" else np.median(gain))


# --- Monte Carlo noise -----------------------------------------------------------------------


def remove_noise(gain: ArrayLike, gain_stderr: ArrayLike | None = None) -> FloatArray:
    r"""Return the gains with their spread freed from the independent Monte Carlo error.

    .. math:: \ln g' = \overline{\ln g} + \sqrt{1 - \overline{(s/g)^2} / \mathrm{Var}(\ln g)}
              \; (\ln g - \overline{\ln g}) + \mathrm{const}

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1].
    gain_stderr : array_like, shape () or (n,), optional
        Independent standard error of each gain [1]; without it the gains are returned as is.

    Returns
    -------
    ndarray, shape (n,)
        Gains [1] of the same order and mean, whose log-variance is that of the fading alone;
        all equal if the noise explains the whole spread.

    Raises
    ------
    ValueError
        If there are fewer than two gains or a value is negative or not finite.

    Notes
    -----
    The shape of the noise is not deconvolved, only its variance removed. The expansion of the
    logarithm wants relative errors below about 0.3; gains of zero stay zero. The mean is kept.

    Examples
    --------
    >>> remove_noise([0.8, 1.0, 1.2], 0.1).round(3)
    array([0.827, 1.002, 1.171])
    """
    g, noise = _checked(gain, gain_stderr)
    seen = g > 0.0
    log_gain = np.log(g[seen])
    if not noise.any() or log_gain.size < 2 or np.ptp(log_gain) == 0.0:
        return g.copy()
    kept = 1.0 - np.mean(noise[seen] / g[seen] ** 2) / log_gain.var(ddof=1)
    if kept <= 0.0:
        return np.where(seen, g[seen].mean(), 0.0)
    out = np.zeros_like(g)
    out[seen] = np.exp(math.sqrt(kept) * (log_gain - log_gain.mean()))
    return out * (g.mean() / out.mean())


# --- correlation ---------------------------------------------------------------------------


def _autocovariance(x: FloatArray) -> FloatArray:
    """Return the autocovariance at lags 0..n-1, each lag divided by its number of pairs."""
    n = x.size
    spectrum = np.fft.rfft(x - x.mean(), 2 * n)
    return np.fft.irfft(np.abs(spectrum) ** 2)[:n] / np.arange(n, 0, -1)


def autocorrelation(
    gain: ArrayLike, gain_stderr: ArrayLike | None = None, *, max_lag: int | None = None
) -> FloatArray:
    r"""Return the autocorrelation of an equally spaced series, Monte Carlo noise removed.

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
        Correlation coefficients at lags 0, 1, ... samples. Noise can take them beyond 1.

    Raises
    ------
    ValueError
        If the gains are invalid, `max_lag` is outside 0..n - 1, or no variance is left
        beside the noise.

    Notes
    -----
    C_k is divided by the n - k pairs of the lag; its mean is the record's, so that all lags are
    low by about Var / (number of independent samples).

    Examples
    --------
    >>> autocorrelation([1.0, 2.0, 1.0, 2.0], max_lag=2)
    array([ 1., -1.,  1.])
    """
    g, noise = _checked(gain, gain_stderr)
    max_lag = g.size // 2 if max_lag is None else max_lag
    if not 0 <= max_lag < g.size:
        raise ValueError(f"max_lag: {max_lag}, allowed 0 <= max_lag <= {g.size - 1}")
    x = g / g.mean()
    share = float(noise.mean()) / float(g.mean()) ** 2
    variance = float(x.var()) - share
    if np.ptp(g) == 0.0 or not variance > 0.0:
        raise ValueError(
            f"gain: variance {x.var():.3g} of gain / mean, allowed more than that of the Monte "
            f"Carlo noise, {share:.3g}"
        )
    rho = _autocovariance(x)[: max_lag + 1] / variance
    rho[0] = 1.0
    return rho


def effective_samples(gain: ArrayLike, gain_stderr: ArrayLike | None = None) -> float:
    r"""Return how many independent samples a correlated series is worth.

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
    ValueError
        As `autocorrelation`.

    Notes
    -----
    The first sum holds for the mean, the second for the variance of a Gaussian process (it does
    not cancel where the correlation oscillates, as that of waves does); the more careful of the
    two is taken. Both sums end at the first lag beyond five times the second: Sokal's window,
    with the squares because the first sum can pass through 0.

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
    window = beyond[0] if beyond.size else rho.size - 1
    inflation = max(1.0 + 2.0 * float(rho[: window + 1].sum()), float(squares[window]))
    return float(np.size(gain) / min(inflation, np.size(gain)))


def block_length(gain: ArrayLike) -> int:
    r"""Return the length of the blocks in which to resample a correlated series.

    .. math:: b = 3 \, (2 G^2 / D)^{1/3} n^{1/3}, \quad G = \sum \lambda_k |k| C_k, \quad
              D = \tfrac43 \left(\sum \lambda_k C_k\right)^2

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1] at equal time steps.

    Returns
    -------
    int
        Block length in samples, n / 1000 to n / 4: longer blocks cost no accuracy there.

    Raises
    ------
    ValueError
        If the gains are invalid.

    Notes
    -----
    Three times the length of Politis and White: theirs has the least mean square error of the
    variance, but that variance is low by O(1 / b) and its intervals too narrow. Their
    flat-top window reaches to the lag where the autocorrelation becomes insignificant. C is
    that of the squared deviation from the mean, on which the scintillation index rests;
    the correlation of the gain itself can cancel in the sum (waves oscillate).

    References
    ----------
    Politis, D. N. and White, H. (2004), doi:10.1081/ETC-120028836; corrected by Patton,
    Politis and White (2009), doi:10.1080/07474930802459016.

    Examples
    --------
    >>> block_length(np.random.default_rng(1).uniform(1.0, 2.0, 500)) < 10
    True
    """
    g = _checked_gain(gain)
    if np.ptp(g) == 0.0:
        return 1
    deviation = g / g.mean() - 1.0
    shortest = max(1, g.size // _MOST_BLOCKS)
    return int(np.clip(round(3.0 * _politis_white(deviation**2)), shortest, max(g.size // 4, 1)))


def _politis_white(x: FloatArray) -> float:
    n = x.size
    x = x - x.mean()
    covariance = _autocovariance(x) * np.arange(n, 0, -1) / n
    if not covariance[0] > 0.0:
        return 1.0
    run = max(5, math.ceil(math.sqrt(math.log10(n))))
    last = min(n - 1, math.ceil(math.sqrt(n)) + run)
    bound = 2.0 * math.sqrt(math.log10(n) / n) * covariance[0]
    quiet = np.append(np.abs(covariance[1 : last + 1]) < bound, np.ones(run, dtype=bool))
    window = int(np.argmax(np.lib.stride_tricks.sliding_window_view(quiet, run).all(axis=1)))
    m = min(2 * max(window, 1), last)
    k = np.arange(1, m + 1)
    tapered = np.minimum(1.0, 2.0 * (1.0 - k / m)) * covariance[1 : m + 1]
    spectrum = covariance[0] + 2.0 * tapered.sum()
    if spectrum == 0.0:
        return float(n)
    return float((1.5 * (2.0 * np.sum(k * tapered) / spectrum) ** 2 * n) ** (1.0 / 3.0))


# --- intervals -----------------------------------------------------------------------------


def _block_means(
    columns: Iterable[FloatArray], block: int, resamples: int, seed: int
) -> FloatArray:
    """Return the means (p, resamples) of p columns (n,) over the same random moving blocks."""
    rng = np.random.default_rng(seed)
    starts = None
    means = []
    for column in columns:
        n = column.size
        if starts is None:
            starts = rng.integers(0, n - block + 1, (resamples, max(1, round(n / block))))
        total = np.concatenate([[0.0], np.cumsum(column)])
        means.append((total[starts + block] - total[starts]).mean(axis=1) / block)
    return np.stack(means)


def _block_interval(
    value: float, replicates: FloatArray, n_blocks: float, confidence: float
) -> Estimate:
    """Return the interval of a positive quantity from its replicates over moving blocks.

    The central 68 % of the replicates, in the logarithm, stretched to `confidence` with Student's
    t: few blocks make plain percentiles too narrow (85 % instead of 95 % with 25 blocks).
    """
    from scipy import special

    low, middle, high = np.quantile(
        replicates, special.ndtr([-1.0, 0.0, 1.0]), method="inverted_cdf"
    )
    if not 0.0 < middle < math.inf:
        return Estimate(value, 0.0, math.inf)
    freedom = max(n_blocks - 1.0, 1.0)
    stretch = special.stdtrit(freedom, 0.5 + 0.5 * confidence) * math.sqrt(1.0 + 1.0 / freedom)
    with np.errstate(over="ignore"):
        low, high = value * (np.array([low, high]) / middle) ** stretch
    return Estimate(value, float(low), float(high))


def _wilson(probability: float, n: float, confidence: float) -> Estimate:
    """Return the Wilson limits of a fraction seen in n trials; n need not be whole."""
    from scipy import special

    z2 = float(special.ndtri(0.5 + 0.5 * confidence)) ** 2
    scale = 1.0 / (1.0 + z2 / n)
    center = (probability + 0.5 * z2 / n) * scale
    half = math.sqrt(z2 / n * (probability * (1.0 - probability) + 0.25 * z2 / n)) * scale
    # At 0 and 1 the exact limit is lost to rounding, and the value would lie outside.
    low, high = min(probability, center - half), max(probability, center + half)
    return Estimate(probability, max(0.0, low), min(1.0, high))


# --- one-sample statistics -----------------------------------------------------------------


def scintillation_index(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    block: int = 1,
    confidence: float = 0.95,
    resamples: int = 1999,
    seed: int = 0,
) -> Estimate:
    r"""Return the scintillation index, Monte Carlo variance removed, with its interval.

    .. math:: \mathrm{SI} = (\mathrm{Var}(g) - \overline{s^2}) / \overline{g}^2

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1].
    gain_stderr : array_like, shape () or (n,), optional
        Independent standard error of each gain [1].
    block : int, optional
        Block length [samples]: 1 for independent gains, `block_length(gain)` for a series.
    confidence : float, optional
        Level of the interval [1].
    resamples, seed : int, optional
        Number and seed of the bootstrap replicates.

    Returns
    -------
    Estimate
        Index [1] and its limits. With the noise removed it is unbiased, hence negative at times
        where there is no fading.

    Raises
    ------
    ValueError
        If a value is negative or not finite, or an option is out of range.

    Notes
    -----
    Var divides by n - 1. Independent gains: bias-corrected accelerated (BCa) bootstrap of the
    pairs (gain, error), below 8 gains its percentiles. Series: moving blocks; the index of a
    short record is low by about SI / n_eff, see `effective_samples`. Heavy tails (SI above 0.3)
    need thousands of samples before any such interval covers as often as it says.

    References
    ----------
    Efron, B. (1987), doi:10.1080/01621459.1987.10478410. Künsch, H. R. (1989),
    doi:10.1214/aos/1176347265.

    Examples
    --------
    >>> si = scintillation_index([0.9, 1.1, 1.0, 0.8, 1.2], 0.05)
    >>> round(si.value, 4)
    0.0225
    """
    g, noise = _checked(gain, gain_stderr)
    _check_bootstrap(confidence, resamples)
    if not 1 <= block <= g.size // 2:
        raise ValueError(f"block: {block}, allowed 1 <= block <= n / 2 = {g.size // 2}")
    noise = noise / g.mean() ** 2
    g = g / g.mean()
    value = float(_scintillation(g, noise))
    if np.ptp(g) == 0.0:
        return Estimate(value, value, value)
    if block == 1:
        return _accelerated_interval(value, g, noise, confidence, resamples, seed)
    mean, square = _block_means((g, g**2), block, resamples, seed)
    raw = (square / mean**2 - 1.0) * g.size / (g.size - 1.0)
    seen = _block_interval(float(_scintillation(g, 0.0 * g)), raw, g.size / block, confidence)
    return Estimate(value, seen.low - float(noise.mean()), seen.high - float(noise.mean()))


def _scintillation(g: FloatArray, noise: FloatArray, axis: int = -1) -> FloatArray:
    excess, mean = g.var(axis, ddof=1) - noise.mean(axis), g.mean(axis)
    # A resample of blocked links alone has no light: count it as no fading.
    return np.divide(excess, mean**2, out=np.zeros_like(mean), where=mean > 0.0)


def _accelerated_interval(
    value: float, g: FloatArray, noise: FloatArray, confidence: float, resamples: int, seed: int
) -> Estimate:
    from scipy import stats

    interval = stats.bootstrap(
        (g, noise),
        _scintillation,
        paired=True,
        vectorized=True,
        confidence_level=confidence,
        n_resamples=resamples,
        batch=max(1, _BATCH_ELEMENTS // g.size),
        method="BCa" if g.size >= _FEWEST_ACCELERATED else "percentile",
        random_state=np.random.default_rng(seed),
    ).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high))


def outage(
    gain: ArrayLike,
    threshold: float = 0.5,
    gain_stderr: ArrayLike | None = None,
    *,
    relative_to: Reference = "mean",
    n_effective: float | None = None,
    confidence: float = 0.95,
) -> Estimate:
    r"""Return the outage probability with its Wilson interval.

    .. math:: P_\mathrm{out} = P(g < \mathrm{threshold})

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1].
    threshold : float, optional
        Threshold [1], a multiple of the reference.
    gain_stderr : array_like, shape () or (n,), optional
        Independent standard error of each gain [1], freed from by `remove_noise` first.
    relative_to : {"mean", "median", "absolute"}, optional
        Reference of the threshold; "absolute" takes it as a gain.
    n_effective : float, optional
        Number of independent samples, by default n; for a series see `effective_samples`.
    confidence : float, optional
        Level of the interval [1].

    Returns
    -------
    Estimate
        Probability [1] and its limits.

    Raises
    ------
    ValueError
        If a value is negative or not finite, or an option is out of range.

    References
    ----------
    Wilson, E. B. (1927), doi:10.1080/01621459.1927.10502953.

    Examples
    --------
    >>> outage([0.4, 1.0, 1.2, 1.4], 0.5, relative_to="absolute").value
    0.25
    """
    g = remove_noise(gain, gain_stderr)
    _check_bootstrap(confidence)
    n = float(g.size) if n_effective is None else n_effective
    if not 1.0 <= n <= g.size:
        raise ValueError(f"n_effective: {n_effective}, allowed 1 <= n_effective <= {g.size}")
    return _wilson(float(np.mean(g < _level(g, threshold, relative_to))), n, confidence)


def gain_pdf(
    gain: ArrayLike, gain_stderr: ArrayLike | None = None, *, bins: int | str = "auto"
) -> Histogram:
    """Return the probability density of the gain as a histogram with its standard error.

    Parameters
    ----------
    gain, gain_stderr
        As in `remove_noise`, which is applied first.
    bins : int or str, optional
        Number of bins or a rule of `numpy.histogram_bin_edges`.

    Returns
    -------
    Histogram
        Edges [1], density [1] per unit of gain, and its binomial standard error for
        independent gains.

    Raises
    ------
    ValueError
        If a value is negative or not finite.

    Examples
    --------
    >>> h = gain_pdf([1.0, 1.2, 1.4, 2.0], bins=2)
    >>> float(np.sum(h.density * np.diff(h.edges)))
    1.0
    """
    g = remove_noise(gain, gain_stderr)
    count, edges = np.histogram(g / g.mean(), bins=bins)
    edges = edges * g.mean()
    share, width = count / g.size, np.diff(edges)
    return Histogram(edges, share / width, np.sqrt(share * (1.0 - share) / g.size) / width)


def gain_cdf(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    n_effective: float | None = None,
    confidence: float = 0.95,
) -> Distribution:
    r"""Return the empirical distribution function with a band that holds everywhere at once.

    .. math:: F_n(x) \pm \sqrt{\ln(2 / (1 - \mathrm{confidence})) / (2 n_\mathrm{eff})}

    Parameters
    ----------
    gain, gain_stderr
        As in `remove_noise`, which is applied first.
    n_effective : float, optional
        Number of independent samples, by default n; for a series see `effective_samples`.
    confidence : float, optional
        Level of the band [1].

    Returns
    -------
    Distribution
        Sorted gains [1], P(g <= x) [1] and the limits of the band [1].

    Raises
    ------
    ValueError
        If a value is negative or not finite, or an option is out of range.

    References
    ----------
    Massart, P. (1990), The tight constant in the Dvoretzky-Kiefer-Wolfowitz inequality,
    doi:10.1214/aop/1176990746.

    Examples
    --------
    >>> gain_cdf([2.0, 1.0, 4.0, 3.0]).probability
    array([0.25, 0.5 , 0.75, 1.  ])
    """
    g = np.sort(remove_noise(gain, gain_stderr))
    _check_bootstrap(confidence)
    n = float(g.size) if n_effective is None else n_effective
    if not 1.0 <= n <= g.size:
        raise ValueError(f"n_effective: {n_effective}, allowed 1 <= n_effective <= {g.size}")
    probability = np.arange(1, g.size + 1) / g.size
    half = math.sqrt(math.log(2.0 / (1.0 - confidence)) / (2.0 * n))
    return Distribution(
        g, probability, np.maximum(probability - half, 0.0), np.minimum(probability + half, 1.0)
    )


# --- time series ---------------------------------------------------------------------------


def coherence_time(
    time: ArrayLike,
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    block: int | None = None,
    confidence: float = 0.95,
    resamples: int = 999,
    seed: int = 0,
) -> Estimate:
    r"""Return the time after which the autocorrelation has fallen to 1/e, with its interval.

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
        Coherence time [s] and its limits, linear between lags; infinite if the autocorrelation
        stays above 1/e up to lag n // 2.

    Raises
    ------
    ValueError
        If the times are not equally spaced, the gains are invalid, or no variance is left
        beside the noise.

    Notes
    -----
    Below one time step the value is only an upper bound: sample faster. The interval resamples
    blocks of the lagged products (Künsch's blocks of blocks).

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
    g, noise = _checked(gain, gain_stderr)
    step = _checked_step(time, g.size)
    _check_bootstrap(confidence, resamples)
    rho = autocorrelation(g, gain_stderr)
    crossing = float(_first_crossing(rho[:, None])[0])
    if math.isinf(crossing):
        return Estimate(math.inf, (rho.size - 1) * step, math.inf)
    lags = min(rho.size, 4 * math.ceil(crossing) + 2)
    x = g / g.mean() - 1.0
    block = _series_block(block, g)
    means = _block_means(_lagged_products(x, lags), block, resamples, seed)
    covariance = means[1:] - means[0] ** 2
    variance = covariance[0] - noise.mean() / g.mean() ** 2
    covariance[0] = variance
    # A replicate without variance beside the noise never falls below 1/e.
    rho = np.divide(covariance, variance, out=np.ones_like(covariance), where=variance > 0.0)
    replicates = _first_crossing(rho)
    found = _block_interval(crossing, replicates, g.size / block, confidence)
    return Estimate(found.value * step, found.low * step, found.high * step)


def _lagged_products(x: FloatArray, lags: int) -> Iterator[FloatArray]:
    rows = x.size - lags + 1
    yield x[:rows]
    for lag in range(lags):
        yield x[:rows] * x[lag : lag + rows]


def _first_crossing(rho: FloatArray) -> FloatArray:
    """Return the first lag [samples] of 1/e along axis 0, interpolated; inf where there is none."""
    level = math.exp(-1.0)
    below = rho <= level
    after = np.maximum(below.argmax(axis=0), 1)
    column = np.arange(rho.shape[1])
    high, low = rho[after - 1, column], rho[after, column]
    drop = np.where(below.any(axis=0), high - low, 1.0)
    return np.where(below.any(axis=0), after - 1 + (high - level) / drop, math.inf)


def _series_block(block: int | None, g: FloatArray) -> int:
    block = block_length(g) if block is None else block
    if not 1 <= block <= max(1, g.size // 2):
        raise ValueError(f"block: {block}, allowed 1 <= block <= n / 2 = {g.size // 2}")
    return block


def level_crossing_rate(
    time: ArrayLike,
    gain: ArrayLike,
    threshold: float = 0.5,
    *,
    relative_to: Reference = "mean",
    block: int | None = None,
    confidence: float = 0.95,
    resamples: int = 999,
    seed: int = 0,
) -> Estimate:
    r"""Return how often the gain falls through a threshold, with the interval.

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
    ValueError
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
    g = _checked_gain(gain)
    step = _checked_step(time, g.size)
    _check_bootstrap(confidence, resamples)
    fall, _ = _fades(g, _level(g, threshold, relative_to))
    count, duration = float(fall.sum()), step * fall.size
    block = _series_block(block, g)
    if count < _FEWEST_CROSSINGS:
        low, high = _poisson_limits(count, confidence)
        return Estimate(count / duration, low / duration, high / duration)
    rate = _block_means((fall,), min(block, fall.size), resamples, seed)[0] / step
    return _block_interval(count / duration, rate, g.size / block, confidence)


def mean_fade_duration(
    time: ArrayLike,
    gain: ArrayLike,
    threshold: float = 0.5,
    *,
    relative_to: Reference = "mean",
    block: int | None = None,
    confidence: float = 0.95,
    resamples: int = 999,
    seed: int = 0,
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
    ValueError
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
    g = _checked_gain(gain)
    step = _checked_step(time, g.size)
    _check_bootstrap(confidence, resamples)
    fall, below = _fades(g, _level(g, threshold, relative_to))
    count = float(fall.sum())
    block = _series_block(block, g)
    if count == 0.0:
        return Estimate(math.nan, math.nan, math.nan)
    value = float(below.sum()) * step / count
    if count < _FEWEST_CROSSINGS:
        return _exponential_limits(value, count, confidence)
    low, falls = _block_means((below, fall), min(block, fall.size), resamples, seed)
    durations = step * np.divide(low, falls, out=np.full_like(low, math.inf), where=falls > 0.0)
    return _block_interval(value, durations, g.size / block, confidence)


def _fades(g: FloatArray, level: float) -> tuple[FloatArray, FloatArray]:
    """Return, per time step, whether the gain falls through the level, and its share below."""
    under = g < level
    fall = (~under[:-1] & under[1:]).astype(np.float64)
    return fall, 0.5 * under[:-1] + 0.5 * under[1:]


def _poisson_limits(count: float, confidence: float) -> tuple[float, float]:
    from scipy import special

    tail = 0.5 - 0.5 * confidence
    low = float(special.gammaincinv(count, tail)) if count else 0.0
    return low, float(special.gammainccinv(count + 1.0, tail))


def _exponential_limits(value: float, count: float, confidence: float) -> Estimate:
    from scipy import special

    tail = 0.5 - 0.5 * confidence
    high, low = special.gammaincinv(count, tail), special.gammainccinv(count, tail)
    return Estimate(value, float(count * value / low), float(count * value / high))


# --- laws ----------------------------------------------------------------------------------


def _check_gamma_gamma(alpha: float, beta: float, mean: float) -> None:
    for name, value in (("alpha", alpha), ("beta", beta), ("mean", mean)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name}: {value}, allowed finite > 0")


def gamma_gamma_pdf(gain: ArrayLike, alpha: float, beta: float, mean: float = 1.0) -> FloatArray:
    r"""Return the gamma-gamma probability density.

    .. math:: f(h) = \frac{2 (\alpha\beta)^{(\alpha+\beta)/2}}{\Gamma(\alpha)\Gamma(\beta)}
              h^{(\alpha+\beta)/2 - 1} K_{\alpha-\beta}(2 \sqrt{\alpha\beta h}),
              \quad h = g / \mathrm{mean}

    Parameters
    ----------
    gain : array_like
        Gains [1].
    alpha, beta : float
        Shapes [1] of the two gamma factors, interchangeable.
    mean : float, optional
        Mean gain [1].

    Returns
    -------
    ndarray
        Density [1] per unit of gain; 0 at gains <= 0.

    Raises
    ------
    ValueError
        If a parameter is not positive and finite.

    Notes
    -----
    Computed in the logarithm from the scaled Bessel function; where that overflows (large
    orders), from its uniform expansion, good to 1e-6 of the density at order 5 and better above.

    References
    ----------
    Al-Habash, Andrews and Phillips (2001), doi:10.1117/1.1386641. DLMF 10.41.4.

    Examples
    --------
    >>> gamma_gamma_pdf(1.0, 4.0, 2.0).round(6)
    np.float64(0.425916)
    """
    _check_gamma_gamma(alpha, beta, mean)
    h = np.asarray(gain, dtype=np.float64) / mean
    density = np.zeros_like(h)
    density[h > 0.0] = np.exp(_gamma_gamma_log_pdf(np.log(h[h > 0.0]), alpha, beta)) / mean
    return density


def _gamma_gamma_log_pdf(log_h: FloatArray, alpha: float, beta: float) -> FloatArray:
    """Return ln f(h) for unit mean."""
    from scipy import special

    half = 0.5 * (alpha + beta)
    log_product = math.log(alpha) + math.log(beta)
    constant = math.log(2.0) - special.gammaln(alpha) - special.gammaln(beta)
    bessel = _log_kv(abs(alpha - beta), 2.0 * np.exp(0.5 * (log_product + log_h)))
    return constant + half * (log_product + log_h) - log_h + bessel


def _log_kv(order: float, x: FloatArray) -> FloatArray:
    """Return ln K_order(x), from the uniform expansion where the scaled function overflows."""
    from scipy import special

    with np.errstate(divide="ignore", over="ignore"):
        scaled = special.kve(order, x)
    out = np.log(scaled, out=np.full_like(x, math.inf), where=np.isfinite(scaled)) - x
    lost = ~np.isfinite(scaled)
    if lost.any():
        z = x[lost] / order
        root = np.hypot(1.0, z)
        p = 1.0 / root
        u1 = (3.0 * p - 5.0 * p**3) / 24.0
        u2 = (81.0 * p**2 - 462.0 * p**4 + 385.0 * p**6) / 1152.0
        series = 1.0 - u1 / order + u2 / order**2
        eta = root + np.log(z) - np.log1p(root)
        out[lost] = 0.5 * np.log(0.5 * np.pi / (order * root)) - order * eta + np.log(series)
    return out


def gamma_gamma_cdf(gain: ArrayLike, alpha: float, beta: float, mean: float = 1.0) -> FloatArray:
    """Return the gamma-gamma distribution function, the integral of `gamma_gamma_pdf`.

    Parameters
    ----------
    gain, alpha, beta, mean
        As in `gamma_gamma_pdf`.

    Returns
    -------
    ndarray
        P(g <= gain) [1].

    Raises
    ------
    ValueError
        If a parameter is not positive and finite.

    Notes
    -----
    Spline quadrature in ln h over 40 standard deviations below and 12 above the mean; absolute
    error below 1e-8. The hypergeometric closed form cancels for shapes above a few tens.

    Examples
    --------
    >>> gamma_gamma_cdf([0.5, 1.0, 2.0], 4.0, 2.0).round(6)
    array([0.34934 , 0.637981, 0.883654])
    """
    from scipy import interpolate, special

    _check_gamma_gamma(alpha, beta, mean)
    shapes = np.array([alpha, beta])
    center = float(np.sum(special.digamma(shapes) - np.log(shapes)))
    width = math.sqrt(float(np.sum(special.polygamma(1, shapes))))
    t = center + width * np.linspace(-40.0, 12.0, 2048)
    density = np.exp(_gamma_gamma_log_pdf(t, alpha, beta) + t)
    integral = interpolate.CubicSpline(t, density).antiderivative()
    with np.errstate(divide="ignore"):
        log_h = np.log(np.maximum(np.asarray(gain, dtype=np.float64) / mean, 0.0))
    return np.clip(integral(np.clip(log_h, t[0], t[-1])) / integral(t[-1]), 0.0, 1.0)


def sample_gamma_gamma(
    n: int, alpha: float, beta: float, mean: float = 1.0, *, rng: np.random.Generator
) -> FloatArray:
    """Draw gamma-gamma gains: the product of two independent gamma variables.

    Parameters
    ----------
    n : int
        Number of gains.
    alpha, beta, mean : float
        As in `gamma_gamma_pdf`.
    rng : numpy.random.Generator
        Source of random numbers.

    Returns
    -------
    ndarray, shape (n,)
        Gains [1].

    Raises
    ------
    ValueError
        If a parameter is not positive and finite.

    Examples
    --------
    >>> sample_gamma_gamma(3, 4.0, 2.0, rng=np.random.default_rng(1)).shape
    (3,)
    """
    _check_gamma_gamma(alpha, beta, mean)
    return mean * rng.gamma(alpha, 1.0 / alpha, n) * rng.gamma(beta, 1.0 / beta, n)


@dataclass(frozen=True)
class DistributionFit:
    """A law fitted to gains.

    Parameters
    ----------
    model : {"lognormal", "gamma-gamma"}
        The law.
    parameters : dict
        ``mu``, ``sigma`` of ln(gain), or ``alpha``, ``beta``, ``mean``.
    n : int
        Number of gains.
    n_free : int
        Number of free parameters.
    log_likelihood : float
        Maximum of ln(likelihood).
    note : str, optional
        What the reader must know, empty if nothing.
    """

    model: Model
    parameters: dict[str, float]
    n: int
    n_free: int
    log_likelihood: float
    note: str = ""

    @property
    def aic(self) -> float:
        """Akaike's criterion 2 k - 2 ln L; among laws for the same gains the least is best."""
        return 2.0 * self.n_free - 2.0 * self.log_likelihood

    @property
    def scintillation_index(self) -> float:
        """Scintillation index [1] of the law."""
        p = self.parameters
        if self.model == "lognormal":
            return math.expm1(p["sigma"] ** 2)
        return 1.0 / p["alpha"] + 1.0 / p["beta"] + 1.0 / (p["alpha"] * p["beta"])

    def pdf(self, gain: ArrayLike) -> FloatArray:
        """Return the density [1] per unit of gain."""
        if self.model == "gamma-gamma":
            return gamma_gamma_pdf(gain, **self.parameters)
        return np.asarray(self._lognormal().pdf(np.asarray(gain, dtype=np.float64)))

    def cdf(self, gain: ArrayLike) -> FloatArray:
        """Return P(g <= gain) [1]: the outage probability at that gain."""
        if self.model == "gamma-gamma":
            return gamma_gamma_cdf(gain, **self.parameters)
        return np.asarray(self._lognormal().cdf(np.asarray(gain, dtype=np.float64)))

    def sample(self, n: int, *, rng: np.random.Generator) -> FloatArray:
        """Draw n gains [1]."""
        if self.model == "gamma-gamma":
            return sample_gamma_gamma(n, **self.parameters, rng=rng)
        return rng.lognormal(self.parameters["mu"], self.parameters["sigma"], n)

    def _lognormal(self) -> Any:
        from scipy import stats

        return stats.lognorm(self.parameters["sigma"], scale=math.exp(self.parameters["mu"]))


def _fit_sample(gain: ArrayLike, gain_stderr: ArrayLike | None) -> FloatArray:
    g = remove_noise(gain, gain_stderr)
    if not g.all():
        zeros = g.size - np.count_nonzero(g)
        raise ValueError(f"gain: {zeros} of {g.size} are 0, allowed gains > 0 for a fit")
    if np.ptp(g) <= 1e-12 * g.max():
        raise ValueError("gain: no variance beside the Monte Carlo noise, allowed gains that vary")
    return g


def fit_lognormal(gain: ArrayLike, gain_stderr: ArrayLike | None = None) -> DistributionFit:
    r"""Fit a lognormal law by maximum likelihood.

    .. math:: \mu = \overline{\ln g'}, \quad \sigma^2 = \overline{(\ln g' - \mu)^2}

    Parameters
    ----------
    gain, gain_stderr
        As in `remove_noise`, which gives the g' of the equation.

    Returns
    -------
    DistributionFit
        Parameters ``mu`` and ``sigma``.

    Raises
    ------
    ValueError
        If a gain is 0, negative or not finite, or no variance is left beside the noise.

    Notes
    -----
    SI = exp(sigma^2) - 1.

    Examples
    --------
    >>> fit_lognormal(np.exp([-0.3, 0.0, 0.3])).scintillation_index  # doctest: +ELLIPSIS
    0.0618...
    """
    g = _fit_sample(gain, gain_stderr)
    log_gain = np.log(g)
    mu, sigma = float(log_gain.mean()), float(log_gain.std())
    log_likelihood = -g.size * (mu + math.log(sigma) + 0.5 * math.log(2.0 * math.pi) + 0.5)
    return DistributionFit("lognormal", {"mu": mu, "sigma": sigma}, g.size, 2, log_likelihood)


def fit_gamma_gamma(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    n_effective: float | None = None,
) -> DistributionFit:
    r"""Fit a gamma-gamma law: moments refined by maximum likelihood.

    .. math:: \mathrm{SI} = 1/\alpha + 1/\beta + 1/(\alpha\beta), \quad
              \overline{h^3} / \overline{h^2} = (1 + 2/\alpha)(1 + 2/\beta)

    Parameters
    ----------
    gain, gain_stderr
        As in `remove_noise`, which is applied first.
    n_effective : float, optional
        Number of independent samples, by default n; decides whether the shapes are identifiable.

    Returns
    -------
    DistributionFit
        Parameters ``alpha >= beta`` (the law does not tell them apart) and ``mean``.

    Raises
    ------
    ValueError
        If a gain is 0, negative or not finite, or no variance is left beside the noise.

    Notes
    -----
    The variance fixes one combination of the shapes; only the skewness tells them apart. The
    skewness of ln h lies between -sigma / 2 (alpha = beta) and -sigma (alpha infinite), with
    sigma^2 = ln(1 + SI), and is known to sqrt(6 / n). Below n sigma^2 = 96 that is too
    coarse at two standard errors: alpha = beta is fitted instead, and `note` says so. alpha is
    limited to 1000 beta, which is a gamma law for every purpose.

    References
    ----------
    Al-Habash, Andrews and Phillips (2001), doi:10.1117/1.1386641.

    Examples
    --------
    >>> g = sample_gamma_gamma(4000, 4.0, 2.0, rng=np.random.default_rng(2))
    >>> fit = fit_gamma_gamma(g)
    >>> round(fit.scintillation_index, 2)  # the law has 0.875
    0.86
    """
    g = _fit_sample(gain, gain_stderr)
    log_h = np.log(g / g.mean())
    second = float(np.mean(np.exp(2.0 * log_h)))
    sigma2 = math.log(second)
    known = (g.size if n_effective is None else n_effective) * sigma2
    free = known >= _SAMPLES_TIMES_SI
    balance = _moment_balance(second, float(np.mean(np.exp(3.0 * log_h)))) if free else 1.0
    v, log_likelihood = _maximize_gamma_gamma(log_h, math.log(second - 1.0), balance, free)
    alpha, beta = _shapes(v[1], v[2])
    mean = float(g.mean()) * math.exp(v[0] * math.sqrt(sigma2))
    return DistributionFit(
        "gamma-gamma",
        {"alpha": alpha, "beta": beta, "mean": mean},
        g.size,
        3 if free else 2,
        log_likelihood - g.size * math.log(g.mean()),
        _gamma_gamma_note(known, v[2]),
    )


def _moment_balance(second: float, third: float) -> float:
    """Return 4 alpha beta / (alpha + beta)^2 from the moments of h, kept inside the family."""
    product = 0.5 * (third / second + 1.0) - second
    total = second - 1.0 - product
    return float(np.clip(4.0 * product / total**2, 0.05, 0.95)) if total > 0.0 else 0.95


def _shapes(log_si: float, balance: float) -> tuple[float, float]:
    """Return (alpha, beta) of a scintillation index and 4 alpha beta / (alpha + beta)^2."""
    root = math.sqrt(max(0.0, 1.0 - balance))
    inverse = (1.0 - root) / (1.0 + root)
    si = math.exp(log_si)
    beta = (1.0 + inverse + math.sqrt((1.0 + inverse) ** 2 + 4.0 * si * inverse)) / (2.0 * si)
    return beta / inverse, beta


def _maximize_gamma_gamma(
    log_h: FloatArray, log_si: float, balance: float, free: bool
) -> tuple[FloatArray, float]:
    """Return (ln mean / sigma, ln SI, balance) of the greatest likelihood, and its logarithm.

    The likelihood is even in ln(alpha / beta) and flat at infinite alpha; in the balance
    4 alpha beta / (alpha + beta)^2 it has a slope at both ends, and nearly orthogonal partners.
    """
    from scipy import optimize

    sigma = math.sqrt(math.log1p(math.exp(log_si)))
    nodes, weights = _likelihood_nodes(log_h)

    def cost(v: FloatArray) -> float:
        shift = v[0] * sigma
        log_pdf = _gamma_gamma_log_pdf(nodes - shift, *_shapes(v[1], v[2])) - shift
        return -float(weights @ log_pdf) / log_h.size

    best = optimize.minimize(
        cost,
        [0.0, log_si, balance],
        method="SLSQP",  # as exact as L-BFGS-B here, which BLAS threads slow down on a busy machine
        jac="3-point",
        bounds=[(-1.0, 1.0), (log_si - 3.0, log_si + 3.0), (_LEAST_BALANCE if free else 1.0, 1.0)],
        options={"finite_diff_rel_step": 1e-4, "ftol": 1e-11},
    )
    return best.x, -float(best.fun) * log_h.size


def _likelihood_nodes(log_h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights such that sum f(log_h) = weights @ f(nodes) for a smooth f.

    Local cubic interpolation over 300 nodes: the logarithm of the density is so smooth that 300
    Bessel functions do the work of one per gain, to 1e-4 in ln L.
    """
    m = 300
    if log_h.size <= 2 * m:
        return log_h, np.ones_like(log_h)
    nodes = np.linspace(log_h.min(), log_h.max(), m)
    u = (log_h - nodes[0]) / (nodes[1] - nodes[0])
    left = np.clip(u.astype(np.int64), 1, m - 3)
    u = u - left
    basis = (
        u * (u - 1.0) * (2.0 - u) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        (u + 1.0) * u * (2.0 - u) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    )
    parts = [np.bincount(left + k - 1, part, m) for k, part in enumerate(basis)]
    return nodes, np.sum(parts, axis=0)


def _gamma_gamma_note(known: float, balance: float) -> str:
    if known < _SAMPLES_TIMES_SI:
        return (
            f"alpha and beta cannot be told apart: n ln(1 + SI) = {known:.3g}, needed "
            f"{_SAMPLES_TIMES_SI:.0f}; alpha = beta fitted, only their scintillation index counts"
        )
    if balance > 1.0 - 1e-6:
        return "alpha = beta is the best of the family; the gains are less skewed than that"
    if balance < 1.01 * _LEAST_BALANCE:
        return "alpha at its limit of 1000 beta: a gamma law of shape beta"
    return ""


def goodness_of_fit(
    model: Model,
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    resamples: int = 199,
    seed: int = 0,
) -> GoodnessOfFit:
    r"""Test a law fitted to independent gains by the Kolmogorov-Smirnov distance.

    .. math:: D = \sup_x |F_n(x) - F(x; \hat\theta)|, \quad
              p = (1 + \#\{D^* \ge D\}) / (1 + \mathrm{resamples})

    Parameters
    ----------
    model : {"lognormal", "gamma-gamma"}
        The law, fitted here.
    gain, gain_stderr
        As in `remove_noise`, which is applied first.
    resamples, seed : int, optional
        Number and seed of the synthetic samples.

    Returns
    -------
    GoodnessOfFit
        Distance, p-value and number of gains.

    Raises
    ------
    ValueError
        As the fits.

    Notes
    -----
    The parameters come from the same gains, so the tables of the distance do not hold: D* is
    measured on samples drawn from the fitted law and fitted anew (parametric bootstrap). For a
    series pass gains far enough apart to be independent.

    References
    ----------
    Stute, W., Manteiga, W. G. and Quindimil, M. P. (1993), doi:10.1007/BF02613687.

    Examples
    --------
    >>> g = np.random.default_rng(3).lognormal(-10.0, 0.3, 200)
    >>> goodness_of_fit("lognormal", g).p_value > 0.05
    True
    """
    if model not in ("lognormal", "gamma-gamma"):
        raise ValueError(f"model: {model!r}, allowed 'lognormal', 'gamma-gamma'")
    if resamples < 1:
        raise ValueError(f"resamples: {resamples}, allowed resamples >= 1")
    fit_law = fit_lognormal if model == "lognormal" else fit_gamma_gamma
    g = _fit_sample(gain, gain_stderr)
    fit = fit_law(g)
    rng = np.random.default_rng(seed)
    distance = _ks_distance(g, fit)
    samples = (fit.sample(g.size, rng=rng) for _ in range(resamples))
    beyond = sum(_ks_distance(sample, fit_law(sample)) >= distance for sample in samples)
    return GoodnessOfFit(model, distance, (1.0 + beyond) / (1.0 + resamples), g.size)


def _ks_distance(gain: FloatArray, fit: DistributionFit) -> float:
    cdf = fit.cdf(np.sort(gain))
    rank = np.arange(gain.size + 1) / gain.size
    return float(max(np.max(rank[1:] - cdf), np.max(cdf - rank[:-1])))


# --- all of it -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FadingStatistics:
    """Fading statistics of one set of gains, made by `fading_statistics`.

    Parameters
    ----------
    n : int
        Number of gains.
    n_effective : float
        Number of independent samples they are worth; n for an ensemble.
    block : int
        Block length [samples] of the bootstrap; 1 for an ensemble.
    confidence : float
        Level of all intervals [1].
    mean, mean_stderr, median : float
        Gain [1].
    scintillation_index : Estimate
        Monte Carlo variance removed [1].
    noise_share : float
        Share of the Monte Carlo noise in the variance of the gains [1].
    thresholds : tuple of float
        Thresholds [1], multiples of `relative_to`.
    relative_to : {"mean", "median", "absolute"}
        Reference of the thresholds.
    outage : tuple of Estimate
        P(gain < threshold) [1].
    pdf, cdf : Histogram, Distribution
        Density and distribution function of the gain.
    fits, goodness : tuple
        Fitted laws, and their tests.
    notes : tuple of str
        What the reader must know.
    lag, autocorrelation : ndarray, optional
        Lags [s] and autocorrelation [1] of a series.
    coherence_time : Estimate, optional
        Lag of 1/e [s] of a series.
    level_crossing_rate, mean_fade_duration : tuple of Estimate
        Per threshold [s-1], [s]; empty for an ensemble.
    """

    n: int
    n_effective: float
    block: int
    confidence: float
    mean: float
    mean_stderr: float
    median: float
    scintillation_index: Estimate
    noise_share: float
    thresholds: tuple[float, ...]
    relative_to: Reference
    outage: tuple[Estimate, ...]
    pdf: Histogram
    cdf: Distribution
    fits: tuple[DistributionFit, ...]
    goodness: tuple[GoodnessOfFit, ...]
    notes: tuple[str, ...]
    lag: FloatArray | None = None
    autocorrelation: FloatArray | None = None
    coherence_time: Estimate | None = None
    level_crossing_rate: tuple[Estimate, ...] = ()
    mean_fade_duration: tuple[Estimate, ...] = ()

    def summary(self) -> str:
        """Return the statistics as a text for the terminal."""
        kind = "independent gains" if self.lag is None else "gains of a time series"
        lines = [
            f"Fading of {self.n} {kind} (intervals {100.0 * self.confidence:g} %)",
            f"  mean gain            {self.mean:.6g} +- {self.mean_stderr:.2g}",
            f"  median gain          {self.median:.6g}",
            f"  scintillation index  {_text(self.scintillation_index)}",
            f"  Monte Carlo share    {100.0 * self.noise_share:.3g} % of the variance",
        ]
        if self.coherence_time is not None:
            lines += [
                f"  coherence time       {_text(self.coherence_time)} s",
                f"  independent samples  {self.n_effective:.3g} (blocks of {self.block})",
            ]
        lines += self._threshold_lines() + self._fit_lines()
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def _threshold_lines(self) -> list[str]:
        lines = []
        for i, threshold in enumerate(self.thresholds):
            what = f"gain < {threshold:g}"
            what += "" if self.relative_to == "absolute" else f" x {self.relative_to}"
            lines.append(f"  {what:<20} outage {_text(self.outage[i])}")
            if self.level_crossing_rate:
                lines.append(f"{'':<23}crossings {_text(self.level_crossing_rate[i])} per s")
                lines.append(f"{'':<23}mean fade {_text(self.mean_fade_duration[i])} s")
        return lines

    def _fit_lines(self) -> list[str]:
        tests = {test.model: test for test in self.goodness}
        lines = []
        for fit in self.fits:
            values = ", ".join(f"{name} {value:.4g}" for name, value in fit.parameters.items())
            line = f"  {fit.model:<20} {values}; AIC {fit.aic:.6g}"
            if fit.model in tests:
                line += f"; KS {tests[fit.model].ks:.3g}, p = {tests[fit.model].p_value:.3g}"
            lines.append(line)
        return lines

    def to_dataset(self) -> xarray.Dataset:
        """Return the statistics as an `xarray.Dataset` with CF attributes."""
        import xarray as xr

        data = xr.Dataset(
            attrs={
                "n": self.n,
                "n_effective": self.n_effective,
                "block_length": self.block,
                "confidence": self.confidence,
                "threshold_relative_to": self.relative_to,
                "notes": "; ".join(self.notes),
            }
        )
        for name, dims, values in self._variables():
            data[name] = (dims, values, fields.attrs(name))
        for name, dims, estimates in self._estimates():
            columns = np.reshape(estimates, (len(self.thresholds), 3) if dims else (3,))
            for suffix, column in zip(("", "_low", "_high"), columns.T, strict=True):
                data[name + suffix] = (dims, column, _limit_attrs(name, suffix))
        return data

    def _variables(self) -> Iterator[tuple[str, tuple[str, ...], object]]:
        yield "gain_mean", (), self.mean
        yield "gain_mean_stderr", (), self.mean_stderr
        yield "gain_median", (), self.median
        yield "noise_share", (), self.noise_share
        yield "threshold", ("threshold",), list(self.thresholds)
        yield "gain_bin", ("gain_bin",), 0.5 * (self.pdf.edges[1:] + self.pdf.edges[:-1])
        yield "gain_bin_width", ("gain_bin",), np.diff(self.pdf.edges)
        yield "gain_pdf", ("gain_bin",), self.pdf.density
        yield "gain_pdf_stderr", ("gain_bin",), self.pdf.density_stderr
        yield "gain", ("gain",), self.cdf.gain
        yield "gain_cdf", ("gain",), self.cdf.probability
        if self.lag is not None:
            yield "lag", ("lag",), self.lag
            yield "autocorrelation", ("lag",), self.autocorrelation
        if self.fits:
            yield from self._fit_variables()

    def _fit_variables(self) -> Iterator[tuple[str, tuple[str, ...], object]]:
        names = list(dict.fromkeys(name for fit in self.fits for name in fit.parameters))
        tests = {test.model: test for test in self.goodness}
        none = GoodnessOfFit("lognormal", math.nan, math.nan, 0)
        yield "model", ("model",), [fit.model for fit in self.fits]
        yield "fit_parameter", ("fit_parameter",), names
        yield (
            "fit_value",
            ("model", "fit_parameter"),
            [[fit.parameters.get(name, math.nan) for name in names] for fit in self.fits],
        )
        yield "aic", ("model",), [fit.aic for fit in self.fits]
        yield "ks", ("model",), [tests.get(fit.model, none).ks for fit in self.fits]
        yield "ks_p_value", ("model",), [tests.get(fit.model, none).p_value for fit in self.fits]

    def _estimates(
        self,
    ) -> Iterator[tuple[str, tuple[str, ...], Estimate | tuple[Estimate, ...]]]:
        yield "scintillation_index", (), self.scintillation_index
        yield "outage", ("threshold",), self.outage
        if self.coherence_time is not None:
            yield "coherence_time", (), self.coherence_time
        if self.level_crossing_rate:
            yield "level_crossing_rate", ("threshold",), self.level_crossing_rate
            yield "mean_fade_duration", ("threshold",), self.mean_fade_duration


def _text(estimate: Estimate) -> str:
    return f"{estimate.value:.4g} [{estimate.low:.4g}, {estimate.high:.4g}]"


def _limit_attrs(name: str, suffix: str) -> dict[str, str]:
    attrs = fields.attrs(name)
    if suffix:
        attrs["long_name"] += f", {'lower' if suffix == '_low' else 'upper'} confidence limit"
    return attrs


class _Boot(TypedDict):
    confidence: float
    resamples: int
    seed: int


class _Series(TypedDict, total=False):
    lag: FloatArray
    autocorrelation: FloatArray
    coherence_time: Estimate
    level_crossing_rate: tuple[Estimate, ...]
    mean_fade_duration: tuple[Estimate, ...]


def fading_statistics(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    time: ArrayLike | None = None,
    noise: Noise = "independent",
    thresholds: Sequence[float] = (0.5, 0.8, 0.9, 1.0),
    relative_to: Reference = "mean",
    confidence: float = 0.95,
    resamples: int = 999,
    test_resamples: int = 199,
    seed: int = 0,
) -> FadingStatistics:
    """Return all fading statistics of an ensemble or, with `time`, of a time series.

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1].
    gain_stderr : array_like, shape () or (n,), optional
        Monte Carlo standard error of each gain [1].
    time : array_like, shape (n,), optional
        Equally spaced times [s]; without them the gains are independent realizations.
    noise : {"independent", "common"}, optional
        Whether the Monte Carlo errors are independent, or one and the same for all gains
        (common random numbers).
    thresholds : sequence of float, optional
        Thresholds [1] of outage, crossing rate and fade duration.
    relative_to : {"mean", "median", "absolute"}, optional
        Reference of the thresholds.
    confidence : float, optional
        Level of all intervals [1].
    resamples, test_resamples : int, optional
        Number of replicates for the intervals, and for the tests of fit; 0 tests leave them out.
    seed : int, optional
        Seed of all replicates.

    Returns
    -------
    FadingStatistics
        With `summary()` and `to_dataset()`.

    Raises
    ------
    ValueError
        If a value is negative or not finite, the times are not equally spaced, or an option is
        out of range.

    Notes
    -----
    Common errors do not widen the spread of the gains: nothing is subtracted, and the mean carries
    them in full. A series is tested for fit on every k-th gain, with k = n / n_effective; its
    likelihoods count every gain, so that only the order of the AIC has a meaning.

    Examples
    --------
    >>> g = np.random.default_rng(4).lognormal(-10.0, 0.1, 300)
    >>> s = fading_statistics(g, 1e-7, test_resamples=0)
    >>> s.n, round(s.scintillation_index.value, 3), [fit.model for fit in s.fits]
    (300, 0.01, ['lognormal', 'gamma-gamma'])
    """
    g, variance = _checked(gain, gain_stderr)
    if noise not in ("independent", "common"):
        raise ValueError(f"noise: {noise!r}, allowed 'independent', 'common'")
    if test_resamples < 0:
        raise ValueError(f"test_resamples: {test_resamples}, allowed test_resamples >= 0")
    _check_bootstrap(confidence, resamples)
    stderr = np.sqrt(variance) if noise == "independent" and variance.any() else None
    independent = 0.0 if stderr is None else float(variance.mean())
    common = float(np.sqrt(variance).mean()) if stderr is None else 0.0
    spread = float(g.var(ddof=1))
    fades = np.ptp(g) > 0.0 and spread * (g.size - 1) / g.size > independent
    levels = tuple(float(threshold) for threshold in thresholds)
    boot: _Boot = {"confidence": confidence, "resamples": resamples, "seed": seed}
    n_effective, block = float(g.size), 1
    series: _Series = {}
    if time is not None:
        block = block_length(g)
        n_effective = effective_samples(g, stderr) if fades else n_effective
        series = _series_part(time, g, stderr, bool(fades), levels, relative_to, block, boot)
    fits, goodness, fit_notes = _all_fits(g, stderr, n_effective, test_resamples, seed)
    index = scintillation_index(g, stderr, block=block, **boot)
    notes = _noise_notes(g, independent, variance, bool(fades), index)
    if series:
        notes += _series_notes(g, independent, n_effective, series)
    trials = [_trials(g, stderr, h, relative_to, n_effective) for h in levels]
    return FadingStatistics(
        n=g.size,
        n_effective=n_effective,
        block=block,
        confidence=confidence,
        mean=float(g.mean()),
        mean_stderr=math.sqrt(
            max(spread - independent, 0.0) / n_effective + independent / g.size + common**2
        ),
        median=float(np.median(g)),
        scintillation_index=index,
        noise_share=independent / spread if spread > 0.0 else 0.0,
        thresholds=levels,
        relative_to=relative_to,
        outage=tuple(
            outage(g, h, stderr, relative_to=relative_to, n_effective=n, confidence=confidence)
            for h, n in zip(levels, trials, strict=True)
        ),
        pdf=gain_pdf(g, stderr),
        cdf=gain_cdf(g, stderr, n_effective=n_effective, confidence=confidence),
        fits=fits,
        goodness=goodness,
        notes=tuple(notes + fit_notes),
        **series,
    )


def _series_part(
    time: ArrayLike,
    g: FloatArray,
    stderr: FloatArray | None,
    fades: bool,
    levels: tuple[float, ...],
    relative_to: Reference,
    block: int,
    boot: _Boot,
) -> _Series:
    lag = _checked_step(time, g.size) * np.arange(g.size // 2 + 1, dtype=np.float64)
    nothing = Estimate(math.nan, math.nan, math.nan)
    return {
        "lag": lag,
        "autocorrelation": (autocorrelation(g, stderr) if fades else np.full_like(lag, math.nan)),
        "coherence_time": (
            coherence_time(time, g, stderr, block=block, **boot) if fades else nothing
        ),
        "level_crossing_rate": tuple(
            level_crossing_rate(time, g, h, relative_to=relative_to, block=block, **boot)
            for h in levels
        ),
        "mean_fade_duration": tuple(
            mean_fade_duration(time, g, h, relative_to=relative_to, block=block, **boot)
            for h in levels
        ),
    }


def _trials(
    g: FloatArray,
    stderr: FloatArray | None,
    threshold: float,
    relative_to: Reference,
    n_effective: float,
) -> float:
    """Return the number of independent trials behind an outage probability."""
    if n_effective == g.size:
        return n_effective
    sample = remove_noise(g, stderr)
    below = (sample < _level(sample, threshold, relative_to)).astype(np.float64)
    # Rare outages decorrelate faster than the gain: their own correlation counts.
    return effective_samples(below) if 0.0 < below.mean() < 1.0 else n_effective


def _all_fits(
    g: FloatArray,
    stderr: FloatArray | None,
    n_effective: float,
    resamples: int,
    seed: int,
) -> tuple[tuple[DistributionFit, ...], tuple[GoodnessOfFit, ...], list[str]]:
    sample = remove_noise(g, stderr)
    if not sample.all():
        return (), (), ["some gains are 0: no continuous law fitted"]
    if np.ptp(sample) <= 1e-12 * sample.max():
        return (), (), ["no variance beside the Monte Carlo noise: no law fitted"]
    fits = (fit_lognormal(sample), fit_gamma_gamma(sample, n_effective=n_effective))
    notes = [f"{fit.model}: {fit.note}" for fit in fits if fit.note]
    apart = sample[:: math.ceil(g.size / n_effective)]
    if resamples == 0:
        return fits, (), notes
    if apart.size < _FEWEST_TESTED:
        return fits, (), [*notes, f"only {apart.size} independent gains: fits not tested"]
    tests = tuple(goodness_of_fit(f.model, apart, resamples=resamples, seed=seed) for f in fits)
    return fits, tests, notes


def _noise_notes(
    g: FloatArray, independent: float, variance: FloatArray, fades: bool, index: Estimate
) -> list[str]:
    notes = []
    if not fades:
        notes.append("no fading seen beside the Monte Carlo noise")
    if index.high < 0.0:
        notes.append(
            "the gains vary less than independent errors of the stated size would make them: "
            "errors of common random numbers are stated with noise='common'"
        )
    if independent and np.any(variance > (0.3 * g) ** 2):
        count = np.count_nonzero(variance > (0.3 * g) ** 2)
        notes.append(f"{count} gains have an error above 30 %: deep fades are blurred by noise")
    return notes


def _series_notes(
    g: FloatArray, independent: float, n_effective: float, series: _Series
) -> list[str]:
    notes = []
    if n_effective < _FEWEST_EFFECTIVE:
        notes.append(
            f"the record is worth {n_effective:.2g} independent samples: the scintillation index "
            f"is low by about {100.0 / n_effective:.0f} %, and the intervals are rough"
        )
    if series["coherence_time"].value < series["lag"][1]:
        notes.append("the coherence time is below one time step: sample faster")
    steps = float(np.mean(np.diff(g) ** 2))
    if independent and 2.0 * independent > 0.1 * steps:
        notes.append(
            f"Monte Carlo noise makes {100.0 * min(1.0, 2.0 * independent / steps):.0f} % of the "
            "step-to-step variance: crossing rates are too high, fades too short; use common "
            "random numbers or more photons"
        )
    return notes
