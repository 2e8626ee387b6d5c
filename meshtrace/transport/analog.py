"""The analog estimator: photons followed one by one, a wavefront at a time.

The gain is the mean weight that a photon brings into the aperture. A chunk of photons is
followed by one thread in a pool of slots: a kernel moves the pool, Embree answers its rays,
and so on until the chunk has ended. Chunks are independent and added in their order.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.bvh import Intersector
from meshtrace.kernels import photon as kernel
from meshtrace.kernels.facets import Surface
from meshtrace.kernels.interface import Interface
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.sources import Sources
from meshtrace.kernels.tally import N_FATES, UNIT, Apertures, Tallies
from meshtrace.link import Link
from meshtrace.stored import SHIFTS
from meshtrace.transport.arrays import (
    aperture_arrays,
    interface_arrays,
    medium_arrays,
    source_arrays,
    surface_arrays,
    with_raster,
)

BLOCK = 4096
"""Photons whose scores are added first: fixed, so that sums do not depend on the chunks."""

_SLOTS = 8192  # photons under way in a thread: their state stays in the cache


@dataclass(frozen=True)
class MapGrid:
    """Square cells on a horizontal plane in the air.

    Parameters
    ----------
    height : float
        Height of the plane [m].
    extent : float
        The map covers |x|, |y| <= extent [m].
    step : float
        Edge of a cell [m].
    axis : tuple of float
        Axis of the aperture that the map stands for, as in `Receiver.axis`.
    fov_deg : float
        Full angle of its field of view [deg].
    """

    height: float
    extent: float
    step: float
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fov_deg: float = 180.0

    @property
    def n(self) -> int:
        """Cells along each axis."""
        return math.ceil(2.0 * self.extent / self.step - 1e-9)


class FixedPointSum:
    """Exact sum of integer arrays in units of 2^-44, without overflow."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._whole = np.zeros(shape, np.int64)
        self._part = np.zeros(shape, np.int64)

    def add(self, units: NDArray[np.int64]) -> None:
        """Add an array; the order of additions does not matter."""
        self._part += units
        self._whole += self._part >> 44
        self._part &= (1 << 44) - 1

    def value(self) -> NDArray[np.float64]:
        """Return the sum as floating point numbers."""
        return self._whole + self._part * UNIT


@dataclass
class Sums:
    """What a run of photons has tallied; runs of disjoint photons add."""

    photons: int
    score: NDArray[np.float64]
    score_squared: NDArray[np.float64]
    ledger: FixedPointSum
    count: NDArray[np.int64]
    misses: NDArray[np.int64]
    map: FixedPointSum
    map_squared: FixedPointSum
    radiance: FixedPointSum
    arrivals: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, photons: int, tallies: Tallies) -> None:
        """Add a finished chunk, whose photons follow those already here."""
        self.photons += photons
        for start in range(0, photons, BLOCK):
            block = tallies.score[start : min(start + BLOCK, photons)]
            self.score += block.sum(axis=0)
            self.score_squared += np.einsum("ij,ij->j", block, block)
        self.ledger.add(tallies.ledger)
        self.count += tallies.n_photons
        self.misses += tallies.misses
        self.map.add(tallies.map)
        self.map_squared.add(tallies.map_squared)
        self.radiance.add(tallies.radiance)
        n = min(int(tallies.n_arrivals[0]), len(tallies.arrivals))
        if n:
            rows = tallies.arrivals[:n]
            self.arrivals.append(rows[np.lexsort((rows[:, 3], rows[:, 1], rows[:, 0]))].copy())


class Setup(NamedTuple):
    """Everything that the chunks of one run share."""

    intersector: Intersector
    seed: int
    arrays: tuple[Sources, Surface, Medium, Apertures, Interface, kernel.Limits]
    planes: NDArray[np.float64]
    bins: tuple[int, int]
    grid: MapGrid | None
    keep_arrivals: bool
    recorder: kernel.Recorder


