"""Realizations of a link: its gains over many seas, and the tilts that multiply each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.comms.matching import receiver_of
from meshtrace.fading import Estimate, effective_samples
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel
from meshtrace.studies.coupled import coupled_series
from meshtrace.studies.series import GainSeries, RandomSea, ensemble, time_series
from meshtrace.uav.airframe import Uav
from meshtrace.uav.tilt import h_alpha
from meshtrace.uav.wind import Dryden

FloatArray = NDArray[np.float64]

_TILTS = 50  # drawn for each realization of the sea


@dataclass(frozen=True, eq=False)
class Fades:
    """Gains of one link with the factors by which the tilt multiplies each.

    Attributes
    ----------
    series : GainSeries
        Gains over n seas.
    h_alpha : ndarray, shape (n, m)
        Tilt factors, m for each sea; ones without a UAV and where the gains contain the tilt.
    n_effective : float
        Number of independent samples.
    """

    series: GainSeries
    h_alpha: FloatArray
    n_effective: float

    @property
    def samples(self) -> FloatArray:
        """Gains times tilt factors (n, m)."""
        return self.series.gain[:, None] * self.h_alpha

    @property
    def chain_error(self) -> float:
        """Relative Monte Carlo error that all gains have in common."""
        return float(self.series.mean_stderr) / max(float(self.series.gain.mean()), 1e-300)

    def mean_gain(self, quantile: float) -> Estimate:
        """Mean gain with an interval of `quantile` standard errors of seas, tilts and chains."""
        gains = independent(self.samples)
        mean = float(gains.mean())
        spread = float(gains.std()) / math.sqrt(max(self.n_effective - 1.0, 1.0))
        reach = quantile * math.hypot(spread, mean * self.chain_error)
        return Estimate(mean, max(mean - reach, 0.0), mean + reach)


def independent(samples: FloatArray) -> FloatArray:
    """Return the mean over the tilts of each sea, or over one sea every tilt by itself."""
    return samples.mean(axis=1) if len(samples) > 1 else samples[0]


class Recipe(NamedTuple):
    """How the seas and the tilts of a link are drawn."""

    sea: SurfaceModel
    realizations: int
    flown: tuple[Uav, Dryden] | None
    coupled: bool
    time_step: float
    seed: int
    options: dict[str, Any]

    def fades(self, link: Link) -> Fades:
        """Return gains and tilt factors of a link."""
        if self.coupled and self.flown is not None:
            return self._coupled(link, *self.flown)
        n = self.realizations
        if isinstance(self.sea, RandomSea):
            series = ensemble(link, n, self.sea, seed=self.seed, **self.options)
        else:
            series = time_series(link, self.sea, [0.0], seed=self.seed, **self.options)
        seas = len(series.gain)
        if self.flown is None:
            return Fades(series, np.ones((seas, 1)), float(seas))
        uav, wind = self.flown
        tilts = _TILTS if seas > 1 else _TILTS * n
        winds = wind.sample_wind(seas * tilts, self.seed)
        fov = math.radians(receiver_of(link).fov_deg)
        factors = h_alpha(uav.tilt(winds).angle, fov).reshape(seas, tilts)
        return Fades(series, factors, float(seas if seas > 1 else tilts))

    def _coupled(self, link: Link, uav: Uav, wind: Dryden) -> Fades:
        times = self.time_step * np.arange(self.realizations)
        series = coupled_series(link, self.sea, times, uav, wind, self.seed, **self.options).series
        n = float(self.realizations)
        n = effective_samples(series.gain) if np.ptp(series.gain) > 0.0 else n
        return Fades(series, np.ones((len(times), 1)), n)
