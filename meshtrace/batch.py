"""Sweeps over parameters and realizations on dask.distributed, kept in a Zarr store.

A task is one point of the sweep and a block of its realizations. Its random numbers belong to
(seed, realization), so that results are the same bits for any number of workers. Only the
process that called `sweep` writes: a finished task fills its own chunk of every array, its flag
last, and is never computed again.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.fields import FIELDS, attrs
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel
from meshtrace.result import FORMAT_VERSION, environment
from meshtrace.scenario import DEFAULT_WIND_SPEED, Run, Sampling, Scenario, ScenarioError

if TYPE_CHECKING:
    import distributed
    import xarray as xr
    import zarr

BLOCK = 8
"""Realizations of one task."""

FIRST_CHAINS = 1024
"""Chains with which a point begins unless told otherwise; its tolerance asks for more."""

WAITING, DONE, FAILED = range(3)  # flags of the realizations

_MEASURED = ("gain", "gain_stderr", "gain_ballistic")
_SHARED = ("rtol", "photons", "seed")  # options of a run that a sweep sets for all its points
_WHOLE = {"realizations": (1, 10**7), "seed": (0, 2**64 - 1)}


def sweep(
    link: Link | Scenario | Mapping[str, Any],
    parameters: Mapping[str, Sequence[Any]],
    *,
    sea: SurfaceModel | Mapping[str, Any] | None = None,
    realizations: int = 1,
    rtol: float | None = 0.01,
    photons: int | None = None,
    seed: int = 1,
    store: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Return the gain at every combination of some parameters, computed in parallel.

    Parameters
    ----------
    link : Link, Scenario or mapping
        What all points share: a link, a scenario, or the plain data of a link file. Options of
        its run that are arguments here are left out.
    parameters : mapping of str to sequence
        Values of each parameter, by its dotted key in a link file: "wind_speed",
        "transmitter.depth", "water.b", "sea.omega_max", ...
    sea : SurfaceModel or mapping, optional
        The sea, or the [sea] table of a link file, in place of that of `link`; a `Link` alone
        goes with the default sea, which follows `wind_speed`.
    realizations : int
        Surfaces of each point. One keeps the phases of the sea as they are; of several,
        realization i has those of `numpy.random.SeedSequence([seed, i])`, as in `ensemble`.
    rtol : float, optional
        Relative standard error to reach in every gain; None for `photons` as they are.
    photons : int, optional
        Chains (forced) or photons (analog) of every gain, with `rtol` the first guess.
    seed : int
        Key of the random numbers, 0 <= seed < 2^64. Points share them.
    store : path, optional
        Zarr store to keep finished points in. A second call with the same arguments
        goes on where the first was stopped, however it was stopped.
    scheduler : str, optional
        Address of a running dask scheduler, as in "tcp://10.0.0.1:8786"; else a cluster is
        started on this machine.
    workers : int, optional
        Processes of that cluster, all cores by default; the result does not depend on them.
    progress : bool
        Show on stderr the address of the dashboard and a bar with the time left.

    Returns
    -------
    xarray.Dataset
        Dimensions are the parameters in their order and "realization" (and "receiver" for a
        link with a list of receivers); variables gain, gain_stderr, gain_ballistic, seconds and
        error, the text of what went wrong, empty where nothing did.

    Raises
    ------
    ScenarioError
        If an option is out of range, no value of a parameter is allowed, or the store holds
        another sweep.
    ModuleNotFoundError
        If dask, distributed or zarr are not installed.

    Notes
    -----
    A point that fails is recorded and not tried again. One whose worker died, time after time, is
    recorded too and tried again by the next call.

    The cluster on this machine starts new Python processes: in a script call `sweep` under
    `if __name__ == "__main__":`.
    """
    _require_batch()
    study = Study(
        _base(link, sea).to_toml(),
        {name: _plain(values) for name, values in parameters.items()},
        realizations,
        rtol,
        photons,
        seed,
    )
    study.check()
    if scheduler is not None and workers is not None:
        raise ScenarioError(f"workers: {workers}, allowed: no workers beside a scheduler")
    group = _open(study, store)
    flags = _array(group, "done")[...]
    tasks = [task for task in study.tasks() if (flags[task.region] == WAITING).any()]
    if tasks:
        _compute(study, group, tasks, scheduler, workers, progress)
    return _dataset(group)


