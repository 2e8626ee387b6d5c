"""Rates of a fading channel: hard and soft decisions, outage, and the photon channel."""

from __future__ import annotations

import functools
import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import NonNegative, Positive, check_call
from meshtrace.comms.budget import ber_of_gains, faded_gains
from meshtrace.comms.decisions import mixed_information, non_negative, soft_information
from meshtrace.comms.ook import OokLink
from meshtrace.models import Floats

_STATES = 8  # that stand for the light of other bits


class Capacity(NamedTuple):
    """Rates over a fading channel [bit s-1].

    `hard` and `soft` are averages over the ensemble (ergodic: a code must span the fades), after
    hard decisions and from full counts of each bit, where only the channel's response mixes bits,
    not the poles of the devices; `hard_outage` is the rate that all but the stated share of the
    realizations carry, the figure for codes shorter than a wave's fade.
    """

    hard: float
    soft: float
    hard_outage: float


@check_call
def hard_information(ber: ArrayLike) -> Floats:
    """Return the capacity of a binary symmetric channel, 1 - H2(BER) [bit per use].

    Parameters
    ----------
    ber : array_like
        Bit error rate, 0 <= ber <= 1, any shape.

    Raises
    ------
    Refused
        If a rate is not within its range.

    Examples
    --------
    >>> round(float(hard_information(1e-3)), 6)
    0.988592
    """
    from scipy.special import entr

    p = non_negative("ber", ber, 1.0)
    return 1.0 - (entr(p) + entr(1.0 - p)) / math.log(2.0)


@check_call
def capacity(
    link: OokLink,
    gain: ArrayLike,
    h_alpha: ArrayLike = 1.0,
    outage: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.01,
) -> Capacity:
    """Return the rates of on-off keying at the link's bit rate over an ensemble of gains.

    Parameters
    ----------
    link : OokLink
        Transmitter and receiver.
    gain : array_like
        Gains (n,) [1].
    h_alpha : array_like
        Tilt factor [1], broadcast against `gain`.
    outage : float
        Share of the realizations that `hard_outage` gives up, 0 <= outage < 1.

    Returns
    -------
    Capacity
        Hard-decision and soft ergodic rates, hard-decision outage rate [bit s-1].

    Raises
    ------
    Refused
        If a value is out of range.
    """
    g = faded_gains(gain, h_alpha)
    power = link.received_power(g)
    low, high = link.levels(power)
    # Poisson counts with the signal-to-noise ratio of quieter ones
    quiet = sum(link.shot_levels(power)) / (low + high)
    pairs = zip(*(level * link.bit_time / quiet for level in (low, high)), strict=True)
    soft = np.array([_soft(link, float(a), float(b)) for a, b in pairs])
    # full counts bound every decision; Gaussian models break that below a count or so in a one
    hard = np.minimum(hard_information(ber_of_gains(link, g)), soft)
    # no interpolation: a rate that one of the realizations does carry
    carried = float(np.quantile(hard, outage, method="lower"))
    rate = link.bit_rate
    return Capacity(rate * float(hard.mean()), rate * float(soft.mean()), rate * carried)


def _soft(link: OokLink, n0: float, n1: float) -> float:
    """Return the mutual information of a bit and its counts behind the channel [bit]."""
    branching = link.sipm.branching
    if link.filters.response is None:
        return soft_information(n0, n1, branching)
    own_share, others, chance = _interference(link)
    zeros, ones = (n0 + (n1 - n0) * (b * own_share + others) for b in (0.0, 1.0))
    return mixed_information(zeros, ones, chance, branching)


@functools.lru_cache(maxsize=64)
def _interference(link: OokLink) -> tuple[float, Floats, Floats]:
    """Return the share of a bit's energy in its slot, and the interference of other bits."""
    shares = link.filters.slot_shares(link.bit_time, link.memory)
    # decision feedback knows the earlier bits, so that their light is no interference
    shares = np.where(link.equalized(link.memory), 0.0, shares)
    others = shares[1:]
    bits = np.array(np.unravel_index(np.arange(2**others.size), (2,) * others.size)).T
    pattern_counts = np.asarray(bits @ others)
    # 2^(memory - 1) patterns would need as many laws: patterns of nearly the same light share one
    bins = np.minimum(
        (_STATES * pattern_counts / max(pattern_counts.max(), 1e-300)).astype(int), _STATES - 1
    )
    count, total = np.bincount(bins), np.bincount(bins, pattern_counts)
    seen = count > 0
    return float(shares[0]), total[seen] / count[seen], count[seen] / pattern_counts.size


@check_call
def wyner_capacity(
    peak_rate: Positive,
    dark_rate: NonNegative,
    mean_share: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0,
) -> float:
    """Return the capacity of the photon channel for any modulation [bit s-1].

    C = A [q (1+s) ln(1+s) + (1-q) s ln s - (q+s) ln(q+s)] / ln 2,  s = dark / A,
    q = min(mean share, (1+s)^(1+s) / (s^s e) - s)

    With much background light it approaches A q (1-q) / (2 s ln 2), q = 1/2.

    Parameters
    ----------
    peak_rate : float
        Signal counts at peak power A [s-1], > 0.
    dark_rate : float
        Dark and background counts [s-1], >= 0.
    mean_share : float
        Largest mean power over peak power, 0 < mean_share <= 1.

    Returns
    -------
    float
        Capacity [bit s-1].

    Raises
    ------
    Refused
        If a value is out of range.

    References
    ----------
    Wyner (1988), IEEE Trans. Inf. Theory 34, 1449, doi:10.1109/18.21284.

    Examples
    --------
    >>> round(wyner_capacity(1.0, 0.1) * math.log(2.0), 6)
    0.250556
    """
    peak, dark, share = peak_rate, dark_rate, mean_share
    s = min(dark / peak, 1e300)
    # without dark counts the capacity is A q ln(1 / q), largest at q = 1 / e
    if s < 1e-300:
        q = min(share, math.exp(-1.0))
        nats = -q * math.log(q)
    else:
        # the sum of the docstring without its differences of large numbers
        q = min(share, s * math.expm1(_excess(1.0, s)))
        nats = q * _excess(1.0, s) - _excess(q, s)
    return peak * nats / math.log(2.0)


def _excess(u: float, s: float) -> float:
    """Return (s+u) ln(1 + u/s) - u, by its series sum_k (-1)^k s x^k / (k (k-1)) for small x."""
    x = u / s
    if x > 1e-3:
        return (s + u) * math.log1p(x) - u
    return u * x * (1.0 / 2.0 - x * (1.0 / 6.0 - x * (1.0 / 12.0 - x * (1.0 / 20.0 - x / 30.0))))
