"""How fast the analog engine is: against raw Embree rays, and against the plain tracer.

Engine and yardstick alternate, and the best of several rounds counts for both, so that a busy
machine slows both alike. Raw rays are those that the engine cast, replayed in its own chunks on
all threads.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plain_tracer import plain_gain

import meshtrace as mt
from meshtrace.bvh import EmbreeIntersector
from meshtrace.simulate import mesh_for
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.transport.analog import run_analog

Rays = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


class RayRecorder:
    """An intersector that keeps the rays it is asked for."""

    def __init__(self, intersector: EmbreeIntersector) -> None:
        self.mesh = intersector.mesh
        self.rays: Rays = []
        self._intersector = intersector

    def facets(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        """Return the facets and keep the rays."""
        self.rays.append((origins.copy(), directions.copy()))
        return self._intersector.facets(origins, directions)

    def intersect(self, origins: Any, directions: Any) -> Any:
        """Pass on what is not asked for photons."""
        return self._intersector.intersect(origins, directions)


def default_mesh(link: mt.Link) -> mt.TriangleMesh:
    """Return the 13 m/s sea over the footprint of a link."""
    return mesh_for(link, JonswapSea(wind_speed=13.0, seed=7))[0]


def best_of(rounds: int, *jobs: Callable[[], Any]) -> list[float]:
    """Return the shortest time of each job; they take turns."""
    best = [math.inf] * len(jobs)
    for _ in range(rounds):
        for i, job in enumerate(jobs):
            start = perf_counter()
            job()
            best[i] = min(best[i], perf_counter() - start)
    return best


def replay(intersector: EmbreeIntersector, rays: Rays, threads: int) -> None:
    """Cast recorded chunks of rays on all threads."""
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda chunk: intersector.facets(*chunk), rays))


def measure(
    photons: int = 1_500_000, rounds: int = 3, threads: int | None = None
) -> dict[str, Any]:
    """Return photons per second, raw rays per second and their ratio.

    Parameters
    ----------
    photons : int
        Photons of each round.
    rounds : int
        Rounds, of which the best counts.
    threads : int, optional
        Threads on both sides, all by default.

    Returns
    -------
    dict
        `photons_per_s`, `rays_per_s`, `ratio` (photons per raw ray), `rays_per_photon`,
        `threads`, `facets`, `seconds`.
    """
    threads = threads or os.cpu_count() or 1
    link = mt.Link()
    mesh = default_mesh(link)
    intersector = EmbreeIntersector(mesh, threads)
    recorder = RayRecorder(intersector)
    recorded = min(photons, 2**18)
    run_analog(link, recorder, photons=recorded, seed=1)
    n_rays = sum(len(o) for o, _ in recorder.rays)
    # as long as the run itself: a short job finds a quiet moment on a busy machine
    again = max(4 * photons // recorded, 1)
    times = best_of(
        rounds,
        lambda: run_analog(link, intersector, photons=photons, seed=1, threads=threads),
        lambda: replay(intersector, recorder.rays * again, threads),
    )
    photon_rate, ray_rate = photons / times[0], n_rays * again / times[1]
    return {
        "photons_per_s": photon_rate,
        "rays_per_s": ray_rate,
        "ratio": photon_rate / ray_rate,
        "rays_per_photon": n_rays / recorded,
        "threads": threads,
        "facets": len(mesh.faces),
        "seconds": times,
    }


def measure_against_plain(
    photons: int = 1_000_000, plain_photons: int = 100_000, rounds: int = 2
) -> dict[str, Any]:
    """Return the rates of engine and plain tracer on the default link, and their ratio."""
    link = mt.Link()
    mesh = default_mesh(link)
    threads = os.cpu_count() or 1
    intersector = EmbreeIntersector(mesh, threads)
    run_analog(link, intersector, photons=4096, seed=1)
    times = best_of(
        rounds,
        lambda: run_analog(
            link, intersector, photons=photons, seed=1, normals="facet", threads=threads
        ),
        lambda: plain_gain(link, mesh, plain_photons, seed=1),
    )
    rates = photons / times[0], plain_photons / times[1]
    return {
        "photons_per_s": rates[0],
        "plain_photons_per_s": rates[1],
        "speedup": rates[0] / rates[1],
        "seconds": times,
    }


def peak_memory(photons: int) -> int:
    """Return the peak resident memory [bytes] of a fresh process that follows photons."""
    done = subprocess.run(
        [sys.executable, __file__, str(photons)], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


def _follow(photons: int) -> int:
    mt.simulate(mt.Link(), FlatSea(), estimator="analog", photons=photons, seed=1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024)


if __name__ == "__main__":
    print(_follow(int(sys.argv[1])))
