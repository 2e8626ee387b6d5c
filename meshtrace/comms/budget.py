"""From channel gains to link performance: budget, average error rate, outage, range.

Gains come as a number, an array over depth or time, or an ensemble of realizations; the tilt factor
h_alpha of an aircraft multiplies them as an array of the same shape (or is 1 where the gains
already contain the tilt).
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace import fading
from meshtrace.checks import Positive, Probability, Seed, check_call
from meshtrace.comms.decisions import non_negative
from meshtrace.comms.ook import OokLink
from meshtrace.errors import Described, Refused, require_array
from meshtrace.fading import Estimate
from meshtrace.fading.distribution import check_effective
from meshtrace.models import Floats

FEC_LIMITS: dict[str, float] = {"uncoded": 1e-3, "paper": 2e-3, "hard-7-percent": 3.8e-3}
"""Bit error rates before decoding that count as success: the figure usual without a code, the
paper's limit, and that of hard-decision codes with 7 % overhead (net rate 239/255)."""

_TABLE_POINTS = 256  # nodes of an interpolated error rate, see `ber_of_gains`


class LinkBudget(NamedTuple):
    """Optical power along the link, in decibels; the fields are numbers or arrays over the gains.

    `margin_optical_db` is 10 log10 of the ratio of optical powers, received over required.
    `margin_electrical_db` is twice that: the ratio of squared photocurrents. It equals the reserve
    in SNR only where the noise does not depend on the signal (thermal or background noise); where
    the shot noise of the signal dominates, the reserve in SNR is the optical figure.
    """

    transmitted_dbm: float
    gain_db: Floats
    tilt_db: Floats
    concentration_db: float
    filter_db: float
    received_dbm: Floats
    required_dbm: float
    margin_optical_db: Floats
    margin_electrical_db: Floats


def _db(ratio: ArrayLike) -> Floats:
    """Return 10 log10 of a ratio, -inf for 0."""
    with np.errstate(divide="ignore"):
        return 10.0 * np.log10(np.asarray(ratio, dtype=float))


@check_call
def link_budget(link: OokLink, gain: ArrayLike, ber: float, h_alpha: ArrayLike = 1.0) -> LinkBudget:
    """Compute the link budget in decibels.

    P_rx = P_Tx + G + h_alpha + eta_conc + T_filter,  margin = P_rx - P_req(ber)

    Parameters
    ----------
    link : OokLink
        Transmitter and receiver.
    gain : array_like
        Channel gain [1], any shape.
    ber : float
        Bit error rate that the link must not exceed, 0 < ber < 0.5; see `FEC_LIMITS`.
    h_alpha : array_like
        Tilt factor [1], broadcast against `gain`.

    Returns
    -------
    LinkBudget
        The terms of the sum; -inf where no light arrives. The margin is -inf too if no power
        reaches the bit error rate.

    Examples
    --------
    >>> budget = link_budget(OokLink(bit_rate=1e6), gain=6.4e-8, ber=1e-3)
    >>> print(f"{float(budget.margin_optical_db):.1f} dB optical")
    5.7 dB optical
    """
    g, tilt = _with_tilt(gain, h_alpha)
    required = link.required_power(ber)
    margin = _db(link.received_power(g * tilt) / required)
    optics, area = link.optics, link.sipm.area
    return LinkBudget(
        transmitted_dbm=float(_db(link.led.power / 1e-3)),
        gain_db=_db(g),
        tilt_db=_db(tilt),
        concentration_db=float(_db(optics.concentration_efficiency(area))),
        filter_db=float(_db(link.filter_share)),
        received_dbm=_db(link.received_power(g * tilt) / 1e-3),
        required_dbm=float(_db(required / 1e-3)),
        margin_optical_db=margin,
        margin_electrical_db=2.0 * margin,
    )


@check_call
def required_gain(link: OokLink, ber: float) -> float:
    """Return the channel gain that a link needs for a bit error rate; infinite if unattainable.

    Parameters
    ----------
    link : OokLink
        Transmitter and receiver.
    ber : float
        Bit error rate, 0 < ber < 0.5.
    """
    received = float(link.received_power(1.0))
    return link.required_power(ber) / received if received > 0.0 else math.inf


@check_call
def faded_gains(gain: ArrayLike, h_alpha: ArrayLike) -> Floats:
    """Return gains times tilt factors as a flat array (n,); refuse negative values."""
    g, h = _with_tilt(gain, h_alpha)
    return np.ravel(g * h)


