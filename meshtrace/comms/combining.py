"""Combining of several receivers of one signal: error rates, equivalent gains, capacity bounds.

Each receiver counts its own photons, with its own shot, dark, background and thermal noise; the
fading of their gains may be correlated, since gains are given together, a row for each fade. Lamps
that send the same bits at once (repetition) need nothing of their own: their powers add at every
receiver, as in the gain of a link of several lamps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import ErrorRate, check_call
from meshtrace.comms.decisions import (
    gaussian_decision,
    generalized_poisson_decision,
    non_negative,
    pattern_decision,
)
from meshtrace.comms.ook import OokLink
from meshtrace.errors import Described, Refused
from meshtrace.models import Floats

Combining = Literal["selection", "equal", "maximal"]
"""Combining of receivers: the best one, the sum of their counts, or the maximal-ratio sum."""

_TOLERANCE = 1e-5  # of ln of a power in searches: 4e-5 dB


@check_call
def combined_ber(
    links: Sequence[OokLink], gain: ArrayLike, combining: Combining = "maximal"
) -> Floats:
    r"""Return the bit error rate of several receivers of one signal.

    .. math:: y = \sum_j w_j y_j, \quad w_j = 1 \text{ (equal)}, \quad
        w_j = \frac{r_{1j} - r_{0j}}{\sigma_j^2} \text{ (maximal)}

    Parameters
    ----------
    links : sequence of OokLink
        Transmission to each receiver. They differ in optics, background and devices at most.
    gain : array_like, shape (..., receivers)
        Gains [1], the last axis over the receivers.
    combining : {"selection", "equal", "maximal"}
        "selection" decides by the receiver with the lowest error rate at these gains, "equal" by
        the sum of the counts of all, "maximal" by a sum with weights, see Notes.

    Returns
    -------
    ndarray, shape (...)
        Bit error rate; 0.5 without light.

    Raises
    ------
    Refused
        If the receivers do not fit together, or their model has the exact law of counts, for which
        "maximal" (GP) and all sums (CP) are not available.

    Notes
    -----
    The samples y_j of one pattern of bits are independent: means and variances of
    `OokLink.moments` add with w_j and w_j^2, and the sum has one best threshold. r_0j and r_1j are
    the count rates of long zeros and ones, sigma_j^2 is the variance averaged over the patterns:
    the weights maximise the ratio of the squared distance of zero and one to the mean noise
    (Brennan 1959), for shot noise they are those of the mean light level. The receiver is taken to
    know its gains, as from a preamble. Counts of GP add to a generalized Poisson law again.

    References
    ----------
    Brennan (1959), Proc. IRE 47, 1075, doi:10.1109/JRPROC.1959.287136.

    Examples
    --------
    >>> one = OokLink(bit_rate=1e6)
    >>> alone, both = (combined_ber([one] * n, [2e-8] * n) for n in (1, 2))
    >>> bool(both < alone**1.5)
    True
    """
    g = _gains(links, gain)
    if combining == "selection" or len(links) == 1:
        bers = [link.ber(link.received_power(g[..., j])) for j, link in enumerate(links)]
        return np.asarray(np.min(bers, axis=0))
    flat = g.reshape(-1, len(links))
    ber = np.full(len(flat), 0.5)
    seen = flat.any(axis=1)
    powers = [link.received_power(flat[seen, j]) for j, link in enumerate(links)]
    ber[seen] = _summed(_alike(links), powers, combining) if seen.any() else 0.5
    return ber.reshape(g.shape[:-1])


def _summed(links: Sequence[OokLink], powers: list[Floats], combining: Combining) -> Floats:
    """Return the bit error rate of a sum of samples at powers [W] of each receiver (n,)."""
    first = links[0]
    levels = [link.levels(power) for link, power in zip(links, powers, strict=True)]
    if first.receiver.exact_counts:
        if combining != "equal" or first.receiver.has_pulses:
            allowed = "W, A, PC or G0; GP adds counts equally"
            raise Refused("model", first.model, f"{allowed}; or combining by selection")
        zeros, ones = (sum(level) * first.bit_time for level in zip(*levels, strict=True))
        return generalized_poisson_decision(zeros, ones, first.sipm.branching).ber
    pairs = zip(links, powers, strict=True)
    moments = [link.moments(power) for link, power in pairs]
    mean, variance = np.stack(moments, axis=1)  # (receivers, n, patterns)
    weight = np.ones(mean.shape[:2])
    if combining == "maximal":
        weight = np.stack([high - low for low, high in levels]) / variance.mean(axis=-1)
        weight = weight / weight.max(axis=0)
    mean = (weight[..., None] * mean).sum(axis=0)
    variance = (weight[..., None] ** 2 * variance).sum(axis=0)
    if not first.receiver.has_pulses:
        return gaussian_decision(mean[:, 0], mean[:, 1], variance[:, 0], variance[:, 1]).ber
    return pattern_decision(mean, np.sqrt(variance), first.patterns()[:, 0]).ber


def _gains(links: Sequence[OokLink], gain: ArrayLike) -> Floats:
    """Return gains (..., receivers); refuse another number of them, and links of other signals."""
    g, n = non_negative("gain", gain), len(links)
    if n == 0 or g.ndim == 0 or g.shape[-1] != n:
        raise Refused("gain", Described(f"shape {g.shape}"), f"(..., {n}), one for each receiver")
    for link in links[1:]:
        for name in ("bit_rate", "led", "memory", "equalizer", "response"):
            if getattr(link, name) != getattr(links[0], name):
                raise Refused("links", Described(f"different {name}"), f"a common {name}")
        if link.receiver != links[0].receiver:
            raise Refused("links", Described("different models"), "a common model")
    return g


def _alike(links: Sequence[OokLink]) -> list[OokLink]:
    """Return links with the averaging window of the first, so that their samples coincide."""
    window = links[0].averaging_window
    return [link if not window else link.replace(window=window) for link in links]


@check_call
def equivalent_gain(
    links: Sequence[OokLink], gain: ArrayLike, ber: ErrorRate, combining: Combining = "maximal"
) -> Floats:
    """Return the gain that would give the first receiver alone the same power margin.

    g_req / t, with the gain g_req that the first receiver needs for a bit error rate, and the
    factor t on the power of the lamp with which all together have it.

    Parameters
    ----------
    links, gain, combining
        As in `combined_ber`.
    ber : float
        Bit error rate, 0 < ber < 0.5.

    Returns
    -------
    ndarray, shape (...)
        Gain [1]: below `budget.required_gain` of the first receiver exactly where the receivers
        together miss the error rate; 0 where no power reaches it.

    Examples
    --------
    >>> one = OokLink(bit_rate=1e6)
    >>> print(f"{float(equivalent_gain([one, one], [2e-8, 2e-8], 1e-3)):.1e}")
    3.8e-08
    """
    from meshtrace.comms.budget import required_gain

    g = _gains(links, gain)
    links = _alike(links)
    flat, equivalent = g.reshape(-1, len(links)), np.zeros(g[..., 0].size)
    needs = np.array([required_gain(link, ber) for link in links])
    seen = (flat / needs).any(axis=1)
    if seen.any():
        # ln t: of the best receiver alone, which all together miss by their number at most where
        # the others add noise alone, and exceed by it at most
        alone, n = -np.log((flat[seen] / needs).max(axis=1)), len(links)
        low, high = alone - 1.1 * math.log(n) - 0.1, alone + math.log(n) + 0.1
        for _ in range(math.ceil(math.log2(2.3 * (math.log(n) + 0.1) / _TOLERANCE))):
            middle = 0.5 * (low + high)
            missed = combined_ber(links, np.exp(middle)[:, None] * flat[seen], combining) > ber
            low, high = np.where(missed, middle, low), np.where(missed, high, middle)
        equivalent[seen] = needs[0] * np.exp(-0.5 * (low + high))
    return equivalent.reshape(g.shape[:-1])


@check_call
def intensity_capacity(
    peak: ArrayLike,
    mean_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5,
) -> tuple[float, float]:
    r"""Return bounds of the capacity of an intensity channel with Gaussian noise.

    .. math:: Y = H x + Z, \quad 0 \le x_k \le 1, \quad E x_k \le \alpha, \quad Z \sim N(0, I)

    Parameters
    ----------
    peak : array_like, shape (), (receivers,) or (receivers, lamps)
        H: signal of each receiver at the peak power of each lamp, over the standard deviation of
        its noise [1], >= 0. The noise does not depend on the signal.
    mean_share : float
        Largest mean power of each lamp over its peak power alpha [1], 0 < alpha <= 1.

    Returns
    -------
    low, high : float
        Lower and upper bound [bit per use].

    Notes
    -----
    A matrix of one column, or several equal up to a factor, is a single channel with the peak
    A = |sum of the columns| over noise 1: projecting on the column (maximal ratio) loses no
    information, and lamps that repeat each other reach every sum from 0 to A with the same mean.
    Its capacity lies between the rate of the input of largest entropy, by the entropy power
    inequality, and that of Gaussian signals of the largest variance, two of the bounds that
    Lapidoth, Moser and Wigger (2009) compare,

    .. math:: \tfrac12 \log_2\left(1 + \frac{A^2 e^{2 h(\alpha)}}{2 \pi e}\right) \le C \le
        \tfrac12 \log_2(1 + v(\alpha) A^2),

    For alpha < 1/2, v = alpha (1 - alpha), and h = alpha mu + ln((1 - exp(-mu)) / mu) is the
    entropy of the law exp(-mu x) on [0, 1] whose mean is alpha, 1 / mu - 1 / (exp(mu) - 1) = alpha.
    From 1/2 on v = 1/4 and h = 0, that of a uniform law.

    Of a matrix of any rank the lower bound is the larger one of two: lamps that repeat each other,
    and, of full column rank, independent lamps by the entropy power inequality for vectors (other
    schemes: Chaaban, Rezki and Alouini 2017),

    .. math:: C \ge \frac{n}{2} \log_2\left(1 + \frac{e^{2 h}}{2 \pi e} \det(H^T H)^{1/n}\right).

    The upper bound is that of Gaussian signals of rank m, whose covariance has entries up to v,

    .. math:: C \le \frac{m}{2} \log_2\left(1 + \frac{v}{m} \sum_{kl} (H^T H)_{kl}\right),

    from the concavity of the logarithm of a determinant.

    References
    ----------
    A. Lapidoth, S. M. Moser and M. A. Wigger, "On the capacity of free-space optical intensity
    channels", IEEE Trans. Inf. Theory 55, 4449 (2009).
    A. Chaaban, Z. Rezki and M.-S. Alouini, "MIMO intensity-modulation channels: capacity bounds
    and high SNR characterization", IEEE International Conference on Communications (2017).

    Examples
    --------
    >>> [round(bound, 3) for bound in intensity_capacity(20.0)]
    [2.305, 3.329]
    """
    allowed = "numbers >= 0 of shape (), (receivers,) or (receivers, lamps)"
    h = non_negative("peak", peak)
    if h.ndim > 2 or not h.size:
        raise Refused("peak", Described(f"shape {h.shape}"), allowed)
    h = h.reshape(-1, 1) if h.ndim < 2 else h
    variance, entropy = _input_law(mean_share)
    gram, n = h.T @ h, h.shape[1]
    rank = max(int(np.linalg.matrix_rank(h)), 1)
    scale = math.exp(2.0 * entropy) / (2.0 * math.pi * math.e)

    def bits(channels: int, ratio: float) -> float:
        return 0.5 * channels * math.log2(1.0 + ratio)

    low = bits(1, scale * float(gram.sum()))
    if rank == n:
        sign, log_det = np.linalg.slogdet(gram)
        low = max(low, bits(n, scale * math.exp(log_det / n))) if sign > 0.0 else low
    return low, bits(rank, variance * float(gram.sum()) / rank)


def _input_law(share: float) -> tuple[float, float]:
    """Return the largest variance and entropy [nat] of inputs on [0, 1] with a bounded mean."""
    from scipy.optimize import brentq

    if share >= 0.5:
        return 0.25, 0.0
    mu = float(brentq(lambda u: 1.0 / u - 1.0 / math.expm1(u) - share, 1e-9, 700.0))
    return share * (1.0 - share), share * mu + math.log(-math.expm1(-mu) / mu)
