"""Best threshold between zeros and ones in Gaussian noise, over patterns of neighbouring bits.

Each pattern has the mean and the standard deviation of its sample; all are equally probable.
"""

from __future__ import annotations

import math

from meshtrace.kernels.jit import entry, inlined

_REACH = 4.0  # standard deviations beyond the outermost means to which thresholds are searched
_INTERVALS = 64  # of the grid of thresholds; tuned: fewer may miss the lowest of several minima
_STEPS = 40  # of Newton's method at most, which halves its bracket where it fails
_SURE = 1e-6  # last step of Newton's method, over an interval of the grid


@inlined
def _errors(mean, std, is_one, threshold, most):
    """Sum twice the error rates of all patterns, up to the first sum above `most`."""
    total = 0.0
    for j in range(len(mean)):
        # a one is missed with the probability Q((mean - threshold) / std) = erfc(margin) / 2
        margin = (mean[j] - threshold) / (std[j] * math.sqrt(2.0))
        total += math.erfc(margin if is_one[j] else -margin)
        if total > most:
            break
    return total


@inlined
def _slopes(mean, std, is_one, threshold):
    """Return the first two derivatives of the sum of error rates, times one positive constant."""
    first, second = 0.0, 0.0
    for j in range(len(mean)):
        # d/dt Q((mean - t) / std) ~ exp(-u^2 / 2) / std, without 1 / sqrt(2 pi)
        u = (threshold - mean[j]) / std[j]
        density = math.exp(-0.5 * u * u) / std[j]
        density = density if is_one[j] else -density
        first += density
        second -= density * u / std[j]
    return first, second


@inlined
def _between(mean, std, is_one):
    """Return the lowest and highest threshold to search, and a guess between the mean levels.

    Mean levels m0 of the zeros and m1 of the ones, with their mean standard deviations s0 and s1.
    """
    low, high = math.inf, -math.inf
    m0, s0, m1, s1, ones = 0.0, 0.0, 0.0, 0.0, 0
    for j in range(len(mean)):
        low = min(low, mean[j] - _REACH * std[j])
        high = max(high, mean[j] + _REACH * std[j])
        if is_one[j]:
            m1, s1, ones = m1 + mean[j], s1 + std[j], ones + 1
        else:
            m0, s0 = m0 + mean[j], s0 + std[j]
    zeros = max(len(mean) - ones, 1)
    m0, s0, m1, s1 = m0 / zeros, s0 / zeros, m1 / max(ones, 1), s1 / max(ones, 1)
    # Equally many standard deviations from both mean levels: nearly the best threshold between two
    # Gaussians of small errors (Agrawal, Fiber-Optic Communication Systems, sec. 4.6).
    return low, high, (m0 * s1 + m1 * s0) / (s0 + s1)


@entry
def best_thresholds(mean, std, is_one, ber, threshold):
    """Find the thresholds with the lowest error rates, and these rates.

    Array twin: `test_pattern_decision_against_a_fine_scan` in `tests/comms/test_ook_ber.py`.
    Why so: a required power takes ten decisions between 128 patterns. The grid is searched outwards
    from the threshold between the mean levels, so that most of its sums end early; its best node is
    improved by Newton's method for the root of the derivative, in a bracket.

    Parameters
    ----------
    mean, std : ndarray, shape (n, p)
        Means and standard deviations of the sample of each of p patterns, in n cases.
    is_one : ndarray, shape (p,)
        Whether a pattern carries a one.
    ber, threshold : ndarray, shape (n,)
        Results: mean error rate of the patterns, and threshold in the unit of `mean`.
    """
    for i in range(len(mean)):
        m, s = mean[i], std[i]
        start, end, middle = _between(m, s, is_one)
        step, least, best = (end - start) / _INTERVALS, math.inf, middle
        first = min(max(math.floor((middle - start) / step), 0), _INTERVALS)
        # Several levels make several minima: the grid finds the lowest, Newton alone the nearest.
        for k in range(2 * _INTERVALS + 1):
            # first, first + 1, first - 1, first + 2 ...
            node = first + ((k + 1) // 2 if k & 1 else -(k // 2))
            if node < 0 or node > _INTERVALS:
                continue
            total = _errors(m, s, is_one, start + node * step, least)
            if total < least:
                least, best = total, start + node * step
        low, high = max(best - step, start), min(best + step, end)
        for _ in range(_STEPS):
            slope, bend = _slopes(m, s, is_one, best)
            if slope > 0.0:
                high = best
            else:
                low = best
            # A negative curvature would lead Newton to a maximum: halve the bracket there.
            trial = best - slope / bend if bend > 0.0 else low
            if not low < trial < high:
                trial = 0.5 * (low + high)
            moved, best = abs(trial - best), trial
            if moved <= _SURE * step:
                break
        ber[i], threshold[i] = 0.5 * _errors(m, s, is_one, best, math.inf) / len(m), best
