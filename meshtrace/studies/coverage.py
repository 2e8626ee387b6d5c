"""The gain at each place of the plane of the receiver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from meshtrace.errors import Described, Refused, require_finite, require_whole
from meshtrace.link import Link, Receiver, WaterReceiver
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.results.coverage import CoverageMap
from meshtrace.scenario import Scenario
from meshtrace.transport.case import resolve
from meshtrace.transport.options import IrradianceMap
from meshtrace.transport.simulate import simulate


def coverage_map(
    link: Link | Scenario,
    surface: SurfaceModel | TriangleMesh | None = None,
    extent: float = 5.0,
    step: float = 0.25,
    *,
    times: Sequence[float] = (0.0,),
    photons: int = 4_000_000,
    seed: int | None = None,
    normals: Literal["vertex", "facet"] | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> CoverageMap:
    """Return the gain over the plane of the receiver, by analog photons.

    Every photon that leaves the sea, or goes down, passes the plane somewhere: one run maps it
    all.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario; height or depth, radius, field of view and tilt of the (first)
        receiver are used.
    surface : SurfaceModel or TriangleMesh, optional
        The surface; by default that of the scenario.
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
    given = {"seed": seed, "normals": normals, "threads": threads}
    options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    case = resolve(link, surface).with_options(**options)
    link = case.link
    kinds = (Receiver, WaterReceiver)
    receiver = next((r for r in link.receivers if isinstance(r, kinds)), None)
    if receiver is None:
        raise Refused("receiver", Described("no receiver"), "a Receiver or a WaterReceiver")
    require_whole(photons, 1, 2**53, "photons")
    at = require_finite(times, "times", "one or more times [s]").tolist()
    view = {"axis": receiver.axis, "fov_deg": receiver.fov_deg}
    grid = IrradianceMap(height=receiver.center[2], extent=extent, step=step, **view)
    runs = [
        simulate(
            link, case.surface, "analog", photons=photons, seed=case.run.seed,
            threads=case.run.threads, mesh=case.meshing.replace(time=time),
            first_photon=i * photons, record=[grid], progress=progress,
        )
        for i, time in enumerate(at)
    ]  # fmt: skip
    area, origin = np.pi * receiver.radius**2, {**runs[0].provenance, "times": at}
    maps = [r.map for r in runs if r.map is not None]
    mean = np.mean([m.irradiance for m in maps], axis=0)
    error = np.sqrt(np.mean([m.irradiance_stderr**2 for m in maps], axis=0))
    stderr = area * error / np.sqrt(len(maps))
    return CoverageMap(maps[0].x, maps[0].y, area * mean, stderr, origin)
