"""The store of a study: kills, other arguments, damage, locks; never another gain in silence."""

from __future__ import annotations

import errno
import json
import os
import signal
import socket
import subprocess
import sys
import time
import warnings
from base64 import b64decode, b64encode
from contextlib import suppress
from functools import partial

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.studies import fading_study, sweeps
from meshtrace.studies.store import Kept, Store, _line, is_store, locked
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea, resolved_sea

LINK = mt.Link()
SEA = JonswapSea(wind_speed=13.0, seed=3, waves="paper")
WAVE = SinusoidalSea(amplitude=0.06, wavelength=4.0)
DAY = mt.Daylight(direct=1.42, diffuse=0.295)
FEW = {"photons": 64, "seed": 5, "threads": 1}
SMALL = {**FEW, "mesh": mt.Meshing(extent=4.0, spacing=0.2)}
TIMES = np.arange(4) * 0.4
FLIGHT = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=8.0))
PAIR = {"clear": LINK, "far": LINK.at_depth(12.0), "waves": LINK.replace("water.b", 0.1)}
ROWS = [
    {"transmitter.depth": d, "gain": g, "stderr": 0.02 * g} for d, g in ((5.0, 3e-4), (9.0, 7e-5))
]
STILL = mt.Scenario.from_toml("wind_speed = 0.0")
STUDIES = {
    "ensemble": partial(mt.ensemble, LINK, 5, SEA, **SMALL),
    "compare": partial(mt.compare, PAIR, SEA, realizations=4, **FEW),
    "sensitivities": partial(
        mt.sensitivities, LINK, WAVE, ["water.a", "receiver.height"], photons=64, threads=1
    ),
    "optimize": partial(
        mt.optimize, LINK, SEA, {"receiver.fov_deg": (10.0, 60.0)}, "gain", hover_std=(1.0, 0.0),
        realizations=2, **FEW,
    ),
    "infer": partial(mt.infer, ROWS, LINK, ["water.a", "receiver.radius"], photons=64, threads=1),
    "series": partial(mt.time_series, LINK, WAVE, TIMES, **SMALL),
    "flight": partial(mt.time_series, LINK, WAVE, TIMES, flight=FLIGHT, **SMALL),
    "coverage": partial(
        mt.coverage_map, LINK, WAVE, 1.0, 0.5, times=(0.0, 1.0), photons=9999, rtol=0.5, threads=1
    ),
    "duplex": partial(mt.duplex, LINK, LINK.mirrored(), SEA, realizations=3, **SMALL),
    "trace": partial(
        mt.channel_trace, LINK, FlatSea(), hours=120 / 36000, rate=10.0, **SMALL
    ),
    "background": partial(
        mt.background_series, LINK, WAVE, DAY, TIMES, photons=64, seed=5, threads=1
    ),
    "irradiance": partial(
        mt.irradiance_series, WAVE, DAY, times=TIMES, photons=1000, seed=5, threads=1
    ),
    "performance": partial(
        mt.link_performance, LINK, SEA, depths=(20.0, 40.0), realizations=2, daylight=DAY, **FEW
    ),
    "depths": partial(
        mt.depth_sweep, LINK, (20.0, 40.0), bit_rate=1e6, wind_speeds=(0.0, 5.0),
        realizations=2, **FEW,
    ),
    "design": partial(mt.design, STILL, photons=64, threads=1),
    "convergence": partial(
        mt.convergence_study, LINK, WAVE, (1.0, 0.5, 0.25, 0.2), placements=2, **FEW
    ),
    "bands": partial(
        mt.band_limit_study, LINK, SEA, (2.0, 3.0, 4.0, 5.0), realizations=2,
        mesh=mt.Meshing(spacing=0.5), **FEW
    ),
    "steps": partial(
        mt.time_step_study, LINK, WAVE, (0.8, 0.4, 0.2, 0.1), duration=0.8,
        mesh=mt.Meshing(spacing=0.2), **FEW
    ),
    "fading": partial(
        fading_study, LINK, resolved_sea(5.0), (4.0, 8.0, 12.0, 16.0), realizations=2,
        mesh=mt.Meshing(spacing=0.2), **FEW,
    ),
}  # fmt: skip
KEPT = ("ensemble", "compare", "series", "coverage", "irradiance")
LONG = ("trace", "infer", "irradiance")
COSTS = ("mesh_time", "bvh_time", "evaluation_time")


@pytest.fixture(autouse=True)
def quiet(recwarn):
    """Leave the warnings of few samples aside."""


