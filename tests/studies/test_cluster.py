"""Studies on a dask cluster: the digits are those of threads, and finished steps are kept."""

import os
import sys
import threading
import time
import warnings

import numpy as np
import pytest
from studies.test_store import LINK, SMALL, STUDIES, TIMES, WAVE, digits

import meshtrace as mt
from meshtrace.errors import Refused, warn
from meshtrace.studies import cluster
from meshtrace.studies.campaign import campaign_of
from meshtrace.studies.cluster import Cluster

distributed = pytest.importorskip("distributed")

ON_CLUSTERS = ("ensemble", "trace", "compare", "sensitivities", "optimize", "infer", "flight",
               "duplex", "background", "irradiance", "performance", "depths", "design",
               "convergence", "bands", "steps", "fading", "coverage")  # fmt: skip


@pytest.fixture(scope="module")
def address():
    """Scheduler with a worker in a process of its own."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as local:
        yield local.scheduler_address


@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ON_CLUSTERS)
@pytest.mark.slow_but("ensemble")
def test_digits_on_a_cluster_are_those_of_threads(name, address, tmp_path):
    study, path = STUDIES[name], tmp_path / "kept.store"
    expected = repr(digits(study()))
    assert repr(digits(study(workers=address, store=path))) == expected
    assert repr(digits(study(store=path))) == expected  # from the store


@pytest.mark.process
@pytest.mark.thorough
def test_warnings_of_workers_are_those_of_this_process(address):
    """Each worker once printed its own, which no filter of the user and no line of many reached."""

    def setup():
        def job(i):
            if i < 4:
                warn(f"row {i % 2}", mt.FewSamplesWarning)
            return i

        return job

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        results = dict(Cluster(address).map(setup, range(5)))
    assert results == {i: i for i in range(5)}
    assert sorted(str(w.message) for w in caught) == ["row 0", "row 1"]
    assert {(w.category, w.filename) for w in caught} == {(mt.FewSamplesWarning, __file__)}


@pytest.mark.process
@pytest.mark.thorough
def test_a_warning_of_a_worker_may_be_an_error(address):
    results = dict(Cluster(address).map(lambda: lambda i: warn(f"row {i}"), range(2)))
    assert [(type(results[i]), str(results[i])) for i in range(2)] == [
        (UserWarning, "row 0"),
        (UserWarning, "row 1"),
    ]


@pytest.fixture(scope="module")
def here():
    """Scheduler of one worker in a thread of this process."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as local:
        yield local.scheduler_address


def test_series_on_a_cluster(here):
    seen = []
    found = mt.time_series(LINK, WAVE, TIMES, **SMALL, workers=here, progress=seen.append)
    alone = mt.time_series(LINK, WAVE, TIMES, **SMALL)
    np.testing.assert_array_equal(found.gains, alone.gains)
    assert seen == [1] * len(TIMES)


def test_a_failing_surface_ends_the_study(here):
    campaign = campaign_of(LINK, WAVE, run={"workers": here, **SMALL})
    steps = campaign.in_time(TIMES)

    def surface(i):
        if i == 2:
            raise Refused("surface", i, "other numbers")
        return WAVE, 0.0

    with pytest.raises(Refused, match="surface: 2, allowed: other numbers"):
        campaign.gains(steps._replace(surface=surface), probed=1)


def pid_of(job):
    if job == 1:
        raise ValueError("one")
    return os.getpid()


@pytest.mark.parametrize(("workers", "jobs"), [(1, 4), (None, 4), (2, 1)])
def test_little_work_is_done_in_this_process(workers, jobs, monkeypatch):
    monkeypatch.setattr(cluster, "_client", None)
    found = dict(Cluster(workers).map(lambda: pid_of, range(jobs)))
    assert str(found.pop(1, "one")) == "one"
    assert found == dict.fromkeys(found, os.getpid())
    assert len(found) == max(jobs - 1, 1)


@pytest.mark.process
@pytest.mark.thorough
def test_other_processes_share_work_that_lasts(tmp_path):
    first = os.getpid()

    def work(job):
        while os.getpid() == first and not (tmp_path / "finished").exists():  # by another process
            time.sleep(0.01)
        if os.getpid() != first:
            (tmp_path / "finished").touch()
        return os.getpid()

    found = dict(Cluster(2).map(lambda: work, range(6)))
    assert sorted(found) == list(range(6))
    assert found[0] == first
    assert len(set(found.values())) == 2


@pytest.mark.process
@pytest.mark.thorough
def test_the_end_of_a_loop_ends_other_processes():
    results = Cluster(2).map(lambda: lambda job: time.sleep(0.1), range(10_000))
    next(results)
    results.close()
    assert not [t for t in threading.enumerate() if t.name == "workers"]


def test_one_worker_needs_no_dask(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert list(Cluster(1).map(lambda: abs, [-2])) == [(0, 2)]
    with pytest.raises(Refused, match=r"workers: distributed is not installed.*meshtrace\[batch\]"):
        Cluster(2)


@pytest.mark.parametrize("name", ["ensemble", "optimize", "infer", "design", "coverage"])
@pytest.mark.parametrize("options", [{"workers": n} for n in (0, 1.5, -1)] + [{"photons": 0}])
def test_options_out_of_range_are_refused(name, options):
    with pytest.raises(Refused, match=rf"{next(iter(options))}: .*, allowed"):
        STUDIES[name](**options)
