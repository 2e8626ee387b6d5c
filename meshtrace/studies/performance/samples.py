"""Realizations of a link: its gains over many seas, and the tilts that multiply each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from meshtrace.errors import Refused
from meshtrace.fading import Estimate, effective_samples
from meshtrace.link import Link
from meshtrace.mesh import RandomSea
from meshtrace.models import Floats
from meshtrace.results.series import GainSeries
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.series import over_realizations, over_times
from meshtrace.uav.airframe import Flight
from meshtrace.uav.tilt import h_alpha

_TILTS = 50  # of each realization of the sea


@dataclass(frozen=True, eq=False)
class FadingSamples:
    """Gains of one link with the tilt factor of each.

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
    h_alpha: Floats
    n_effective: float

    @property
    def samples(self) -> Floats:
        """Gains times tilt factors (n, m)."""
        return self.series.gain[:, None] * self.h_alpha

    @property
    def chain_error(self) -> float:
        """Relative Monte Carlo error that all gains have in common."""
        return float(self.series.mean_stderr) / max(float(self.series.gain.mean()), 1e-300)

    def mean_gain(self, quantile: float) -> Estimate:
        """Return the mean gain with `quantile` standard errors of seas, tilts and chains."""
        gains = independent(self.samples)
        mean = float(gains.mean())
        spread = float(gains.std()) / math.sqrt(max(self.n_effective - 1.0, 1.0))
        reach = quantile * math.hypot(spread, mean * self.chain_error)
        return Estimate(mean, max(mean - reach, 0.0), mean + reach)


def independent(samples: Floats) -> Floats:
    """Return the mean over the tilts of each sea, or of each tilt over a single sea."""
    return samples.mean(axis=1) if len(samples) > 1 else samples[0]


class Realizations(NamedTuple):
    """Number of surfaces for the average of a link, and options of their chains.

    Options that are None are those of the scenario, or the defaults of `ensemble`.

    Attributes
    ----------
    n : int
        Independent seas, or times of a coupled flight, >= 2.
    seed : int, optional
        Seed of chains, phases, gusts and bootstrap.
    photons : int, optional
        Chains, common to all seas.
    spacing : float, optional
        Spacing of the mesh [m].
    """

    n: int = 200
    seed: int | None = None
    photons: int | None = None
    spacing: float | None = None


class Ensemble(NamedTuple):
    """Seas and tilts for the average of a link."""

    campaign: Campaign
    n: int
    flight: Flight | None
    progress: Callable[[int], None] | None

    def provenance(self) -> dict[str, Any]:
        """Return the aircraft, its wind and the number of realizations."""
        flight = self.flight
        return {
            **(self.campaign.of_flight(flight) if flight else {"uav": None, "wind": None}),
            "coupled": flight is not None and flight.coupled,
            "realizations": self.n,
        }

    def at(self, link: Link) -> Campaign:
        """Return the campaign of a link at its depth."""
        (base,) = self.campaign.links
        return self.campaign.of(link, f"{base} at {link.depth!r} m")

    def samples(self, link: Link) -> FadingSamples:
        """Return gains and tilt factors of a link."""
        campaign, flight = self.at(link), self.flight
        if flight is not None and flight.coupled:
            times = flight.time_step * np.arange(self.n, dtype=np.float64)
            series = over_times(campaign, times, flight, self.progress)
            n = effective_samples(series.gain) if np.ptp(series.gain) > 0.0 else float(self.n)
            return FadingSamples(series, np.ones((self.n, 1)), n)
        if isinstance(campaign.surface, RandomSea):
            series = over_realizations(campaign, self.n, self.progress)
        else:
            series = over_times(campaign, np.array([campaign.meshing.time]), None, self.progress)
        seas = len(series.gain)
        if flight is None:
            return FadingSamples(series, np.ones((seas, 1)), float(seas))
        if link.direction == "down":
            raise Refused("coupled", False, "True for an aircraft that tilts a lamp")
        tilts = _TILTS if seas > 1 else _TILTS * self.n
        winds = campaign.wind_of(flight).sample_wind(seas * tilts, campaign.run.seed)
        fov = math.radians(link.only_receiver.fov_deg)
        factors = h_alpha(flight.uav.tilt(winds).angle, fov).reshape(seas, tilts)
        return FadingSamples(series, factors, float(seas if seas > 1 else tilts))
