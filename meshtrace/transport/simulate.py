"""One function in front of both estimators."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Literal

import numpy as np

from meshtrace.bvh import EmbreeIntersector
from meshtrace.link import Link, WaterSource
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.results.gain import GainResult, merge
from meshtrace.results.provenance import provenance
from meshtrace.results.tallies import Arrivals, standard_error
from meshtrace.transport.analog import BLOCK, MapGrid, run_analog
from meshtrace.transport.forced import ForcedDetection, crossing_reach
from meshtrace.transport.outcome import DomainWarning as DomainWarning
from meshtrace.transport.outcome import analog_result, per_receiver
from meshtrace.transport.paths import PhotonPaths, received_paths, record_paths

DEFAULT_PHOTONS = {"forced": 10_000, "analog": 1_000_000}
"""Photons of a run, by estimator; the first is the default estimator."""

_MOST_PHOTONS = {"forced": 2**20, "analog": 10**9}  # that a relative tolerance may ask for


def simulate(
    link: Link,
    surface: SurfaceModel | TriangleMesh,
    *,
    estimator: Literal["forced", "analog"] = "forced",
    photons: int | None = None,
    rtol: float | None = None,
    seed: int = 1,
    normals: Literal["vertex", "facet"] = "vertex",
    time: float = 0.0,
    extent: float | None = None,
    spacing: float | None = None,
    threads: int | None = None,
    reflected_photons: int = 0,
    batch_size: int = 2**17,
    first_photon: int = 0,
    max_surface_events: int = 10,
    max_events: int = 100_000,
    roulette: float | None = None,
    grid: MapGrid | None = None,
    keep_arrivals: bool = False,
    progress: Callable[[int], None] | None = None,
) -> GainResult:
    """Return the gain of a link over a surface.

    Parameters
    ----------
    link : Link
        The link.
    surface : SurfaceModel or TriangleMesh
        A sea, triangulated at `time` over the link's footprint, or a mesh taken as it is.
    estimator : {"forced", "analog"}
        Scattering chains aimed at the aperture, or photons followed one by one. Analog follows
        everything; forced is some 10^5 times more efficient and leaves out only light that the
        surface sends back into the water first (see `reflected_photons`).
    photons : int, optional
        Chains (forced, default 10 000) or photons (analog, default 1 000 000).
    rtol : float, optional
        Relative standard error to reach in every gain; `photons` is then the first guess.
    seed : int
        Key of the random numbers, 0 <= seed < 2^64.
    normals : {"vertex", "facet"}
        Normals interpolated from the exact slopes at the corners, or those of the facets.
    time : float
        Time of the sea [s].
    extent, spacing : float, optional
        Half-width and spacing of the mesh [m]; by default those of `link.footprint()`, where
        the mesh is coarser away from the axis.
    threads : int, optional
        Threads, all cores by default; the result does not depend on them.
    reflected_photons : int
        Forced only: analog photons that estimate the light which reached the receiver after
        the surface had sent it back into the water; it is added to the gain.
    batch_size : int
        Analog only: photons of a chunk, a multiple of 4096; no effect on the result.
    first_photon : int
        Analog only: id of the first photon; runs of disjoint ids are independent and `merge`.
    max_surface_events, max_events : int
        Analog only: crossings and collisions after which a photon is ended.
    roulette : float, optional
        Analog only: weight below which Russian roulette is played; 0 for never.
    grid : MapGrid, optional
        Analog only: cells on a plane in the air in which light is counted.
    keep_arrivals : bool
        Keep every arrival with its path lengths.
    progress : callable, optional
        Analog only: called with the number of photons done since its last call.

    Returns
    -------
    GainResult

    Raises
    ------
    ValueError
        If an option is out of range, the mesh does not cover the link, or the forced estimator
        is asked for what only the analog one follows.

    Warns
    -----
    DomainWarning
        If more than 1e-4 of the weight left the mesh sideways, or light leaked through it.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> r = mt.simulate(mt.Link(), FlatSea(), photons=4096, seed=1)
    >>> round(r.gain * 1e5, 1)
    6.0
    """
    if estimator not in DEFAULT_PHOTONS:
        allowed = " or ".join(DEFAULT_PHOTONS)
        raise ValueError(f"estimator: {estimator!r}, allowed {allowed}")
    run = {
        "estimator": estimator,
        "photons": DEFAULT_PHOTONS[estimator] if photons is None else photons,
        "rtol": rtol,
        "seed": seed,
        "normals": normals,
        "time": time,
        "extent": extent,
        "spacing": spacing,
        "threads": threads or os.cpu_count() or 1,
        "reflected_photons": reflected_photons,
        "batch_size": batch_size,
        "first_photon": first_photon,
        "max_surface_events": max_surface_events,
        "max_events": max_events,
        "roulette": roulette,
        "grid": {**asdict(grid), "axis": list(grid.axis)} if grid else None,
        "keep_arrivals": keep_arrivals,
    }
    _check(run)
    reach = None if estimator == "analog" else crossing_reach(link)
    mesh, config = mesh_for(link, surface, time, extent, spacing, reach)
    origin = provenance(link, config, run)
    if estimator == "forced":
        return _to_tolerance(
            lambda n, _: _forced(link, mesh, {**run, "photons": n}, origin, keep_arrivals), run
        )
    return _to_tolerance(
        lambda n, first: _analog(
            link,
            mesh,
            {**run, "photons": n, "first_photon": first},
            origin,
            grid,
            keep_arrivals,
            progress,
        ),
        run,
    )


def _to_tolerance(evaluate: Callable[[int, int], GainResult], run: dict[str, Any]) -> GainResult:
    """Repeat with more photons until the relative standard error is met.

    Analog photons add to those already followed; chains are drawn anew.
    """
    n, first, rtol = run["photons"], run["first_photon"], run["rtol"]
    most = _MOST_PHOTONS[run["estimator"]]
    result = evaluate(n, first)
    while rtol is not None:
        stderr, gain = result.stderrs, result.gains
        with np.errstate(divide="ignore", invalid="ignore"):
            # no hit yet is no result, not a gain of 0 +- 0
            worst = float(np.max(np.where(gain > 0.0, stderr / gain, math.inf)))
        if worst <= rtol or n >= most:
            break
        # an error of few hits is itself uncertain: never more than sixteenfold at once
        more = min(math.ceil(n * min(1.1 * (worst / rtol) ** 2, 16.0)), most)
        if run["estimator"] == "forced":
            result = evaluate(more, first)
        else:
            result = merge([result, evaluate(more - n, first + n)])
        n = more
    return result


def _analog(
    link: Link,
    mesh: TriangleMesh,
    run: dict[str, Any],
    origin: dict[str, Any],
    grid: MapGrid | None,
    keep_arrivals: bool,
    progress: Callable[[int], None] | None,
) -> GainResult:
    options = {
        name: run[name]
        for name in (
            "photons",
            "seed",
            "normals",
            "threads",
            "batch_size",
            "first_photon",
            "max_surface_events",
            "max_events",
            "roulette",
        )
    }
    sums = run_analog(
        link,
        EmbreeIntersector(mesh, run["threads"]),
        grid=grid,
        keep_arrivals=keep_arrivals,
        progress=progress,
        **options,
    )
    return analog_result(link, sums, {**origin, "run": run}, grid, keep_arrivals)


def _forced(
    link: Link,
    mesh: TriangleMesh,
    run: dict[str, Any],
    origin: dict[str, Any],
    keep_arrivals: bool,
) -> GainResult:
    forced = ForcedDetection(
        link, run["photons"], run["seed"], run["normals"], run["threads"], float(mesh.bounds[1, 2])
    )
    parts = forced.evaluate(mesh)
    gain, stderr = parts.gain, parts.stderr
    extra: dict[str, Any] = {}
    if run["reflected_photons"]:
        added, added_stderr = _reflected(link, mesh, run)
        gain, stderr = gain + added, np.hypot(stderr, added_stderr)
        extra["gain_reflected"] = per_receiver(link, added)
        extra["gain_reflected_stderr"] = per_receiver(link, added_stderr)
    if keep_arrivals:
        rows = [np.insert(rows, 0, r, axis=1) for r, rows in enumerate(forced.arrivals(mesh))]
        extra["arrivals"] = Arrivals.of_rows(np.concatenate(rows))
    return GainResult(
        gain=per_receiver(link, gain),
        gain_stderr=per_receiver(link, stderr),
        photons=parts.counts.chains,
        fates={},
        provenance={**origin, "run": run},
        gain_ballistic=per_receiver(link, parts.ballistic),
        gain_scattered=per_receiver(link, parts.scattered.mean(axis=1)),
        gain_order=parts.orders,
        chains=parts.counts._asdict(),
        **extra,
    )


def _reflected(
    link: Link, mesh: TriangleMesh, run: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the surface sent back first, by analog photons and a wider aperture.

    That light comes from everywhere below: its irradiance is even over metres, so an aperture
    of 1 m (never wider than half of what the field of view covers) has the same mean.
    """
    wide, area = [], []
    for r in link.receivers:
        half = math.radians(min(r.fov_deg, 120.0)) / 2.0
        radius = max(r.radius, min(1.0, 0.5 * getattr(r, "height", 1.0) * math.tan(half)))
        wide.append(r.model_copy(update={"radius": radius}))
        area.append((r.radius / radius) ** 2)
    sums = run_analog(
        link.model_copy(update={"receiver": tuple(wide)}),
        EmbreeIntersector(mesh, run["threads"]),
        photons=run["reflected_photons"],
        seed=run["seed"],
        normals=run["normals"],
        threads=run["threads"],
        first_scored=2,
        roulette=1e-3 * math.exp(-link.water.a * _deepest(link)),
    )
    n = sums.photons
    scale = np.array(area)
    return scale * sums.score / n, scale * standard_error(sums.score, sums.score_squared, n)


