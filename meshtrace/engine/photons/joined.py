"""Joined photons: followed forwards from the source, and joined to every receiver.

Photons move as those of the analog estimator; but they score the expected value of what they bring
to each receiver, at every collision and crossing (`photons.next_event`), not where they hit it.
Light that the surface reflects first comes from photons that go on after a reflection. For light
that goes down photons run backwards, from a receiver in the water to the lamps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains.aimed import ROOTS, search_extent
from meshtrace.engine.crossing import FLAT, ROOT
from meshtrace.engine.gains import Gains, places_of, shares_of, table_of
from meshtrace.engine.photons.joined_walk import follow_joined
from meshtrace.engine.photons.targets import JOINED_PHOTON, TARGET, JoinedWorld, Joins, Window
from meshtrace.engine.setup import arrays, ends
from meshtrace.engine.setup.bodies import BodyScene, for_thread, scene_of
from meshtrace.engine.setup.options import BLOCK
from meshtrace.engine.setup.tinting import UNTINTED, Tinting
from meshtrace.errors import Described, Refused
from meshtrace.kernels.interface import MeshArrays
from meshtrace.kernels.medium import Absorption
from meshtrace.kernels.rays import NO_BVH
from meshtrace.kernels.scene import FACET, Emitter, Locator, Target, facet_summary
from meshtrace.kernels.sources import SourceKind, Sources
from meshtrace.kernels.tally import ARRIVAL
from meshtrace.kernels.tints import NO_TINTS
from meshtrace.link import Link
from meshtrace.link.link import SAME_SIDE
from meshtrace.link.sources import AirLamp
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.results.tallies import ArrivalTally
from meshtrace.stored import SHIFTS

_ORDERS = 40  # separate numbers of scatterings; the last holds all beyond
_LEAST_SLOPED = 0.1  # tuned: least share of aperture points drawn by slopes that pays its time
_COPIES = 256  # room for copies of one photon that wait at a time
_FREQUENT = 0.7  # tuned: least mean number of drawn collisions on the way up
_SPREAD = 1.3  # tuned: width of the law of crossings, over that of the slopes
# tuned: decay of the chance of a connection with depth, over c; random slopes or turbid water
_DECAY = 0.8
# share of these guided directions left beside bodies that reflect; tuned: a plate below the lamp
_BESIDE_BODIES = 0.25
_START = 0.8  # factor on `_LOBE` and `_CONE` for the directions in which photons leave a source
# tuned: expected directions per collision about the targets, over still water, over random slopes
_LOBE, _ROUGH_LOBE = 0.5, 0.3
_CONE = 0.5  # tuned: those uniform over the cones to what the targets see
# tuned: weight times importance, over that of the start, above which photons are split: in turbid
# water, in clear water, and where beams hit their targets
_HIGHEST, _CLEAR_HIGHEST, _AIMED_HIGHEST = 2.0, 1.5, 2.0
_LEAST_FALL = 0.1  # tuned: of ln(importance) over the depth, against photons far below the source
_BENT = 0.3  # tuned: fall of the importance with the bend of light over random slopes
# extrapolated boundary over the diffusion coefficient; 2 would be one without internal reflection
_BOUNDARY = 3.4
_GUIDES = 64  # targets at most to which directions are guided: their densities are sums over all
_TOGETHER = 4  # targets up to which a block of photons stays whole; tuned: memory of arrivals
_ROOM = 32  # arrivals of a photon at each target, else a block is followed again
_VISIBLE = 50.0  # [m], depth from which light comes back to the air at most
_SEEN_SHARE = 0.1  # tuned: radius of the water about a receiver that counts as near, over the way
_OPAQUE = 1e4  # largest optical depth: diffuse photons collide up to its square times (1 - g)
DIFFUSE = 1.0
"""Optical depth b (1 - g) z beyond which the importance is that of diffusion theory."""
# options of the physics that joined photons need
_SWITCHES = {"snell": "physical", "direction": "vector", "second_hit": "trace"}


class JoinedPhotons:
    """Joined photons of a link, for any surface.

    Parameters
    ----------
    link : Link
        The link; sources on the other side of the surface than the receivers.
    photons : int
        Photons, >= 32; for light that goes down, of each receiver.
    seed : int
        Key of the random numbers, 0 <= seed < 2^64.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; results do not depend on them.
    first : int or sequence of int
        1 scores all light, 2 only light that the surface or the bottom has reflected before; for
        all receivers or for each.
    direct : bool
        Score unscattered light, too; only with random slopes.

    Raises
    ------
    Refused
        If the link has a feature that joined photons do not follow, or if its largest
        coefficient of scattering times the depth exceeds 1e4.

    Notes
    -----
    Over waves without random slopes a collision is joined by all crossings that refract its light
    to the receiver. Light that the surface reflects, and that meets it again without a collision
    between, is left out there: 3e-6 of the light that leaves isotropically scattering water over a
    sinusoid of slope 0.31 and over a sea of 6 m/s.
    """

    def __init__(
        self,
        link: Link,
        photons: int,
        seed: int,
        normals: str = "vertex",
        threads: int = 1,
        first: int | Sequence[int] = 1,
        direct: bool = False,
    ) -> None:
        ends.require_followable(link)
        for name, physical in _SWITCHES.items():
            if getattr(link.physics, name) != physical:
                raise Refused(f"physics.{name}", getattr(link.physics, name), f'"{physical}"')
        # photons run backwards to a lamp, which they meet in a point
        for path, item in link.items():
            if link.direction == "down" and isinstance(item, AirLamp) and item.size > 0.0:
                raise Refused(path, Described(f"a radius of {item.size:g} m"), ends.POINTS_ONLY)
        # delta tracking draws collisions at the largest rate of the water: too many in tiny steps
        medium = ends.expected_water(link, crest=0.0)
        rate = medium.b_max if medium.absorption == Absorption.CONTINUOUS else medium.c_max
        most = rate * _way_in_water(link)
        if most > _OPAQUE:
            depth = Described(f"an optical depth of {most:.3g}, at its densest place")
            raise Refused("water", depth, f"up to {_OPAQUE:g}; {ends.ANALOG}")
        self.link, self.photons, self.seed = link, photons, seed
        self._normals, self._threads = normals, threads
        self._first = [int(k) for k in np.broadcast_to(first, len(link.receivers))]
        self._direct = direct

    def evaluate(self, mesh: TriangleMesh, record: bool = False) -> Gains:
        """Return the gain over a mesh, with every arrival if `record`.

        Raises
        ------
        Refused
            If the mesh overhangs.
        """
        (gains,) = self._evaluated(mesh, [self.link], UNTINTED, record, 1)
        return gains

    def at_wavelengths(
        self, mesh: TriangleMesh, tinting: Tinting, links: Sequence[Link], record: bool = False,
        lamps: int = 1,
    ) -> list[Gains]:  # fmt: skip
        """Return the gain of each link over a mesh, at the wavelengths of a tinting.

        Photons are those of the bases of the tinting in turn, refracted by the index of this link.
        Bubbles that differ between the wavelengths need separate photons for each. With several
        `lamps` gains are those of each pair, lamp after lamp.
        """
        if len(links) == 1 or tinting.follows:
            tinting = UNTINTED if len(links) == 1 else tinting
            return self._evaluated(mesh, links, tinting, record, lamps)
        each = (self._in_water_of(link) for link in links)
        return [p._evaluated(mesh, [p.link], UNTINTED, record, lamps)[0] for p in each]

    def _in_water_of(self, link: Link) -> JoinedPhotons:
        """Return the same photons in the water of another link, with the index of this one."""
        photons, n = copy(self), self.link.water.n
        photons.link = link.model_copy(update={"receiver": self.link.receiver})
        if link.water.n != n:
            photons.link = photons.link.replace("water.n", n)
        return photons

    def at_index(self, n: float, photons: int) -> JoinedPhotons:
        """Return `photons` photons with the same random numbers in water of another index."""
        photons_at = copy(self)
        photons_at.link, photons_at.photons = self.link.replace("water.n", n), photons
        return photons_at

    def _evaluated(
        self, mesh: TriangleMesh, links: Sequence[Link], tinting: Tinting, record: bool, lamps: int
    ) -> list[Gains]:
        ends.require_height_field(mesh)
        if record:  # the receivers of these photons may be some of those of the links
            links = [link.model_copy(update={"receiver": self.link.receiver}) for link in links]
        frame, bases = arrays.frame_of(self.link), [self]
        # every base follows separate photons, by the scattering of its water
        if tinting.bases:
            bases = [self._in_water_of(links[i]) for i in tinting.bases]
        intersector = EmbreeIntersector(frame.mesh(mesh), 1)
        n = len(self.link.receivers)
        gains = Gains.zeros(len(tinting.shares), lamps * n, _ORDERS)
        tables = [list[ArrivalTally]() for _ in links]
        for run in self._runs(frame):
            worlds = list[JoinedWorld]()
            for base in bases:
                worlds.append(base._world(frame, intersector, run))
            # targets of a backward run are lamps, whose scores all add to its one receiver
            receivers = run.receivers if run.start is None else run.receivers * len(run.targets)
            places = receivers
            if lamps > 1:
                places = [k * n + r for k in range(lamps) for r in run.receivers]
            launched = lamps if run.start is None else 1  # lamps from which photons start
            for sums, arrivals, weights in self._follow(
                worlds, intersector, tinting, record, launched
            ):
                gains.add(sums, places)
                if not record:
                    continue
                arrivals["receiver"] = np.array(receivers)[arrivals["receiver"]]
                weights = weights * shares_of(arrivals, self.photons)
                for table, weight, link in zip(tables, weights, links, strict=False):
                    table.append(table_of(arrivals, weight, frame.unit, link))
        if record:
            gains.table.extend(ArrivalTally.concatenated(table) for table in tables)
        return gains.of_photons(self.photons).by_wavelength()

    @property
    def _under(self) -> bool | None:
        """Whether both ends lie under the surface, None for a link that crosses it."""
        direction = self.link.direction
        return direction == "under" if direction in SAME_SIDE else None

    def _runs(self, frame: arrays.Frame) -> list[_Run]:
        """Return the runs: one to all receivers in the air, or one from each in the water."""
        link = self.link
        if link.direction != "down":
            # sorted, so that sums do not depend on the order in which receivers are listed
            order = sorted(range(len(link.receivers)), key=lambda i: repr(link.receivers[i]))
            targets = [ends.target_of(link.receivers[i], frame) for i in order]
            first = [self._first[i] for i in order]
            return [_Run(None, order, targets, np.ones(len(order)), first)]
        # photons from each receiver, weighted by what its view collects, to every lamp
        power = np.array([t.power_mw for t in link.transmitters])
        lamps = [
            ends.lamp_target(t, link, frame) for t in link.transmitters if isinstance(t, AirLamp)
        ]
        runs = []
        for i, end in enumerate(link.receivers):
            start, first = ends.emitter_of(end, frame), [self._first[i]] * len(lamps)
            # what the view of the receiver collects, times the share of each lamp in the power
            runs.append(_Run(start, [i], lamps, start.power * power / power.sum(), first))
        return runs

    def _world(self, frame: arrays.Frame, intersector: EmbreeIntersector, run: _Run) -> JoinedWorld:
        """Return the inputs of the photons of a run."""
        link, start = self.link, run.start
        surface = arrays.surface_arrays(intersector.mesh, self._normals, link.physics.unresolved)
        rough = max(surface.roughness[:2]) > 0.0
        ends.require_followed_bodies(link, frame.unit * float(surface.low[2]), rough)
        is_level = surface.low[2] == surface.high[2] and surface.max_slope == 0.0
        # smooth waves focus: crossings are then solved for, all of them
        is_smooth = not is_level and max(surface.roughness[:2]) == 0.0
        crest = frame.unit * float(surface.high[2])
        medium = arrays.with_raster(frame.medium(ends.expected_water(link, crest)), intersector)
        if start is None:
            sources = arrays.source_arrays(link, crest, frame)
        else:  # an aperture in the water as the one source of photons that run backwards
            end = start.kind, start.position, start.axis, start.spread, start.radius
            in_water, share = True, 1.0
            rest = in_water, share, start.e1, start.table
            sources = Sources(*(np.array([value]) for value in (*end, *rest)))
        grid = arrays.grid_arrays(intersector.mesh)
        bins, facets, search = arrays.NO_BINS, np.zeros(0, FACET), None
        # a grid finds the facet over a point by its lines; Newton over smooth waves by bins
        if is_smooth or not len(grid.x.line):
            bins = arrays.locator(surface, run.targets)
        if is_smooth:
            facets = np.empty(len(surface.faces), FACET)
            facet_summary(surface, facets)
            search = search_extent(surface, facets, bins)
        joins = self._joins(surface, sources, run, frame, bins, facets)
        return JoinedWorld(
            np.uint64(self.seed), sources, surface, grid, medium, arrays.interface_arrays(link),
            joins, search, np.zeros(1, FLAT), np.zeros(ROOTS, ROOT), None, self._under,
            NO_TINTS, NO_BVH,
            np.zeros(1 + _COPIES, JOINED_PHOTON), np.zeros(0, ARRIVAL), np.zeros(1, np.int64),
        )  # fmt: skip

    def _joins(
        self, surface: MeshArrays, sources: Sources, run: _Run, frame: arrays.Frame,
        bins: Locator, facets: NDArray[np.void],
    ) -> Joins:  # fmt: skip
        """Return the targets and the guides of the photons."""
        link = self.link
        # densities at any angle, beside the quantiles of `Medium` by which angles are drawn
        water = arrays.angle_table(link.water.phase)
        bubble = arrays.angle_table(link.bubbles.phase_function()) if link.bubbles else water
        # mean square of one component of the random slopes; `roughness` has standard deviations
        rough = 0.5 * (surface.roughness.along**2 + surface.roughness.across**2)
        depth = _way_in_water(link) / frame.unit
        a, b = (frame.unit * x for x in arrays.mean_water(link.water, frame.unit * depth))
        # transport coefficient b (1 - g): by it light forgets its direction
        turned = b * (1.0 - link.water.phase.mean_cosine)
        # clear water has few collisions, at which photons are joined: more are drawn, and weighted.
        # Where collisions absorb, their rate is that of light
        often = 1.0
        if link.physics.absorption == "continuous" and link.physics.free_path != "local_c":
            often = max(1.0, _FREQUENT / (b * depth)) if b > 0.0 else 1.0
        in_water = link.direction == "under"
        window = _window(a, turned, turned * depth > DIFFUSE)
        # crossings are drawn somewhat wider than slopes of waves and random ones carry them
        spread = _SPREAD * math.sqrt(rough + arrays.mean_square_slope(surface))
        bends = rough > 0.0 and not window.diffuse and self._under is None
        if bends and self._is_aimed(sources, run.targets, spread):
            # beams onto targets: a collision turns light out of the range that slopes can bend back
            mean_share = _remaining_importance(water, link.water.n / link.n_air, spread)
            kappa = a + b * (1.0 - mean_share)
            window = window._replace(kappa=kappa, highest=_AIMED_HIGHEST, bent=_BENT)
        # water that hardly attenuates would keep photons that go down for ever
        window = window._replace(kappa=max(window.kappa, _LEAST_FALL / depth))
        walls = _walls(scene_of(link, frame))
        free_path = 1.0 / max(a + b, 1e-300)  # no division by 0 in clear water
        records = self._targets(surface, sources, run, walls, free_path)
        # ceiling division: evenly spaced, at most _GUIDES
        guides = records[:: -(-len(records) // _GUIDES)].copy()
        # without random slopes collisions alone are joined, and no connection is left out
        still = rough == 0.0
        decay = 0.0 if still and not window.diffuse else _DECAY * (a + b)
        lobe = _LOBE if still else 0.0 if window.bent > 0.0 else _ROUGH_LOBE
        cone = 0.0 if window.diffuse else _CONE
        first = min(run.first)
        start = _START if first == 1 else 0.0
        if len(walls):  # light that reflects may lead anywhere
            start *= _BESIDE_BODIES
        start_lobe, start_cone = start * lobe, start * cone
        if in_water:
            guides = np.concatenate([guides, _images(guides, sources, window.kappa, spread)])
            # straight connections bring light from any depth; close to a receiver even directions
            # cost more copies than they save
            decay = cone = 0.0
        return Joins(
            records, guides, first, self._direct, water, bubble, bins, facets, spread, decay,
            often * b, often, start_lobe, start_cone, lobe, cone, window,
        )  # fmt: skip

    def _targets(
        self, surface: MeshArrays, sources: Sources, run: _Run, walls: Floats, free_path: float
    ) -> NDArray[np.void]:
        """Return the records of the targets of a run, see `TARGET`."""
        records, in_water = np.zeros(len(run.targets), TARGET), self.link.direction == "under"
        records["first"] = run.first
        # area over which slopes spread light, per squared height: 2 pi sigma_a sigma_c (n - 1)^2
        turn = 2.0 if in_water else self.link.water.n / self.link.n_air - 1.0
        blur = 2.0 * math.pi * surface.roughness.along * surface.roughness.across * turn**2
        for row, target, part in zip(records, run.targets, run.share, strict=True):
            _fill(row, target, part, free_path)
            if in_water:
                _see_in_water(row, sources, walls)
            if not target.is_lamp and max(surface.roughness[:2]) > 0.0:
                # the wider an aperture against the blur by slopes, the more of its points slopes
                # draw
                sloped = target.area / (target.area + blur * target.center.z**2)
                row["sloped"] = sloped if sloped > _LEAST_SLOPED else 0.0
        return records

    def _is_aimed(self, sources: Sources, targets: list[Target], spread: float) -> bool:
        """Return whether random slopes bend most of the unscattered light to the targets.

        Array twin of `bend_ahead` for the axes of the sources.
        """
        # Snell's law in vectors: the normal that bends d_w to d_a is along n d_w - n_air d_a
        n, n_air = self.link.water.n, self.link.n_air
        beams = (SourceKind.GAUSSIAN_BEAM, SourceKind.TOP_HAT_BEAM)
        for kind, p, axis, wide in zip(
            sources.kind, sources.position, sources.axis, sources.spread, strict=True
        ):
            if kind not in beams or n * wide > 2.0 * (n - n_air) * spread or axis[2] <= 0.0:
                return False
            # from the point where the axis meets still water
            way = np.array([t.center for t in targets]) - (p - axis * (p[2] / axis[2]))
            normal = n * axis - n_air * way / np.linalg.norm(way, axis=1)[:, None]
            if not (np.hypot(normal[:, 0], normal[:, 1]) < 2.0 * spread * normal[:, 2]).any():
                return False
        return True

    def _follow(
        self,
        worlds: Sequence[JoinedWorld],
        intersector: EmbreeIntersector,
        tinting: Tinting,
        record: bool,
        lamps: int,
    ) -> Iterator[tuple[Gains, NDArray[np.void], Floats]]:
        """Yield (sums by lamp and target, arrivals, weights) of consecutive photons of a run.

        Weights are (wavelengths, arrivals); both are empty unless they are recorded. Blocks of
        `BLOCK` photons belong to the bases in turn; they are split further for many targets.
        """
        n = len(worlds[0].joins.target)
        # whole groups of photons, so that a part has about the rows of a block to a few targets
        step = max(BLOCK // (-(-n // _TOGETHER) * SHIFTS), 1) * SHIFTS
        spans = [
            (i, min(i + step, start + BLOCK, self.photons))
            for start in range(0, self.photons, BLOCK)
            for i in range(start, min(start + BLOCK, self.photons), step)
        ]
        # numbers of photons by base, for the balance heuristic
        numbers = np.zeros(len(worlds))
        for first, last in spans:
            numbers[first // BLOCK % len(worlds)] += last - first
        kappa = np.array([world.joins.window.kappa for world in worlds])
        frame = arrays.frame_of(self.link)
        bodies, depth = scene_of(self.link, frame), _way_in_water(self.link) / frame.unit
        # importance exp(-kappa depth) at the start, over the first base's: see `Tinting.mixed`
        importance = np.exp((kappa[0] - kappa) * depth)

        def follow(span: tuple[int, int]) -> tuple[Gains, NDArray[np.void], Floats]:
            first, last = span
            base = first // BLOCK % len(worlds)
            world = worlds[base]._replace(tints=tinting.tints)
            room = _ROOM * (last - first) * n
            while True:  # followed again, with the same random numbers, if its rows had no room
                with intersector.function() as bvh, for_thread(bodies) as body_arrays:
                    block = world._replace(
                        bvh=bvh,
                        bodies=body_arrays,
                        photon=np.zeros_like(world.photon),
                        flat=np.zeros_like(world.flat),
                        roots=np.zeros_like(world.roots),
                        arrivals=np.empty(room, ARRIVAL),
                        n_arrivals=np.zeros(1, np.int64),
                    )
                    follow_joined(first, last, block)
                if block.n_arrivals[0] <= room:
                    break
                room = int(block.n_arrivals[0])
            arrivals = block.arrivals[: block.n_arrivals[0]]
            factors = tinting.mixed(arrivals["tint"], base, numbers / self.photons, importance)
            factors *= arrivals["weight"]
            sums = Gains.zeros(len(factors), lamps * n, _ORDERS)
            place = places_of(arrivals, self.seed, self.link, lamps, n)
            sums.add_arrivals(arrivals, factors, first, last - first, place)
            if record:
                return sums, arrivals, factors
            # no views: they would keep the memory of this block while the next one is followed
            return sums, np.empty(0, ARRIVAL), np.empty((len(factors), 0))

        return ordered_map(follow, spans, self._threads)


class _Run(NamedTuple):
    """Photons from the sources, or backwards from one receiver, and their targets."""

    start: Emitter | None  # a receiver in the water
    receivers: list[int]  # that the photons serve: the targets, or the start
    targets: list[Target]
    share: Floats  # factors on the scores of the targets
    first: list[int]  # by target, number of the crossing from which on light is scored


def _remaining_importance(phase: Floats, n: float, spread: float) -> float:
    """Return the mean share of its importance that light keeps at a collision.

    `phase` is that of `arrays.angle_table`, `spread` the standard deviation of the slopes, n the
    index of water over that of air.
    """
    edge = arrays.angle_edges()
    theta = 0.5 * (edge[1:] + edge[:-1])
    scattered = 2.0 * math.pi * phase * np.sin(theta) * np.diff(edge)
    # Squared slope over its variance that bends light back after a turn by theta: by Snell's law
    # for small angles a slope s turns refracted light by (n - 1) s, the collision by n theta.
    bend = (n * theta / ((n - 1.0) * spread)) ** 2
    return float((scattered / (1.0 + _BENT * bend)).sum() / scattered.sum())


def _window(a: float, turned: float, diffuse: bool) -> Window:
    """Return the weight window of water with absorption a and transport coefficient b (1 - g)."""
    # attenuated by a + b (1 - g): light that is scattered forwards stays in the view
    kappa, length, beyond, highest = a + turned, 0.0, 0.0, _CLEAR_HIGHEST
    if diffuse:
        # diffusion theory: D = 1 / (3 (a + b (1 - g))), decay (a / D)^(1/2), and an extrapolated
        # boundary beyond the surface, where the fluence would vanish
        d = 1.0 / (3.0 * (a + turned))
        kappa, length = math.sqrt(a / d), 1.0 / (a + turned)
        beyond, highest = _BOUNDARY * d, _HIGHEST
    return Window(diffuse, kappa, length, beyond, highest, bent=0.0)


def _way_in_water(link: Link) -> float:
    """Return the length of the path of light through the water [m], for rates and importances.

    The largest depth of an end; between ends in the water their largest distance; of light that
    comes back to the air, or to receivers behind the lamps, the depth of the bottom, or that from
    which a share e^-6 returns.
    """
    pairs = list(product(link.transmitters, link.receivers))
    ahead = any(np.dot(t.axis, np.subtract(r.center, t.center)) > 0.0 for t, r in pairs)
    if link.direction == "under" and ahead:
        return max(math.dist(t.center, r.center) for t, r in pairs)
    if link.direction in ("under", "over"):
        a = arrays.mean_water(link.water, 1.0)[0]
        visible = 3.0 / a if a > 0.0 else math.inf
        return min(link.water.bottom_depth or math.inf, visible, _VISIBLE)
    return max(-item.center[2] for _, item in link.items())


def _walls(bodies: BodyScene | None) -> Floats:
    """Return a corner of each facet that reflects light, in the frame of the bodies."""
    if bodies is None:
        return np.zeros((0, 3))
    facets = bodies.arrays
    return facets.vertices[facets.faces[facets.albedo[facets.body] > 0.0, 0]]


def _see_in_water(row: np.void, sources: Sources, walls: Floats) -> None:
    """Write the sphere of water about a receiver from which most scattered light reaches it.

    It extends to the nearest of the points (n, 3) of bodies that reflect.
    """
    far = np.linalg.norm(sources.position - row["center"], axis=1).max()
    near = np.linalg.norm(walls - row["center"], axis=1).min(initial=math.inf)
    row["seen"][:3] = row["center"]
    row["seen"][3] = max(float(row["radius"]), _SEEN_SHARE * float(far))
    # else roulette would end the light of a lamp beside the receiver before it comes back
    if len(walls):
        row["seen"][3] = max(row["seen"][3], near)


def _images(
    guides: NDArray[np.void], sources: Sources, kappa: float, spread: float
) -> NDArray[np.void]:
    """Return guides to the images of receivers in still water, where their light counts.

    `spread` is the standard deviation of the slopes of the sea.
    """
    images = guides.copy()
    images["mirror"] = 1
    images["seen"][:, 2] *= -1.0
    # two standard deviations of slopes turn light by four: over the depth of the receiver
    glitter = np.minimum(4.0 * spread, 1.0) * images["seen"][:, 2]
    images["seen"][:, 3] = np.maximum(images["seen"][:, 3], glitter)
    # beyond e^-3 of the straight light the mirror is not worth directions of its own
    straight, mirrored = (
        np.linalg.norm(sources.position[:, None] - end["seen"][:, :3], axis=-1).min(axis=0)
        for end in (guides, images)
    )
    return images[kappa * (mirrored - straight) < 3.0]


def _fill(row: np.void, target: Target, share: float, free_path: float) -> None:
    """Write a target as a record; `free_path` is the mean one [m]."""
    for name, value in target._asdict().items():
        row[name] = value
    row["share"] = share
    # The part of still water that it sees: where its axis leads, as wide as its cone and aperture.
    # The axis of a lamp is along its light, downwards; that of a receiver is along the light that
    # it takes, upwards, and is turned.
    axis = np.array(target.lamp.axis) if target.is_lamp else -np.array(target.axis)
    fall = target.center.z / max(-axis[2], 0.1)  # [m] along the axis, bounded for grazing views
    row["seen"][:2] = np.array(target.center)[:2] + fall * axis[:2]
    row["seen"][2] = 0.0
    half = math.acos(target.cos_half_fov)
    # 1.4 rad: the tangent of wider views is bounded by their reach
    wide = min(fall * math.tan(min(half, 1.4)), target.reach) + target.radius
    # tuned: the last collision, a part of a free path below, may lie somewhat farther out
    row["seen"][3] = wide + 0.3 * free_path
