"""Scattered light over the cells of a map, by chains that neighbouring cells share.

Each square tile of cells has its own chains, aimed at the middle of the tile. Their crossings of
still water are moved to first order to each cell. Over random slopes a crossing is drawn about
that point and counts by its density there, so that the estimate is unbiased about any point. Points
aimed at are uniform over a cell: the result is the mean gain over the area of the cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from meshtrace.engine.chains import gain as kernel
from meshtrace.engine.chains.aimed import AimedChains
from meshtrace.engine.chains.sampling import Chains
from meshtrace.engine.chains.sets import (
    TURBID,
    Block,
    ChainDrawer,
    ChainSet,
    Request,
    blocks_of,
    levels,
)
from meshtrace.engine.choice import LITTLE, PILOT, Pilot, allotment, pilot_statistics, returned_gain
from meshtrace.engine.crossing import FLAT, ROOT
from meshtrace.engine.setup.ends import forced_link, require_chains
from meshtrace.engine.setup.options import IrradianceMap
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.results.series import LIT
from meshtrace.results.tallies import error_of_groups
from meshtrace.stored import SHIFTS

_TILE = 0.06  # edge of a tile over the height of the map above the sources: seen from there under
# 3 degrees, as the cells of `representatives`
_TOGETHER = 2**15  # scores that are computed at a time, which stay in the cache of a core
_REGIONS = 4  # along each side of a map, in which chains are compared with photons
_DOUBT = 3.5  # standard errors by which they may differ there, as in `choice`
# CPU times over that of an analog photon, measured on the default link: to aim a chain at a cell
# took 0.31, to draw it for a tile 3.6, and a photon 0.28 microseconds
_TO_CELL, _TO_TILE = 1.2, 12.0
_OF_TILE = 14_000.0  # of a tile beside its chains, most of it pilots
_FEWEST = 100.0  # effective chains: the standard error of fewer is uncertain itself
_SMALL = 0.01  # share of the gain below which its scattered part does not matter, tuned
_MARGIN = 1.2  # factor on the number of chains that an error asks for, tuned
_MOST_CHAINS = 2**20  # of a tile, tuned: time for accuracy
FIRST = 512
"""Chains of a tile before the first comparison with a tolerance."""
_STREAM = 8  # part of the seeds of all points of this module; those of tiles have two more parts


Tile = tuple[slice, slice]
"""Cells of a map with common chains, by their numbers along x and y."""


@dataclass(frozen=True)
class TileSums:
    """Mean scattered light of the cells of a tile, and its variance, by a number of chains.

    A container of its own: `Gains` would hold three parts and all orders for each of 10^4 cells.
    """

    chains: int
    gain: Floats  # (shifts, cells), each shift an estimate of its own; the mean is the gain
    square: Floats  # (cells,) sum of the squares of what each chain brings to the gain

    def to_row(self) -> Floats:
        """Return the sums as one row of numbers."""
        return np.concatenate([[float(self.chains)], self.square, self.gain.ravel()])

    @classmethod
    def of_row(cls, row: Floats) -> TileSums:
        """Return the sums that `to_row` wrote."""
        cells = (len(row) - 1) // (SHIFTS + 1)
        return cls(int(row[0]), row[1 + cells :].reshape(SHIFTS, cells), row[1 : 1 + cells])

    def __add__(self, other: TileSums) -> TileSums:
        """Return the sums of two sets of chains together, weighted by their numbers."""
        n, share = self.chains + other.chains, other.chains / (self.chains + other.chains)
        # both are means: that of all chains weighs them by their shares, and sums of squares by the
        # squares of these
        gain = (1.0 - share) * self.gain + share * other.gain
        return TileSums(n, gain, (1.0 - share) ** 2 * self.square + share**2 * other.square)

    @property
    def mean(self) -> Floats:
        """Scattered gain of the cells."""
        return np.asarray(self.gain.mean(axis=0))

    @property
    def stderr(self) -> Floats:
        """Standard error of each cell; errors within a tile are correlated."""
        return error_of_groups(self.gain, axis=0)

    @property
    def effective(self) -> Floats:
        """Number of equal chains with the variance of each cell (Kish's effective sample size)."""
        # (sum w)^2 / sum w^2; 1e-300 gives 0 for 0 / 0 in the dark
        return np.asarray(self.mean**2 / np.maximum(self.square, 1e-300))


def mean_of_times(times: Sequence[TileSums]) -> TileSums:
    """Return the mean light over surfaces that the same chains cross."""
    gain = np.mean([at_time.gain for at_time in times], axis=0)
    # Errors of the same chains may add up: standard deviations are averaged, not variances. Gains
    # are averaged shift by shift, which keeps their correlation.
    square = np.mean([np.sqrt(at_time.square) for at_time in times], axis=0) ** 2
    return TileSums(times[0].chains, gain, square)


def further(by_tile: Sequence[TileSums], lack: Floats) -> dict[int, int]:
    """Return the number of further chains that tiles need, by tile number.

    `lack` (tiles,) is that of `CellChains.lack`.
    """
    wanted = dict[int, int]()
    for tile, (sums, factor) in enumerate(zip(by_tile, lack.tolist(), strict=True)):
        # an error of few chains is itself uncertain: never more than sixteenfold at once
        total = min(math.ceil(sums.chains * min(_MARGIN * factor, 16.0)), _MOST_CHAINS)
        if factor > 1.0 and total > sums.chains:
            wanted[tile] = total - sums.chains
    return wanted


class _SquareDrawer(ChainDrawer):
    """Sampler of chains aimed at points of squares; the `radius` of a target is the edge."""

    def place_points(self, chains: Chains) -> None:
        """Map points of the unit disk to the unit square about the origin."""
        # points of the disk are r = u^(1/2), phi = 2 pi v: u - 1/2, and v in -1/2 ... 1/2
        x, y = chains.disk.T
        radial, angular = x * x + y * y, np.arctan2(y, x) / (2.0 * math.pi)
        chains.disk[:] = np.column_stack([radial - 0.5, angular])

    def of_tile(self, tile: int) -> _SquareDrawer:
        """Return a sampler of chains that cross still water towards a single tile."""
        drawer = copy(self)
        every = np.full(len(self.link.targets), tile)
        drawer.link = self.link._replace(stands_for=every)
        return drawer


class CellChains:
    """Scattering chains aimed at the cells of a map.

    Parameters
    ----------
    link : Link
        The link; height, radius and field of view of its first receiver, upright, are used.
    meshes : sequence of TriangleMesh
        Surfaces at the times of the map, with the same random slopes.
    grid : IrradianceMap
        Cells of the map.
    seed : int
        Seed of the chains.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads of the pilots; results do not depend on them.
    stride : int
        Take only every `stride`-th tile along each side, to estimate the cost of all.

    Raises
    ------
    Refused
        If chains do not follow the link.
    """

    def __init__(
        self,
        link: Link,
        meshes: Sequence[TriangleMesh],
        grid: IrradianceMap,
        seed: int,
        normals: str = "vertex",
        threads: int = 1,
        stride: int = 1,
    ) -> None:
        require_chains(link)
        self._grid, self._seed, self._threads = grid, seed, threads
        receiver = link.receivers[0]
        self.cells = grid.n  # along each side
        self.tiles, middles, self._number = _tiles(link, grid, stride)
        sites = tuple(receiver.replace(position=place) for place in middles)
        self._link = link.replace(receiver=sites)
        arrays = forced_link(self._link)
        # square cells as targets, whose radius stands for the edge, see `_SquareDrawer`
        x, y, edge = Vec3(1.0, 0.0, 0.0), Vec3(0.0, 1.0, 0.0), grid.step / arrays.frame.unit
        squares = [t._replace(radius=edge, e1=x, e2=y) for t in arrays.targets]
        arrays = arrays._replace(targets=squares, stands_for=np.arange(len(squares)))
        # the chains are the same at all times: scatterings lie up to the highest of all crests
        crest = max(float(mesh.bounds[1, 2]) for mesh in meshes)
        self._drawer = _SquareDrawer(arrays, *levels(arrays, crest))
        self._orders = [self._drawer.last_order(s) for s in range(len(arrays.emitters))]
        self._aimed = [
            AimedChains(arrays, mesh, normals, link.physics.unresolved) for mesh in meshes
        ]

    @property
    def serves(self) -> bool:
        """Whether chains can serve the map: with scattering, clear water and random slopes."""
        # without random slopes each cell has crossings of its own; in turbid water photons are
        # the better estimator anywhere, see `choice`
        clear = max(law.expected for law in self._drawer.nominals) < TURBID
        return clear and all(self._orders) and all(aimed.blurred for aimed in self._aimed)

    @cached_property
    def pilots(self) -> list[Pilot]:
        """Pilot of each source over the first surface, by tile and order."""
        targets, pilots = list(range(len(self.tiles))), []
        for s, last in enumerate(self._orders):
            # PILOT chains of each order, in SHIFTS groups
            requests = [
                Request(s, k, PILOT // SHIFTS, (self._seed, s, k, _STREAM))
                for k in range(1, last + 1)
            ]
            job = partial(pilot_statistics, self._drawer, [self._aimed[0]], targets)
            statistics = ordered_map(job, requests, self._threads)
            pilots.append(np.array([row[0][0] for row in statistics]).transpose(1, 2, 0))
        return pilots

    @property
    def n(self) -> int:
        """Number of tiles along each side of the map; with a stride, the number of tiles used."""
        return math.isqrt(len(self.tiles))

    def omits(self, gain: Floats) -> bool:
        """Return whether chains omit too much light, reflected first, in any tile.

        `gain` (n, n) is that of the cells; the light is estimated in the middle of each tile.
        """
        middle = np.array([gain[tile].mean() for tile in self.tiles])
        least = LITTLE * np.maximum(middle, LIT * gain.max())
        return bool((returned_gain(self._link) > least).any())

    def scattered(self, by_tile: Sequence[TileSums]) -> tuple[Floats, Floats]:
        """Return gain and standard error of all cells (n, n); 0 where a stride leaves out tiles."""
        gain, stderr = np.zeros((2, self._grid.n, self._grid.n))
        for tile, sums in zip(self.tiles, by_tile, strict=True):
            shape = gain[tile].shape
            gain[tile], stderr[tile] = sums.mean.reshape(shape), sums.stderr.reshape(shape)
        return gain, stderr

    def agree(self, by_tile: Sequence[TileSums], gain: Floats, stderr: Floats) -> bool:
        """Test whether scattered gains of photons and chains agree within chance.

        `gain` and `stderr` (n, n) are those of the cells by photons. Sums over regions of the map
        are compared: chains may miss light, as that of large angles, without a sign of it in their
        errors.
        """
        n = min(_REGIONS, self.n)
        total, square = np.zeros((2, n, n))
        for k, (tile, sums) in enumerate(zip(self.tiles, by_tile, strict=True)):
            # cells of a tile share chains: their errors add up, and only that of the sum is known
            i, j = divmod(k, self.n)
            region = i * n // self.n, j * n // self.n
            by_shift = sums.gain.sum(axis=1)
            total[region] += gain[tile].sum() - by_shift.mean()
            square[region] += np.square(stderr[tile]).sum() + error_of_groups(by_shift) ** 2
        return bool((np.abs(total) <= _DOUBT * np.sqrt(square)).all())

    def cost(self, chains: Floats) -> float:
        """Return the time of a map, in analog photons, from the numbers of chains of its tiles."""
        # per tile, times all of them: with a stride `chains` is a sample of the tiles
        cells = self._grid.n**2 / self._number
        each = float(np.mean(chains)) * (_TO_CELL * cells + _TO_TILE) + _OF_TILE
        return len(self._aimed) * self._number * each

    def lack(self, by_tile: Sequence[TileSums], direct: Floats, rtol: float) -> Floats:
        """Return the required over the present number of chains of each tile.

        For a relative error of all of its cells, and scattered light worth `_FEWEST` equal chains
        where it matters; `direct` is the unscattered gain of the cells (n, n).
        """
        gain, _ = self.scattered(by_tile)
        gain = gain + direct
        # cells below `LIT` of the brightest are accurate enough with the error of one at that limit
        least, ratios = LIT * gain.max(), []
        for tile, sums in zip(self.tiles, by_tile, strict=True):
            whole = np.maximum(gain[tile].ravel(), least)
            # variances fall in proportion to the number of chains
            square = (sums.stderr / (rtol * whole)) ** 2
            few = np.where(
                sums.mean > _SMALL * whole, _FEWEST / np.maximum(sums.effective, 1e-9), 0.0
            )
            ratios.append(float(np.maximum(square, few).max()))
        return np.array(ratios)

    def sums(self, time: int, tile: int, chains: int, first: int) -> TileSums:
        """Return the light that chains bring to a tile over the surface at a time.

        Parameters
        ----------
        time, tile : int
            Numbers of the surface and of the tile.
        chains : int
            Chains of all sources and orders.
        first : int
            Chains that the tile had before: makes the seed of these another one.
        """
        # centres of the cells, (cells, 3) in the frame of the link
        x, y = np.meshgrid(*(self._grid.axes[part] for part in self.tiles[tile]), indexing="ij")
        centres = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, self._grid.height)])
        places = self._drawer.link.frame.points(centres)
        total = TileSums(0, np.zeros((SHIFTS, len(places))), np.zeros(len(places)))
        # each source has an equal part of the chains, as pilots do not compare the light of sources
        drawer, share = self._drawer.of_tile(tile), max(chains // len(self.pilots), SHIFTS)
        for s, (_, _, spread, _) in enumerate(self.pilots):
            expected = self._drawer.nominals[s].expected
            # by the pilot of this tile alone, with a weight of 1
            counts = allotment(share, expected, spread[[tile]], np.ones(1), np.ones(1, np.int64))
            for k, n in enumerate(counts.tolist(), 1):
                request = Request(s, k, n, (self._seed, s, k, _STREAM, tile, first))
                total = replace(total, chains=total.chains + request.number)
                for block in blocks_of(request):
                    self._add(total, block, drawer.drawn(block), time, tile, places)
        return total

    def _add(
        self, total: TileSums, block: Block, chains: ChainSet, time: int, tile: int, places: Floats
    ) -> None:
        """Add the light of the chains of a block to places of a tile."""
        aimed, request, shifts = self._aimed[time], block.request, block.shifts_in
        scene = aimed.scene(aimed.link.emitters[request.source], aimed.link.targets[tile])
        flat, share = chains.crossings(tile), aimed.link.share(request.source, tile)
        near, n = np.zeros(flat.shape[1], FLAT), len(flat)  # scratch of a chain; number of chains
        # all chains to a few cells at a time: their scores stay in the cache of a core
        at_once = max(_TOGETHER // n, 1)
        for i in range(0, len(places), at_once):
            cells = slice(i, min(i + at_once, len(places)))
            out = kernel.Output(
                score=np.zeros((cells.stop - i) * n),
                arrivals=np.empty(0, kernel.ARRIVAL),
                counters=np.zeros(len(kernel.Counter), np.int64),
                roots=np.zeros(1, ROOT),
            )
            kernel.blurred_contributions(
                chains.chains, flat, places[cells], near, aimed.spread, scene, out
            )
            score = out.score.reshape(cells.stop - i, shifts.stop - shifts.start, -1)
            total.gain[shifts, cells] += share / request.per_shift * score.sum(axis=2).T
            square = np.einsum("ijk,ijk->i", score, score)
            total.square[cells] += square * (share / request.number) ** 2


def _tiles(
    link: Link, grid: IrradianceMap, stride: int
) -> tuple[list[Tile], list[tuple[float, float]], int]:
    """Return tiles of a map, their centres [m], and the number of tiles without a stride.

    Tiles have about the same number of cells along each side, at least one.
    """
    # light from below is blurred in proportion to its way: the edge of a tile is a share of it
    level = max(source.center[2] for source in link.transmitters)
    across = max(math.floor(_TILE * (grid.height - level) / grid.step), 1)
    cuts = np.linspace(0, grid.n, math.ceil(grid.n / across) + 1).round().astype(int).tolist()
    parts = [slice(*ends) for ends in pairwise(cuts)]
    number, chosen = len(parts) ** 2, parts[min(stride // 2, len(parts) - 1) :: stride]
    middle = {part.start: float(grid.axes[part].mean()) for part in chosen}
    tiles = [(a, b) for a in chosen for b in chosen]
    return tiles, [(middle[a.start], middle[b.start]) for a, b in tiles], number
