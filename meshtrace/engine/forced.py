"""Forced detection: scattering chains rotated to land on the aperture.

Everything random about a photon except its emission direction is drawn; then the directions
that land it on a random point x of the aperture are solved for. With K scatterings

    h_K = E[ |A| sum_{w: X_K(w) = x} I(w) W_K(w) / |det dX_K / dOmega(w)| ],   h = sum_K h_K,

with the area |A| of the aperture, the emission direction w, the intensity I(w) of the source
[sr-1], the point X_K(w) where a chain meets the plane of the aperture, and the weight W_K of a
chain (transmittances and albedos); see "Forced detection" in docs/theory.md. K = 0 is deterministic
(`chains.unscattered`); every K >= 1 has its own chains. The random numbers are Sobol points with
32 random shifts: the mean over each shift is an independent, unbiased estimate, and the scatter of
these means gives the standard error.

The chains do not depend on the surface: one set serves every frame of a moving sea.

Where chains are the less efficient estimator, scattered light comes from joined photons
(`meshtrace.engine.photons.joined`) or analog ones (`meshtrace.engine.photons.arriving`). Light off
the bottom, and light that the surface reflects before it crosses, always comes from photons; the
latter is left out where it is negligible.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property, partial
from operator import call
from typing import Any

import numpy as np

from meshtrace.engine import parts
from meshtrace.engine.chains.aimed import AimedChains
from meshtrace.engine.chains.gain import Counter
from meshtrace.engine.chains.sets import Drawing, Request, blocks_of, flat_mesh, points_of, shifted
from meshtrace.engine.choice import ANALOG_PER_CHAIN
from meshtrace.engine.gains import Gains
from meshtrace.engine.photons.arriving import scattered_gains
from meshtrace.engine.plan import Plan, Planner
from meshtrace.engine.plan import Scattered as Scattered
from meshtrace.engine.plan import TypicalSea as TypicalSea
from meshtrace.engine.setup import ends
from meshtrace.engine.setup.options import Case
from meshtrace.engine.straight import straight_gains
from meshtrace.errors import Described, Refused
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.tally import DIRECT, MIRRORED
from meshtrace.kernels.tints import Tints
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import Pace, ordered_map
from meshtrace.results.gain import ChainCounts
from meshtrace.results.tallies import ArrivalTally, error_of_groups
from meshtrace.stored import SHIFTS

MANY_SEAS = 1.5
"""Factor on the highest crest of sample meshes: seas that are not known yet may be higher."""

# Unscattered light of an extended source is summed over points of the source, one for this many
# chains; tuned: each point costs an integral over the facets.
_CHAINS_PER_POINT = 32
# points of each shift that are tried first, and the relative standard error below which they
# suffice: seen from afar an extended source is hardly more than a point; tuned: time
_FEW_POINTS, _SMOOTH = 2, 5e-4
_CUT_CHAINS = 2048  # to estimate the share of the light that a mesh cuts off; tuned: noise, time
# chains of an order over those of the largest one: orders with fewer are dropped. Allotment goes
# with the square root of the variance: 3 % of the chains carry some 0.1 % of the light.
_LEAST_CHAINS = 0.03
_UNSCATTERED_SHARE = 0.3  # chains without a scattering, over all others; tuned: noise, time


class ForcedDetection:
    """Gain of a link over any surface, by chains and photons.

    Parameters
    ----------
    link : Link
        The link; sources on the other side of the surface than the receivers.
    photons : int
        Chains in all. There are eight times as many joined photons where these follow scattered
        light or light off the bottom. If they follow only light that the surface reflects first,
        there are twice as many, or fewer where it is below 2 % of the gain or where its error is
        small beside that of the chains: they take a tenth of the time. Photons
        that several wavelengths share may be as few as the chains, see `choice.choose_common`.
        There are 32 times as many analog photons.
    seed : int
        Seed of the points and their shifts.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; results do not depend on them.
    sea : TypicalSea
        Crest and random slopes that are expected of the surfaces.
    scattered : {"auto", "chains", "joined"}
        Estimator of the scattered light; "auto" chooses one for each receiver by pilot runs over
        still water with random slopes, see `meshtrace.engine.choice`. "chains" omits light that
        the surface reflects first.

    Raises
    ------
    Refused
        If the link has a feature that only the analog estimator follows.
    """

    def __init__(
        self,
        link: Link,
        photons: int,
        seed: int,
        normals: str = "vertex",
        threads: int = 1,
        sea: TypicalSea = TypicalSea(),  # noqa: B008 - frozen
        scattered: Scattered = "auto",
    ) -> None:
        planner = Planner(link, seed, normals, threads, sea, scattered=scattered)
        self._draw(planner, planner.plan(photons, planner.compare()))

    @classmethod
    def following(cls, planner: Planner, plan: Plan) -> ForcedDetection:
        """Return the estimator with the chains and photons of a plan."""
        forced = cls.__new__(cls)
        forced._draw(planner, plan)
        return forced

    def _draw(self, planner: Planner, plan: Plan) -> None:
        """Draw the chains of a plan."""
        self.planner, self.plan = planner, plan
        self.photons, self.threads, self.method = plan.photons, planner.threads, plan.method
        self.link, self.arrays, self.drawer = planner.link, planner.arrays, planner.drawer
        self._unscattered: list[Drawing] = []  # drawn on demand, see `unscattered`
        # drawn before any surface is known: one set serves every frame of a moving sea
        drawings = self.drawer.draw_all(plan.chains, self.threads)
        self.scattered_sets = [
            [(request, chains) for request, chains in drawings if request.source == s]
            for s in range(len(self.arrays.emitters))
        ]

    def at_index(self, n: float, share: float) -> ForcedDetection:
        """Return the estimator in water of another index, with a share of its chains and photons.

        They have the same random numbers, so that noise cancels in differences. Orders of
        scattering with negligible light, to which pilots allot few chains, are left out.
        """
        joined, chains = self.plan.joined, list[Request]()
        for drawings in self.scattered_sets:
            requests = [request for request, _ in drawings]
            least = _LEAST_CHAINS * max((request.per_shift for request in requests), default=0)
            for request in requests:
                if request.per_shift > least:
                    fewer = max(round(share * request.per_shift), 2)
                    chains.append(request._replace(per_shift=fewer))
        if joined is not None:
            joined = joined.at_index(n, max(round(share * joined.photons), SHIFTS))
        photons = max(round(share * self.photons), SHIFTS)
        plan = replace(self.plan, photons=photons, chains=chains, joined=joined)
        return ForcedDetection.following(self.planner.at_index(n), plan)

    @property
    def serves_neighbours(self) -> bool:
        """Whether the gain rests on chains of point sources alone, which `FrozenForced` reuses."""
        # joined photons are followed under one surface; chains are drawn without it
        chained = set(self.method) == {"chains"} and not any(self.arrays.sizes)
        return chained and self.plan.joined is None

    def sets(self, unscattered: bool) -> list[list[Drawing]]:
        """Return the chains by source, preceded by chains without scatterings if `unscattered`."""
        if not unscattered:
            return self.scattered_sets
        pairs = zip(self.unscattered(), self.scattered_sets, strict=True)
        return [[first, *others] for first, others in pairs]

    def unscattered(self) -> list[Drawing]:
        """Return chains without scatterings by source, which differ in their random slopes only.

        They sample unscattered light where random slopes are too narrow for an integral over the
        facets, or where that integral is 0.
        """
        if self._unscattered:
            return self._unscattered
        # chains of a downlink start at receivers, each with the full number; the sources of an
        # uplink divide it between them
        emitters = len(self.arrays.emitters)
        per_source = self.photons / (1 if self.arrays.down else emitters)
        n = max(math.ceil(_UNSCATTERED_SHARE * per_source / SHIFTS), 2)
        # keys end in the order, 0, and the purpose, 1 for the chains of a run
        requests = [Request(s, 0, n, (*self.planner.keys[s], 0, 1)) for s in range(emitters)]
        self._unscattered = self.drawer.draw_all(requests)
        return self._unscattered

    @property
    def _requests(self) -> list[Request]:
        """Requests of all chains in order of their numbers, chains without scatterings last."""
        return [*self.plan.chains, *(request for request, _ in self._unscattered)]

    def evaluate(self, mesh: TriangleMesh) -> Gains:
        """Return the gain over a mesh, at the first wavelength."""
        return self.at_wavelengths(mesh)[0]

    def at_wavelengths(
        self, mesh: TriangleMesh, surface: AimedChains | None = None, record: bool = False,
        per_lamp: bool = False,
    ) -> list[Gains]:  # fmt: skip
        """Return the gains over a mesh at all wavelengths that share these paths.

        `surface` is the same mesh, already prepared for a link that differs in the water alone;
        `record` adds a table with a row for every arrival, `per_lamp` the gains by lamp.
        """
        # chains end below the ceiling of the expected sea: light above it would be missed; the mesh
        # is in metres, the ceiling in units of the frame
        top = float(mesh.bounds[1, 2])
        if top > self.drawer.ceiling * self.arrays.frame.unit and "chains" in self.method:
            planner = replace(self.planner, sea=self.planner.sea._replace(crest=top))
            higher = ForcedDetection.following(
                planner, planner.plan(self.photons, planner.compare())
            )
            return higher.at_wavelengths(mesh, surface, record, per_lamp)
        aimed = surface.of_link(self.arrays) if surface else self.planner.aim_over(mesh)
        plan, shared = self.plan, self.planner.shared
        aimed = aimed.at_wavelengths(shared)
        lamps = len(self.arrays.power) if per_lamp else 1
        gains = self._chain_gains(aimed, lamps).by_wavelength()
        # arrivals of chains are recorded in a second pass: few runs ask for them
        tables = self._tables(aimed) if record else [list[ArrivalTally]() for _ in gains]
        joined: list[Gains] = []
        if plan.joined is not None:
            joined = plan.joined.at_wavelengths(mesh, shared.tinting, shared.links, record, lamps)
        groups = [(joined, plan.joined_to)]
        analog = [r for r, method in enumerate(self.method) if method == "analog"]
        if analog:
            planner, number = self.planner, round(ANALOG_PER_CHAIN * self.photons)
            photons = scattered_gains(
                planner.link_to(analog), mesh, number, planner.seed, planner.normals,
                planner.threads, record, lamps,
            )  # fmt: skip
            groups.append(([photons], analog))
        # photons are numbered after all chains, those without scatterings last
        chains = sum(request.number for request in self._requests)
        for by_wavelength, receivers in groups:
            pairs = [k * len(self.method) + r for k in range(lamps) for r in receivers]
            for i, by_photons in enumerate(by_wavelength):
                gains[i] = gains[i].with_photons(by_photons, pairs)
                tables[i] += [table.moved(receivers, chains) for table in by_photons.table]
        if record:
            whole = map(ArrivalTally.concatenated, tables)
            gains = [replace(g, table=[t]) for g, t in zip(gains, whole, strict=True)]
        return [g.over_lamps(lamps) for g in gains] if per_lamp else gains

    def _chain_gains(self, aimed: AimedChains, lamps: int = 1) -> Gains:
        """Return the gain by unscattered light and by chains at all wavelengths.

        For each pair of a lamp and a receiver, lamp after lamp, unless `lamps` is 1.

        A pair of ends with no light through the facets may still have some through random slopes,
        which chains without scatterings then sample.
        """
        link, sampled = self.arrays, list[tuple[int, int]]()
        orders = max((request.order for request in self.plan.chains), default=0) + 1
        gains = Gains.zeros(aimed.wavelengths, lamps * len(self.method), orders)
        # Slopes too narrow for an integral are sampled by chains without scatterings; extended
        # sources are summed anyway. Such chains cross the surface, and show nothing of what it
        # mirrors: for ends on one side slopes so narrow are left out.
        integrated = link.reflects or not aimed.sampled
        exact = [p for p in link.pairs if integrated or link.sizes[p[0]] > 0.0]
        dark = [pair for pair in link.pairs if pair not in exact]
        part = MIRRORED if link.reflects else DIRECT
        served = [pair for pair in link.pairs if self.method[link.receiver(*pair)] == "chains"]
        chain_jobs = parts.chain_jobs(served, self.scattered_sets)
        # without chains and joined photons, whose groups scatter far more, see `add_direct`
        alone = not self.plan.chains and self.plan.joined is None
        # one queue for facets and chains: a thread that is done with facets takes up chains
        jobs: list[Any] = [partial(self._source_gains, aimed, *pair) for pair in exact]
        jobs += [partial(self._scores, aimed, job) for job in chain_jobs]
        results = ordered_map(call, jobs, self.threads, ahead=len(jobs))
        cut_short = 0
        for pair in exact:
            from_points, error = next(results)
            gain = from_points.mean(axis=1).T  # (wavelengths, 1 or SHIFTS)
            # the error where a view ends within the aperture counts even beside chains
            in_groups = alone or aimed.meets_rim(*pair)
            place, gain = self._place(*pair, lamps), link.share(*pair) * gain
            gains.add_direct(place, gain, error, in_groups, part)
            cut_short += aimed.is_cut_short(*pair)
            # an extended source is sampled at random points, with a value for each shift
            if gain.shape[-1] > 1:
                sampled.append(pair)
            elif not gain.any() and not link.reflects:
                dark.append(pair)
        for e, t in link.pairs if link.reflects else []:
            gain, error = self._straight_gains(aimed, e, t)
            gains.add_direct(self._place(e, t, lamps), link.share(e, t) * gain, error, alone)
        drawn = sum(request.number for request in self.plan.chains)
        pace = Pace(len(chain_jobs), f"{drawn:,} chains over one surface")
        for job, scores in zip(chain_jobs, results, strict=True):
            self._add_scores(gains, job, scores, lamps)
            pace.add()
        # a narrow beam may pass between the quadrature nodes of all facets: chains may hit it
        rest = parts.chain_jobs(dark, [[drawing] for drawing in self.unscattered()] if dark else [])
        results = ordered_map(partial(self._scores, aimed), rest, self.threads)
        bright = set(sampled)  # pairs with sampled unscattered light, counted in the result
        for job, scores in zip(rest, results, strict=True):
            self._add_scores(gains, job, scores, lamps)
            source = job[1].request.source
            bright |= {(source, t) for t, score in zip(job[0], scores, strict=True) if score.any()}
        outcomes = {c.name.lower(): int(aimed.counters[c]) for c in Counter}
        counts = ChainCounts(drawn=drawn, sampled=len(bright), cut_short=cut_short, **outcomes)
        method = lamps * self.method
        return replace(gains, method=method, counts=counts, reflects=self.plan.reflects)

    def _place(self, emitter: int, target: int, lamps: int) -> int:
        """Return the index of a pair of ends among the gains, see `_chain_gains`."""
        link = self.arrays
        lamp = link.lamp(emitter, target) if lamps > 1 else 0
        return lamp * len(self.method) + link.receiver(emitter, target)

    def _scores(self, aimed: AimedChains, job: parts.ChainJob) -> list[Floats]:
        """Return the scores (wavelengths, chains) of a block of chains at each target of a job."""
        targets, block = job
        chains, scores = self.drawer.drawn(block), dict[int, Floats]()
        for group in aimed.together(targets, chains):
            # columns go through all chains of the first target, then of the second, and so on
            score, _ = aimed.aim(block.request.source, group, chains)
            scores |= dict(zip(group, np.split(score, len(group), axis=-1), strict=True))
        return [scores[target] for target in targets]

    def _add_scores(
        self, gains: Gains, job: parts.ChainJob, scores: list[Floats], lamps: int
    ) -> None:
        """Add the scores of a block of chains at each target of a job to the gains."""
        targets, block = job
        request = block.request
        for t, score in zip(targets, scores, strict=True):
            place = self._place(request.source, t, lamps)
            share = self.arrays.share(request.source, t) / request.number
            gains.add_chains(place, request.order, block.shifts_in, score, share)

    def _source_gains(self, aimed: AimedChains, e: int, t: int) -> tuple[Floats, float]:
        """Return unscattered gains by points of a source, and their relative quadrature error.

        From emitter e to target t, of shape (shifts, points, wavelengths) for an extended source,
        with a few points of each shift if these agree, else with all of them; (1, 1, wavelengths)
        for a point source.
        """
        # the gain of a point source is an integral without noise: all shifts share one value
        if self.arrays.sizes[e] == 0.0:
            return aimed.direct_light(e, t)[None, None], aimed.relative_error(e, t)
        if aimed.sampled:
            radius = Described(f"a radius of {self.arrays.sizes[e] * self.arrays.frame.unit:g} m")
            allowed = f"a point source below random slopes this narrow; {ends.ANALOG}"
            raise Refused("transmitter", radius, allowed)
        points = self._lamp_points(e)
        gains: Floats = np.zeros((SHIFTS, 0, aimed.wavelengths))
        # the other points only if the first ones differ: each costs an integral over the facets
        for part in (points[:, :_FEW_POINTS], points[:, _FEW_POINTS:]):
            if not part.size:
                break
            by_point = []
            for p in part.reshape(-1, 3):
                by_point.append(aimed.direct_light(e, t, Vec3(*p.tolist())))
            gains = np.concatenate([gains, np.reshape(by_point, (*part.shape[:2], -1))], axis=1)
            error = error_of_groups(gains.mean(axis=1))
            if (error < _SMOOTH * gains.mean(axis=(0, 1))).all():
                break
        return gains, aimed.relative_error(e, t)

    def unscattered_gain(self, mesh: TriangleMesh) -> Floats:
        """Return the unscattered gain of each receiver over a mesh."""
        return self._chain_gains(self.planner.aim_over(mesh)).by_wavelength()[0].ballistic

    @cached_property
    def _media(self) -> list[Medium]:
        """The water at each wavelength."""
        links, frame = self.planner.shared.links, self.arrays.frame
        if len(links) == 1:
            return [self.arrays.medium]
        return [frame.medium(ends.expected_water(link, crest=5.0)) for link in links]

    def _straight_gains(self, aimed: AimedChains, e: int, t: int) -> tuple[Floats, float]:
        """Return the light (wavelengths, 1 or SHIFTS) straight from an emitter to a target.

        With the relative error of its quadrature.
        """
        link = self.arrays
        points: list[list[Vec3 | None]] = [[None]]
        if link.sizes[e] > 0.0:
            by_shift = self._lamp_points(e)[:, :_FEW_POINTS].tolist()
            points = [[Vec3(*p) for p in shift] for shift in by_shift]
        gains, errors = np.zeros((len(self._media), len(points))), [0.0]
        for i, medium in enumerate(self._media):
            for shift, places in enumerate(points):
                for place in places:
                    gain, error = straight_gains(link, aimed.intersector, medium, e, t, place)
                    gains[i, shift] += gain / len(places)
                    errors.append(error)
        return gains, max(errors)

    def _lamp_points(self, s: int) -> Floats:
        """Return random points of an extended source, shape (shifts, points, 3)."""
        # Order -1 has no vertices, and leaves room for 3 uniforms a point, of which 2 are used. The
        # key ends in 6, a purpose that no chains have: these points are independent of all chains.
        per_shift = max(self.photons // (_CHAINS_PER_POINT * SHIFTS), 2)
        u = shifted(*points_of(Request(s, -1, per_shift, (self.planner.seed, s, 0, 6))))
        emitter, size = self.arrays.emitters[s], self.arrays.sizes[s]
        # radius by inversion: uniform over the disk of a top-hat beam, else a Gaussian waist whose
        # irradiance falls as exp(-2 r^2 / size^2)
        if emitter.kind == SourceKind.TOP_HAT_BEAM:
            radius = size * np.sqrt(u[:, 0])
        else:
            radius = size * np.sqrt(-0.5 * np.log(u[:, 0]))
        e1, e2 = (np.array(e) for e in ends.across(emitter.axis))
        phi = 2.0 * math.pi * u[:, 1:2]
        circle = np.cos(phi) * e1 + np.sin(phi) * e2
        return (np.array(emitter.position) + radius[:, None] * circle).reshape(SHIFTS, -1, 3)

    def _tables(self, aimed: AimedChains) -> list[list[ArrivalTally]]:
        """Return tables of the arrivals of unscattered light and of chains, by wavelength."""
        tinting, links = self.planner.shared.tinting, self.planner.shared.links
        tables = [list[ArrivalTally]() for _ in links]
        for e, t in self.arrays.pairs if self.arrays.reflects else []:
            arrivals = parts.straight_light(self.arrays, e, t)
            gains, _ = self._straight_gains(aimed, e, t)
            for table, gain, link in zip(tables, gains, links, strict=True):
                if gain.any():
                    table.append(arrivals.table(self.arrays.receiver(e, t), gain.mean(), link))
        for e, t in self.arrays.pairs:
            for arrivals in self._arrivals(aimed, e, t, tinting.tints):
                # weights are those of the base wavelength, factors (wavelengths, rows) on them
                factors = tinting.factors(arrivals.log_weights)
                for table, factor, link in zip(tables, factors, links, strict=True):
                    table.append(arrivals.table(self.arrays.receiver(e, t), factor, link))
        return tables

    def _arrivals(
        self, aimed: AimedChains, e: int, t: int, tints: Tints | None
    ) -> Iterator[parts.Light]:
        """Yield the arrivals from emitter e at target t through facets, and by blocks of chains."""
        chained = self.method[self.arrays.receiver(e, t)] == "chains"
        sets = self.scattered_sets[e] if chained else []
        if self.arrays.sizes[e] > 0.0:
            n = self._source_gains(aimed, e, t)[0].shape[1]
            points = self._lamp_points(e)[:, :n]
            for shift, i in np.ndindex(SHIFTS, n):
                lamp = Vec3(*points[shift, i].tolist())
                gains = aimed.direct_gains(e, t, lamp) / (n * SHIFTS)
                yield parts.direct_light(aimed, e, t, gains, tints, lamp, shift)
        elif not aimed.sampled and (gains := aimed.direct_gains(e, t)).any():
            yield parts.direct_light(aimed, e, t, gains, tints)
        else:
            # sampled, or dark through facets: chains without scatterings may bring light
            sets = [self.unscattered()[e], *sets]
        for request, stored in sets:
            # numbers run on from request to request
            before = self._requests[: self._requests.index(request)]
            first = sum(earlier.number for earlier in before)
            for block in blocks_of(request, stored):
                chains = self.drawer.drawn(block)
                arrivals = parts.chain_light(aimed, e, t, chains, tints, block)
                yield arrivals._replace(sample=first + arrivals.sample)


def cut_share(case: Case, mesh: TriangleMesh) -> Floats:
    """Return the share of the light that would cross a flat sea outside a mesh, by receiver."""
    link = case.link
    # most meshes reach beyond all crossings and cut nothing off: no chains are drawn for them
    low, high = mesh.bounds[:, :2]
    # distances of the crossings from x = y = 0 towards -x, -y (first row) and towards +x, +y
    reach = ends.crossing_reach(link) + np.array(link.origin) * [[-1.0], [1.0]]
    if (low <= -reach[0]).all() and (high >= reach[1]).all():
        return np.zeros(len(link.receivers))
    sea = TypicalSea.of_meshes([mesh])
    planner = Planner(link, case.run.seed, case.meshing.normals, case.threads, sea)
    few = ForcedDetection.following(planner, planner.plan(_CUT_CHAINS, planner.compare()))
    within = flat_mesh(low, high)
    if planner.arrays.reflects:
        # the mesh cuts off what it mirrors, hardly what the water scatters between the ends
        whole = few.unscattered_gain(planner.flat())
        cut = whole - few.unscattered_gain(within)
    else:
        whole = few.at_wavelengths(planner.flat())[0].gain
        # the same chains over both: their noise cancels in the difference
        cut = whole - few.at_wavelengths(within)[0].gain
    return np.divide(cut, whole, out=np.zeros_like(whole), where=whole > 0.0)
