"""Maps of the gain over the plane of the receiver."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from threading import Lock
from typing import Annotated, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Positive, check_call
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.cell_chains import FIRST, CellChains, TileSums, further, mean_of_times
from meshtrace.engine.chains.maps import unscattered_map
from meshtrace.engine.outcome import (
    FEW_PHOTONS,
    FewSamplesWarning,
    analog_result,
    warn_of_dark_map,
    warn_of_lost,
)
from meshtrace.engine.photons.analog import PhotonSums, run_analog
from meshtrace.engine.photons.arriving import largest_weight
from meshtrace.engine.setup.arrays import frame_of
from meshtrace.engine.setup.meshing import mesh_for, surface_config
from meshtrace.engine.setup.options import Analog, IrradianceMap, RunOptions
from meshtrace.engine.setup.tinting import UNTINTED, CommonPaths, clearest, photon_paths, scattering
from meshtrace.errors import Described, Refused, require_finite, warn
from meshtrace.kernels.tints import ALONE
from meshtrace.link import Link, Receiver, WaterReceiver
from meshtrace.link.link import SAME_SIDE
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import one_blas_thread
from meshtrace.results.provenance import provenance
from meshtrace.results.series import (
    LIT,
    ByWavelength,
    CoverageMap,
    checked_wavelengths,
    relative_errors,
    spectral,
)
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign, case_of
from meshtrace.studies.cluster import Restored

_FIRST_PHOTONS = 2**20  # at most, before the first comparison with `rtol`
_MOST_AT_ONCE = 16.0  # most growth of the photons at once: the error of few hits is uncertain
_MESHES = 4  # of the latest times, in memory for further photons; tuned: memory, time
_PROBED = 3  # a probe takes one of so many tiles along x and along y
_BLOCK = 2**18  # photons of a step; tuned: a store has a map for each step


_Step = tuple[int, int, int, int]
"""Samples over the surface at one time: photons of a run, or chains to a tile of cells.