def _with_tilt(gain: ArrayLike, h_alpha: ArrayLike) -> tuple[Floats, Floats]:
    """Return gains and tilt factors as arrays; refuse negatives and shapes that do not fit."""
    g, h = non_negative("gain", gain), non_negative("h_alpha", h_alpha)
    for name, values in (("gain", g), ("h_alpha", h)):
        if not values.size:
            raise Refused(name, Described(f"shape {values.shape}"), "one or more")
    try:
        np.broadcast_shapes(g.shape, h.shape)
    except ValueError as error:
        shapes = Described(f"shape {h.shape}")
        raise Refused("h_alpha", shapes, f"() or {g.shape}, as the gains") from error
    return g, h


@check_call
def ber_of_gains(link: OokLink, gain: Floats) -> Floats:
    """Return the bit error rate at each of many gains, by interpolation for long arrays.

    Parameters
    ----------
    link : OokLink
        Transmitter and receiver.
    gain : ndarray
        Gains [1], any shape.

    Returns
    -------
    ndarray
        Bit error rate, same shape.

    Notes
    -----
    For more than 512 gains, ln BER is interpolated over ln power (PCHIP): 256 nodes over the powers
    at which the rate differs from 0.5 keep its relative error below 1e-3.
    """
    from scipy.interpolate import PchipInterpolator

    power = link.received_power(gain)
    if power.size <= 2 * _TABLE_POINTS:
        return link.ber(power)
    # lower powers have a rate of 0.5 within 1e-4: nodes for them would be wasted
    floor = link.required_power(0.4999)
    high = float(power.max())
    if high <= floor:
        return np.full(power.shape, 0.5)
    clipped = np.maximum(power, floor)
    nodes = np.linspace(math.log(float(clipped.min())), math.log(high), _TABLE_POINTS)
    if nodes[0] == nodes[-1]:
        return np.full(power.shape, float(link.ber(high)))
    log_ber = np.log(np.maximum(link.ber(np.exp(nodes)), 1e-300))  # 0 where it underflows
    # monotone between the nodes, as the error rate is: a plain spline could overshoot
    table = PchipInterpolator(nodes, log_ber)
    ber = np.exp(table(np.clip(np.log(clipped), nodes[0], nodes[-1])))
    return np.where(power < floor, 0.5, ber)


@check_call
def average_ber(
    link: OokLink,
    gain: ArrayLike,
    h_alpha: ArrayLike = 1.0,
    *,
    n_effective: float | None = None,
    confidence: Probability = 0.95,
    resamples: Annotated[int, Field(ge=1, le=10**7)] = 1000,
    seed: Seed = 1,
) -> Estimate:
    """Average the bit error rate over fading, BER = E[BER(P h)].

    Parameters
    ----------
    link : OokLink
        Transmitter and receiver.
    gain : array_like
        Gains of the realizations or of a time series (n,) [1].
    h_alpha : array_like
        Tilt factor [1], broadcast against `gain`; zeros (line of sight outside of the field of
        view) count with a bit error rate of 0.5.
    n_effective : float, optional
        Number of independent gains, by default n; for a series see `fading.effective_samples`.
    confidence : float
        Level of the interval.
    resamples, seed : int
        Number and seed of the bootstrap replicates.

    Returns
    -------
    Estimate
        Average and its interval: percentile bootstrap, stretched in the logarithm by
        sqrt(n / n_effective).

    Raises
    ------
    Refused
        If a value is out of range.

    Notes
    -----
    The Monte Carlo noise of the gains acts like additional fading: remove it from the gains first
    (`fading.remove_noise`), or make it small against their spread.
    """
    g = faded_gains(gain, h_alpha)
    n = check_effective(n_effective, g.size)
    return bootstrapped_mean(ber_of_gains(link, g), n, confidence, resamples, seed)


def bootstrapped_mean(
    ber: Floats, n_effective: float, confidence: float, resamples: int, seed: int
) -> Estimate:
    """Return the mean of bit error rates with a percentile bootstrap of its logarithm.

    Parameters
    ----------
    ber : ndarray
        Bit error rates (n,).
    n_effective : float
        Number of independent ones; the interval is stretched by sqrt(n / n_effective).
    confidence : float
        Level of the interval.
    resamples, seed : int
        Number and seed of the replicates.
    """
    mean = float(ber.mean())
    if mean == 0.0:
        return Estimate(mean, 0.0, 0.0)
    # resampling of whole realizations: error rates span decades, and no normal law holds
    rng = np.random.default_rng(seed)
    # scipy.stats.bootstrap refuses a single value and a single replicate
    means = [ber[rng.integers(0, ber.size, ber.size)].mean() for _ in range(resamples)]
    limits = np.quantile(means, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence])
    # stretched in the logarithm, so that the lower limit stays above 0
    low, high = mean * (limits / mean) ** math.sqrt(ber.size / n_effective)
    # the percentiles of skewed replicates may lie on one side of the mean
    return Estimate(mean, float(min(low, mean)), float(max(high, mean)))


