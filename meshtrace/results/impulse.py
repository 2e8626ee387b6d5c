"""Impulse response: distribution of the gain over delay."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused, require_between, require_finite, require_whole
from meshtrace.fields import attrs
from meshtrace.results.gain import GainResult
from meshtrace.stored import SHIFTS, Stored

if TYPE_CHECKING:
    import xarray as xr

_MOST_BINS = 10**7
SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum [m s-1] (exact)."""


_NUMBERS = (
    "first_arrival",
    "mean_delay",
    "mean_delay_stderr",
    "rms_delay_spread",
    "rms_delay_spread_stderr",
)


@dataclass(frozen=True, eq=False, repr=False)
class ImpulseResponse(Stored):
    """Impulse response of a channel, h(t) in gain per second.

    Attributes
    ----------
    edges : ndarray, shape (n + 1,)
        Edges of the delay bins [s]; 0 is the first arrival.
    h, h_stderr : ndarray, shape (n,)
        Gain per second in each bin, and its standard error.
    first_arrival : float
        Delay of the first light [s] from its emission.
    mean_delay, mean_delay_stderr : float
        Mean delay behind the first arrival [s].
    rms_delay_spread, rms_delay_spread_stderr : float
        Root of the variance of the delays [s].
    delay, weight : ndarray, shape (arrivals,)
        Delays behind the first arrival [s] and contributions to the gain.
    provenance : dict
        Versions, configuration and seeds of the run.
    """

    edges: NDArray[np.float64]
    h: NDArray[np.float64]
    h_stderr: NDArray[np.float64]
    first_arrival: float
    mean_delay: float
    mean_delay_stderr: float
    rms_delay_spread: float
    rms_delay_spread_stderr: float
    delay: NDArray[np.float64]
    weight: NDArray[np.float64]
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "impulse-response"
    title: ClassVar[str] = "meshtrace impulse response"

    def _headline(self) -> str:
        return f"rms delay spread {self.rms_delay_spread:.4g} s, {len(self.weight)} arrivals"

    def summary(self) -> str:
        """Return delays and their standard errors as text for a terminal."""
        return "\n".join(
            [
                f"impulse response of {len(self.weight):,} arrivals",
                f"  gain                 {self.weight.sum():.4e}",
                f"  first arrival        {self.first_arrival:.6g} s",
                f"  mean delay           {self.mean_delay:.4g} +- {self.mean_delay_stderr:.1g} s",
                f"  rms delay spread     {self.rms_delay_spread:.4g} +- "
                f"{self.rms_delay_spread_stderr:.1g} s",
            ]
        )

    def _content(self) -> xr.Dataset:
        import xarray as xr

        variables: dict[str, Any] = {
            "impulse_response": ("bin", self.h, attrs("impulse_response")),
            "impulse_response_stderr": ("bin", self.h_stderr, attrs("impulse_response_stderr")),
            "delay_edges": ("bin_edge", self.edges, attrs("delay_edges")),
            "arrival_delay": ("arrival", self.delay, attrs("delay")),
            "arrival_weight": ("arrival", self.weight, attrs("arrival_weight")),
            **{name: ((), getattr(self, name), attrs(name)) for name in _NUMBERS},
        }
        return xr.Dataset(variables)

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any) -> ImpulseResponse:
        return cls(
            edges=data["delay_edges"].to_numpy(),
            h=data["impulse_response"].to_numpy(),
            h_stderr=data["impulse_response_stderr"].to_numpy(),
            **{name: float(data[name]) for name in _NUMBERS},
            delay=data["arrival_delay"].to_numpy(),
            weight=data["arrival_weight"].to_numpy(),
            provenance=provenance,
        )

    def transfer_function(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return H(f) = sum w exp(-2 pi i f t) / sum w at frequencies [Hz]; H(0) = 1."""
        f = require_finite(frequency, "frequency", "finite frequencies [Hz]")
        out = np.empty(len(f), complex)
        for i, value in enumerate(f):
            out[i] = (self.weight * np.exp(-2j * np.pi * value * self.delay)).sum()
        return out / self.weight.sum()


def impulse_response(
    result: GainResult, bin_width: float = 1e-10, receiver: int = 0
) -> ImpulseResponse:
    """Return the impulse response from the arrivals of a run.

    t = (n_water L_water + n_air L_air) / c0 for each arrival.

    Parameters
    ----------
    result : GainResult
        Of `simulate(..., record=[Arrivals()])`, by either estimator.
    bin_width : float
        Width of the delay bins [s].
    receiver : int
        Index of the receiver.

    Returns
    -------
    ImpulseResponse

    Raises
    ------
    ValueError
        If the run kept no arrivals, or none came.

    Notes
    -----
    Standard errors come from 32 independent groups of arrivals (the shifts of the points, or
    photon ids modulo 32). The phase index stands for the group index, which is some 3 %
    larger in sea water; it is common to all arrivals.
    """
    arrivals = getattr(result, "arrivals", None)
    if arrivals is None:
        found = Described("no arrivals")
        raise Refused("result", found, "a result of simulate(..., record=[Arrivals()])")
    bin_width = require_between(bin_width, 0.0, math.inf, "bin_width")
    require_whole(receiver, 0, 2**31, "receiver")
    mine = arrivals.receiver == receiver
    if not mine.any():
        raise Refused("receiver", receiver, "a receiver where light arrived")
    link = result.provenance["link"]
    water, air = arrivals.water_path[mine], arrivals.air_path[mine]
    time = (link["water"]["n"] * water + link["n_air"] * air) / SPEED_OF_LIGHT
    weight, group = arrivals.weight[mine], arrivals.group[mine]
    first = float(time.min())
    delay = time - first
    longest = float(delay.max())
    if not longest / bin_width < _MOST_BINS:
        allowed = f"at most {_MOST_BINS} bins over {longest:.3g} s"
        raise Refused("bin_width", bin_width, allowed)
    n_bins = int(longest / bin_width) + 1
    edges = bin_width * np.arange(n_bins + 1, dtype=np.float64)
    bins = np.minimum((delay / bin_width).astype(int), n_bins - 1)
    by_group = np.zeros((SHIFTS, n_bins))
    moments = np.zeros((SHIFTS, 3))
    for g in range(SHIFTS):
        # parts without Monte Carlo error belong to every group; the others share the gain
        w = np.where(group < 0, weight, np.where(group == g, SHIFTS * weight, 0.0))
        by_group[g] = np.bincount(bins, w, n_bins)
        moments[g] = w.sum(), (w * delay).sum(), (w * delay**2).sum()
    total, jack = moments.mean(axis=0), _jackknife(moments)
    mean, spread = _delays(total)
    jack_mean, jack_spread = np.array([_delays(m) for m in jack]).T
    factor = (SHIFTS - 1) / np.sqrt(SHIFTS)
    return ImpulseResponse(
        edges=edges,
        h=by_group.mean(axis=0) / bin_width,
        h_stderr=by_group.std(axis=0, ddof=1) / np.sqrt(SHIFTS) / bin_width,
        first_arrival=first,
        mean_delay=mean,
        mean_delay_stderr=float(factor * jack_mean.std()),
        rms_delay_spread=spread,
        rms_delay_spread_stderr=float(factor * jack_spread.std()),
        delay=delay,
        weight=weight,
        provenance=result.provenance,
    )


def _jackknife(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the means of all groups but one."""
    n = len(moments)
    return (moments.sum(axis=0) - moments) / (n - 1)


def _delays(moments: NDArray[np.float64]) -> tuple[float, float]:
    """Return mean and root variance from sums of w, w t, w t^2."""
    mean = moments[1] / moments[0]
    return float(mean), float(np.sqrt(max(moments[2] / moments[0] - mean**2, 0.0)))
