"""Forced detection at many places of one plane, by common chains.

The chains, their allotment to the orders and the mesh are those of one link. The crossings of
each chain on still water are searched at the nodes of a coarse lattice of places; between nodes
they are interpolated, as the start of Newton's method (smooth surfaces) or as the centre of the
proposed crossings (random slopes). Places between nodes of different crossings are searched one
by one. Points aimed at are uniform over the cells of the map, so that the gain is the mean over
the cell. Unscattered light is the sum over the images of the facets, once for all cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused
from meshtrace.kernels import cells as direct
from meshtrace.kernels import places as kernel
from meshtrace.kernels.aiming import FLAT
from meshtrace.kernels.blurred import MOST_PARTS
from meshtrace.kernels.chain_gain import RAY
from meshtrace.kernels.crossings import ROOT, Counter, Search
from meshtrace.kernels.scene import Target
from meshtrace.kernels.unscattered import STACK
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link, Receiver
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map, paced
from meshtrace.results.coverage import as_high, place_of_highest
from meshtrace.stored import SHIFTS
from meshtrace.transport.aimed import ROOTS, AimedChains
from meshtrace.transport.arrays import locator
from meshtrace.transport.chain_sets import CROSSINGS, Request, starts_of
from meshtrace.transport.forced import ForcedDetection, TypicalSea
from meshtrace.transport.forced_link import ANALOG, needs_photons
from meshtrace.transport.options import Forced

_CHAINS = 256  # of the lowest level; the levels above double it
_LAST = int(math.log2(Forced.most_photons // _CHAINS))  # level
_STREAM, _PILOT_STREAM = 32, 16  # of the points of the lowest level, and of the pilot
_NODE_STEP = 0.07  # distance of the nodes over the height of the map above the source
_MOST_NODES = 33  # along an axis
_FEWEST = 100.0  # effective samples, see `lack_of_samples` of the single receivers
_SETTLING = 6  # levels above the highest one, for the place of the highest gain
_SMALL = 0.01  # share of the gain below which its scattered part does not matter
_DARK_LEVEL = 6  # at which a cell without light is given up
_PILOT_CELLS = 16  # cells of the pilot along an axis
_GROWTH = 0.9  # of the level with the logarithm of the variance: shifted points do better
_AT_ONCE = 2**14  # cells of a job
_ROWS = 64  # chains of a job, about
_AT_EDGE = 8  # points along a cell at the edge of the field of view
_AUDITED = 0.02  # share of the chains whose facets are all searched: they count by its inverse
_COARSEST = 16  # points along a cell that resolve the blur by random slopes


class Grid(NamedTuple):
    """Square cells of a map, from (-extent, -extent) on."""

    extent: float  # [m]
    step: float  # [m]

    @property
    def n(self) -> int:
        """Cells along each axis."""
        return math.ceil(2.0 * self.extent / self.step - 1e-9)

    @property
    def half(self) -> float:
        """Half-width of all cells [m]."""
        return 0.5 * self.n * self.step


class Sums(NamedTuple):
    """Gain of cells by shift, and the moments of their scattered light."""

    gain: Floats  # (shifts, cells)
    scattered: Floats  # (cells,)
    square: Floats  # (cells,) variance of the mean of as many independent chains


class Scored(NamedTuple):
    """Contribution of some shifts of the chains of one order to the gain of cells."""

    order: int
    first: int  # shift
    gain: Floats  # (shifts, cells)
    square: Floats  # (cells,) part of `Sums.square`
    counts: dict[str, int]


class ForcedMap:
    """Gain over a plane, averaged over meshes.

    Parameters
    ----------
    link : Link
        The link; height, radius and field of view of its first receiver are used.
    meshes : sequence of TriangleMesh
        Surfaces at several times.
    grid : Grid
        Cells of the map.
    seed : int
        Seed of the chains.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; results do not depend on them.

    Raises
    ------
    Refused
        If the link has a feature that the map does not follow.
    """

    def __init__(
        self,
        link: Link,
        meshes: Sequence[TriangleMesh],
        grid: Grid,
        seed: int,
        normals: str = "vertex",
        threads: int = 1,
    ) -> None:
        require_mappable(link)
        receiver = link.receivers[0]
        middle = grid.half - grid.extent
        ways = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
        sites = tuple(
            receiver.replace(position=(middle + grid.half * a, middle + grid.half * b))
            for a, b in ways
        )
        self._link, self._grid = link.replace(receiver=sites), grid
        self._options = seed, normals, threads
        self._sea = TypicalSea.of(meshes)
        self._require_chains(link.replace(receiver=sites[0]))
        self._base = ForcedDetection(
            self._link, _CHAINS, seed, normals, threads, self._sea, scattered="chains"
        )
        self._arrays = self._base.arrays
        self._unit = self._arrays.frame.unit
        self._target = upright(self._arrays.targets[0])
        self._aimed = [self._over(mesh) for mesh in meshes]
        self._direct = self._unscattered()
        self.counts = dict.fromkeys(("chains", "interpolated", "searched", "enumerated"), 0)
        self.lacking = 0  # cells above the tolerance after the most chains

    def _require_chains(self, link: Link) -> None:
        """Refuse a link whose scattered light in the middle of the map chains do not follow."""
        found = ForcedDetection(link, _CHAINS, *self._options, self._sea)
        if found.method != ["chains"]:
            scattered = Described("light that arrives by many or large angles")
            raise Refused("water", scattered, f"light that chains follow; {ANALOG}")

    def _over(self, mesh: TriangleMesh) -> AimedChains:
        """Return chains over a mesh, with bins of all its facets."""
        aimed = self._base.over(mesh)
        aimed.search_of(self._target)  # bounds of the facets near the receivers, which are kept
        aimed.locator = locator(aimed.surface, [self._target._replace(reach=math.inf)])
        return aimed

    def _unscattered(self) -> Floats | None:
        """Return the unscattered gain (n, n) of the cells; None if it has to be sampled."""
        jobs = [
            partial(self._image, aimed, s)
            for aimed in self._aimed
            for s in range(len(self._arrays.emitters))
        ]
        total = np.zeros((self._grid.n, self._grid.n))
        for found in ordered_map(lambda job: job(), jobs, self._options[2]):
            if found is None:
                return None
            total += found
        return total / len(self._aimed)

    def _image(self, aimed: AimedChains, source: int) -> Floats | None:
        """Return the unscattered gain of the cells from one source over one mesh."""
        scene = aimed.scene(self._arrays.emitters[source], self._target)
        half, step = self._grid.half / self._unit, self._grid.step / self._unit
        cells = direct.Cells(-half, -half, step, self._grid.n)
        gain = np.zeros((self._grid.n, self._grid.n))
        stretch, lever = aimed.bounds_of(scene)
        if not aimed.rough:
            stack, polygons = np.empty((STACK, 3), np.int64), np.empty((2, 16, 2))
            direct.image_map(scene, cells, 1.5 * stretch, lever, stack, polygons, gain)
        else:
            n = scene.medium.n_water / scene.medium.n_air
            height = max(self._target.center.z - float(scene.surface.high[2]), 1e-6)
            blur = abs(n - 1.0) * height * min(scene.surface.roughness[:2])
            across = math.ceil(step / blur) if blur > 0.0 else _COARSEST + 1
            if not aimed.blurred or across > _COARSEST:
                return None
            finer = max(across, min(4 * across, _AT_EDGE))
            rules = direct.Rules(*(direct.Rule(*square_rule(k)) for k in (across, finer)))
            if not direct.blurred_map(scene, cells, stretch, MOST_PARTS, rules, gain):
                return None
        return self._arrays.power[source] * self._target.area / cells.step**2 * gain

    def run(
        self, rtol: float, progress: Callable[[int], None] | None = None
    ) -> tuple[Floats, Floats]:
        """Return gain and standard error (n, n), with chains up to a relative error of each cell.

        A pilot of a few cells assigns each cell its number of chains; cells above the
        tolerance are evaluated again with other chains, more of them. So are those that may be the
        highest, for its place.
        """
        n = self._grid.n
        gain, stderr = np.zeros(n * n), np.zeros(n * n)
        level = self._first_levels(rtol)
        open_ = np.ones(n * n, bool)
        while open_.any():
            now = int(level[open_].min())
            cells = np.flatnonzero(open_ & (level == now))
            for first in range(0, len(cells), _AT_ONCE):
                some = cells[first : first + _AT_ONCE]
                found = self._evaluate(now, some)
                gain[some], stderr[some] = mean_and_error(found)
                more = levels_lacking(found, rtol)
                dark = (gain[some] == 0.0) & (now >= _DARK_LEVEL)
                done = (more == 0) | dark | (now == _LAST)
                self.lacking += int((done & (more > 0) & ~dark).sum())
                open_[some[done]] = False
                level[some] = np.minimum(now + more, _LAST)
                if progress is not None:
                    progress(int(done.sum()))
        whole = gain.reshape(n, n), stderr.reshape(n, n)
        self._settle(*whole, int(level.max()))
        return whole

    def _settle(self, gain: Floats, stderr: Floats, level: int) -> None:
        """Draw more chains in the cells as high as the highest, until its place is resolved."""
        for now in range(level + 2, min(level + _SETTLING, _LAST) + 1, 2):
            if gain.max() == 0.0 or place_of_highest(gain, stderr) is not None:
                return
            cells = np.flatnonzero(as_high(gain, stderr))
            for first in range(0, len(cells), _AT_ONCE):
                some = cells[first : first + _AT_ONCE]
                gain.ravel()[some], stderr.ravel()[some] = mean_and_error(self._evaluate(now, some))

    def _first_levels(self, rtol: float) -> NDArray[np.int64]:
        """Return the level of each cell by a pilot of the lowest level at a lattice of cells."""
        n = self._grid.n
        k = min(n, _PILOT_CELLS)
        at = np.unique(np.linspace(0, n - 1, k).round().astype(np.int64))
        cells = (at[:, None] * n + at[None, :]).ravel()
        more = np.minimum(levels_lacking(self._evaluate(0, cells, _PILOT_STREAM), rtol), _LAST)
        nearest = np.abs(np.arange(n)[:, None] - at).argmin(axis=1)
        lattice = more.reshape(len(at), len(at))
        return lattice[np.ix_(nearest, nearest)].ravel()

    def _evaluate(self, level: int, cells: NDArray[np.int64], stream: int = _STREAM) -> Sums:
        """Return the sums of cells with the chains of a level, an independent set by stream."""
        n = self._grid.n
        places = np.stack([cells // n, cells % n], axis=1) + 0.5
        places = np.asarray(places * self._grid.step - self._grid.half) / self._unit
        sums = Sums(np.zeros((SHIFTS, len(cells))), np.zeros(len(cells)), np.zeros(len(cells)))
        if self._direct is not None:
            sums.gain[:] = self._direct.ravel()[cells]
        jobs = list(self._jobs(level, places, stream))
        scattered = ordered_map(lambda job: job(), jobs, self._options[2])
        for part in paced(scattered, len(jobs), f"{len(cells):,} cells"):
            sums.gain[part.first : part.first + len(part.gain)] += part.gain
            if part.order > 0:
                sums.scattered[:] += part.gain.sum(axis=0) / SHIFTS
                sums.square[:] += part.square
            for name, count in part.counts.items():
                self.counts[name] += count
        return sums

    def _jobs(self, level: int, places: Floats, stream: int) -> Iterator[Callable[[], Scored]]:
        """Yield jobs over whole shifts of the chains of a level."""
        photons = _CHAINS << level
        requests = self._base.requests(photons, stream + level)
        if self._direct is None:
            requests += self._base.unscattered_requests(photons, stream + level)
        lattice = self._nodes(places)
        for aimed in self._aimed:
            for request in requests:
                step = max(_ROWS // request.per_shift, 1)
                for first in range(0, SHIFTS, step):
                    shifts = first, min(first + step, SHIFTS)
                    yield partial(self._score, aimed, request, *shifts, places, *lattice)

    def _search(self, aimed: AimedChains) -> Search:
        """Return the search of crossings, for a share of the chains even where waves focus."""
        search = aimed.search_of(self._target)
        return search if search.audit == 1.0 else search._replace(audit=_AUDITED, curvature=0.0)

    def _nodes(self, places: Floats) -> tuple[kernel.Nodes, NDArray[np.bool_]]:
        """Return the lattice of nodes, and those around the places; none for fewer places."""
        half, emitters = self._grid.half / self._unit, self._arrays.emitters
        height = self._target.center.z - max(e.position.z for e in emitters)
        k = min(max(math.ceil(2.0 * half / (_NODE_STEP * height)), 1) + 1, _MOST_NODES)
        nodes = kernel.Nodes(-half, 2.0 * half / (k - 1), k)
        at = np.clip(np.floor((places + half) / nodes.step).astype(np.int64), 0, k - 2)
        needed = np.zeros((k, k), bool)
        for a, b in np.ndindex(2, 2):
            needed[at[:, 0] + a, at[:, 1] + b] = True
        if len(places) < np.count_nonzero(needed):
            return kernel.Nodes(-half, 2.0 * half, 2), np.zeros((2, 2), bool)
        return nodes, needed

    def _score(
        self,
        aimed: AimedChains,
        request: Request,
        first: int,
        last: int,
        places: Floats,
        nodes: kernel.Nodes,
        needed: NDArray[np.bool_],
    ) -> Scored:
        """Return the scores of some shifts of the chains of one order."""
        source, per_shift = request.source, request.per_shift
        chains = self._base.drawer.draw_shifts(request, first, last)
        still, raised = self._base.drawer.still_scenes(source, self._target)
        starts = starts_of(still.emitter, still.target)
        scene = aimed.scene(still.emitter, self._target)
        room = kernel.Room(
            np.zeros(CROSSINGS, FLAT),
            np.zeros_like(starts),
            np.zeros(chains.order + 2, RAY),
            np.zeros(ROOTS, ROOT),
            np.zeros(len(Counter), np.int64),
            np.zeros(2, np.int64),
        )
        way = kernel.Way(starts, start_shares(starts), still, raised)
        law = kernel.Law(self._search(aimed), aimed.spread, aimed.blurred)
        score, square = np.zeros((last - first, len(places))), np.zeros(len(places))
        side = self._grid.step / self._unit / self._target.radius
        chains = chains._replace(
            chains=chains.chains._replace(disk=square_of(chains.chains.disk, side))
        )
        for i in range(0, len(chains.audit), _ROWS):
            some = chains.rows(slice(i, i + _ROWS))
            flats = np.zeros((len(some.audit), nodes.n, nodes.n, CROSSINGS), FLAT)
            if needed.any():
                kernel.node_crossings(some.chains, nodes, needed, way, room, flats)
            else:
                flats["branch"] = 1.0  # as of many crossings: the places are searched one by one
            shift = (i + np.arange(len(some.audit))) // per_shift
            kernel.cell_scores(
                some.chains, some.audit, shift, flats, nodes, places, way, law, scene, room,
                score, square,
            )  # fmt: skip
        share = float(self._arrays.power[source]) / (per_shift * len(self._aimed))
        counts = {
            "chains": len(chains.audit) * len(places),
            "interpolated": int(room.places[0]),
            "searched": int(room.places[1]),
            "enumerated": int(room.counters[Counter.ENUMERATED]),
        }
        square *= (share / SHIFTS) ** 2
        return Scored(chains.order, first, share * score, square, counts)


def require_mappable(link: Link) -> None:
    """Refuse features that chains to many places do not follow."""
    receiver = link.receivers[0]
    beyond = needs_photons(link)
    if beyond is not None:
        raise Refused(*beyond, f"a point source in bottomless water; {ANALOG}")
    if link.direction == "down" or not isinstance(receiver, Receiver):
        raise Refused("receiver", Described(receiver.kind), f"a receiver in the air; {ANALOG}")
    if receiver.tilt_deg != 0.0:
        raise Refused("receiver.tilt_deg", receiver.tilt_deg, f"0; {ANALOG}")


def upright(target: Target) -> Target:
    """Return an aperture with axes along x and y."""
    return target._replace(e1=Vec3(1.0, 0.0, 0.0), e2=Vec3(0.0, 1.0, 0.0))


def start_shares(starts: Floats) -> Floats:
    """Return the displacement of each start of the search with that of the aperture."""
    return np.array([1.0, 0.5, 0.0] + [1.0] * (len(starts) - 3))


def square_of(disk: Floats, side: float) -> Floats:
    """Return points of a square from those of the unit disk, by a map that preserves areas."""
    radial = np.square(disk).sum(axis=1)
    angular = np.arctan2(disk[:, 1], disk[:, 0]) / (2.0 * math.pi) + 0.5
    return side * (np.stack([radial, angular], axis=1) - 0.5)


def square_rule(n: int) -> tuple[Floats, Floats]:
    """Return points and shares of Gauss's rule over the unit square about the origin."""
    x, w = np.polynomial.legendre.leggauss(n)
    a, b = np.meshgrid(0.5 * x, 0.5 * x, indexing="ij")
    return np.stack([a.ravel(), b.ravel()], axis=1), np.outer(0.5 * w, 0.5 * w).ravel()


def mean_and_error(sums: Sums) -> tuple[Floats, Floats]:
    """Return gain and standard error of cells."""
    return sums.gain.mean(axis=0), sums.gain.std(axis=0, ddof=1) / math.sqrt(SHIFTS)


def levels_lacking(sums: Sums, rtol: float) -> NDArray[np.int64]:
    """Return the levels that cells lack, 0 where error and effective samples suffice."""
    gain, stderr = mean_and_error(sums)
    with np.errstate(divide="ignore", invalid="ignore"):
        lack = np.where(gain > 0.0, (stderr / gain / rtol) ** 2, math.inf)
        few = _FEWEST * sums.square / sums.scattered**2
    matters = (sums.scattered > _SMALL * gain) & (gain > 0.0)
    lack = np.maximum(lack, np.where(matters, few, 0.0))
    more = np.ceil(np.clip(_GROWTH * np.log2(np.maximum(lack, 1e-9)), -1.0, 4.0))
    return np.where(lack > 1.0, np.maximum(more, 1.0), 0.0).astype(np.int64)