def _deepest(link: Link) -> float:
    return max((t.depth for t in link.transmitters if isinstance(t, WaterSource)), default=0.0)


def mesh_for(
    link: Link,
    surface: SurfaceModel | TriangleMesh,
    time: float = 0.0,
    extent: float | None = None,
    spacing: float | None = None,
    reach: float | None = None,
) -> tuple[TriangleMesh, dict[str, Any]]:
    """Return the mesh of a surface for a link, and what tells it apart.

    `reach` [m] is as far from the axis as light can cross to a receiver: the forced estimator
    needs no more of the surface.

    Raises
    ------
    ValueError
        If a given mesh does not reach over the sources and receivers, or the surface reaches
        a source or a receiver.
    """
    if isinstance(surface, TriangleMesh):
        mesh = surface
        digest = hashlib.sha256(
            mesh.vertices.tobytes() + mesh.faces.tobytes() + mesh.vertex_normals.tobytes()
        ).hexdigest()
        config: dict[str, Any] = {"kind": "mesh", "sha256": digest, "facets": len(mesh.faces)}
    elif isinstance(surface, SurfaceModel):
        f = link.footprint()
        if reach is not None:
            wide = max(min(reach + 2.0, f.extent), f.fine_extent + 1.0)
            f = f._replace(extent=wide, coarse_spacing=4.0 * f.spacing)
        if extent is None:
            mesh = surface.mesh(
                time,
                f.extent,
                spacing or f.spacing,
                center=f.center,
                fine_extent=f.fine_extent,
                coarse_spacing=max(f.coarse_spacing, spacing or 0.0),
            )
        else:
            mesh = surface.mesh(time, extent, spacing or f.spacing)
        config = surface.to_config()
    else:
        raise ValueError(
            f"surface: {type(surface).__name__}, allowed a sea (SurfaceModel) or a TriangleMesh"
        )
    _check_cover(link, mesh)
    return mesh, config