def sweep_file(
    path: str | Path,
    *,
    store: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Run the sweep of a study file: a link file with a table [sweep].

    Parameters
    ----------
    path : path
        TOML file. [sweep] takes realizations, rtol, photons, seed and store, as in `sweep`
        (rtol, photons and seed may stand in [run] too); [sweep.parameters] the lists of values
        by their dotted keys.
    store, scheduler, workers, progress
        As in `sweep`; a store in the file lies beside it.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    ScenarioError
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
    path = Path(path)
    try:
        config = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError(f"{path}: {error.strerror}, allowed: a TOML file") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ScenarioError(f"{path}: {_one_line(error)}, allowed: TOML in UTF-8") from error
    table = config.pop("sweep", None)
    if not isinstance(table, dict):
        raise ScenarioError(f"{path}: sweep: {table!r}, allowed: a table")
    run = config.get("run", {})
    options = {key: run[key] for key in _SHARED if isinstance(run, dict) and key in run}
    options |= {key: value for key, value in table.items() if key not in ("parameters", "store")}
    for key in options:
        if key not in ("realizations", *_SHARED):
            raise ScenarioError(
                f"{path}: sweep.{key}: {options[key]!r}, no such key, allowed: parameters, "
                f"realizations, {', '.join(_SHARED)}, store"
            )
    if store is None and "store" in table:
        store = path.parent / str(table["store"])
    return sweep(
        Scenario.from_config(config, folder=path.parent),
        dict(_dotted(table.get("parameters", {}))),
        store=store,
        scheduler=scheduler,
        workers=workers,
        progress=progress,
        **options,
    )


class Task(NamedTuple):
    """One point and a block of its realizations."""

    point: tuple[int, ...]  # which value of each parameter
    first: int
    last: int  # behind the last realization

    @property
    def region(self) -> tuple[Any, ...]:
        """The chunk of the task in arrays (parameters..., realization)."""
        return (*self.point, slice(self.first, self.last))


class Outcome(NamedTuple):
    """What a task gave, by realization."""

    measured: NDArray[np.float64]  # (3, n, receivers) gain, standard error, unscattered gain
    seconds: NDArray[np.float64]
    error: list[str]


@dataclass(frozen=True)
class Study:
    """Everything that the results of a sweep depend on."""

    base: str  # link file
    parameters: dict[str, list[Any]]
    realizations: int
    rtol: float | None
    photons: int | None
    seed: int

    def check(self) -> None:
        """Raise ScenarioError if an option is out of range or a parameter has no allowed value."""
        for name, (low, high) in _WHOLE.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise ScenarioError(f"{name}: {value!r}, allowed: {low} <= {name} <= {high}")
        self.scenario({})
        if not self.parameters:
            raise ScenarioError("parameters: none, allowed: lists of values by dotted keys")
        for name, values in self.parameters.items():
            if not values:
                raise ScenarioError(f"{name}: [], allowed: at least one value")
            problems = [self._problem({name: value}) for value in values]
            if all(problems):
                raise ScenarioError(str(problems[0]))

    def _problem(self, changes: dict[str, Any]) -> str:
        try:
            self.scenario(changes)
        except ScenarioError as error:
            return str(error)
        return ""

    def scenario(self, changes: Mapping[str, Any]) -> Scenario:
        """Return the scenario of a point, whose changes win over the options of the sweep."""
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
        """Run the realizations of a task; what fails gives its text and no numbers."""
        n = task.last - task.first
        outcome = Outcome(np.full((3, n, self.receivers), np.nan), np.zeros(n), [""] * n)
        for i in range(n):
            start = time.perf_counter()
            try:
                outcome.measured[:, i] = self._measure(task, task.first + i)
            except Exception as error:
                outcome.error[i] = _one_line(error)
            outcome.seconds[i] = time.perf_counter() - start
        return outcome

    def _measure(self, task: Task, realization: int) -> NDArray[np.float64]:
        """Return gain, standard error and unscattered gain, each by receiver."""
        scenario = self.scenario(self.changes(task))
        surface, key = scenario.surface, self.seed
        if self.realizations > 1:
            sequence = np.random.SeedSequence([self.seed, realization])
            phases, key = (int(word) for word in sequence.generate_state(2))
            surface = surface.with_seed(phases) if hasattr(surface, "with_seed") else surface
        run = scenario.run.model_copy(update={"seed": key, "threads": 1})
        result = scenario.model_copy(update={"surface": surface, "run": run}).simulate()
        rows = [getattr(result, name) for name in _MEASURED]
        return np.stack([np.full(self.receivers, np.nan if row is None else row) for row in rows])

    @cached_property
    def receivers(self) -> int:
        """Number of receivers of every point."""
        return len(self.scenario({}).link.receivers)

    @cached_property
    def listed(self) -> bool:
        """Whether the receivers are a list, and a dimension of the result."""
        return isinstance(self.scenario({}).link.receiver, tuple)

    def identity(self) -> dict[str, Any]:
        """Return what tells this sweep from others, as plain data."""
        options = {name: getattr(self, name) for name in (*_WHOLE, "rtol", "photons")}
        return {**options, "parameters": self.parameters, "link": tomllib.loads(self.base)}


def _base(
    link: Link | Scenario | Mapping[str, Any], sea: SurfaceModel | Mapping[str, Any] | None
) -> Scenario:
    """Return what all points share, without the options that a sweep sets."""
    if isinstance(link, Link):
        parts = (sea, link.bubbles, link.whitecaps)
        winds = (getattr(part, "wind_speed", None) for part in parts)
        wind = next((wind for wind in winds if wind is not None), DEFAULT_WIND_SPEED)
        default = Scenario.from_config({"wind_speed": wind})
        scenario = default.model_copy(update={"link": link})
    elif isinstance(link, Scenario):
        scenario = link
    else:
        scenario = Scenario.from_config(link)
    if isinstance(sea, SurfaceModel):
        scenario = scenario.model_copy(update={"surface": sea, "sampling": Sampling()})
    elif sea is not None:
        scenario = Scenario.from_config({**scenario.to_config(), "sea": dict(sea)})
    forced = scenario.run.estimator == "forced"
    photons = FIRST_CHAINS if forced else scenario.run.photons
    return scenario.model_copy(update={"run": Run(**{**_kept(scenario.run), "photons": photons})})


def _kept(run: Run) -> dict[str, Any]:
    """Return the options of a run that a sweep keeps."""
    return run.model_dump(exclude={*_SHARED, "threads"}, exclude_none=True)


def _plain(values: Sequence[Any]) -> list[Any]:
    """Return values as plain data: arrays and tuples as lists."""
    if isinstance(values, str) or not hasattr(values, "__iter__"):
        raise ScenarioError(f"parameters: {values!r}, allowed: a list of values")
    return list(json.loads(json.dumps(list(values), default=lambda value: value.tolist())))


def _dotted(table: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the lists in nested tables with their dotted keys."""
    if not isinstance(table, dict):
        yield path, table
        return
    for key, value in table.items():
        yield from _dotted(value, f"{path}.{key}" if path else key)


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"


def _require_batch() -> None:
    try:
        import distributed  # noqa: F401
        import zarr  # noqa: F401
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f'sweep: {error.name} is missing, pip install "meshtrace[batch]"', name=error.name
        ) from error


def _open(study: Study, store: str | Path | None) -> zarr.Group:
    """Return the arrays of a sweep, new ones or those of a store that holds the same sweep."""
    import zarr

    if store is None:
        return _create(study, zarr.storage.MemoryStore())
    path = Path(store)
    if not path.exists():
        # appears as a whole: a store that was killed half-made is no store
        unfinished = path.with_name(f"{path.name}.{os.getpid()}.partial")
        _create(study, unfinished)
        unfinished.rename(path)
    try:
        group = zarr.open_group(path, mode="r+")
        found = json.loads(str(group.attrs["identity"]))
    except (OSError, KeyError, ValueError) as error:
        raise ScenarioError(
            f"store: {str(path)!r} is not that of a sweep, allowed: one, or a new path"
        ) from error
    difference = _difference(found, json.loads(json.dumps(study.identity())))
    if difference:
        raise ScenarioError(
            f"store: {str(path)!r} holds another sweep ({difference}), allowed: the same "
            "arguments, or another path"
        )
    return group


def _difference(there: Any, here: Any, path: str = "") -> str:
    """Return where two trees of plain data first differ, as text, empty if nowhere."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            inner = f"{path}.{key}" if path else key
            text = _difference(there.get(key), here.get(key), inner)
            if text:
                return text
        return ""
    return "" if there == here else f"{path}: {there!r} there, {here!r} here"


def _create(study: Study, store: Any) -> zarr.Group:
    """Create the arrays of a sweep: one chunk for each task."""
    import zarr

    group = zarr.create_group(
        store,
        attributes={
            "title": "meshtrace sweep",
            "format_version": FORMAT_VERSION,
            "kind": "sweep",
            "identity": json.dumps(study.identity()),
            "environment": json.dumps(environment()),
        },
    )
    shape, dims = [], []
    for name, values in study.parameters.items():
        _write_coordinate(group, name, _labels(values))
        shape.append(len(values))
        dims.append(name)
    n = study.realizations
    _write_coordinate(group, "realization", np.arange(n))
    chunks = (*(1 for _ in shape), min(BLOCK, n))
    for name, dtype in (("seconds", "f8"), ("error", "string"), ("done", "i1")):
        group.create_array(
            name, shape=(*shape, n), chunks=chunks, dtype=dtype,
            dimension_names=(*dims, "realization"),
            attributes={"units": "s"} if name == "seconds" else {},
        )  # fmt: skip
    extra = (study.receivers,) if study.listed else ()
    for name in _MEASURED:
        group.create_array(
            name, shape=(*shape, n, *extra), chunks=(*chunks, *extra), dtype="f8",
            fill_value=np.nan, dimension_names=(*dims, "realization", *("receiver" for _ in extra)),
            attributes=_attributes(name),
        )  # fmt: skip
    return group


def _attributes(name: str) -> dict[str, Any]:
    return dict(attrs(name))


def _labels(values: list[Any]) -> NDArray[Any]:
    """Return values as coordinates: numbers, or else text."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return np.array(values)
    return np.array([v if isinstance(v, str) else json.dumps(v) for v in values], dtype=object)


def _write_coordinate(group: zarr.Group, name: str, values: NDArray[Any]) -> None:
    short = name.rpartition(".")[2]
    array = group.create_array(
        name, shape=values.shape, chunks=values.shape,
        dtype="string" if values.dtype == object else values.dtype, dimension_names=(name,),
        attributes=_attributes(short) if short in FIELDS else {},
    )  # fmt: skip
    array[:] = values


def _array(group: zarr.Group, name: str) -> Any:
    return group[name]


def _write(group: zarr.Group, task: Task, outcome: Outcome) -> None:
    """Fill the chunk of a task in every array, its flags last."""
    for name, rows in zip(_MEASURED, outcome.measured, strict=True):
        array = _array(group, name)
        whole = array.ndim == len(task.region) + 1
        array[task.region] = rows if whole else rows[:, 0]
    _array(group, "seconds")[task.region] = outcome.seconds
    _array(group, "error")[task.region] = np.array(outcome.error, dtype=object)
    flags = [FAILED if text else DONE for text in outcome.error]
    _array(group, "done")[task.region] = np.array(flags, np.int8)


def _dataset(group: zarr.Group) -> xr.Dataset:
    """Return the arrays of a sweep as a Dataset in memory."""
    import xarray as xr

    data = xr.open_zarr(group.store, consolidated=False, decode_timedelta=False).load()
    for name in [name for name in data.variables if data[name].dtype.kind == "T"]:
        data[name] = data[name].dims, np.array(data[name].values.tolist(), str), data[name].attrs
    return data.drop_vars("done")


def _compute(
    study: Study,
    group: zarr.Group,
    tasks: list[Task],
    scheduler: str | None,
    workers: int | None,
    progress: bool,
) -> None:
    """Run tasks on a cluster and write each as it finishes."""
    import distributed

    with _client(scheduler, workers) as client, _bar(client, len(tasks), progress) as advance:
        futures = client.map(_run, tasks, study=study, pure=False)
        of = dict(zip((future.key for future in futures), tasks, strict=True))
        for future in distributed.as_completed(futures):
            task = of[future.key]
            if future.status == "finished":
                _write(group, task, future.result())
            else:
                _note(group, task, _one_line(future.exception()))
            future.release()
            advance()


def _run(task: Task, study: Study) -> Outcome:
    return study.compute(task)


def _note(group: zarr.Group, task: Task, text: str) -> None:
    """Record that a task was lost; it stays to be done."""
    _array(group, "error")[task.region] = np.array([text] * (task.last - task.first), dtype=object)


@contextmanager
def _client(scheduler: str | None, workers: int | None) -> Iterator[distributed.Client]:
    """Yield a client of a running scheduler or of a new cluster on this machine."""
    import distributed

    with ExitStack() as stack:
        if scheduler is None:
            scheduler = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=workers or os.cpu_count() or 1,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=":0",
                )
            )
        try:
            client = distributed.Client(scheduler)
        except (OSError, ValueError) as error:
            raise ScenarioError(
                f"scheduler: {scheduler!r}: {_one_line(error)}, allowed: the address of a running "
                "dask scheduler"
            ) from error
        yield stack.enter_context(client)


@contextmanager
def _bar(client: distributed.Client, total: int, shown: bool) -> Iterator[Callable[[], None]]:
    """Print where the dashboard is and show a bar; yield how to say that a task is done."""
    if not shown:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(file=sys.stderr)
    console.print(f"dashboard: {client.dashboard_link}", highlight=False, soft_wrap=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        row = bar.add_task("sweep", total=total)
        yield lambda: bar.advance(row)