Index of the time, index of the run or the tile, number of samples, number of the first of them. A
map of several wavelengths has several runs, of different kinds of photons. Samples are numbered by
run or tile: those from the first on have not been followed before.
"""


@spectral
@check_call
def coverage_map(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    extent: float = 5.0,
    step: float = 0.25,
    *,
    times: Sequence[float] | None = None,
    photons: Annotated[int, Field(ge=1, le=2**53)] = 4_000_000,
    rtol: Positive | None = None,
    wavelengths_nm: ArrayLike | None = None,
    **run: Unpack[RunOptions],
) -> CoverageMap | ByWavelength[CoverageMap]:
    r"""Map the gain over the plane of the receiver.

    Analog photons make the map: every photon that leaves the sea, or goes down, passes the plane
    somewhere, so that a single run maps it all. With `rtol` they carry only scattered and reflected
    light, or chains carry that, see Notes. Between ends on one side a tilted receiver is refused in
    the plane of a lamp, whose straight light does not cross it.

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
        Photons for each time; with `rtol` the first guess, at most 2^20.
    rtol : float, optional
        Relative standard error > 0 to reach in every cell by more samples; unscattered light has
        no noise where its image is known. Cells darker than a hundredth of the highest gain reach
        `rtol` of that.
    wavelengths_nm : array_like, optional
        Wavelengths [nm], in place of that of the sources: a map for each, of common photons (see
        `simulate`); `rtol` holds for all.
    **run
        Options of the run, see `RunOptions`. The store keeps the photons, which a smaller `rtol`
        uses again, and the chains; progress is by those followed since the last call.

    Returns
    -------
    CoverageMap, or ByWavelength of them

    Warns
    -----
    FewSamplesWarning
        If cells have not reached `rtol` with the most photons, 10^9 for each time, or chains, 2^20
        for each tile.

    Notes
    -----
    With `rtol` the gain of a cell is

    .. math:: h = h_0 + \frac{1}{N} \sum_i w_i, \qquad
        s^2 = \frac{1}{N} \left(\frac{1}{N} \sum_i w_i^2 - (h - h_0)^2\right)
        + \left(\frac{1}{N} \frac{\sum_M w_i^2}{\sum_M w_i}\right)^2,

    with h_0 the unscattered light: the sum over the images of all facets, which has no noise; the
    error of that sum, by parts of facets of twice the length, is joined to s.
    w_i are the scores of photons that have scattered, met the bottom or been reflected before they
    leave the water, N their number. The last term, one typical photon of the map M, keeps the
    error of a cell without photons from zero. `provenance["unscattered"]` is "image".

    It is "photons" where these carry all the light, with s as usual: without `rtol`, in scenarios
    that name the analog estimator, and where the image is not known (receivers in the water or
    tilted, extended sources, light from the air, surfaces that overhang, random slopes too narrow
    for the cells, some forms as published).
    With `rtol` dark cells have an upper bound, `gain_bound`.

    Chains take the place of the photons w_i, and `provenance["scattered"]` is "chains", where a
    probe of one tile in nine says that they are cheaper: over random slopes, in water of fewer than
    4 scatterings on the way, at one wavelength and up to four times, if light reflected first is
    below 0.1 % of each gain and the scattered light of the first photons agrees within 3.5 standard
    errors in each sixteenth of the map. Tiles of 6 % of the height of the plane above the sources,
    of one cell at least, have chains of their own, which serve all their cells: errors of the cells
    of a tile are correlated, those of two tiles independent. The error of a cell is the scatter
    over the 32 shifts of the points of its chains, of which scattered light of more than 1 % of a
    gain has the worth of at least 100 equal ones.

    At several wavelengths the photons are those of the wavelength that scatters most, half of them
    with the smallest and half with the largest index of the water; so are the two images of all
    facets. Maps are linear in the index between. A wavelength with fewer than 100 effective photons
    in the median cell of more than 1 % of the highest gain has photons of its own, unless those of
    the base are few, too.
    """
    case = case_of(link, surface, run)
    kinds = (Receiver, WaterReceiver)
    receiver = next((r for r in case.link.receivers if isinstance(r, kinds)), None)
    if receiver is None:
        raise Refused("receiver", Described("no receiver"), "a Receiver or a WaterReceiver")
    _require_off_plane(case.link, receiver, step)
    instants = case.meshing.time if times is None else times
    instants = require_finite(instants, "times", "one or more times [s]").tolist()
    grid = IrradianceMap(
        height=receiver.center[2],
        extent=extent,
        step=step,
        axis=receiver.axis,
        fov_deg=receiver.fov_deg,
    )
    # to a tolerance unscattered light is summed as an image, without noise, where it is known: this
    # needs meshes that are fine below the whole map
    for_image = rtol is not None and not isinstance(case.run.estimator, Analog)
    wavelengths = [] if wavelengths_nm is None else checked_wavelengths(wavelengths_nm)
    links = [case.link.at_wavelength(nm) for nm in wavelengths] or [case.link]
    without_links = Campaign({}, case.surface, case.run, case.meshing)
    campaign = without_links.with_loop(run, "coverage_map")
    maps = dict[int, CoverageMap]()  # by the place of the link in `links`
    with campaign.workers(), one_blas_thread():
        # each turn serves the wavelengths that the photons of one base sample well
        while waiting := [i for i in range(len(links)) if i not in maps]:
            base, shared = photon_paths(links, waiting)
            of_base = campaign._replace(links={str(i): links[i] for i in shared.wavelengths})
            mapped = _Mapped(of_base, shared, receiver, grid, instants, for_image)
            maps |= mapped.run(photons, rtol, base)
    for coverage in maps.values():
        coverage.provenance.update(case.origin)
    results = tuple(maps[i] for i in range(len(links)))
    return ByWavelength(np.array(wavelengths), results) if wavelengths else results[0]


def _require_off_plane(link: Link, receiver: Receiver | WaterReceiver, step: float) -> None:
    """Refuse a tilted receiver in the plane of a lamp: straight light never crosses that plane.

    Photons count by cos(theta) / |cos(zenith)| where they cross the plane: light along the plane is
    not seen.
    """
    sine = math.hypot(*receiver.axis[:2])
    if link.direction not in SAME_SIDE or sine < 1e-9:  # rounding of a tilt of 180 degrees
        return
    level = receiver.center[2]
    if any(abs(lamp.center[2] - level) < step for lamp in link.transmitters):
        end = "depth" if level < 0.0 else "height"
        allowed = f"{step:g} m (the step) or more from the level of every lamp, or no tilt"
        raise Refused(f"receiver.{end}", abs(level), allowed)


class _Mapped(Restored):
    """Maps of a receiver at wavelengths with common photons, and their unscattered light.

    Parameters
    ----------
    campaign : Campaign
        Links at the wavelengths of the map, over the sea.
    shared : CommonPaths
        Their common paths.
    receiver, grid, times
        Receiver, cells and times of the map.
    for_image : bool
        Whether the meshes are fine below all cells, for the image of the unscattered light.
    unscattered : bool, optional
        Whether the photons carry the unscattered light, too; by default if it has no image.
    """

    def __init__(
        self,
        campaign: Campaign,
        shared: CommonPaths,
        receiver: Receiver | WaterReceiver,
        grid: IrradianceMap,
        times: list[float],
        for_image: bool,
        unscattered: bool | None = None,
    ) -> None:
        self._campaign, self._common, self._for_image = campaign, shared, for_image
        self._receiver, self._grid, self.times = receiver, grid, times
        options = campaign.run.estimator
        self.options = options if isinstance(options, Analog) else Analog()
        self.tinting = shared.tinting
        # gains are linear in the index of the water between the smallest and the largest one:
        # weights of these two ends, (ends, wavelengths), or of the only one
        of_ends = np.array([1.0 - shared.shares, shared.shares])
        self.end_shares = of_ends[: len(shared.bases)]
        self._links = links = list(campaign.links.values())
        self._clearest = clearest(links)
        scatterers = [links[i] for i in self.tinting.bases] or [shared.bases[0]]
        # each run scatters as one wavelength does, and refracts by one end of the indices
        self.runs = [
            (base, link.replace("water.n", end.water.n))
            for end in shared.bases
            for base, link in enumerate(scatterers)
        ]
        # Runs of one end have as many photons each, so that its map is the mean of theirs; `shares`
        # are the weights of all runs in the map of each wavelength, (runs, wavelengths).
        self._base_shares = np.full(len(scatterers), 1.0 / len(scatterers))
        self.shares = np.repeat(self.end_shares, len(scatterers), axis=0) / len(scatterers)
        # a mesh with its intersector takes tens of megabytes
        self.mesh = lru_cache(_MESHES)(self._meshed)
        # one lock a time: threads wait only for the mesh that they need
        self._mesh_locks = [Lock() for _ in times]
        image = self._unscattered() if for_image and unscattered is None else None
        self._image: Floats | None = image[0] if image else None
        self._image_error: Floats = image[1] if image else np.zeros(1)
        self._photons_carry_all = self._image is None if unscattered is None else unscattered
        # gain and error by chains; empty where photons serve better, None before they are compared
        self._by_chains: tuple[Floats, Floats] | tuple[()] | None = None
        self._chains_used = 0
        # from which a worker builds the same object, see `Restored`
        self.inputs = (
            campaign.alone, shared, receiver, grid, times, for_image, self._photons_carry_all
        )  # fmt: skip

    def _meshed(self, time: float) -> TriangleMesh:
        """Mesh the surface at a time, fine below all cells for the image of unscattered light."""
        inputs = self._campaign.surface, self._campaign.meshing.replace(time=time)
        if self._for_image:
            half = 0.5 * self._grid.n * self._grid.step
            # receivers in the corners make the mesh fine below the whole map, which may end a part
            # of a cell beyond `extent`
            ends = (-self._grid.extent, 2.0 * half - self._grid.extent)
            corners = [self._receiver.replace(position=(x, y)) for x in ends for y in ends]
            try:
                below = self._clearest.replace(receiver=tuple(corners))
                # an infinite reach: fine wherever light may cross to a corner
                return mesh_for(below, *inputs, math.inf)[0]
            except Refused:  # a given mesh that does not reach below all cells
                pass
        return mesh_for(self._clearest, *inputs)[0]

    def steps(self, done: int, photons: int) -> list[_Step]:
        """Return the steps of `photons` more photons at each time, after `done` at each."""
        steps, n = list[_Step](), len(self.runs)
        for i in range(len(self.times)):
            # ids are consecutive over all calls: `done` of each time precede those of this call, in
            # which one time follows the other
            first = self.options.first_photon + len(self.times) * done + i * photons
            # as many photons to each run
            cuts = [first + k * photons // n for k in range(n + 1)]
            steps += [
                (i, k, min(_BLOCK, cuts[k + 1] - start), start)
                for k in range(n)
                for start in range(cuts[k], cuts[k + 1], _BLOCK)
            ]
        return steps

    def setup(self) -> Callable[[_Step], Floats]:
        """Return the function from a step to its numbers."""
        return lambda step: self.tallies(*step).to_row()

    def tallies(
        self, time: int, run: int, photons: int, first: int, grid: IrradianceMap | None = None
    ) -> PhotonSums:
        """Return the tallies of a step, by default in the cells of the map."""
        base, link = self.runs[run]
        with self._mesh_locks[time]:  # one thread makes the mesh of all
            mesh = self.mesh(self.times[time])
            EmbreeIntersector(frame_of(link).mesh(mesh), 1).built()  # kept with the mesh
        # Another grid is for a warning alone, which photons of one wavelength with all their light
        # serve. `turn` is the base of the tinting that these photons follow, and the shares of all.
        tinting = UNTINTED if grid else self.tinting
        turn = (0, ALONE.parts) if grid else (base, self._base_shares)
        return run_analog(
            link, EmbreeIntersector(mesh, 1), self.options.replace(first_photon=first),
            photons=photons, seed=self._campaign.run.seed,
            normals=self._campaign.meshing.normals,
            unscattered=self._photons_carry_all or grid is not None,
            record=[grid or self._grid], tinting=tinting, turn=turn,
        )  # fmt: skip

    @cached_property
    def cell_chains(self) -> CellChains | None:
        """Chains to all tiles; None if they cannot follow the scattered light of this map."""
        return self._chains_of(1)

    def _chains_of(self, stride: int) -> CellChains | None:
        """Return chains to one in `stride` x `stride` tiles; None if they cannot serve."""
        # chains hold the meshes of all times in memory, and know a single wavelength
        if len(self._links) > 1 or len(self.times) > _MESHES:
            return None
        link, run = self._links[0].replace(receiver=self._receiver), self._campaign.run
        options = run.seed, self._campaign.meshing.normals, self._campaign.threads, stride
        try:
            chains = CellChains(link, [self.mesh(t) for t in self.times], self._grid, *options)
        except Refused:  # a feature that chains do not follow
            return None
        return chains if chains.serves else None

    def tile_setup(self) -> Callable[[_Step], Floats]:
        """Return the function from a step of chains to its numbers."""
        chains = self.cell_chains
        assert chains is not None
        _ = chains.pilots  # computed once, before threads share them
        return lambda step: chains.sums(*step).to_row()

    def _shape_of_tile(self, step: _Step) -> tuple[int]:
        """Return the shape of the numbers of a tile, see `TileSums.to_row`."""
        chains, (_, tile, *_) = self.cell_chains, step
        assert chains is not None
        # number of cells that the slices of the tile select
        cells = np.empty((chains.cells, chains.cells))[chains.tiles[tile]].size
        return (1 + (SHIFTS + 1) * cells,)

    def _unscattered(self) -> tuple[Floats, Floats] | None:
        """Return the unscattered gain of the cells and the error of its quadrature.

        Both (x, y, wavelengths); None if photons have to carry it.
        """
        options = self._campaign.meshing.normals, self._campaign.threads, self.tinting
        total, error = np.zeros((2, self._grid.n, self._grid.n, len(self._links)))
        for link, shares in zip(self._common.bases, self.end_shares, strict=True):
            link = link.replace(receiver=self._receiver)
            for time in self.times:
                unscattered = unscattered_map(link, self.mesh(time), self._grid, *options)
                if unscattered is None:
                    return None
                total += shares * unscattered[0] / len(self.times)
                # errors of different times and indices have the same causes: they add up
                error += shares * unscattered[1] / len(self.times)
        return total, error

    def run(self, photons: int, rtol: float | None, base: int) -> dict[int, CoverageMap]:
        """Return the maps of the wavelengths that are sampled well by the photons of the base.

        Photons carry all light, or the light that the images lack, unless chains take their place.
        """
        # with a tolerance few photons first: their errors give the number that it needs
        more = photons if rtol is None else min(photons, _FIRST_PHOTONS)
        # photons of each time so far, their sums by run, and places of the well-sampled links
        done, sums, sampled = 0, list[PhotonSums](), list[int]()
        while not sums or more > 0:
            sums = self._follow(base, done, more, sums)
            done += more
            gain, stderr = self._gain(sums)
            # decided once, after the first photons
            sampled = sampled or self._well_sampled(sums, base)
            pairs = [(gain[:, :, k], stderr[:, :, k]) for k in sampled]
            errors = [relative_errors(*pair).max() for pair in pairs if pair[0].any()]
            # number of photons needed over the present one, as the error falls as 1 / sqrt(N); 0
            # without any light, where more photons would not help
            lack = 0.0 if rtol is None else (max(errors, default=0.0) / rtol) ** 2
            # a tenth more, as the error is uncertain
            wanted = math.ceil(done * min(1.1 * float(lack), _MOST_AT_ONCE))
            more = max(min(wanted, Analog.most_photons) - done, 0) if lack > 1.0 else 0
            # once, when the first photons have shown what the tolerance would cost
            if more > 0 and rtol is not None and self._by_chains is None:
                self._by_chains = self._gain_by_chains(sums, rtol, done * lack) or ()
                if self._by_chains:
                    more, pairs = 0, [self._by_chains]
        self._warn(sums)
        return {
            self._common.wavelengths[k]: self._map(self._links[k], *pair, sums, done, rtol)
            for k, pair in zip(sampled, pairs, strict=True)
        }

    def _gain_by_chains(
        self, sums: list[PhotonSums], rtol: float, photons: float
    ) -> tuple[Floats, Floats] | None:
        """Return gain and standard error of the cells, with scattered light by chains.

        None where `photons` at each time are cheaper, collect more light or follow light that
        chains omit.
        """
        # chains carry scattered light alone: the rest has to be known
        if self._image is None or not self._cheaper(rtol, photons) or self.cell_chains is None:
            return None
        chains, direct, first = self.cell_chains, self._image[:, :, 0], True
        # further chains by tile, until no tile needs any
        tiles_done, waiting = dict[int, TileSums](), dict.fromkeys(range(len(chains.tiles)), FIRST)
        while waiting:
            for tile, more in self._tile_sums(waiting, tiles_done).items():
                tiles_done[tile] = tiles_done[tile] + more if tile in tiles_done else more
            tiles = [tiles_done[tile] for tile in range(len(chains.tiles))]
            # after the first pass alone: if chains omit light, more of them do not help
            if first and not self._trusts(chains, tiles, sums):
                return None
            first, waiting = False, further(tiles, chains.lack(tiles, direct, rtol))
        scattered, stderr = chains.scattered(tiles)
        self._chains_used = sum(sums_of_tile.chains for sums_of_tile in tiles)
        return direct + scattered, np.hypot(stderr, self._image_error[:, :, 0])

    def _cheaper(self, rtol: float, photons: float) -> bool:
        """Return whether chains cost less than `photons` at each time, by a probe of few tiles."""
        # one tile in nine tells the cost of all, for a ninth of the pilots
        probe = self._chains_of(_PROBED)
        # costs are in photons over all times
        budget = min(photons, Analog.most_photons) * len(self.times)
        if probe is None or self._image is None or probe.cost(np.array([FIRST])) > budget:
            return False
        tiles = [
            mean_of_times([probe.sums(i, tile, FIRST, 0) for i in range(len(self.times))])
            for tile in range(len(probe.tiles))
        ]
        # needed over present chains: no tile has fewer than the first ones
        factor = np.maximum(probe.lack(tiles, self._image[:, :, 0], rtol), 1.0)
        return probe.cost(factor * [sums.chains for sums in tiles]) < budget

    def _trusts(self, chains: CellChains, tiles: list[TileSums], sums: list[PhotonSums]) -> bool:
        """Return whether chains agree with photons in all cells, and omit little light."""
        assert self._image is not None
        # the first photons follow light on all its ways, without bias: they judge the chains
        gain, stderr = (values[:, :, 0] for values in self._gain_by_photons(sums))
        whole = self._image[:, :, 0] + chains.scattered(tiles)[0]
        illuminated = all((tile.mean > 0.0).all() for tile in tiles)  # else an error would be zero
        return illuminated and chains.agree(tiles, gain, stderr) and not chains.omits(whole)

    def _tile_sums(
        self, wanted: dict[int, int], earlier: Mapping[int, TileSums]
    ) -> dict[int, TileSums]:
        """Follow `wanted` further chains to each tile, and return their means over the times."""
        first = {tile: earlier[tile].chains if tile in earlier else 0 for tile in wanted}
        steps = [
            (i, tile, chains, first[tile])
            for i in range(len(self.times))
            for tile, chains in wanted.items()
        ]
        table = self._evaluate(self.tile_setup, steps, "chains", {}, self._shape_of_tile, "tiles")
        sums = dict[int, list[TileSums]]()
        for (_, tile, *_), row in table:
            sums.setdefault(tile, []).append(TileSums.of_row(row))
        return {tile: mean_of_times(each) for tile, each in sums.items()}

    def _evaluate(
        self, setup: Callable[[], Callable[[_Step], Floats]], steps: list[_Step], name: str,
        identity: dict[str, Any], shape: Callable[[_Step], tuple[int]], work: str,
    ) -> Iterator[tuple[_Step, Floats]]:  # fmt: skip
        """Yield each step with its numbers, see `Campaign.evaluate`, and report its samples."""
        campaign = self._campaign._replace(progress=None)
        identity |= {"map": self._grid.model_dump(mode="json"), "times": self.times}
        results = campaign.evaluate(setup, steps, name, identity, shape, work)
        for step, row in zip(steps, results, strict=True):
            yield step, row
            if self._campaign.progress is not None:
                self._campaign.progress(step[2])

    def _well_sampled(self, sums: list[PhotonSums], base: int) -> list[int]:
        """Return places of the links with enough effective photons in the median bright cell."""
        effective = []  # photons of each wavelength, (gain / stderr)^2
        by_wavelength = (np.moveaxis(x, 2, 0) for x in self._gain_by_photons(sums))
        for gain, stderr in zip(*by_wavelength, strict=True):
            illuminated = gain > LIT * gain.max()
            effective.append(
                float(np.median((gain[illuminated] / stderr[illuminated]) ** 2))
                if illuminated.any()
                else 0.0
            )
        # where the base itself has few, half as many are enough
        limit = min(FEW_PHOTONS, 0.5 * effective[self._common.wavelengths.index(base)])
        pairs = zip(self._common.wavelengths, effective, strict=True)
        return [k for k, (i, number) in enumerate(pairs) if i == base or number >= limit]

    def _map(
        self, link: Link, gain: Floats, stderr: Floats, sums: list[PhotonSums], photons: int,
        rtol: float | None,
    ) -> CoverageMap:  # fmt: skip
        """Return the map of a wavelength, and warn of cells that have not reached `rtol`."""
        bound = None
        if rtol is not None:
            cells = int((relative_errors(gain, stderr) > rtol).sum())
            if cells:
                text = f"rtol: {cells} of {gain.size} cells have not reached {rtol:g}"
                warn(f"{text} with the most samples", FewSamplesWarning)
            bound = self._bound(link, gain, stderr, sum(tally.photons for tally in sums))
        campaign, axis = self._campaign, self._grid.axes
        meshing = campaign.meshing.replace(time=self.times[0]).model_dump()
        run = campaign.run.replace(estimator=self.options).to_config()
        run |= {"photons": photons, "rtol": rtol} | meshing
        run["record"] = [self._grid.model_dump(mode="json")]
        method = "photons" if self._image is None else "image"
        origin = provenance(link, surface_config(campaign.surface), run)
        origin |= {"times": self.times, "unscattered": method}
        if self._by_chains:
            origin |= {"scattered": "chains", "chains": self._chains_used}
        return CoverageMap(axis, axis, gain, stderr, origin, bound)

    def _warn(self, sums: list[PhotonSums]) -> None:
        """Warn of lost photons, and of a receiver that faces away from the light."""
        records = {"irradiance-map": self._grid}
        pairs = zip(self.runs, sums, strict=True)
        results = [analog_result(link, tally, {}, records) for (_, link), tally in pairs]
        for result in results:
            warn_of_lost(result)

        def follow(photons: int, record: Sequence[IrradianceMap]) -> PhotonSums:
            return self.tallies(0, 0, photons, self.options.first_photon, *record)

        if self._image is None:
            warn_of_dark_map(results[0], records, follow)

    def _follow(
        self, base: int, done: int, photons: int, sums: list[PhotonSums]
    ) -> list[PhotonSums]:
        """Follow more photons at each time, and return the tallies of all so far by run."""
        # no photons yet: empty tallies
        tallies = sums or [self.tallies(0, k, 0, 0) for k in range(len(self.runs))]
        steps, name = self.steps(done, photons), f"photons of link {base}"
        run = self.options.model_dump(mode="json")
        identity = {"run": run, "unscattered": self._photons_carry_all}
        sizes = [tally.to_row().size for tally in tallies]
        table = self._evaluate(
            self.setup, steps, name, identity, lambda step: (sizes[step[1]],), "runs of photons"
        )
        for (_, part, *_), row in table:
            tallies[part] += tallies[part].of_row(row)
        return tallies

    def _gain_by_photons(self, sums: list[PhotonSums]) -> tuple[Floats, Floats]:
        """Return the gain that photons carry, and its standard error (x, y, wavelengths)."""
        # from the flux through a cell to that through the aperture: the ratio of their areas
        scale = np.pi * self._receiver.radius**2 / self._grid.step**2
        means, errors = np.array([tally.map_mean() for tally in sums]).swapaxes(0, 1)
        shares = self.shares[:, None, None]
        gain: Floats = scale * (shares * means).sum(axis=0)
        return gain, scale * np.sqrt(((shares * errors) ** 2).sum(axis=0))

    def _gain(self, sums: list[PhotonSums]) -> tuple[Floats, Floats]:
        """Return the whole gain and its standard error (x, y, wavelengths)."""
        gain, stderr = self._gain_by_photons(sums)
        if self._image is None:
            return gain, stderr
        area = np.pi * self._receiver.radius**2
        # the error of a cell that no photon has met is not zero, as one may yet come: it is at
        # least the contribution of one typical photon of the map, see the last term of s^2
        typical = np.zeros(gain.shape[2])
        for tally, shares in zip(sums, self.shares, strict=True):
            total, squares = (x.value().sum(axis=(0, 1)) for x in (tally.map, tally.map_squared))
            # sum w^2 / sum w: the mean weight of the photons, by the light that each carries
            weight = squares / np.maximum(total, 1e-300) / tally.map_scale
            typical += shares * area / self._grid.step**2 * weight / tally.photons
        return self._image + gain, np.hypot(np.hypot(stderr, typical), self._image_error)

    def _bound(self, link: Link, gain: Floats, stderr: Floats, photons: int) -> Floats | None:
        """Return upper bounds of dark cells at 95 % confidence, nan elsewhere; None without any.

        No photon scores more than its largest weight w times the aperture over the cell. With mean
        m and standard error s of n photons the bound is m + 2 s + 3 w / n: two standard errors for
        light that was met, and the rule of three, (1 - p)^n = 0.05, for light that was not. A
        photon of a base that scatters more than the link weighs exp((b_base - b) l) after a way l
        without scattering: w takes l as the depth of the deepest end.
        """
        if (gain > 0.0).all():
            return None
        excess = max(scattering(self._common.bases[0])[0] - scattering(link)[0], 0.0)  # [m-1]
        depth = max(-item.center[2] for _, item in link.items())
        # 0: depths from still water, without the troughs of the waves
        weight = largest_weight(link, 0.0) * math.exp(excess * depth)
        most = weight * np.pi * self._receiver.radius**2 / self._grid.step**2
        return np.where(gain > 0.0, np.nan, gain + 2.0 * stderr + 3.0 * most / photons)
