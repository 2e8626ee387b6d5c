"""Runs of a link at values of uncertain inputs: mean gain, fading, and the gain it needs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np

from meshtrace.comms.background import with_background
from meshtrace.comms.budget import required_gain
from meshtrace.engine.setup.options import Arrivals, Meshing, StudyOptions
from meshtrace.engine.simulate import simulate
from meshtrace.errors import Described, Refused
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import SeededSurface
from meshtrace.models import Floats
from meshtrace.results.gain import GainResult
from meshtrace.scenario import Scenario
from meshtrace.scenario.files import Table, set_value
from meshtrace.studies.background import mean_sea, transmission_at
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.inputs import Axis, Input
from meshtrace.studies.keys import Bounds, checked_bounds
from meshtrace.studies.neighbours import depth_key, range_of
from meshtrace.studies.series import over_realizations

_MORE_CHAINS = 4  # of the mean gain, whose error counts for less than that of the fading
_NOISE_LEFT = 0.1  # of the variance of ln gain, at least what remains without its noise


def key_in_file(name: str) -> str:
    """Return the key as in a link file, where the spectrum of the water is part of [water]."""
    return name.replace("water.spectrum.", "water.")


def axes_of(inputs: list[Input], bounds: Bounds) -> list[Axis]:
    """Return the axes of the inputs, followed by the axis of the range, if any."""
    axes = [item.axis() for item in inputs]
    if len(bounds) > 1:
        raise Refused("bounds", list(bounds), "one key")
    for name, (low, high) in checked_bounds(bounds).items():
        if key_in_file(name) in (key_in_file(item.name) for item in inputs):
            raise Refused("bounds", name, "a key that is no input")
        axes.append(Axis(name, low, high, False))
    return axes


class StateRuns:
    """Runs of a link at values of its inputs.

    Parameters
    ----------
    config : dict
        The link as plain data, open to other values of the inputs.
    photons : int
        Chains over the seas of the fading.
    meshing : Meshing
        Time, resolution and waves of the surface.
    seed, realizations, threshold, limit
        As in `availability`.
    """

    def __init__(
        self, config: Table, photons: int, meshing: Meshing, seed: int, realizations: int,
        threshold: float | None, limit: float,
    ) -> None:  # fmt: skip
        self.config, self.photons, self.meshing = config, photons, meshing
        self.seed, self.realizations = seed, realizations
        self.threshold, self.limit = threshold, limit

    def closing_depth(self, link: Link, inputs: list[Input]) -> float:
        """Return the depth [m] at which median inputs close the link."""
        medians = {item.name: float(item.ppf(0.5)) for item in inputs}

        def reserve(depth: float) -> float:
            scenario = self.scenario(medians | {depth_key(link): depth})
            result = self._mean(scenario, self.seed, 1)
            return math.log(result.gain / (self.threshold or self._need(scenario, result)))

        return range_of(reserve, link)[0]

    def check(self, axes: list[Axis], values: list[float]) -> None:
        """Check the ends of each axis, with the values of a run on all others, before the work."""
        run = dict(zip((axis.name for axis in axes), values, strict=True))
        for axis in axes:
            for end in (axis.low, axis.high):
                self.scenario(run | {axis.name: end})

    def identity(self) -> dict[str, Any]:
        """Return the inputs of a run that identify its stored numbers."""
        # another threshold takes no new runs
        limit = self.limit if self.threshold is None else None
        return {"config": self.config, "limit": limit, "realizations": self.realizations}

    def scenario(self, values: Mapping[str, float]) -> Scenario:
        """Return the scenario at values of the inputs by key."""
        table = deepcopy(self.config)
        for name, value in values.items():
            set_value(table, key_in_file(name), value)
        return Scenario.from_config(table)

    def value(self, name: str) -> float:
        """Return the value of a key of the link; nan if it is not set."""
        item: Any = self.config
        for part in key_in_file(name).split("."):
            item = item.get(part, math.nan) if isinstance(item, Mapping) else math.nan
        return float(item)

    def measure(self, names: Sequence[str], step: tuple[Any, ...]) -> Floats:
        """Return mean gain, its error, variance of ln gain and, if asked for, the needed gain.

        A step is the number of the run and the values of the inputs of these names.
        """
        number, *values = step
        scenario = self.scenario(dict(zip(names, values, strict=True)))
        # each run has seas and chains of its own: common ones would bias all runs alike, unseen
        seed = realization_seed(self.seed, number)
        result = self._mean(scenario, seed, _MORE_CHAINS)
        need = math.nan if self.threshold else self._need(scenario, result)
        variance = 0.0
        if isinstance(scenario.surface, SeededSurface):
            run: StudyOptions = {
                "photons": self.photons, "mesh": self.meshing, "seed": seed, "threads": 1
            }  # fmt: skip
            variance = self._variance(campaign_of(scenario, None, "", run, fading=True))
        return np.array([result.gain, result.gain_stderr, variance, need])

    def _mean(self, scenario: Scenario, seed: int, more: int) -> GainResult:
        """Return the gain over a sea whose waves are random slopes."""
        sea = scenario.surface
        if isinstance(sea, SeededSurface):
            sea = mean_sea(scenario.link, sea.with_seed(seed))
        result = simulate(
            scenario.link, sea, photons=more * self.photons, seed=seed, threads=1,
            mesh=self.meshing.replace(waves=None),  # those of `mean_sea` stay
            record=[Arrivals()] if self.threshold is None else (),
        )  # fmt: skip
        if not result.gain > 0.0:
            raise Refused("inputs", Described("a dark link"), "links with light")
        return result

    def _need(self, scenario: Scenario, result: Any) -> float:
        """Return the gain that the transmission needs, under its background and response."""
        ook, sky = transmission_at(scenario, result, 0)
        need = required_gain(ook if sky is None else with_background(ook, sky), self.limit)
        if not math.isfinite(need):
            raise Refused("limit", self.limit, "a bit error rate that some power reaches")
        return need

    def _variance(self, campaign: Campaign) -> float:
        """Return the variance of ln gain over seas, less the sampling variance of chains."""
        series = over_realizations(campaign, self.realizations)
        logs = np.log(np.maximum(series.gain, 1e-300))
        total, n = float(logs.var(ddof=1)), len(logs)
        relative = series.gain_stderr / np.maximum(series.gain, 1e-300)
        of_all_seas = float(series.mean_stderr) / max(float(series.gain.mean()), 1e-300)
        # as in `GainSeries.fading`: the error that all seas have in common does not scatter them
        noise = max(float(np.mean(relative**2)) - of_all_seas**2, 0.0) * n / (n - 1)
        return max(total - noise, _NOISE_LEFT * total)
