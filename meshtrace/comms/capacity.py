"""Rates of a fading channel: hard and soft decisions, outage, and the photon channel."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.comms.budget import ber_of_gains, faded_gains
from meshtrace.comms.decisions import non_negative, soft_information
from meshtrace.comms.ook import OokLink
from meshtrace.errors import Refused
from meshtrace.models import Floats


class Capacity(NamedTuple):
    """Rates over a fading channel [bit s-1].

    `hard` and `soft` are averages over the ensemble (ergodic: a code must span the fades), after
    hard decisions and from full counts without intersymbol interference; `hard_outage` is the rate
    that all but the stated share of the realizations carry, the figure for codes shorter than a
    wave's fade.
    """

    hard: float
    soft: float
    hard_outage: float


def hard_information(ber: ArrayLike) -> Floats:
    """Return the capacity of a binary symmetric channel, 1 - H2(BER) [bit per use].

    Parameters
    ----------
    ber : array_like
        Bit error rate, 0 <= ber <= 1, any shape.

    Examples
    --------
    >>> round(float(hard_information(1e-3)), 6)
    0.988592
    """
    from scipy.special import entr

    p = non_negative("ber", ber)
    return 1.0 - (entr(p) + entr(1.0 - p)) / math.log(2.0)


def capacity(
    link: OokLink, gain: ArrayLike, h_alpha: ArrayLike = 1.0, outage: float = 0.01
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
    if not 0.0 <= outage < 1.0:
        raise Refused("outage", outage, "0 <= outage < 1")
    g = faded_gains(gain, h_alpha)
    power = link.received_power(g)
    low, high = link.levels(power)
    # Poisson counts with the signal-to-noise ratio of quieter ones
    quiet = sum(link.shot_levels(power)) / (low + high)
    pairs = zip(*(level * link.bit_time / quiet for level in (low, high)), strict=True)
    soft = np.array([soft_information(float(a), float(b), link.sipm.branching) for a, b in pairs])
    # full counts bound every decision; Gaussian models break that below a count or so in a one
    hard = np.minimum(hard_information(ber_of_gains(link, g)), soft)
    carried = float(np.quantile(hard, outage, method="lower"))
    rate = link.bit_rate
    return Capacity(rate * float(hard.mean()), rate * float(soft.mean()), rate * carried)


def wyner_capacity(peak_rate: float, dark_rate: float, mean_share: float = 1.0) -> float:
    """Return the capacity of the photon channel for any modulation [bit s-1].

    C = A [q (1+s) ln(1+s) + (1-q) s ln s - (q+s) ln(q+s)] / ln 2,  s = dark / A,
    q = min(mean share, (1+s)^(1+s) / (s^s e) - s)

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
    if not (0.0 < peak_rate < math.inf and 0.0 <= dark_rate < math.inf):
        raise Refused("peak_rate, dark_rate", (peak_rate, dark_rate), "finite, > 0 and >= 0")
    if not 0.0 < mean_share <= 1.0:
        raise Refused("mean_share", mean_share, "0 < mean_share <= 1")
    s = dark_rate / peak_rate
    s_log_s = s * math.log(s) if s > 0.0 else 0.0
    best = math.exp((1.0 + s) * math.log1p(s) - s_log_s - 1.0) - s
    q = min(mean_share, best)
    nats = q * (1.0 + s) * math.log1p(s) + (1.0 - q) * s_log_s - (q + s) * math.log(q + s)
    return peak_rate * nats / math.log(2.0)
