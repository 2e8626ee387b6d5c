"""Sweeps over parameters and realizations on dask.distributed.

A task is one point of the sweep and a block of its realizations. Its random numbers belong to
(seed, realization), so that results are the same bits for any number of workers. Only the
process that called `sweep` writes: a finished task is a line of the store, and is never computed
again.
"""

from __future__ import annotations

import itertools
import json
import math
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.checks import check_call
from meshtrace.comms.background import DARK
from meshtrace.engine.setup.options import Arrivals
from meshtrace.engine.simulate import simulate
from meshtrace.errors import (
    MISSING,
    Described,
    Refused,
    refusing,
    require_keys,
    require_seed,
    require_whole,
)
from meshtrace.fields import FIELDS, attrs
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource
from meshtrace.models import import_modules, modules_of, trusting
from meshtrace.results.gain import GainResult
from meshtrace.results.provenance import environment
from meshtrace.results.series import checked_wavelengths
from meshtrace.scenario import Scenario
from meshtrace.scenario.files import parse_toml, read_text
from meshtrace.stored import FORMAT_VERSION
from meshtrace.studies.background import error_rate, transmission_at, transmission_of
from meshtrace.studies.base import OPTIONS_OF_SWEEP, base_scenario, plain_base
from meshtrace.studies.campaign import finished
from meshtrace.studies.cluster import DEFAULT_TIMEOUT, Cluster, error_text
from meshtrace.studies.store import Item, Store

if TYPE_CHECKING:
    import xarray as xr

# A task is what a worker takes and what the store keeps: with more realizations a call that is
# stopped loses more work, with fewer each has more of the overhead of a message and a line.
BLOCK = 8
"""Realizations of one task."""

MEASURED = ("gain", "gain_stderr", "gain_ballistic")
"""Names of the numbers of a realization for each receiver, attributes of a `GainResult`."""

_MEASURED_IN_DAYLIGHT = ("background_radiance", "background_radiance_stderr", "ber", "ber_stderr")
"""Names of the numbers that daylight adds to `MEASURED`."""


class Task(NamedTuple):
    """One point of a sweep and a block of its realizations.

    Attributes
    ----------
    point : tuple of int
        Index of the value of each parameter.
    first, last : int
        Realizations first, first + 1, ..., last - 1.
    """

    point: tuple[int, ...]
    first: int
    last: int

    def __str__(self) -> str:
        """Return the name of the task in a store: its point and its first realization."""
        return f"{self.point} {self.first}"

    @property
    def region(self) -> tuple[Any, ...]:
        """Place of the task in arrays (parameters..., realization)."""
        return (*self.point, slice(self.first, self.last))


def tasks_of(parameters: Mapping[str, list[Any]], realizations: int) -> Iterator[Task]:
    """Yield the tasks of all combinations of values, and realizations."""
    for point in itertools.product(*(range(len(values)) for values in parameters.values())):
        for first in range(0, realizations, BLOCK):
            yield Task(point, first, min(first + BLOCK, realizations))


