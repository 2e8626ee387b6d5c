"""Outage and fade margin of codes interleaved over several fades."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Probability, check_call
from meshtrace.comms.budget import ber_of_gains, faded_gains, required_gain
from meshtrace.comms.capacity import hard_information
from meshtrace.comms.ook import OokLink
from meshtrace.errors import Refused, require_finite

_GRID = 4096
_MOST_FADES = 256
_WIDEST_DB = 60.0


@check_call
def mean_below(
    values: ArrayLike, limit: float, n: Annotated[int, Field(ge=1, le=_MOST_FADES)]
) -> float:
    """Return the probability that the mean of n independent draws lies below a limit.

    Parameters
    ----------
    values : array_like
        Sample (m,) that stands for the law, m >= 1, finite.
    limit : float
        Limit of the mean.
    n : int
        Number of draws, 1 ... 256.

    Returns
    -------
    float
        Probability: exact for n = 1, else by convolution on 4096 nodes over the range of the
        values, each shared out between its two neighbours.

    Raises
    ------
    Refused
        If a value is out of range.

    Examples
    --------
    >>> round(mean_below([0.0, 1.0], 0.4, 2), 3)  # both draws are 0
    0.25
    """
    sample = require_finite(values, "values", "(m,) with m >= 1, finite")
    low, high = float(sample.min()), float(sample.max())
    if n == 1 or low == high:
        return float((sample < limit).mean())
    step = (high - low) / (_GRID - 1)
    at = (sample - low) / step
    left = np.minimum(at.astype(np.int64), _GRID - 2)
    share = at - left
    # shared linearly by the two nodes next to it, a value keeps its mean
    mass = np.bincount(left, 1.0 - share, _GRID) + np.bincount(left + 1, share, _GRID)
    length = n * (_GRID - 1) + 1
    # padded, so that the periodic convolution does not wrap around
    summed = np.fft.irfft(np.fft.rfft(mass / sample.size, 2 * length) ** n, 2 * length)[:length]
    below = np.concatenate([[0.0], np.cumsum(summed)])
    # a node stands for the half step on either side of it
    place = n * (limit - low) / step + 0.5
    return float(np.clip(np.interp(place, np.arange(length + 1), below), 0.0, 1.0))


@check_call
def interleaved_outage(
    link: OokLink, gain: ArrayLike, rate: Probability, fades: int = 1, h_alpha: ArrayLike = 1.0
) -> float:
    r"""Return the outage of an ideal code interleaved over several fades.

    .. math:: P_\mathrm{out} = P\left(\frac{1}{m} \sum_{i=1}^{m} C(h_i) < R\right), \quad
        C = 1 - H_2(\mathrm{BER}(P h))

    Parameters
    ----------
    link : OokLink
        Transmitter and receiver.
    gain : array_like
        Gains (n,) [1], the law of the independent fades.
    rate : float
        Rate of the code R [bit per use], 0 < R < 1.
    fades : int
        Independent fades m of a code word, 1 ... 256: the interleaver's depth over the time
        after which fades are independent. 1 without interleaver.
    h_alpha : array_like
        Tilt factor [1], broadcast against `gain`.

    Returns
    -------
    float
        Probability.

    Raises
    ------
    Refused
        If a value is out of range.

    Notes
    -----
    The law of block fading: a long code fails only where the information that its m blocks carry
    after hard decisions falls below its rate. Within a block the gain is constant.

    References
    ----------
    L. H. Ozarow, S. Shamai and A. D. Wyner, IEEE Trans. Veh. Technol. 43, 359 (1994),
    doi:10.1109/25.293655. D. Tse and P. Viswanath, Fundamentals of Wireless Communication (2005),
    section 5.4.

    Examples
    --------
    >>> gain = [1e-9, 2e-8, 4e-8, 8e-8]
    >>> [round(interleaved_outage(OokLink(), gain, 0.5, m), 4) for m in (1, 2, 4)]
    [0.25, 0.0625, 0.0508]
    """
    ber = ber_of_gains(link, faded_gains(gain, h_alpha))
    return mean_below(hard_information(ber), rate, fades)


@check_call
def fade_margin_db(
    link: OokLink,
    gain: ArrayLike,
    rate: Probability,
    fades: int = 1,
    outage: Probability = 1e-3,
    h_alpha: ArrayLike = 1.0,
) -> float:
    """Return the optical margin that fading costs an interleaved code.

    Parameters
    ----------
    link, rate, fades, h_alpha
        As in `interleaved_outage`.
    gain : array_like
        Gains (n,) [1]; their mean does not matter. An outage needs some 10 / outage gains.
    outage : float
        Probability that is allowed, 0 < outage < 1.

    Returns
    -------
    float
        10 log10 of the mean power over the power that the code needs without fading [dB].

    Raises
    ------
    Refused
        If a value is out of range, or 60 dB do not suffice.

    Notes
    -----
    The interleaver's gain is the margin with `fades` = 1 less that with m.
    """
    from scipy.optimize import brentq

    error_rate = brentq(lambda p: float(hard_information(p)) - rate, 0.0, 0.5, xtol=1e-15)
    relative = faded_gains(gain, h_alpha)
    relative = relative / relative.mean()
    steady = required_gain(link, max(error_rate, 1e-12))

    def missed(margin: float) -> bool:
        scaled = steady * 10.0 ** (0.1 * margin) * relative
        return interleaved_outage(link, scaled, rate, fades) > outage

    low, high = -_WIDEST_DB, _WIDEST_DB
    if missed(high):
        raise Refused("outage", outage, f"attainable with {_WIDEST_DB:g} dB of margin")
    # bisection, since the outage of a finite sample may fall in steps
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if missed(middle) else (low, middle)
    return high
