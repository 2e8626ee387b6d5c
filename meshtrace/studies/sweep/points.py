"""The points and realizations of a sweep, and the numbers of each."""

from __future__ import annotations

import itertools
import json
import time
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.comms.background import DARK
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.fields import FIELDS, attrs
from meshtrace.kernels.random import realization_seed
from meshtrace.models import Floats, import_modules
from meshtrace.results.provenance import environment
from meshtrace.scenario import Scenario
from meshtrace.stored import FORMAT_VERSION
from meshtrace.studies.background import RAYS, checked_daylight, error_rate, transmission_of
from meshtrace.studies.cluster import error_text
from meshtrace.transport.backward import background

if TYPE_CHECKING:
    import xarray as xr

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
    def key(self) -> str:
        """Name of the task in a store."""
        return f"{self.point} {self.first}"

    @property
    def region(self) -> tuple[Any, ...]:
        """Place of the task in arrays (parameters..., realization)."""
        return (*self.point, slice(self.first, self.last))


def tasks_of(values: list[range], realizations: int) -> Iterator[Task]:
    """Yield the tasks of some numbers of values and realizations."""
    for point in itertools.product(*values):
        for first in range(0, realizations, BLOCK):
            yield Task(point, first, min(first + BLOCK, realizations))


class Outcome(NamedTuple):
    """Numbers of a task, by realization."""

    numbers: Floats  # (n, numbers * receivers + 1), of `Study.measured` and seconds
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
        return tasks_of([range(len(v)) for v in self.parameters.values()], self.realizations)

    def changes(self, task: Task) -> dict[str, Any]:
        """Return the values of the parameters at the point of a task."""
        rows = zip(self.parameters.items(), task.point, strict=True)
        return {name: values[i] for (name, values), i in rows}

    def compute(self, task: Task) -> Outcome:
        """Run the realizations of a task; a failed one has an error text and no numbers."""
        import_modules(self.modules)
        n = task.last - task.first
        found, error = np.full((n, len(self.measured) * self.receivers + 1), np.nan), [""] * n
        for i in range(n):
            start = time.perf_counter()
            try:
                found[i, :-1] = self._measure(task, task.first + i).ravel()
            except Exception as failure:
                error[i] = error_text(failure)
            found[i, -1] = time.perf_counter() - start
        return Outcome(found, error)

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

    def identity(self) -> dict[str, Any]:
        """Return the configuration that identifies this sweep, as plain data."""
        return {
            "realizations": self.realizations,
            "seed": self.seed,
            "rtol": self.rtol,
            "photons": self.photons,
            "parameters": self.parameters,
            "link": tomllib.loads(self.base),
            "measured": list(self.measured),
            "receivers": self.receivers,
            "listed": isinstance(self.scenario({}).link.receiver, tuple),
            "light": self.light if self.lit else "",
        }


def dataset(identity: dict[str, Any], outcomes: Mapping[Task, Outcome]) -> xr.Dataset:
    """Return the results of a sweep as a Dataset, nan where points are not finished."""
    import xarray as xr

    coordinates = {name: _labels(values) for name, values in identity["parameters"].items()}
    coordinates["realization"] = np.arange(identity["realizations"])
    dims, shape = tuple(coordinates), tuple(map(len, coordinates.values()))
    names, receivers = identity["measured"], identity["receivers"]
    numbers = np.full((*shape, len(names) * receivers + 1), np.nan)
    error = np.full(shape, "", object)
    for task, outcome in outcomes.items():
        numbers[task.region], error[task.region] = outcome
    measured = numbers[..., :-1].reshape(*shape, len(names), receivers)
    variables: dict[str, Any] = {
        "seconds": (dims, numbers[..., -1], {"units": "s"}),
        "error": (dims, error.astype(str)),
    }
    for i, name in enumerate(names):
        light = {"light": identity["light"]} if name == "ber" else {}
        whole = measured[..., i, :] if identity["listed"] else measured[..., i, 0]
        along = (*dims, "receiver") if identity["listed"] else dims
        variables[name] = (along, whole, {**attrs(name), **light})
    about = {key: attrs(key.rpartition(".")[2]) for key in dims if key.rpartition(".")[2] in FIELDS}
    labelled = {key: (key, values, about.get(key, {})) for key, values in coordinates.items()}
    origin = {
        "title": "meshtrace sweep",
        "format_version": FORMAT_VERSION,
        "kind": "sweep",
        "identity": json.dumps(identity),
        "environment": json.dumps(environment()),
    }
    return xr.Dataset(variables, labelled, origin)


def _labels(values: list[Any]) -> NDArray[Any]:
    """Return values as coordinates: numbers, or else text."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return np.array(values)
    return np.array([v if isinstance(v, str) else json.dumps(v) for v in values])


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
