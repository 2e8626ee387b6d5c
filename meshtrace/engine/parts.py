"""Gain over one surface by receiver, shift and order, and its light by arrival."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.chains.aimed import AimedChains, on_disk
from meshtrace.engine.chains.gain import Counter
from meshtrace.engine.chains.sets import Block, ChainSet, Drawing
from meshtrace.engine.choice import Method
from meshtrace.engine.photons.joined import PhotonParts
from meshtrace.engine.photons.targets import REFLECTED, SCATTERED
from meshtrace.engine.setup.ends import ForcedLink
from meshtrace.kernels.tints import NO_TINTS, Tints
from meshtrace.kernels.vectors import Vec3
from meshtrace.models import Floats
from meshtrace.results.gain import ChainCounts, ScatteredSamples
from meshtrace.results.tallies import error_of_groups
from meshtrace.stored import SHIFTS


@dataclass(frozen=True)
class Parts:
    """Gain over one surface, in parts.

    Attributes
    ----------
    direct : ndarray, shape (receivers, shifts)
        Unscattered gain of each shift of the points; all the same where it is deterministic, but
        for the error of its quadrature.
    scattered : ndarray, shape (receivers, shifts)
        Scattered gain of each shift of the points.
    orders : ndarray, shape (receivers, orders)
        Scattered gain by the number of scatterings, from 1 on.
    counts : ChainCounts
        Numbers of chains, and of their outcomes.
    method : list of {"chains", "joined", "analog"}
        Estimator of the scattered gain of each receiver.
    samples : list of ScatteredSamples
        Chains or photons that the scattered gain of each receiver rests on.
    photons : list of PhotonParts
        Photons to all receivers if light that the surface reflects first was measured, else none:
        joined and analog ones, no receiver has light of both.
    quadrature : ndarray, shape (receivers,)
        Standard error of the unscattered gain by its quadrature, where the shifts do not show it.
    """

    direct: Floats
    scattered: Floats
    orders: Floats
    counts: ChainCounts
    method: list[Method]
    samples: list[ScatteredSamples]
    photons: list[PhotonParts] = field(default_factory=list)
    quadrature: Floats = field(default_factory=lambda: np.zeros(1))

    @property
    def ballistic(self) -> Floats:
        """Unscattered gain of each receiver."""
        return self.direct.mean(axis=1)

    @property
    def shifts(self) -> Floats:
        """Gain of each receiver by the shift of the points, shape (receivers, shifts)."""
        return sum((one.groups[REFLECTED] for one in self.photons), self.direct + self.scattered)

    @property
    def gain(self) -> Floats:
        """Gain of each receiver."""
        return self.shifts.mean(axis=1)

    @property
    def stderr(self) -> Floats:
        """Standard error of the gain of each receiver."""
        return np.hypot(error_of_groups(self.shifts, axis=1), self.quadrature)


BlockSums = tuple[Floats, Floats, NDArray[np.int64]]
"""Score (wavelengths, shifts), sum of squares and hits of the chains of a block, to a receiver."""

ChainJob = tuple[list[int], Block]
"""Targets, and the chains that one thread aims at them."""


def block_sums(score: Floats, block: Block) -> BlockSums:
    """Return the sums of scores (wavelengths, chains)."""
    n = block.shifts_in.stop - block.shifts_in.start
    light = score.reshape(len(score), n, -1).sum(axis=-1)
    square = np.einsum("ji,ji->j", score, score)
    return light, square, np.asarray(np.count_nonzero(score, axis=-1))


class QuadratureError(NamedTuple):
    """Error of the unscattered light of a pair by its quadrature."""

    relative: float
    in_shifts: bool  # carried by the shifts, so that errors of frames of a sea add up
    is_cut_short: bool


def with_error(gain: Floats, error: float) -> Floats:
    """Return a gain (..., 1 or shifts) with the relative `error` of a quadrature between shifts.

    Half of them lie above and half below: +-a has the standard error a / (SHIFTS - 1)^(1/2). It is
    the same in all frames of a sea, whose errors so add up.
    """
    if error == 0.0:
        return gain
    above = np.where(np.arange(SHIFTS) % 2 == 0, 1.0, -1.0)
    return gain * (1.0 + error * math.sqrt(SHIFTS - 1) * above)


class ChainSums:
    """Sums over chains at some wavelengths, by receiver."""

    def __init__(
        self,
        link: ForcedLink,
        method: list[Method],
        sets: list[list[Drawing]],
        wavelengths: int,
    ) -> None:
        self._link, self._method = link, method
        served = [pair for pair in link.pairs if method[link.receiver(*pair)] == "chains"]
        self.jobs = chain_jobs(served, sets)
        requests = [drawing.request for row in sets for drawing in row]
        self.chains = sum(request.number for request in requests)
        orders = max((request.order for request in requests), default=0)
        shape = wavelengths, len(method)
        self._direct = np.zeros((*shape, SHIFTS))
        self._scattered = np.zeros((*shape, orders, SHIFTS))
        self._squares, self._quadrature = np.zeros((2, *shape))
        self._samples, self._scored = np.zeros((2, *shape), np.int64)
        self._sampled = set[tuple[int, int]]()  # pairs whose unscattered light is sampled
        self._cut_short = 0  # pairs whose unscattered light took too many nodes

    def add_direct(self, e: int, t: int, gain: Floats, quadrature: QuadratureError) -> None:
        """Add the unscattered gain of a pair (wavelengths, 1 or shifts), see `with_error`."""
        r, light = self._link.receiver(e, t), self._link.share(e, t) * gain
        if quadrature.in_shifts:
            light = self._link.share(e, t) * with_error(gain, quadrature.relative)
        else:  # scattered light has far larger errors between shifts
            self._quadrature[:, r] += quadrature.relative * light.mean(axis=-1)
        self._direct[:, r] += light
        self._cut_short += quadrature.is_cut_short
        if gain.shape[-1] > 1:
            self._sampled.add((e, t))

    def add(self, job: ChainJob, found: list[BlockSums]) -> None:
        """Add the sums of a job, by target."""
        targets, block = job
        request, shifts = block.request, block.shifts_in
        for t, (score, square, scored) in zip(targets, found, strict=True):
            r, share = self._link.receiver(request.source, t), self._link.share(request.source, t)
            light = share * (score / request.per_shift)
            if request.order == 0:
                self._direct[:, r, shifts] += light
                if light.any():
                    self._sampled.add((request.source, t))
                continue
            self._scattered[:, r, request.order - 1, shifts] += light
            self._samples[:, r] += block.rows.stop - block.rows.start
            self._scored[:, r] += scored
            self._squares[:, r] += share**2 * square / request.number**2

    def parts(
        self, i: int, counters: NDArray[np.int64], light: list[PhotonParts], reflects: bool
    ) -> Parts:
        """Return the gain of one wavelength in parts, with the light of photons to all receivers.

        Where chains serve it is that of the bottom alone. Light reflected first counts if
        `reflects`. `counters` are the outcomes of the search for crossings.
        """
        outcomes = {c.name.lower(): int(counters[c]) for c in Counter}
        counts = ChainCounts(
            drawn=self.chains,
            sampled=len(self._sampled),
            cut_short=self._cut_short,
            **outcomes,
        )
        scattered, orders = self._scattered[i].sum(axis=1), self._scattered[i].mean(axis=2)
        squares = self._squares[i].copy()
        for found in light:
            scattered += found.groups[SCATTERED]
            squares += found.square[SCATTERED] / np.maximum(found.photons, 1)
            seen = np.flatnonzero(found.orders.any(axis=0)).max(initial=0)
            orders = np.pad(orders, ((0, 0), (0, max(seen - orders.shape[1], 0))))
            orders[:, :seen] += found.orders[:, 1 : seen + 1]
        effective = scattered.mean(axis=1) ** 2 / np.maximum(squares, 1e-300)
        columns = self._samples[i], self._scored[i], effective
        chained = zip(*(column.tolist() for column in columns), strict=True)
        samples = [ScatteredSamples("chains", *row) for row in chained]
        for found in light:
            for r, row in enumerate(found.samples(SCATTERED)):
                if row.samples and self._method[r] != "chains":
                    samples[r] = row
        return Parts(
            direct=self._direct[i],
            scattered=scattered,
            orders=orders,
            counts=counts,
            method=self._method,
            samples=samples,
            photons=light if reflects else [],
            quadrature=self._quadrature[i],
        )


def chain_jobs(pairs: list[tuple[int, int]], sets: list[list[Drawing]]) -> list[ChainJob]:
    """Return the jobs of the chains of each source, aimed at the targets of some pairs."""
    jobs = []
    for e, row in enumerate(sets):
        targets = [t for f, t in pairs if f == e]
        if targets:
            jobs += [(targets, block) for drawing in row for block in drawing.blocks()]
    return jobs


class Light(NamedTuple):
    """Light that arrives at one receiver, one row an arrival; the weights sum to the gain.

    Unscattered light without random slopes is one row a facet, with shift -1: it has no Monte
    Carlo error, and belongs to every shift alike.
    """

    weight: Floats
    order: NDArray[np.int64]  # number of scatterings
    water: Floats  # path in the water [m]
    air: Floats
    angle: Floats  # to the axis of the receiver [rad]
    lamp: Floats  # cosine of the emission to the axis of the source
    shift: NDArray[np.int64]
    tint: Floats  # (n, tints), see `kernels.tints`
    facet: NDArray[np.int64]  # that of unscattered light without random slopes, else -1

    def by_shift(self, values: Floats) -> Floats:
        """Return the sum of the weights times values (n,) of each shift, shape (shifts,)."""
        light = self.weight * values
        common = self.shift < 0
        sums = np.bincount(self.shift[~common], light[~common], minlength=SHIFTS)
        return light[common].sum() + SHIFTS * sums


def merged(rows: list[Light]) -> Light:
    """Return all light of some rows."""
    return Light(*map(np.concatenate, zip(*rows, strict=True)))


def direct_light(
    aimed: AimedChains,
    emitter: int,
    target: int,
    gains: Floats,
    tints: Tints | None = NO_TINTS,
    at: Vec3 | None = None,
    shift: int = -1,
) -> Light:
    """Return unscattered light by facet, from the centre or a point `at` of a source."""
    link, unit = aimed.link, aimed.link.frame.unit
    lit = np.flatnonzero(gains)
    crossing = aimed.centroids[lit]
    source = link.emitters[emitter]
    if at is not None:
        source = source._replace(position=at)
    start = np.array(source.position)
    up, way = crossing - start, np.array(link.targets[target].center) - crossing
    water, air = (unit * np.linalg.norm(part, axis=1) for part in (up, way))
    angle, lamp = _angles(link, emitter, target, up, way)
    return Light(
        weight=link.share(emitter, target) * gains[lit],
        order=np.zeros(len(lit), np.int64),
        water=water,
        air=air,
        angle=angle,
        lamp=lamp,
        shift=np.full(len(lit), shift),
        tint=aimed.straight_tints(source, crossing, tints),
        facet=lit,
    )


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
    first, n = (block.rows.start, block.request.number) if block else (0, len(chains.audit))
    found = aimed.aim(emitter, target, chains, keep=True).arrivals
    end, chain = link.targets[target], found["chain"]
    way = on_disk(end.center, end, chains.chains.disk[chain]) - found["point"]
    angle, lamp = _angles(link, emitter, target, found["emission"], way)
    return Light(
        weight=link.share(emitter, target) * found["weight"] / n,
        order=np.full(len(found), chains.order),
        water=unit * found["water"],
        air=unit * found["air"],
        angle=angle,
        lamp=lamp,
        shift=(first + chain) // (n // SHIFTS),
        tint=aimed.chain_tints(emitter, chains, found, tints),
        facet=np.full(len(found), -1),
    )


def _angles(
    arrays: ForcedLink, emitter: int, target: int, start: Floats, end: Floats
) -> tuple[Floats, Floats]:
    """Return angles of arrival [rad] and cosines of emission of chains, by their two end segments.

    Chains of light that goes down start at the receiver and end at the lamp.
    """
    low, high = arrays.emitters[emitter], arrays.targets[target]
    first = _cosine(start, low.axis)
    if arrays.down:
        return np.arccos(first), _cosine(-end, high.lamp.axis)
    return np.arccos(_cosine(end, high.axis)), first


def _cosine(way: Floats, axis: tuple[float, float, float]) -> Floats:
    """Return the cosines of the angles of directions (n, 3) to an axis."""
    return np.clip(way @ np.array(axis) / np.linalg.norm(way, axis=1), -1.0, 1.0)
