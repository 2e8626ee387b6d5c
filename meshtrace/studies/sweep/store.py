"""The Zarr store of a sweep: one chunk of every array for each task, its flag written last."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.fields import FIELDS, attrs
from meshtrace.results.provenance import environment
from meshtrace.scenario import ScenarioError
from meshtrace.studies.sweep.points import BLOCK, MEASURED, Outcome, Study, Task

if TYPE_CHECKING:
    import xarray as xr
    import zarr

WAITING, DONE, FAILED = range(3)  # flags of the realizations


def open_store(study: Study, store: str | Path | None) -> zarr.Group:
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
            "format_version": 1,
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
    for name in MEASURED:
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


def waiting_tasks(study: Study, group: zarr.Group) -> list[Task]:
    """Return the tasks of which the store lacks a realization."""
    flags = _array(group, "done")[...]
    return [task for task in study.tasks() if (flags[task.region] == WAITING).any()]


def write(group: zarr.Group, task: Task, outcome: Outcome) -> None:
    """Fill the chunk of a task in every array, its flags last."""
    for name, rows in zip(MEASURED, outcome.measured, strict=True):
        array = _array(group, name)
        whole = array.ndim == len(task.region) + 1
        array[task.region] = rows if whole else rows[:, 0]
    _array(group, "seconds")[task.region] = outcome.seconds
    _array(group, "error")[task.region] = np.array(outcome.error, dtype=object)
    flags = [FAILED if text else DONE for text in outcome.error]
    _array(group, "done")[task.region] = np.array(flags, np.int8)


def dataset(group: zarr.Group) -> xr.Dataset:
    """Return the arrays of a sweep as a Dataset in memory."""
    import xarray as xr

    data = xr.open_zarr(group.store, consolidated=False, decode_timedelta=False).load()
    for name in [name for name in data.variables if data[name].dtype.kind == "T"]:
        data[name] = data[name].dims, np.array(data[name].values.tolist(), str), data[name].attrs
    return data.drop_vars("done")


def note(group: zarr.Group, task: Task, text: str) -> None:
    """Record that a task was lost; it stays to be done."""
    _array(group, "error")[task.region] = np.array([text] * (task.last - task.first), dtype=object)
