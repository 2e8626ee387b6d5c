"""Best threshold between zeros and ones in Gaussian noise."""

from __future__ import annotations

import math

from meshtrace.kernels.jit import entry, inlined

_REACH = 4.0  # of the thresholds, in standard deviations beyond the outermost means
_INTERVALS = 64  # of the grid that finds the lowest of several minima
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_SECTIONS = 18  # which leave 2e-4 of an interval, where the error rate is flat to 1e-7


@inlined
def _errors(mean, std, is_one, threshold, most):
    """Return twice the sum of the error rates of all patterns, or any number above `most`."""
    total = 0.0
    for j in range(len(mean)):
        margin = (mean[j] - threshold) / (std[j] * math.sqrt(2.0))
        total += math.erfc(margin if is_one[j] else -margin)
        if total > most:
            break
    return total


@entry
def best_thresholds(mean, std, is_one, ber, threshold):
    """Fill in the error rates of the best thresholds, and the thresholds.

    Array twin: `test_pattern_decision_against_a_fine_scan` in `tests/comms/test_ook_ber.py`.
    Why so: a required power takes ten decisions between 128 patterns. The best of a grid is
    improved by a golden-section search (Kiefer 1953).

    Parameters
    ----------
    mean, std : ndarray, shape (n, p)
        Means and standard deviations of the sample for each pattern.
    is_one : ndarray, shape (p,)
        Whether a pattern carries a one.
    ber, threshold : ndarray, shape (n,)
        Results.
    """
    for i in range(len(mean)):
        m, s = mean[i], std[i]
        low, high = math.inf, -math.inf
        for j in range(len(m)):
            low = min(low, m[j] - _REACH * s[j])
            high = max(high, m[j] + _REACH * s[j])
        step, least, best = (high - low) / _INTERVALS, math.inf, low
        for k in range(_INTERVALS + 1):
            total = _errors(m, s, is_one, low + k * step, least)
            if total < least:
                least, best = total, low + k * step
        low, high = max(best - step, low), min(best + step, high)
        for _ in range(_SECTIONS):  # golden-section search around the best point
            wider_below = best - low > high - best
            trial = best - (1.0 - _GOLDEN) * (best - low)
            if not wider_below:
                trial = best + (1.0 - _GOLDEN) * (high - best)
            total = _errors(m, s, is_one, trial, least)
            if total < least:
                if wider_below:
                    high = best
                else:
                    low = best
                least, best = total, trial
            elif wider_below:
                low = trial
            else:
                high = trial
        ber[i], threshold[i] = 0.5 * least / len(m), best
