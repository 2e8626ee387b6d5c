"""Sets of chains: points, number by order, collisions, and crossings of a flat sea.

Points are scrambled Sobol points of the unit cube, the same as by `scipy.stats.qmc.Sobol`: the
import of `scipy.stats` takes as long as a third of a whole run. `joe_kuo.txt` has the first rows of
new-joe-kuo-6.21201 (Joe and Kuo 2008, https://web.maths.unsw.edu.au/~fkuo/sobol): the number of a
dimension, degree s and inner coefficients a of a primitive polynomial, and its first direction
numbers m_i.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from copy import copy
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.chains import sampling as kernel
from meshtrace.engine.chains.gain import ARRIVAL, flat_contributions, flat_crossings
from meshtrace.engine.chains.sampling import Chains, Nominal
from meshtrace.engine.crossing import FLAT
from meshtrace.engine.setup.arrays import NO_BINS, integral, surface_arrays
from meshtrace.engine.setup.ends import ForcedLink
from meshtrace.errors import Refused
from meshtrace.kernels.interface import MeshArrays
from meshtrace.kernels.medium import DepthMode, Medium
from meshtrace.kernels.scene import FACET, Emitter, Scene, Target
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.stored import SHIFTS

# Which orders of scattering chains follow. `joe_kuo.txt` has points for 72 orders.
_TAIL = 1e-7  # orders whose share of a Poisson law is smaller together are left out
_MAX_ORDER = 72
_MOST_CROWDED = 4.0  # density of collisions in the upper half of the way over the mean, see
# `ChainDrawer.last_order`; tuned: water that is refused against large weights
_MOST_LEFT_OUT = 1e-3  # probability of more scatterings than the highest order

# Memory and threads: digits depend on none of these.
_MOST_CACHED = 2**15  # numbers in a set of points that is cached for the next surface: 256 kB
_BLOCK, _LARGEST = 1024, 8192  # chains of a block for one thread: about, and at most
_CHAIN_BYTES = 2**26  # chains of more bytes are drawn again for each surface
CROSSINGS = 4  # crossings of a flat sea that are stored for each chain; the others are lost

# Mixture of the densities of path lengths (`sampling.make_chains`), tuned: any mixture is unbiased,
# and each chain of a component that does not suit a link is lost to the others.
_MIXTURE = np.array([0.1, 0.4, 0.15, 0.12, 0.1, 0.08, 0.05])  # free paths, then each of _STRETCH
_STRETCH = np.array([0.0, 0.015, 0.05, 0.15, 0.4, 1.0])  # from the shortest way (0) to the longest
_LONGEST_WAY = 1.3, 6.0  # bounds of the longest way over the shortest
_FITTED = 0.8  # share of fitted chains in turbid water, see `sampling.make_chains`

_BITS = 30  # of a coordinate of a Sobol point, as in scipy
_NO_POINTS = np.zeros((0, 0)), np.zeros((0, 0))

TURBID = 4.0
"""Scatterings expected on the way, from which water is turbid: chains are fitted to the way."""


Scores = tuple[Floats, NDArray[np.void]]
"""Scores (wavelengths, chains) of a set of chains, and its unblocked arrivals (ARRIVAL)."""


class ChainSet(NamedTuple):
    """Chains of one order from one source, and their crossings of a flat sea."""

    chains: Chains
    find: Callable[[Chains, int], NDArray[np.void]]  # searches the crossings to a receiver
    flat: dict[int, NDArray[np.void]]  # (n, CROSSINGS) FLAT by receiver; empty if they are many

    @property
    def order(self) -> int:
        """Number of scatterings."""
        return self.chains.vertex.shape[1]

    @property
    def number(self) -> int:
        """Number of chains."""
        return len(self.chains.path)

    def crossings(self, receiver: int) -> NDArray[np.void]:
        """Return the crossings (n, crossings) of a flat sea to a receiver."""
        return self.flat[receiver] if receiver in self.flat else self.find(self.chains, receiver)

    def part(self, span: slice) -> ChainSet:
        """Return the chains of a range of rows, as views of the same arrays."""
        arrays: Any = (array[span] for array in self.chains)
        flat = {receiver: crossings[span] for receiver, crossings in self.flat.items()}
        return self._replace(chains=Chains(*arrays), flat=flat)


class Request(NamedTuple):
    """Chains of one order from a source, `per_shift` for each shift of the points.

    Randomised quasi-Monte Carlo: one net of Sobol points is shifted at random `SHIFTS` (32) times;
    the spread of the 32 means is the standard error. The chains of a shift follow one another.
    """

    source: int
    order: int
    per_shift: int
    key: tuple[int, ...]  # of the random scrambling and shifts
    shifts: int = SHIFTS  # the first ones of all

    @property
    def number(self) -> int:
        """Number of chains."""
        return self.shifts * self.per_shift

    def spans(self) -> list[slice]:
        """Return the rows of blocks for threads: whole shifts, or a part of one."""
        n, most = self.per_shift, min(self.per_shift, _LARGEST)
        # A block never has parts of two shifts: its points are a slice of the net.
        if most < n:
            ends = [slice(i, min(i + most, n)) for i in range(0, n, most)]
            shifts = range(self.shifts)
            return [slice(s * n + e.start, s * n + e.stop) for s in shifts for e in ends]
        step = n * max(_BLOCK // n, 1)
        return [slice(i, min(i + step, self.number)) for i in range(0, self.number, step)]


class Block(NamedTuple):
    """Chains for one thread: drawn ones, or the points and shifts from which to draw them."""

    request: Request
    span: slice  # rows of all chains of the request
    points: tuple[Floats, Floats]  # (per_shift, width), (SHIFTS, 1, width); empty if drawn
    chains: ChainSet | None

    @property
    def shifts_in(self) -> slice:
        """Shifts whose chains this block holds."""
        n = self.request.per_shift
        return slice(self.span.start // n, -(-self.span.stop // n))


Drawing = tuple[Request, ChainSet | None]
"""Chains of a request: stored ones, or none, which are drawn again for each surface."""


def blocks_of(request: Request, chains: ChainSet | None = None) -> Iterator[Block]:
    """Yield the chains of a request in blocks, as parts of stored ones or yet to be drawn."""
    points = points_of(request) if chains is None else _NO_POINTS
    for span in request.spans():
        yield Block(request, span, points, chains and chains.part(span))


def _near_crossings(known: ChainSet | None, receiver: int, n: int) -> NDArray[np.void]:
    """Return crossings of a flat sea by n known chains to a receiver, without columns if none."""
    flat = known.flat.get(receiver) if known else None
    return np.zeros((n, 0), FLAT) if flat is None else flat


class ChainDrawer:
    """Sampler of the chains of a link.

    Parameters
    ----------
    link : ForcedLink
        The link.
    crest, ceiling : float
        Height up to which collisions are expected, and height of the flat sea for chains that have
        no crossing of still water; in the unit of the link's frame.
    ratios : sequence of float
        Scattering coefficients, over that of the link, of all waters whose light is computed.
    """

    wavelengths = 1

    def __init__(
        self, link: ForcedLink, crest: float, ceiling: float, ratios: Sequence[float] = (1.0,)
    ) -> None:
        self.link = link
        self.crest, self.ceiling = crest, ceiling
        self.nominals = [
            nominal(link.medium, e, link.targets, crest, ratios) for e in link.emitters
        ]

    def of_link(self, link: ForcedLink) -> ChainDrawer:
        """Return a sampler of the same chains for another link, scaled with the depths.

        Differences between the links then have little noise: all random numbers are the same.
        """
        drawer = copy(self)
        drawer.link, drawer.nominals = link, []
        emitters = zip(self.link.emitters, link.emitters, strict=True)
        for law, (before, now) in zip(self.nominals, emitters, strict=True):
            # lengths [m] scale with the depth, densities [m-1] by its inverse
            k = now.position.z / before.position.z
            law = law._replace(distance=law.distance * k, step=law.step * k)
            drawer.nominals.append(law._replace(c=law.c / k, density=law.density / k))
        return drawer

    def last_order(self, source: int) -> int:
        """Return the highest order of the chains from a source; refuse too dense water.

        More scatterings have a Poisson probability of less than `_TAIL`.
        """
        medium, law = self.link.medium, self.nominals[source]
        b = medium.layer_b.mean() if medium.layered else medium.b
        # 1.2, tuned: scattered light goes a longer way than straight light
        most = 1.2 * max(law.expected, b * law.distance + float(medium.bubble_path[-1]))
        if b == 0.0 and medium.bubble_path[-1] == 0.0:
            return 0
        # Orders end at _MAX_ORDER: light of denser water would be lost without notice.
        if 1.0 - poisson_law(1.2 * law.expected).sum() > _MOST_LEFT_OUT:
            raise Refused(
                "water",
                f"{law.expected:.3g} scatterings expected on the way to the surface",
                f'nearly all light within {_MAX_ORDER}; else estimator="analog"',
            )
        # Draws from the profile follow the straight way. Light that wanders in a layer near the
        # surface has its collisions elsewhere, and large weights.
        upper = float(law.density[len(law.density) // 2 :].max()) * law.distance
        if medium.layered and upper > _MOST_CROWDED and law.expected > 2.0:
            raise Refused(
                "water.layers",
                f"{law.expected:.3g} scatterings expected, {upper:.3g} times as dense near "
                "the surface as on average",
                f"up to {_MOST_CROWDED:g}; light that wanders in a thin turbid layer needs "
                'estimator="analog"',
            )
        beyond = 1.0 - np.cumsum(poisson_law(most))
        return int(np.clip(np.count_nonzero(beyond > _TAIL), 1, _MAX_ORDER))

    def draw(
        self, request: Request, receivers: Collection[int] | None = None,
        known: ChainSet | None = None,
    ) -> ChainSet:  # fmt: skip
        """Return all chains of a request, to all receivers by default.

        `known` are the same chains of a link nearby, whose crossings are followed to these.
        """
        chains = self.empty(request, receivers)
        for block in blocks_of(request):
            self._fill((block, chains.part(block.span)), known and known.part(block.span))
        return chains

    def retargeted(self, source: int, drawn: ChainSet, known: ChainSet | None = None) -> ChainSet:
        """Return the same chains with their crossings to the receivers of this link.

        `known` as for `draw`.
        """
        receivers = self._representatives() if drawn.flat else []
        flat = {r: self._search(source, drawn.chains, r, known) for r in receivers}
        return drawn._replace(find=partial(self._search, source), flat=flat)

    def draw_all(self, requests: Sequence[Request], threads: int = 1) -> list[Drawing]:
        """Return sets of chains, which are drawn now if they are few enough to be stored.

        The threads share their blocks.
        """
        receivers = len(self._representatives())
        # many chains are drawn again from their keys, block by block, rather than stored
        if sum(self._bytes(request, receivers) for request in requests) > _CHAIN_BYTES:
            return [(request, None) for request in requests]
        drawings = [(request, self.empty(request)) for request in requests]
        jobs = (
            (block, chains.part(block.span))
            for request, chains in drawings
            for block in blocks_of(request)
        )
        deque(ordered_map(self._fill, jobs, threads), maxlen=0)
        return list(drawings)

    def whole(self, drawing: Drawing) -> ChainSet:
        """Return all chains of a request, as stored or drawn again."""
        request, chains = drawing
        return chains or self.draw(request)

    def drawn(self, block: Block) -> ChainSet:
        """Return the chains of a block."""
        if block.chains is not None:
            return block.chains
        n = block.span.stop - block.span.start
        chains = self._allocate(block.request, n, self._representatives())
        self._fill((block, chains))
        return chains

    def _representatives(self) -> list[int]:
        """Return one receiver of each group that shares its crossings of still water."""
        return list(dict.fromkeys(self.link.stands_for.tolist()))

    def _bytes(self, request: Request, receivers: int) -> int:
        """Return the memory [bytes] that a request needs for a number of receivers."""
        # a vertex is three numbers and a byte for its kind, a chain 14 numbers at most
        per_chain = 25 * request.order + 112 + receivers * CROSSINGS * FLAT.itemsize
        return request.number * per_chain

    def empty(self, request: Request, receivers: Collection[int] | None = None) -> ChainSet:
        """Allocate all chains of a request, with their crossings unless these are many."""
        receivers = self._representatives() if receivers is None else receivers
        few = self._bytes(request, len(receivers)) <= _CHAIN_BYTES
        return self._allocate(request, request.number, receivers if few else ())

    def _allocate(self, request: Request, n: int, receivers: Collection[int]) -> ChainSet:
        """Allocate arrays for n chains and their crossings to `receivers`."""
        flat = {receiver: np.zeros((n, CROSSINGS), FLAT) for receiver in receivers}
        return ChainSet(Chains.zeros(n, request.order), partial(self._search, request.source), flat)

    def _fill(self, job: tuple[Block, ChainSet], known: ChainSet | None = None) -> None:
        """Draw the chains of a block from shifted points; find their crossings of a flat sea.

        `known` as for `draw`.
        """
        block, drawn = job
        source, per_shift = block.request.source, block.request.per_shift
        first = block.span.start - block.shifts_in.start * per_shift  # of a part of one shift
        points, shifts = block.points
        # columns: 3 for each vertex, 2 of the disk, 2 of the slopes, audit, component
        u = shifted(points[first : first + drawn.number], shifts[block.shifts_in])
        drawn.chains.audit[:] = u[:, -2]
        law = self.nominals[source]
        # one coordinate picks the component, see the balance heuristic in `make_chains`
        component = np.searchsorted(np.cumsum(law.mixture)[:-1], u[:, -1])
        kernel.make_chains(drawn.chains, law, self.link.medium, u, component)
        self.place_points(drawn.chains)
        for receiver, out in drawn.flat.items():
            near = _near_crossings(known, receiver, len(out))
            flat_crossings(drawn.chains, near, *self._still_water(source, receiver), out)

    def place_points(self, chains: Chains) -> None:
        """Place the points that chains aim at: by default they stay in the unit disk.

        Samplers for maps, whose apertures are square cells, override this.
        """

    def _search(
        self, source: int, chains: Chains, receiver: int, known: ChainSet | None = None
    ) -> NDArray[np.void]:
        """Return the crossings of a flat sea by chains from a source to a receiver."""
        out = np.zeros((len(chains.path), CROSSINGS), FLAT)
        near = _near_crossings(known, receiver, len(out))
        flat_crossings(chains, near, *self._still_water(source, receiver), out)
        return out

    def _still_water(self, source: int, receiver: int) -> tuple[Floats, Scene, Scene]:
        """Return the starts (x, y) of the search for flat crossings, and two scenes of flat water.

        The water is at the mean level, and at the ceiling for chains that end above that level.
        """
        link, sea = self.link, _still_surface()
        emitter, target = link.emitters[source], link.targets[receiver]
        bins, facets = NO_BINS, np.zeros(0, FACET)
        scene = Scene(emitter, target, sea, bins, facets, link.medium, link.interface)
        raised = scene._replace(surface=sea._replace(level=self.ceiling))
        return starts_of(emitter, target), scene, raised

    def aim(self, source: int, receiver: int, chains: ChainSet) -> Scores:
        """Return the scores (1, chains) of a set of chains over still water, without arrivals."""
        score = np.empty((1, chains.number))
        _, scene, _ = self._still_water(source, receiver)
        flat_contributions(chains.chains, chains.crossings(receiver), scene, score[0])
        return score, np.zeros(0, ARRIVAL)


def levels(link: ForcedLink, crest: float) -> tuple[float, float]:
    """Return the height of a crest [m] and the ceiling of chains, in the unit of the link.

    Chains end below the ceiling, which lies above all crests and below all receivers.
    """
    top = max(crest, 0.0) / link.frame.unit
    lowest = min(t.center[2] for t in link.targets)
    # above the highest crest, as light may come down to a trough; at most half way to a receiver;
    # 0.25 is tuned
    return top, top + min(0.25 * (top + 1.0), 0.5 * max(lowest - top, 0.0))


def poisson_law(mean: float) -> Floats:
    """Return the probabilities of 0, 1, ... scatterings up to the highest order."""
    order = np.arange(_MAX_ORDER + 1)
    # through logarithms: mean^k and k! overflow long before their ratio
    return np.exp(order * math.log(mean) - mean - np.cumsum(np.log(np.maximum(order, 1))))


def points_of(request: Request) -> tuple[Floats, Floats]:
    """Return the points of a set of chains and their shifts, from a cache if they are few."""
    # besides the vertices: 2 coordinates on the aperture, 2 slopes, audit, component
    width = kernel.DIMENSIONS * request.order + 6
    few = request.per_shift * width <= _MOST_CACHED
    return (_cached_points if few else shifted_points)(width, request.per_shift, request.key)


def shifted_points(width: int, per_shift: int, key: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Return Sobol points of the unit cube, (per_shift, width), and their random shifts."""
    rng = np.random.default_rng(key)
    return sobol_points(width, per_shift, rng), rng.random((SHIFTS, 1, width))