def digits(found):
    data = found.to_dataset()
    return {k: v.to_numpy().tolist() for k, v in data.variables.items() if k not in COSTS}


def kept_by(monkeypatch):
    """Return a list that grows by a key for each item that is computed."""
    computed, keep = [], Kept.keep

    def counted(self, key, *rest):
        computed.append(key)
        return keep(self, key, *rest)

    monkeypatch.setattr(Kept, "keep", counted)
    return computed


def killed_after(items, study, path):
    """Run a study in a child that kills itself after some items are kept."""
    child = os.fork()
    if child == 0:
        keep, left = Kept.keep, [items]

        def last(self, *item):
            kept = keep(self, *item)
            left[0] -= 1
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return kept

        with suppress(BaseException):
            Kept.keep = last
            study(store=path)
        os._exit(1)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL


@pytest.mark.posix
@pytest.mark.process
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.thorough) if n in LONG else n for n in STUDIES]
)
@pytest.mark.slow_but(*KEPT)
def test_killed_study_resumes_with_the_same_digits(name, tmp_path, monkeypatch):
    study, path = STUDIES[name], tmp_path / "kept.store"
    computed = kept_by(monkeypatch)
    expected = digits(study())
    computed.clear()
    study(store=tmp_path / "whole.store")
    items = len(computed)
    assert items >= 2
    killed_after(items // 2, study, path)
    computed.clear()
    assert repr(digits(study(store=path))) == repr(expected)
    assert len(computed) == items - items // 2
    computed.clear()
    assert repr(digits(study(store=path))) == repr(expected)
    assert computed == []


@pytest.mark.parametrize(
    "name", ["ensemble", pytest.param("sensitivities", marks=pytest.mark.thorough)]
)
def test_other_arguments_are_refused_by_name(name, tmp_path):
    study, path = STUDIES[name], tmp_path / "kept.store"
    study(store=path)
    sound = path.read_bytes()
    with pytest.raises(Refused, match=r"holds another study \(seed: \d there, 9 here\), allowed"):
        study(store=path, seed=9)
    assert path.read_bytes() == sound


def test_another_study_or_version_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "kept.store"
    STUDIES["ensemble"](store=path)
    message = r"holds another study \(study: 'ensemble' there, '(compare|time_series)' here\)"
    with pytest.raises(Refused, match=message):
        mt.time_series(LINK, SEA, TIMES, **SMALL, store=path)
    with pytest.raises(Refused, match=message):  # whose loops have other names
        STUDIES["compare"](store=path)
    with pytest.raises(Refused, match=r"holds another study \(steps\.labels: "):
        mt.ensemble(LINK, 6, SEA, **SMALL, store=path)
    monkeypatch.setattr("meshtrace.studies.store.version", lambda name: "0.0.1")
    with pytest.raises(Refused, match=r"meshtrace: '\d.*' there, '0\.0\.1' here"):
        STUDIES["ensemble"](store=path)


# ---- damage ----------------------------------------------------------------------------------

IDENTITY = {"seed": 1, "parameters": {"water.b": [0.0, 0.1]}}
ITEMS = {str(i): np.random.default_rng(i).normal(size=(2, 3)) for i in range(6)}


def filled(path):
    """Compute what a store lacks; return all its items, and the keys that were computed."""
    computed = []
    with Store(path).loop("numbers", IDENTITY) as kept:
        for key, numbers in ITEMS.items():
            if key not in kept:
                kept.keep(key, numbers, f"text {key}")
                computed.append(key)
        found = {key: (kept[key][0].tolist(), kept[key][1]) for key in ITEMS}
    assert found == {key: (value.tolist(), f"text {key}") for key, value in ITEMS.items()}
    return computed


@pytest.fixture
def sound(tmp_path):
    path = tmp_path / "sound.store"
    assert filled(path) == list(ITEMS)
    assert filled(path) == []
    assert is_store(path)
    return path


@pytest.mark.filterwarnings("ignore:.*computed again")
def test_any_wrong_bit_is_noticed(sound, tmp_path):
    rng, content = np.random.default_rng(26), sound.read_bytes()
    outcomes = []
    for bit in rng.choice(8 * len(content), 40, replace=False):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << (bit % 8)
        copy = tmp_path / "copy.store"
        copy.write_bytes(damaged)
        outcomes.append(len(filled(copy)))
        assert filled(copy) == []  # and mended
    assert set(outcomes) <= {0, 1, 2}  # the identity, an item, or the end of a line
    assert 1 in outcomes


def test_damage_is_reported_in_one_line(sound):
    lines = sound.read_bytes().splitlines(keepends=True)
    lines[3] = lines[3].replace(b'"text 2"', b'"text 7"')
    sound.write_bytes(b"".join(lines))
    with pytest.warns(UserWarning, match=r"sound\.store: 1 damaged line, the items are computed"):
        assert filled(sound) == ["2"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert filled(sound) == []


def test_cut_store_goes_on(sound, tmp_path):
    """A line that a power failure cut is no damage: the run was stopped there."""
    content, copy = sound.read_bytes(), tmp_path / "cut.store"
    first = len(content.splitlines(keepends=True)[0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for size in np.random.default_rng(3).integers(first, len(content), 50):
            copy.write_bytes(content[:size])
            assert len(filled(copy)) == 7 - content[:size].count(b"\n")
    for size in (0, 1, first - 1):
        copy.write_bytes(content[:size])
        with pytest.raises(Refused, match=r"cut\.store' is not that of a study"):
            filled(copy)


def test_items_of_another_study_are_none(sound, tmp_path):
    """Intact lines of a study with other arguments are left aside."""
    other = tmp_path / "other.store"
    with Store(other).loop("numbers", {**IDENTITY, "seed": 2}) as kept:
        for key in ITEMS:
            kept.keep(key, np.zeros((2, 3)))
    theirs = other.read_bytes().splitlines(keepends=True)[1:]
    mine = sound.read_bytes().splitlines(keepends=True)
    sound.write_bytes(b"".join([mine[0], *theirs, *mine[1:4]]))
    assert filled(sound) == ["3", "4", "5"]


def test_numbers_that_are_none_are_kept(tmp_path):
    path, numbers = tmp_path / "nan.store", np.array([np.nan, np.inf, -0.0, 5e-324])
    identity = {"limit": float("nan")}
    with Store(path).loop("numbers", identity) as kept:
        kept.keep((0, 1.5), numbers)
    with Store(path).loop("numbers", identity) as kept:
        assert kept[0, 1.5][0].tobytes() == numbers.tobytes()


def test_items_before_an_error_stay(sound):
    with suppress(KeyboardInterrupt), Store(sound).loop("more", IDENTITY) as kept:
        kept.keep("a", [1.0])
        raise KeyboardInterrupt
    with Store(sound).loop("more", IDENTITY) as kept:
        assert kept["a"][0].tolist() == [1.0]
    assert filled(sound) == []


# ---- locks -----------------------------------------------------------------------------------

HOLD = """
import sys, time
from pathlib import Path
from meshtrace.studies.store import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60.0)
"""


@pytest.fixture
def holder(tmp_path):
    """Process that holds the lock of a store."""
    store = tmp_path / "depths.store"
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
    with pytest.raises(Refused, match=rf"depths\.store' is in use by {owner} for \d+ s, allowed"):
        with locked(store):
            pass


def test_lock_of_a_dead_process_is_taken_over(holder):
    process, store = holder
    process.kill()
    process.wait()
    lock = store.with_name("depths.store.lock")
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
    lock = tmp_path / "depths.store.lock"
    lock.write_text(json.dumps(owner))
    if free:
        with locked(tmp_path / "depths.store"):
            assert lock.exists()
    else:
        with (
            pytest.raises(Refused, match=rf"in use by {owner['host']}:{owner['pid']} for"),
            locked(tmp_path / "depths.store"),
        ):
            pass


@pytest.mark.parametrize("store", [None, "interrupted.store"])
def test_an_interruption_says_how_to_go_on(store, tmp_path):
    path = store and tmp_path / store
    with pytest.raises(KeyboardInterrupt) as raised:
        mt.time_series(LINK, WAVE, TIMES, **FEW, store=path, progress=stop_after_two())
    assert raised.value.__suppress_context__
    assert str(raised.value) == (
        f"finished steps are in {path}: the same call resumes"
        if path
        else "no store= was given, with which the same call would resume"
    )
    # neither a frame of the step nor one of its callback is shown
    names = {frame.name for frame in raised.traceback}
    assert "advance" not in names


def stop_after_two():
    done = []

    def advance(n):
        done.append(n)
        if len(done) == 2:
            raise KeyboardInterrupt

    return advance


def test_lock_is_freed_after_an_error(tmp_path):
    store = tmp_path / "depths.store"
    with pytest.raises(ZeroDivisionError), locked(store):
        _ = 1 / 0
    with locked(store):
        pass


def test_a_file_system_without_locks_is_named(tmp_path, monkeypatch):
    """As some network file systems: a study without its lock could be written by two processes."""

    def refuse(descriptor, blocking):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("filelock.lock_descriptor", refuse)
    with (
        pytest.raises(Refused, match=r"depths\.store\.lock': No locks available, allowed: a path"),
        locked(tmp_path / "depths.store"),
    ):
        pass


@pytest.mark.posix
def test_store_of_a_stopped_process_is_refused_at_once(holder):
    """Nothing waits for it."""
    process, store = holder
    process.send_signal(signal.SIGSTOP)
    with pytest.raises(Refused, match=rf"in use by {socket.gethostname()}:{process.pid} for"):
        with locked(store):
            pass


def forged(**changes):
    """Return lines of a store with right digests, one of which no study wrote."""
    item = {
        "of": "x",
        "item": "0",
        "shape": [1, 2],
        "numbers": "AAAAAAAA8D8AAAAAAADwPw==",
        "text": "",
    }
    loop = {"loop": "sweep", "identity": {"study": "sweep"}}
    line = {key: value for key, value in {**item, **changes}.items() if value is not None}
    return _line(loop) + _line(line)


@pytest.mark.parametrize(
    "changes",
    [{"numbers": None}, {"of": None}, {"item": None}, {"shape": None}, {"text": None}, {"of": {}},
     {"item": 5}, {"text": []}, {"numbers": 5}, {"numbers": "AAA"}, {"numbers": "not base64"},
     {"numbers": "AAAAAAAA8D8="}, {"shape": []}, {"shape": [2.5]}, {"shape": "12"}, {"shape": [-1, -2]},
     {"shape": [2**62, 2**62]}, {"shape": 5}, {"loop": 5}, {"loop": "x", "identity": []},
     {"loop": "x", "identity": {}}, {"loop": "x", "identity": {"study": 5}}, {"loop": "x"}],
)  # fmt: skip
def test_lines_of_right_digests_that_no_study_wrote(changes, tmp_path):
    """Once tracebacks of five kinds."""
    path = tmp_path / "a.store"
    path.write_bytes(forged())
    store = Store(path, "sweep")
    store.read()
    assert store._items["x"]["0"][0].tolist() == [[1.0, 1.0]]
    path.write_bytes(forged(**changes))
    with pytest.raises(
        Refused, match=r"^store: .*a line that no study wrote .*, allowed: one, or a new path"
    ):
        Store(path, "sweep").read()


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.thorough) if n in LONG else n for n in STUDIES]
)
@pytest.mark.slow_but(*KEPT)
def test_items_of_another_shape_are_refused(name, tmp_path):
    """Once some were spread over all links in silence, others ended in a traceback."""
    path, study = tmp_path / "a.store", STUDIES[name]
    study(store=path)
    sound = path.read_bytes().splitlines(keepends=True)
    for change in (lambda x: np.concatenate([x, x]), lambda x: x[..., :-1], lambda x: x.ravel()[0]):
        path.write_bytes(b"".join(changed(line, change) for line in sound))
        with pytest.raises(Refused, match=r"^store: '.*a.store': an item of shape .*, allowed: "):
            study(store=path)


def changed(line, change):
    """Return a line of a store with other numbers in its item, if it has any."""
    content = json.loads(line.partition(b" ")[2])
    if "item" not in content:
        return line
    numbers = change(np.frombuffer(b64decode(content["numbers"])).reshape(content["shape"]))
    content.update(shape=numbers.shape, numbers=b64encode(numbers.tobytes()).decode())
    return _line(content)


def test_items_of_a_sweep_of_another_shape_are_refused(tmp_path, monkeypatch):
    """Once a single number became those of all receivers and quantities."""
    path = tmp_path / "a.store"

    def fill(self, setup, tasks):
        for i in range(len(tasks)):
            yield i, (np.full((1, 1), 3e-5), '[""]')

    monkeypatch.setattr("meshtrace.studies.sweeps.Cluster.map", fill)
    run = partial(mt.sweep, {"wind_speed": 5.0}, {"transmitter.depth": [5.0, 10.0]}, photons=32,
                  rtol=None, store=path)  # fmt: skip
    run()
    for read in (run, partial(sweeps.read_store, path)):
        with pytest.raises(
            Refused, match=r"^store: '.*a.store': an item of shape \(1, 1\), allowed"
        ):
            read()
