"""Gain at each place of the plane of the receiver."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains.maps import unscattered_map
from meshtrace.engine.outcome import (
    FEW_PHOTONS,
    FewSamplesWarning,
    analog_result,
    largest_weight,
    warn_of_dark_map,
    warn_of_lost,
)
from meshtrace.engine.photons.analog import FixedPointSum, PhotonSums, run_analog
from meshtrace.engine.setup.common_paths import CommonPaths, clearest, photon_paths, scattering
from meshtrace.engine.setup.meshing import mesh_for, surface_config
from meshtrace.engine.setup.options import (
    Analog,
    Case,
    IrradianceMap,
    RunOptions,
    require_options,
    resolve,
)
from meshtrace.engine.setup.tinting import UNTINTED
from meshtrace.errors import Described, Refused, require_finite, require_whole
from meshtrace.link import Link, Receiver, WaterReceiver
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.coverage import LIT, CoverageMap, relative_errors
from meshtrace.results.provenance import provenance
from meshtrace.results.wavelengths import ByWavelength, checked_wavelengths
from meshtrace.scenario import Scenario
from meshtrace.studies.store import Item, Kept, Store

_FIRST_PHOTONS = 2**20  # at most, before the first comparison with `rtol`
_MOST_AT_ONCE = 16.0  # times the photons: an error of few hits is uncertain itself
_MESHES = 4  # that are kept for further photons


@overload
def coverage_map(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    extent: float = 5.0,
    step: float = 0.25,
    *,
    wavelengths_nm: None = None,
    **options: Any,
) -> CoverageMap: ...


@overload
def coverage_map(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    extent: float = 5.0,
    step: float = 0.25,
    *,
    wavelengths_nm: ArrayLike,
    **options: Any,
) -> ByWavelength[CoverageMap]: ...


def coverage_map(  # type: ignore[misc]
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    extent: float = 5.0,
    step: float = 0.25,
    *,
    times: Sequence[float] | None = None,
    photons: int = 4_000_000,
    rtol: float | None = None,
    wavelengths_nm: ArrayLike | None = None,
    **run: Unpack[RunOptions],
) -> CoverageMap | ByWavelength[CoverageMap]:
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
    wavelengths_nm : array_like, optional
        Wavelengths [nm], in place of that of the sources: a map for each, of common photons (see
        `simulate`); `rtol` holds for all.
    **run
        Options of the run, see `RunOptions`. The store keeps the photons of each time, which a
        smaller `rtol` uses again; progress is by the photons followed since the last call.

    Returns
    -------
    CoverageMap, or ByWavelength of them

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

    At several wavelengths the photons are those of the wavelength that scatters most, half of them
    with the smallest and half with the largest index of the water; so are the two images of all
    facets. Maps are linear in the index between. A wavelength with fewer than 100 effective photons
    in the median cell of more than 1 % of the highest gain has photons of its own, unless those of
    the base are few, too.
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
    inputs = receiver, grid, at, exact, progress
    waves = [] if wavelengths_nm is None else checked_wavelengths(wavelengths_nm)
    links = [case.link.at_wavelength(nm) for nm in waves] or [case.link]
    kept, found = Store(store, "coverage_map"), dict[int, CoverageMap]()
    while waiting := [i for i in range(len(links)) if i not in found]:
        base, common = photon_paths(links, waiting, mixed=True)
        mapped = _Mapped(case, links, common, *inputs)
        with kept.loop(f"photons of link {base}", mapped.identity()) as mapped.kept:
            found |= mapped.run(photons, rtol, base)
    results = [found[i] for i in range(len(links))]
    return ByWavelength(np.array(waves), tuple(results)) if waves else results[0]


class _Mapped:
    """Maps of a receiver at wavelengths with common photons, and their unscattered light."""

    kept: Kept

    def __init__(
        self,
        case: Case,
        links: Sequence[Link],
        common: CommonPaths,
        receiver: Receiver | WaterReceiver,
        grid: IrradianceMap,
        times: list[float],
        exact: bool,
        progress: Callable[[int], None] | None,
    ) -> None:
        options = case.run.estimator
        self._options = options if isinstance(options, Analog) else Analog()
        case = case._replace(link=clearest(links))
        self._case = case._replace(run=case.run.replace(estimator=self._options))
        self._links, self._common = [links[i] for i in common.rows], common
        self._tinting = common.tinting or UNTINTED
        shares = np.array([1.0 - common.shares, common.shares])
        self._ends = shares[: len(common.bases)]  # of the smallest and the largest index
        several = [links[i] for i in self._tinting.bases] or [common.bases[0]]
        self._runs = [
            (base, link.replace("water.n", end.water.n))
            for end in common.bases
            for base, link in enumerate(several)
        ]
        self._parts = np.full(len(several), 1.0 / len(several))  # of the photons of an index
        self._shares = np.repeat(self._ends, len(several), axis=0) / len(several)  # of the runs
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
        options = self._case.meshing.normals, self._case.threads, self._tinting
        total = np.zeros((self._grid.n, self._grid.n, len(self._links)))
        for link, shares in zip(self._common.bases, self._ends, strict=True):
            link = link.replace(receiver=self._receiver)
            for time in self._times:
                found = unscattered_map(link, self._mesh(time), self._grid, *options)
                if found is None:
                    return None
                total += shares * found / len(self._times)
        return total

    def identity(self) -> dict[str, Any]:
        """Return the configuration that the tallies depend on, as plain data."""
        case = self._case
        return {
            "links": [link.model_dump(mode="json") for link in self._links],
            "surface": surface_config(case.surface),
            "run": self._options.model_dump(mode="json"),
            "seed": case.run.seed,
            "meshing": case.meshing.model_dump(mode="json"),
            "map": self._grid.model_dump(mode="json"),
            "times": self._times,
            "unscattered": self._image is None,
        }

    def run(self, photons: int, rtol: float | None, base: int) -> dict[int, CoverageMap]:
        """Return maps by photons, which carry all light, or the light that the images lack.

        Those of the wavelengths for which the photons of the base are many enough.
        """
        more = photons if rtol is None else min(photons, _FIRST_PHOTONS)
        each, sums, kept = 0, list[PhotonSums](), list[int]()
        while not sums or more > 0:
            sums = self._follow(each, more, sums)
            each += more
            gain, stderr = self._gain(sums)
            kept = kept or self._well_sampled(sums, base)
            pairs = [(gain[:, :, k], stderr[:, :, k]) for k in kept]
            errors = [relative_errors(*pair).max() for pair in pairs if pair[0].any()]
            # maps without any light are given up
            lack = 0.0 if rtol is None else (max(errors, default=0.0) / rtol) ** 2
            wanted = math.ceil(each * min(1.1 * float(lack), _MOST_AT_ONCE))
            more = max(min(wanted, Analog.most_photons) - each, 0) if lack > 1.0 else 0
        self._warn(sums)
        rows = [self._common.rows[k] for k in kept]
        maps = [
            self._map(self._links[k], *pair, sums, each, rtol)
            for k, pair in zip(kept, pairs, strict=True)
        ]
        return dict(zip(rows, maps, strict=True))

    def _well_sampled(self, sums: list[PhotonSums], base: int) -> list[int]:
        """Return which wavelengths have enough effective photons in a typical lit cell."""
        found = []
        for gain, stderr in zip(*(np.moveaxis(x, 2, 0) for x in self._mixed(sums)), strict=True):
            lit = gain > LIT * gain.max()
            found.append(float(np.median((gain[lit] / stderr[lit]) ** 2)) if lit.any() else 0.0)
        limit = min(FEW_PHOTONS, 0.5 * found[self._common.rows.index(base)])
        pairs = zip(self._common.rows, found, strict=True)
        return [k for k, (i, number) in enumerate(pairs) if i == base or number >= limit]

    def _map(
        self, link: Link, gain: Floats, stderr: Floats, sums: list[PhotonSums], photons: int,
        rtol: float | None,
    ) -> CoverageMap:  # fmt: skip
        """Return the map of a wavelength."""
        bound = None
        if rtol is not None:
            cells = int((relative_errors(gain, stderr) > rtol).sum())
            if cells:
                text = f"rtol: {cells} of {gain.size} cells have not reached {rtol:g}"
                warnings.warn(f"{text} with the most photons", FewSamplesWarning, stacklevel=5)
            bound = self._bound(link, gain, stderr, sum(one.photons for one in sums))
        axis = self._grid.axes
        return CoverageMap(axis, axis, gain, stderr, self._origin(link, photons, rtol), bound)

    def _warn(self, sums: list[PhotonSums]) -> None:
        """Warn of lost photons, and of a map that looks away from the light."""
        records = {"irradiance-map": self._grid}
        results = [
            analog_result(link, one, {}, records)
            for (_, link), one in zip(self._runs, sums, strict=True)
        ]
        for result in results:
            warn_of_lost(result)
        if self._image is None:
            warn_of_dark_map(results[0], records, self._back)

    def _back(self, grid: IrradianceMap, photons: int) -> PhotonSums:
        """Follow a few photons at the first time with another map."""
        case = self._case
        intersector = EmbreeIntersector(self._mesh(self._times[0]), case.threads)
        link = self._common.bases[0]
        return run_analog(
            link, intersector, self._options, photons=photons, record=[grid], **case.how
        )

    def _follow(self, done: int, photons: int, sums: list[PhotonSums]) -> list[PhotonSums]:
        """Follow more photons at each time, and return their tallies with the sums, by run."""
        found: list[Any] = list(sums) or [None] * len(self._runs)
        n = len(found)
        for i, time in enumerate(self._times):
            first = self._options.first_photon + len(self._times) * done + i * photons
            cuts = [first + k * photons // n for k in range(n + 1)]
            for k, run in enumerate(self._runs):
                found[k] = self._more(*run, time, cuts[k], cuts[k + 1] - cuts[k], found[k])
        return found

    def _more(
        self,
        base: int,
        link: Link,
        time: float,
        first: int,
        photons: int,
        sums: PhotonSums | None,
    ) -> PhotonSums:
        """Follow photons of a base, and add their tallies to the sums."""
        key = f"{photons} from {first}"
        if key in self.kept:
            if self._progress is not None:
                self._progress(photons)
            return _unpacked(self.kept[key])
        case, options = self._case, self._options.replace(first_photon=first)
        sums = run_analog(
            link, EmbreeIntersector(self._mesh(time), case.threads), options,
            photons=photons, record=[self._grid], unscattered=self._image is None, sums=sums,
            tinting=self._tinting, turn=(base, self._parts), progress=self._progress, **case.how,
        )  # fmt: skip
        self.kept.keep(key, *_packed(sums))
        return sums

    def _mixed(self, sums: list[PhotonSums]) -> tuple[Floats, Floats]:
        """Return gain by photons and standard error of the cells (x, y, wavelengths)."""
        scale = np.pi * self._receiver.radius**2 / self._grid.step**2
        means, errors = np.array([one.map_mean() for one in sums]).swapaxes(0, 1)
        shares = self._shares[:, None, None]
        gain: Floats = scale * (shares * means).sum(axis=0)
        return gain, scale * np.sqrt(((shares * errors) ** 2).sum(axis=0))

    def _gain(self, sums: list[PhotonSums]) -> tuple[Floats, Floats]:
        """Return gain and standard error of the cells (x, y, wavelengths)."""
        gain, stderr = self._mixed(sums)
        if self._image is None:
            return gain, stderr
        area = np.pi * self._receiver.radius**2
        typical = np.zeros(gain.shape[2])
        for one, shares in zip(sums, self._shares, strict=True):
            total, squares = (x.value().sum(axis=(0, 1)) for x in (one.map, one.map_squared))
            weight = squares / np.maximum(total, 1e-300) / one.map_scale
            typical += shares * area / self._grid.step**2 * weight / one.photons
        return self._image + gain, np.hypot(stderr, typical)

    def _origin(self, link: Link, photons: int, rtol: float | None) -> dict[str, Any]:
        """Return the provenance of a map."""
        case = self._case
        meshing = case.meshing.replace(time=self._times[0]).model_dump()
        run = {**case.run.to_config(), "photons": photons, "rtol": rtol, **meshing}
        run["record"] = [self._grid.model_dump(mode="json")]
        origin = {**provenance(link, surface_config(case.surface), run), **case.origin}
        light = "photons" if self._image is None else "image"
        return {**origin, "times": self._times, "unscattered": light}

    def _bound(self, link: Link, gain: Floats, stderr: Floats, photons: int) -> Floats | None:
        """Return upper bounds of dark cells, 95 % confidence, nan elsewhere; None if all are lit.

        No photon scores more than its largest weight w times the aperture over the cell; with
        mean m and standard error s the bound is m + 2 s + 3 w / n (rule of three). A photon of a
        base that scatters more has the more weight the longer it has not scattered: w counts the
        straight way down the water.
        """
        if (gain > 0.0).all():
            return None
        fewer = max(scattering(self._common.bases[0])[0] - scattering(link)[0], 0.0)
        depth = max(-item.center[2] for _, item in link.items())
        weight = largest_weight(link, 0.0) * math.exp(fewer * depth)
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
