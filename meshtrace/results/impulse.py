"""Impulse response: distribution of the gain over delay."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace.checks import Positive, check_call
from meshtrace.errors import Described, Refused, require_finite
from meshtrace.models import Floats
from meshtrace.results.gain import GainResult
from meshtrace.results.tallies import SPEED_OF_LIGHT as SPEED_OF_LIGHT
from meshtrace.results.tallies import ArrivalTally, error_of_groups, sums_by_group
from meshtrace.stored import SHIFTS, Stored, Variable

# A single late photon may stretch the delays by any factor. The limit is memory: 1e7 bins by 32
# groups of 8 bytes are 2.6 GB.
_MOST_BINS = 10**7


@dataclass(frozen=True, eq=False, repr=False)
class ImpulseResponse(Stored, kind="impulse-response", title="meshtrace impulse response"):
    """Impulse response h(t) of a channel: gain per second of delay.

    Attributes
    ----------
    edges : ndarray, shape (n + 1,)
        Edges of the delay bins [s]; 0 is the first arrival.
    h, h_stderr : ndarray, shape (n,)
        Gain per second in each bin, and its standard error.
    first_arrival : float
        Time from emission to the first arrival [s].
    mean_delay, mean_delay_stderr : float
        Mean delay after the first arrival, weighted by gain, and its standard error [s].
    rms_delay_spread, rms_delay_spread_stderr : float
        Standard deviation of the delays, weighted by gain, and its standard error [s].
    delay, weight, angle : ndarray, shape (arrivals,)
        Delays after the first arrival [s], contributions to the gain [1], and angles to the axis
        of the receiver [rad], nan where they are not recorded.
    provenance : dict
        Versions, configuration and seeds of the run.
    """

    edges: Annotated[Floats, Variable("bin_edge", name="delay_edges")]
    h: Annotated[Floats, Variable("bin", name="impulse_response")]
    h_stderr: Annotated[Floats, Variable("bin", name="impulse_response_stderr")]
    first_arrival: Annotated[float, Variable()]
    mean_delay: Annotated[float, Variable()]
    mean_delay_stderr: Annotated[float, Variable()]
    rms_delay_spread: Annotated[float, Variable()]
    rms_delay_spread_stderr: Annotated[float, Variable()]
    delay: Annotated[Floats, Variable("arrival", name="arrival_delay")]
    weight: Annotated[Floats, Variable("arrival", name="arrival_weight")]
    angle: Annotated[Floats, Variable("arrival", name="arrival_angle")]
    provenance: dict[str, Any] = field(default_factory=dict)

    def _headline(self) -> str:
        spread = f"rms delay spread {self.rms_delay_spread:.4g} s"
        return f"impulse response of {len(self.weight):,} arrivals, {spread}"

    def transfer_function(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return H(f) = sum w exp(-2 pi i f t) / sum w at frequencies [Hz]; H(0) = 1."""
        sums = [
            (self.weight * np.exp(-2j * np.pi * f * self.delay)).sum()
            for f in require_finite(frequency, "frequency", "finite frequencies [Hz]")
        ]
        return np.array(sums, complex) / self.weight.sum()


@check_call
def impulse_response(
    result: GainResult,
    bin_width: Positive = 1e-10,
    receiver: Annotated[int, Field(ge=0, le=2**31)] = 0,
) -> ImpulseResponse:
    """Return the impulse response from the arrivals of a run.

    t = (n_water L_water + n_air L_air) / c0 for each arrival.

    Parameters
    ----------
    result : GainResult
        Result of `simulate(..., record=[Arrivals()])` with either estimator.
    bin_width : float
        Width of the delay bins [s].
    receiver : int
        Index of the receiver.

    Returns
    -------
    ImpulseResponse

    Raises
    ------
    Refused
        If the run recorded no arrivals, no light arrived at the receiver, or the delays span too
        many bins.

    Notes
    -----
    Standard errors come from 32 independent groups of arrivals (random shifts of the quasi-random
    points of chains, or photon ids modulo 32). The refractive indices n are those of the phase
    velocity, the same for all arrivals; the group index of sea water, which pulses follow, is some
    3 % larger.
    """
    arrivals = getattr(result, "arrivals", None)
    if arrivals is None:
        raise Refused(
            "result", Described("no arrivals"), "a result of simulate(..., record=[Arrivals()])"
        )
    return response_of(arrivals, bin_width, receiver, result.provenance)


def response_of(
    arrivals: ArrivalTally,
    bin_width: float = 1e-10,
    receiver: int = 0,
    provenance: dict[str, Any] | None = None,
) -> ImpulseResponse:
    """Return the impulse response from the arrivals at one receiver; see `impulse_response`."""
    chosen = arrivals.receiver == receiver
    if not chosen.any():
        raise Refused("receiver", receiver, "a receiver where light arrived")
    time, angle = arrivals.time[chosen], arrivals.angle[chosen]
    weight, group = arrivals.weight[chosen], arrivals.group[chosen]
    first = float(time.min())
    delay = time - first
    longest = float(delay.max())
    # written so that a quotient that overflows to inf, or is nan, is refused, too
    if not longest / bin_width < _MOST_BINS:
        allowed = f"at most {_MOST_BINS} bins over {longest:.3g} s"
        raise Refused("bin_width", bin_width, allowed)
    bins = (delay / bin_width).astype(int)
    by_group = sums_by_group(group, weight, bins, int(bins.max()) + 1)
    # sums of w, w t and w t^2 by group, shape (SHIFTS, 3)
    moments = np.stack([sums_by_group(group, weight * delay**k)[:, 0] for k in range(3)], axis=1)
    mean, spread = _delays(moments.mean(axis=0))
    # mean and spread are ratios of sums: their errors come from the jackknife, which leaves out one
    # group at a time
    others = (moments.sum(axis=0) - moments) / (SHIFTS - 1)
    # s^2 = (n - 1) / n sum (x_i - mean)^2 = (n - 1) var (Efron and Stein 1981, eq. 1.4), with var
    # the mean square about the mean, as of `std`
    factor = np.sqrt(SHIFTS - 1)
    errors = [float(factor * v.std()) for v in np.array([_delays(m) for m in others]).T]
    return ImpulseResponse(
        edges=bin_width * np.arange(by_group.shape[1] + 1, dtype=np.float64),
        h=by_group.mean(axis=0) / bin_width,
        h_stderr=error_of_groups(by_group) / bin_width,
        first_arrival=first,
        mean_delay=mean,
        mean_delay_stderr=errors[0],
        rms_delay_spread=spread,
        rms_delay_spread_stderr=errors[1],
        delay=delay,
        weight=weight,
        angle=angle,
        provenance=provenance or {},
    )


def _delays(moments: Floats) -> tuple[float, float]:
    """Return the weighted mean and standard deviation [s] from sums of w, w t, w t^2."""
    mean = moments[1] / moments[0]
    # rounding may turn the variance of equal delays negative
    return float(mean), float(np.sqrt(max(moments[2] / moments[0] - mean**2, 0.0)))
