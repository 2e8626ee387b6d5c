"""Impulse response: when the light arrives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.results.gain import SHIFTS, GainResult

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum [m s-1] (exact)."""


@dataclass(frozen=True, eq=False)
class ImpulseResponse:
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
        Delays behind the first arrival [s] and what each brings to the gain.
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

    def transfer_function(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return H(f) = sum w exp(-2 pi i f t) / sum w at frequencies [Hz]; H(0) = 1."""
        f = np.atleast_1d(np.asarray(frequency, dtype=float))
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
        Of `simulate(..., keep_arrivals=True)`, by either estimator.
    bin_width : float
        Width of the delay bins [s].
    receiver : int
        Which receiver.

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
    if "arrival_weight" not in result.data:
        raise ValueError("result: no arrivals, allowed simulate(..., keep_arrivals=True)")
    if not bin_width > 0.0:
        raise ValueError(f"bin_width: {bin_width!r}, allowed > 0 s")
    columns = {
        name: result.data[f"arrival_{name}"][1]
        for name in ("receiver", "weight", "water_path", "air_path", "group")
    }
    mine = columns["receiver"] == receiver
    if not mine.any():
        raise ValueError(f"receiver: {receiver}, no light arrived there")
    link = result.provenance["link"]
    time = (
        link["water"]["n"] * columns["water_path"][mine] + link["n_air"] * columns["air_path"][mine]
    ) / SPEED_OF_LIGHT
    weight, group = columns["weight"][mine], columns["group"][mine]
    first = float(time.min())
    delay = time - first
    n_bins = int(delay.max() / bin_width) + 1
    edges = bin_width * np.arange(n_bins + 1, dtype=np.float64)
    bins = np.minimum((delay / bin_width).astype(int), n_bins - 1)
    by_group = np.zeros((SHIFTS, n_bins))
    moments = np.zeros((SHIFTS, 3))
    for g in range(SHIFTS):
        # what has no Monte Carlo error belongs to every group; the others share the gain
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
    )


def _jackknife(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the means of all groups but one."""
    n = len(moments)
    return (moments.sum(axis=0) - moments) / (n - 1)


def _delays(moments: NDArray[np.float64]) -> tuple[float, float]:
    """Return mean and root variance from sums of w, w t, w t^2."""
    mean = moments[1] / moments[0]
    return float(mean), float(np.sqrt(max(moments[2] / moments[0] - mean**2, 0.0)))
