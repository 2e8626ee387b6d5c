"""The gain at each place of the plane of the receiver."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from meshtrace.errors import Described, Refused, require_finite, require_whole
from meshtrace.link import Link, Receiver, WaterReceiver
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.results.coverage import CoverageMap
from meshtrace.results.gain import GainResult, merge
from meshtrace.scenario import Scenario
from meshtrace.transport.case import resolve
from meshtrace.transport.options import Analog, IrradianceMap
from meshtrace.transport.simulate import simulate

_DARK = 0.01  # of the highest gain, below which a cell is not resolved to `rtol`
_MOST_AT_ONCE = 16.0  # times the photons: an error of few hits is uncertain itself


def coverage_map(
    link: Link | Scenario,
    surface: SurfaceModel | TriangleMesh | None = None,
    extent: float = 5.0,
    step: float = 0.25,
    *,
    times: Sequence[float] = (0.0,),
    photons: int = 4_000_000,
    rtol: float | None = None,
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
    rtol : float, optional
        Standard error to reach in every cell, relative to its gain, or to a hundredth of the
        highest gain where it is darker; `photons` is then the first guess, and each time takes at
        most 10^9.
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
    if rtol is not None and not 0.0 < rtol < math.inf:
        raise Refused("rtol", rtol, "a finite number > 0")
    at = require_finite(times, "times", "one or more times [s]").tolist()
    view = {"axis": receiver.axis, "fov_deg": receiver.fov_deg}
    grid = IrradianceMap(height=receiver.center[2], extent=extent, step=step, **view)

    def run(n: int, first: int) -> list[GainResult]:
        """Return the maps of n photons at each time, from the photon id `first` on."""
        return [
            simulate(
                link, case.surface, "analog", photons=n, seed=case.run.seed,
                threads=case.run.threads, mesh=case.meshing.replace(time=time),
                first_photon=first + i * n, record=[grid], progress=progress,
            )
            for i, time in enumerate(at)
        ]  # fmt: skip

    runs, area = run(photons, 0), np.pi * receiver.radius**2
    found = _mean(runs, at, area)
    while rtol is not None and photons < Analog.most_photons:
        lack = (_largest_error(found) / rtol) ** 2
        if lack <= 1.0:
            break
        more = math.ceil(photons * min(1.1 * lack, _MOST_AT_ONCE)) - photons
        more = min(more, Analog.most_photons - photons)
        added = run(more, len(at) * photons)
        runs = [merge([a, b]) for a, b in zip(runs, added, strict=True)]
        photons += more
        found = _mean(runs, at, area)
    return found


def _mean(runs: list[GainResult], times: list[float], area: float) -> CoverageMap:
    """Return the mean over the times of gains of an aperture."""
    maps = [r.map for r in runs if r.map is not None]
    mean = np.mean([m.irradiance for m in maps], axis=0)
    error = np.sqrt(np.mean([m.irradiance_stderr**2 for m in maps], axis=0))
    stderr, origin = area * error / np.sqrt(len(maps)), {**runs[0].provenance, "times": times}
    return CoverageMap(maps[0].x, maps[0].y, area * mean, stderr, origin)


def _largest_error(found: CoverageMap) -> float:
    """Return the largest error of a cell over its gain, or over a share of the highest gain."""
    highest = float(found.gain.max())
    if highest == 0.0:
        return math.inf
    return float(np.max(found.gain_stderr / np.maximum(found.gain, _DARK * highest)))
