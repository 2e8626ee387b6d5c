"""Gains: sums of arriving light by part, receiver and group.

A row is one arrival of light at one receiver, by a sample: a chain or a photon, which may have
several. Samples come in 32 independent groups, whose scatter gives standard errors. Parts of a gain
are unscattered light, scattered light, and light that the surface reflects at least once before it
crosses ("reflected first").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused
from meshtrace.kernels.random import Purpose, philox
from meshtrace.kernels.tally import BODY, BOTTOM, DIRECT, MIRRORED, N_PARTS, REFLECTED, SCATTERED
from meshtrace.link import Link
from meshtrace.link.receivers import Camera
from meshtrace.models import Floats
from meshtrace.results.gain import ChainCounts, ScatteredSamples
from meshtrace.results.tallies import ArrivalTally, error_of_groups, sums_by_group, travel_time
from meshtrace.stored import SHIFTS

Method = Literal["chains", "joined", "analog"]
"""Estimator of the scattered light of a receiver."""

_SCATTERED_PARTS = SCATTERED, BOTTOM, BODY
_SPARSE = 4  # cells (part, receiver, photon) per row beyond which samples are sorted rather than
# counted in an array: saves memory


@dataclass(frozen=True)
class Gains:
    """Gain of each receiver over one surface, at one wavelength or at several.

    Attributes
    ----------
    groups : ndarray, shape (..., N_PARTS, receivers, SHIFTS)
        Gain by part, see `meshtrace.kernels.tally`, as each group of samples estimates it; the
        mean over the groups is the gain. Groups are equal where it is deterministic, but for the
        error of its quadrature, see `with_error`.
    all_orders : ndarray, shape (..., receivers, orders)
        Gain without light reflected first by the number of scatterings, from 0 on.
    square : ndarray, shape (..., N_PARTS, receivers)
        Sum of the squares of what each sample brings to the gain.
    scored : ndarray of int, shape (..., N_PARTS, receivers)
        Samples that bring something.
    samples : ndarray of int, shape (N_PARTS, receivers)
        Samples in all.
    quadrature : ndarray, shape (..., receivers)
        Standard error of the unscattered gain by its quadrature, where the groups do not show it.
    method : list of {"chains", "joined", "analog"}
        Estimator of the scattered gain of each receiver.
    counts : ChainCounts
        Numbers of chains by their outcomes.
    reflects : bool
        Whether light that the surface reflects first was measured.
    table : list of ArrivalTally
        The rows, if they are recorded, by wavelength.
    by_lamp : Gains, optional
        Gains with a receiver for each pair of a lamp and a receiver, lamp after lamp, whose sums
        over the lamps these are.
    """

    groups: Floats
    all_orders: Floats
    square: Floats
    scored: NDArray[np.int64]
    samples: NDArray[np.int64]
    quadrature: Floats
    method: list[Method] = field(default_factory=list)
    counts: ChainCounts = field(default_factory=ChainCounts)
    reflects: bool = True
    table: list[ArrivalTally] = field(default_factory=list)
    by_lamp: Gains | None = None

    @classmethod
    def zeros(cls, wavelengths: int, receivers: int, orders: int) -> Gains:
        """Return gains of 0, without any samples."""
        # each wavelength first, so that one of them is a contiguous slice
        shape = wavelengths, N_PARTS, receivers
        return cls(
            groups=np.zeros((*shape, SHIFTS)),
            all_orders=np.zeros((wavelengths, receivers, orders)),
            square=np.zeros(shape),
            scored=np.zeros(shape, np.int64),
            samples=np.zeros(shape[1:], np.int64),
            quadrature=np.zeros((wavelengths, receivers)),
        )

    def add(self, other: Gains, receivers: Sequence[int]) -> Gains:
        """Add the sums over other samples to receivers, some of which may be given twice."""
        # `add.at`, as an indexed += would add once to a receiver that repeats
        last: Any = (..., np.array(receivers, np.intp))
        np.add.at(self.groups, (*last, slice(None)), other.groups)
        np.add.at(self.all_orders, (*last, slice(None)), other.all_orders)
        np.add.at(self.square, last, other.square)
        np.add.at(self.scored, last, other.scored)
        return self

    def by_wavelength(self) -> list[Gains]:
        """Return the gains at each wavelength."""
        return [
            replace(
                self,
                groups=self.groups[i],
                all_orders=self.all_orders[i],
                square=self.square[i],
                scored=self.scored[i],
                samples=self.samples.copy(),
                quadrature=self.quadrature[i],
                table=self.table[i : i + 1],
            )
            for i in range(len(self.groups))
        ]

    def over_lamps(self, lamps: int) -> Gains:
        """Return the sums over the lamps of gains at one wavelength by pair, see `by_lamp`."""
        receivers = len(self.method) // lamps

        def pairs(values: Any, axis: int) -> Any:
            head, tail = values.shape[:axis], values.shape[axis + 1 :]
            return values.reshape(*head, lamps, receivers, *tail)

        chained = np.array([method == "chains" for method in self.method[:receivers]])
        samples = pairs(self.samples, 1)
        # chains start at one lamp each, photons at any: all of them are samples of every lamp
        of_photons = np.arange(N_PARTS)[:, None] >= np.where(chained, SCATTERED + 1, SCATTERED)
        return replace(
            self,
            groups=pairs(self.groups, 1).sum(axis=1),
            all_orders=pairs(self.all_orders, 0).sum(axis=0),
            square=pairs(self.square, 1).sum(axis=1),
            scored=pairs(self.scored, 1).sum(axis=1),
            samples=np.where(of_photons, samples.max(axis=1), samples.sum(axis=1)),
            quadrature=pairs(self.quadrature, 0).sum(axis=0),
            method=self.method[:receivers],
            by_lamp=replace(self, table=[]),
        )

    @property
    def with_lamps(self) -> list[Gains]:
        """These gains, followed by the gains of each lamp, if any."""
        return [self] if self.by_lamp is None else [self, self.by_lamp]

    @property
    def parts(self) -> Floats:
        """Gain by part, see `meshtrace.kernels.tally`, shape (N_PARTS, receivers)."""
        return self.groups.mean(axis=-1)

    @property
    def part_stderr(self) -> Floats:
        """Standard errors of the parts, shape (N_PARTS, receivers)."""
        # scatter of independent groups: those of one sample's rows are correlated
        return error_of_groups(self.groups, axis=-1)

    @property
    def direct(self) -> Floats:
        """Unscattered gain by group, straight, refracted or mirrored, shape (receivers, SHIFTS)."""
        return self.groups[..., DIRECT, :, :] + self.groups[..., MIRRORED, :, :]

    @property
    def scattered(self) -> Floats:
        """Gain by group of light scattered by water, bottom or bodies, and not reflected first."""
        return sum_of_parts(self.groups, _SCATTERED_PARTS)

    @property
    def ballistic(self) -> Floats:
        """Unscattered gain of each receiver."""
        return self.direct.mean(axis=-1)

    @property
    def shifts(self) -> Floats:
        """Gain of each receiver by group, shape (receivers, SHIFTS)."""
        return self.direct + self.scattered + self.groups[..., REFLECTED, :, :]

    @property
    def gain(self) -> Floats:
        """Gain of each receiver."""
        return self.shifts.mean(axis=-1)

    @property
    def stderr(self) -> Floats:
        """Standard error of the gain of each receiver."""
        # the quadrature and the scatter of the groups err independently
        return np.hypot(error_of_groups(self.shifts, axis=-1), self.quadrature)

    @property
    def orders(self) -> Floats:
        """Scattered gain by the number of scatterings, from 1 on."""
        return self.all_orders[..., 1:]

    def samples_of(self, part: int) -> list[ScatteredSamples]:
        """Return the samples of a part of each receiver."""
        # light of bodies alone is scattered light, too, by the same photons
        together = [SCATTERED, BODY] if part == SCATTERED else [part]
        mean, square = self.parts[together].sum(axis=0), self.square[together].sum(axis=0)
        # (sum w)^2 / sum w^2, the number of equal samples of this variance; no 0 / 0 in the dark
        effective = mean**2 / np.maximum(square, 1e-300)
        scored = self.scored[together].max(axis=0)
        names = {"joined": "joined photons", "analog": "analog photons"}
        if part == SCATTERED:
            names["chains"] = "chains"
        columns = self.samples[part].tolist(), scored.tolist(), effective.tolist()
        estimators = [names.get(method, "joined photons") for method in self.method]
        return [ScatteredSamples(*row) for row in zip(estimators, *columns, strict=True)]

    def add_direct(
        self, receiver: int, gain: Floats, error: float, in_groups: bool, part: int = DIRECT
    ) -> None:
        """Add unscattered gain (wavelengths, 1 or SHIFTS) with the relative error of a quadrature.

        `in_groups` shows the error as a scatter of the groups, so that errors of the frames of a
        moving sea add up; beside scattered light, whose groups scatter far more, it stays apart.
        """
        if in_groups:
            gain = with_error(gain, error)
        else:
            self.quadrature[:, receiver] += error * gain.mean(axis=-1)
        self.groups[:, part, receiver] += gain

    def add_chains(
        self, receiver: int, order: int, groups: slice, score: Floats, share: float
    ) -> None:
        """Add the scores (wavelengths, chains) of chains of one order in successive groups.

        The gain is the sum of `share` times the scores of all groups; each group has equally many
        chains, stored one group after the other.
        """
        part = SCATTERED if order else DIRECT
        by_group = score.reshape(len(score), groups.stop - groups.start, -1).sum(axis=-1)
        # each group estimates the whole gain, but has a share 1 / SHIFTS of the chains
        self.groups[:, part, receiver, groups] += SHIFTS * share * by_group
        self.all_orders[:, receiver, order] += share * by_group.sum(axis=-1)
        self.square[:, part, receiver] += share**2 * np.einsum("ji,ji->j", score, score)
        self.scored[:, part, receiver] += np.count_nonzero(score, axis=-1)
        self.samples[part, receiver] += score.shape[-1]

    def add_arrivals(
        self, arrivals: NDArray[np.void], weights: Floats, first: int, photons: int,
        receiver: NDArray[np.int64] | None = None,
    ) -> None:  # fmt: skip
        """Add the arrivals (ARRIVAL) of `photons` successive photons, from number `first` on.

        `weights` (wavelengths, arrivals) are theirs at each wavelength; `receiver` (arrivals,) are
        their places among gains by lamp. Sums are not yet divided by the number of photons, see
        `of_photons`.
        """
        receivers, n_orders = self.all_orders.shape[1:]
        receiver = arrivals["receiver"] if receiver is None else receiver
        # flat index of (part, receiver), and from it those of (part, receiver, group) and (part,
        # receiver, photon)
        part, size = arrivals["part"] * receivers + receiver, N_PARTS * receivers
        group = part * SHIFTS + arrivals["photon"] % SHIFTS
        # what a photon brings to a receiver is one score, in however many rows it comes
        sample = part * photons + (arrivals["photon"] - first)
        # a count for every (part, receiver, photon) would be mostly zeros
        if size * photons > _SPARSE * len(arrivals):
            cells, sample = np.unique(sample, return_inverse=True)
        else:
            cells = np.arange(size * photons)
        # orders count scatterings of light that the surface does not reflect first
        not_reflected = arrivals["part"] != REFLECTED
        order = np.minimum(arrivals["order"], n_orders - 1)  # the last holds all beyond
        order = (receiver * n_orders + order)[not_reflected]
        for k, weight in enumerate(weights):
            sums = np.bincount(group, weight, size * SHIFTS)
            self.groups[k] += sums.reshape(self.groups.shape[1:])
            score = np.bincount(sample, weight, len(cells))
            for total, value in ((self.square, score * score), (self.scored, score != 0.0)):
                of_part = np.bincount(cells // photons, value, size).reshape(total.shape[1:])
                total[k] += of_part.astype(total.dtype)
            of_order = np.bincount(order, weight[not_reflected], receivers * n_orders)
            self.all_orders[k] += of_order.reshape(receivers, n_orders)

    def of_photons(self, photons: int) -> Gains:
        """Return the gains per photon from sums over photons 0, 1, ..., `photons` - 1."""
        # a group estimates the gain from its own photons
        return replace(
            self,
            groups=self.groups / photons_by_group(photons),
            all_orders=self.all_orders / photons,
            square=self.square / photons**2,
            samples=np.full_like(self.samples, photons),
        )

    def with_photons(self, photons: Gains, receivers: Sequence[int]) -> Gains:
        """Add the gains of photons to the receivers they serve.

        At one wavelength; `photons` has these receivers alone, in this order. Where the method of a
        receiver is chains, its scattered light by photons is only that which the bottom reflects.
        """
        # photons have a fixed number of orders, of which high ones mostly bring nothing
        n_orders = np.flatnonzero(photons.all_orders.any(axis=0)).max(initial=0) + 1
        orders = widened(self.all_orders, max(n_orders, self.all_orders.shape[1]))
        index = np.array(receivers)
        orders[index, 1:n_orders] += photons.all_orders[:, 1:n_orders]
        # without DIRECT: unscattered light is already here, integrated over the facets
        later = slice(DIRECT + 1, None)
        self.groups[later, index] += photons.groups[later]
        self.square[later, index] += photons.square[later]
        # the numbers of samples are those of the estimator of the receiver
        chained = np.array([self.method[r] == "chains" for r in receivers])
        for mine, other in ((self.scored, photons.scored), (self.samples, photons.samples)):
            of_chains = mine[SCATTERED, index]
            mine[later, index] = other[later]
            mine[SCATTERED, index] = np.where(chained, of_chains, other[SCATTERED])
        return replace(self, all_orders=orders)


def places_of(
    arrivals: NDArray[np.void], seed: int, link: Link, lamps: int, receivers: int
) -> NDArray[np.int64] | None:
    """Return the index of each arrival among gains by lamp; None for one lamp."""
    if lamps == 1:
        return None
    return lamps_of(arrivals["photon"], seed, link) * receivers + arrivals["receiver"]


def lamps_of(photons: NDArray[np.int64], seed: int, link: Link) -> NDArray[np.intp]:
    """Return the index of the source of each photon, as `kernels.sources.launch` draws it."""
    power = np.array([source.power_mw for source in link.transmitters])
    # the kernel as plain code, which numpy applies to whole arrays; without compilation it is that
    words = getattr(philox, "py_func", philox)(seed, photons, 0, Purpose.LAUNCH)
    u = (words[3].astype(float) + 0.5) * 2.0**-32
    return np.searchsorted((np.cumsum(power) / power.sum())[:-1], u, side="right")


def photons_by_group(photons: int) -> NDArray[np.int64]:
    """Return the numbers of photons in the groups, by id modulo SHIFTS."""
    # the first groups may have one more
    return (photons + SHIFTS - 1 - np.arange(SHIFTS)) // SHIFTS


def widened(orders: Floats, width: int) -> Floats:
    """Return a copy of gains by order (receivers, orders) with zeros up to `width` orders."""
    wide = np.zeros((len(orders), width))
    wide[:, : orders.shape[1]] = orders
    return wide


def sum_of_parts(values: Floats, parts: Sequence[int]) -> Floats:
    """Sum values of shape (..., parts, receivers, groups) over the given parts."""
    # one after the other: the digits of links that have the first part alone do not change
    total = values[..., parts[0], :, :]
    for part in parts[1:]:
        total = total + values[..., part, :, :]
    return total


def with_error(gain: Floats, error: float) -> Floats:
    """Spread a gain over groups (..., SHIFTS) by the relative `error` of a quadrature.

    `gain` is (..., 1 or SHIFTS), and returned as it is without an error. Even groups are raised and
    odd ones lowered by a: the mean of SHIFTS groups at +-a has the standard error
    a / (SHIFTS - 1)^(1/2). The pattern is the same in all frames of a sea, whose errors so add up.
    """
    if error == 0.0:
        return gain
    sign = np.where(np.arange(SHIFTS) % 2 == 0, 1.0, -1.0)
    return gain * (1.0 + error * math.sqrt(SHIFTS - 1) * sign)


def pixel_groups(table: ArrivalTally, link: Link) -> Floats:
    """Return the gain of each pixel by group from all arrivals, (receivers, pixels, SHIFTS).

    Pixels are numbered as in `Camera.pixels_of`.

    Raises
    ------
    Refused
        If receivers differ in their numbers of pixels.
    """
    n = {getattr(end, "pixels", 1) for end in link.receivers}
    if len(n) != 1:
        raise Refused("receiver", Described("different numbers of pixels"), "equal numbers")
    groups = []
    for r, end in enumerate(link.receivers):
        assert isinstance(end, Camera)
        here = table.receiver == r
        pixel = end.pixels_of(table.angle[here], table.azimuth[here])
        groups.append(sums_by_group(table.group[here], table.weight[here], pixel, end.pixels**2).T)
    return np.array(groups)


def shares_of(arrivals: NDArray[np.void], photons: int) -> Floats:
    """Return the factors (rows,) by which weights of arrivals sum to the gain of all photons.

    Photons have the numbers 0 ... `photons` - 1. Groups may differ by a photon: the gain is the
    mean over the means of the groups.
    """
    in_group = photons_by_group(photons)
    return np.asarray(1.0 / (SHIFTS * in_group[arrivals["photon"] % SHIFTS]))


def table_of(arrivals: NDArray[np.void], weight: Floats, unit: float, link: Link) -> ArrivalTally:
    """Return the table of arrivals (ARRIVAL) of photons, whose paths are in units of `unit` [m]."""
    water, air = unit * arrivals["water"], unit * arrivals["air"]
    angle, azimuth = np.empty(len(weight)), np.empty(len(weight))
    for r, receiver in enumerate(link.receivers):
        of_receiver = arrivals["receiver"] == r
        way = arrivals["way"][of_receiver]
        # one order of additions: matrix products round otherwise, and small angles are the arc
        # cosine of numbers near 1
        x, y, z = way.T
        cosine = x * receiver.axis[0] + y * receiver.axis[1] + z * receiver.axis[2]
        cosine /= np.sqrt(x * x + y * y + z * z)
        angle[of_receiver] = np.arccos(np.clip(cosine, -1.0, 1.0))
        azimuth[of_receiver] = receiver.azimuths_of(way)
    return ArrivalTally(
        receiver=arrivals["receiver"].copy(),
        weight=weight,
        water_path=water,
        air_path=air,
        time=travel_time(water, air, link.water.n, link.n_air),
        angle=angle,
        azimuth=azimuth,
        group=arrivals["photon"] % SHIFTS,
        sample=arrivals["photon"].copy(),
        part=arrivals["part"].copy(),
        order=arrivals["order"].copy(),
    )
