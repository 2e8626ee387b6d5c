"""Confidence intervals of fractions, counts and correlated series."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from meshtrace.errors import require_seed
from meshtrace.fading.gains import FloatArray


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
