"""Photons and rays per second, figure of merit, cost of a new sea and of whole answers.

CPU time of one thread: wall time depends on the load of the machine, and on two sides of a ratio
not alike.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.daylight.light import Daylight
from meshtrace.engine.backward.background import background
from meshtrace.engine.bvh import CopiedScene, EmbreeIntersector, RayScene
from meshtrace.engine.forced import MANY_SEAS, ForcedDetection, TypicalSea
from meshtrace.engine.photons.analog import run_analog
from meshtrace.engine.setup.arrays import frame_of
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.engine.setup.meshing import FADING_SPACING, mesh_for
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.results.coverage import relative_errors
from meshtrace.results.tallies import standard_error
from meshtrace.studies.campaign import campaign_of, mean, stderr
from meshtrace.studies.coverage import coverage_map
from meshtrace.studies.series import ensemble

_CHUNK = 8192  # rays

Rays = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


class RayRecorder(EmbreeIntersector):
    """Intersector that records all of its rays."""

    shortcut = False

    def __init__(self, mesh: TriangleMesh, threads: int) -> None:
        super().__init__(mesh, threads)
        self.rays: Rays = []

    def over(self, mesh: TriangleMesh) -> RayRecorder:
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


def best_of(
    rounds: int, *jobs: Callable[[], Any], clock: Callable[[], float] = process_time
) -> list[float]:
    """Return the shortest time of each job [s] by a clock, CPU time, over interleaved rounds."""
    best = [math.inf] * len(jobs)
    for _ in range(rounds):
        for i, job in enumerate(jobs):
            start = clock()
            job()
            best[i] = min(best[i], clock() - start)
    return best


def replay(scene: RayScene, rays: Rays) -> None:
    """Cast recorded chunks of rays."""
    for chunk in rays:
        scene.run(*chunk)


def analog_rate(
    link: Link,
    mesh: TriangleMesh,
    photons: int = 1_500_000,
    rounds: int = 3,
) -> dict[str, Any]:
    """Return photons per CPU second against raw Embree rays per second on the same mesh.

    Raw rays are the rays of the engine without its shortcut on grids, replayed through embreex in
    the same chunks; both on one thread.

    Parameters
    ----------
    link : Link
        The link.
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
    local = frame_of(link).mesh(mesh)  # the rays are in the units of the tracer
    raw = CopiedScene(local.vertices, local.faces)
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
    sea = TypicalSea.of([mesh])
    gains, stated, setup = [], [], []
    for seed in range(seeds):
        start = process_time()
        forced = ForcedDetection(link, chains, seed, threads=1, sea=sea)
        setup.append(process_time() - start)
        parts = forced.evaluate(mesh)
        gains.append(float(parts.gain[0]))
        stated.append(float(parts.stderr[0]))
    analog = partial(run_analog, link, intersector, photons=photons, threads=1)
    times = best_of(rounds, lambda: forced.evaluate(mesh), lambda: analog(seed=1))
    sums = analog(seed=2)
    gain = float(sums.score[0]) / photons
    stderr = float(standard_error(sums.score, sums.score_squared, photons)[0])
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


def new_sea(link: Link, sea: Any, rtol: float = 0.01, rounds: int = 5) -> dict[str, Any]:
    """Return the CPU time of one thread for one gain at a relative tolerance over a new sea.

    Triangulation, chains, aiming and, where paths must be checked, the BVH are included.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel with seed
        A random sea; every round takes other phases.
    rtol : float
        Relative standard error.

    Returns
    -------
    dict
        `seconds` (median), `kept_seconds` with chains that are made already, `mesh_seconds`,
        `bvh_seconds`, `rtol` reached (largest), `chains`.
    """
    reach, chains = crossing_reach(link), 64
    rows = []
    for seed in range(rounds + 1):  # the first warms up
        start = process_time()
        mesh, _ = mesh_for(link, sea.with_seed(1000 + seed), reach=reach)
        typical, meshed = TypicalSea.of([mesh]), process_time()
        while True:
            forced = ForcedDetection(link, chains, seed, threads=1, sea=typical)
            made = process_time()
            parts = forced.evaluate(mesh)
            reached = float(parts.stderr[0]) / float(parts.gain[0])
            if reached <= rtol:
                break
            chains *= 2
        done = process_time()
        EmbreeIntersector(mesh, 1)
        built = process_time()
        kept = done - made + meshed - start
        rows.append((done - start, kept, built - start, meshed - start, built - done, reached))
    total, kept, with_bvh, mesh_time, bvh_time, _ = np.median(rows[1:], axis=0).tolist()
    return {
        "seconds": total,
        "kept_seconds": kept,
        "with_bvh_seconds": with_bvh,
        "mesh_seconds": mesh_time,
        "bvh_seconds": bvh_time,
        "rtol": max(row[-1] for row in rows[1:]),
        "chains": parts.counts["chains"],
        "facets": len(mesh.faces),
    }


