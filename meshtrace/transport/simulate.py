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
from meshtrace.errors import Described, Refused
from meshtrace.link import Link, WaterSource
from meshtrace.link.link import Footprint
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.results.gain import GainResult, merge
from meshtrace.results.provenance import provenance
from meshtrace.results.tallies import Arrivals, standard_error
from meshtrace.transport.analog import BLOCK, MapGrid, run_analog
from meshtrace.transport.forced import ForcedDetection
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.outcome import DomainWarning as DomainWarning
from meshtrace.transport.outcome import FewSamplesWarning as FewSamplesWarning
from meshtrace.transport.outcome import (
    analog_result,
    bound_of_dark,
    per_receiver,
    warn_of_cut,
    warn_of_few,
    warn_of_returned,
)
from meshtrace.transport.paths import PhotonPaths, received_paths, record_paths

DEFAULT_PHOTONS = {"forced": 10_000, "analog": 1_000_000}
"""Photons of a run, by estimator; the first is the default estimator."""

_MOST_FACETS = 8e6
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
        surface sends back into the water first (see `reflected_photons`): some 1e-4 of the gain in
        clear sea water, up to 1 % where water scatters backwards strongly; it warns beyond 0.1 %.
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
        raise Refused("estimator", estimator, str(allowed))
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
    warn_of_few(parts)
    if not run["reflected_photons"]:
        warn_of_returned(link)
    warn_of_cut(forced, mesh)
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
        gain_bound=bound_of_dark(link, gain, run["photons"]),
        photons=run["photons"],
        fates={},
        provenance={**origin, "run": run, "scattered": parts.method},
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
            far = math.dist(f.center, link.origin)
            wide = max(
                min(reach + far + 20.0 * f.spacing, f.extent), f.fine_extent + 10.0 * f.spacing
            )
            f = f._replace(extent=wide, coarse_spacing=4.0 * f.spacing)
        _require_size(f, extent, spacing)
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
            mesh = surface.mesh(time, extent, spacing or f.spacing, center=link.origin)
        config = surface.to_config()
    else:
        raise Refused("surface", type(surface).__name__, "a sea (SurfaceModel) or a TriangleMesh")
    _check_cover(link, mesh)
    return mesh, config


def _require_size(f: Footprint, extent: float | None, spacing: float | None) -> None:
    """Refuse a mesh of more facets than memory and time allow, before it is made."""
    fine = spacing or f.spacing
    if extent is not None:
        facets = 2.0 * (2.0 * extent / fine) ** 2
    else:
        coarse = max(f.coarse_spacing, fine)
        facets = 8.0 * ((f.fine_extent / fine) ** 2 + (f.extent / coarse) ** 2)
    if facets > _MOST_FACETS:
        size = Described(f"{facets / 1e6:.3g} million facets, some {facets * 250e-9:.2g} GB")
        allowed = f"at most {_MOST_FACETS / 1e6:g} million facets; larger spacing or smaller extent"
        raise Refused("mesh", size, allowed)


def _check_cover(link: Link, mesh: TriangleMesh) -> None:
    low, high = mesh.bounds
    for path, item in link.items():
        x, y, z = item.center
        if not (low[0] <= x <= high[0] and low[1] <= y <= high[1]):
            covered = f"covers x {low[0]:g}..{high[0]:g} m, y {low[1]:g}..{high[1]:g} m"
            allowed = f"a mesh that covers the beam: {path} at ({x:g}, {y:g}) m"
            raise Refused("mesh", Described(covered), allowed)
        if z < 0.0 and z >= low[2]:
            allowed = f"below the lowest trough, depth > {-low[2]:.3g} m"
            raise Refused(f"{path}.depth", Described(f"{-z:g} m"), allowed)
        if z > 0.0 and z <= high[2]:
            allowed = f"above the highest crest, height > {high[2]:.3g} m"
            raise Refused(f"{path}.height", Described(f"{z:g} m"), allowed)


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
            raise Refused(name, value, f"an integer {low} <= {name} <= {high}")
    if run["batch_size"] % BLOCK:
        raise Refused("batch_size", run["batch_size"], f"multiples of {BLOCK}")
    if run["normals"] not in ("vertex", "facet"):
        raise Refused("normals", run["normals"], "vertex or facet")
    if not np.isfinite(run["time"]):
        raise Refused("time", run["time"], "a finite time [s]")
    if run["roulette"] is not None and not 0.0 <= run["roulette"] <= 1.0:
        raise Refused("roulette", run["roulette"], "0 <= roulette <= 1")
    if run["rtol"] is not None and not 1e-6 <= run["rtol"] <= 1.0:
        raise Refused("rtol", run["rtol"], "1e-6 <= rtol <= 1")


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
        raise Refused("n", n, "1 <= n <= 100000")
    mesh, _ = mesh_for(link, surface, time, extent, spacing)
    if received_only:
        return received_paths(link, mesh, n, seed, normals)
    return record_paths(link, mesh, n, seed, normals, max_vertices)
