"""Cores that a process may use: those of its affinity, no more than the quota of its container."""

import os
import subprocess
import sys
from threading import get_ident

import pytest

from meshtrace import parallel
from meshtrace.parallel import default_threads, ordered_map, results_of
from meshtrace.studies import cluster


@pytest.fixture
def four(monkeypatch, tmp_path):
    """Have four cores, and a missing file of a quota."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 2, 5, 7}, raising=False)
    monkeypatch.setattr(parallel, "_QUOTA", tmp_path / "cpu.max")
    return tmp_path / "cpu.max"


def test_cores_are_those_of_the_affinity(four):
    assert parallel.cores() == default_threads() == 4


@pytest.mark.parametrize(
    ("quota", "n"),
    [("max 100000", 4), ("200000 100000", 2), ("150000 100000", 2), ("1000 100000", 1),
     ("900000 100000", 4), ("", 4), ("0 0", 4), ("odd", 4)],
)  # fmt: skip
def test_a_quota_is_rounded_up(four, quota, n):
    four.write_text(quota)
    assert parallel.cores() == n


def test_systems_without_affinity_count_all_cores(four, monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert parallel.cores() == 1
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    assert parallel.cores() == 6


def test_a_study_has_as_many_processes_as_cores(four, monkeypatch):
    asked = []
    monkeypatch.setattr(
        cluster.Cluster, "_beside", lambda self, setup, jobs, others: asked.append(others) or []
    )
    list(cluster.Cluster().map(lambda: abs, range(10)))
    assert asked == [3]


@pytest.mark.process
@pytest.mark.posix
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="affinity of Linux")
def test_a_process_on_one_core_has_one_thread():
    """It once had as many as the machine has cores, as under `taskset -c 0`."""
    one = min(os.sched_getaffinity(0))
    code = (
        f"import os; os.sched_setaffinity(0, {{{one}}})\n"
        "from meshtrace.parallel import default_threads; print(default_threads())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "1\n", done.stderr


def test_loops_of_parallel_functions_share_their_threads():
    # a pool for each would have as many threads as the square of those asked for
    def loop():
        return {get_ident()} | set(ordered_map(lambda _: get_ident(), range(8), 2))

    assert [len(threads) for threads in results_of(2, loop, loop)] == [1, 1]
    # the calling thread has pools again
    assert get_ident() not in set(ordered_map(lambda _: get_ident(), range(8), 2))