def sobol_points(width: int, count: int, rng: np.random.Generator) -> Floats:
    """Return the first Sobol points, (count, width), scrambled and shifted digit by digit.

    Notes
    -----
    Direction numbers v are multiplied by random lower triangular matrices of bits (Matousek 1998,
    J. Complexity 14:527), all points shifted by random bits. In the order of Gray's code the points
    2^j ... 2^(j+1) - 1 are the points before them, backwards, shifted by v_j.
    """
    (rng,) = rng.spawn(1)  # as scipy does
    place = 2 ** np.arange(_BITS, dtype=np.uint32)
    shift = rng.integers(2, size=(width, _BITS), dtype=np.uint32) @ place
    lower = np.tril(rng.integers(2, size=(width, _BITS, _BITS), dtype=np.uint32))
    # a unit diagonal makes the matrix invertible over the bits: strata are kept
    lower[:, range(_BITS), range(_BITS)] = 1
    doublings = math.ceil(math.log2(max(count, 2)))
    scrambled = (lower @ _directions(doublings)[:width]) & 1
    points: Any = shift[None]
    for v in np.tensordot(scrambled, place[::-1], (1, 0)).T:
        points = np.concatenate([points, points[::-1] ^ v])
    return points[:count] * 2.0**-_BITS


@cache
def _directions(count: int) -> NDArray[np.uint32]:
    """Return the bits of the first direction numbers, highest first: shape (widths, bits, count).

    m_k = 2 a_1 m_(k-1) ^ ... ^ 2^(s-1) a_(s-1) m_(k-s+1) ^ 2^s m_(k-s) ^ m_(k-s), v_k = m_k / 2^k.
    """
    table = Path(__file__).with_name("joe_kuo.txt").read_text(encoding="ascii").splitlines()[1:]
    numbers = [[1] * count]
    for row in table:
        _, s, a, *m = map(int, row.split())
        for k in range(s, count):
            last = m[k - s] ^ (m[k - s] << s)
            for i in range(1, s):
                last ^= ((a >> (s - 1 - i)) & 1) * (m[k - i] << i)
            m.append(last)
        numbers.append(m[:count])
    place = np.arange(_BITS - 1, -1, -1, dtype=np.uint32)
    v: Any = np.array(numbers, np.uint32) << place[:count]
    return (v[:, None] >> place[:, None]) & 1


