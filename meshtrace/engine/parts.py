"""Arrivals of unscattered light and of scattering chains at receivers, one row each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.chains.aimed import AimedChains, on_disk
from meshtrace.engine.chains.sets import Block, ChainSet, Drawing, blocks_of
from meshtrace.engine.setup.ends import ForcedLink
from meshtrace.kernels.tally import DIRECT, MIRRORED, SCATTERED
from meshtrace.kernels.tints import NO_TINTS, Tints
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.results.tallies import ArrivalTally, sums_by_group, travel_time
from meshtrace.stored import SHIFTS

ChainJob = tuple[list[int], Block]
"""Numbers of targets, and the chains that one thread aims at them."""


def chain_jobs(pairs: list[tuple[int, int]], sets: list[list[Drawing]]) -> list[ChainJob]:
    """List the jobs that aim the chains of each source at its targets.

    `pairs` are (emitter, target); `sets` has the drawings of chains of each emitter.
    """
    # a block of chains is drawn once and aimed at all targets of its source
    jobs = []
    for e, drawings in enumerate(sets):
        targets = [t for emitter, t in pairs if emitter == e]
        if targets:
            jobs += [(targets, block) for drawing in drawings for block in blocks_of(*drawing)]
    return jobs


class Light(NamedTuple):
    """Light that arrives at one receiver, one row an arrival; the weights sum to the gain.

    Unscattered light without random slopes is one row a facet, with shift -1: it has no Monte
    Carlo error, and belongs to every shift alike.
    """

    weight: Floats
    order: NDArray[np.int64]  # number of scatterings
    water: Floats  # path in the water [m]
    air: Floats  # path in the air [m]
    angle: Floats  # of arrival, to the axis of the receiver [rad]
    way: Floats  # (n, 3) along the light at the receiver, of any length
    lamp: Floats  # cosine of the angle of emission to the axis of the source
    shift: NDArray[np.int64]  # independent group of the chain, 0 ... SHIFTS - 1
    sample: NDArray[np.int64]  # number of the chain in its set, -1 without one
    log_weights: Floats  # (n, functions): what paths sum up, see `kernels.tints`
    facet: NDArray[np.int64]  # that of unscattered light without random slopes, else -1
    part: NDArray[np.int64]  # see `kernels.tally`: chains bring no light that is reflected first

    def table(self, receiver: int, factor: Floats, link: Link) -> ArrivalTally:
        """Return the table of arrivals at a receiver, with the weights times `factor` (n,)."""
        return ArrivalTally(
            receiver=np.full(len(self.weight), receiver),
            weight=self.weight * factor,
            water_path=self.water,
            air_path=self.air,
            time=travel_time(self.water, self.air, link.water.n, link.n_air),
            angle=self.angle,
            azimuth=link.receivers[receiver].azimuths_of(self.way),
            group=self.shift,
            sample=self.sample,
            part=self.part,
            order=self.order,
        )

    def by_shift(self, values: Floats) -> Floats:
        """Return the sum of the weights times values (n,) of each shift, shape (shifts,)."""
        return sums_by_group(self.shift, self.weight * values)[:, 0]


def merged(pieces: list[Light]) -> Light:
    """Concatenate `Light` records."""
    return Light(*map(np.concatenate, zip(*pieces, strict=True)))


def direct_light(
    aimed: AimedChains,
    emitter: int,
    target: int,
    gains: Floats,
    tints: Tints | None = NO_TINTS,
    at: Vec3 | None = None,
    shift: int = -1,
) -> Light:
    """Return unscattered light by facet, from the centre or a point `at` of a source.

    `gains` (facets,) are those of a source of all the power.
    """
    link, unit = aimed.link, aimed.link.frame.unit
    # few facets of a sea send light to one receiver
    nonzero = np.flatnonzero(gains)
    crossing = aimed.centroids[nonzero]
    source = link.emitters[emitter]
    if at is not None:
        source = source._replace(position=at)
    # paths and angles of a facet: straight to its centroid, and from there to the centre of the
    # aperture
    start = np.array(source.position)
    up, way = crossing - start, np.array(link.targets[target].center) - crossing
    water, air = (unit * np.linalg.norm(part, axis=1) for part in (up, way))
    if link.reflects:  # both ways lie in one medium
        water, air = _in_medium(link, water + air)
    angle, lamp = _angles(link, emitter, target, up, way)
    return Light(
        weight=link.share(emitter, target) * gains[nonzero],
        order=np.zeros(len(nonzero), np.int64),
        water=water,
        air=air,
        angle=angle,
        way=-up if link.down else way,
        lamp=lamp,
        shift=np.full(len(nonzero), shift),
        sample=np.full(len(nonzero), -1),
        log_weights=aimed.unscattered_tints(source, target, crossing, tints),
        facet=nonzero,
        part=np.full(len(nonzero), MIRRORED if link.reflects else DIRECT),
    )


def straight_light(link: ForcedLink, emitter: int, target: int) -> Light:
    """Return light straight from an emitter to a target in its medium, along one ray.

    From centre to centre; the weight is the share of the power, without a gain.
    """
    way = np.array([link.targets[target].center]) - np.array(link.emitters[emitter].position)
    water, air = _in_medium(link, link.frame.unit * np.linalg.norm(way, axis=1))
    angle, lamp = _angles(link, emitter, target, way, way)
    none, straight = np.array([-1]), np.array([DIRECT])
    return Light(
        weight=np.array([link.share(emitter, target)]),
        order=np.zeros(1, np.int64),
        water=water,
        air=air,
        angle=angle,
        way=way,
        lamp=lamp,
        shift=none,
        sample=none,
        log_weights=np.zeros((1, 0)),
        facet=none,
        part=straight,
    )


def _in_medium(link: ForcedLink, length: Floats) -> tuple[Floats, Floats]:
    """Return the lengths in water and in air of paths that stay in the medium of both ends."""
    dry = np.zeros_like(length)
    return (length, dry) if link.direction == "under" else (dry, length)


def chain_light(
    aimed: AimedChains,
    emitter: int,
    target: int,
    chains: ChainSet,
    tints: Tints | None = NO_TINTS,
    block: Block | None = None,
) -> Light:
    """Return the arrivals of a set of chains, or of a block of one."""
    link, unit = aimed.link, aimed.link.frame.unit
    # Number of the first chain among the n of its request: a block has some of them, and their
    # mean over n is the gain.
    first, n = (block.span.start, block.request.number) if block else (0, chains.number)
    _, arrivals = aimed.aim(emitter, target, chains, keep=True)
    # each chain aims at a point of its own on the aperture
    end, chain = link.targets[target], arrivals["chain"]
    way = on_disk(end.center, end, chains.chains.disk[chain]) - arrivals["point"]
    angle, lamp = _angles(link, emitter, target, arrivals["emission"], way)
    return Light(
        weight=link.share(emitter, target) * arrivals["weight"] / n,
        order=np.full(len(arrivals), chains.order),
        water=unit * arrivals["water"],
        air=unit * arrivals["air"],
        angle=angle,
        way=-arrivals["emission"] if link.down else way,
        lamp=lamp,
        # chains of a request are stored shift by shift, equally many of each
        shift=(first + chain) // (n // SHIFTS),
        sample=first + chain,
        log_weights=aimed.chain_tints(emitter, chains, arrivals, tints),
        facet=np.full(len(arrivals), -1),
        part=np.full(len(arrivals), min(chains.order, SCATTERED)),
    )


def _angles(
    arrays: ForcedLink, emitter: int, target: int, start: Floats, end: Floats
) -> tuple[Floats, Floats]:
    """Return angles of arrival [rad] and cosines of emission, from the end segments of chains.

    `start` and `end` (n, 3) point along the chain, from its lower to its upper end. Chains of light
    that goes down run backwards, from the receiver to the lamp.
    """
    # the lower end is a source, or a receiver whose axis, as an emitter, is turned to its view
    low, high = arrays.emitters[emitter], arrays.targets[target]
    first = _cosine(start, low.axis)
    if arrays.down:
        return np.arccos(first), _cosine(-end, high.lamp.axis)
    return np.arccos(_cosine(end, high.axis)), first


def _cosine(way: Floats, axis: tuple[float, float, float]) -> Floats:
    """Return the cosines of the angles of directions (n, 3) to an axis."""
    # no direction between two ends at one place, from which no light goes straight
    length = np.maximum(np.linalg.norm(way, axis=1), 1e-300)
    return np.clip(way @ np.array(axis) / length, -1.0, 1.0)
