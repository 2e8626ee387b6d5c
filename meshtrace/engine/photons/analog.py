"""The analog estimator: individual photons.

The gain is the mean weight that a photon brings to the aperture. Photons are followed in chunks,
one thread for each; chunks are independent and added in the order of their ids.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import Intersector
from meshtrace.engine.photons.flight import Miss, follow
from meshtrace.engine.photons.state import PHOTON, Recorder, World
from meshtrace.engine.setup import arrays
from meshtrace.engine.setup.bodies import for_thread, scene_of
from meshtrace.engine.setup.options import BLOCK, Analog, IrradianceMap, Record, read_records
from meshtrace.engine.setup.tinting import UNTINTED, Tinting
from meshtrace.kernels.rays import NO_BVH
from meshtrace.kernels.sources import FORWARD, N_SCORES, Sources
from meshtrace.kernels.tally import ARRIVAL, N_PLANE_SCORES, UNIT, Fate, MapGrid, Tallies
from meshtrace.kernels.tints import ALONE, NO_TINTS
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map, paced
from meshtrace.results.tallies import standard_error
from meshtrace.stored import SHIFTS

_HEADROOM = 6  # bits by which weights may exceed that on the shortest path, see `_cells_of`
_GUIDED = 100  # crossings allowed over a mesh that overhangs: a jet guides light
# integer tallies, whose sums do not depend on the order of additions; those of floating point are
# added block by block in the order of the ids
_EXACT = ("ledger", "map", "map_squared", "radiance")  # fields of `PhotonSums` and of tallies
_ADDED = ("photons", "score", "score_squared", "count", "misses", *_EXACT, "arrivals")
# tallies of the kernels that start at 0 in each chunk
_SUMS = (*_EXACT, "map_tint", "n_photons", "misses", "n_arrivals")


def options_over(mesh: TriangleMesh, options: Analog) -> Analog:
    """Return the options for a mesh, with up to 100 crossings by default if it overhangs.

    A jet guides light by dozens of total reflections.
    """
    # an option that the user has set stays, whatever the surface
    if mesh.single_valued or "max_surface_events" in options.model_fields_set:
        return options
    return options.replace(max_surface_events=_GUIDED)


class FixedPointSum:
    """Exact sum of integer arrays in units of 2^-44 (`kernels.tally.UNIT`), without overflow."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.array = np.zeros((2, *shape), np.int64)  # whole numbers, and units below one

    def add(self, units: NDArray[np.int64]) -> None:
        """Add an array; the order of additions does not matter."""
        self.array[1] += units
        # carry whole numbers, so that the lower part cannot overflow
        self.array[0] += self.array[1] >> 44
        self.array[1] &= (1 << 44) - 1

    def __add__(self, other: FixedPointSum) -> FixedPointSum:
        """Return the sum of this one and another."""
        total = deepcopy(self)
        total.add(other.array[1])
        total.array[0] += other.array[0]
        return total

    def value(self) -> Floats:
        """Return the sum as floating point numbers."""
        return self.array[0] + self.array[1] * UNIT


