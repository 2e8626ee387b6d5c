"""Scaling of the rates with threads, and with the processes of a sweep."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from functools import partial
from itertools import count
from time import perf_counter, thread_time
from typing import Any

from meshtrace.bench.engine import best_of
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.photons.analog import run_analog
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.parallel import default_threads, job_times
from meshtrace.scenario import Scenario


def counts_up_to(most: int) -> list[int]:
    """Return 1, 2, 4, ... and the largest.

    Examples
    --------
    >>> counts_up_to(1), counts_up_to(6)
    ([1], [1, 2, 4, 6])
    """
    return sorted({1, most, *(2**i for i in range(1, most.bit_length()) if 2**i <= most)})


def thread_scaling(
    link: Link,
    mesh: TriangleMesh,
    near: TriangleMesh,
    photons: int = 1_500_000,
    chains: int = 400_000,
    rounds: int = 3,
    most: int | None = None,
) -> dict[str, Any]:
    """Return rates of both estimators on one thread, two, four, ... relative to one.

    They are those of wall time, and fall with other load on the machine; see `speedup_by_jobs`.

    Parameters
    ----------
    link : Link
        The link.
    mesh, near : TriangleMesh
        The surface for analog transport, and the part of it that forced detection needs.
    photons, chains : int
        Work of each round of both estimators; chains are made and evaluated.
    rounds : int
        Rounds, of which the best counts; all numbers of threads take turns.
    most : int, optional
        Most threads, all cores by default.

    Returns
    -------
    dict
        `threads`; `photons_per_s` and `chains_per_s` for each; `analog_speedup` and
        `forced_speedup`, relative to one thread; `analog_by_jobs` and `forced_by_jobs` of
        `speedup_by_jobs`, for 2 and 16 threads.
    """
    threads = counts_up_to(default_threads(most))
    typical = TypicalSea.of([near])
    analog = [
        partial(run_analog, link, EmbreeIntersector(mesh, n), photons=photons, seed=1, threads=n)
        for n in threads
    ]
    seeds = count(1)  # kept chains would not be made

    def make_and_evaluate(n: int) -> None:
        ForcedDetection(link, chains, next(seeds), threads=n, sea=typical).evaluate(near)

    jobs: list[Callable[[], Any]] = [*analog, *(partial(make_and_evaluate, n) for n in threads)]
    times = best_of(rounds, *jobs, clock=perf_counter)
    analog_times, forced_times = times[: len(threads)], times[len(threads) :]
    return {
        "threads": threads,
        "photons_per_s": [photons / t for t in analog_times],
        "chains_per_s": [chains / t for t in forced_times],
        "analog_speedup": [analog_times[0] / t for t in analog_times],
        "forced_speedup": [forced_times[0] / t for t in forced_times],
        "analog_by_jobs": speedup_by_jobs(analog[0]),
        "forced_by_jobs": speedup_by_jobs(partial(make_and_evaluate, 1)),
    }


def speedup_by_jobs(work: Callable[[], Any], threads: tuple[int, ...] = (2, 16)) -> dict[str, Any]:
    """Return the largest speedup of work on one thread, by the CPU seconds of its jobs.

    Jobs of a map go to the first free thread, in order; maps and the rest follow each other.
    Memory, caches and other limits of a machine are not included.

    Parameters
    ----------
    work : callable
        Work on one thread, whose parallel part consists of `meshtrace.parallel.ordered_map`.
    threads : tuple of int
        Numbers of threads.

    Returns
    -------
    dict
        `threads`, `speedup` for each, `jobs`, `serial` share of the time outside jobs.
    """
    start = thread_time()
    with job_times() as rows:
        work()
    total = thread_time() - start
    serial = max(total - sum(map(sum, rows)), 0.0)
    return {
        "threads": list(threads),
        "speedup": [total / (serial + sum(makespan(row, n) for row in rows)) for n in threads],
        "jobs": sum(map(len, rows)),
        "serial": serial / total,
    }


def makespan(seconds: list[float], threads: int) -> float:
    """Return the time of jobs that go to the first free thread, in order.

    Examples
    --------
    >>> makespan([2.0, 1.0, 1.0], 2)
    2.0
    """
    ends = [0.0] * threads
    for each in seconds:
        heapq.heapreplace(ends, ends[0] + each)
    return max(ends)


def worker_scaling(
    scenario: Scenario,
    realizations: int = 128,
    chains: int = 8192,
    rounds: int = 1,
    most: int | None = None,
) -> dict[str, Any]:
    """Return the rates of a sweep with one, two, four, ... processes.

    The time is wall time, and includes the start of the processes.

    Parameters
    ----------
    scenario : Scenario
        Link and random sea.
    realizations : int
        Seas, in tasks of `meshtrace.studies.sweeps.BLOCK`.
    chains : int
        Chains of every gain.
    rounds : int
        Rounds, of which the best counts; all numbers of workers take turns.
    most : int, optional
        Most workers, all cores by default.

    Returns
    -------
    dict
        `workers`; `realizations_per_s` for each; `speedup`, relative to one worker.

    Raises
    ------
    ModuleNotFoundError
        If dask and distributed are not installed.
    """
    from meshtrace.studies.cluster import Cluster
    from meshtrace.studies.sweeps import Sweep

    def run(workers: int, n: int = realizations) -> None:
        study = Sweep(scenario.to_toml(), {}, n, None, chains, seed=1)
        for _ in Cluster(workers).map(lambda: study.compute, list(study.tasks())):
            pass

    workers = counts_up_to(default_threads(most))
    run(workers[-1], 1)  # compiles
    times = best_of(rounds, *(partial(run, n) for n in workers), clock=perf_counter)
    return {
        "workers": workers,
        "realizations": realizations,
        "realizations_per_s": [realizations / t for t in times],
        "speedup": [times[0] / t for t in times],
    }
