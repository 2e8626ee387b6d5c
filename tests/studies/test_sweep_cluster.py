"""Clusters that must be refused: foreign or no workers, a scheduler that dies, open doors."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cloudpickle
import psutil
import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.studies import cluster, sweep

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")

FLAT = {"spectrum": "flat"}
FEW = {"rtol": None, "photons": 64, "surface": FLAT}


def slow_jobs(until=os.devnull):
    """Return the setup of jobs, sent by value: half a second each until there is a file."""
    return lambda: lambda i: (time.sleep(0.01 if os.path.exists(until) else 0.5), os.getpid())[1]


@pytest.fixture
def scheduler():
    """Scheduler in a process of its own, without workers."""
    script = (
        "import asyncio, distributed\n"
        "async def main():\n"
        "    async with distributed.Scheduler(host='127.0.0.1', port=0, dashboard=False) as s:\n"
        "        print(s.address, flush=True)\n"
        "        await s.finished()\n"
        "asyncio.run(main())\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    with process:
        yield process, process.stdout.readline().strip()
        process.kill()


@pytest.fixture
def worker_of():
    """Return a function that starts a worker, by default of this package."""
    started = []

    def start(address, packages=None):
        script = (
            "import asyncio, distributed\n"
            "async def main():\n"
            f"    async with distributed.Worker({address!r}, nthreads=1) as w:\n"
            "        await w.finished()\n"
            "asyncio.run(main())\n"
        )
        process = subprocess.Popen(
            [sys.executable, "-c", script], cwd=packages,stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.fixture(params=["other kernels", "no package"])
def foreign(request, tmp_path):
    """Folder that hides this package behind one of other kernels, or behind none."""
    kernels = tmp_path / "meshtrace" / "kernels"
    kernels.mkdir(parents=True)
    if request.param == "no package":
        (tmp_path / "meshtrace" / "__init__.py").write_text("raise ImportError('not here')\n")
        return tmp_path, "meshtrace ImportError: not here there"
    for folder in (kernels.parent, kernels):
        (folder / "__init__.py").write_text("")
    (kernels / "jit.py").write_text("def sources():\n    return b'other'\n")
    return tmp_path, f"kernels {b'other'.hex()} there"


@pytest.mark.thorough
def test_foreign_worker_is_refused(scheduler, worker_of, foreign, tmp_path):
    _, address = scheduler
    packages, message = foreign
    worker_of(address, packages)
    store = tmp_path / "kept.store"
    with pytest.raises(Refused, match=r"worker: tcp://") as caught:
        sweep(mt.Link(), {"water.b": [0.0]}, workers=address, store=store, **FEW)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(store.read_bytes().splitlines()) == 1  # none of its numbers


def test_late_worker_describes_itself_instead_of_computing():
    run, here = cluster._portable_job(), cluster._environment()
    setup = cloudpickle.dumps(lambda: abs)
    assert cluster._checked(run(-2, setup=setup, expected=here)) == (2, [])
    other = run(-2, setup=setup, expected={**here, "numpy": "1.0"})
    with pytest.raises(Refused, match="worker: a worker that came late: "):
        cluster._checked({**other, "numpy": "1.0"})


def test_cluster_without_workers_is_refused_in_time(scheduler):
    _, address = scheduler
    start = time.monotonic()
    with pytest.raises(Refused, match=r"workers: no worker within 1 s, allowed"):
        sweep(mt.Link(), {"water.b": [0.0]}, workers=address, timeout=1.0, **FEW)
    assert time.monotonic() - start < 20.0


@pytest.mark.posix
@pytest.mark.thorough
def test_a_stopped_worker_is_refused_in_time(scheduler, worker_of):
    """The client once waited for it without limit."""
    _, address = scheduler
    worker = worker_of(address)
    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
    worker.send_signal(signal.SIGSTOP)
    start = time.monotonic()
    with pytest.raises(Refused, match=r"workers: no answer of a worker within 1 s, allowed"):
        sweep(mt.Link(), {"water.b": [0.0]}, workers=address, timeout=1.0, **FEW)
    assert time.monotonic() - start < 60.0


@pytest.mark.posix
@pytest.mark.thorough
def test_a_stopped_scheduler_ends_the_study(scheduler, worker_of, monkeypatch):
    """A client that had no answer once took it for a busy scheduler for ever."""
    process, address = scheduler
    worker_of(address)
    monkeypatch.setattr(cluster, "_SILENCE", 1.0)
    found = cluster.Cluster(address).map(slow_jobs(), range(1000))
    for _ in range(3):
        next(found)
    process.send_signal(signal.SIGSTOP)
    start = time.monotonic()
    with pytest.raises(Refused, match=r"workers: no answer, \d+ of 1000 tasks finished, allowed"):
        list(found)
    assert time.monotonic() - start < 90.0


@pytest.mark.posix
@pytest.mark.thorough
def test_jobs_of_a_stopped_worker_are_done_by_others(tmp_path):
    """Within the time after which dask gives up a worker without a sign of life."""
    file, done = tmp_path / "stopped", {}
    with dask.config.set({"distributed.scheduler.worker-ttl": "2s"}):
        for i, pid in cluster.Cluster(3).map(slow_jobs(file), range(300)):
            done[i] = pid
            if pid != os.getpid() and not file.exists():
                os.kill(pid, signal.SIGSTOP)
                file.touch()
    assert sorted(done) == list(range(300))
    assert file.exists()


@pytest.mark.posix
@pytest.mark.slow
def test_dead_scheduler_ends_the_command(scheduler, worker_of, tmp_path):
    process, address = scheduler
    worker_of(address)
    study = tmp_path / "study.toml"
    study.write_text(
        "bubbles = 'none'\nrun.photons = 8192\n[sweep]\nrtol = 1.0\nphotons = 8192\n"
        f"[sweep.parameters]\n'water.b' = {[0.001 * i for i in range(200)]}\n"
    )
    command = [sys.executable, "-m", "meshtrace", "sweep", str(study), "--workers", address]
    client = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with client:
        store = tmp_path / "study.store"
        while client.poll() is None and not (
            store.exists() and store.read_bytes().count(b"\n") > 2
        ):
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        errors = client.communicate(timeout=45)[1]  # distributed waits for a minute
    assert client.returncode == 2, errors
    assert "of 200 tasks finished" in errors.splitlines()[-1]
    assert "the same command resumes" in errors.splitlines()[-1]
    assert "Traceback" not in errors


@pytest.mark.thorough
def test_local_cluster_listens_to_this_machine_alone_and_works_in_private(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    seen, folders = set(), []

    def listening(process):
        try:
            found = process.net_connections("inet")
        except psutil.NoSuchProcess:  # a helper of the start of a worker has ended meanwhile
            return set()
        return {c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN}

    def look(done):  # after the first point: wait for the worker
        me, end = psutil.Process(), time.monotonic() + 60.0
        while not folders and time.monotonic() < end:
            time.sleep(0.05)
            children = [listening(child) for child in me.children(recursive=True)]
            if any(children):
                seen.update(listening(me), *children)
                folders.extend(Path(tmp_path).glob("meshtrace-*"))

    points = {"water.b": [0.01 * i for i in range(8)]}
    sweep(mt.Link(), points, workers=2, **{**FEW, "progress": look})
    assert seen == {"127.0.0.1"}
    assert folders
    assert not Path(folders[0]).exists()  # and leaves nothing
