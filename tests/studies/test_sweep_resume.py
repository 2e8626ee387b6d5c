"""Sweeps in real processes: the same bits for any workers, and after any of them is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from meshtrace import cli
from meshtrace.scenario import Scenario
from meshtrace.studies import sweep, sweeps
from meshtrace.studies.sweeps import Sweep

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.process

PHOTONS = 8192  # so many that a sweep lasts seconds, and can be interrupted
LINK = {"sea": {"spectrum": "jonswap"}, "bubbles": "none", "run": {"photons": PHOTONS}}
PARAMETERS = {"transmitter.depth": [4.0 + i for i in range(12)], "wind_speed": [5.0, 13.0]}
OPTIONS = {"rtol": None, "photons": PHOTONS}
SCRIPT = f"""
import sys
from meshtrace.studies.sweeps import sweep

if __name__ == "__main__":
    sweep({LINK!r}, {PARAMETERS!r}, store=sys.argv[1], workers=1, **{OPTIONS!r})
"""


@pytest.fixture(scope="module")
def expected():
    """Gains of all points, computed one after the other in this process."""
    asked = Sweep(Scenario.from_config(LINK).to_toml(), PARAMETERS, 1, None, PHOTONS, 1)
    gain = np.empty((12, 2, 1))
    for task in asked.tasks():
        gain[task.region] = asked.compute(task)[0][:, 0]
    return gain


def finished(store):
    """Which points of a store are done; none where it is not made yet."""
    if not store.exists():
        return np.zeros((12, 2, 1), bool)
    return np.isfinite(sweeps.read_store(store)["gain"].values)


def wait_for(store, points, alive):
    """Wait until some points are done, and return which."""
    while alive():
        done = finished(store)
        if done.sum() >= points:
            return done
        time.sleep(0.01)
    raise AssertionError("ended before it could be killed")


@pytest.mark.slow
def test_bits_are_those_of_one_process(expected):
    parameters = {**PARAMETERS, "transmitter.depth": [*PARAMETERS["transmitter.depth"], -1.0]}
    one, two = (sweep(LINK, parameters, workers=n, **OPTIONS) for n in (1, 2))
    np.testing.assert_array_equal(one["gain"].values[:-1], expected)
    assert one.drop_vars("seconds").identical(two.drop_vars("seconds"))
    assert (one["error"][-1] == "transmitter.depth: -1.0, allowed: 0 < depth <= 12000").all()


@pytest.mark.slow
def test_killed_client_loses_nothing(expected, tmp_path):
    store, script = tmp_path / "depths.store", tmp_path / "study.py"
    script.write_text(SCRIPT)
    client = subprocess.Popen([sys.executable, str(script), str(store)])
    try:
        wait_for(store, 4, lambda: client.poll() is None)
    finally:
        client.kill()
        client.wait()
    done = finished(store)
    assert 4 <= done.sum() < done.size
    seconds = sweeps.read_store(store)["seconds"].values
    data = sweep(LINK, PARAMETERS, store=store, workers=1, **OPTIONS)
    np.testing.assert_array_equal(data["gain"].values, expected)
    np.testing.assert_array_equal(data["seconds"].values[done], seconds[done])  # not run again
    assert (data["error"] == "").all()
    assert finished(store).all()


@pytest.mark.posix
@pytest.mark.slow
def test_killed_worker_loses_nothing(expected, tmp_path):
    store, result = tmp_path / "depths.store", []
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        address = cluster.scheduler_address

        def call():
            result.append(sweep(LINK, PARAMETERS, store=store, workers=address, **OPTIONS))

        with distributed.Client(address, set_as_default=False) as client:
            (worker,) = client.run(os.getpid).values()
        thread = threading.Thread(target=call)
        thread.start()
        done = wait_for(store, 2, thread.is_alive)
        os.kill(worker, signal.SIGKILL)
        thread.join()
    assert done.sum() < done.size
    np.testing.assert_array_equal(result[0]["gain"].values, expected)
    assert (result[0]["error"] == "").all()


def keys_in_memory(dask_worker):
    return sorted(dask_worker.data)


@pytest.mark.posix
@pytest.mark.slow
def test_results_lost_with_their_worker_are_computed_again(expected):
    """The first result is being written; the worker dies with the next three in its memory."""
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        lost = []

        def advance(done):
            if lost:
                return
            (worker,) = client.scheduler_info()["workers"]
            while len(lost) < 4:
                time.sleep(0.02)
                lost[:] = client.run(keys_in_memory)[worker]
            os.kill(client.run(os.getpid)[worker], signal.SIGKILL)
            while worker in client.scheduler_info()["workers"]:
                time.sleep(0.02)

        options = {**OPTIONS, "progress": advance}
        data = sweep(LINK, PARAMETERS, workers=cluster.scheduler_address, **options)
    np.testing.assert_array_equal(data["gain"].values, expected)
    assert (data["error"] == "").all()


@pytest.mark.posix
@pytest.mark.slow
def test_interrupted_command_goes_on(expected, tmp_path):
    study, store = tmp_path / "study.toml", tmp_path / "study.store"
    study.write_text(
        f"""
        bubbles = "none"
        [sea]
        spectrum = "jonswap"
        [run]
        photons = {PHOTONS}
        [sweep]
        rtol = 1.0
        photons = {PHOTONS}
        [sweep.parameters]
        "transmitter.depth" = {PARAMETERS["transmitter.depth"]}
        wind_speed = {PARAMETERS["wind_speed"]}
        """
    )
    command = [sys.executable, "-m", "meshtrace", "sweep", str(study), "--workers", "1"]
    # Ctrl-C reaches every process of the terminal: a session of its own stands for it
    first = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # a shell's background jobs ignore Ctrl-C, and so would their children
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        done = wait_for(store, 2, lambda: first.poll() is None)
        os.killpg(first.pid, signal.SIGINT)
        errors = first.communicate(timeout=60)[1]
    finally:
        if first.poll() is None:
            os.killpg(first.pid, signal.SIGKILL)
    assert first.returncode == 130
    assert "finished points are in" in errors
    assert "Traceback" not in errors
    assert done.sum() < done.size
    again = CliRunner().invoke(cli.app, command[3:])
    assert again.exit_code == 0, again.output
    assert finished(store).all()
    np.testing.assert_array_equal(sweeps.read_store(store)["gain"].values, expected)
