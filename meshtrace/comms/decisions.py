"""Decisions between zeros and ones: base of the receiver models, best thresholds, error rates.

The Gaussian decisions take mean and variance of the receiver's sample. The compound Poisson law is
exact: every count adds g(age) times its number of avalanches, and counts of different ages are
independent; it is inverted by FFT.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace.checks import NonNegative, Positive, Shape, check_call
from meshtrace.comms.pulses import PulseFilters
from meshtrace.errors import Described, Refused, require_array, require_real
from meshtrace.kernels.decision import best_thresholds
from meshtrace.models import Family, Floats

_NORMAL = 1e9  # mean counts above which their law is normal, to a skewness of 3e-5
_BRANCHING = "0 <= branching < 1"
_PATTERNS = "a number for each pattern (..., p), and p flags"


class Decision(NamedTuple):
    """Error rate [1] of the best single threshold, and that threshold in the unit of the sample."""

    ber: Floats
    threshold: Floats


Powers = Annotated[Floats, Shape("n")]  # on the SiPM [W]
Branching = Annotated[float, Field(ge=0.0, lt=1.0)]


class ReceiverModel(Family, default="W"):
    """Base of all receiver models.

    A subclass needs the method `decide`. It is then allowed as ``OokLink(model=Mine(...))``, and
    in plain data by its import path "module:Mine" (link files need trust for it), or by the name
    that a field such as ``kind: Literal["mine"] = "mine"`` gives it. Its methods get the
    `OokLink` whose model it is.

    docs/guides/own_models.md is an example.
    """

    has_pulses: ClassVar[bool] = False
    """Whether the model follows pulses, so that an eye diagram exists."""

    exact_counts: ClassVar[bool] = False
    """Whether the model uses the exact law of Poisson counts, which excludes renewal noise."""

    def averaging_window(self, link: Any) -> float:
        """Return the averaging window in front of the decision [s]."""
        return 0.0

    def moments(self, link: Any, power: ArrayLike, phase: float = 1.0) -> tuple[Floats, Floats]:
        """Return mean [s-1] and variance [s-2] of the sample for each bit pattern.

        By default those of independent bits: levels of a zero and a one (..., 2), Gaussian noise
        in B = R_b / 2.
        """
        mean, shot = (np.stack(v, axis=-1) for v in (link.levels(power), link.shot_levels(power)))
        return mean, noise(link, shot, 0.5 * link.bit_rate)

    @abc.abstractmethod
    def decide(self, link: Any, power: Powers) -> Decision:
        """Return bit error rate and threshold [s-1] at powers (n,) on the SiPM, all > 0 [W]."""


def noise(link: Any, shot: Floats, bandwidth: float) -> Floats:
    """Return the variance of shot and thermal noise (2 F r + S) B [s-2].

    Parameters
    ----------
    link : OokLink
        Excess noise factor F and thermal noise S.
    shot : ndarray
        Count rates with shot noise r [s-1].
    bandwidth : float
        Noise bandwidth B [Hz].
    """
    thermal = link.tia.thermal_noise(link.sipm.electrons_per_count)
    return (2.0 * link.sipm.excess_noise_factor * shot + thermal) * bandwidth


def non_negative(name: str, value: ArrayLike, most: float = math.inf) -> Floats:
    """Return `value` as an array of finite numbers from 0 to `most`, or refuse it by name."""
    allowed = "finite numbers >= 0" if math.isinf(most) else f"numbers from 0 to {most:g}"
    array = require_array(value, name, allowed)
    if not np.all(np.isfinite(array) & (array >= 0.0) & (array <= most)):
        raise Refused(name, value, allowed)
    return array


_Variance = Annotated[ArrayLike, Field(gt=0.0)]


@check_call
def gaussian_decision(m0: ArrayLike, m1: ArrayLike, v0: _Variance, v1: _Variance) -> Decision:
    """Decide between two Gaussian levels.

    BER = [Q((m1 - th) / s1) + Q((th - m0) / s0)] / 2,  with th at the crossing of the densities
    and the standard deviations s0 and s1

    Parameters
    ----------
    m0, m1 : array_like
        Means of zero and one, m1 >= m0.
    v0, v1 : array_like
        Their variances, > 0.

    Returns
    -------
    Decision
        Bit error rate and threshold, broadcast shape.

    Notes
    -----
    With D = m1 - m0, th = m0 + v0 (D^2 + v1 ln(v1/v0)) / (D v0 + R) and
    R^2 = v0 v1 (D^2 + (v1 - v0) ln(v1/v0)). The usual root is a quotient over v1 - v0, which is
    0 / 0 for equal variances; this form of it is regular there.

    Examples
    --------
    >>> print(f"{float(gaussian_decision(0.0, 6.0, 1.0, 1.0).ber):.6e}")
    1.349898e-03
    """
    from scipy.special import ndtr

    try:
        m0, m1, v0, v1 = np.broadcast_arrays(m0, m1, v0, v1)
    except ValueError as error:
        raise Refused("m1", Described("another shape"), "shapes that fit") from error
    if np.any(m1 < m0):
        raise Refused("m1", Described("below m0"), "m1 >= m0")
    d, log_ratio = m1 - m0, np.log(v1 / v0)
    # the quadratic of equal densities, solved without its division by v1 - v0 (Notes)
    root = np.sqrt(v0 * v1 * (d * d + (v1 - v0) * log_ratio))
    divisor = d * v0 + root
    safe = np.where(divisor > 0.0, divisor, 1.0)  # equal laws: any threshold errs half of the time
    above_m0 = v0 * (d * d + v1 * log_ratio) / safe  # threshold, from m0
    ber = 0.5 * (ndtr((above_m0 - d) / np.sqrt(v1)) + ndtr(-above_m0 / np.sqrt(v0)))
    return Decision(ber, m0 + above_m0)


@check_call
def pattern_decision(mean: ArrayLike, std: ArrayLike, is_one: NDArray[np.bool_]) -> Decision:
    """Decide between zeros and ones of equally likely patterns with Gaussian noise.

    Parameters
    ----------
    mean, std : array_like
        Mean and standard deviation of the sample (..., p).
    is_one : array_like
        Which of the p patterns carry a one (p,).

    Returns
    -------
    Decision
        Bit error rate, averaged over the patterns, and threshold (...).

    Notes
    -----
    The threshold is the best of a grid, improved by Newton's method: see
    `kernels.decision.best_thresholds`.
    """
    mean, std = np.asarray(mean), np.asarray(std)
    for name, array in (("is_one", is_one), ("mean", mean), ("std", std)):
        if array.ndim == 0 or array.shape[-1:] != is_one.shape[-1:] or not is_one.size:
            raise Refused(name, Described(f"shape {array.shape}"), _PATTERNS)
    mean, std = (np.ascontiguousarray(x) for x in np.broadcast_arrays(mean, std))
    decision = Decision(np.empty(mean.shape[:-1]), np.empty(mean.shape[:-1]))
    flat = (x.reshape(-1, is_one.size) for x in (mean, std))
    # the kernel writes into these views of the decision
    best_thresholds(*flat, is_one, *(x.reshape(-1) for x in decision))
    return decision


@check_call
def generalized_poisson_logpmf(
    k: ArrayLike, primaries: NonNegative, branching: Branching
) -> Floats:
    """Return the log-probability of k counts from branching Poisson primaries.

    P(k) = N (N + k lam)^(k-1) exp(-N - k lam) / k!  (Consul and Jain 1973, Technometrics 15, 791)

    Parameters
    ----------
    k : array_like
        Counts, integers >= 0, any shape.
    primaries : float
        Mean number of primaries N.
    branching : float
        Mean number of direct secondaries lam, 0 <= lam < 1; 0 is the Poisson law.

    Returns
    -------
    ndarray
        Log probability, same shape.
    """
    from scipy.special import gammaln, xlogy

    k = non_negative("k", k)
    # at k = 0 the law is exp(-N); its general form would be 0 / 0 there if N = 0
    rate = primaries + k * branching
    # xlogy(1, N) is ln N without a warning where N = 0
    log_growth = xlogy(1.0, primaries) + xlogy(k - 1.0, np.where(rate > 0.0, rate, 1.0))
    return np.where(k == 0.0, -primaries, log_growth - rate - gammaln(k + 1.0))


def _distance(n0: float, n1: float, branching: float) -> float:
    """Return the distance between the means of two counts in standard deviations of the larger."""
    # generalized Poisson counts have the mean N / (1 - lam) and the variance N / (1 - lam)^3
    return (n1 - n0) * math.sqrt((1.0 - branching) / n1) if n1 > 0.0 else 0.0


def _decision_laws(n0: float, n1: float, branching: float) -> tuple[Floats, Floats, Floats]:
    """Return the counts of non-negligible probability, and its logarithm for zero and one bits."""
    unbranched = 1.0 - branching
    # Normal tails hold less than 1e-32 beyond 12 deviations; 40
    # more counts cover the skewed tail of laws of few counts.
    std0, std1 = (math.sqrt(n / unbranched**3) for n in (n0, n1))
    first = max(math.floor(n0 / unbranched - 12.0 * std0), 0)
    k = np.arange(first, math.ceil(n1 / unbranched + 12.0 * std1 + 40.0), dtype=float)
    log0, log1 = (generalized_poisson_logpmf(k, n, branching) for n in (n0, n1))
    return k, log0, log1


@check_call
def generalized_poisson_decision(n0: ArrayLike, n1: ArrayLike, branching: float) -> Decision:
    """Decide by the number of counts, with their exact law.

    Parameters
    ----------
    n0, n1 : array_like
        Mean primaries in a zero and in a one, 0 <= n0 <= n1; broadcast.
    branching : float
        Mean number of direct secondaries per avalanche; 0 is Poisson counting.

    Returns
    -------
    Decision
        Bit error rate and the lowest count that is read as a one, broadcast shape. Where the error
        rate lies below 1e-300 it is 0, and the threshold half-way between the means.

    Notes
    -----
    A count k is read as a one where the likelihood of a one is the larger, which the monotone
    likelihood ratio makes a threshold. Each tail is summed separately, never as 1 - cdf.

    Examples
    --------
    >>> print(f"{float(generalized_poisson_decision(2.0, 20.0, 0.0).ber):.5e}")
    9.37655e-04
    """
    n0, n1 = non_negative("n0", n0), non_negative("n1", n1)
    branching = require_real(branching, "branching", _BRANCHING)
    if np.any(n0 > n1) or not 0.0 <= branching < 1.0:
        raise Refused("n0, n1, branching", (n0, n1, branching), f"n0 <= n1, {_BRANCHING}")
    return Decision(*np.vectorize(_count_decision, [float, float])(n0, n1, branching))


def _count_decision(n0: float, n1: float, branching: float) -> tuple[float, float]:
    """Return the bit error rate and the decision threshold [counts]."""
    # means 100 deviations apart: the error rate underflows, and no sum over huge counts is needed
    if (n1 - n0) ** 2 * (1.0 - branching) > 1e4 * n1:
        return 0.0, 0.5 * (n0 + n1) / (1.0 - branching)
    # the test above leaves means so close together that both laws have the same variance
    if n0 > _NORMAL:
        from scipy.special import ndtr

        ber = float(ndtr(-0.5 * _distance(n0, n1, branching)))
        return ber, 0.5 * (n0 + n1) / (1.0 - branching)
    k, log0, log1 = _decision_laws(n0, n1, branching)
    read_one = log1 >= log0
    ber = 0.5 * float(np.exp(log0[read_one]).sum() + np.exp(log1[~read_one]).sum())
    return ber, float(k[np.argmax(read_one)])


# distance of the means [standard deviations] beyond which the loss is below 2e-22, about
# exp(-20^2 / 8), of a bit
_CERTAIN = 20.0


@check_call
def soft_information(n0: float, n1: float, branching: float) -> float:
    """Return the mutual information between equally likely bits and their counts [bit per use].

    Parameters
    ----------
    n0, n1 : float
        Mean primaries in a zero and in a one, 0 <= n0 <= n1.
    branching : float
        Mean number of direct secondaries per avalanche.

    Examples
    --------
    >>> round(soft_information(2.0, 20.0, 0.0), 6)
    0.995989
    """
    arguments = {"n0": n0, "n1": n1, "branching": branching}
    n0, n1, branching = (require_real(x, name, "a number") for name, x in arguments.items())
    if not (0.0 <= n0 <= n1 < math.inf and 0.0 <= branching < 1.0):
        raise Refused("n0, n1, branching", (n0, n1, branching), f"n0 <= n1, {_BRANCHING}")
    if _distance(n0, n1, branching) > _CERTAIN:
        return 1.0
    if n0 > _NORMAL:
        # other bits in one state, of log probability 0
        return _normal_information(np.array([[n0], [n1]]), np.zeros(1), branching)
    return _information(np.array(_decision_laws(n0, n1, branching)[1:]))


def _information(log_p: Floats) -> float:
    """Return the mutual information [bit] of bits and counts.

    `log_p` (2, k) are the log probabilities of the counts for a zero and for a one.
    """
    # I = sum over both bits and all counts of p ln(p / mean p) / 2, in nat
    log_mean = np.logaddexp(*log_p) - math.log(2.0)
    # p ln p goes to 0 with p: the bound keeps it from becoming 0 times infinity
    terms = np.exp(log_p) * np.maximum(log_p - log_mean, -1e3)
    return float(np.clip(0.5 * terms.sum() / math.log(2.0), 0.0, 1.0))


def _normal_information(means: Floats, log_chance: Floats, branching: float) -> float:
    """Return the mutual information [bit] of bits and normal counts.

    `means` (2, states) are the mean primaries of a zero and of a one for each state of the other
    bits, `log_chance` (states,) the log probabilities of the states.
    """
    from scipy.special import logsumexp

    # I = 1 - E log2(1 + p_other(x) / p_sent(x)), with the densities p of the bit sent and of the
    # other one, by Gauss-Hermite nodes around the mean of each state
    nodes, weights = np.polynomial.hermite_e.hermegauss(32)
    # counts times (1 - lam): mean N, variance N / (1 - lam); at least that of N = 1, as a dark
    # state would have none
    std = np.sqrt(np.maximum(means, 1.0) / (1.0 - branching))
    counts = means[..., None] + std[..., None] * nodes  # (2, states, nodes)
    # of each law at each node: (2, states, nodes, 2, states), then summed over the last states
    z = (counts[..., None, None] - means) / std
    log_p = logsumexp(log_chance - np.log(std) - 0.5 * z * z, axis=-1)
    # ln p_other - ln p_sent (2, states, nodes): the first axis is the bit sent, the last of log_p
    # the bit whose density it is
    other = np.stack([log_p[0, ..., 1] - log_p[0, ..., 0], log_p[1, ..., 0] - log_p[1, ..., 1]])
    lost = np.logaddexp(0.0, other) @ (weights / weights.sum()) @ np.exp(log_chance)
    return float(np.clip(1.0 - 0.5 * lost.sum() / math.log(2.0), 0.0, 1.0))


_EXACT = 1e3  # mean counts up to which a mixture of their laws is summed


@check_call
def mixed_information(
    zeros: ArrayLike, ones: ArrayLike, chance: ArrayLike, branching: Branching
) -> float:
    """Return the soft information if light of other bits mixes the laws of the counts.

    Parameters
    ----------
    zeros, ones : array_like, shape (m,)
        Mean primaries in a zero and in a one for each state of the other bits, >= 0.
    chance : array_like, shape (m,)
        Probabilities of the states; they add up to 1.
    branching : float
        Mean number of direct secondaries per avalanche.

    Notes
    -----
    The other bits are unknown, so that this is the rate of a decoder of single bits. Means above
    1000 count as normal, with 32 nodes in each state.

    Examples
    --------
    >>> round(mixed_information([2.0, 3.0], [20.0, 21.0], [0.5, 0.5], 0.0), 6)
    0.992362
    """
    from scipy.special import logsumexp

    arguments = {"zeros": zeros, "ones": ones, "chance": chance}
    values = [non_negative(name, x) for name, x in arguments.items()]
    for name, row in zip(arguments, values, strict=True):
        if row.ndim != 1 or row.shape != values[2].shape or not values[2].any():
            raise Refused(name, Described(f"shape {row.shape}"), "(n,) each, not all chances 0")
    means = np.stack(values[:2])
    with np.errstate(divide="ignore"):
        log_chance = np.log(values[2])
    if means.max() >= _EXACT:
        return _normal_information(means, log_chance, branching)
    unbranched = 1.0 - branching
    most = float(means.max()) / unbranched
    # as in `_decision_laws`, but up from 0, as zeros may be dark in some states
    k = np.arange(math.ceil(most + 12.0 * math.sqrt(most) / unbranched + 40.0), dtype=float)
    laws = [[generalized_poisson_logpmf(k, float(n), branching) for n in row] for row in means]
    return _information(logsumexp(np.array(laws) + log_chance[:, None], axis=1))


ComplexArray = NDArray[np.complex128]

_POINTS = 2**16  # of the lattice of the compound Poisson law
_INDEX = np.arange(_POINTS // 2 + 1)  # of the frequencies of a real FFT


@check_call
def compound_poisson_decision(
    low: NonNegative,
    high: Positive,
    filters: PulseFilters,
    bit_time: Positive,
    removed: Annotated[Floats, Shape("n")],
    branching: Branching,
    thermal_std: Positive,
) -> tuple[float, float]:
    """Decide between zeros and ones in filtered shot noise, without Gaussian assumption.

    ln E exp(-i w X) = int r(t) [B(exp(-i w (1 - lam) g(t))) - 1] dt - (w s_th)^2 / 2,

    with the sample X, the count rate r(t) and response g(t) at the age t, the generating function B
    of the Borel law, and the thermal standard deviation s_th. The characteristic function is
    averaged over both values of each other bit, which is exact.

    Parameters
    ----------
    low, high : float
        Primary counts during long zeros and long ones [s-1], 0 <= low < high.
    filters : PulseFilters
        Poles and window.
    bit_time : float
        T [s].
    removed : ndarray
        Mean that an equaliser takes off for each of the present and earlier bits that was a one
        (memory,) [s-1], next ones last; its length is the number of bits that matter.
    branching : float
        Mean number of direct secondaries per avalanche, 0 <= lam < 1.
    thermal_std : float
        Standard deviation of the Gaussian noise in the sample [s-1], > 0.

    Returns
    -------
    tuple of float
        Bit error rate, with an absolute error of some 1e-12, and threshold [s-1].

    Notes
    -----
    The amplitudes of single counts are rounded to a lattice of 65536 values that spans the
    sample's range; the largest lies on it. Means of more than about 10000 counts are too many: a
    single count then spans few of its steps.
    """
    if not low < high:
        raise Refused("low", low, f"low < high = {high:g}")
    if not removed.size:
        raise Refused("removed", removed, "a number for each bit, one or more")
    unbranched = 1.0 - branching  # response of one avalanche over that of one count
    # mean where all bits are ones, the highest one [s-1]
    top = low + (high - low) * float(filters.mean_step(bit_time * removed.size))
    below = 8.0 * thermal_std + float(removed.sum())
    step = _lattice_step(below, top, filters, unbranched, thermal_std)
    frequency = 2.0 * math.pi * np.fft.rfftfreq(_POINTS, step)
    borel = _borel(branching)
    # lattice point j stands for the amplitudes between its edges j - 1/2 and j + 1/2: lower edges
    edges = np.arange(1, math.ceil(unbranched * filters.peak / step) + 1) - 0.5
    # a response is above an edge between two ages, on either side of its peak
    young, old = filters.ages_above(np.minimum(edges * step / unbranched, filters.peak))

    def exponent(counts_until: Callable[[Floats], Floats]) -> ComplexArray:
        """Return the exponent of the characteristic function by the mean counts below an age."""
        # counts whose response lies between two edges of the lattice
        counts = np.zeros(_POINTS)
        above = counts_until(old) - counts_until(young)
        counts[1 : above.size + 1] = above - np.append(above[1:], 0.0)
        spectrum = np.fft.fft(counts)
        # m avalanches of one count have m times its
        # amplitude: its spectrum at m times the frequency
        branched = sum(p * spectrum[(m * _INDEX) % _POINTS] for m, p in enumerate(borel, 1))
        return np.asarray(branched - counts.sum())

    # Characteristic functions (cf) with the sign of `numpy.fft`, exp(-i w X). The sample is shifted
    # up by a whole number of steps, so that values below 0 lie on the lattice.
    cf_zero = np.exp(
        exponent(lambda age: low * age)
        - 0.5 * (thermal_std * frequency) ** 2
        - 1j * frequency * math.ceil(below / step) * step
    )

    def bit(ago: int) -> ComplexArray:
        """Return the factor of the characteristic function for a one sent `ago` bits earlier."""
        log_cf = exponent(lambda age: (high - low) * filters.light_since(age, ago, bit_time))
        return np.asarray(np.exp(log_cf + 1j * frequency * removed[ago]))

    ahead = min(filters.bits_ahead(bit_time), removed.size - 1)
    for ago in (*range(1, removed.size - ahead), *range(-ahead, 0)):
        # independent bits, each a one half of the time
        cf_zero = cf_zero * 0.5 * (1.0 + bit(ago))
    cf_one = cf_zero * bit(0)
    # each tail is summed from its end, never as 1 - cdf, which would cancel
    missed = np.concatenate(([0.0], np.cumsum(np.fft.irfft(cf_one, _POINTS))))
    false = np.concatenate((np.cumsum(np.fft.irfft(cf_zero, _POINTS)[::-1])[::-1], [0.0]))
    index = int(np.argmin(missed + false))  # the lowest lattice point above the threshold
    ber = max(0.5 * float(missed[index] + false[index]), 0.0)  # rounding may leave it below 0
    # half a step below that point, less the shift
    return ber, (index - 0.5 - math.ceil(below / step)) * step


def _lattice_step(
    below: float, top: float, filters: PulseFilters, unbranched: float, thermal_std: float
) -> float:
    """Return the step of a lattice of amplitudes that begins at -below, all in s-1."""
    # Campbell's theorem: variance r F int g^2, F = 1 / (1 - lam)
    spread = math.sqrt(top * filters.noise_energy / unbranched)
    # The FFT is periodic, and what lies beyond an end comes back at the other: room for 12
    # deviations of shot noise, 30 avalanches at their peak and 8 deviations of thermal noise.
    reach = top + 12.0 * spread + 30.0 * unbranched * filters.peak + 8.0 * thermal_std
    step = (reach + below) / _POINTS
    peak_steps = unbranched * filters.peak / step
    # the peak of a single avalanche becomes a whole number of steps, or stays below one
    return step * (peak_steps / max(math.floor(peak_steps), min(peak_steps, 1.0)))


def _borel(branching: float) -> Floats:
    """Return the probabilities of 1, 2, ... avalanches per primary, scaled to a sum of 1.

    Those below 1e-16 and of 400 avalanches or more are left out.
    """
    from scipy.special import gammaln

    m = np.arange(1, 400)
    if branching == 0.0:
        return np.ones(1)
    # Borel: P(m) = exp(-lam m) (lam m)^(m-1) / m!
    p = np.exp(-branching * m + (m - 1) * np.log(branching * m) - gammaln(m + 1))
    probable = p[p > 1e-16]
    return np.asarray(probable / probable.sum())