@dataclass
class PhotonSums:
    """Tallies of a run of photons; tallies of disjoint photons add."""

    photons: int
    score: Floats  # (scores,) sum over the photons, see `AnalogPhotons.n_scores`
    score_squared: Floats  # (scores,) sum of the squares of each photon's score
    count: NDArray[np.int64]  # (fates,) photons by `Fate`
    misses: NDArray[np.int64]  # rays by `flight.Miss`
    ledger: FixedPointSum  # (fates,) weight that ended by each
    map_scale: Floats  # (wavelengths,) factor on the scores of a map, see `_cells_of`
    map: FixedPointSum  # (x, y, wavelengths)
    map_squared: FixedPointSum  # (x, y, wavelengths)
    radiance: FixedPointSum  # (groups, planes, cosines, azimuths)
    arrivals: list[NDArray[np.void]] = field(default_factory=list)

    def __add__(self, other: PhotonSums) -> PhotonSums:
        """Return the tallies of two disjoint sets of photons together."""
        totals = {name: getattr(self, name) + getattr(other, name) for name in _ADDED}
        return replace(self, **totals)

    def to_row(self) -> Floats:
        """Return all tallies but arrivals as one row of 64-bit numbers."""
        # integers keep their bits as floating point numbers: a store knows rows of one type alone
        photons = np.array([self.photons])
        return np.concatenate([x.ravel().view(np.float64) for x in (photons, *self._arrays())])

    def of_row(self, row: Floats) -> PhotonSums:
        """Return the tallies that `to_row` wrote, in the shapes of these tallies."""
        sums, start = deepcopy(self), 1
        sums.photons = int(row[:1].view(np.int64)[0])
        # written into the arrays of the copy, in the order of `to_row`
        for array in sums._arrays():
            part = row[start : start + array.size].view(array.dtype)
            array[...] = part.reshape(array.shape)
            start += array.size
        return sums

    def _arrays(self) -> list[NDArray[Any]]:
        """Return the arrays of all tallies but arrivals, in the order of a row."""
        exact = (getattr(self, name).array for name in _EXACT)
        return [self.score, self.score_squared, self.count, self.misses, *exact]

    @classmethod
    def of_strata(cls, strata: Sequence[PhotonSums]) -> PhotonSums:
        """Return the sum of tallies of the apertures over strata of fixed numbers of photons.

        The means of the strata differ by design, not by noise: the squares returned give the
        variance within the strata alone, about the mean of all photons.
        """
        whole = reduce(add, strata)
        within = sum(stratum.score**2 / max(stratum.photons, 1) for stratum in strata)
        # subtract the squares of the strata's means, add that of the common mean
        square = whole.score_squared - within + whole.score**2 / max(whole.photons, 1)
        return replace(whole, score_squared=square)

    @property
    def all_arrivals(self) -> NDArray[np.void]:
        """The recorded arrivals, as one array."""
        return np.concatenate([np.zeros(0, ARRIVAL), *self.arrivals])

    def map_mean(self) -> tuple[Floats, Floats]:
        """Return the mean score of a photon in the cells (x, y, wavelengths), and its error."""
        total, n = self.map.value(), self.photons
        error = standard_error(total, self.map_squared.value(), n)
        return total / n / self.map_scale, error / self.map_scale

    def add(self, photons: int, tallies: Tallies) -> None:
        """Add the tallies of the next chunk of photons."""
        self.photons += photons
        # blocks of a fixed size, so that sums do not depend on the size of a chunk
        for start in range(0, photons, BLOCK):
            block = tallies.score[start : min(start + BLOCK, photons)]
            self.score += block.sum(axis=0)
            self.score_squared += np.einsum("ij,ij->j", block, block)
        self.count += tallies.n_photons
        self.misses += tallies.misses
        for name in _EXACT:
            getattr(self, name).add(getattr(tallies, name))
        n = min(int(tallies.n_arrivals[0]), len(tallies.arrivals))
        if n:
            arrivals = tallies.arrivals[:n]
            # the kernel writes arrivals in the order of a path; a full order makes files alike
            order = np.lexsort((arrivals["water"], arrivals["receiver"], arrivals["photon"]))
            self.arrivals.append(arrivals[order])


