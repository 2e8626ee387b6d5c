"""Damaged stores and locks: one line that names the file, and never another gain in silence."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import warnings

import numpy as np
import pytest

from meshtrace.errors import Refused
from meshtrace.scenario import Scenario
from meshtrace.studies.sweep import DONE, Study
from meshtrace.studies.sweep.lock import locked
from meshtrace.studies.sweep.store import dataset, open_store, waiting_tasks, write

zarr = pytest.importorskip("zarr")

LINK = {"sea": {"spectrum": "flat"}, "bubbles": "none", "run": {"photons": 64}}
STUDY = Study(
    Scenario.from_config(LINK).to_toml(), {"water.b": [0.0, 0.1], "water.n": [1.33, 1.34]},
    3, None, None, 1,
)  # fmt: skip


def finish(store):
    """Compute what a store lacks, and return its dataset."""
    group = open_store(STUDY, store)
    for task in waiting_tasks(STUDY, group):
        write(group, task, STUDY.compute(task))
    return dataset(group)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "sweep.zarr"
    return path, finish(path).drop_vars("seconds")


def outcome(path, expected):
    """Return the word for what a store gives; fail if it is another gain, or not one line."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = finish(path).drop_vars("seconds")
        except Refused as error:
            assert str(error).count("\n") == 0
            assert str(path) in str(error)
            return "refused"
    assert found.identical(expected)
    if not caught:
        return "unharmed"
    for warning in caught:
        text = str(warning.message)
        assert "\n" not in text
        assert str(path) in text
        assert "computed again" in text
    return "computed again"


def files_of(path):
    return sorted(file.relative_to(path) for file in path.rglob("*") if file.is_file())


def flip(file, rng):
    content = bytearray(file.read_bytes())
    content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
    file.write_bytes(content)


def cut(file, rng):
    content = file.read_bytes()
    file.write_bytes(content[: rng.integers(len(content))])


def remove(file, rng):
    file.unlink()


def drill(sound, tmp_path, files, damage, rng):
    """Damage each of some files in a copy of a store; count what came of it."""
    path, expected = sound
    counts = dict.fromkeys(("refused", "computed again", "unharmed"), 0)
    for i, name in enumerate(files):
        copy = tmp_path / f"{i}.zarr"
        shutil.copytree(path, copy)
        damage(copy / name, rng)
        counts[outcome(copy, expected)] += 1
        shutil.rmtree(copy)
    return counts


@pytest.mark.parametrize("damage", [flip, cut, remove])
@pytest.mark.thorough
@pytest.mark.slow_but("flip")
def test_damage_never_gives_another_gain(sound, tmp_path, damage):
    path, _ = sound
    files = files_of(path)
    rng = np.random.default_rng(7)
    chosen = [files[i] for i in rng.choice(len(files), 10, replace=False)]
    gains = [name for name in files if name.parts[0] == "gain" and name.name != "zarr.json"]
    counts = drill(sound, tmp_path, [*chosen, *gains], damage, rng)
    # every damaged chunk of gains is noticed
    assert counts["computed again"] >= len(gains)
    assert counts["refused"] > 0


@pytest.mark.parametrize("name", ["gain", "gain_stderr", "seconds", "done", "checksum", "error"])
def test_chunks_of_other_places_are_noticed(sound, tmp_path, name):
    """A chunk replaced by an intact one of the same array, or of the same place of another sweep."""
    path, expected = sound
    chunks = [f for f in files_of(path) if f.parts[0] == name and f.name != "zarr.json"]
    assert len(chunks) == 4
    for i, chunk in enumerate(chunks):
        copy = tmp_path / f"{i}.zarr"
        shutil.copytree(path, copy)
        other = chunks[(i + 1) % 4]
        shutil.copy(path / other, copy / chunk)
        same = (path / other).read_bytes() == (path / chunk).read_bytes()
        assert outcome(copy, expected) == ("unharmed" if same else "computed again")


