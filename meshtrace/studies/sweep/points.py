"""The points and realizations of a sweep, and the numbers of each."""

from __future__ import annotations

import itertools
import time
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.comms.background import DARK
from meshtrace.errors import Described, Refused, one_line, require_whole
from meshtrace.kernels.jit import sources
from meshtrace.kernels.random import realization_seed
from meshtrace.models import import_modules
from meshtrace.scenario import Scenario
from meshtrace.studies.background import RAYS, checked_daylight, error_rate, transmission_of
from meshtrace.transport.backward import background

BLOCK = 8
"""Realizations of one task."""

MEASURED = ("gain", "gain_stderr", "gain_ballistic")
"""Numbers of a realization for each receiver."""

LIT = ("background_radiance", "background_radiance_stderr", "ber", "ber_stderr")
"""More of them under daylight."""


class Task(NamedTuple):
    """One point and a block of its realizations."""

    point: tuple[int, ...]  # which value of each parameter
    first: int
    last: int  # behind the last realization

    @property
    def region(self) -> tuple[Any, ...]:
        """Chunk of the task in arrays (parameters..., realization)."""
        return (*self.point, slice(self.first, self.last))


class Outcome(NamedTuple):
    """Numbers of a task, by realization."""

    measured: NDArray[np.float64]  # (numbers, n, receivers), see `Study.measured`
    seconds: NDArray[np.float64]
    error: list[str]


@dataclass(frozen=True)
class Study:
    """All inputs of a sweep."""

    base: str  # link file
    parameters: dict[str, list[Any]]
    realizations: int
    rtol: float | None
    photons: int | None
    seed: int
    modules: tuple[str, ...] = ()  # of the user's classes, which another process imports first

    def check(self) -> None:
        """Refuse options out of range and parameters without any allowed value."""
        require_whole(self.realizations, 1, 10**7, "realizations")
        require_whole(self.seed, 0, 2**64 - 1, "seed")
        base = self.scenario({})
        if self.lit:
            transmission_of(base.link.replace(receiver=base.link.receivers[0]), base.detector)
        if not self.parameters:
            raise Refused("parameters", Described("none"), "lists of values by dotted keys")
        for name, values in self.parameters.items():
            if not values:
                raise Refused(name, values, "at least one value")
            problems = [self._problem({name: value}) for value in values]
            if problems[0] is not None and all(problems):
                raise problems[0]

    def _problem(self, changes: dict[str, Any]) -> ValueError | None:
        try:
            self.scenario(changes)
        except ValueError as error:
            return error
        return None

    def scenario(self, changes: Mapping[str, Any]) -> Scenario:
        """Return the scenario of a point; its values override the options of the sweep."""
        options = {"run.photons": self.photons, "run.rtol": self.rtol}
        given = {key: value for key, value in options.items() if value is not None}
        return Scenario.from_toml(self.base, changes={**given, **changes})

    def tasks(self) -> Iterator[Task]:
        """Yield all tasks."""
        for point in itertools.product(*(range(len(v)) for v in self.parameters.values())):
            for first in range(0, self.realizations, BLOCK):
                yield Task(point, first, min(first + BLOCK, self.realizations))

    def changes(self, task: Task) -> dict[str, Any]:
        """Return the values of the parameters at the point of a task."""
        rows = zip(self.parameters.items(), task.point, strict=True)
        return {name: values[i] for (name, values), i in rows}

    def compute(self, task: Task) -> Outcome:
        """Run the realizations of a task; a failed one has an error text and no numbers."""
        import_modules(self.modules)
        n = task.last - task.first
        outcome = Outcome(
            np.full((len(self.measured), n, self.receivers), np.nan), np.zeros(n), [""] * n
        )
        for i in range(n):
            start = time.perf_counter()
            try:
                outcome.measured[:, i] = self._measure(task, task.first + i)
            except Exception as error:
                outcome.error[i] = error_text(error)
            outcome.seconds[i] = time.perf_counter() - start
        return outcome

    def _measure(self, task: Task, realization: int) -> NDArray[np.float64]:
        """Return the numbers of `measured`, each by receiver."""
        scenario = self.scenario(self.changes(task))
        surface, key = scenario.surface, self.seed
        if self.realizations > 1:
            phases, key = (realization_seed(self.seed, realization, word) for word in (0, 1))
            surface = surface.with_seed(phases) if hasattr(surface, "with_seed") else surface
        run = scenario.run.model_copy(update={"seed": key, "threads": 1})
        scenario = scenario.model_copy(update={"surface": surface, "run": run})
        result = scenario.simulate()
        rows = [getattr(result, name) for name in MEASURED]
        rows = [np.full(self.receivers, np.nan if row is None else row) for row in rows]
        if self.lit:
            rows += list(_under_daylight(scenario, rows[0], rows[1]))
        return np.stack(rows)

    @cached_property
    def lit(self) -> bool:
        """Whether points have background light and error rates."""
        tables = (name.partition(".")[0] for name in self.parameters)
        return "daylight" in tables or self.scenario({}).daylight is not None

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the numbers of a realization."""
        return MEASURED + LIT if self.lit else MEASURED

    @property
    def light(self) -> str:
        """Light of the bit error rates."""
        day = self.scenario({}).daylight
        swept = [name for name in self.parameters if name.partition(".")[0] == "daylight"]
        base = DARK if day is None else day.light
        return f"{base}; at each point by {', '.join(swept)}" if swept else base

    @cached_property
    def receivers(self) -> int:
        """Number of receivers of every point."""
        return len(self.scenario({}).link.receivers)

    @cached_property
    def listed(self) -> bool:
        """Return whether the receivers are a list, and a dimension of the result."""
        return isinstance(self.scenario({}).link.receiver, tuple)

    def identity(self) -> dict[str, Any]:
        """Return the configuration that identifies this sweep, as plain data."""
        options = {
            name: getattr(self, name) for name in ("realizations", "seed", "rtol", "photons")
        }
        return {
            "meshtrace": version("meshtrace"),  # another version may give other digits
            "kernels": sources().hex(),
            **options,
            "parameters": self.parameters,
            "link": tomllib.loads(self.base),
        }


def error_text(error: BaseException) -> str:
    """Return an error as one line."""
    text = one_line(error)
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"


def _under_daylight(
    scenario: Scenario, gain: NDArray[np.float64], stderr: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the numbers of `LIT` (4, receivers) at the gains of a scenario."""
    rows = []
    for receiver, h, error in zip(scenario.link.receivers, gain, stderr, strict=True):
        link = scenario.link.replace(receiver=receiver)
        ook, found = transmission_of(link, scenario.detector), None
        if checked_daylight(scenario.daylight, link) is not None:
            alone = scenario.model_copy(update={"link": link})
            found = background(alone, photons=RAYS, seed=scenario.run.seed, threads=1)
        light = (found.radiance, found.radiance_stderr) if found else (0.0, 0.0)
        rows.append([*light, *error_rate(ook, np.array([h]), float(error), found)])
    return np.array(rows).T
