"""The analog estimator: individual photons.

The gain is the mean weight of a photon in the aperture. A chunk of photons is followed by one
thread. Chunks are independent and added in their order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import Intersector
from meshtrace.engine.photons import state as kernel
from meshtrace.engine.photons.flight import follow
from meshtrace.engine.setup import arrays
from meshtrace.engine.setup.options import BLOCK, Analog, IrradianceMap, Record, read_records
from meshtrace.kernels.rays import NO_BVH
from meshtrace.kernels.sources import FORWARD, N_SCORES
from meshtrace.kernels.tally import ARRIVAL, N_PLANE_SCORES, UNIT, Fate, Tallies
from meshtrace.kernels.vectors import UP, Vec3
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map, paced
from meshtrace.stored import SHIFTS

_GUIDED = 100  # crossings of light that a jet guides
_EXACT = ("ledger", "map", "map_squared", "radiance")  # fields of `PhotonSums` and of tallies
_SUMS = (*_EXACT, "n_photons", "misses", "n_arrivals")


def options_over(mesh: TriangleMesh, options: Analog) -> Analog:
    """Return the options for a mesh: up to 100 crossings by default for one that overhangs.

    A jet guides light by dozens of total reflections.
    """
    if mesh.single_valued or "max_surface_events" in options.model_fields_set:
        return options
    return options.replace(max_surface_events=_GUIDED)


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

    def value(self) -> Floats:
        """Return the sum as floating point numbers."""
        return self._whole + self._part * UNIT


@dataclass
class PhotonSums:
    """Tallies of a run of photons; tallies of disjoint photons add."""

    photons: int
    score: Floats
    score_squared: Floats
    count: NDArray[np.int64]
    misses: NDArray[np.int64]
    ledger: FixedPointSum
    map: FixedPointSum
    map_squared: FixedPointSum
    radiance: FixedPointSum
    arrivals: list[NDArray[np.void]] = field(default_factory=list)

    def add(self, photons: int, tallies: Tallies) -> None:
        """Add a finished chunk with the next photons."""
        self.photons += photons
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
            rows = tallies.arrivals[:n]
            order = np.lexsort((rows["water"], rows["receiver"], rows["photon"]))
            self.arrivals.append(rows[order])


class Setup(NamedTuple):
    """Inputs common to the chunks of one run, in local coordinates, with tallies of no photons."""

    frame: arrays.Frame
    intersector: Intersector
    world: kernel.World
    arrivals: bool

    @property
    def n_scores(self) -> int:
        """Scores of a photon: one by aperture, four by plane; two of a backward photon."""
        world = self.world
        if len(world.back.origin):
            return N_SCORES
        return len(world.apertures.radius) + N_PLANE_SCORES * len(world.tallies.planes)


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
    recorder: kernel.Recorder | None = None,
    progress: Callable[[int], None] | None = None,
    sums: PhotonSums | None = None,
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
        Whether apertures in the air and maps score light that has met its first crossing alone.
    record : sequence of Record
        Extra tallies.
    recorder : Recorder, optional
        Arrays for the paths of the first photons; must fit into the first chunk.
    progress : callable, optional
        Called with the number of photons done since its last call.
    sums : PhotonSums, optional
        Tallies of other photons with the same records, to which these are added.

    Returns
    -------
    PhotonSums
    """
    records = read_records(record, options)
    options = options_over(intersector.mesh, options)
    recorder = recorder or new_recorder(0, 0)
    setup = setup_of(link, intersector, options, seed, normals, unscattered, records, recorder)
    if sums is None:
        none, score = setup.world.tallies, np.zeros(setup.n_scores)
        exact: Any = {name: FixedPointSum(getattr(none, name).shape) for name in _EXACT}
        counts = none.n_photons.copy(), none.misses.copy()
        sums = PhotonSums(0, score, score.copy(), *counts, **exact)
    first, end = options.first_photon, options.first_photon + photons
    starts = range(first, end, options.batch_size)
    chunks = ((start, min(start + options.batch_size, end)) for start in starts)
    traced = ordered_map(partial(chunk_tallies, setup), chunks, threads)
    for n, tallies in paced(traced, photons, f"{photons:,} photons", lambda part: part[0]):
        sums.add(n, tallies)
        if progress is not None:
            progress(n)
    recorder.vertex[:] = setup.frame.metres(recorder.vertex)
    return sums