def tinted(
    sums: PhotonSums,
    factors: Callable[[Floats], Floats],
    scale: Floats,
    first: int,
    arrivals: bool,
) -> list[PhotonSums]:
    """Return the tallies of the apertures at each wavelength, from arrivals with sums of tints.

    `factors` maps tint sums (arrivals, tints) to factors on the weights (wavelengths, arrivals),
    `scale` (wavelengths,) multiplies them; `first` is the id of the first photon. Results hold the
    arrivals if `arrivals`.
    """
    hits = sums.all_arrivals
    # one score for each pair of photon and aperture: of several arrivals the sum is squared
    n, by_wavelength = len(sums.score), []
    pair, pair_of = np.unique((hits["photon"] - first) * n + hits["receiver"], return_inverse=True)
    aperture = pair % n
    for weight in factors(hits["tint"]) * scale[:, None] * hits["weight"]:
        score = np.bincount(pair_of, weight, len(pair))
        total: Floats = np.bincount(aperture, score, n).astype(float)
        square: Floats = np.bincount(aperture, score * score, n).astype(float)
        recorded = hits[: len(hits) * arrivals].copy()  # all or none
        recorded["weight"] = weight[: len(recorded)]
        by_wavelength.append(replace(sums, score=total, score_squared=square, arrivals=[recorded]))
    return by_wavelength


def run_analog(
    link: Link,
    intersector: Intersector,
    options: Analog = Analog(),  # noqa: B008 - frozen
    *,
    photons: int,
    seed: int,
    normals: str = "vertex",
    threads: int = 1,
    unscattered: bool = True,
    record: Iterable[Record] = (),
    recorder: Recorder | None = None,
    progress: Callable[[int], None] | None = None,
    tinting: Tinting = UNTINTED,
    turn: tuple[int, Floats] = (0, ALONE.parts),
) -> PhotonSums:
    """Trace photons and return their tallies.

    Parameters
    ----------
    link : Link
        The link.
    intersector : Intersector
        The surface.
    options : Analog
        Options of the estimator.
    photons : int
        Photons to follow, with ids from `options.first_photon` on.
    seed : int
        Key of the random numbers.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; the result does not depend on them.
    unscattered : bool
        Whether apertures, and maps in the air, score light that has met its first crossing alone.
    record : sequence of Record
        Extra tallies.
    recorder : Recorder, optional
        Arrays for the paths of the first photons; must fit into the first chunk.
    progress : callable, optional
        Called with the number of photons done since its last call.
    tinting : Tinting
        Functions that arrivals sum up, and their coefficients at the wavelengths of a map.
    turn : tuple of int and ndarray
        Which of the bases of the tinting these photons belong to, and the shares of all.

    Returns
    -------
    PhotonSums
    """
    records = read_records(record, options)
    options = options_over(intersector.mesh, options)
    # kernels are compiled for one type: without a recorder one of no photons
    recorder = recorder or new_recorder(0, 0)
    frame = arrays.frame_of(link)
    # a map is in metres of the world, to be converted to the frame of the link
    cells = _cells_of(records.get("irradiance-map"), link, frame, tinting, turn)
    tracer = AnalogPhotons(link, intersector, options, seed, normals, frame, cells)
    tracer.world = tracer.world._replace(
        recorder=recorder, tints=tinting.tints, scores_unscattered=unscattered
    )
    tracer.room = len(link.receivers) * ("arrivals" in records)
    empty, score = tracer.world.tallies, np.zeros(tracer.n_scores)
    exact: Any = {name: FixedPointSum(getattr(empty, name).shape) for name in _EXACT}
    counts = empty.n_photons.copy(), empty.misses.copy()
    sums = PhotonSums(0, score, score.copy(), *counts, map_scale=empty.grid.scale, **exact)
    first, end = options.first_photon, options.first_photon + photons
    starts = range(first, end, options.batch_size)
    chunks = ((start, min(start + options.batch_size, end)) for start in starts)
    traced = ordered_map(tracer.tallies, chunks, threads)
    for n, tallies in paced(traced, photons, f"{photons:,} photons", lambda part: part[0]):
        sums.add(n, tallies)
        if progress is not None:
            progress(n)
    recorder.vertex[:] = frame.metres(recorder.vertex)
    return sums


