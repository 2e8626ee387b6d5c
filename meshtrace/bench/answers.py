"""Time of whole answers: realizations, background light, a coverage map, the first run."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from time import perf_counter, process_time
from typing import Any

import numpy as np

from meshtrace.daylight.light import Daylight
from meshtrace.engine.backward.background import background
from meshtrace.link import Link
from meshtrace.results.coverage import relative_errors
from meshtrace.studies.coverage import coverage_map
from meshtrace.studies.series import ensemble

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
    background(link, sea, day, photons=rays, threads=1)  # compiles
    while True:
        start = process_time()
        found = background(link, sea, day, photons=rays, threads=1)
        seconds = process_time() - start
        reached = float(found.radiance_stderr / found.radiance)
        if reached <= rtol or rays >= 2**22:
            return {"cpu_seconds": seconds, "rtol": reached, "rays": rays}
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
