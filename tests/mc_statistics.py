"""Statistical tests of samplers and of Monte Carlo means, with a stated significance."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

ALPHA = 1e-4
"""Probability that a family of tests rejects a right program."""


def sidak(alpha: float, tests: int) -> float:
    """Return the significance of each of many independent tests that have alpha together.

    Parameters
    ----------
    alpha : float
        Significance of the family, 0 < alpha < 1.
    tests : int
        Number of tests in the family.

    Returns
    -------
    float
        1 - (1 - alpha)^(1 / tests).
    """
    return float(-np.expm1(np.log1p(-alpha) / tests))


def chi2_test(counts: ArrayLike, probabilities: ArrayLike, min_expected: float = 10.0) -> float:
    """Return the p-value of Pearson's test that counts were drawn with given probabilities.

    Parameters
    ----------
    counts : array_like of int, shape (n,)
        How many samples fell into each bin; the bins cover everything that can be drawn.
    probabilities : array_like, shape (n,)
        Probability of each bin; their sum must be 1 to 1e-6.
    min_expected : float
        Neighbouring bins are pooled until each expects as many.

    Returns
    -------
    float
        Probability of a deviation at least as large.

    Raises
    ------
    ValueError
        If the probabilities do not sum to 1, or fewer than two bins are left.
    """
    from scipy import stats

    counts, probabilities = np.asarray(counts), np.asarray(probabilities, dtype=np.float64)
    if abs(probabilities.sum() - 1.0) > 1e-6:
        raise ValueError(f"probabilities: sum {probabilities.sum()}, allowed 1")
    expected = counts.sum() * probabilities / probabilities.sum()
    pooled_counts, pooled_expected = [0.0], [0.0]
    for count, expectation in zip(counts, expected, strict=True):
        if pooled_expected[-1] >= min_expected:
            pooled_counts.append(0.0)
            pooled_expected.append(0.0)
        pooled_counts[-1] += count
        pooled_expected[-1] += expectation
    if pooled_expected[-1] < min_expected and len(pooled_expected) > 1:
        pooled_counts[-2] += pooled_counts.pop()
        pooled_expected[-2] += pooled_expected.pop()
    if len(pooled_counts) < 2:
        raise ValueError(f"counts: {counts.sum()} samples, allowed: enough for two bins")
    observed, model = np.array(pooled_counts), np.array(pooled_expected)
    chi2 = np.sum((observed - model) ** 2 / model)
    return float(stats.chi2.sf(chi2, len(observed) - 1))


def z_test(mean: float, stderr: float, expected: float, expected_stderr: float = 0.0) -> float:
    """Return the two-sided p-value that a mean with a standard error has an expectation.

    Parameters
    ----------
    mean, stderr : float
        Estimate and its standard error.
    expected, expected_stderr : float
        Reference, and its own standard error.

    Returns
    -------
    float
        Probability of a deviation at least as large under a normal law.

    Raises
    ------
    ValueError
        If both standard errors are 0 or one is not a finite number >= 0.
    """
    from scipy import stats

    error = float(np.hypot(stderr, expected_stderr))
    if not (0.0 < error < np.inf and stderr >= 0.0 and expected_stderr >= 0.0):
        raise ValueError(f"stderr: {stderr}, {expected_stderr}, allowed finite, not both 0")
    return float(2.0 * stats.norm.sf(abs(mean - expected) / error))
