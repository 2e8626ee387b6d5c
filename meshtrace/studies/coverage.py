"""Gain at each place of the plane of the receiver."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains.maps import unscattered_map
from meshtrace.engine.outcome import (
    FewSamplesWarning,
    analog_result,
    irradiance_map,
    largest_weight,
    warn_of_dark_map,
    warn_of_lost,
)
from meshtrace.engine.photons.analog import FixedPointSum, PhotonSums, run_analog
from meshtrace.engine.setup.meshing import mesh_for, surface_config
from meshtrace.engine.setup.options import (
    Analog,
    Case,
    IrradianceMap,
    RunOptions,
    require_options,
    resolve,
)
from meshtrace.errors import Described, Refused, require_finite, require_whole
from meshtrace.link import Link, Receiver, WaterReceiver
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.coverage import CoverageMap, relative_errors
from meshtrace.results.provenance import provenance
from meshtrace.scenario import Scenario
from meshtrace.studies.store import Item, Kept, Store

_FIRST_PHOTONS = 2**20  # at most, before the first comparison with `rtol`
_MOST_AT_ONCE = 16.0  # times the photons: an error of few hits is uncertain itself
_MESHES = 4  # that are kept for further photons


def coverage_map(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    extent: float = 5.0,
    step: float = 0.25,
    *,
    times: Sequence[float] | None = None,
    photons: int = 4_000_000,
    rtol: float | None = None,
    **run: Unpack[RunOptions],
) -> CoverageMap:
    r"""Return the gain over the plane of the receiver.

    By analog photons: every photon that leaves the sea, or goes down, passes the plane somewhere,
    so that one run maps it all. With `rtol` they carry scattered and reflected light alone, see
    Notes.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario; height or depth, radius, field of view and tilt of the (first)
        receiver are used.
    surface : MeshSource or TriangleMesh, optional
        The surface; by default that of the scenario.
    extent : float
        Half-width of the map [m]. It covers |x|, |y| <= extent.
    step : float
        Edge of a cell [m]. The gain is the mean over the cell, so that a step below the
        aperture's diameter resolves nothing more.
    times : sequence of float, optional
        Times [s] over which the map is averaged; by default 0, or that of the scenario.
    photons : int
        Photons for each time; with `rtol` the first guess, of which 2^20 count.
    rtol : float, optional
        Relative standard error > 0 to reach in every cell by more photons; unscattered light is
        exact where its image is known. Cells darker than a hundredth of the highest gain reach
        `rtol` of that.
    **run
        Options of the run, see `RunOptions`. The store keeps the photons of each time, which a
        smaller `rtol` uses again; progress is by the photons followed since the last call.

    Returns
    -------
    CoverageMap

    Warns
    -----
    FewSamplesWarning
        If cells have not reached `rtol` with the most photons, 10^9 for each time.

    Notes
    -----
    With `rtol` the gain of a cell is

    .. math:: h = h_0 + \frac{1}{N} \sum_i w_i, \qquad
        s^2 = \frac{1}{N} \left(\frac{1}{N} \sum_i w_i^2 - (h - h_0)^2\right)
        + \left(\frac{1}{N} \frac{\sum_M w_i^2}{\sum_M w_i}\right)^2,

    with h_0 the unscattered light: the sum over the images of all facets, which has no noise.
    w_i are the scores of photons that have scattered, met the bottom or been reflected before they
    leave the water, N their number. The last term, one typical photon of the map M, keeps the
    error of a cell without photons from zero. `provenance["unscattered"]` is "image".

    It is "photons" where these carry all the light, with s as usual: without `rtol`, in scenarios
    that name the analog estimator, and where the image is not known (receivers in the water or
    tilted, extended sources, light from the air, surfaces that overhang, random slopes too narrow
    for the cells, some forms as published).
    With `rtol` dark cells have an upper bound, `gain_bound`.
    """
    require_options(run, RunOptions)
    options: dict[str, Any] = {name: value for name, value in run.items() if value is not None}
    store, progress = options.pop("store", None), options.pop("progress", None)
    case = resolve(link, surface, **options)
    kinds = (Receiver, WaterReceiver)
    receiver = next((r for r in case.link.receivers if isinstance(r, kinds)), None)
    if receiver is None:
        raise Refused("receiver", Described("no receiver"), "a Receiver or a WaterReceiver")
    require_whole(photons, 1, 2**53, "photons")
    if rtol is not None and not 0.0 < rtol < math.inf:
        raise Refused("rtol", rtol, "a finite number > 0")
    given_times = case.meshing.time if times is None else times
    at = require_finite(given_times, "times", "one or more times [s]").tolist()
    view = {"axis": receiver.axis, "fov_deg": receiver.fov_deg}
    grid = IrradianceMap(height=receiver.center[2], extent=extent, step=step, **view)
    exact = rtol is not None and not isinstance(case.run.estimator, Analog)
    mapped = _Mapped(case, receiver, grid, at, exact, progress)
    with Store(store, "coverage_map").loop("photons", mapped.identity()) as mapped.kept:
        return mapped.run(photons, rtol)


class _Mapped:
    """Map of a receiver: link, surface and options, cells and times, and its unscattered light."""

    kept: Kept

    def __init__(
        self,
        case: Case,
        receiver: Receiver | WaterReceiver,
        grid: IrradianceMap,
        times: list[float],
        exact: bool,
        progress: Callable[[int], None] | None,
    ) -> None:
        options = case.run.estimator
        self._options = options if isinstance(options, Analog) else Analog()
        self._case = case._replace(run=case.run.replace(estimator=self._options))
        self._receiver, self._grid, self._times = receiver, grid, times
        self._progress = progress
        half = 0.5 * grid.n * grid.step
        ends = (-grid.extent, 2.0 * half - grid.extent)
        corners = (receiver.replace(position=(x, y)) for x in ends for y in ends)
        self._corners = case.link.replace(receiver=tuple(corners))
        self._mesh = lru_cache(_MESHES)(partial(self._meshed, exact))
        self._image = self._unscattered() if exact else None

    def _meshed(self, exact: bool, time: float) -> TriangleMesh:
        """Return the mesh of a time, fine below all cells if exact."""
        inputs = self._case.surface, self._case.meshing.replace(time=time)
        if exact:
            try:
                return mesh_for(self._corners, *inputs, math.inf)[0]
            except Refused:  # a given mesh that does not reach below all cells
                pass
        return mesh_for(self._case.link, *inputs)[0]

    def _unscattered(self) -> Floats | None:
        """Return the unscattered gain of the cells, or None if photons have to carry it."""
        link, options = self._case.link, (self._case.meshing.normals, self._case.threads)
        link = link.replace(receiver=self._receiver)
        total = np.zeros((self._grid.n, self._grid.n))
        for time in self._times:
            found = unscattered_map(link, self._mesh(time), self._grid, *options)
            if found is None:
                return None
            total += found / len(self._times)
        return total

    def identity(self) -> dict[str, Any]:
        """Return the configuration that the tallies depend on, as plain data."""
        case = self._case
        return {
            "link": case.link.model_dump(mode="json"),
            "surface": surface_config(case.surface),
            "run": self._options.model_dump(mode="json"),
            "seed": case.run.seed,
            "meshing": case.meshing.model_dump(mode="json"),
            "map": self._grid.model_dump(mode="json"),
            "times": self._times,
            "unscattered": self._image is None,
        }

    def run(self, photons: int, rtol: float | None) -> CoverageMap:
        """Return the map by photons, which carry all light, or the light that the image lacks."""
        more = photons if rtol is None else min(photons, _FIRST_PHOTONS)
        each, sums = 0, None
        while sums is None or more > 0:
            sums = self._follow(each, more, sums)
            each += more
            gain, stderr = self._gain(sums)
            lack = 0.0 if rtol is None else (relative_errors(gain, stderr).max() / rtol) ** 2
            wanted = math.ceil(each * min(1.1 * float(lack), _MOST_AT_ONCE))
            # a map without any light is given up
            lacks = lack > 1.0 and gain.max() > 0.0
            more = max(min(wanted, Analog.most_photons) - each, 0) if lacks else 0
        records, origin = {"irradiance-map": self._grid}, self._origin(each, rtol)
        result = analog_result(self._case.link, sums, origin, records)
        warn_of_lost(result)
        if self._image is None:
            warn_of_dark_map(result, records, self._back)
        bound = None
        if rtol is not None:
            cells = int((relative_errors(gain, stderr) > rtol).sum())
            if cells:
                text = f"rtol: {cells} of {gain.size} cells have not reached {rtol:g}"
                warnings.warn(f"{text} with the most photons", FewSamplesWarning, stacklevel=3)
            bound = self._bound(gain, stderr, sums.photons)
        assert result.map is not None
        return CoverageMap(result.map.x, result.map.y, gain, stderr, origin, bound)

    def _back(self, grid: IrradianceMap, photons: int) -> PhotonSums:
        """Follow a few photons at the first time with another map."""
        case, intersector = (
            self._case,
            EmbreeIntersector(self._mesh(self._times[0]), self._case.threads),
        )
        return run_analog(
            case.link, intersector, self._options, photons=photons, record=[grid], **case.how
        )

    def _follow(self, done: int, photons: int, sums: PhotonSums | None) -> PhotonSums:
        """Follow more photons at each time, and add their tallies to the sums."""
        for i, time in enumerate(self._times):
            first = self._options.first_photon + len(self._times) * done + i * photons
            key = f"{photons} from {first}"
            if key in self.kept:
                sums = _unpacked(self.kept[key])
                if self._progress is not None:
                    self._progress(photons)
                continue
            case, options = self._case, self._options.replace(first_photon=first)
            sums = run_analog(
                case.link, EmbreeIntersector(self._mesh(time), case.threads), options,
                photons=photons, record=[self._grid], unscattered=self._image is None, sums=sums,
                progress=self._progress, **case.how,
            )  # fmt: skip
            self.kept.keep(key, *_packed(sums))
        assert sums is not None
        return sums

    def _gain(self, sums: PhotonSums) -> tuple[Floats, Floats]:
        """Return gain and standard error of the cells."""
        area = np.pi * self._receiver.radius**2
        found = irradiance_map(self._grid, sums)
        gain, stderr = area * found.irradiance, area * found.irradiance_stderr
        if self._image is None:
            return gain, stderr
        total, squares = (float(x.value().sum()) for x in (sums.map, sums.map_squared))
        typical = area / self._grid.step**2 * squares / max(total, 1e-300)
        return self._image + gain, np.hypot(stderr, typical / sums.photons)

    def _origin(self, photons: int, rtol: float | None) -> dict[str, Any]:
        """Return the provenance of the map."""
        case = self._case
        meshing = case.meshing.replace(time=self._times[0]).model_dump()
        run = {**case.run.to_config(), "photons": photons, "rtol": rtol, **meshing}
        run["record"] = [self._grid.model_dump(mode="json")]
        origin = {**provenance(case.link, surface_config(case.surface), run), **case.origin}
        light = "photons" if self._image is None else "image"
        return {**origin, "times": self._times, "unscattered": light}

    def _bound(self, gain: Floats, stderr: Floats, photons: int) -> Floats | None:
        """Return upper bounds of dark cells, 95 % confidence, nan elsewhere; None if all are lit.

        No photon scores more than its largest weight w times the aperture over the cell; with
        mean m and standard error s the bound is m + 2 s + 3 w / n (rule of three).
        """
        if (gain > 0.0).all():
            return None
        weight = largest_weight(self._case.link, 0.0)
        most = weight * np.pi * self._receiver.radius**2 / self._grid.step**2
        return np.where(gain > 0.0, np.nan, gain + 2.0 * stderr + 3.0 * most / photons)


def _packed(sums: PhotonSums) -> tuple[Floats, str]:
    """Return all tallies as one row of 64-bit numbers, and their shapes and types as text."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in vars(sums).items():
        parts = vars(value) if isinstance(value, FixedPointSum) else {"": value}
        arrays |= {f"{name}.{part}": np.asarray(array) for part, array in parts.items()}
    del arrays["arrivals."]
    rows = [array.ravel().view(np.float64) for array in arrays.values()]
    about = {name: (array.shape, array.dtype.str) for name, array in arrays.items()}
    return np.concatenate(rows), json.dumps(about)


def _unpacked(item: Item) -> PhotonSums:
    """Return the tallies of a row, see `_packed`."""
    found: dict[str, Any] = {}
    start = 0
    for path, (shape, dtype) in json.loads(item.text).items():
        name, _, part = path.partition(".")
        size = math.prod(shape)
        array = item.numbers[start : start + size].view(dtype).reshape(shape).copy()
        start += size
        if part:
            vars(found.setdefault(name, FixedPointSum(tuple(shape))))[part] = array
        else:
            found[name] = array if shape else int(array)
    return PhotonSums(**found)
