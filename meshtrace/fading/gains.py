"""Checked gains without their Monte Carlo noise, and confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import (
    Described,
    Refused,
    require_array,
    require_between,
    require_seed,
    require_whole,
    require_word,
)

FloatArray = NDArray[np.float64]
Reference = Literal["mean", "median", "absolute"]

# With fewer replicates all may lie on one side of the estimate, and BCa divides by zero.
FEWEST_RESAMPLES = 50
MOST_RESAMPLES = 10**6


def checked_gain(gain: ArrayLike) -> FloatArray:
    """Return the gains as an array of two or more, not all 0."""
    g = require_array(gain, "gain", "(n,) with n >= 2")
    if g.ndim != 1 or g.size < 2:
        raise Refused("gain", Described(f"shape {g.shape}"), "(n,) with n >= 2")
    _check_values("gain", g)
    if not g.any():
        raise Refused("gain", Described("all 0"), "at least one gain > 0")
    return g


def checked(gain: ArrayLike, gain_stderr: ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    """Return the gains and the variance of the Monte Carlo error of each."""
    g = checked_gain(gain)
    if gain_stderr is None:
        return g, np.zeros_like(g)
    stderr = require_array(gain_stderr, "gain_stderr", f"() or {g.shape}")
    if stderr.shape not in ((), g.shape):
        raise Refused("gain_stderr", Described(f"shape {stderr.shape}"), f"() or {g.shape}")
    stderr = np.broadcast_to(stderr, g.shape)
    _check_values("gain_stderr", stderr)
    return g, stderr**2


def _check_values(name: str, values: FloatArray) -> None:
    bad = np.flatnonzero(~(np.isfinite(values) & (values >= 0.0)))
    if bad.size:
        raise Refused(f"{name}[{bad[0]}]", float(values[bad[0]]), "finite values >= 0")


def checked_step(time: ArrayLike, n: int) -> float:
    """Return the time step [s] of equally spaced times."""
    t = require_array(time, "time", f"({n},), one time [s] per gain")
    if t.shape != (n,):
        raise Refused("time", Described(f"shape {t.shape}"), f"({n},), one time [s] per gain")
    if not np.isfinite(t).all():
        raise Refused("time", Described("not all finite"), "finite times [s]")
    step = (t[-1] - t[0]) / (n - 1)
    if not step > 0.0 or np.abs(np.diff(t) - step).max() > 1e-6 * step + 1e-12 * np.abs(t).max():
        raise Refused(
            "time", Described("not equally spaced and increasing"), "a constant step > 0 s"
        )
    return float(step)


def check_bootstrap(confidence: float, resamples: int = FEWEST_RESAMPLES) -> None:
    """Raise `Refused` for a confidence or a number of replicates out of range."""
    require_between(confidence, 0.0, 1.0, "confidence")
    require_whole(resamples, FEWEST_RESAMPLES, MOST_RESAMPLES, "resamples")


def check_effective(n_effective: float | None, n: int) -> float:
    """Return the number of independent samples, by default n."""
    if n_effective is None:
        return float(n)
    return require_between(n_effective, 1.0, n, "n_effective", "[]", f"1 <= n_effective <= {n}")


def level_of(gain: FloatArray, threshold: float, relative_to: Reference) -> float:
    """Return the threshold as a gain."""
    threshold = require_between(threshold, 0.0, math.inf, "threshold")
    require_word(relative_to, ("mean", "median", "absolute"), "relative_to")
    if relative_to == "absolute":
        return threshold
    return threshold * float(gain.mean() if relative_to == "mean" else np.median(gain))


def remove_noise(gain: ArrayLike, gain_stderr: ArrayLike | None = None) -> FloatArray:
    r"""Return the gains with the independent Monte Carlo error removed from their spread.

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
    Refused
        If there are fewer than two gains or a value is negative or not finite.

    Notes
    -----
    The shape of the noise is not deconvolved, only its variance removed. The expansion of the
    logarithm needs relative errors below about 0.3; gains of zero stay zero. The mean is kept.

    Examples
    --------
    >>> remove_noise([0.8, 1.0, 1.2], 0.1).round(3)
    array([0.827, 1.002, 1.171])
    """
    g, noise = checked(gain, gain_stderr)
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


class Estimate(NamedTuple):
    """A value with its confidence interval; ``float(estimate)`` is the value."""

    value: float
    low: float
    high: float

    def __float__(self) -> float:
        return float(self.value)


def block_means(columns: Iterable[FloatArray], block: int, resamples: int, seed: int) -> FloatArray:
    """Return the means (p, resamples) of p columns (n,) over the same random moving blocks."""
    require_seed(seed)
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


def block_interval(
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


def wilson(probability: float, n: float, confidence: float) -> Estimate:
    """Return the Wilson limits of a fraction observed in n trials, n not necessarily whole."""
    from scipy import special

    z2 = float(special.ndtri(0.5 + 0.5 * confidence)) ** 2
    scale = 1.0 / (1.0 + z2 / n)
    center = (probability + 0.5 * z2 / n) * scale
    half = math.sqrt(z2 / n * (probability * (1.0 - probability) + 0.25 * z2 / n)) * scale
    # At 0 and 1 the exact limit is lost to rounding, and the value would lie outside.
    low, high = min(probability, center - half), max(probability, center + half)
    return Estimate(probability, max(0.0, low), min(1.0, high))


def poisson_limits(count: float, confidence: float) -> tuple[float, float]:
    """Return Garwood's limits of the mean of a Poisson count observed once."""
    from scipy import special

    tail = 0.5 - 0.5 * confidence
    low = float(special.gammaincinv(count, tail)) if count else 0.0
    return low, float(special.gammainccinv(count + 1.0, tail))


def exponential_limits(value: float, count: float, confidence: float) -> Estimate:
    """Return the limits of the mean of `count` exponential durations."""
    from scipy import special

    tail = 0.5 - 0.5 * confidence
    high, low = special.gammaincinv(count, tail), special.gammainccinv(count, tail)
    return Estimate(value, float(count * value / low), float(count * value / high))