def run_analog(
    link: Link,
    intersector: Intersector,
    *,
    photons: int,
    seed: int,
    normals: str = "vertex",
    threads: int = 1,
    batch_size: int = 2**17,
    first_photon: int = 0,
    max_surface_events: int = 10,
    max_events: int = 100_000,
    roulette: float | None = None,
    first_scored: int = 1,
    grid: MapGrid | None = None,
    keep_arrivals: bool = False,
    recorder: kernel.Recorder | None = None,
    progress: Callable[[int], None] | None = None,
) -> Sums:
    """Follow photons and return their tallies.

    Parameters
    ----------
    link : Link
        The link.
    intersector : Intersector
        The surface.
    photons : int
        Photons to follow, with ids from `first_photon` on.
    seed : int
        Key of the random numbers.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; the result does not depend on them.
    batch_size : int
        Photons of a chunk, a multiple of 4096; the result does not depend on it.
    roulette : float, optional
        Weight below which Russian roulette is played; by default half of the weight that
        absorption leaves on the straight way up (1e-3 with light from the air).
    first_scored : int
        Crossing of the surface from which on light is scored; 2 for what was sent back once.
    grid : MapGrid, optional
        Cells on a plane in the air in which light is counted.
    keep_arrivals : bool
        Keep every arrival at an aperture with its path lengths.
    recorder : Recorder, optional
        Arrays for the paths of the first photons; must fit into the first chunk.
    progress : callable, optional
        Called with the number of photons done since its last call.

    Returns
    -------
    Sums
    """
    setup = _setup(
        link,
        intersector,
        seed,
        normals,
        max_surface_events,
        max_events,
        roulette,
        first_scored,
        grid,
        keep_arrivals,
        recorder,
    )
    sums = _zero(setup)
    end = first_photon + photons
    spans = ((a, min(a + batch_size, end)) for a in range(first_photon, end, batch_size))
    with ThreadPoolExecutor(threads) as pool:
        for n, tallies in _in_order(pool, threads, spans, setup):
            sums.add(n, tallies)
            if progress is not None:
                progress(n)
    return sums


def _in_order(
    pool: ThreadPoolExecutor, threads: int, spans: Iterator[tuple[int, int]], setup: Setup
) -> Iterator[tuple[int, Tallies]]:
    """Yield chunks in order while `threads` of them are computed: memory stays flat."""
    running: deque[Future[tuple[int, Tallies]]] = deque()
    for span in spans:
        running.append(pool.submit(_chunk, setup, *span))
        if len(running) > threads:
            yield running.popleft().result()
    while running:
        yield running.popleft().result()


def _chunk(setup: Setup, first: int, last: int) -> tuple[int, Tallies]:
    """Follow the photons first <= id < last; again, if their arrivals found no room."""
    room = (last - first) * len(setup.arrays[3].radius) if setup.keep_arrivals else 0
    while True:
        tallies = _tallies(setup, last - first, room)
        _follow(setup, first, last, tallies)
        if not setup.keep_arrivals or int(tallies.n_arrivals[0]) <= room:
            return last - first, tallies
        room = int(tallies.n_arrivals[0])


def _follow(setup: Setup, first: int, last: int, tallies: Tallies) -> None:
    """Follow photons in a pool of slots: kernel, Embree, kernel, until all have ended."""
    slots = min(_SLOTS, last - first)
    pool = kernel.Pool(
        state=np.zeros((slots, 10)),
        flag=np.zeros((slots, 8), np.int64),
        origin=np.zeros((slots, 3), np.float32),
        direction=np.zeros((slots, 3), np.float32),
        ray_slot=np.arange(slots),
    )
    # numpy's type: numba takes a Python integer for a signed one
    world = kernel.World(first, np.uint64(setup.seed), *setup.arrays, tallies, setup.recorder)
    facets = np.full(slots, -1, np.int32)
    n_rays, next_photon = slots, first
    while n_rays:
        n_rays, next_photon = kernel.advance(pool, n_rays, facets, next_photon, last, world)
        if n_rays:
            facets = setup.intersector.facets(pool.origin[:n_rays], pool.direction[:n_rays])