_cached_points = lru_cache(maxsize=64)(shifted_points)


def shifted(points: Floats, shifts: Floats) -> Floats:
    """Return points (n, width) shifted modulo 1, by each of the shifts (m, 1, width) in turn.

    The result has the shape (m n, width) and lies inside the unit cube.
    """
    # Cranley and Patterson (1976): a random shift modulo 1 makes each point uniform, so that means
    # are unbiased, and leaves the net as even as it was.
    u = (points[None] + shifts) % 1.0
    # logarithms of 0 and 1 - 1 would be infinite
    return np.clip(u.reshape(-1, u.shape[-1]), 1e-12, 1.0 - 1e-12)


@cache
def _still_surface() -> MeshArrays:
    """Return a square of still water; only its level is used, so crossings off it are valid."""
    return surface_arrays(flat_mesh(-np.ones(2), np.ones(2)), "facet")


def nominal(
    medium: Medium,
    emitter: Emitter,
    targets: list[Target],
    crest: float,
    ratios: Sequence[float] = (1.0,),
) -> Nominal:
    """Return the expected collisions along the straight path to the highest crest.

    The way is the shortest one to any of the targets. The share of fitted chains is that of turbid
    waters among those with `ratios` of the scattering coefficient. Only a proposal: any law is
    unbiased, one near the collisions of light that arrives has even weights.
    """
    depth = crest - emitter.position[2]
    n = medium.n_water / medium.n_air
    x, y, _ = emitter.position
    apart = [math.hypot(t.center[0] - x, t.center[1] - y) for t in targets]
    # Horizontal part in the water: sin i = sin t / n by Snell, angles taken for their tangents.
    offset = min(
        depth / (depth + n * t.center[2]) * far for t, far in zip(targets, apart, strict=True)
    )
    distance = math.hypot(depth, offset)
    # the longest way ends at the farthest crossing inside a field of view
    slant = max(math.hypot(depth, far + t.reach) for t, far in zip(targets, apart, strict=True))
    longest = min(max(slant / distance, _LONGEST_WAY[0]), _LONGEST_WAY[1])
    nodes = 513  # a layer or cloud of bubbles of 1/500 of the depth is resolved
    height = np.linspace(0.0, 1.0, nodes) * depth
    below = depth - height
    b = np.interp(below / medium.layer_step, np.arange(len(medium.layer_b)), medium.layer_b)
    if not medium.layered:
        b = np.full(nodes, medium.b)
    # Each node takes the bubbles 0.3 m above it (tuned): chains are turned and waves rise, and
    # bubbles must be likely enough there, too.
    at = (np.maximum(below - 0.3, 0.0) - medium.bubble_start) / medium.bubble_step
    b_bub = np.interp(at, np.arange(len(medium.bubble_b)), medium.bubble_b, right=0.0)
    total = np.maximum(b + b_bub, 1e-12)
    step = distance / (nodes - 1)
    # collisions [1] from the source up to each node: their share is the distribution function
    cumulative = integral(total, step)
    # clear water needs some rate, or free paths would have no scale
    c = max(medium.a + float(b.mean()), 1e-3 / distance)
    uniform = not medium.layered and medium.depth_mode == DepthMode.NONE
    # A fitted chain takes its length from its directions: these must not depend on the depth, as
    # the choice between water and bubbles does. In layers collisions are not even along the way.
    turbid = float(np.mean(np.asarray(ratios) * cumulative[-1] >= TURBID))
    fitted = _FITTED * turbid if uniform else 0.0
    return Nominal(
        distance=distance,
        c=c,
        step=step,
        share=cumulative / cumulative[-1],
        density=total / cumulative[-1],
        bubble=np.where(total > 0.0, b_bub / total, 0.0),
        expected=float(cumulative[-1]),
        stretch=1.0 + (longest - 1.0) * _STRETCH,
        mixture=np.append((1.0 - fitted) * _MIXTURE, fitted),
    )


def flat_mesh(low: Floats, high: Floats) -> TriangleMesh:
    """Return a flat sea of two facets between two corners (x, y)."""
    (x0, y0), (x1, y1) = low, high
    corners = [(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)]
    return TriangleMesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]))


def starts_of(emitter: Emitter, target: Target) -> Floats:
    """Return the starts (x, y) of the search for flat crossings, the likely one first.

    Shape (15, 2): below the receiver, half way, above the source, and two rings of six.
    """
    rx, ry = target.center[:2]
    sx, sy = emitter.position[:2]
    starts = [(rx, ry), (0.5 * (rx + sx), 0.5 * (ry + sy)), (sx, sy)]
    # Rings up to 60 degrees from the vertical (tan 60 < 2): flatter light crosses far out, where
    # Newton comes from anywhere. 2 m more for receivers close to the water.
    reach = min(target.reach, 2.0 * (target.center[2] + 2.0))
    for radius in (0.3, 0.8):
        # turned by the radius against each other, so that the starts fill the disk
        for azimuth in np.arange(6) * math.pi / 3.0 + radius:
            far = radius * reach
            starts.append((rx + far * math.cos(azimuth), ry + far * math.sin(azimuth)))
    return np.array(starts)