def _check_cover(link: Link, mesh: TriangleMesh) -> None:
    low, high = mesh.bounds
    for item in (*link.transmitters, *link.receivers):
        x, y = item.position
        if not (low[0] <= x <= high[0] and low[1] <= y <= high[1]):
            raise ValueError(
                f"mesh: covers x {low[0]:g}..{high[0]:g} m, y {low[1]:g}..{high[1]:g} m, allowed "
                f"a mesh that covers the beam: {item.kind} at ({x:g}, {y:g}) m"
            )
        depth, height = getattr(item, "depth", None), getattr(item, "height", None)
        if depth is not None and -depth >= low[2]:
            raise ValueError(
                f"{item.kind}.depth: {depth:g} m, allowed below the lowest trough, "
                f"depth > {-low[2]:.3g} m"
            )
        if height is not None and height <= high[2]:
            raise ValueError(
                f"{item.kind}.height: {height:g} m, allowed above the highest crest, "
                f"height > {high[2]:.3g} m"
            )


def _check(run: dict[str, Any]) -> None:
    """Raise ValueError naming the first option that is out of range."""
    integer = {
        "photons": (1, 2**53),
        "seed": (0, 2**64 - 1),
        "first_photon": (0, 2**53),
        "reflected_photons": (0, 2**53),
        "max_surface_events": (1, 2**31),
        "max_events": (1, 2**31),
        "batch_size": (BLOCK, 2**18),
        "threads": (1, 1024),
    }
    for name, (low, high) in integer.items():
        value = run[name]
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        if not whole or not low <= value <= high:
            raise ValueError(f"{name}: {value!r}, allowed an integer {low} <= {name} <= {high}")
    if run["batch_size"] % BLOCK:
        raise ValueError(f"batch_size: {run['batch_size']}, allowed multiples of {BLOCK}")
    if run["normals"] not in ("vertex", "facet"):
        raise ValueError(f"normals: {run['normals']!r}, allowed vertex or facet")
    if not np.isfinite(run["time"]):
        raise ValueError(f"time: {run['time']!r}, allowed a finite time [s]")
    if run["roulette"] is not None and not 0.0 <= run["roulette"] <= 1.0:
        raise ValueError(f"roulette: {run['roulette']!r}, allowed 0 <= roulette <= 1")
    if run["rtol"] is not None and not 1e-6 <= run["rtol"] <= 1.0:
        raise ValueError(f"rtol: {run['rtol']!r}, allowed 1e-6 <= rtol <= 1")


