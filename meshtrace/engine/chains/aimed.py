"""Chains and unscattered light over one surface: crossings, weights, and shadowing by waves.

`AimedChains` has one surface, in the local frame of a link (lengths over `link.frame.unit`), and
calls the kernels of chains (`gain`), of unscattered light through smooth facets (`unscattered`) and
through facets with random slopes (`microfacets`). Scores and gains are shares of the power of a
source that arrive at a receiver. `source` and `receiver` are indices of emitters and targets of the
`ForcedLink`: chains of a downlink run against the light, and there the emitter is the receiver.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from functools import cache, cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains import gain as kernel
from meshtrace.engine.chains import microfacets, pencils
from meshtrace.engine.chains import unscattered as image
from meshtrace.engine.chains.gain import Counter, tint_chains, tint_straight
from meshtrace.engine.chains.sets import ChainDrawer, ChainSet, Request, Scores
from meshtrace.engine.crossing import FLAT, ROOT, Search
from meshtrace.engine.setup.arrays import locator, mean_square_slope, surface_arrays, with_raster
from meshtrace.engine.setup.bodies import for_thread
from meshtrace.engine.setup.ends import ForcedLink, expected_water, forced_link
from meshtrace.engine.setup.tinting import UNTINTED, CommonPaths
from meshtrace.kernels.interface import Direction, MeshArrays, Roughness, Snell
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.scene import FACET, Emitter, Locator, Scene, Target, facet_summary
from meshtrace.kernels.tints import Tints
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.quadrature import gauss_legendre

SearchMode = Literal["usual", "thorough"]

Nodes = tuple[int, int] | None
"""Rings and nodes on each of a quadrature over an aperture; None where it is much wider."""

ROOTS = 64  # crossings of one chain at most: a buffer; more are not counted
# Standard deviation of random slopes over that of the mesh's slopes. Below it the integral over the
# slopes would take more time than sampled chains: tuned.
_NARROWEST = 0.1
# Radius of an aperture over the `blur`: up to _POINT four points stand for the disk; beyond _WIDEST
# Gauss nodes about the light of each part are fewer than nodes all over the disk.
_POINT = 0.5
_WIDEST = 20.0
_MOST_NODES = 3e8  # on the aperture, for one source and receiver: half a minute of a thread
LEAST_ERROR = 2e-4  # relative, of light over random slopes: rounded up from what scans showed
LEAST_IMAGE_ERROR = 2e-6  # of light over smooth facets, where errors of both signs cancel: scans
_SAMPLED_FACETS = 256  # facets on which other lengths of parts are tried: a tenth of the time
_FEWER, _LONGER = 0.75, 2.0  # numbers of nodes and lengths of parts, for an error, over the usual
# Width of the slopes by which crossings are proposed, over that of the sea's slopes: a proposal of
# lighter tails would give weights without a bound.
_SPREAD = 1.1
_TOGETHER = 2**15  # scores of chains to close receivers that are computed at a time; tuned: memory
_IN_BLOCK = 128  # facets of a block, which one bound may leave out together; tuned: time
_FEW_PAIRS = 8  # pairs of source and receiver up to which blocks save no time; tuned
# Share of the chains over a gentle sea for which all facets are searched, see `gain._roots_near`.
# Tuned: time against noise, unbiased in either case.
_AUDITED = 0.02


class Quadrature(NamedTuple):
    """Unscattered light of a pair by an integral over the surface."""

    gain: float  # of all facets
    at: Vec3 | None  # point of the source, None for its centre
    # whether Gauss nodes between rims were used, see `pencils.Work`, or bodies cast shadows
    lenses: bool = False
    cut_short: float = 0.0  # gain of facets that were not cut as finely as they should be
    # over smooth surfaces alone, every `stride`-th facet that brings light, and what it brings
    sampled_facets: NDArray[np.int64] = np.zeros(0, np.int64)
    sampled_gain: Floats = np.zeros(0)
    stride: int = 0


_DARK = Quadrature(0.0, None)


class AimedChains:
    """Chains over one surface, in the local frame of the link.

    Parameters
    ----------
    link : ForcedLink
        The link.
    mesh : TriangleMesh
        The surface [m].
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    unresolved : str
        `Physics.unresolved`.
    search : {"usual", "thorough"}
        "usual" searches every facet for crossings of a share of the chains and divides by that
        share: unbiased, with more noise. "thorough" does so for every chain, but for level water,
        whose crossings are those of still water.
    """

    def __init__(
        self,
        link: ForcedLink,
        mesh: TriangleMesh,
        normals: str = "vertex",
        unresolved: str = "none",
        search: SearchMode = "usual",
    ) -> None:
        self.link = link
        self._mesh = link.frame.mesh(mesh)
        self.intersector = EmbreeIntersector(self._mesh, 1)
        self._search_mode = search
        self.surface: MeshArrays = surface_arrays(self._mesh, normals, unresolved)
        rough, self._mesh_slopes = self.surface.roughness, mean_square_slope(self.surface)
        self.rough = rough.along > 0.0 or rough.across > 0.0
        # The half-vector between two directions fixes the slope that refracts one into the other
        # only by Snell's law, not by the forms as published.
        physical = link.interface.snell, link.interface.direction
        wide = min(rough.along, rough.across) > _NARROWEST * math.sqrt(self._mesh_slopes)
        self.blurred = physical == (Snell.PHYSICAL, Direction.VECTOR) and wide
        self.facets = np.empty(len(mesh.faces), FACET)
        facet_summary(self.surface, self.facets)
        # Kernels of unscattered light expect the source below the surface: for lamps in the air all
        # is turned upside down, so that they lie below.
        self._mirrored = _upside_down(self.surface) if link.forwards else None
        self._serve(link)
        self.nodes: dict[tuple[int, int], Nodes] = {}  # of the aperture, by source and receiver
        # largest height of the waves above or below the mean level
        self._wave_height = max(abs(float(self.surface.low[2])), abs(float(self.surface.high[2])))

    def _serve(self, link: ForcedLink) -> None:
        """Set link, water and bins; empty counters."""
        self.link, self.tinting = link, UNTINTED
        # index of the wavelength that calibrates the others, and the surface at it
        self._calibration: tuple[int, AimedChains] | None = None
        # bubbles whose depth is below the local surface need its height everywhere
        self.medium = with_raster(link.medium, self.intersector)
        self.locator = locator(self.surface, link.targets)
        self._last: dict[tuple[int, int], Quadrature] = {}  # by source and receiver
        self.counters = np.zeros(len(Counter), np.int64)

    def of_link(self, link: ForcedLink) -> AimedChains:
        """Return the same surface over another link of the same frame and slopes."""
        aimed = copy(self)
        # it depends on the bins, which are those of the receivers
        aimed.__dict__.pop("_extent", None)
        aimed._serve(link)
        return aimed

    @cached_property
    def _extent(self) -> Search:
        """Extent of the search for roots."""
        surface = self.surface
        extent = search_extent(surface, self.facets, self.locator)
        if self._search_mode == "usual":
            return extent
        # level water has the crossings of still water
        level = bool(surface.low[2] == surface.high[2] == 0.0) and not self.rough
        return extent._replace(still=True) if level else extent._replace(audit=1.0)

    @property
    def sampled(self) -> bool:
        """Whether unscattered light is sampled: slopes are too narrow for an integral over them."""
        return self.rough and not self.blurred

    @cached_property
    def spread(self) -> Roughness:
        """Proposal distribution of the slopes, wider than the sea's to bound the weights."""
        rough, mesh = self.surface.roughness, self._mesh_slopes
        # variances of independent slopes add: those of the mesh and the random ones
        along, across = (_SPREAD * math.hypot(s, math.sqrt(mesh)) for s in rough[:2])
        return rough._replace(along=along, across=across)

    @property
    def centroids(self) -> Floats:
        """Centroids of the facets, shape (m, 3)."""
        return np.stack([self.facets[name] for name in ("x", "y", "z")], axis=1)

    def _forwards(self, emitter: int, target: int, at: Vec3 | None) -> Scene:
        """Return the scene in which unscattered light runs from the source to the receiver.

        A source in the water may be moved to a point. Chains of a downlink start at its receiver,
        the emitter of their scene; unscattered light starts at its lamp.
        """
        link, forwards = self.link, self.link.forwards
        start = link.emitters[emitter]
        if at is not None:
            start = start._replace(position=at)
        scene = self.scene(start, link.targets[target])
        if forwards is None or self._mirrored is None:
            return scene
        # chains of a downlink start at its receiver: its ends change places. The indices on both
        # sides of the surface do for all light from the air
        lamp, receiver = (target, emitter) if link.down else (emitter, target)
        surface, facets = self._mirrored
        medium, source = forwards.medium, forwards.emitters[lamp]
        if at is not None and not link.down:
            source = source._replace(position=at._replace(z=-at.z))
        return scene._replace(
            emitter=source,
            target=forwards.targets[receiver],
            surface=surface,
            facets=facets,
            medium=self.medium._replace(n_water=medium.n_water, n_air=medium.n_air),
            mirrored=True,
        )

    def scene(self, emitter: Emitter, target: Target) -> Scene:
        """Return the `Scene` of one source, the surface and one aperture, for kernels."""
        facets, medium, interface = self.facets, self.medium, self.link.interface
        return Scene(
            emitter, target, self.surface, self.locator, facets, medium, interface,
            reflects=self.link.reflects,
        )  # fmt: skip

    def together(self, receivers: Sequence[int], chains: ChainSet) -> Iterator[list[int]]:
        """Yield receivers that a set of chains is aimed at together.

        Over random slopes these are receivers close to one of them, whose crossings of still water
        serve them all.
        """
        # Crossings that Newton searches belong to one receiver alone.
        most = max(_TOGETHER // chains.number, 1) if self.blurred else 1
        groups: dict[int, list[int]] = {}
        for r in receivers:
            groups.setdefault(int(self.link.stands_for[r]), []).append(r)
        for group in groups.values():
            yield from (group[k : k + most] for k in range(0, len(group), most))

    def aim(
        self, source: int, receivers: int | Sequence[int], chains: ChainSet, keep: bool = False
    ) -> Scores:
        """Return the scores (wavelengths, chains) of a set, and its unblocked arrivals if `keep`.

        To one receiver, or to receivers `together`: then column m * n + i is chain i of n to the
        m-th of the receivers.
        """
        receivers = [receivers] if isinstance(receivers, int) else receivers
        # several wavelengths are weights of the arrivals of one
        n, keep = chains.number * len(receivers), keep or self._calibration is not None
        out = kernel.Output(
            score=np.zeros(n),
            # two crossings a chain: more are rare even where a sea focuses
            arrivals=np.empty(2 * n + 64 if keep else 0, kernel.ARRIVAL),
            counters=np.zeros(len(Counter), np.int64),
            roots=np.zeros(ROOTS, ROOT),
        )
        emitter = self.link.emitters[source]
        if self.blurred:
            first = int(self.link.stands_for[receivers[0]])
            scene, flat = self.scene(emitter, self.link.targets[first]), chains.crossings(first)
            places = np.array([self.link.targets[r].center for r in receivers])
            near = np.zeros(flat.shape[1], FLAT)
            with for_thread(self.link.bodies) as bodies:
                scene = scene._replace(bodies=bodies)
                count = kernel.blurred_contributions(
                    chains.chains, flat, places, near, self.spread, scene, out
                )
        else:
            (receiver,) = receivers
            target, flat = self.link.targets[receiver], chains.crossings(receiver)
            scene = self.scene(emitter, target)
            with for_thread(self.link.bodies) as bodies:
                scene = scene._replace(bodies=bodies)
                count = kernel.contributions(chains.chains, flat, self._extent, scene, out)
        arrivals = out.arrivals[:count]
        self.counters += out.counters
        if self._calibration is None:
            return out.score[None], arrivals
        return self._tinted_scores(source, chains, n, arrivals), arrivals

    def at_wavelengths(self, shared: CommonPaths) -> AimedChains:
        """Return the same surface at several wavelengths, on the paths of one base wavelength.

        Unscattered light is computed at the base and at the wavelength whose attenuation differs
        most from it; `direct_light` interpolates the others.
        """
        tinting, aimed, calibration = shared.tinting, copy(self), copy(self)
        if len(shared.links) == 1:
            return aimed
        # logarithms of the transmittance over the base's, from each source up to the origin
        starts = self.link.emitters
        ways = [self.straight_tints(e, np.zeros((1, 3)), tinting.tints) for e in starts]
        farthest = int(np.abs(tinting.shares @ np.concatenate(ways).T).max(axis=1).argmax())
        water = expected_water(shared.links[farthest], crest=5.0)
        medium, base = self.link.frame.medium(water), self.medium
        # paths are those of the base, whatever the dispersion: its indices
        medium = medium._replace(n_water=base.n_water, n_air=base.n_air)
        calibration.medium = with_raster(medium, self.intersector)
        # not those of the base: errors of gains are asked for at the base
        calibration._last = {}
        aimed.tinting, aimed._calibration = tinting, (farthest, calibration)
        return aimed

    @property
    def wavelengths(self) -> int:
        """Number of wavelengths."""
        return len(self.tinting.shares)

    def _tinted_scores(
        self, source: int, chains: ChainSet, n: int, arrivals: NDArray[np.void]
    ) -> Floats:
        """Return the scores (wavelengths, n) of chains from their arrivals."""
        score, by_chain = np.zeros((self.wavelengths, n)), arrivals.copy()
        # arrivals count chains from one receiver to the next, see `aim`
        by_chain["chain"] %= chains.number
        tints = self.chain_tints(source, chains, by_chain, self.tinting.tints)
        weights = self.tinting.factors(tints)
        weights *= arrivals["weight"]
        # crossings of one chain follow one another
        first = np.flatnonzero(np.diff(arrivals["chain"], prepend=-1))
        if len(first):
            score[:, arrivals["chain"][first]] = np.add.reduceat(weights, first, axis=1)
        return score

    def direct_light(self, source: int, receiver: int, at: Vec3 | None = None) -> Floats:
        """Return the unscattered gain (wavelengths,) of a receiver, see `direct_gains`."""
        gains = self.direct_gains(source, receiver, at)
        if self._calibration is None:
            return gains.sum(keepdims=True)
        farthest, calibration = self._calibration
        far_gains = calibration.direct_gains(source, receiver, at)
        nonzero, emitter = np.flatnonzero(gains), self.link.emitters[source]
        if not len(nonzero):
            return np.zeros(self.wavelengths)
        # Beer and Lambert for the light G of a facet: G_j = G exp(-(c_j - c) l). `logs` has this
        # exponent for l the way in the water by the centroid of the facet, (wavelengths, facets)
        start = emitter if at is None else emitter._replace(position=at)
        ends = self.centroids[nonzero]
        tints = self.unscattered_tints(start, receiver, ends, self.tinting.tints)
        logs = self.tinting.shares @ tints.T
        # The light of a facet crosses it at other points, too: its effective l, over that way,
        # follows from the light at the farthest wavelength, computed on its own.
        with np.errstate(all="ignore"):
            stretch = np.log(far_gains[nonzero] / gains[nonzero]) / logs[farthest]
        # equal attenuation, or light too faint for a ratio: the way to the centroid
        stretch[~np.isfinite(stretch) | (stretch <= 0.0)] = 1.0
        return np.asarray(np.exp(logs * stretch) @ gains[nonzero])

    def chain_tints(
        self, source: int, chains: ChainSet, arrivals: NDArray[np.void], tints: Tints | None
    ) -> Floats:
        """Return the log weights (arrivals, tints) of the chains that arrive from a source."""
        sums = np.zeros((len(arrivals), len(tints.c) if tints else 0))
        if tints:
            emitter = self.link.emitters[source]
            tint_chains(chains.chains, arrivals, emitter, self.clear, tints, sums)
        return sums

    def straight_tints(self, start: Emitter, ends: Floats, tints: Tints | None) -> Floats:
        """Return the log weights (n, tints) of straight paths from a source to ends (n, 3)."""
        sums = np.zeros((len(ends), len(tints.c) if tints else 0))
        if tints:
            tint_straight(start.position, ends, self.clear, tints, sums)
        return sums

    def unscattered_tints(
        self, start: Emitter, receiver: int, crossings: Floats, tints: Tints | None
    ) -> Floats:
        """Return the log weights (n, tints) of unscattered light by crossings (n, 3)."""
        sums = self.straight_tints(start, crossings, tints)
        if not (tints and self.link.reflects):
            return sums
        # both ways lie in the water, or neither does
        back = np.empty_like(sums)
        tint_straight(self.link.targets[receiver].center, crossings, self.clear, tints, back)
        return sums + back if self.link.direction == "under" else np.zeros_like(sums)

    @property
    def clear(self) -> Medium:
        """The water with b = 0, so that bubbles alone scatter: `tints` has the water itself."""
        return self.medium._replace(b=0.0, layered=False)

    def direct_gains(
        self,
        source: int,
        receiver: int,
        at: Vec3 | None = None,
        facets: NDArray[np.int64] | None = None,
        longer: float = 1.0,
    ) -> Floats:
        """Return the unscattered gain of each facet, or of `facets`; deterministic.

        From the centre of the source, or from the point `at`. Random slopes are left out where
        unscattered light is `sampled`. A facet has no gain if waves hide its centroid from source
        or receiver. Parts of facets are `longer` times as long as usual; if that is more than 1,
        with fewer nodes: the change of the gain tells its error.
        """
        scene = self._forwards(source, receiver, at)
        gain = np.zeros(len(self._mesh.faces))
        stack = np.empty((image.STACK, 3), np.int64)
        # only light through all facets, as usual, is recorded: its error may be asked for
        pair, usual = (source, receiver), facets is None and longer == 1.0
        if self.blurred:
            nodes = self.nodes.setdefault(pair, _disk_nodes(scene.target.radius / self.blur(scene)))
            rule = _rule(nodes, longer)
            blocks = self._blocks if facets is None else _one_block(facets)
            coarse, work = np.zeros(len(gain), bool), np.zeros(len(pencils.Work))
            work[pencils.Work.LEFT] = _MOST_NODES
            with for_thread(self.link.bodies) as bodies:
                scene = scene._replace(bodies=bodies)
                microfacets.blurred_gain(scene, rule, blocks, stack, coarse, work, gain)
            if usual:
                _, lenses, cut_short = work.tolist()
                # shadows end within parts, as a view does: a coarser quadrature tells the error
                edges = lenses > 0.0 or self.link.bodies is not None
                self._last[pair] = Quadrature(float(gain.sum()), at, edges, cut_short)
        else:
            stretch, lever, bend = self.bounds_of(scene)
            facets = np.arange(len(gain)) if facets is None else np.ascontiguousarray(facets)
            with for_thread(self.link.bodies) as bodies:
                scene, bounds = scene._replace(bodies=bodies), (1.5 * stretch, lever, bend)
                image.image_gain(scene, facets, longer, *bounds, stack, gain)
            if usual:
                illuminated = np.flatnonzero(gain)
                stride = max(len(illuminated) // _SAMPLED_FACETS, 1)
                sample = illuminated[::stride]
                self._last[pair] = Quadrature(
                    float(gain.sum()), at,
                    sampled_facets=sample, sampled_gain=gain[sample], stride=stride,
                )  # fmt: skip
        return gain

    def relative_error(self, source: int, receiver: int) -> float:
        """Return the relative quadrature error of the last unscattered light of a pair.

        Over smooth surfaces it is the change by parts of another length on a sample of facets; over
        random slopes, where the view ends within the aperture, by a coarser quadrature.
        """
        last = self._last.get((source, receiver), _DARK)
        if last.gain == 0.0:
            return 0.0
        if last.stride:
            # Images differ from triangles in second order: parts twice as long err four times as
            # much, three times the error more. Half of the change leaves room for edges of beams
            # and views, which err in first order. Facets too small to be cut have no longer parts:
            # halves of them then err by a quarter, and the change is 3/4 of the error.
            facets, error = last.sampled_facets, 0.0
            for longer, share in ((2.0, 0.5), (0.5, 1.5)):
                gain = self.direct_gains(source, receiver, last.at, facets, longer)[facets]
                difference, n = gain - last.sampled_gain, last.stride
                # the sum estimated from every n-th facet, and its noise, which also bounds what
                # changes of both signs hide from the sum
                sum_of_squares = float(difference @ difference)
                error = share * math.hypot(n * difference.sum(), math.sqrt(n * sum_of_squares))
                if error > 0.0:
                    break
            return max(error / last.gain, LEAST_IMAGE_ERROR)
        change = LEAST_ERROR
        if last.lenses:
            coarser = self.direct_gains(source, receiver, last.at, longer=_LONGER).sum()
            change = max(change, abs(coarser / last.gain - 1.0))
        return math.hypot(change, last.cut_short / last.gain)

    def meets_rim(self, source: int, receiver: int) -> bool:
        """Return whether the view ends within the aperture, for the last unscattered light."""
        return self._last.get((source, receiver), _DARK).lenses

    def is_cut_short(self, source: int, receiver: int) -> bool:
        """Return whether the last unscattered light left facets uncut, to limit its time."""
        return self._last.get((source, receiver), _DARK).cut_short > 0.0

    @cached_property
    def _blocks(self) -> microfacets.Blocks:
        """The facets in blocks of about `_IN_BLOCK`, or in one block for few pairs of ends."""
        n = len(self.facets)
        if len(self.link.emitters) * len(self.link.targets) <= _FEW_PAIRS:
            return _one_block(np.arange(n))
        # a grid of side x side blocks, by quantiles: facets are small only where light crosses
        side = math.ceil(math.sqrt(n / _IN_BLOCK))
        place, centroids = np.zeros(n, np.int64), self.centroids
        for axis in (0, 1):
            ends = np.quantile(centroids[:, axis], np.arange(1, side) / side)
            place = side * place + np.searchsorted(ends, centroids[:, axis])
        order = np.argsort(place, kind="stable")
        start = np.flatnonzero(np.diff(place[order], prepend=-1))
        sorted_centroids = centroids[order]
        # distance of the corners from the centroid, in space
        size = self.facets["radius"] * np.sqrt(
            1.0 + self.facets["slope_x"] ** 2 + self.facets["slope_y"] ** 2
        )
        low, high = (f.reduceat(sorted_centroids, start, axis=0) for f in (np.minimum, np.maximum))
        middle = 0.5 * (low + high)
        # the sphere about the middle that holds all facets of a block
        block = np.repeat(np.arange(len(start)), np.diff(start, append=n))
        far = np.linalg.norm(sorted_centroids - middle[block], axis=1) + size[order]
        # change of slope over a facet, as in `microfacets.may_shine`
        bend = 2.0 * size[order] * self.facets["curvature"][order]
        radius, bend = (np.maximum.reduceat(x, start) for x in (far, bend))
        return microfacets.Blocks(np.append(start, n), order, middle, radius, bend)

    def blur(self, scene: Scene) -> float:
        """Return the width of the light of one facet on the aperture, one standard deviation."""
        # a slope s turns steep light by (n - 1) s, and reflected light by 2 s; the smaller of the
        # widths along and across wind
        n = scene.medium.n_water / scene.medium.n_air
        turn = 2.0 if scene.reflects else abs(n - 1.0)
        low, high, z = scene.surface.low[2], scene.surface.high[2], scene.target.center.z
        height = max(float(low - z if scene.reflects else z - high), 1e-6)
        return float(turn * height * min(self.surface.roughness[:2]))

    def take_points(self, source: int, receiver: int) -> None:
        """Take one point for an aperture over which blurred light does not change.

        That suffices for the ratio of the light through two meshes.
        """
        scene = self._forwards(source, receiver, None)
        if self.blurred and scene.target.radius <= _POINT * self.blur(scene):
            self.nodes[source, receiver] = 1, 1

    def bounds_of(self, scene: Scene) -> tuple[float, float, float]:
        """Return bounds (stretch, lever, bend) on the images of facets, for `image_gain`.

        `stretch` is |dX/dP|, the change of a landing point X with its crossing P, `lever` [m] that
        with a slope, |dX/ds|. A flat sea stretches light by 1 + (n h / d) (cos i / cos t)^3 in the
        plane of incidence, i and t the angles in water and air, h and d the heights of the ends:
        without bound where it leaves along the surface. Light arrives less flat than straight from
        above the source. `bend` [m-1] is the relative change of this stretch with the crossing,
        3 tan t (n / d) cos^3 i / cos t.
        """
        n, target, source = scene.medium.n_water / scene.medium.n_air, scene.target, scene.emitter
        if scene.reflects:
            # the kernel bounds the image in a mirror where it knows the direction of the light;
            # a plane mirror maps triangles to triangles
            return 0.0, 0.0, 0.0
        height = target.center[2] + self._wave_height
        # bounds hold from the deepest trough to the highest crest
        depth = max(-source.position[2] - self._wave_height, 0.1)
        aside = math.dist(target.center[:2], source.position[:2]) + target.radius
        flattest = aside / math.hypot(aside, max(target.center[2] - self._wave_height, 1e-6))
        # waves turn light flatter than a flat sea: 78 degrees (sine 0.98) at least, within the view
        sin_t = min(target.sin_widest, max(0.98, flattest) * min(n, 1.0))
        cos_t, cos_i = math.sqrt(1.0 - sin_t**2), math.sqrt(1.0 - (sin_t / n) ** 2)
        # a slope ds turns light by (n cos i / cos t - 1) ds, a flat plane meets it at h / cos^2 t
        lever = height * abs(n * cos_i / cos_t - 1.0) / cos_t**2
        # Without the 78 degrees: where a crossing is known, `unscattered._flat_stretch` is checked.
        sin_t = min(target.sin_widest, flattest * min(n, 1.0))
        cos_t, cos_i = math.sqrt(1.0 - sin_t**2), math.sqrt(1.0 - (sin_t / n) ** 2)
        stretch = 1.0 + n * height / depth * max((cos_i / cos_t) ** 3 / 1.5, 1.0)
        bend = 3.0 * sin_t * n / depth * cos_i**3 / cos_t**2
        # 1.5 for the slopes of the waves, which these formulas of a flat sea leave out
        return 1.5 * stretch, 1.5 * lever, bend


def _upside_down(s: MeshArrays) -> tuple[MeshArrays, NDArray[np.void]]:
    """Return a surface upside down, with facets in the same order, and their summary."""
    flip = np.array([1.0, 1.0, -1.0])
    series = s.roughness.series
    # odd moments of the slopes change their sign with z
    odd = series._replace(a=-series.a, aaa=-series.aaa, acc=-series.acc)
    # mirroring turns the sense of the corners: normals point to the air again
    faces = np.ascontiguousarray(s.faces[:, ::-1])
    faces.flags.writeable = False  # as those of every mesh: kernels are compiled for one kind
    surface = s._replace(
        vertices=s.vertices * flip,
        faces=faces,
        face_normals=-s.face_normals * flip,
        vertex_normals=-s.vertex_normals * flip,
        low=np.array([s.low[0], s.low[1], -s.high[2]]),
        high=np.array([s.high[0], s.high[1], -s.low[2]]),
        roughness=s.roughness._replace(series=odd),
    )
    facets = np.empty(len(s.faces), FACET)
    facet_summary(surface, facets)
    return surface, facets


def search_extent(surface: MeshArrays, facets: NDArray[np.void], bins: Locator) -> Search:
    """Return the extent of the search for roots."""
    near = bins.facet if len(bins.facet) else slice(None)
    return Search(
        # Newton does not converge where normals jump from facet to facet: search all facets then
        audit=_AUDITED if surface.interpolate else 1.0,
        margin=2.0 * float(facets["radius"][near].max()),
        curvature=float(facets["curvature"][near].max()),
        still=False,
    )


def _one_block(facets: NDArray[np.int64]) -> microfacets.Blocks:
    """Return all facets as one block of infinite size, so that none is excluded."""
    wide = np.full(1, math.inf)
    return microfacets.Blocks(np.array([0, len(facets)]), facets, np.zeros((1, 3)), wide, wide)


def _disk_nodes(blur: float) -> Nodes:
    """Return the number of rings, and of nodes on each, that integrate a Gaussian spot to 1e-3.

    `blur` is the radius of the aperture over the standard deviation of the spot, which may lie
    anywhere on the disk. None where nodes about the light of each part are fewer.
    """
    if blur > _WIDEST:
        return None
    if blur <= _POINT:
        return 1, 4
    # fitted to the numbers that spots of all places needed; `test_microfacets.py` holds the 1e-3
    return math.ceil(1.0 + 1.05 * blur), math.ceil(4.0 + 1.9 * blur)


@cache
def _rule(on_disk: Nodes, longer: float) -> pencils.Rule:
    """Return the quadratures over an aperture, with rings at Gauss's nodes of the area."""
    rings, around = on_disk or (1, 1)
    if longer > 1.0:
        rings, around = max(rings - 1, 1), max(math.ceil(_FEWER * around), 3)
    nodes, weights = gauss_legendre(rings)
    # every other ring turned by half a step, so that no direction is left out
    azimuth = 2.0 * math.pi * (np.arange(around) + 0.5 * (np.arange(rings)[:, None] % 2)) / around
    circle = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    # dA = d(r^2) dphi / 2: Gauss's nodes in r^2
    points = np.sqrt(0.5 * (nodes + 1.0))[:, None, None] * circle
    shares = np.repeat(0.5 * weights / around, around)
    finer = _FEWER if longer > 1.0 else 1.0
    wide = on_disk is None
    about_half, gauss_weights = gauss_rules(pencils.GAUSS)
    return pencils.Rule(
        points.reshape(-1, 2), shares, wide, 0.5 + about_half, gauss_weights, longer, finer
    )


@cache
def gauss_rules(most: int) -> Floats:
    """Tabulate Gauss-Legendre nodes and weights over (-1/2, 1/2); row n - 1 has n nodes.

    Shape (2, most, most); a row ends in zeros.
    """
    rules = np.zeros((2, most, most))
    for n in range(1, most + 1):
        rules[:, n - 1, :n] = 0.5 * np.array(gauss_legendre(n))
    return rules


def on_disk(center: Vec3, end: Emitter | Target, disk: Floats) -> Floats:
    """Map points (n, 2) of the unit disk to points (n, 3) on the disk of an emitter or target."""
    return np.asarray(center) + end.radius * disk @ np.array([end.e1, end.e2])


def compile_evaluation(link: Link, mesh: TriangleMesh, normals: str = "vertex") -> None:
    """Compile the kernels that evaluate chains of a link over a mesh, in the order of their use.

    The kernels that draw chains take as long to compile, and a second process can compile them.

    Parameters
    ----------
    link, mesh
        Link and surface of a later run, which choose between the kernels.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.

    Raises
    ------
    Refused
        If forced detection does not follow the link.
    """
    arrays = forced_link(link)
    none = ChainDrawer(arrays, 0.0, 0.0).empty(Request(source=0, order=1, per_shift=0, key=()))
    aimed = AimedChains(arrays, mesh, normals, link.physics.unresolved)
    aimed.direct_gains(0, 0)
    aimed.aim(0, 0, none)
