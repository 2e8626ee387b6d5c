"""BLAS has one thread while the package works, and as many as before afterwards."""

import threading

import numpy as np
import pytest
from threadpoolctl import OpenBLASController, ThreadpoolController

import meshtrace as mt
from meshtrace import TriangleMesh, parallel
from meshtrace.parallel import ordered_map
from meshtrace.surfaces import FlatSea, JonswapSea

BLAS = ThreadpoolController().select(user_api="blas")
FEW = {"photons": 64, "seed": 1}


def threads_of_blas():
    return max(row["num_threads"] for row in BLAS.info())


@pytest.fixture
def two_threads():
    """BLAS with two threads, as on a machine of two cores."""
    before = BLAS.limit(limits=2)
    OpenBLASController.clear_controlling_thread()
    if threads_of_blas() < 2:
        pytest.skip("BLAS has one thread")
    yield
    before.restore_original_limits()
    OpenBLASController.clear_controlling_thread()


@pytest.fixture
def seen(monkeypatch):
    """Threads of BLAS whenever a mesh is made."""
    found, make = [], TriangleMesh.__post_init__

    def noted(mesh):
        found.append(threads_of_blas())
        make(mesh)

    monkeypatch.setattr(TriangleMesh, "__post_init__", noted)
    return found


SEA, LIGHT = JonswapSea(wind_speed=5.0), mt.Daylight(direct=1.42, diffuse=0.295)
WORKS = {
    "simulate": lambda: mt.simulate(mt.Link(), FlatSea(), threads=1, **FEW),
    "analog": lambda: mt.simulate(mt.Link(), FlatSea(), "analog", threads=1, **FEW),
    "trace_paths": lambda: mt.trace_paths(mt.Link(), FlatSea(), n=4),
    "background": lambda: mt.background(mt.Link(), FlatSea(), LIGHT, photons=4096, threads=1),
    "ensemble": lambda: mt.ensemble(mt.Link(), 2, SEA, threads=1, **FEW),
    "threads": lambda: mt.ensemble(mt.Link(), 2, SEA, threads=2, **FEW),
    "coverage_map": lambda: mt.coverage_map(
        mt.Link(), FlatSea(), 0.5, 0.5, photons=4096, threads=1
    ),
}


@pytest.mark.parametrize("name", WORKS)
def test_works_hold_blas_to_one_thread(name, two_threads, seen):
    WORKS[name]()
    assert set(seen) == {1}
    assert threads_of_blas() == 2


def test_jobs_of_a_cluster_hold_it(two_threads):
    from meshtrace.studies.cluster import Cluster

    rows = list(Cluster(1).map(lambda: lambda _: threads_of_blas(), [0, 1]))
    assert rows == [(0, 1), (1, 1)]
    assert threads_of_blas() == 2


def test_the_last_of_several_works_lifts_the_limit(two_threads):
    inside, ended = threading.Event(), threading.Event()

    def long_work():
        with parallel.one_blas_thread():
            inside.set()
            ended.wait()

    thread = threading.Thread(target=long_work, daemon=True)
    with parallel.one_blas_thread():
        thread.start()
        inside.wait()
    assert threads_of_blas() == 1
    ended.set()
    thread.join()
    assert threads_of_blas() == 2


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_lifts_the_limit(threads, two_threads):
    with pytest.raises(ZeroDivisionError):
        list(ordered_map(lambda x: 1 // x, [1, 0], threads))
    assert threads_of_blas() == 2


def test_nodes_are_found_once(monkeypatch):
    """Finding 64 nodes cost a third of a gain, in a solver that keeps all cores busy."""
    mt.simulate(mt.Link(), FlatSea(), **FEW)
    monkeypatch.delattr(np.polynomial.legendre, "leggauss")
    mt.simulate(mt.Link(), FlatSea(), **FEW)


def test_light_reflected_first_is_estimated_once(monkeypatch):
    from meshtrace.engine import choice, outcome

    calls, estimate = [], choice.returned_gain

    def counted(link):
        calls.append(link)
        return estimate(link)

    monkeypatch.setattr(choice, "returned_gain", counted)
    monkeypatch.setattr(outcome, "returned_gain", counted)
    mt.simulate(mt.Link(), FlatSea(), **FEW)
    assert len(calls) == 1