def resolved_sea(
    link: Link,
    sea: Any,
    rtol: float = 0.01,
    rounds: int = 3,
    realizations: int = 16,
) -> dict[str, Any]:
    """Return the CPU time of one thread for a sea that is resolved down to the waves light feels.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel with seed
        A random sea of many waves.
    rtol : float
        Relative standard error of a gain.
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
    mesh, _ = mesh_for(link, sea, reach=reach, per_wave=FADING_SPACING)
    forced = ForcedDetection(link, chains, 1, threads=1, sea=TypicalSea.of([mesh], MANY_SEAS))
    aimed = forced.over(mesh)
    (direct,) = best_of(3, lambda: aimed.direct_gains(0, 0))
    campaign = campaign_of(link, sea, photons=chains, threads=1)
    start = process_time()
    found = campaign.gains(campaign.realizations(realizations))["gain"]
    each = (process_time() - start) / realizations
    return {
        "gain": gain,
        "seconds_per_realization": each,
        "direct_seconds": direct,
        "facets": len(mesh.faces),
        "rtol": float((stderr(found, "shift") / mean(found, "shift")).max()),
    }


_RUN = sys.executable, "-m", "meshtrace", "run"


def realization(link: Link, sea: Any, chains: int = 608, realizations: int = 64) -> dict[str, Any]:
    """Return the cost of a realization of an ensemble, on one thread.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel with seed
        A random sea.
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
    ensemble(link, realizations, sea, photons=chains, threads=1)  # compiles, too
    start = process_time()
    found = ensemble(link, realizations, sea, photons=chains, threads=1)
    seconds = process_time() - start
    return {
        "cpu_seconds": seconds / realizations,
        "rtol": float(np.sqrt(np.mean((found.gain_stderr / found.gain) ** 2))),
        "chains": chains,
        "realizations": realizations,
    }


def background_light(link: Link, sea: Any, rtol: float = 0.03) -> dict[str, Any]:
    """Return the cost of the background light over one sea at a tolerance, on one thread.

    Parameters
    ----------
    link : Link
        The link, with one receiver.
    sea : SurfaceModel
        The sea.
    rtol : float
        Relative standard error.

    Returns
    -------
    dict
        `cpu_seconds`, `rtol` reached, `rays`.
    """
    day, rays = Daylight.clear_sky(sun_zenith_deg=30.0), 256
    while True:
        work = partial(background, link, sea, day, photons=rays, threads=1)
        found = work()  # and compiles
        reached = float(found.radiance_stderr / found.radiance)
        if reached <= rtol or rays >= 2**22:
            return {"cpu_seconds": best_of(3, work)[0], "rtol": reached, "rays": rays}
        rays *= 2


def coverage_cost(
    link: Link, sea: Any, extent: float = 5.0, step: float = 0.25, rtol: float = 0.02
) -> dict[str, Any]:
    """Return the CPU time of a coverage map with a relative error in every cell.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        The sea.
    extent, step, rtol : float
        As in `coverage_map`.

    Returns
    -------
    dict
        `cells`, `photons`, `cpu_seconds` on one thread, `rtol` reached (largest, of cells above
        1 % of the highest gain).
    """
    options: Any = {"rtol": rtol, "threads": 1}
    coverage_map(link, sea, 2.0 * step, step, **options)  # compiles
    start = process_time()
    found = coverage_map(link, sea, extent, step, **options)
    seconds = process_time() - start
    reached = float(relative_errors(found.gain, found.gain_stderr).max())
    photons = found.provenance["run"]["photons"]
    size = found.gain.size
    return {"cells": size, "photons": photons, "cpu_seconds": seconds, "rtol": reached}


def first_run() -> dict[str, float]:
    """Return the time of a first `meshtrace run`, which compiles its kernels by two processes.

    Returns
    -------
    dict
        `seconds` of wall time and `cpu_seconds` with an empty cache; `warm_seconds` and
        `warm_cpu_seconds` of the same command after it.
    """
    with tempfile.TemporaryDirectory() as folder:
        own = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
        cache = {**own, "MESHTRACE_CACHE_DIR": folder}
        rows = {}
        for name in ("", "warm_"):
            before, start = os.times(), perf_counter()
            subprocess.run(_RUN, env=cache, check=True, capture_output=True)
            after, seconds = os.times(), perf_counter() - start
            user = after.children_user - before.children_user
            rows[f"{name}seconds"] = seconds
            rows[f"{name}cpu_seconds"] = user + after.children_system - before.children_system
    return rows
