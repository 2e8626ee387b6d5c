"""The Zarr store of a sweep: one chunk of every array for each task, its flag written last.

Every chunk carries a CRC-32C checksum, every realization one of its numbers and its place in the
sweep, and the group holds the SHA-256 digests of all metadata: damaged or exchanged chunks are
computed again, damaged metadata are refused.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused, show
from meshtrace.fields import FIELDS, attrs
from meshtrace.results.provenance import environment
from meshtrace.stored import FORMAT_VERSION
from meshtrace.studies.sweep.points import BLOCK, LIT, MEASURED, Outcome, Study, Task, error_text

if TYPE_CHECKING:
    import xarray as xr
    import zarr

WAITING, DONE, FAILED = range(3)  # flags of the realizations

_BY_TASK = ("done", "checksum", "error", "seconds", *MEASURED, *LIT)


def open_store(study: Study, store: str | Path | None) -> zarr.Group:
    """Return the arrays of a sweep, new ones or those of a store that holds the same sweep.

    Raises
    ------
    Refused
        If the store is that of another sweep or of none, or its metadata are damaged.
    """
    import zarr

    if store is None:
        return _create(study, zarr.storage.MemoryStore())
    path = Path(store)
    if not path.exists():
        # appears as a whole: a store that was killed half-made is no store
        unfinished = path.with_name(f"{path.name}.{os.getpid()}.partial")
        _create(study, unfinished)
        _seal(unfinished)
        unfinished.rename(path)
    found = json.loads(_verified(path)["identity"])
    difference = _difference(found, json.loads(json.dumps(study.identity())))
    if difference:
        held = Described(f"{str(path)!r} holds another sweep ({difference})")
        raise Refused("store", held, "the same arguments, or another path")
    group = zarr.open_group(path, mode="r+")
    for name, values in _coordinates(study).items():
        try:
            whole = np.array_equal(_array(group, name)[...], values)
        except Exception as error:  # codecs and file systems raise any exception
            raise _damaged(path / name, error_text(error)) from error
        if not whole:
            raise _damaged(path / name, "other values")
    return group


def _seal(path: Path) -> None:
    """Write the digests of all metadata into those of the group."""
    top = path / "zarr.json"
    content = json.loads(top.read_bytes())
    files = sorted(path.glob("*/zarr.json"))
    content["attributes"]["digests"] = {f.parent.name: _digest(f.read_bytes()) for f in files}
    content["attributes"]["digest"] = _digest(_canonical(content))
    top.write_text(json.dumps(content, indent=2))


def _verified(path: Path) -> dict[str, Any]:
    """Return the attributes of a store with intact metadata; refuse altered ones."""
    top = path / "zarr.json"
    try:
        content = json.loads(top.read_bytes())
        attributes = dict(content["attributes"])
        is_sweep = attributes.get("kind") == "sweep"
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        if not isinstance(error, OSError):
            raise _damaged(top, "no metadata of a group") from error
        is_sweep = False
    if not is_sweep:
        other = Described(f"{str(path)!r} is not that of a sweep")
        raise Refused("store", other, "one, or a new path")
    content["attributes"] = {k: v for k, v in attributes.items() if k != "digest"}
    if attributes.get("digest") != _digest(_canonical(content)):
        raise _damaged(top, "its checksum differs")
    for name, digest in attributes["digests"].items():
        file = path / name / "zarr.json"
        if not file.is_file():
            raise _damaged(file, "missing")
        if _digest(file.read_bytes()) != digest:
            raise _damaged(file, "its checksum differs")
    return attributes


def _damaged(file: Path, reason: str) -> Refused:
    return Refused("store", Described(f"{str(file)!r} is damaged ({reason})"), "a new path")


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _canonical(content: Any) -> bytes:
    return json.dumps(content, sort_keys=True).encode()


def _difference(there: Any, here: Any, path: str = "") -> str:
    """Return the first difference of two trees of plain data as text, empty if none."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            inner = f"{path}.{key}" if path else key
            text = _difference(there.get(key), here.get(key), inner)
            if text:
                return text
        return ""
    return "" if there == here else f"{path}: {show(there)} there, {show(here)} here"


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
    coordinates, checked = _coordinates(study), _checked_codecs()
    for name, values in coordinates.items():
        _write_coordinate(group, name, values)
    dims, shape = tuple(coordinates), tuple(map(len, coordinates.values()))
    chunks = (*(1 for _ in study.parameters), min(BLOCK, study.realizations))
    for name, dtype in (("seconds", "f8"), ("error", "string"), ("done", "i1"), ("checksum", "u8")):
        group.create_array(
            name, shape=shape, chunks=chunks, dtype=dtype, compressors=checked,
            dimension_names=dims, attributes={"units": "s"} if name == "seconds" else {},
        )  # fmt: skip
    extra = (study.receivers,) if study.listed else ()
    for name in study.measured:
        light = {"light": study.light} if name == "ber" else {}
        group.create_array(
            name, shape=(*shape, *extra), chunks=(*chunks, *extra), dtype="f8",
            compressors=checked, fill_value=np.nan, attributes={**attrs(name), **light},
            dimension_names=(*dims, *("receiver" for _ in extra)),
        )  # fmt: skip
    return group


