"""Gain at each place of the plane of the receiver."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused, require_finite, require_whole
from meshtrace.link import Link, Receiver, WaterReceiver
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.parallel import default_threads
from meshtrace.results.coverage import CoverageMap
from meshtrace.results.gain import GainResult, merge
from meshtrace.results.provenance import provenance
from meshtrace.scenario import Scenario
from meshtrace.transport.case import Case, resolve
from meshtrace.transport.coverage import ForcedMap, Grid, require_mappable
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import mesh_for
from meshtrace.transport.options import Analog, IrradianceMap
from meshtrace.transport.outcome import FewSamplesWarning, largest_weight, warn_of_omitted
from meshtrace.transport.simulate import simulate

_DARK = 0.01  # of the highest gain, below which a cell is not resolved to `rtol`
_BOUND_PHOTONS = 2**20  # analog, where chains bring no light
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
    """Return the gain over the plane of the receiver.

    Without `rtol` by analog photons: every photon that leaves the sea, or goes down, passes the
    plane somewhere, so that one run maps it all. With `rtol` by forced detection, see Notes.

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
        Standard error to reach in every cell, relative to its gain, > 0.
    seed, normals, threads
        As in `simulate`.
    progress : callable, optional
        Called with the number of photons followed since its last call, or of finished cells.

    Returns
    -------
    CoverageMap

    Warns
    -----
    FewSamplesWarning
        If cells have not reached `rtol` with the most samples.

    Notes
    -----
    Forced detection uses the same chains in all cells, so that their errors are correlated. Each
    cell takes the number of chains that it needs, up to 2^20, and cells that may have the highest
    gain up to 64 times as many, until its place is resolved; the number of chains times cells,
    of crossings on still water that were interpolated between nodes and searched, and of
    searches of all facets are in `provenance["chains"]`. Light that the surface first reflects
    into the water is left out, see `Forced`.

    Links that chains do not follow (receivers in the water or tilted, extended sources, water with
    a bottom or of too many scatterings, surfaces that overhang) and scenarios that name the
    analog estimator take analog photons with `rtol`, too: `photons` is the first guess, each time
    takes at most 10^9, and cells darker than a hundredth of the highest gain reach `rtol` of that.
    Dark cells have an upper bound, `gain_bound`.
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
    mapped = _Mapped(case, receiver, grid, at)
    if rtol is not None and not isinstance(case.run.estimator, Analog):
        try:
            return mapped.forced(rtol, progress)
        except Refused:  # a feature that chains do not follow
            pass
    return mapped.analog(photons, rtol, progress)


