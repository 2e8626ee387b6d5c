"""Distribution of gains without their Monte Carlo noise: index, outage, intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Infinite, Probability, Seed, check_call
from meshtrace.errors import (
    Described,
    Refused,
    require_array,
    require_between,
    require_seed,
    require_whole,
)
from meshtrace.models import Floats
from meshtrace.stored import Variable

Reference = Literal["mean", "median", "absolute"]

# With fewer replicates all may lie on one side of the estimate, and BCa divides by zero.
FEWEST_RESAMPLES = 50
MOST_RESAMPLES = 10**6


def checked_gain(gain: ArrayLike) -> Floats:
    """Return the gains as an array (n,); refuse fewer than two, invalid ones, and all 0."""
    g = require_array(gain, "gain", "(n,) with n >= 2")
    if g.ndim != 1 or g.size < 2:
        raise Refused("gain", Described(f"shape {g.shape}"), "(n,) with n >= 2")
    _check_values("gain", g)
    if not g.any():
        raise Refused("gain", Described("all 0"), "at least one gain > 0")
    return g


def checked(gain: ArrayLike, gain_stderr: ArrayLike | None) -> tuple[Floats, Floats]:
    """Return the gains and the variance of the Monte Carlo error of each, both (n,)."""
    g = checked_gain(gain)
    if gain_stderr is None:
        return g, np.zeros_like(g)
    stderr = require_array(gain_stderr, "gain_stderr", f"() or {g.shape}")
    if stderr.shape not in ((), g.shape):
        raise Refused("gain_stderr", Described(f"shape {stderr.shape}"), f"() or {g.shape}")
    stderr = np.broadcast_to(stderr, g.shape)
    _check_values("gain_stderr", stderr)
    return g, stderr**2


def _check_values(name: str, values: Floats) -> None:
    """Require finite values >= 0."""
    bad = np.flatnonzero(~(np.isfinite(values) & (values >= 0.0)))
    if bad.size:
        raise Refused(f"{name}[{bad[0]}]", float(values[bad[0]]), "finite values >= 0")


def checked_step(time: ArrayLike, n: int) -> float:
    """Return the step [s] of n equally spaced times; refuse others."""
    t = require_array(time, "time", f"({n},), one time [s] per gain")
    if t.shape != (n,):
        raise Refused("time", Described(f"shape {t.shape}"), f"({n},), one time [s] per gain")
    if not np.isfinite(t).all():
        raise Refused("time", Described("not all finite"), "finite times [s]")
    step = (t[-1] - t[0]) / (n - 1)
    # times in files are rounded: a millionth of the step, or the last digits of large times
    if not step > 0.0 or np.abs(np.diff(t) - step).max() > 1e-6 * step + 1e-12 * np.abs(t).max():
        uneven = Described("not equally spaced and increasing")
        raise Refused("time", uneven, "a constant step > 0 s")
    return float(step)


Resamples = Annotated[int, Field(ge=FEWEST_RESAMPLES, le=MOST_RESAMPLES)]
Threshold = Annotated[float, Field(gt=0.0, lt=math.inf), Infinite()]
"""Threshold of a gain [1] > 0; the largest number stands for one that no gain reaches."""


def check_effective(n_effective: float | None, n: int) -> float:
    """Return the number of independent samples, by default n; refuse one outside 1 ... n."""
    if n_effective is None:
        return float(n)
    return require_between(n_effective, 1.0, n, "n_effective", "[]", f"1 <= n_effective <= {n}")


def level_of(gain: Floats, threshold: float, relative_to: Reference) -> float:
    """Convert a relative threshold to a gain."""
    if relative_to == "absolute":
        return threshold
    return threshold * float(gain.mean() if relative_to == "mean" else np.median(gain))


@check_call
def remove_noise(gain: ArrayLike, gain_stderr: ArrayLike | None = None) -> Floats:
    r"""Return the gains with the independent Monte Carlo error removed from their spread.

    .. math:: \ln g' = \overline{\ln g} + \sqrt{1 - \overline{(s/g)^2} / \mathrm{Var}(\ln g)}
              \; (\ln g - \overline{\ln g}) + \mathrm{const}

    with the standard errors s and the constant that preserves the mean gain.

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1].
    gain_stderr : array_like, shape () or (n,), optional
        Independent standard error of each gain [1]; without it the gains are returned unchanged.

    Returns
    -------
    ndarray, shape (n,)
        Gains [1] in the same order and with the same mean, whose log-variance is that of the
        fading alone; all equal if the noise explains the whole spread.

    Raises
    ------
    Refused
        If there are fewer than two gains or a value is negative or not finite.

    Notes
    -----
    Only the variance of the noise is removed; its shape is not deconvolved. The expansion of the
    logarithm needs relative errors below about 0.3. Gains of zero stay zero.

    Examples
    --------
    >>> remove_noise([0.8, 1.0, 1.2], 0.1).round(3)
    array([0.827, 1.002, 1.171])
    """
    g, noise = checked(gain, gain_stderr)
    nonzero = g > 0.0
    log_gain = np.log(g[nonzero])
    if not noise.any() or log_gain.size < 2 or np.ptp(log_gain) == 0.0:
        return g.copy()
    # to first order the noise adds (s / g)^2 to the variance of ln g
    fading_share = 1.0 - np.mean(noise[nonzero] / g[nonzero] ** 2) / log_gain.var(ddof=1)
    if fading_share <= 0.0:
        return np.where(nonzero, g[nonzero].mean(), 0.0)
    denoised = np.zeros_like(g)
    denoised[nonzero] = np.exp(math.sqrt(fading_share) * (log_gain - log_gain.mean()))
    return denoised * (g.mean() / denoised.mean())


class Estimate(NamedTuple):
    """Value with its confidence interval; ``float(estimate)`` is the value."""

    value: float
    low: float
    high: float

    def __float__(self) -> float:
        return float(self.value)


def block_means(columns: Iterable[Floats], block: int, resamples: int, seed: int) -> Floats:
    """Return the means (p, resamples) of p columns (n,) over random moving blocks.

    A replicate is made of about n / block blocks of `block` neighbours, which start anywhere and
    are the same in all columns.
    """
    require_seed(seed)
    rng = np.random.default_rng(seed)
    starts = None
    means = []
    for column in columns:
        n = column.size
        if starts is None:
            starts = rng.integers(0, n - block + 1, (resamples, max(1, round(n / block))))
        # sums of blocks as differences of the cumulative sum
        cumulative = np.concatenate([[0.0], np.cumsum(column)])
        means.append((cumulative[starts + block] - cumulative[starts]).mean(axis=1) / block)
    return np.stack(means)


def block_interval(
    value: float, replicates: Floats, n_blocks: float, confidence: float
) -> Estimate:
    """Return the interval of a positive quantity from its replicates over moving blocks.

    The central 68 % of the replicates (one standard deviation of a normal law), in the logarithm,
    is stretched to `confidence` with Student's t: with few blocks plain percentiles are too narrow
    (they cover 85 % instead of 95 % with 25 blocks).
    """
    from scipy import special

    low, middle, high = np.quantile(
        replicates, special.ndtr([-1.0, 0.0, 1.0]), method="inverted_cdf"
    )
    if not 0.0 < middle < math.inf:
        return Estimate(value, 0.0, math.inf)
    degrees = max(n_blocks - 1.0, 1.0)  # of freedom
    # the mean of n blocks drawn with replacement has a variance too small by (n - 1) / n
    stretch = special.stdtrit(degrees, 0.5 + 0.5 * confidence) * math.sqrt(1.0 + 1.0 / degrees)
    with np.errstate(over="ignore"):
        low, high = value * (np.array([low, high]) / middle) ** stretch
    return Estimate(value, float(low), float(high))


# With fewer gains the jackknife of the BCa bootstrap is unreliable: plain percentiles instead.
_FEWEST_ACCELERATED = 8
# Gains resampled at a time: bounds memory.
_BATCH_ELEMENTS = 1_000_000


@check_call
def scintillation_index(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    block: int = 1,
    confidence: Probability = 0.95,
    resamples: Resamples = 1999,
    seed: Seed = 1,
) -> Estimate:
    r"""Return the scintillation index without the Monte Carlo variance, and its interval.

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
        Index [1] and its limits. With the noise removed it is unbiased, and may therefore be
        negative where there is no fading.

    Raises
    ------
    Refused
        If a value is negative or not finite, or an option is out of range.

    Notes
    -----
    Var divides by n - 1. The interval of independent gains is the bias-corrected accelerated (BCa)
    bootstrap of the pairs (gain, error), or its plain percentiles below 8 gains. That of a series
    resamples moving blocks; the index of a short record is low by about SI / n_eff, see
    `effective_samples`. With heavy tails (SI above 0.3) it takes thousands of samples before any
    such interval has its nominal coverage.

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
    require_whole(block, 1, g.size // 2, "block")
    noise = noise / g.mean() ** 2  # variances of gain / mean
    g = g / g.mean()
    value = float(_scintillation(g, noise))
    # the bootstrap of equal gains is degenerate
    if np.ptp(g) == 0.0:
        return Estimate(value, value, value)
    if block == 1:
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
    mean, square = block_means((g, g**2), block, resamples, seed)
    # the variance divides by n - 1, as in the value itself
    noisy = (square / mean**2 - 1.0) * g.size / (g.size - 1.0)
    # The interval is that of the index with its noise, which is positive. Without the noise it may
    # be negative, and `block_interval` takes logarithms.
    limits = block_interval(float(_scintillation(g, 0.0 * g)), noisy, g.size / block, confidence)
    return Estimate(value, limits.low - float(noise.mean()), limits.high - float(noise.mean()))


def _scintillation(g: Floats, noise: Floats, axis: int = -1) -> Floats:
    """Return the index of gains with error variances `noise` along an axis, as scipy calls it."""
    fading, mean = g.var(axis, ddof=1) - noise.mean(axis), g.mean(axis)
    # A resample may hold blocked links alone, without any light: it counts as no fading.
    return np.divide(fading, mean**2, out=np.zeros_like(mean), where=mean > 0.0)


class Histogram(NamedTuple):
    """Probability density over bins: edges (m + 1,), density (m,) and its stderr (m,)."""

    edges: Annotated[Floats, Variable("gain_bin_edge", name="gain_bin_edge")]
    density: Annotated[Floats, Variable("gain_bin", name="gain_pdf")]
    density_stderr: Annotated[Floats, Variable("gain_bin", name="gain_pdf_stderr")]


class Distribution(NamedTuple):
    """Empirical CDF: sorted gains (n,), P(gain <= x) (n,) and its confidence limits (n,)."""

    gain: Annotated[Floats, Variable("gain")]
    probability: Annotated[Floats, Variable("gain", name="gain_cdf")]
    low: Annotated[Floats, Variable("gain", name="gain_cdf_low")]
    high: Annotated[Floats, Variable("gain", name="gain_cdf_high")]


@check_call
def outage(
    gain: ArrayLike,
    threshold: Threshold = 0.5,
    gain_stderr: ArrayLike | None = None,
    *,
    relative_to: Reference = "mean",
    n_effective: float | None = None,
    confidence: Probability = 0.95,
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
    n = check_effective(n_effective, g.size)
    return wilson_interval(float(np.mean(g < level_of(g, threshold, relative_to))), n, confidence)


def wilson_interval(probability: float, n: float, confidence: float) -> Estimate:
    """Return a probability observed in n independent samples with its Wilson interval.

    (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)
    """
    from scipy import special

    z2 = float(special.ndtri(0.5 + 0.5 * confidence)) ** 2
    scale = 1.0 / (1.0 + z2 / n)
    center = (probability + 0.5 * z2 / n) * scale
    half = math.sqrt(z2 / n * (probability * (1.0 - probability) + 0.25 * z2 / n)) * scale
    # at 0 and 1 rounding may leave the value outside of its limits
    low, high = min(probability, center - half), max(probability, center + half)
    return Estimate(probability, max(0.0, low), min(1.0, high))


@check_call
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
        # in units of the mean gain, by which the edges are multiplied below
        count, edges = np.histogram(g / g.mean(), bins=bins)
    except ValueError as error:
        raise Refused("bins", bins, "a number, or a rule as auto, fd, doane") from error
    edges = edges * g.mean()
    share, width = count / g.size, np.diff(edges)
    return Histogram(edges, share / width, np.sqrt(share * (1.0 - share) / g.size) / width)


@check_call
def gain_cdf(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    n_effective: float | None = None,
    confidence: Probability = 0.95,
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
    n = check_effective(n_effective, g.size)
    probability = np.arange(1, g.size + 1) / g.size
    # inequality of Dvoretzky, Kiefer and Wolfowitz with Massart's constant
    half = math.sqrt(math.log(2.0 / (1.0 - confidence)) / (2.0 * n))
    return Distribution(
        g, probability, np.maximum(probability - half, 0.0), np.minimum(probability + half, 1.0)
    )