def _checked_codecs() -> list[Any]:
    from zarr.codecs import Crc32cCodec, ZstdCodec

    return [ZstdCodec(), Crc32cCodec()]


def _coordinates(study: Study) -> dict[str, NDArray[Any]]:
    """Return the coordinates of the arrays by their dimensions."""
    labels = {name: _labels(values) for name, values in study.parameters.items()}
    return {**labels, "realization": np.arange(study.realizations)}


def _labels(values: list[Any]) -> NDArray[Any]:
    """Return values as coordinates: numbers, or else text."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return np.array(values)
    return np.array([v if isinstance(v, str) else json.dumps(v) for v in values], dtype=object)


def _write_coordinate(group: zarr.Group, name: str, values: NDArray[Any]) -> None:
    short = name.rpartition(".")[2]
    about: dict[str, Any] = dict(attrs(short)) if short in FIELDS else {}
    text = values.dtype == object
    array = group.create_array(
        name, shape=values.shape, chunks=values.shape, dtype="string" if text else values.dtype,
        compressors=_checked_codecs(), dimension_names=(name,),
        attributes=about,
    )  # fmt: skip
    array[...] = values


def _array(group: zarr.Group, name: str) -> Any:
    return group[name]


def _names(group: zarr.Group) -> list[str]:
    """Return the names of the arrays by task."""
    return [name for name in _BY_TASK if name in group]


def waiting_tasks(study: Study, group: zarr.Group) -> list[Task]:
    """Return the unfinished tasks, including those with damaged or lost chunks."""
    tasks = list(study.tasks())
    root = getattr(group.store, "root", None)
    if root is not None:
        for name in _names(group):
            _discard_damaged(_array(group, name), Path(root) / name, tasks)
    flags, gain = _array(group, "done")[...], _array(group, "gain")[...]
    waiting = []
    for task in tasks:
        done = flags[task.region]
        lost = [] if root is None or (done == WAITING).any() else _lost(group, Path(root), task)
        if lost:
            warnings.warn(f"{lost[0]}: missing, its points are computed again", stacklevel=2)
        without_gain = np.isnan(gain[task.region].T) & (done == DONE)
        again = bool(lost) or bool((done == WAITING).any()) or bool(without_gain.any())
        if not again and _is_exchanged(group, task):
            again = True
            place = f"{root or 'store'}: numbers of another place at {task.point}"
            warnings.warn(f"{place}, its points are computed again", stacklevel=2)
        if again:
            waiting.append(task)
    return waiting


def _is_exchanged(group: zarr.Group, task: Task) -> bool:
    """Return whether a finished task has numbers that were not written for it."""
    found, flags = (_array(group, name)[task.region] for name in ("checksum", "done"))
    return not np.array_equal(found, _checksums(group, task, flags))


def _checksums(group: zarr.Group, task: Task, flags: NDArray[np.int8]) -> NDArray[np.uint64]:
    """Return the checksums of the realizations of a task: of sweep, place, flag and numbers."""
    names = [name for name in _names(group) if name not in ("checksum", "done")]
    columns = [flags, *(_array(group, name)[task.region] for name in names)]
    start = hashlib.sha256(repr((group.attrs["identity"], names, task.point)).encode())
    sums = []
    for i in range(task.last - task.first):
        row = start.copy()
        numbers = [column[i : i + 1].tolist() for column in columns]
        row.update(repr([task.first + i, *numbers]).encode())
        sums.append(int.from_bytes(row.digest()[:8], "little"))
    return np.array(sums, np.uint64)


def _discard_damaged(array: Any, folder: Path, tasks: list[Task]) -> None:
    """Remove the chunks of an array that cannot be read, with a warning for each."""
    try:
        array[...]
    except OSError as error:
        raise _damaged(folder, error_text(error)) from error
    except Exception:  # codecs raise any exception
        for task in tasks:
            try:
                array[task.region]
            except Exception as error:
                file = _chunk(array, folder, task)
                file.unlink()
                reason = f"damaged ({error_text(error)}), its points are computed again"
                warnings.warn(f"{file}: {reason}", stacklevel=3)


def _chunk(array: Any, folder: Path, task: Task) -> Path:
    """Return the file of the chunk of a task."""
    place = (*task.point, task.first // BLOCK)
    return folder / array.metadata.encode_chunk_key(place + (0,) * (array.ndim - len(place)))


def _lost(group: zarr.Group, root: Path, task: Task) -> list[Path]:
    """Return the files that a finished task has lost."""
    files = (_chunk(_array(group, name), root / name, task) for name in _names(group))
    return [file for file in files if not file.exists()]


def write(group: zarr.Group, task: Task, outcome: Outcome) -> None:
    """Fill the chunk of a task in every array, its flags last."""
    import zarr

    flags = np.array([FAILED if text else DONE for text in outcome.error], np.int8)
    # chunks of fill values, too: one that is missing later has been lost
    with zarr.config.set({"array.write_empty_chunks": True}):
        for name, rows in zip(MEASURED + LIT, outcome.measured, strict=False):
            array = _array(group, name)
            whole = array.ndim == len(task.region) + 1
            array[task.region] = rows if whole else rows[:, 0]
        _array(group, "seconds")[task.region] = outcome.seconds
        _array(group, "error")[task.region] = np.array(outcome.error, dtype=object)
        _array(group, "checksum")[task.region] = _checksums(group, task, flags)
        _array(group, "done")[task.region] = flags


def note(group: zarr.Group, task: Task, text: str) -> None:
    """Record that a task was lost; it stays to be done."""
    _array(group, "error")[task.region] = np.array([text] * (task.last - task.first), dtype=object)


def read_store(path: Path) -> xr.Dataset:
    """Return the results of a store, nan where points are not finished.

    Raises
    ------
    Refused
        If it is no store of a sweep, or damaged.
    """
    import zarr

    _verified(path)
    try:
        return dataset(zarr.open_group(path, mode="r"))
    except Exception as error:  # codecs and file systems raise any exception
        raise _damaged(path, error_text(error)) from error


def dataset(group: zarr.Group) -> xr.Dataset:
    """Return the arrays of a sweep as a Dataset in memory."""
    import xarray as xr

    # without dask arrays, whose scheduler is a setting of the process
    data = xr.open_zarr(group.store, consolidated=False, decode_timedelta=False, chunks=None).load()
    for name in [name for name in data.variables if data[name].dtype.kind == "T"]:
        data[name] = data[name].dims, np.array(data[name].values.tolist(), str), data[name].attrs
    data.attrs = {k: v for k, v in data.attrs.items() if not k.startswith("digest")}
    return data.drop_vars(["done", "checksum"])