@pytest.mark.slow
def test_hundreds_of_damaged_files_never_give_another_gain(sound, tmp_path):
    path, _ = sound
    rng = np.random.default_rng(8)
    files = [files_of(path)[i] for i in rng.integers(len(files_of(path)), size=300)]
    for damage in (flip, cut, remove):
        drill(sound, tmp_path, files, damage, rng)


def test_finished_point_without_a_gain_is_computed(sound, tmp_path):
    path, expected = sound
    copy = tmp_path / "nan.zarr"
    shutil.copytree(path, copy)
    group = zarr.open_group(copy, mode="r+")
    with zarr.config.set({"array.write_empty_chunks": True}):
        group["gain"][1, 0] = np.nan
    assert (group["done"][1, 0] == DONE).all()
    group = open_store(STUDY, copy)
    assert [task.point for task in waiting_tasks(STUDY, group)] == [(1, 0)]
    assert finish(copy).drop_vars("seconds").identical(expected)


def test_store_without_checksums_is_refused(sound, tmp_path):
    path, _ = sound
    copy = tmp_path / "bare.zarr"
    shutil.copytree(path, copy)
    top = json.loads((copy / "zarr.json").read_text())
    del top["attributes"]["digest"]
    (copy / "zarr.json").write_text(json.dumps(top))
    with pytest.raises(Refused, match=r"bare\.zarr.*its checksum differs"):
        open_store(STUDY, copy)


# ---- locks -----------------------------------------------------------------------------------

HOLD = """
import sys, time
from meshtrace.studies.sweep.lock import locked
with locked(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60.0)
"""


@pytest.fixture
def holder(tmp_path):
    """Process that holds the lock of a store."""
    store = tmp_path / "depths.zarr"
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(store)], stdout=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout.readline() == "held\n"
        yield process, store
        process.kill()


def test_store_in_use_is_refused_with_owner_and_age(holder):
    process, store = holder
    owner = f"{socket.gethostname()}:{process.pid}"
    with pytest.raises(Refused, match=rf"depths\.zarr' is in use by {owner} for \d+ s, allowed"):
        with locked(store):
            pass


def test_lock_of_a_dead_process_is_taken_over(holder):
    process, store = holder
    process.kill()
    process.wait()
    lock = store.with_name("depths.zarr.lock")
    assert json.loads(lock.read_text())["pid"] == process.pid
    with locked(store):
        assert json.loads(lock.read_text())["pid"] == os.getpid()
    assert not lock.exists()


@pytest.mark.parametrize(
    ("owner", "free"),
    [
        ({"host": "elsewhere", "pid": 1, "since": time.time() - 7200.0}, False),
        ({"host": socket.gethostname(), "pid": os.getppid(), "since": time.time()}, False),
        # the number of a process that began after the lock was taken
        ({"host": socket.gethostname(), "pid": os.getppid(), "since": 1.0}, True),
        ({}, True),
    ],
)
def test_lock_without_a_holder_belongs_to_a_process_that_may_live(tmp_path, owner, free):
    lock = tmp_path / "depths.zarr.lock"
    lock.write_text(json.dumps(owner))
    if free:
        with locked(tmp_path / "depths.zarr"):
            assert lock.exists()
    else:
        with (
            pytest.raises(Refused, match=rf"in use by {owner['host']}:{owner['pid']} for"),
            locked(tmp_path / "depths.zarr"),
        ):
            pass


def test_lock_is_freed_after_an_error(tmp_path):
    store = tmp_path / "depths.zarr"
    with pytest.raises(ZeroDivisionError), locked(store):
        _ = 1 / 0
    with locked(store):
        pass


def test_a_system_without_such_locks_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setattr("platform.system", lambda: "Windows")
    with (
        pytest.raises(Refused, match=r"depths\.zarr' on Windows, allowed: none, or Linux, macOS"),
        locked(tmp_path / "depths.zarr"),
    ):
        pass