@dataclass(frozen=True)
class Sweep:
    """All inputs of a sweep.

    Attributes
    ----------
    base : str
        Text (TOML) of the link file that all points share.
    parameters : dict of str to list
        Values of each parameter by its dotted key.
    realizations, rtol, photons, seed
        As in `sweep`.
    wavelengths_nm : tuple of float
        Wavelengths [nm]; empty for that of the sources.
    modules : tuple of str
        Modules of classes of the user, which a worker imports before it reads `base`.
    """

    base: str
    parameters: dict[str, list[Any]]
    realizations: int = 1
    rtol: float | None = 0.01
    photons: int | None = None
    seed: int = 1
    wavelengths_nm: tuple[float, ...] = ()
    modules: tuple[str, ...] = ()

    def check(self) -> None:
        """Refuse options out of range and parameters without any allowed value."""
        require_whole(self.realizations, 1, 10**7, "realizations")
        require_seed(self.seed)
        base = self.scenario({})
        for name in self.parameters:
            if self.wavelengths_nm and name.endswith("wavelength_nm"):
                allowed = "no wavelength among the parameters, or no wavelengths_nm"
                raise Refused("parameters", name, allowed)
        # The results of both calls are dropped: an error of all points is to be raised at once, and
        # not to be recorded at each of them.
        self._at_wavelengths(base)
        if self.in_daylight:
            transmission_of(base.link.replace(receiver=base.link.receivers[0]), base.detector)
        if not self.parameters:
            raise Refused("parameters", Described("none"), "lists of values by dotted keys")
        for name, values in self.parameters.items():
            if not values:
                raise Refused(name, values, "at least one value")
            problems = []
            for value in values:
                try:
                    self.scenario({name: value})
                except ValueError as error:
                    problems.append(error)
            # a single value that is refused makes its points fail, and the sweep goes on
            if len(problems) == len(values):
                raise problems[0]

    def scenario(self, changes: Mapping[str, Any]) -> Scenario:
        """Return the scenario of a point; its values override the options of the sweep."""
        options = {"run.photons": self.photons, "run.rtol": self.rtol}
        chosen = {key: value for key, value in options.items() if value is not None}
        return Scenario.from_toml(self.base, changes=chosen | dict(changes))

    def tasks(self) -> Iterator[Task]:
        """Yield all tasks."""
        return tasks_of(self.parameters, self.realizations)

    def changes(self, task: Task) -> dict[str, Any]:
        """Return the values of the parameters at the point of a task."""
        pairs = zip(self.parameters.items(), task.point, strict=True)
        return {name: values[i] for (name, values), i in pairs}

    def compute(self, task: Task) -> Item:
        """Run the realizations of a task; a failed one has an error text and no numbers.

        Returns
        -------
        tuple of ndarray and str
            Numbers, shape (realizations, measured * wavelengths * receivers + 1): those of
            `measured`, each by wavelength and receiver, and last the seconds of the realization.
            The text is the JSON list of the errors of the realizations, empty where they went well.
        """
        # classes of the user register themselves when their module is imported
        import_modules(self.modules)
        n, per_wavelength = task.last - task.first, len(self.measured) * self.receivers
        # one number more: the seconds
        table = np.full((n, per_wavelength * max(len(self.wavelengths_nm), 1) + 1), np.nan)
        error_texts = [""] * n
        for i in range(n):
            start = time.perf_counter()
            try:
                table[i, :-1] = self._measure(task, task.first + i).ravel()
            # a point that cannot be computed is a result, too: the sweep goes on
            except Exception as failure:
                error_texts[i] = error_text(failure)
            table[i, -1] = time.perf_counter() - start
        return table, json.dumps(error_texts)

    def _measure(self, task: Task, realization: int) -> NDArray[np.float64]:
        """Return the numbers of a realization, shape (measured, wavelengths, receivers)."""
        scenario = self.scenario(self.changes(task))
        surface, seed = scenario.surface, self.seed
        if self.realizations > 1:
            # waves (word 0) and chains (word 1) of a realization are independent
            phases, seed = (realization_seed(self.seed, realization, word) for word in (0, 1))
            # a surface without phases is the same in each realization, its chains are not
            surface = surface.with_seed(phases) if hasattr(surface, "with_seed") else surface
        # tasks already run side by side: each on one thread
        run = scenario.run.model_copy(update={"seed": seed, "threads": 1})
        scenario = scenario.model_copy(update={"surface": surface, "run": run})
        # error rates need the response of the channel
        record = [Arrivals()] if self.in_daylight else ()
        if not self.wavelengths_nm:
            return self._numbers(scenario, simulate(scenario, record=record))[:, None]
        results = simulate(scenario, wavelengths_nm=self.wavelengths_nm, record=record)
        pairs = zip(self._at_wavelengths(scenario), results.results, strict=True)
        return np.stack([self._numbers(*pair) for pair in pairs], axis=1)

    def _at_wavelengths(self, scenario: Scenario) -> list[Scenario]:
        """Return a scenario at each of the wavelengths, none without `wavelengths_nm`."""
        return [scenario.at_wavelength(nm) for nm in self.wavelengths_nm]

    def _numbers(self, scenario: Scenario, result: GainResult) -> NDArray[np.float64]:
        """Return the numbers of `measured` of a result, shape (measured, receivers)."""
        values = [getattr(result, name) for name in MEASURED]
        # analog photons do not separate the ballistic part, which is then None; a link of a single
        # receiver has scalars
        measured = [np.full(self.receivers, np.nan if value is None else value) for value in values]
        if self.in_daylight:
            measured += list(_under_daylight(scenario, result))
        return np.stack(measured)

    @cached_property
    def in_daylight(self) -> bool:
        """Whether points have background light and error rates."""
        tables = (name.partition(".")[0] for name in self.parameters)
        return "daylight" in tables or self.scenario({}).daylight is not None

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the numbers of a realization."""
        return MEASURED + _MEASURED_IN_DAYLIGHT if self.in_daylight else MEASURED

    @property
    def light_text(self) -> str:
        """Description of the light under which the bit error rates hold."""
        day = self.scenario({}).daylight
        swept = [name for name in self.parameters if name.partition(".")[0] == "daylight"]
        base = DARK if day is None else day.light
        return f"{base}; at each point by {', '.join(swept)}" if swept else base

    @cached_property
    def receivers(self) -> int:
        """Number of receivers of every point."""
        return len(self.scenario({}).link.receivers)

    def run(
        self,
        store: str | Path | None,
        workers: int | str | None = None,
        timeout: float = DEFAULT_TIMEOUT,
        progress: Callable[[int], None] | None = None,
    ) -> xr.Dataset:
        """Compute the results, or read them from the store; options are as in `sweep`."""
        cluster = Cluster(workers, timeout)
        identity, items = self.identity(), dict[Task, Item]()
        shape, tasks = partial(_shape_of, identity), list(self.tasks())
        with (
            Store(store, "sweep").loop("sweep", identity) as stored,
            closing(
                # nothing to set up on a worker: the sweep holds all inputs
                finished(stored, cluster.map, lambda: self.compute, tasks, shape, "points")
            ) as results,
        ):
            for task, item in results:
                if isinstance(item, Exception):
                    # the worker may have failed, and not the point: such an item is not stored.
                    # `dataset` broadcasts the one nan of a realization to all its numbers
                    n = task.last - task.first
                    item = np.full((n, 1), np.nan), json.dumps([error_text(item)] * n)
                items[task] = item
                if progress is not None:
                    progress(1)
        # a store that passed all checks may still hold texts that are not JSON
        with refusing("store", "items of this sweep, or a new path"):
            return dataset(identity, items)

    def identity(self) -> dict[str, Any]:
        """Return the configuration that identifies this sweep, as plain data."""
        fields = asdict(self)
        # parsed, so that the form of the text does not matter; modules follow from their names in
        # the link and the parameters
        del fields["base"], fields["modules"]
        return fields | {
            "link": tomllib.loads(self.base),
            "measured": list(self.measured),
            "receivers": self.receivers,
            # whether the receivers are a list, perhaps of one, and results have their dimension
            "listed": isinstance(self.scenario({}).link.receiver, tuple),
            "light": self.light_text if self.in_daylight else "",
        }


def _sizes(identity: dict[str, Any]) -> tuple[int, int, int]:
    """Return the shape of a realization: quantities, wavelengths, receivers."""
    wavelengths = max(len(identity["wavelengths_nm"]), 1)
    return len(identity["measured"]), wavelengths, identity["receivers"]


def dataset(identity: dict[str, Any], items: Mapping[Task, Item]) -> xr.Dataset:
    """Return the results of a sweep as a Dataset, nan where points are not finished."""
    import xarray as xr

    coordinates = {name: _labels(values) for name, values in identity["parameters"].items()}
    coordinates["realization"] = np.arange(identity["realizations"])
    dims, shape = tuple(coordinates), tuple(map(len, coordinates.values()))
    names, wavelengths = identity["measured"], identity["wavelengths_nm"]
    sizes = _sizes(identity)
    # the last number of a realization is its seconds
    numbers = np.full((*shape, math.prod(sizes) + 1), np.nan)  # (parameters..., realization, k)
    error = np.full(shape, "", object)
    for task, (numbers_of_task, texts) in items.items():
        numbers[task.region], error[task.region] = numbers_of_task, json.loads(texts)
    measured = numbers[..., :-1].reshape(*shape, *sizes)
    variables: dict[str, Any] = {
        "seconds": (dims, numbers[..., -1], {"units": "s"}),
        "error": (dims, error.astype(str)),
    }
    # a dimension that the user did not ask for has the size 1, and is dropped
    asked = bool(wavelengths), identity["listed"]
    selection = tuple(slice(None) if keep else 0 for keep in asked)
    measured_dims = (*dims, *itertools.compress(("wavelength", "receiver"), asked))
    for i, name in enumerate(names):
        light_attrs = {"light": identity["light"]} if name == "ber" else {}
        variables[name] = measured_dims, measured[(..., i, *selection)], attrs(name) | light_attrs
    # units and long names by the last part of a key, "depth" of "transmitter.depth", where
    # `fields.toml` has it
    known = {key: attrs(key.rpartition(".")[2]) for key in dims if key.rpartition(".")[2] in FIELDS}
    labelled = {key: (key, values, known.get(key, {})) for key, values in coordinates.items()}
    if wavelengths:
        labelled["wavelength_nm"] = ("wavelength", np.array(wavelengths), attrs("wavelength_nm"))
    attributes = {
        "title": "meshtrace sweep",
        "format_version": FORMAT_VERSION,
        "kind": "sweep",
        "identity": json.dumps(identity),
        "environment": json.dumps(environment()),
    }
    return xr.Dataset(variables, labelled, attributes)


def _labels(values: list[Any]) -> NDArray[Any]:
    """Return values as the labels of a coordinate: numbers, or else text."""
    # bool is a subclass of int in Python, and shall not become 0 and 1
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return np.array(values)
    return np.array([v if isinstance(v, str) else json.dumps(v) for v in values])


def _under_daylight(scenario: Scenario, result: GainResult) -> NDArray[np.float64]:
    """Return the numbers that daylight adds, at the gains of a result, shape (4, receivers)."""
    results = []
    numbers = zip(result.gains, result.stderrs, strict=True)
    for i, (gain, error) in enumerate(numbers):
        ook, sky = transmission_at(scenario, result, i)
        radiance = (sky.radiance, sky.radiance_stderr) if sky else (0.0, 0.0)
        results.append([*radiance, *error_rate(ook, np.array([gain]), float(error), sky)])
    return np.array(results).T


@check_call
def sweep(
    link: Link | Scenario | Mapping[str, Any],
    parameters: Mapping[str, Sequence[Any]],
    *,
    surface: MeshSource | Mapping[str, Any] | None = None,
    realizations: int = 1,
    rtol: float | None = 0.01,
    photons: int | None = None,
    seed: int = 1,
    wavelengths_nm: ArrayLike | None = None,
    store: str | Path | None = None,
    workers: int | str | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    progress: Callable[[int], None] | None = None,
) -> xr.Dataset:
    """Compute the gain at every combination of parameter values in parallel.

    With daylight in the link file, or swept, the background light and the bit error rate too.

    Parameters
    ----------
    link : Link, Scenario or mapping
        Common part of all points: a link, a scenario, or the plain data of a link file. Options of
        its run that are arguments here are left out.
    parameters : mapping of str to sequence
        Values of each parameter, by its dotted key in a link file: "wind_speed",
        "transmitter.depth", "water.b", "sea.omega_max", "daylight.sun_zenith_deg", ...
    surface : SurfaceModel or mapping, optional
        The sea, or the [sea] table of a link file, in place of that of `link`; a `Link` alone
        goes with the default sea, which follows `wind_speed`.
    realizations : int
        Surfaces of each point. A single one keeps the phases of the sea; realization i of several
        has those of `numpy.random.SeedSequence([seed, i])`, as in `ensemble`.
    rtol : float, optional
        Relative standard error to reach in every gain; None for a fixed `photons`.
    photons : int, optional
        Chains (forced) or photons (analog) of every gain, with `rtol` the first guess.
    seed : int
        Key of the random numbers, 0 <= seed < 2^64. Points share them.
    wavelengths_nm : array_like, optional
        Wavelengths [nm], in place of that of the sources, with the gains of common paths at each
        point (see `simulate`) and the light of the same model.
    store : path, optional
        File that keeps finished points; of a study file by default beside it. A second call with
        the same arguments and version resumes the first, however it was stopped.
    workers : int or str, optional
        Processes, or the address or file of a running dask scheduler: 1 for this process alone, by
        default all cores, where points take longer than the start of processes. The result does
        not depend on them.
    timeout : float
        Seconds to wait for the scheduler, and for a worker.
    progress : callable, optional
        Called with 1 after each task.

    Returns
    -------
    xarray.Dataset
        Dimensions are the parameters in their order and "realization" ("wavelength" for several
        wavelengths, "receiver" for a link with a list of receivers); variables gain, gain_stderr,
        gain_ballistic, seconds and error, the text of a failure or empty; under daylight also
        background_radiance and ber, with their standard errors. The attribute `light` of ber names
        the light. The response of the channel spreads its pulses, see `link_performance`.

    Raises
    ------
    Refused
        If an option is out of range or no value of a parameter is allowed; the store holds another
        sweep or is in use; the scheduler is lost, has no worker, or has one that would compute
        other numbers.
    ModuleNotFoundError
        If dask and distributed are not installed, which `workers` other than 1 need.

    Notes
    -----
    A point that fails is recorded and not tried again. One whose worker died again and again is
    recorded too, and tried again by the next call; so is a point whose line in the store is
    damaged, with a warning.

    The bit error rate is that of the receiver of the link file ("physical" without one), at rest
    and at the gain of each realization; its mean over the realizations is the average BER. A swept
    key such as "daylight.sun_zenith_deg" moves the sun: direct and diffuse irradiance follow,
    unless a link file or its plain data give them.

    The cluster on this machine starts new Python processes: in a script call `sweep` under
    `if __name__ == "__main__":`.
    """
    daylight_table = link.get("daylight") if isinstance(link, Mapping) else None
    options: dict[str, Any] = {"rtol": rtol, "photons": photons, "seed": seed}
    options |= {"realizations": realizations, "wavelengths_nm": wavelengths_nm}
    study = _study(base_scenario(link, surface), daylight_table, parameters, options)
    return study.run(store, workers, timeout, progress)


def _study(
    base: Scenario,
    daylight_table: Any,
    parameters: Mapping[str, Sequence[Any]],
    options: dict[str, Any],
) -> Sweep:
    """Return the checked sweep, with options as in `sweep`.

    `daylight_table` is the table [daylight] as the user wrote it, None if there is only a model.
    """
    import tomli_w

    plain = {name: _plain(values) for name, values in parameters.items()}
    config = plain_base(base, plain, daylight_table)
    # text, not objects: a worker reads it once it has imported the modules of the user's classes
    text = tomli_w.dumps(config)
    nm = options.get("wavelengths_nm")
    options = options | {"wavelengths_nm": () if nm is None else tuple(checked_wavelengths(nm))}
    study = Sweep(text, plain, **options)
    study.check()
    return replace(study, modules=tuple(modules_of(f"{text}{plain}")))


def read_store(path: Path) -> xr.Dataset:
    """Read the results in the store of a sweep, nan where points are not finished.

    Raises
    ------
    Refused
        If it is no store of a sweep.
    """
    store = Store(path)
    store.read()
    if "sweep" not in store.identities:
        other = Described(f"{str(path)!r} is not that of a sweep")
        raise Refused("store", other, "one, or a new path")
    items, identity = store.items("sweep"), store.identities["sweep"]
    with refusing("store", "the items of a sweep"):
        tasks = tasks_of(identity["parameters"], identity["realizations"])
        # a store of another program may have items of any shape
        of_shape = partial(_shape_of, identity)
        known = {task: items.of_shape(task, of_shape(task)) for task in tasks if task in items}
        return dataset(identity, known)


def _shape_of(identity: dict[str, Any], task: Task) -> tuple[int, int]:
    """Return the shape of the numbers of a task: realizations by numbers, seconds included."""
    return task.last - task.first, math.prod(_sizes(identity)) + 1


@check_call
def sweep_file(
    path: str | Path,
    *,
    store: str | Path | None = None,
    trust: bool = False,
    workers: int | str | None = None,
    timeout: float = DEFAULT_TIMEOUT,
    progress: Callable[[int], None] | None = None,
) -> xr.Dataset:
    """Run the sweep of a study file: a link file with a table [sweep].

    Parameters
    ----------
    path : path
        TOML file, see `read_study`.
    store, trust
        As in `read_study`.
    workers, timeout, progress
        As in `sweep`.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    Refused
        If the file cannot be read or a value is not allowed.

    Examples
    --------
    A study file::

        [receiver]
        radius = 0.1

        [sweep]
        realizations = 16

        [sweep.parameters]
        wind_speed = [5.0, 13.0]
        transmitter.depth = [5.0, 10.0, 20.0]
    """
    study, store = read_study(path, store, trust)
    return study.run(store, workers, timeout, progress)


@check_call
def read_study(
    path: str | Path, store: str | Path | None = None, trust: bool = False
) -> tuple[Sweep, Path]:
    """Read the sweep of a study file and the path of its store.

    Parameters
    ----------
    path : path
        TOML file. [sweep] takes realizations, rtol, photons, seed, wavelengths_nm and store, as in
        `sweep` (rtol, photons and seed may stand in [run] too); [sweep.parameters] the lists of
        values by their dotted keys.
    store : path, optional
        By default that in the file, which lies beside it, or else the name of the file with the
        ending .store.
    trust : bool
        Run the modules that the file names by import paths, see `Scenario.load`.

    Raises
    ------
    Refused
        If the file cannot be read or a value is not allowed.
    """
    path = Path(path)
    text = read_text(path)
    try:
        config = parse_toml(text)
        table = config.pop("sweep", MISSING)
        if not isinstance(table, dict):
            raise Refused("sweep", table, "a table")
        keys = "parameters", "realizations", *OPTIONS_OF_SWEEP, "wavelengths_nm", "store"
        require_keys(table, keys, "sweep")
        store_name = table.pop("store", path.with_suffix(".store").name)
        if not isinstance(store_name, str) or not store_name:
            raise Refused("sweep.store", store_name, "a path")
    except Refused as error:
        raise error.in_file(str(path)) from error.__cause__
    # options that may stand in [run] or in [sweep], which wins
    run = config.get("run", {})
    # a [run] that is no table is refused below, by `Scenario.from_config`
    of_run = {key: run[key] for key in OPTIONS_OF_SWEEP if isinstance(run, dict) and key in run}
    parameters = dict(_dotted(table.pop("parameters", {})))
    # modules that a file names are code of its author
    with trusting(trust):
        base = base_scenario(Scenario.from_config(config, folder=path.parent), None)
        study = _study(base, config.get("daylight"), parameters, of_run | table)
    return study, path.parent / store_name if store is None else Path(store)


def _plain(values: Sequence[Any]) -> list[Any]:
    """Convert values to numbers, text and lists as in JSON; arrays and tuples become lists."""
    if isinstance(values, str) or not hasattr(values, "__iter__"):
        raise Refused("parameters", values, "a list of values")
    return list(json.loads(json.dumps(list(values), default=lambda value: value.tolist())))


def _dotted(table: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the lists in nested tables with their dotted keys."""
    if not isinstance(table, dict):
        yield path, table
        return
    for key, value in table.items():
        yield from _dotted(value, f"{path}.{key}" if path else key)
