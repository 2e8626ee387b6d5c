"""Studies of many surfaces: moving seas, ensembles, coverage of a plane."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, islice
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.link import Link, Receiver
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.results.coverage import CoverageMap
from meshtrace.results.provenance import provenance
from meshtrace.results.series import GainSeries
from meshtrace.stored import SHIFTS
from meshtrace.transport.analog import MapGrid
from meshtrace.transport.forced import ForcedDetection, Parts, crossing_reach
from meshtrace.transport.simulate import mesh_for, simulate


@runtime_checkable
class RandomSea(SurfaceModel, Protocol):
    """A sea whose phases come from a seed."""

    def with_seed(self, seed: int) -> RandomSea:
        """Return the same sea with other phases."""
        ...


def time_series(
    link: Link,
    sea: SurfaceModel,
    times: ArrayLike,
    *,
    photons: int = 2048,
    seed: int = 1,
    normals: Literal["vertex", "facet"] = "vertex",
    extent: float | None = None,
    spacing: float | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> GainSeries:
    """Return the gain over a moving sea, by forced detection with one set of chains.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        The sea; its phases stay, time moves its waves.
    times : array_like, shape (n,)
        Times [s].
    photons : int
        Chains, common to all times.
    seed, normals, extent, spacing, threads
        As in `simulate`; the result does not depend on the threads.
    progress : callable, optional
        Called with 1 after each time.

    Returns
    -------
    GainSeries

    Notes
    -----
    All times share the chains: the Monte Carlo noise is common to them and cancels in
    differences.
    """
    times = np.atleast_1d(np.asarray(times, dtype=float))
    if times.ndim != 1 or not times.size or not np.isfinite(times).all():
        raise ValueError(f"times: shape {times.shape}, allowed finite times (n,) [s], n >= 1")
    run = _run(photons, seed, normals, extent, spacing)
    reach = crossing_reach(link)
    meshes = (mesh_for(link, sea, float(t), extent, spacing, reach)[0] for t in times)
    return _series(
        link, meshes, "time", times, run, threads, provenance(link, sea.to_config(), run), progress
    )


def ensemble(
    link: Link,
    n_realizations: int,
    sea: SurfaceModel | None = None,
    *,
    wind_speed: float = 5.0,
    photons: int = 2048,
    seed: int = 1,
    normals: Literal["vertex", "facet"] = "vertex",
    time: float = 0.0,
    extent: float | None = None,
    spacing: float | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> GainSeries:
    """Return the gains over independent realizations of a sea, by forced detection.

    Parameters
    ----------
    link : Link
        The link.
    n_realizations : int
        Realizations, each with its own random phases.
    sea : SurfaceModel with seed, optional
        The sea; a JONSWAP sea of `wind_speed` [m s-1] by default.
    photons : int
        Chains, common to all realizations.
    seed : int
        Seed of the chains and, by `numpy.random.SeedSequence([seed, i])`, of the phases of
        realization i.
    normals, time, extent, spacing, threads
        As in `simulate`; the result does not depend on the threads.
    progress : callable, optional
        Called with 1 after each realization.

    Returns
    -------
    GainSeries
    """
    _check_integer("n_realizations", n_realizations, 1, 10_000_000)
    run = _run(photons, seed, normals, extent, spacing)
    if sea is None:
        from meshtrace.scenario import Scenario

        sea = Scenario.from_config({"wind_speed": wind_speed}).surface
    if not isinstance(sea, RandomSea):
        raise ValueError(f"sea: {type(sea).__name__}, allowed a sea with random phases")
    seeds = np.array(
        [np.random.SeedSequence([seed, i]).generate_state(1)[0] for i in range(n_realizations)],
        np.int64,
    )
    reach = crossing_reach(link)
    meshes = (mesh_for(link, sea.with_seed(int(s)), time, extent, spacing, reach)[0] for s in seeds)
    origin = provenance(link, sea.to_config(), {**run, "time": time})
    return _series(link, meshes, "realization", seeds, run, threads, origin, progress)


def _run(
    photons: int, seed: int, normals: str, extent: float | None, spacing: float | None
) -> dict[str, Any]:
    """Return the options of a run over many seas, refusing what is out of range."""
    _check_integer("photons", photons, 1, 2**53)
    _check_integer("seed", seed, 0, 2**64 - 1)
    if normals not in ("vertex", "facet"):
        raise ValueError(f"normals: {normals!r}, allowed vertex or facet")
    return {
        "estimator": "forced",
        "photons": photons,
        "seed": seed,
        "normals": normals,
        "extent": extent,
        "spacing": spacing,
    }


def _check_integer(name: str, value: int, low: int, high: int) -> None:
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or not low <= value <= high:
        raise ValueError(f"{name}: {value!r}, allowed an integer {low} <= {name} <= {high}")


def _series(
    link: Link,
    meshes: Iterator[TriangleMesh],
    along: Literal["time", "realization"],
    coordinate: NDArray[Any],
    run: dict[str, Any],
    threads: int | None,
    origin: dict[str, Any],
    progress: Callable[[int], None] | None,
) -> GainSeries:
    threads = threads or os.cpu_count() or 1
    first = list(islice(meshes, 4))
    crest = 1.5 * max(float(mesh.bounds[1, 2]) for mesh in first)
    forced = ForcedDetection(link, run["photons"], run["seed"], run["normals"], crest=crest)
    meshes = chain(first, meshes)
    n, n_rx = len(coordinate), len(link.receivers)
    gain, stderr, ballistic = (np.empty((n, n_rx)) for _ in range(3))
    shifts = np.zeros((n_rx, SHIFTS))
    with ThreadPoolExecutor(threads) as pool:
        for i, parts in enumerate(_evaluated(pool, forced, meshes, threads)):
            gain[i], stderr[i], ballistic[i] = parts.gain, parts.stderr, parts.ballistic
            shifts += parts.shifts
            if progress is not None:
                progress(1)
    mean_stderr = (shifts / max(n, 1)).std(axis=1, ddof=1) / np.sqrt(SHIFTS)
    if not isinstance(link.receiver, tuple):
        return GainSeries(
            along,
            coordinate,
            gain[:, 0],
            stderr[:, 0],
            ballistic[:, 0],
            float(mean_stderr[0]),
            origin,
        )
    return GainSeries(along, coordinate, gain, stderr, ballistic, mean_stderr, origin)


def _evaluated(
    pool: ThreadPoolExecutor, forced: ForcedDetection, meshes: Iterator[TriangleMesh], ahead: int
) -> Iterator[Parts]:
    """Yield the parts of each mesh in order while a few are computed: memory stays flat."""
    running = [pool.submit(forced.evaluate, mesh) for mesh in islice(meshes, ahead + 1)]
    while running:
        parts = running.pop(0).result()
        for mesh in islice(meshes, 1):
            running.append(pool.submit(forced.evaluate, mesh))
        yield parts


def coverage_map(
    link: Link,
    sea: SurfaceModel | TriangleMesh,
    extent: float = 5.0,
    step: float = 0.25,
    *,
    times: Sequence[float] = (0.0,),
    photons: int = 4_000_000,
    seed: int = 1,
    normals: Literal["vertex", "facet"] = "vertex",
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> CoverageMap:
    """Return the gain over the plane of the receiver, by analog photons.

    Every photon that leaves the sea lands somewhere on the plane: one run maps it all.

    Parameters
    ----------
    link : Link
        The link; height, radius, field of view and tilt of its (first) receiver are used.
    sea : SurfaceModel or TriangleMesh
        The surface.
    extent : float
        The map covers |x|, |y| <= extent [m].
    step : float
        Edge of a cell [m]; the gain is the mean over the cell, so that a step below the
        aperture's diameter resolves nothing more.
    times : sequence of float
        Times [s] over which the map is averaged.
    photons : int
        Photons for each time.
    seed, normals, threads, progress
        As in `simulate`.

    Returns
    -------
    CoverageMap
    """
    receiver = next((r for r in link.receivers if isinstance(r, Receiver)), None)
    if receiver is None:
        raise ValueError("receiver: none in the air, allowed a link with one")
    if not len(times):
        raise ValueError("times: (), allowed one or more times [s]")
    if not 0.0 < step <= extent:
        raise ValueError(f"step: {step!r}, allowed 0 < step <= extent = {extent:g} m")
    grid = MapGrid(receiver.height, extent, step, receiver.axis, receiver.fov_deg)
    runs = [
        simulate(
            link,
            sea,
            estimator="analog",
            photons=photons,
            seed=seed,
            time=time,
            normals=normals,
            first_photon=i * photons,
            threads=threads,
            grid=grid,
            progress=progress,
        )
        for i, time in enumerate(times)
    ]
    area = np.pi * receiver.radius**2
    maps = [r.map for r in runs if r.map is not None]
    mean = np.mean([m.irradiance for m in maps], axis=0)
    error = np.sqrt(np.mean([m.irradiance_stderr**2 for m in maps], axis=0))
    return CoverageMap(
        maps[0].x,
        maps[0].y,
        area * mean,
        area * error / np.sqrt(len(maps)),
        {**runs[0].provenance, "times": [float(t) for t in times]},
    )