def _setup(
    link: Link,
    intersector: Intersector,
    seed: int,
    normals: str,
    max_surface_events: int,
    max_events: int,
    roulette: float | None,
    first_scored: int,
    grid: MapGrid | None,
    keep_arrivals: bool,
    recorder: kernel.Recorder | None,
) -> Setup:
    surface = surface_arrays(intersector.mesh, normals, link.physics.unresolved)
    sources = source_arrays(link, float(surface.high[2]) + 1e-3)
    survival = 0.0
    if roulette is None and link.physics.absorption == "paper":
        roulette, survival = 1e-3, 0.1  # the paper ends no photon in water (E13)
    if roulette is None:
        roulette = 1e-3
        if sources.in_water.all() and link.planes is None:
            depth = max(-z for z in sources.position[:, 2])
            roulette = 0.5 * math.exp(-min(link.water.a * depth, 600.0))
    limits = kernel.Limits(roulette, survival, max_events, max_surface_events, first_scored)
    planes = link.planes
    return Setup(
        intersector,
        seed,
        (
            sources,
            surface,
            with_raster(medium_arrays(link, float(surface.high[2])), intersector),
            aperture_arrays(link),
            interface_arrays(link),
            limits,
        ),
        -np.array(planes.depths) if planes else np.zeros(0),
        (planes.n_cosines, planes.n_azimuths) if planes else (0, 1),
        grid,
        keep_arrivals,
        recorder or new_recorder(0, 0),
    )


def new_recorder(photons: int, vertices: int) -> kernel.Recorder:
    """Return empty arrays for the paths of the first photons."""
    return kernel.Recorder(
        vertex=np.full((photons, vertices, 3), np.nan),
        weight=np.full((photons, vertices), np.nan),
        what=np.full((photons, vertices), -1, np.int8),
        length=np.zeros(photons, np.int64),
    )


def _tallies(setup: Setup, photons: int, room: int = 0) -> Tallies:
    apertures = setup.arrays[3]
    n_scores = len(apertures.radius) + 4 * len(setup.planes)
    grid = setup.grid
    n_cells = grid.n if grid else 0
    return Tallies(
        score=np.zeros((photons, n_scores)),
        ledger=np.zeros(N_FATES, np.int64),
        n_photons=np.zeros(N_FATES, np.int64),
        misses=np.zeros(2, np.int64),
        planes=setup.planes,
        radiance=np.zeros((SHIFTS, len(setup.planes), *setup.bins), np.int64),
        map_z=grid.height if grid else 0.0,
        map_x=-grid.extent if grid else 0.0,
        map_y=-grid.extent if grid else 0.0,
        map_step=grid.step if grid else 1.0,
        map_axis=grid.axis if grid else (0.0, 0.0, 1.0),
        map_cos=max(math.cos(math.radians(grid.fov_deg) / 2.0), 1e-12) if grid else 0.0,
        map=np.zeros((n_cells, n_cells), np.int64),
        map_squared=np.zeros((n_cells, n_cells), np.int64),
        arrivals=np.zeros((room, 5)),
        n_arrivals=np.zeros(1, np.int64),
    )


def _zero(setup: Setup) -> Sums:
    tallies = _tallies(setup, 0)
    n_scores = tallies.score.shape[1]
    return Sums(
        0,
        np.zeros(n_scores),
        np.zeros(n_scores),
        FixedPointSum((N_FATES,)),
        np.zeros(N_FATES, np.int64),
        np.zeros(2, np.int64),
        FixedPointSum(tallies.map.shape),
        FixedPointSum(tallies.map.shape),
        FixedPointSum(tallies.radiance.shape),
    )
