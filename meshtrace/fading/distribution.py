"""Distribution of gains: scintillation index free of Monte Carlo noise, density, outage."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import Refused, require_seed, require_whole
from meshtrace.fading.gains import (
    Estimate,
    FloatArray,
    Reference,
    block_interval,
    block_means,
    check_bootstrap,
    check_effective,
    checked,
    level_of,
    remove_noise,
    wilson,
)

# Below this number the jackknife of the BCa bootstrap has too little to work on.
_FEWEST_ACCELERATED = 8
# Bound of memory: gains resampled at a time.
_BATCH_ELEMENTS = 1_000_000


def scintillation_index(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    block: int = 1,
    confidence: float = 0.95,
    resamples: int = 1999,
    seed: int = 1,
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
    Refused
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
    g, noise = checked(gain, gain_stderr)
    check_bootstrap(confidence, resamples)
    require_whole(block, 1, g.size // 2, "block")
    noise = noise / g.mean() ** 2
    g = g / g.mean()
    value = float(_scintillation(g, noise))
    if np.ptp(g) == 0.0:
        return Estimate(value, value, value)
    if block == 1:
        return _accelerated_interval(value, g, noise, confidence, resamples, seed)
    mean, square = block_means((g, g**2), block, resamples, seed)
    raw = (square / mean**2 - 1.0) * g.size / (g.size - 1.0)
    seen = block_interval(float(_scintillation(g, 0.0 * g)), raw, g.size / block, confidence)
    return Estimate(value, seen.low - float(noise.mean()), seen.high - float(noise.mean()))


def _scintillation(g: FloatArray, noise: FloatArray, axis: int = -1) -> FloatArray:
    excess, mean = g.var(axis, ddof=1) - noise.mean(axis), g.mean(axis)
    # A resample of blocked links alone has no light: count it as no fading.
    return np.divide(excess, mean**2, out=np.zeros_like(mean), where=mean > 0.0)


def _accelerated_interval(
    value: float, g: FloatArray, noise: FloatArray, confidence: float, resamples: int, seed: int
) -> Estimate:
    require_seed(seed)
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
        Independent standard error of each gain [1], removed by `remove_noise` first.
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
    Refused
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
    check_bootstrap(confidence)
    n = check_effective(n_effective, g.size)
    return wilson(float(np.mean(g < level_of(g, threshold, relative_to))), n, confidence)


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
    Refused
        If a value is negative or not finite.

    Examples
    --------
    >>> h = gain_pdf([1.0, 1.2, 1.4, 2.0], bins=2)
    >>> float(np.sum(h.density * np.diff(h.edges)))
    1.0
    """
    g = remove_noise(gain, gain_stderr)
    if not isinstance(bins, str):
        require_whole(bins, 1, 10**7, "bins")
    try:
        count, edges = np.histogram(g / g.mean(), bins=bins)
    except ValueError as error:
        raise Refused("bins", bins, "a number, or a rule as auto, fd, doane") from error
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
    r"""Return the empirical distribution function with a simultaneous confidence band.

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
    Refused
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
    check_bootstrap(confidence)
    n = check_effective(n_effective, g.size)
    probability = np.arange(1, g.size + 1) / g.size
    half = math.sqrt(math.log(2.0 / (1.0 - confidence)) / (2.0 * n))
    return Distribution(
        g, probability, np.maximum(probability - half, 0.0), np.minimum(probability + half, 1.0)
    )