def chunk_tallies(setup: Setup, span: tuple[int, int]) -> tuple[int, Tallies]:
    """Trace the photons first <= id < last; repeat with a larger buffer if arrivals overflow."""
    first, last = span
    room = (last - first) * len(setup.world.apertures.radius) if setup.arrivals else 0
    while True:
        none = setup.world.tallies
        tallies = none._replace(
            score=np.zeros((last - first, setup.n_scores)),
            arrivals=np.zeros(room, ARRIVAL),
            **{name: np.zeros_like(getattr(none, name)) for name in _SUMS},
        )
        with setup.intersector.function() as bvh:
            world = setup.world._replace(first=first, tallies=tallies, bvh=bvh)
            follow(first, last, world._replace(photon=np.zeros(1, kernel.PHOTON)))
        if not setup.arrivals or int(tallies.n_arrivals[0]) <= room:
            tallies.arrivals["water"] *= setup.frame.unit
            tallies.arrivals["air"] *= setup.frame.unit
            return last - first, tallies
        room = int(tallies.n_arrivals[0])


def setup_of(
    link: Link,
    intersector: Intersector,
    options: Analog,
    seed: int,
    normals: str,
    unscattered: bool = True,
    records: Mapping[str, Record] = MappingProxyType({}),
    recorder: kernel.Recorder | None = None,
    frame: arrays.Frame | None = None,
) -> Setup:
    """Return the inputs of the chunks, in the frame of the link unless one is given."""
    frame = frame or arrays.frame_of(link)
    if frame != arrays.IDENTITY:
        intersector = intersector.over(frame.mesh(intersector.mesh))
    surface = arrays.surface_arrays(intersector.mesh, normals, link.physics.unresolved)
    crest = float(surface.high[2])
    sources = frame.sources(arrays.source_arrays(link, frame.unit * (crest + 1e-3)))
    roulette, survival = options.roulette, 0.0
    if roulette is None and link.physics.absorption == "paper":
        roulette, survival = 1e-3, 0.1  # the paper ends no photon in water (E13)
    if roulette is None:
        roulette = 1e-3
        if sources.in_water.all() and link.planes is None:
            depth = frame.unit * max(-z for z in sources.position[:, 2])
            roulette = 0.5 * math.exp(-min(link.water.a * depth, 600.0))
    medium = frame.medium(arrays.medium_arrays(link, frame.unit * crest))
    world = kernel.World(
        first=0,
        seed=np.uint64(seed),  # numba takes a Python integer for a signed one
        sources=sources,
        surface=surface,
        grid=arrays.grid_arrays(intersector.mesh) if intersector.shortcut else arrays.NO_GRID,
        medium=arrays.with_raster(medium, intersector),
        apertures=frame.apertures(arrays.aperture_arrays(link)),
        interface=arrays.interface_arrays(link),
        limits=kernel.Limits(
            roulette, survival, options.max_events, options.max_surface_events, unscattered
        ),
        tallies=_no_tallies(link, frame, records.get("irradiance-map")),
        recorder=recorder or new_recorder(0, 0),
        back=FORWARD,
        bvh=NO_BVH,
        photon=np.zeros(1, kernel.PHOTON),
    )
    return Setup(frame, intersector, world, "arrivals" in records)


def new_recorder(photons: int, vertices: int) -> kernel.Recorder:
    """Return empty arrays for the paths of the first photons."""
    return kernel.Recorder(
        vertex=np.full((photons, vertices, 3), np.nan),
        weight=np.full((photons, vertices), np.nan),
        what=np.full((photons, vertices), -1, np.int8),
        length=np.zeros(photons, np.int64),
    )


def _no_tallies(link: Link, frame: arrays.Frame, record: Record | None) -> Tallies:
    """Return tallies of no photons."""
    planes, grid = link.planes, record if isinstance(record, IrradianceMap) else None
    depths = np.array(planes.depths if planes else ())
    bins = (planes.n_cosines, planes.n_azimuths) if planes else (0, 1)
    n_cells = grid.n if grid else 0
    return Tallies(
        score=np.zeros((0, 0)),
        ledger=np.zeros(len(Fate), np.int64),
        n_photons=np.zeros(len(Fate), np.int64),
        misses=np.zeros(len(kernel.Miss), np.int64),
        planes=-depths / frame.unit,
        radiance=np.zeros((SHIFTS, len(depths), *bins), np.int64),
        map_z=grid.height / frame.unit if grid else 0.0,
        map_x=(-grid.extent - frame.x) / frame.unit if grid else 0.0,
        map_y=(-grid.extent - frame.y) / frame.unit if grid else 0.0,
        map_step=grid.step / frame.unit if grid else 1.0,
        map_axis=Vec3(*grid.axis) if grid else UP,
        map_cos=max(math.cos(math.radians(grid.fov_deg) / 2.0), 1e-12) if grid else 0.0,
        map=np.zeros((n_cells, n_cells), np.int64),
        map_squared=np.zeros((n_cells, n_cells), np.int64),
        arrivals=np.zeros(0, ARRIVAL),
        n_arrivals=np.zeros(1, np.int64),
    )
