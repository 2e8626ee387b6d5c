"""Works of the engine whose speed is measured, each beside its reference.

In all measurements `link` and `sea` are the link and a sea over it (a random one where phases
change), and `rtol` is the relative standard error to reach.
"""

from __future__ import annotations

import heapq
import math
import os
import tempfile
from collections.abc import Callable
from functools import partial
from itertools import count
from time import perf_counter, thread_time
from typing import Any

import numpy as np
from clocks import best_of, of_command, timed
from numpy.typing import NDArray

from meshtrace import EmbreeIntersector, TriangleMesh, background, parallel
from meshtrace.checks import check_call
from meshtrace.daylight import Daylight
from meshtrace.engine import bvh
from meshtrace.engine.forced import MANY_SEAS, ForcedDetection, TypicalSea
from meshtrace.engine.photons.analog import run_analog
from meshtrace.engine.setup import arrays, meshing
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.link import Link
from meshtrace.parallel import default_threads
from meshtrace.results import tallies
from meshtrace.results.series import relative_errors
from meshtrace.scenario import Scenario
from meshtrace.studies import coverage_map, ensemble

_CHUNK = 8192  # rays
Rays = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


class RayRecorder(EmbreeIntersector):
    """Intersector that records all of its rays."""

    shortcut = False

    def __init__(self, mesh: TriangleMesh, threads: int) -> None:
        super().__init__(mesh, threads)
        self.rays: Rays = []

    def for_mesh(self, mesh: TriangleMesh) -> RayRecorder:
        """Return a recorder over the mesh in the units of the tracer, with the same record."""
        found = RayRecorder(mesh, self.threads)
        found.rays = self.rays
        return found

    def facets(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        """Return the facets and record the rays."""
        self.rays.append((origins.copy(), directions.copy()))
        return super().facets(origins, directions)

    def chunks(self) -> Rays:
        """Return the rays in chunks for raw casting."""
        whole = [np.concatenate(part) for part in zip(*self.rays, strict=True)]
        starts = range(_CHUNK, len(whole[0]), _CHUNK)
        return list(zip(*(np.split(part, starts) for part in whole), strict=True))


def to_tolerance(
    measure: Callable[[int], dict[str, Any]], samples: int, rtol: float, most: int = 2**22
) -> tuple[int, dict[str, Any]]:
    """Return the number of samples for a relative error, by doubling, and its measurement."""
    while (found := measure(samples))["rtol"] > rtol and samples < most:
        samples *= 2
    return samples, found


def replay(scene: bvh.RayScene, rays: Rays) -> None:
    """Cast recorded chunks of rays."""
    for chunk in rays:
        scene.run(*chunk)


@check_call
def analog_rate(
    link: Link, mesh: TriangleMesh, photons: int = 1_500_000, rounds: int = 3
) -> dict[str, Any]:
    """Return photons per CPU second against raw Embree rays per second on the same mesh.

    Raw rays are the rays of the engine without its shortcut on grids, replayed through embreex in
    the same chunks; both on one thread.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    photons : int
        Photons of each round.
    rounds : int
        Rounds, of which the best counts.

    Returns
    -------
    dict
        `photons_per_s`, `rays_per_s`, `ratio` (photons per raw ray), `rays_per_photon`, `facets`,
        `seconds`, all of CPU time.
    """
    intersector, recorder = EmbreeIntersector(mesh, 1), RayRecorder(mesh, 1)
    recorded = min(photons, 2**18)
    run_analog(link, recorder, photons=recorded, seed=1)
    rays = recorder.chunks()
    local = arrays.frame_of(link).mesh(mesh)  # the rays are in the units of the tracer
    raw = bvh.CopiedScene(local.vertices, local.faces)
    repeats = max(photons // recorded, 1)  # both sides run for about as long
    times = best_of(
        rounds,
        lambda: run_analog(link, intersector, photons=photons, seed=1, threads=1),
        lambda: replay(raw, rays * repeats),
    )
    n_rays = sum(len(origins) for origins, _ in rays)
    photon_rate, ray_rate = photons / times[0], repeats * n_rays / times[1]
    return {
        "photons_per_s": photon_rate,
        "rays_per_s": ray_rate,
        "ratio": photon_rate / ray_rate,
        "rays_per_photon": n_rays / recorded,
        "facets": len(mesh.faces),
        "seconds": times,
    }


@check_call
def figure_of_merit(
    link: Link,
    mesh: TriangleMesh,
    chains: int = 20_000,
    photons: int = 4_000_000,
    rounds: int = 3,
    seeds: int = 16,
) -> dict[str, Any]:
    """Return the figure of merit 1 / (variance x time) of forced over analog transport.

    Times are CPU seconds of one thread. Variances are relative to the gain. That of the forced
    estimator is the scatter over `seeds` independent sets of chains; its time is that of making and
    aiming them (both estimators are warm, the mesh is made). That of the analog one is known from
    its sums of squares.

    Returns
    -------
    dict
        `ratio` and `ratio_stderr`, `ratio_kept` with chains that are made already;
        `forced_variance`, `forced_seconds` of aiming, `setup_seconds` of making one set of chains,
        `analog_variance`, `analog_seconds`; `scatter_over_error` of the forced gains, scatter
        over the root mean square of their standard errors; gains and standard errors.
    """
    intersector = EmbreeIntersector(mesh, 1)
    sea = TypicalSea.of_meshes([mesh])
    gains, stated, setup = [], [], []
    for seed in range(seeds):
        forced, seconds = timed(partial(ForcedDetection, link, chains, seed, threads=1, sea=sea))
        setup.append(seconds)
        parts = forced.evaluate(mesh)
        gains.append(float(parts.gain[0]))
        stated.append(float(parts.stderr[0]))
    analog = partial(run_analog, link, intersector, photons=photons, threads=1)
    times = best_of(rounds, lambda: forced.evaluate(mesh), lambda: analog(seed=1))
    sums = analog(seed=2)
    gain = float(sums.score[0]) / photons
    stderr = float(tallies.standard_error(sums.score, sums.score_squared, photons)[0])
    mean = float(np.mean(gains))
    forced_variance = float(np.var(gains, ddof=1)) / mean**2
    analog_variance = (stderr / mean) ** 2
    kept = analog_variance * times[1] / (forced_variance * times[0])
    ratio = kept * times[0] / (times[0] + min(setup))
    # the variance of n normal numbers is itself uncertain by sqrt(2 / (n - 1)); that of the
    # analog run by the number of its hits
    hits = max((gain / stderr) ** 2, 1.0)
    relative = math.sqrt(2.0 / (seeds - 1) + 2.0 / hits)
    return {
        "ratio": ratio,
        "ratio_stderr": ratio * relative,
        "ratio_kept": kept,
        "scatter_over_error": float(np.std(gains, ddof=1) / np.sqrt(np.mean(np.square(stated)))),
        "forced_variance": forced_variance,
        "forced_seconds": times[0],
        "setup_seconds": min(setup),
        "analog_variance": analog_variance,
        "analog_seconds": times[1],
        "forced_gain": mean,
        "forced_gain_stderr": mean * math.sqrt(forced_variance / seeds),
        "analog_gain": gain,
        "analog_gain_stderr": stderr,
        "chains": chains,
        "photons": photons,
    }


@check_call
def new_sea(link: Link, sea: Any, rtol: float = 0.01, rounds: int = 5) -> dict[str, Any]:
    """Return the CPU time of one thread for one gain at a relative tolerance over a new sea.

    Triangulation, chains, aiming and, where paths must be checked, the BVH are included; every
    round takes other phases.

    Returns
    -------
    dict
        `seconds` (median), `kept_seconds` with chains that are made already, `mesh_seconds`,
        `bvh_seconds`, `rtol` reached (largest), `chains`.
    """
    reach, chains = crossing_reach(link), 64

    def gain(seed: int, chains: int) -> dict[str, Any]:
        phases = sea.with_seed(1000 + seed)
        (mesh, _), meshed = timed(partial(meshing.mesh_for, link, phases, reach=reach))
        typical = TypicalSea.of_meshes([mesh])
        forced, made = timed(partial(ForcedDetection, link, chains, seed, threads=1, sea=typical))
        parts, aimed = timed(partial(forced.evaluate, mesh))
        _, built = timed(EmbreeIntersector(mesh, 1).built)
        return {
            "seconds": meshed + made + aimed,
            "kept_seconds": meshed + aimed,
            "with_bvh_seconds": meshed + made + aimed + built,
            "mesh_seconds": meshed,
            "bvh_seconds": built,
            "rtol": float(parts.stderr[0] / parts.gain[0]),
            "chains": parts.counts.drawn,
            "facets": len(mesh.faces),
        }

    rows = []
    for seed in range(rounds + 1):  # the first warms up
        chains, row = to_tolerance(partial(gain, seed), chains, rtol)
        rows.append(row)
    names = [name for name in rows[0] if name.endswith("seconds")]
    median = {name: float(np.median([row[name] for row in rows[1:]])) for name in names}
    return {**rows[-1], **median, "rtol": max(row["rtol"] for row in rows[1:])}


@check_call
def resolved_sea(
    link: Link, sea: Any, rtol: float = 0.01, rounds: int = 3, realizations: int = 16
) -> dict[str, Any]:
    """Return the CPU time of one thread for a sea that is resolved down to the waves light feels.

    Parameters
    ----------
    rounds : int
        New seas of which the median counts.
    realizations : int
        Seas of the ensemble.

    Returns
    -------
    dict
        `gain` of `new_sea`, which has seconds and facets; `seconds_per_realization` of an ensemble
        with as many chains, which are made once, its `facets`, and `direct_seconds` of the
        unscattered light alone.
    """
    gain = new_sea(link, sea, rtol, rounds)
    reach, chains = crossing_reach(link), gain["chains"]
    mesh, _ = meshing.mesh_for(link, sea, reach=reach, per_wave=meshing.FADING_SPACING)
    forced = ForcedDetection(
        link, chains, 1, threads=1, sea=TypicalSea.of_meshes([mesh], MANY_SEAS)
    )
    aimed = forced.planner.aim_over(mesh)
    (direct,) = best_of(3, lambda: aimed.direct_gains(0, 0))
    each = realization(link, sea, chains, realizations)
    return {
        "gain": gain,
        "seconds_per_realization": each["cpu_seconds"],
        "direct_seconds": direct,
        "facets": len(mesh.faces),
        "rtol": each["rtol"],
    }


def realization(link: Link, sea: Any, chains: int = 608, realizations: int = 64) -> dict[str, Any]:
    """Return the cost of a realization of an ensemble, on one thread.

    Parameters
    ----------
    chains : int
        Chains, common to all realizations.
    realizations : int
        Seas of the ensemble.

    Returns
    -------
    dict
        `cpu_seconds` of a realization, making of the chains included; `rtol`, the root mean
        square of the relative standard errors; `chains`, `realizations`.

    Notes
    -----
    The search for the band that fading needs, made once for a link and a wind, is not included.
    """
    run: Any = partial(ensemble, link, surface=sea, photons=chains, threads=1)
    series, seconds = timed(lambda: run(realizations), lambda: run(2))
    return {
        "cpu_seconds": seconds / realizations,
        "rtol": float(np.sqrt(np.mean((series.gain_stderr / series.gain) ** 2))),
        "chains": chains,
        "realizations": realizations,
    }


def background_light(link: Link, sea: Any, rtol: float = 0.03) -> dict[str, Any]:
    """Return the cost of the background light over one sea at a tolerance, on one thread.

    Returns
    -------
    dict
        `cpu_seconds`, `rtol` reached, `rays`.
    """
    day = Daylight.clear_sky(sun_zenith_deg=30.0)

    def light(rays: int) -> dict[str, Any]:
        work = partial(background, link, sea, day, photons=rays, threads=1)
        found = work()  # and compiles
        reached = float(found.radiance_stderr / found.radiance)
        return {"cpu_seconds": best_of(3, work)[0], "rtol": reached, "rays": rays}

    return to_tolerance(light, 256, rtol)[1]


def coverage_cost(
    link: Link, sea: Any, extent: float = 5.0, step: float = 0.1, rtol: float = 0.01
) -> dict[str, Any]:
    """Return the CPU time of a coverage map with a relative error in every cell.

    Parameters
    ----------
    extent, step, rtol : float
        As in `coverage_map`.

    Returns
    -------
    dict
        `cells`, `photons`, `cpu_seconds` on one thread, `rtol` reached (largest, of cells above
        1 % of the highest gain), `rtol_of_all` (of darker ones, too).
    """
    run: Any = partial(coverage_map, link, sea, step=step, rtol=rtol, threads=1)
    cover, seconds = timed(lambda: run(extent=extent), lambda: run(extent=2.0 * step))
    return {
        "cells": cover.gain.size,
        "photons": cover.provenance["run"]["photons"],
        "cpu_seconds": seconds,
        "rtol": float(relative_errors(cover.gain, cover.gain_stderr).max()),
        "rtol_of_all": float((cover.gain_stderr / cover.gain).max()),
    }


def first_run() -> dict[str, float]:
    """Return the time of a first `meshtrace run`, which compiles its kernels by two processes.

    Returns
    -------
    dict
        `seconds` of wall time and `cpu_seconds` with an empty cache; `warm_seconds` and
        `warm_cpu_seconds` of the same command after it.
    """
    own = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    with tempfile.TemporaryDirectory() as folder:
        cache, rows = {**own, "MESHTRACE_CACHE_DIR": folder}, dict[str, float]()
        for name in ("", "warm_"):
            used, wall = of_command("-m", "meshtrace", "run", env=cache)
            rows |= {f"{name}seconds": wall, f"{name}cpu_seconds": used}
    return rows


def counts_up_to(most: int) -> list[int]:
    """Return 1, 2, 4, ... and the largest.

    Examples
    --------
    >>> counts_up_to(1), counts_up_to(6)
    ([1], [1, 2, 4, 6])
    """
    return sorted({1, most, *(2**i for i in range(1, most.bit_length()) if 2**i <= most)})


@check_call
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
    typical = TypicalSea.of_meshes([near])
    seeds = count(1)  # kept chains would not be made

    def trace(n: int) -> None:
        run_analog(link, EmbreeIntersector(mesh, n), photons=photons, seed=1, threads=n)

    def make_and_evaluate(n: int) -> None:
        ForcedDetection(link, chains, next(seeds), threads=n, sea=typical).evaluate(near)

    found: dict[str, Any] = {"threads": threads}
    works = ("analog", "photons", photons, trace), ("forced", "chains", chains, make_and_evaluate)
    for name, unit, size, work in works:
        times = best_of(rounds, *(partial(work, n) for n in threads), clock=perf_counter)
        found |= {
            f"{unit}_per_s": [size / t for t in times],
            f"{name}_speedup": [times[0] / t for t in times],
            f"{name}_by_jobs": speedup_by_jobs(partial(work, 1)),
        }
    return found


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
    with parallel.job_times() as rows:
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


@check_call
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