@check_call
def outage(
    link: OokLink,
    gain: ArrayLike,
    ber: float,
    h_alpha: ArrayLike = 1.0,
    *,
    n_effective: float | None = None,
    confidence: float = 0.95,
) -> Estimate:
    """Return the probability that the link misses a bit error rate, P(g h_alpha < g_req).

    Parameters
    ----------
    link : OokLink
        Transmitter and receiver.
    gain : array_like
        Gains (n,) [1], n >= 2.
    ber : float
        Bit error rate, 0 < ber < 0.5.
    h_alpha : array_like
        Tilt factor [1], broadcast against `gain`; its zeros count as outages, which happen with
        the probability P(alpha > fov / 2) of the tilt angle alpha.
    n_effective : float, optional
        Number of independent gains, by default n; for a series see `fading.effective_samples`.
    confidence : float
        Level of the interval.

    Returns
    -------
    Estimate
        Probability with its Wilson interval.
    """
    g = faded_gains(gain, h_alpha)
    # no gain opens a closed eye: the required gain is infinite, which `fading.outage` refuses
    threshold = min(required_gain(link, ber), float(np.finfo(float).max))
    return fading.outage(
        g, threshold, relative_to="absolute", n_effective=n_effective, confidence=confidence
    )


@check_call
def depth_at(depth: ArrayLike, value: ArrayLike, limit: Positive) -> float:
    """Return the largest depth at which a curve over depth crosses a limit.

    Monotone cubic (PCHIP) interpolation of ln(value) over depth.

    Parameters
    ----------
    depth : array_like
        Depths (n,) [m], strictly rising, n >= 2.
    value : array_like
        Gain, bit error rate or any other positive quantity at these depths (n,).
    limit : float
        Limit, > 0.

    Returns
    -------
    float
        Depth [m].

    Raises
    ------
    Refused
        If the arrays do not fit, a value is not positive, or the curve does not cross the limit.

    Examples
    --------
    >>> print(f"{depth_at([10.0, 20.0, 30.0], [1e-4, 1e-6, 1e-8], 1e-5):.3f}")
    15.000
    """
    from scipy.interpolate import PchipInterpolator

    rising = "two or more depths (n,), strictly rising"
    positive = "a finite value > 0 for each depth"
    d, v = require_array(depth, "depth", rising), require_array(value, "value", positive)
    if d.ndim != 1 or d.size < 2 or not np.all(np.isfinite(d)) or not np.all(np.diff(d) > 0.0):
        raise Refused("depth", depth, rising)
    if v.shape != d.shape or not np.all(np.isfinite(v) & (v > 0.0)):
        raise Refused("value", value, positive)
    curve = PchipInterpolator(d, np.log(v) - math.log(limit))
    crossings = curve.roots(discontinuity=False, extrapolate=False)
    # scipy returns a nan after the start of an interval in which the curve equals the limit
    crossings = crossings[np.isfinite(crossings)]
    if crossings.size == 0:
        between = f"as found between {d[0]:g} m and {d[-1]:g} m"
        raise Refused("limit", limit, f"{v.min():g} <= limit <= {v.max():g} {between}")
    return float(crossings.max())


@check_call
def range_at_ber(link: OokLink, depth: ArrayLike, gain: ArrayLike, ber: float) -> float:
    """Return the greatest depth at which a link without fading reaches a bit error rate.

    Parameters
    ----------
    link : OokLink
        Transmitter and receiver.
    depth : array_like
        Depths of the transmitter (n,) [m], strictly rising.
    gain : array_like
        Channel gain at these depths (n,) [1].
    ber : float
        Bit error rate, 0 < ber < 0.5; see `FEC_LIMITS`.

    Returns
    -------
    float
        Depth [m].

    Raises
    ------
    Refused
        If the table of depths does not contain the range.

    Notes
    -----
    With fading, compute the `average_ber` of the ensemble at each depth, and pass these values to
    `depth_at` with the bit error rate as the limit.
    """
    return depth_at(depth, gain, required_gain(link, ber))