class _Mapped(NamedTuple):
    """Link, surface and options of a map, its receiver, cells and times."""

    case: Case
    receiver: Receiver | WaterReceiver
    grid: IrradianceMap
    times: list[float]

    def forced(self, rtol: float, progress: Callable[[int], None] | None) -> CoverageMap:
        """Return the map by forced detection."""
        case, receiver, grid, times = self
        link = case.link.replace(receiver=receiver)
        require_mappable(link)
        cells = Grid(grid.extent, grid.step)
        sides = (-cells.extent, 2.0 * cells.half - cells.extent)
        corners = link.replace(
            receiver=tuple(receiver.replace(position=(x, y)) for x in sides for y in sides)
        )
        reach, meshes = crossing_reach(corners), []
        for time in times:
            mesh, config = mesh_for(corners, case.surface, case.meshing.replace(time=time), reach)
            meshes.append(mesh)
        threads = default_threads(case.run.threads)
        forced = ForcedMap(link, meshes, cells, case.run.seed, case.meshing.normals, threads)
        gain, stderr = forced.run(rtol, progress)
        _warn_of_lack(forced.lacking, gain.size, rtol)
        run = {
            **case.run.to_config(),
            "rtol": rtol,
            **case.meshing.model_dump(),
            "record": [grid.model_dump()],
        }
        origin = {**provenance(link, config, run), **case.origin, "times": times}
        origin["chains"] = forced.counts
        warn_of_omitted(corners, gain[[0, 0, -1, -1], [0, -1, 0, -1]])
        axis = np.asarray(-grid.extent + grid.step * (np.arange(grid.n) + 0.5), np.float64)
        bound = None
        if not (gain > 0.0).all():
            limit = self._bound(self.analog(_BOUND_PHOTONS), _BOUND_PHOTONS)
            bound = np.where(gain > 0.0, np.nan, limit)
        return CoverageMap(axis, axis, gain, stderr, origin, bound)

    def analog(
        self,
        photons: int,
        rtol: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> CoverageMap:
        """Return the map by analog photons."""
        case, receiver, grid, times = self

        def run(n: int, first: int) -> list[GainResult]:
            """Return the maps of n photons at each time, from the photon id `first` on."""
            return [
                simulate(
                    case.link, case.surface, "analog", photons=n, seed=case.run.seed,
                    threads=case.run.threads, mesh=case.meshing.replace(time=time),
                    first_photon=first + i * n, record=[grid], progress=progress,
                )
                for i, time in enumerate(times)
            ]  # fmt: skip

        runs, area = run(photons, 0), np.pi * receiver.radius**2
        found = _mean(runs, times, area)
        while rtol is not None and photons < Analog.most_photons:
            lack = (float(_errors(found).max()) / rtol) ** 2
            if lack <= 1.0:
                break
            more = math.ceil(photons * min(1.1 * lack, _MOST_AT_ONCE)) - photons
            more = min(more, Analog.most_photons - photons)
            added = run(more, len(times) * photons)
            runs = [merge([a, b]) for a, b in zip(runs, added, strict=True)]
            photons += more
            found = _mean(runs, times, area)
        if rtol is None:
            return found
        _warn_of_lack(int((_errors(found) > rtol).sum()), found.gain.size, rtol)
        if (found.gain > 0.0).all():
            return found
        limit = self._bound(found, photons)
        return replace(found, gain_bound=np.where(found.gain > 0.0, np.nan, limit))

    def _bound(self, found: CoverageMap, photons: int) -> NDArray[np.float64]:
        """Return upper bounds of the gains of analog photons at each time, 95 % confidence.

        No photon scores more than its largest weight w times the aperture over the cell; with
        mean m and standard error s the bound is m + 2 s + 3 w / n (rule of three).
        """
        weight = largest_weight(self.case.link, 0.0)
        most = weight * np.pi * self.receiver.radius**2 / self.grid.step**2
        return found.gain + 2.0 * found.gain_stderr + 3.0 * most / (photons * len(self.times))


def _mean(runs: list[GainResult], times: list[float], area: float) -> CoverageMap:
    """Return the mean over the times of gains of an aperture."""
    maps = [r.map for r in runs if r.map is not None]
    mean = np.mean([m.irradiance for m in maps], axis=0)
    error = np.sqrt(np.mean([m.irradiance_stderr**2 for m in maps], axis=0))
    stderr, origin = area * error / np.sqrt(len(maps)), {**runs[0].provenance, "times": times}
    return CoverageMap(maps[0].x, maps[0].y, area * mean, stderr, origin)


def _errors(found: CoverageMap) -> NDArray[np.float64]:
    """Return the errors of cells over their gains, or over a share of the highest gain."""
    highest = float(found.gain.max())
    if highest == 0.0:
        return np.full(found.gain.shape, math.inf)
    return np.asarray(found.gain_stderr / np.maximum(found.gain, _DARK * highest))


def _warn_of_lack(cells: int, of: int, rtol: float) -> None:
    """Warn of cells above the tolerance after the most samples."""
    if cells:
        warnings.warn(
            f"rtol: {cells} of {of} cells have not reached {rtol:g} with the most samples",
            FewSamplesWarning,
            stacklevel=4,
        )