def trace_paths(
    link: Link,
    surface: SurfaceModel | TriangleMesh,
    n: int = 1000,
    *,
    received_only: bool = False,
    seed: int = 1,
    normals: Literal["vertex", "facet"] = "vertex",
    time: float = 0.0,
    extent: float | None = None,
    spacing: float | None = None,
    max_vertices: int = 64,
) -> PhotonPaths:
    """Return paths of photons for the eye; no tally is changed by it.

    Parameters
    ----------
    link : Link
        The link.
    surface : SurfaceModel or TriangleMesh
        The surface, as in `simulate`.
    n : int
        Photons, 1 <= n <= 100 000.
    received_only : bool
        Paths of light that reaches the first receiver, sampled by forced detection in
        proportion to the light they carry, instead of the first n analog photons.
    seed, normals, time, extent, spacing
        As in `simulate`.
    max_vertices : int
        Vertices kept of a photon.

    Returns
    -------
    PhotonPaths
    """
    if not 1 <= n <= 100_000:
        raise ValueError(f"n: {n!r}, allowed 1 <= n <= 100000")
    mesh, _ = mesh_for(link, surface, time, extent, spacing)
    if received_only:
        return received_paths(link, mesh, n, seed, normals)
    return record_paths(link, mesh, n, seed, normals, max_vertices)