class AnalogPhotons:
    """Photons of a link over a surface, followed in chunks that do not depend on each other.

    Parameters
    ----------
    link, intersector, options, seed, normals
        As of `run_analog`.
    frame : Frame
        Coordinates of the kernels.
    cells : MapGrid
        Cells of a map in the frame, none by default.

    Attributes
    ----------
    world : World
        What all photons share, with empty tallies; without a recorder, at one wavelength.
    room : int
        Arrivals of a photon for which a chunk has memory at first, 0 if none are recorded.
    """

    def __init__(
        self,
        link: Link,
        intersector: Intersector,
        options: Analog,
        seed: int,
        normals: str,
        frame: arrays.Frame,
        cells: MapGrid = MapGrid(),  # noqa: B008 - immutable
    ) -> None:
        if frame != arrays.IDENTITY:
            intersector = intersector.for_mesh(frame.mesh(intersector.mesh))
        mesh = intersector.mesh
        normals = normals if mesh.max_slope > 0.0 else "facet"  # of a flat sea they are the same
        surface = arrays.surface_arrays(mesh, normals, link.physics.unresolved)
        crest = float(surface.high[2])
        sources = arrays.source_arrays(link, frame.unit * (crest + 1e-3), frame)
        least_weight, survival = _roulette_of(link, options, sources, frame.unit)
        medium = frame.medium(arrays.medium_arrays(link, frame.unit * crest))
        self.world = World(
            first=0,
            seed=np.uint64(seed),  # numba takes a Python integer for a signed one
            sources=sources,
            surface=surface,
            grid=arrays.grid_arrays(mesh) if intersector.shortcut else arrays.NO_GRID,
            bodies=None,  # those of a thread, see `tallies`
            medium=arrays.with_raster(medium, intersector),
            apertures=arrays.aperture_arrays(link, frame),
            interface=arrays.interface_arrays(link),
            least_weight=least_weight,
            survival=survival,
            max_events=options.max_events,
            max_crossings=options.max_surface_events,
            scores_unscattered=True,
            tallies=_no_tallies(link, frame, cells),
            recorder=new_recorder(0, 0),
            back=FORWARD,
            tints=NO_TINTS,
            bvh=NO_BVH,
            photon=np.zeros(1, PHOTON),
        )
        self.room, self._unit = 0, frame.unit
        self._intersector, self._bodies = intersector, scene_of(link, frame)

    @property
    def n_scores(self) -> int:
        """Scores of a photon: one by aperture, four by plane; three of a backward photon."""
        world = self.world
        if len(world.back.origin):
            return N_SCORES
        return len(world.apertures.radius) + N_PLANE_SCORES * len(world.tallies.planes)

    def tallies(self, span: tuple[int, int]) -> tuple[int, Tallies]:
        """Trace the photons first <= id < last; return their number and tallies."""
        first, last = span
        # one arrival of each photon at each receiver; few arrive twice
        room = (last - first) * self.room
        while True:
            empty = self.world.tallies
            tallies = empty._replace(
                score=np.zeros((last - first, self.n_scores)),
                arrivals=np.zeros(room, ARRIVAL),
                map_factors=np.empty((2, len(empty.grid.scale))),
                **{name: np.zeros_like(getattr(empty, name)) for name in _SUMS},
            )
            # every thread has tallies and a photon of its own; the surface is shared
            with ExitStack() as scenes:
                world = self.world._replace(
                    first=first,
                    tallies=tallies,
                    bvh=scenes.enter_context(self._intersector.function()),
                    bodies=scenes.enter_context(for_thread(self._bodies)),
                    photon=np.zeros(1, PHOTON),
                )
                follow(first, last, world)
            if not self.room or int(tallies.n_arrivals[0]) <= room:
                tallies.arrivals["water"] *= self._unit
                tallies.arrivals["air"] *= self._unit
                return last - first, tallies
            # the kernel counts on beyond a full buffer: the second pass has room for all
            room = int(tallies.n_arrivals[0])


