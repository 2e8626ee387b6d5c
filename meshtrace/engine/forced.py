"""Forced detection: scattering chains rotated to land on the aperture.

Everything random about a photon except its emission direction is drawn; then the directions
that land it on a random point x of the aperture are solved for. With K scatterings

    h_K = E[ |A| sum_{w: X_K(w) = x} I(w) W_K(w) / |det dX_K / dOmega(w)| ],   h = sum_K h_K.

K = 0 is deterministic (`chains.unscattered`); every K >= 1 has its own chains. The points are
randomly shifted Sobol points: the mean of each shift is an unbiased estimate of its own, and
the scatter of the shifts gives the standard error.

The chains do not depend on the surface: one set serves every frame of a moving sea.

Where chains are the worse estimator the scattered light is that of joined photons
(`meshtrace.engine.photons.joined`) or of analog ones (`meshtrace.engine.photons.arriving`). Light
that the surface reflects first, where it counts, and that of the bottom is always that of photons.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial
from operator import call
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import choice, parts
from meshtrace.engine.chains.aimed import AimedChains, SearchMode
from meshtrace.engine.chains.sets import (
    ChainDrawer,
    Drawing,
    Request,
    flat_mesh,
    levels,
    points_of,
    shifted,
)
from meshtrace.engine.photons.arriving import ArrivingPhotons, largest_weight
from meshtrace.engine.photons.joined import JoinedPhotons, PhotonParts
from meshtrace.engine.setup import ends
from meshtrace.engine.setup.options import Case
from meshtrace.engine.setup.tinting import UNTINTED, Common
from meshtrace.errors import Described, Refused
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.tints import Tints
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes
from meshtrace.models import Floats
from meshtrace.parallel import Pace, ordered_map
from meshtrace.results.tallies import ArrivalTally, error_of_groups
from meshtrace.stored import SHIFTS

Scattered = Literal["auto", "chains", "joined"]

MANY_SEAS = 1.5
"""Margin of a typical sea for those that are not known yet: they may be higher."""

_STILL_CHAINS = 8  # unscattered, of each shift, over still water
_MOST_CHAINS = 2**22  # some 10 s of a thread for each receiver
_CHAINS_PER_POINT = 32  # of an extended source, from which unscattered light is summed
_FEW_POINTS, _SMOOTH = 2, 5e-4  # of each shift, which suffice for this relative error
_CUT_CHAINS = 2048  # to estimate the share of the light that a mesh cuts off
_UNLIT = 0.03  # chains of an order over those of the order with most: its light is some 0.1 %
_PILOT_SEED = 2**63  # flips a bit of the seed: photons of pilots are none of a run
_FEWEST = 4 * SHIFTS  # chains of a run to a relative error, whose 32 groups must not be single ones
_UNSCATTERED_SHARE = 0.3  # chains without a scattering, over the scattered ones


class TypicalSea(NamedTuple):
    """Properties of all surfaces that forced detection needs before their meshes.

    Parameters
    ----------
    crest : float
        Height up to which collisions are expected [m]: about the highest crest of the surfaces.
        Unbiased for any value; a good one saves chains.
    unresolved : UnresolvedSlopes, optional
        Random slopes, with which the estimators are compared.
    """

    crest: float = 0.0
    unresolved: UnresolvedSlopes | None = None

    @classmethod
    def of(cls, meshes: Iterable[TriangleMesh], margin: float = 1.0) -> TypicalSea:
        """Return the typical sea of some surfaces, its crest by a margin above the highest."""
        found = [(float(mesh.bounds[1, 2]), mesh.unresolved) for mesh in meshes]
        return cls(margin * max(crest for crest, _ in found), found[0][1])


class ForcedDetection:
    """Gain of a link over any surface, by chains and photons.

    Parameters
    ----------
    link : Link
        The link; sources on the other side of the surface than the receivers.
    photons : int
        Chains in all. Joined photons are eight times as many where scattered light or that of the
        bottom rests on them, else twice, or fewer where the light that the surface reflects first
        is below 2 % of the gain: they take a tenth of the time. Common ones of several
        wavelengths are between, see `choice.choose_common`. Analog photons are 32 times as many.
    seed : int
        Seed of the points and their shifts.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; results do not depend on them.
    sea : TypicalSea
        What is known of the surfaces.
    search : {"usual", "thorough"}
        Search of crossings, see `AimedChains`.
    scattered : {"auto", "chains", "joined"}
        Estimator of the scattered light; "auto" compares pilots over still water, with random
        slopes, for each receiver, see `meshtrace.engine.choice`. With "chains" light that the
        surface reflects first is omitted.
    common : Common, optional
        The wavelengths for all of which chains are allotted to the orders, and estimators chosen.

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
        search: SearchMode = "usual",
        scattered: Scattered = "auto",
        common: Common | None = None,
    ) -> None:
        if not SHIFTS <= photons <= _MOST_CHAINS:
            allowed = f"an integer {SHIFTS} <= photons <= {_MOST_CHAINS} for forced detection"
            raise Refused("photons", photons, allowed)
        self.link = link
        self.arrays = ends.forced_link(link)
        self.photons, self.seed, self.normals, self.threads = photons, seed, normals, threads
        self.sea, self.search, self.wanted = sea, search, scattered
        self.common = common or Common(UNTINTED, [link], (1.0,))
        self.drawer = ChainDrawer(self.arrays, *levels(self.arrays, sea.crest), self.common.ratios)
        self._per_chain = choice.PER_CHAIN
        self.method: list[choice.Method] = ["joined"] * len(link.receivers)
        # receivers with pilots, and the number of those that each stands for
        self._piloted, self._number = np.unique(
            self.arrays.stands_for_receivers, return_counts=True
        )
        self._light: Floats | None = None  # of each receiver with a pilot, over still water
        self._pilot: choice.ScatteredPilot | None = None  # of its estimator, for each of these
        self._chained: list[choice.Pilot] = []  # by source
        orders = self._orders_of_chains()
        if orders is not None and scattered != "joined":
            compares = scattered == "auto" and any(orders)
            alone = Common(UNTINTED, [self.link], (1.0,))
            still, surfaces = self.flat(), list[ChainDrawer | AimedChains]([self.drawer])
            shared = self.common if self.common.tinting.follows else alone  # with common photons
            unresolved = sea.unresolved
            if compares and unresolved is not None and link.physics.unresolved == "tilt":
                # chains and joined photons are compared over still water with random slopes
                still = replace(still, unresolved=unresolved)
                surfaces.append(self.over(still).at_wavelengths(shared))
            found = self.pilots(surfaces, orders)
            self._chained, compared = found[0][0], found[-1]
            self._light = self._still_gain(self._chained)
            self.method = ["chains"] * len(link.receivers)
            base = 0 if len(compared) == 1 else int(np.argmax(shared.ratios))
            self._pilot = choice.chain_pilot(compared[base], self.arrays)
            doubtful = ~choice.is_clear(self._pilot)
            joined = self._pilot_photons(doubtful) if compares else None
            if joined is not None:
                light = (
                    joined.at_wavelengths(still, shared.tinting, shared.links)
                    if len(shared.links) > 1
                    else [joined.evaluate(still)]
                )
                if len(compared) < len(light):
                    (compared,) = self.pilots([self.over(still).at_wavelengths(shared)], orders)
                self._choose(compared, light, doubtful, self.expected * np.array(shared.ratios))
        elif scattered == "auto" and len(self.common.links) == 1:
            still = self.flat()
            if link.physics.unresolved == "tilt":
                still = replace(still, unresolved=sea.unresolved)
            joined = self._pilot_photons(np.ones(len(self._piloted), bool))
            if joined is not None:
                self._choose_photons(joined.evaluate(still))
        self._allot()

    def _choose_photons(self, joined: PhotonParts) -> None:
        """Choose between joined and analog photons where chains do not follow the link."""
        pilot, largest = choice.ScatteredPilot.of_photons(joined), largest_weight(self.link, 0.0)
        better = choice.prefer_analog(pilot, largest, ["joined"] * len(self._piloted))
        chosen = dict(zip(self._piloted.tolist(), better, strict=True))
        self.method = [chosen[r] for r in self.arrays.stands_for_receivers.tolist()]

    def _allot(self) -> None:
        """Allot the chains to the orders by the pilots; draw them, and set up the photons."""
        requests = self._requests(self._chained) if "chains" in self.method else []
        drawings = self.drawer.draw_all(requests, self.threads)
        self.scattered_sets = [
            [one for one in drawings if one.request.source == s]
            for s in range(len(self.arrays.emitters))
        ]
        self._unscattered: list[Drawing] = []  # drawn on demand
        self._arriving = self._arriving_photons()
        self._joined = self._joined_photons()

    def with_photons(self, photons: int) -> ForcedDetection:
        """Return another number of chains and photons by the same pilots."""
        found = copy(self)
        found.photons = photons
        found._allot()
        return found

    def photons_for(self, rtol: float, most: int) -> int:
        """Return a number of chains that pilots expect to reach a relative error, up to `most`.

        Pilots have random numbers of their own: their choice of the number biases nothing. Few
        Sobol points gain little over the independent ones of which these are.
        """
        if self._pilot is None or self._light is None:
            return most
        method = [self.method[r] for r in self._piloted]
        largest = largest_weight(self.link, 0.0)
        n = choice.samples_for(rtol, self._pilot, self._light, largest, method)
        return int(min(max(n, _FEWEST), most))

    def at_index(self, n: float, share: float) -> ForcedDetection:
        """Return a share of the chains and photons, the same ones, in water of another index.

        Orders of scattering without light, to which pilots allot few chains, are left out.
        """
        found = copy(self)
        found.link = self.link.replace("water.n", n)
        found.arrays = ends.forced_link(found.link)
        found.drawer = self.drawer.of_link(found.arrays)
        found.photons = max(round(share * self.photons), SHIFTS)
        found._unscattered = []
        found.scattered_sets = []
        for row in self.scattered_sets:
            requests = [drawing.request for drawing in row]
            most = max((one.per_shift for one in requests), default=0)
            requests = [one for one in requests if one.per_shift > _UNLIT * most]
            few = [one._replace(per_shift=max(round(share * one.per_shift), 2)) for one in requests]
            found.scattered_sets.append(found.drawer.draw_all(few, self.threads))
        if self._joined is not None:
            photons = max(round(share * self._joined.photons), SHIFTS)
            found._joined = self._joined.at_index(n, photons)
        return found

    def _orders_of_chains(self) -> list[int] | None:
        """Return the orders of the chains from each source, None if photons alone follow the link.

        Raises
        ------
        Refused
            If neither chains nor photons follow it.
        """
        try:
            ends.require_points(self.link)
            if self.link.water.bottom_depth is not None and not self._follows_bottom():
                ends.refuse_bottom(self.link)
            return [self.drawer.last_order(s) for s in range(len(self.arrays.emitters))]
        except Refused as refused:  # a feature, or too many orders, for chains
            if self.wanted == "chains":
                raise
            try:
                self._photons(SHIFTS, range(len(self.method)))
            except Refused:  # a form as published
                raise refused from None
        return None

    def _follows_bottom(self) -> bool:
        """Return whether joined photons may follow the light of the bottom."""
        try:
            return self.wanted != "chains" and bool(self._photons(SHIFTS, range(len(self.method))))
        except Refused:  # forms as published
            return False

    def pilots(
        self, surfaces: Sequence[ChainDrawer | AimedChains], orders: list[int]
    ) -> list[list[list[choice.Pilot]]]:
        """Return the pilots of the sources up to their orders, by surface and wavelength."""
        requests = [
            Request(s, k, choice.PILOT // SHIFTS, (*self._seed(s), k))
            for s, last in enumerate(orders)
            for k in range(1, last + 1)
        ]
        targets = np.unique(self.arrays.stands_for).tolist()
        job = partial(choice.pilot_statistics, self.drawer, surfaces, targets)
        rows = list(ordered_map(job, requests, self.threads))
        cuts, pilots = np.cumsum(orders)[:-1], list[list[list[choice.Pilot]]]()
        for k, over in enumerate(surfaces):
            shape = len(rows), over.wavelengths, 4, len(targets)
            table = np.reshape([row[k] for row in rows], shape).swapaxes(0, 1)
            parts_of = (np.split(one, cuts) for one in table)
            pilots.append([[choice.Pilot.of_orders(part) for part in row] for row in parts_of])
        return pilots

    def _pilot_photons(self, doubtful: NDArray[np.bool_]) -> JoinedPhotons | None:
        """Return the photons of a pilot, None if joined photons do not follow the link."""
        receivers = self._piloted[doubtful].tolist()
        try:
            if not receivers:
                return None
            photons = self._photons(choice.PILOT_PHOTONS, receivers)
        except Refused:
            return None
        photons.seed ^= _PILOT_SEED
        if self._chained and self.link.water.bottom_depth is not None:
            # chains are compared with the light that misses it
            photons.link = photons.link.replace("water.bottom_albedo", 0.0)
        return photons

    def _choose(
        self,
        pilots: list[list[choice.Pilot]],
        light: list[PhotonParts],
        doubtful: NDArray[np.bool_],
        expected: Floats,
    ) -> None:
        """Set the estimators of doubtful receivers and of the receivers represented by them."""
        chains = [choice.chain_pilot(row, self.arrays).of(doubtful) for row in pilots]
        photons = [choice.ScatteredPilot.of_photons(one) for one in light]
        better, self._per_chain = choice.choose_common(chains, photons, expected)
        if len(chains) == 1 and self._pilot is not None:
            # several wavelengths share the paths of chains and joined photons alone
            joined = np.array([method == "joined" for method in better])
            pairs = zip(photons[0], chains[0], strict=True)
            pilot = choice.ScatteredPilot(*(np.where(joined, *pair) for pair in pairs))
            for row, found in zip(self._pilot, pilot, strict=True):
                row[doubtful] = found
            better = choice.prefer_analog(pilot, largest_weight(self.link, 0.0), better)
        chosen = dict(zip(self._piloted[doubtful].tolist(), better, strict=True))
        first = self.arrays.stands_for_receivers.tolist()
        self.method = [chosen.get(r, "chains") for r in first]

    def _requests(self, pilots: list[choice.Pilot]) -> list[Request]:
        """Return the chains of each source and order, allotted by the pilots."""
        link, kept = self.arrays, np.array([self.method[r] == "chains" for r in self._piloted])
        photons, emitters = self.photons, len(link.emitters)
        # a common factor of the gain does not matter for one receiver
        together = len(kept) > 1 and not link.down
        light = self._light if together and self._light is not None else np.ones(len(kept))
        share = photons if link.down else max(photons // emitters, SHIFTS)
        requests = []
        for s, found in enumerate(pilots):
            number = self._number[kept]
            if not link.down:
                found, seen = found.of(kept), light[kept]
            elif kept[s]:
                found, seen, number = found.joined(link.power), light[s : s + 1], np.ones(1, int)
            else:
                continue
            if len(self.common.links) > 1 and self._light is not None:
                lit = self._light[s : s + 1] if link.down else self._light[kept]
                found, seen = found.at_wavelengths(np.array(self.common.ratios), lit)
                number = np.tile(number, len(self.common.ratios))
            counts = choice.allotment(share, self.drawer.nominals[s].expected, found, seen, number)
            key = self._seed(s)
            requests += [Request(s, k, int(n), (*key, k, 1)) for k, n in enumerate(counts, 1)]
        return requests

    def _seed(self, emitter: int) -> tuple[int, int]:
        """Return the seed of the chains of an emitter: receivers have the same in any order."""
        return self.seed, 0 if self.arrays.down else emitter

    def _still_gain(self, pilots: list[choice.Pilot]) -> Floats:
        """Return the gain of each receiver with a pilot over still water."""
        gain = np.array([found.mean.sum(axis=1) for found in pilots])
        targets = np.unique(self.arrays.stands_for).tolist()
        for s, row in enumerate(gain):
            request = Request(s, 0, _STILL_CHAINS, (*self._seed(s), 0, 3))
            unscattered = self.drawer.draw(request, targets)
            for i, t in enumerate(targets):
                row[i] += self.drawer.aim(s, t, unscattered).score.mean()
        return self.arrays.by_receiver(gain)

    @property
    def expected(self) -> float:
        """Largest expected number of scatterings between a source and the surface."""
        return max(law.expected for law in self.drawer.nominals)

    @cached_property
    def returned(self) -> Floats:
        """Estimated gain of light reflected first, of each receiver by that which stands for it."""
        found = choice.returned_gain(self._to(self._piloted))
        return found[np.searchsorted(self._piloted, self.arrays.stands_for_receivers)]

    @property
    def serves_neighbours(self) -> bool:
        """Whether its chains alone, of point sources, make the gain: `FrozenForced` keeps them."""
        return (
            self._joined is None and set(self.method) == {"chains"} and not any(self.arrays.sizes)
        )

    def _photons(self, photons: int, receivers: Iterable[int], first: int = 1) -> JoinedPhotons:
        """Return joined photons to some receivers; `first` applies where chains serve."""
        rows = list(receivers)
        link = self._to(rows)
        crossings = [1 if self.method[r] == "joined" else first for r in rows]
        return JoinedPhotons(link, photons, self.seed, self.normals, self.threads, first=crossings)

    def _to(self, receivers: Iterable[int]) -> Link:
        """Return the link to some receivers."""
        some = tuple(self.link.receivers[r] for r in receivers)
        return self.link.model_copy(update={"receiver": some})

    def _arriving_photons(self) -> ArrivingPhotons | None:
        """Return the analog photons, None where no receiver rests on them."""
        self._hit = [r for r, method in enumerate(self.method) if method == "analog"]
        photons = round(choice.ANALOG_PER_CHAIN * self.photons)
        how = photons, self.seed, self.normals, self.threads
        return ArrivingPhotons(self._to(self._hit), *how) if self._hit else None

    def _joined_photons(self) -> JoinedPhotons | None:
        """Return the joined photons of the light that chains omit; None if it is negligible."""
        every = [r for r, method in enumerate(self.method) if method != "analog"]
        rows = [r for r in every if self.method[r] == "joined"]
        self.reflects = self.wanted != "chains" and self.link.physics.reflected == "trace"
        water = self.link.water
        if every and water.bottom_depth is not None and water.bottom_albedo > 0.0:
            self._served = every
            return self._photons(round(choice.PER_CHAIN * self.photons), every, first=2)
        self._served = every if self.reflects else rows
        per_chain = self._per_chain if rows else choice.REFLECTED_PER_CHAIN
        if self.reflects and len(rows) < len(every) and self._light is not None:
            # light that the surface reflects first may be too little to be measured
            returned = self.returned[self._piloted]
            counted = choice.counts(returned, self._light)
            lit = set(self._piloted[counted].tolist())
            first = self.arrays.stands_for_receivers.tolist()
            self._served = [r for r in every if first[r] in lit or self.method[r] == "joined"]
            if lit and not rows:
                share = float((returned[counted] / self._light[counted]).max())
                per_chain *= min(share / choice.MUCH, 1.0)
        self.reflects = self.reflects and bool(self._served or self._hit)
        photons = max(round(per_chain * self.photons), SHIFTS)
        try:
            return self._photons(photons, self._served, first=2) if self._served else None
        except Refused:  # forms as published, which chains follow
            if rows:
                raise
            self.reflects = False
            return None

    def over(self, mesh: TriangleMesh) -> AimedChains:
        """Return the chains aimed over a mesh.

        Raises
        ------
        Refused
            If the mesh overhangs.
        """
        ends.require_height_field(mesh)
        normals, unresolved = self.normals, self.link.physics.unresolved
        return AimedChains(self.arrays, mesh, normals, unresolved, self.search)

    def sets(self, unscattered: bool) -> list[list[Drawing]]:
        """Return the chains by source, on demand with unscattered ones."""
        if not unscattered:
            return self.scattered_sets
        pairs = zip(self.unscattered(), self.scattered_sets, strict=True)
        return [[first, *row] for first, row in pairs]

    def unscattered(self) -> list[Drawing]:
        """Return unscattered chains by source, which differ by their random slopes only."""
        if self._unscattered:
            return self._unscattered
        emitters = len(self.arrays.emitters)
        per_source = self.photons / (1 if self.arrays.down else emitters)
        n = max(math.ceil(_UNSCATTERED_SHARE * per_source / SHIFTS), 2)
        requests = [Request(s, 0, n, (*self._seed(s), 0, 1)) for s in range(emitters)]
        self._unscattered = self.drawer.draw_all(requests)
        return self._unscattered

    def evaluate(self, mesh: TriangleMesh) -> parts.Parts:
        """Return the gain over a mesh, in parts."""
        return self.at_wavelengths(mesh)[0]

    def at_wavelengths(
        self, mesh: TriangleMesh, over: AimedChains | None = None
    ) -> list[parts.Parts]:
        """Return the gains over a mesh at the wavelengths of common paths.

        `over` is the mesh with the receivers of a link that differs in the water alone.
        Where facets bring no light, chains without scatterings are asked before a pair is dark.
        """
        higher = self._reaching(mesh)
        if higher is not self:
            return higher.at_wavelengths(mesh, over)
        link, common = self.arrays, self.common
        aimed = self.over(mesh) if over is None else over.of_link(link)
        aimed = aimed.at_wavelengths(common)
        sums = parts.ChainSums(link, self.method, self.scattered_sets, aimed.wavelengths)
        lit, dark = list[tuple[int, int]](), list[tuple[int, int]]()
        for s, r in link.pairs:
            (dark if aimed.sampled and link.sizes[s] == 0.0 else lit).append((s, r))
        alone = not any(self.scattered_sets) and self._joined is None
        jobs: list[Any] = [partial(self._unscattered_light, aimed, *pair) for pair in lit]
        jobs += [partial(self._summed, aimed, job) for job in sums.jobs]
        found = ordered_map(call, jobs, self.threads, ahead=len(jobs))
        for s, r in lit:
            from_points, error = next(found)
            gain = from_points.mean(axis=1).T
            in_shifts = alone or aimed.meets_rim(s, r)
            quadrature = parts.QuadratureError(error, in_shifts, aimed.is_cut_short(s, r))
            sums.add_direct(s, r, gain, quadrature)
            if gain.shape[-1] == 1 and not gain.any():
                dark.append((s, r))
        pace = Pace(len(sums.jobs), f"{sums.chains:,} chains over one surface")
        for job, rows in zip(sums.jobs, found, strict=True):
            sums.add(job, rows)
            pace.add()
        rest = parts.chain_jobs(dark, [[one] for one in self.unscattered()] if dark else [])
        found = ordered_map(partial(self._summed, aimed), rest, self.threads)
        for job, rows in zip(rest, found, strict=True):
            sums.add(job, rows)
        light = list[list[PhotonParts]]([[] for _ in range(aimed.wavelengths)])
        if self._joined is not None:
            found_light = (
                self._joined.at_wavelengths(mesh, common.tinting, common.links)
                if aimed.wavelengths > 1
                else [self._joined.evaluate(mesh)]
            )
            for row, one in zip(light, found_light, strict=True):
                row.append(one.among(len(self.method), self._served))
        if self._arriving is not None:
            light[0].append(self._arriving.evaluate(mesh).among(len(self.method), self._hit))
        return [sums.parts(i, aimed.counters, row, self.reflects) for i, row in enumerate(light)]

    def _summed(self, aimed: AimedChains, job: parts.ChainJob) -> list[parts.BlockSums]:
        """Return the sums over the chains of a block to each of its targets."""
        targets, block = job
        chains, found = self.drawer.drawn(block), dict[int, parts.BlockSums]()
        for some in aimed.together(targets, chains):
            score = aimed.aim(block.request.source, some, chains).score
            for target, row in zip(some, np.split(score, len(some), axis=-1), strict=True):
                found[target] = parts.block_sums(row, block)
        return [found[target] for target in targets]

    def _unscattered_light(self, aimed: AimedChains, s: int, r: int) -> tuple[Floats, float]:
        """Return `_from_source`, and the relative error of its quadrature over the surface."""
        return self._from_source(aimed, s, r), aimed.relative_error(s, r)

    def _from_source(self, aimed: AimedChains, s: int, r: int) -> Floats:
        """Return the unscattered light of the points of a source, (shifts, points, wavelengths).

        For an extended one, from the first points of each shift, and from all unless these
        suffice; else (1, 1, wavelengths).
        """
        if self.arrays.sizes[s] == 0.0:
            return aimed.direct_light(s, r)[None, None]
        if aimed.sampled:
            narrow = Described(f"a radius of {self.arrays.sizes[s] * self.arrays.frame.unit:g} m")
            allowed = f"a point source below random slopes this narrow; {ends.ANALOG}"
            raise Refused("transmitter", narrow, allowed)
        points = self._lamp_points(s)
        found: Floats = np.zeros((SHIFTS, 0, aimed.wavelengths))
        for some in (points[:, :_FEW_POINTS], points[:, _FEW_POINTS:]):
            if not some.size:
                break
            row = []
            for p in some.reshape(-1, 3):
                row.append(aimed.direct_light(s, r, Vec3(*p.tolist())))
            found = np.concatenate([found, np.reshape(row, (*some.shape[:2], -1))], axis=1)
            error = error_of_groups(found.mean(axis=1))
            if (error < _SMOOTH * found.mean(axis=(0, 1))).all():
                break
        return found

    def _lamp_points(self, s: int) -> Floats:
        """Return points of an extended source, shape (shifts, points, 3)."""
        per_shift = max(self.photons // (_CHAINS_PER_POINT * SHIFTS), 2)
        u = shifted(*points_of(Request(s, -1, per_shift, (self.seed, s, 0, 6))))
        emitter, size = self.arrays.emitters[s], self.arrays.sizes[s]
        if emitter.kind == SourceKind.TOP_HAT_BEAM:
            radius = size * np.sqrt(u[:, 0])
        else:
            radius = size * np.sqrt(-0.5 * np.log(u[:, 0]))
        e1, e2 = (np.array(e) for e in ends.across(emitter.axis))
        phi = 2.0 * math.pi * u[:, 1:2]
        circle = np.cos(phi) * e1 + np.sin(phi) * e2
        return (np.array(emitter.position) + radius[:, None] * circle).reshape(SHIFTS, -1, 3)

    def _reaching(self, mesh: TriangleMesh) -> ForcedDetection:
        """Return chains that reach the mesh; new ones if it is far higher than expected."""
        top = float(mesh.bounds[1, 2])
        if top <= self.drawer.ceiling * self.arrays.frame.unit or "chains" not in self.method:
            return self
        sea = self.sea._replace(crest=top)
        return ForcedDetection(
            self.link, self.photons, self.seed, self.normals, self.threads, sea,
            self.search, self.wanted, self.common,
        )  # fmt: skip

    def flat(self) -> TriangleMesh:
        """Return a flat sea larger than the footprint of the light."""
        far = ends.crossing_reach(self.link) + 10.0 * self.arrays.frame.unit
        origin = np.array(self.link.origin)
        return flat_mesh(origin - far, origin + far)

    def arrivals(self, mesh: TriangleMesh) -> ArrivalTally:
        """Return the light that arrives; the weights of a receiver add up to its gain.

        Unscattered light without random slopes is one arrival a facet, with shift -1: it has no
        Monte Carlo error.
        """
        return self.arrivals_at_wavelengths(mesh)[0]

    def arrivals_at_wavelengths(self, mesh: TriangleMesh) -> list[ArrivalTally]:
        """Return the light that arrives at the wavelengths of common paths."""
        higher = self._reaching(mesh)
        if higher is not self:
            return higher.arrivals_at_wavelengths(mesh)
        tinting, links = self.common.tinting, self.common.links
        aimed, rows = self.over(mesh), [list[Floats]() for _ in links]
        for e, t in self.arrays.pairs:
            light = self._light_of(aimed, e, t, tinting.tints)
            receiver = np.full(len(light.weight), self.arrays.receiver(e, t))
            path = light.water, light.air, light.shift, light.angle
            for row, factor in zip(rows, tinting.factors(light.tint), strict=True):
                row.append(np.column_stack([receiver, light.weight * factor, *path]))
        if self._joined is not None:
            photons = self._joined.at_wavelengths(mesh, tinting, links, arrivals=True)
            for row, found in zip(rows, photons, strict=True):
                row += _of_photons(self._served, found)
        if self._arriving is not None:
            rows[0] += _of_photons(self._hit, self._arriving.evaluate(mesh, arrivals=True))
        return [ArrivalTally.of_rows(np.concatenate(row)) for row in rows]

    def _light_of(self, aimed: AimedChains, e: int, t: int, tints: Tints | None) -> parts.Light:
        """Return the light of a pair over facets and chains."""
        chained = self.method[self.arrays.receiver(e, t)] == "chains"
        rows, sets = list[parts.Light](), self.scattered_sets[e] if chained else []
        if self.arrays.sizes[e] > 0.0:
            n = self._from_source(aimed, e, t).shape[1]
            points = self._lamp_points(e)[:, :n]
            for shift, i in np.ndindex(SHIFTS, n):
                lamp = Vec3(*points[shift, i].tolist())
                gains = aimed.direct_gains(e, t, lamp) / (n * SHIFTS)
                rows.append(parts.direct_light(aimed, e, t, gains, tints, lamp, shift))
        elif not aimed.sampled and (found := aimed.direct_gains(e, t)).any():
            rows.append(parts.direct_light(aimed, e, t, found, tints))
        else:
            sets = [self.unscattered()[e], *sets]
        for drawing in sets:
            for block in drawing.blocks():
                chains = self.drawer.drawn(block)
                rows.append(parts.chain_light(aimed, e, t, chains, tints, block))
        return parts.merged(rows)


def _of_photons(receivers: list[int], found: PhotonParts) -> list[Floats]:
    """Return the arrivals of photons at some receivers, as rows of an `ArrivalTally`."""
    rows = []
    for r, light in zip(receivers, found.arrivals or [], strict=True):
        angle = np.full((len(light), 1), np.nan)  # not known
        rows.append(np.concatenate([np.full((len(light), 1), r), light, angle], axis=1))
    return rows


def cut_share(case: Case, mesh: TriangleMesh) -> Floats:
    """Return the share of the light of a flat sea that crosses outside a mesh, by receiver."""
    link = case.link
    low, high = mesh.bounds[:, :2]
    reach = ends.crossing_reach(link) + np.array(link.origin) * [[-1.0], [1.0]]
    if (low <= -reach[0]).all() and (high >= reach[1]).all():
        return np.zeros(len(link.receivers))
    few = ForcedDetection(link, _CUT_CHAINS, **case.how, sea=TypicalSea.of([mesh]))
    whole = few.at_wavelengths(few.flat())[0].gain
    cut = whole - few.at_wavelengths(flat_mesh(low, high))[0].gain
    return np.divide(cut, whole, out=np.zeros_like(whole), where=whole > 0.0)
