"""Plan the computation of a gain: the estimator for each receiver, and the numbers of samples.

1. Pilot chains of each order of scattering are aimed at each receiver over still water.
2. Where few of them carry most of the light, they are compared with pilots of photons.
3. Chains are allotted to the orders by their pilots (Neyman's allocation).
4. Joined photons follow light that the surface reflects first, unless a closed-form estimate shows
   it to be negligible, and always follow light off the bottom.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import choice
from meshtrace.engine.chains.aimed import AimedChains, SearchMode
from meshtrace.engine.chains.sets import ChainDrawer, Request, flat_mesh, levels
from meshtrace.engine.gains import Method
from meshtrace.engine.photons.arriving import largest_weight
from meshtrace.engine.photons.joined import JoinedPhotons
from meshtrace.engine.setup import ends
from meshtrace.engine.setup.tinting import CommonPaths, paths_alone
from meshtrace.errors import Refused
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.stored import SHIFTS

Scattered = Literal["auto", "chains", "joined"]

_STILL_CHAINS = 8  # chains without scatterings of each shift, for the gain over still water
_PILOT_SEED = 2**63  # flips a bit of the seed: photons of pilots are independent of those of a run
_MOST_CHAINS = 2**22  # some 10 s of a thread for each receiver
# Least number of chains for a tolerance. The error is the scatter of `SHIFTS` groups, and groups of
# a single chain would gain nothing from Sobol points.
_FEWEST = 4 * SHIFTS


class TypicalSea(NamedTuple):
    """Properties of the surfaces that forced detection needs before it knows their meshes.

    Parameters
    ----------
    crest : float
        Height up to which collisions are expected [m]: about the highest crest of the surfaces.
        Results are unbiased for any value, but take fewer chains with a good one.
    unresolved : UnresolvedSlopes, optional
        Random slopes of the still water over which estimators are compared.
    """

    crest: float = 0.0
    unresolved: UnresolvedSlopes | None = None

    @classmethod
    def of_meshes(cls, meshes: Iterable[TriangleMesh], margin: float = 1.0) -> TypicalSea:
        """Return the typical sea of meshes, with `margin` times their highest crest."""
        # random slopes follow from the spectrum: they are alike for all surfaces of a sea
        crests, slopes = zip(*((float(m.bounds[1, 2]), m.unresolved) for m in meshes), strict=True)
        return cls(margin * max(crests), slopes[0])


@dataclass(frozen=True)
class Comparison:
    """Estimators chosen by pilots, independent of the number of samples.

    Attributes
    ----------
    method : list of {"chains", "joined", "analog"}
        Estimator of the scattered light of each receiver.
    per_chain : float
        Number of joined photons in place of a chain.
    chained : list of choice.Pilot
        Pilot chains by source; empty where only photons follow the link.
    still_gain : ndarray or None, shape (receivers with a pilot,)
        Gain over still water.
    pilot : choice.ScatteredPilot or None
        Statistics of the chosen estimator, for the same receivers.
    """

    method: list[Method]
    per_chain: float = choice.PER_CHAIN
    chained: list[choice.Pilot] = field(default_factory=list)
    still_gain: Floats | None = None
    pilot: choice.ScatteredPilot | None = None


@dataclass(frozen=True)
class Plan:
    """Estimators and numbers of samples for the gain of a link.

    Attributes
    ----------
    photons : int
        Number of samples that was asked for: of chains, where these serve.
    method : list of {"chains", "joined", "analog"}
        Estimator of the scattered light of each receiver.
    chains : list of Request
        Chains by source and order.
    joined : JoinedPhotons or None
        Joined photons, None if no receiver needs them.
    joined_to : list of int
        Receivers that they serve.
    reflects : bool
        Whether photons follow light that the surface reflects first.
    """

    photons: int
    method: list[Method]
    chains: list[Request]
    joined: JoinedPhotons | None
    joined_to: list[int]
    reflects: bool


@dataclass
class Planner:
    """Planner of the estimators and samples of a link.

    Parameters are those of `ForcedDetection`, with `search` of `AimedChains` and `wavelengths`, the
    paths that several wavelengths share.
    """

    link: Link
    seed: int
    normals: str = "vertex"
    threads: int = 1
    sea: TypicalSea = TypicalSea()  # noqa: RUF009 - frozen
    search: SearchMode = "usual"
    scattered: Scattered = "auto"
    wavelengths: CommonPaths | None = None

    def __post_init__(self) -> None:
        self.arrays = ends.forced_link(self.link)
        self.shared = self.wavelengths or paths_alone(self.link)
        self.drawer = ChainDrawer(
            self.arrays, *levels(self.arrays, self.sea.crest), self.shared.ratios
        )
        # Of receivers close to each other one has pilots, for all of them: `_first` (receivers,) is
        # its index, `_piloted` has the indices of receivers with pilots, and `_number` how many
        # receivers each of these stands for. `_targets` are the targets that pilots aim at.
        self._first = self.arrays.stands_for_receivers
        self._piloted, self._number = np.unique(self._first, return_counts=True)
        self._targets: list[int] = np.unique(self.arrays.stands_for).tolist()
        # key of the chains from each emitter: receivers of a downlink share one, so that results
        # do not depend on their order
        down, sources = self.arrays.down, range(len(self.arrays.emitters))
        self.keys = [(self.seed, 0 if down else s) for s in sources]

    def at_index(self, n: float) -> Planner:
        """Return a planner for water of another index, with chains of the same random numbers."""
        # with the same laws and keys chains are neighbours, whose noise cancels in differences
        planner = copy(self)
        planner.link = self.link.replace("water.n", n)
        planner.arrays = ends.forced_link(planner.link)
        planner.drawer = self.drawer.of_link(planner.arrays)
        return planner

    def plan(self, photons: int, comparison: Comparison) -> Plan:
        """Return the plan for a total number of chains by a comparison of estimators.

        Raises
        ------
        Refused
            If there would be too few or too many of them.
        """
        if not SHIFTS <= photons <= _MOST_CHAINS:
            allowed = f"an integer {SHIFTS} <= photons <= {_MOST_CHAINS} for forced detection"
            raise Refused("photons", photons, allowed)
        method = comparison.method
        chains = self._allot(photons, comparison) if "chains" in method else []
        joined, joined_to, reflects = self._plan_joined(photons, comparison)
        # only photons follow light that the surface reflects first
        reflects = reflects and bool(joined_to or "analog" in method)
        return Plan(photons, method, chains, joined, joined_to, reflects)

    def photons_for(self, rtol: float, most: int, comparison: Comparison) -> int:
        """Return the number of chains that a relative error needs by the pilots, at most `most`.

        Pilots and runs have independent random numbers, so that the choice biases nothing. The
        variance of pilots is that of independent points, which is about right for few Sobol points.
        """
        pilot, gain = comparison.pilot, comparison.still_gain
        if pilot is None or gain is None:
            return most
        method = [comparison.method[r] for r in self._piloted]
        n = choice.samples_for(rtol, pilot, gain, self._largest_score, method)
        return int(min(max(n, _FEWEST), most))

    def compare(self) -> Comparison:
        """Choose the estimators by pilots over still water."""
        # where chains do not follow the link, joined photons are compared with analog ones alone
        orders = self._orders()
        if orders is None or self.scattered == "joined":
            every = np.ones(len(self._piloted), bool)
            method: list[Method] = ["joined"] * len(self._piloted)
            # analog photons follow one wavelength, and hardly hit what lies on their own side
            analog = self.scattered == "auto" and len(self.shared.links) == 1
            analog = analog and not self.arrays.reflects
            photons = self._pilot_photons(every, []) if analog else None
            if photons is not None:
                gains = photons.evaluate(self._still_water())
                pilot = choice.ScatteredPilot.of_photons(gains)
                method = choice.prefer_analog(pilot, self._largest_score, method)
            return Comparison(self._by_receiver(every, method, "joined"))
        compares = self.scattered == "auto" and any(orders)
        still, shared = self._still_water(), self.shared
        if not shared.tinting.follows:  # wavelengths cannot share photons: compare at the base
            shared = paths_alone(self.link)
        surfaces: list[ChainDrawer | AimedChains] = [self.drawer]
        if compares and still.unresolved is not None:
            # Chains are worst where random slopes are wider than a beam: estimators are compared
            # over such slopes. Chains are still allotted to the orders by pilots over smooth water.
            surfaces.append(self.aim_over(still).at_wavelengths(shared))
        pilots = self.pilots(surfaces, orders)
        # smooth still water at the wavelength of the base, and the last surface at all wavelengths
        chained, compared = pilots[0][0], pilots[-1]
        # the wavelength that scatters most is the hardest one for chains
        most = 0 if len(compared) == 1 else int(np.argmax(shared.ratios))
        pilot = choice.chain_pilot(compared[most], self.arrays)
        names: list[Method] = ["chains"] * len(self.link.receivers)
        chains = Comparison(names, choice.PER_CHAIN, chained, self._still_gain(chained), pilot)
        # photons are tried where few chains carry most of the light, or none bring any
        doubtful = ~choice.is_clear(pilot)
        joined = self._pilot_photons(doubtful, chained) if compares else None
        if joined is None:
            return chains
        by_photons = [
            choice.ScatteredPilot.of_photons(gains)
            for gains in joined.at_wavelengths(still, shared.tinting, shared.links)
        ]
        if len(compared) < len(by_photons):
            # pilots over the still water of the drawer have one wavelength alone
            (compared,) = self.pilots([self.aim_over(still).at_wavelengths(shared)], orders)
        by_chains = [choice.chain_pilot(p, self.arrays).select(doubtful) for p in compared]
        return self._choose(chains, by_chains, by_photons, doubtful, shared)

    def _choose(
        self,
        chains: Comparison,
        by_chains: list[choice.ScatteredPilot],
        by_photons: list[choice.ScatteredPilot],
        doubtful: NDArray[np.bool_],
        shared: CommonPaths,
    ) -> Comparison:
        """Return the comparison with the better estimators of doubtful receivers.

        `doubtful` is a mask of the receivers with pilots; receivers that these stand for follow.
        Pilots are lists by wavelength.
        """
        # scatterings expected on the way by wavelength, for the source that expects most
        expected = max(law.expected for law in self.drawer.nominals) * np.array(shared.ratios)
        better, per_chain = choice.choose_common(by_chains, by_photons, expected, self._turn)
        pilot = chains.pilot
        if len(by_chains) == 1 and pilot is not None:
            # analog photons compete at a single wavelength only: several share the paths of chains
            # and joined photons alone
            joined = np.array([method == "joined" for method in better])
            pairs = zip(by_photons[0], by_chains[0], strict=True)
            chosen = choice.ScatteredPilot(*(np.where(joined, *pair) for pair in pairs))
            pilot = choice.ScatteredPilot(*(column.copy() for column in pilot))
            for column, values in zip(pilot, chosen, strict=True):
                column[doubtful] = values
            better = choice.prefer_analog(chosen, self._largest_score, better)
        method = self._by_receiver(doubtful, better, "chains")
        return replace(chains, method=method, per_chain=per_chain, pilot=pilot)

    def _by_receiver(
        self, piloted: NDArray[np.bool_], method: list[Method], default: Method
    ) -> list[Method]:
        """Extend the estimators of the piloted (masked) receivers to all receivers."""
        chosen = dict(zip(self._piloted[piloted].tolist(), method, strict=True))
        return [chosen.get(r, default) for r in self._first.tolist()]

    def _orders(self) -> list[int] | None:
        """Return the highest order of chains by source, None if only photons follow the link.

        Raises
        ------
        Refused
            If neither chains nor photons follow it.
        """
        # light off the bottom needs joined photons, which do not follow published forms of physics
        try:
            ends.require_chains(self.link)
            if self.link.water.bottom_depth is not None and not self._photons_follow():
                depth = self.link.water.bottom_depth
                raise Refused("water.bottom_depth", depth, ends.POINTS_ONLY)
            return [self.drawer.last_order(s) for s in range(len(self.arrays.emitters))]
        except Refused:  # chains do not follow a feature, or would need too many orders
            if not self._photons_follow():
                raise
        return None

    def _photons_follow(self) -> bool:
        """Return whether joined photons may follow the link, without published forms of physics."""
        try:
            self._joined(SHIFTS, range(len(self.link.receivers)))
        except Refused:
            return False
        return self.scattered != "chains"

    def pilots(
        self, surfaces: Sequence[ChainDrawer | AimedChains], orders: list[int]
    ) -> list[list[list[choice.Pilot]]]:
        """Return the pilots of the sources up to their orders, by surface and wavelength."""
        requests = [
            Request(s, k, choice.PILOT // SHIFTS, (*self.keys[s], k))
            for s, last in enumerate(orders)
            for k in range(1, last + 1)
        ]
        job = partial(choice.pilot_statistics, self.drawer, surfaces, self._targets)
        statistics = list(ordered_map(job, requests, self.threads))
        cuts, pilots = np.cumsum(orders)[:-1], list[list[list[choice.Pilot]]]()
        for k, surface in enumerate(surfaces):
            shape = len(statistics), surface.wavelengths, 4, len(self._targets)
            # by wavelength, then source and order: split where the orders of a source end
            table = np.reshape([row[k] for row in statistics], shape).swapaxes(0, 1)
            by_source = (np.split(part, cuts) for part in table)
            pilots.append([[p.transpose(1, 2, 0) for p in parts] for parts in by_source])
        return pilots

    def _pilot_photons(
        self, doubtful: NDArray[np.bool_], chained: list[choice.Pilot]
    ) -> JoinedPhotons | None:
        """Return the joined photons of a pilot, None if none are needed or possible."""
        if not doubtful.any() or not self._photons_follow():
            return None
        expected = max(law.expected for law in self.drawer.nominals)
        number = choice.pilot_photons(expected, self._turn, len(self.shared.links))
        photons = self._joined(number, self._piloted[doubtful].tolist())
        # a choice by the photons of the run itself would bias it
        photons.seed ^= _PILOT_SEED
        if chained and self.link.water.bottom_depth is not None:
            # compared with chains, which omit light off the bottom
            photons.link = photons.link.replace("water.bottom_albedo", 0.0)
        return photons

    def _still_gain(self, pilots: list[choice.Pilot]) -> Floats:
        """Return the gain of each receiver with a pilot over still water."""
        gain = np.array([mean.sum(axis=1) for _, mean, _, _ in pilots])
        for s, to_targets in enumerate(gain):
            # deterministic over still water but for the random point of the aperture: few suffice
            request = Request(s, 0, _STILL_CHAINS, (*self.keys[s], 0, 3))
            unscattered = self.drawer.draw(request, self._targets)
            for i, t in enumerate(self._targets):
                score, _ = self.drawer.aim(s, t, unscattered)
                to_targets[i] += score.mean()
        return self.arrays.by_receiver(gain)

    def _allot(self, photons: int, comparison: Comparison) -> list[Request]:
        """Return the chains of each source and order, allotted by the pilots."""
        link, emitters = self.arrays, len(self.arrays.emitters)
        served = np.array([comparison.method[r] == "chains" for r in self._piloted])
        # the gain weights errors of receivers against each other: one receiver does not need it
        together = len(served) > 1 and not link.down
        known = comparison.still_gain
        gain = known if together and known is not None else np.ones(len(served))
        # chains start at the sources of an uplink, and each source serves all receivers; those of
        # a downlink start at the receivers, each of which has its own
        share = photons if link.down else max(photons // emitters, SHIFTS)
        requests = []
        for s, (_, mean, spread, _) in enumerate(comparison.chained):
            # a pilot counts as often as receivers stand behind it
            number, scale = self._number[served], gain[served]
            if not link.down:
                mean, spread = mean[served], spread[served]
            elif served[s]:
                # the targets are lamps, which share all chains: the deviation of the sum is at most
                # the sum of deviations
                mean, spread = (link.power @ mean)[None], (link.power @ spread)[None]
                number, scale = np.ones(1, int), gain[s : s + 1]
            else:
                continue
            # all wavelengths share one set of chains: each counts as a further receiver
            if len(self.shared.links) > 1 and known is not None:
                bright = known[s : s + 1] if link.down else known[served]
                ratios = np.array(self.shared.ratios)
                spread, scale = choice.at_wavelengths(mean, spread, ratios, bright)
                number = np.tile(number, len(ratios))
            expected = self.drawer.nominals[s].expected
            counts = choice.allotment(share, expected, spread, scale, number)
            requests += [
                # keys end in a purpose: 1 for the chains of a run, from 2 on for pilots
                Request(s, k, int(n), (*self.keys[s], k, 1))
                for k, n in enumerate(counts, 1)
            ]
        return requests

    def _plan_joined(
        self, photons: int, comparison: Comparison
    ) -> tuple[JoinedPhotons | None, list[int], bool]:
        """Return the joined photons, the receivers that they serve, and `reflects` of the plan.

        They follow scattered light where chains do not, and light that chains omit: that which the
        surface reflects first, unless it is negligible, and that of the bottom.
        """
        method, per_chain = comparison.method, comparison.per_chain
        every = [r for r, name in enumerate(method) if name != "analog"]
        joined = [r for r in every if method[r] == "joined"]
        reflects = self.scattered != "chains" and self.link.physics.reflected == "trace"
        # between ends on one side all unscattered light is reflected first, and has its own part
        reflects = reflects and not self.arrays.reflects
        water, gain = self.link.water, comparison.still_gain
        # where chains serve they bring all light of first crossings: photons score from the second
        crossings = [1 if name == "joined" else 2 for name in method]
        if every and water.bottom_depth is not None and water.bottom_albedo > 0.0:
            # light off the bottom has no closed-form estimate: all get the full number of photons
            number = round(choice.PER_CHAIN * photons)
            return self._joined(number, every, crossings), every, reflects
        served, fewest = every if reflects else joined, math.inf
        per_chain = per_chain if joined else choice.REFLECTED_PER_CHAIN
        if reflects and len(joined) < len(every) and gain is not None:
            # light that the surface reflects first may be too little to be worth photons
            returned = self.returned[self._piloted]
            counted = choice.exceeds(returned, gain, choice.MEASURED)
            bright = set(self._piloted[counted].tolist())
            first = self._first.tolist()
            served = [r for r in every if first[r] in bright or method[r] == "joined"]
            if bright and not joined:
                share = float((returned[counted] / gain[counted]).max())
                per_chain *= min(share / choice.MUCH, 1.0)
                if comparison.pilot is not None:
                    variance = comparison.pilot.variance[counted]
                    fewest = choice.reflected_per_chain(returned[counted], variance)
        if not served:
            return None, [], reflects
        # a part of a gain that has small errors beside those of the chains needs no more photons
        enough = max(min(fewest, per_chain) * photons, choice.FEWEST_REFLECTED)
        try:
            number = max(round(min(per_chain * photons, enough)), SHIFTS)
            return self._joined(number, served, crossings), served, reflects
        except Refused:  # published forms of physics, which chains alone follow
            if joined:
                raise
            return None, [], False

    def _joined(
        self, photons: int, receivers: Sequence[int], crossings: Sequence[int] = ()
    ) -> JoinedPhotons:
        """Return joined photons to `receivers`, which score from the given crossing on.

        `crossings` (all receivers of the link,) are 1 by default, 2 for reflected light alone.
        """
        link = self.link_to(receivers)
        first = [crossings[r] if crossings else 1 for r in receivers]
        return JoinedPhotons(link, photons, self.seed, self.normals, self.threads, first=first)

    def link_to(self, receivers: Iterable[int]) -> Link:
        """Return the link reduced to `receivers`."""
        ends_of = tuple(self.link.receivers[r] for r in receivers)
        return self.link.model_copy(update={"receiver": ends_of})

    @property
    def _turn(self) -> float:
        """1 - g, the number of isotropic scatterings equivalent to one."""
        return 1.0 - self.link.water.phase.mean_cosine

    @cached_property
    def _largest_score(self) -> float:
        """Largest score that an analog photon can have over still water."""
        return largest_weight(self.link, 0.0)

    @cached_property
    def returned(self) -> Floats:
        """Estimated gain (receivers,) of light reflected first, by the receivers with pilots."""
        gain = choice.returned_gain(self.link_to(self._piloted))
        return gain[np.searchsorted(self._piloted, self._first)]

    def aim_over(self, mesh: TriangleMesh) -> AimedChains:
        """Return the chains aimed over a mesh.

        Raises
        ------
        Refused
            If the mesh overhangs.
        """
        ends.require_height_field(mesh)
        unresolved = self.link.physics.unresolved
        return AimedChains(self.arrays, mesh, self.normals, unresolved, self.search)

    def flat(self) -> TriangleMesh:
        """Return a flat sea larger than the footprint of the light."""
        # a margin of ten units of length, so that no slanted light passes beside the rim; tuned
        far = ends.crossing_reach(self.link) + 10.0 * self.arrays.frame.unit
        origin = np.array(self.link.origin)
        return flat_mesh(origin - far, origin + far)

    def _still_water(self) -> TriangleMesh:
        """Return a flat sea, with the random slopes of the sea if the physics has them."""
        tilts = self.link.physics.unresolved == "tilt"
        return replace(self.flat(), unresolved=self.sea.unresolved) if tilts else self.flat()