def _roulette_of(link: Link, options: Analog, sources: Sources, unit: float) -> tuple[float, float]:
    """Return the weight below which Russian roulette is played, and the probability of survival.

    A probability of 0 stands for weight / limit, after which all weigh the same.
    """
    if options.roulette is not None:
        return options.roulette, 0.0
    if link.physics.absorption == "paper":
        return 1e-3, 0.1  # E13 of docs/paper.md: it ends no photon in water
    # planes and light from the air count photons at depths where all are weak
    if not sources.in_water.all() or link.planes is not None:
        return 1e-3, 0.0
    depth = unit * max(-z for z in sources.position[:, 2])
    # half of exp(-a depth): light that goes straight up never meets the roulette; 600 keeps the
    # limit above 0
    return 0.5 * math.exp(-min(link.water.a * depth, 600.0)), 0.0


def new_recorder(photons: int, vertices: int) -> Recorder:
    """Return empty arrays for the paths of the first photons."""
    return Recorder(
        vertex=np.full((photons, vertices, 3), np.nan),
        weight=np.full((photons, vertices), np.nan),
        what=np.full((photons, vertices), -1, np.int8),
        length=np.zeros(photons, np.int64),
    )


def _no_tallies(link: Link, frame: arrays.Frame, cells: MapGrid) -> Tallies:
    """Return empty tallies with the given map."""
    # arrays that a link does not need have no elements: the kernels then skip their scores
    planes, shape = link.planes, (cells.n, cells.n, len(cells.scale))
    depths = np.array(planes.depths if planes else ())
    bins = (planes.n_cosines, planes.n_azimuths) if planes else (0, 1)
    return Tallies(
        score=np.zeros((0, 0)),
        ledger=np.zeros(len(Fate), np.int64),
        n_photons=np.zeros(len(Fate), np.int64),
        misses=np.zeros(len(Miss), np.int64),
        planes=-depths / frame.unit,
        radiance=np.zeros((SHIFTS, len(depths), *bins), np.int64),
        grid=cells,
        map_tint=np.zeros(len(cells.mixture.shares)),
        map_factors=np.empty((2, len(cells.scale))),
        map=np.zeros(shape, np.int64),
        map_squared=np.zeros(shape, np.int64),
        arrivals=np.zeros(0, ARRIVAL),
        n_arrivals=np.zeros(1, np.int64),
    )


def _cells_of(
    grid: Record | None, link: Link, frame: arrays.Frame, tinting: Tinting, turn: tuple[int, Floats]
) -> MapGrid:
    """Return the cells of a map at the wavelengths of a tinting, none without a map.

    Integer tallies of weak light would lose digits: scores are scaled by the power of two that
    brings the weight on the shortest path through the water to about 1. Weights at other
    wavelengths may exceed it: `_HEADROOM` keeps the sums of a chunk below 2^63.
    """
    if not isinstance(grid, IrradianceMap):
        return MapGrid()
    # by the clearest layer: no path is absorbed less, and no weight is larger
    mixture, tints, layers = tinting.mixture(*turn), tinting.tints, link.water.layers
    levels = [source.center[2] for source in link.transmitters]
    way = min(abs(min(z, 0.0) - min(grid.height, 0.0)) for z in levels)
    a = link.water.a if layers is None else min(row[1] for row in layers)
    # logarithm of the transmission on that path, by wavelength
    logs = np.full(mixture.shares.shape[1], -a * way)
    if tints is not None:
        logs -= mixture.shares.T @ tints.c.mean(axis=1) * way / frame.unit
    return MapGrid(
        n=grid.n,
        z=grid.height / frame.unit,
        x=(-grid.extent - frame.x) / frame.unit,
        y=(-grid.extent - frame.y) / frame.unit,
        step=grid.step / frame.unit,
        axis=Vec3(*grid.axis),
        # not 0: light along the plane does not cross it
        cos=max(math.cos(math.radians(grid.fov_deg) / 2.0), 1e-12),
        mixture=mixture,
        scale=np.exp2(np.floor(-np.clip(logs, -600.0, 0.0) / math.log(2.0)) - _HEADROOM),
    )
