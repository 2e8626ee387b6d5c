"""Candidates of an optimisation: objectives, and common seas, hover errors, tilts and chains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, Literal, get_args

import numpy as np

from meshtrace.comms.budget import required_gain
from meshtrace.comms.ook import OokLink
from meshtrace.engine.parts import Light
from meshtrace.errors import Refused
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Led, Link
from meshtrace.mesh import SeededSurface
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.neighbours import Neighbours
from meshtrace.studies.sensitivity.parameters import Quantity
from meshtrace.studies.store import digest_of
from meshtrace.uav.airframe import Flight

Objective = Literal["outage", "gain", "range", "margin"]
Custom = Callable[[Link, Floats, Floats], float]

_DARK = 1e-30  # gain that stands for no light
_DB = 10.0 / math.log(10.0)
Evaluate = Callable[[Link], Sequence[tuple[Floats, Floats]]]
"""Gains and weights of a link: of all, and of the groups of the jackknife."""


def weighted_quantile(values: Floats, weights: Floats, quantile: float) -> float:
    """Return a quantile of weighted values, linear between the middles of their weights."""
    order = np.argsort(values)
    middle = np.cumsum(weights[order]) - 0.5 * weights[order]
    return float(np.interp(quantile, middle / weights.sum(), values[order]))


class Goal:
    """Objective of an optimisation, its cost and its quantity.

    Parameters
    ----------
    objective : {"outage", "gain", "range", "margin"} or callable
        "outage": the quantile of -ln(gain / need), smooth where the outage of a sample is a
        step function. A callable takes (link, gains, weights) and returns a number to minimise.
    quantile : float
        Quantile of the gain for "outage".
    ook : OokLink or None
        Transmission.
    limit : float
        Bit error rate of a working link.
    """

    def __init__(
        self, objective: Objective | Custom, quantile: float, ook: OokLink | None, limit: float
    ) -> None:
        if not callable(objective) and objective not in get_args(Objective):
            raise Refused(
                "objective", objective, f"{', '.join(get_args(Objective))}, or a function"
            )
        if ook is None and objective in ("outage", "range", "margin"):
            raise Refused("ook", None, f"a transmission, for {objective}")
        self.objective = objective
        self._quantile, self._ook, self._limit = quantile, ook, limit
        self._rates = Quantity("range", limit)

    @property
    def name(self) -> str:
        """Name of the objective."""
        return "custom" if callable(self.objective) else self.objective

    def costs(self, link: Link, evaluate: Evaluate) -> Floats:
        """Return the number to minimise: of all gains, then of the groups of the jackknife."""
        if self.objective == "range":
            return self._ranges(link, evaluate)
        return np.array([self._cost(link, *group) for group in evaluate(link)])

    def _cost(self, link: Link, gains: Floats, weights: Floats) -> float:
        if callable(self.objective):
            return float(self.objective(link, gains, weights))
        mean = math.log(max(float(gains @ weights) / float(weights.sum()), _DARK))
        if self.objective == "gain":
            return -mean
        need = math.log(self._need(link))
        if self.objective == "margin":
            return need - mean
        logs = np.log(np.maximum(gains, _DARK))
        return need - weighted_quantile(logs, weights, self._quantile)

    def quantity(self, link: Link, cost: float, evaluate: Evaluate) -> float:
        """Return the quantity of the objective: gain, outage, range [m] or margin [dB]."""
        if self.objective == "outage":
            gains, weights = evaluate(link)[0]
            return float(weights[gains < self._need(link)].sum() / weights.sum())
        scale = {"gain": math.exp(-cost), "range": -cost, "margin": -_DB * cost}
        return scale.get(self.name, cost)

    def error(self, cost: float, stderr: float) -> float:
        """Return the standard error of the quantity by the error of the cost; nan for an outage."""
        scale = {"gain": math.exp(-cost), "margin": _DB, "outage": math.nan}
        return stderr * scale.get(self.name, 1.0)

    def _need(self, link: Link) -> float:
        assert self._ook is not None
        return required_gain(OokLink.of_link(link, self._ook), self._limit)

    def _ranges(self, link: Link, evaluate: Evaluate) -> Floats:
        """Return minus the depths of an averaged error rate equal to the limit."""
        assert self._ook is not None
        ook = OokLink.of_link(link, self._ook)
        depth = link.depth
        found: list[tuple[float, Floats]] = []
        for _ in range(8):
            groups = evaluate(link.at_depth(depth))
            excess = np.array([self._excess(ook, *group) for group in groups])
            found.append((depth, excess))
            if len(found) == 1:
                depth += -1.0 if excess[0] < 0.0 else 1.0
                continue
            (d0, e0), (d1, e1) = found[-2:]
            slope = (e1[0] - e0[0]) / (d1 - d0)
            ends = d1 - e1 / slope
            if abs(ends[0] - d1) < 0.02:
                return -ends
            depth = float(np.clip(ends[0], 0.5 * d1, 2.0 * d1))
        raise Refused("transmitter.depth", depth, "a link with a range")

    def _excess(self, ook: OokLink, gains: Floats, weights: Floats) -> float:
        """Return the logarithm of the ratio of the light to the need."""
        law = self._rates.law(ook, rising=False)
        logs = np.log(np.maximum(ook.received_power(gains), _DARK))
        low, high = -20.0, 20.0
        for _ in range(40):
            shift = 0.5 * (low + high)
            if float(np.exp(law(logs + shift)) @ weights) / float(weights.sum()) > self._limit:
                low = shift
            else:
                high = shift
        return -0.5 * (low + high)


_POSITIONS = 12  # of the receiver over each of several seas
_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))  # azimuths that fill a disk evenly
_CASES = 4  # candidates whose arrivals are kept for other fields of view


_EDGE = math.radians(2.0)  # more than a facet is seen under
_SMALL = 1e-4  # share of the light

REWEIGHED = ("receiver.fov_deg", "transmitter.half_angle_deg")
"""Variables for which the arrivals stay: the view cuts them off, a lamp in the water weighs them
again."""


class Sample:
    """Surfaces and receivers common to all candidates.

    Parameters
    ----------
    campaign : Campaign
        The start, with the widest field of view of all candidates, its surface and options.
    realizations : int
        Seas, each with 12 places and tilts; over a surface without random phases, places.
    hover_std : (float, float)
        Standard deviations of the place of the end in the air along x and y [m].
    flight : Flight, optional
        Aircraft that tilts it.
    turned : tuple of str
        Variables that only weigh the arrivals again, see `REWEIGHED`.

    Notes
    -----
    Hover errors are stratified in the probability t that a place lies farther out,
    r = sqrt(-2 ln t) in standard deviations: strata become narrower outwards as (1 - k / m)^2,
    so that low quantiles of the gain rest on places of their own.
    """

    def __init__(
        self,
        campaign: Campaign,
        realizations: int,
        hover_std: tuple[float, float],
        flight: Flight | None,
        turned: tuple[str, ...],
    ) -> None:
        link, self._seed = campaign.link, campaign.run.seed
        self._flight, self._start, self._turned = flight, link, turned
        random = isinstance(campaign.surface, SeededSurface)
        self._seas = realizations if random else 1
        self._places = 1
        if flight is not None or any(hover_std):
            self._places = _POSITIONS if random else realizations
        self._draw(campaign, hover_std)
        self._near = Neighbours(
            campaign, self._seas, phases=random, fading=True,
            kept=self._seas, around=self._spread(link, 0),
        )  # fmt: skip
        self._lights = lru_cache(_CASES)(partial(self._over_seas, self._near.light))
        self._identity = {
            "realizations": realizations,
            "hover_std": hover_std,
            "flight": flight and campaign.of_flight(flight),
            "turned": list(turned),
        }

    def _draw(self, campaign: Campaign, hover_std: tuple[float, float]) -> None:
        """Draw places, their weights and the winds of all seas."""
        flight, m = self._flight, self._places
        rng = np.random.default_rng([self._seed, 1])
        edges = (1.0 - np.arange(m + 1) / m) ** 2
        share = rng.random() if m == 1 else 0.5
        beyond = edges[1:] + share * (edges[:-1] - edges[1:])
        radius = np.sqrt(-2.0 * np.log(beyond)) if m > 1 else np.zeros(1)
        azimuth = 2.0 * math.pi * rng.random() + _GOLDEN * np.arange(m)
        places = radius[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        self._offsets = places * np.array(hover_std)
        self.weights = np.tile(edges[:-1] - edges[1:], self._seas) / self._seas
        self._tilts = np.zeros((self._seas, m, 2))
        if flight is not None:
            wind, seed = campaign.wind_of(flight), realization_seed(self._seed, 0)
            tilt = flight.uav.tilt(wind.sample_wind(self._seas * m, seed))
            angles = np.degrees(np.stack([tilt.angle, tilt.azimuth], axis=1))
            self._tilts = angles.reshape(self._seas, m, 2)

    def _spread(self, link: Link, i: int) -> Link:
        """Return a link with its end in the air at all places over sea i."""
        name, end = link.air_end
        if end.tilt_deg != 0.0 and self._flight is not None:
            raise Refused(f"{name}.tilt_deg", end.tilt_deg, "0: the aircraft tilts it")
        ends = []
        for (x, y), (tilt, azimuth) in zip(self._offsets, self._tilts[i], strict=True):
            place = (end.position[0] + float(x), end.position[1] + float(y))
            lean = {} if self._flight is None else {
                "tilt_deg": float(tilt), "tilt_azimuth_deg": float(azimuth)
            }  # fmt: skip
            ends.append(end.replace(position=place, **lean))
        return link.model_copy(update={name: tuple(ends)})

    def gains(self, link: Link) -> Floats:
        """Return the gains of a candidate, kept in the store, shape (seas * places, shifts)."""
        candidate = digest_of(link.model_dump(mode="json"))
        name = f"candidates of seed {self._seed}"
        (found,) = self._near.campaign.over(
            lambda: lambda _: self._computed(link), [candidate], name, self._identity
        )
        return found

    def _computed(self, link: Link) -> Floats:
        """Return the gains of a candidate over all seas."""
        if self._turned:
            same = link
            for name in self._turned:
                part, key = name.split(".")
                same = same.replace(name, getattr(getattr(self._start, part), key))
            lights = self._lights(same)
            half = math.radians(0.5 * link.receivers[0].fov_deg)
            direct = [(light.shift < 0) & (np.abs(light.angle - half) < _EDGE) for light in lights]
            cut = (
                light.weight[near].sum() > _SMALL * light.weight.sum()
                for light, near in zip(lights, direct, strict=True)
            )
            if not any(cut):  # facets with unscattered light that counts, by the edge of the view
                return np.array([light.by_shift(self._factor(link, light)) for light in lights])
            sampled = [self._factor(link, light) * (light.shift >= 0) for light in lights]
            rows = [light.by_shift(part) for light, part in zip(lights, sampled, strict=True)]
            return np.array(rows) + np.array(self._over_seas(self._near.unscattered, link))[:, None]
        return np.array(self._over_seas(self._near.gains, link))

    def _over_seas(self, evaluate: Callable[[Link, int], Any], link: Link) -> list[Any]:
        """Return the values of a candidate at all places over all seas."""

        def one(i: int) -> list[Any]:
            links = [self._spread(link, i)]
            if link.direction == "down":  # the light of lamps at several places would add up
                lamps = links[0].transmitters
                links = [link.model_copy(update={"transmitter": lamp}) for lamp in lamps]
            return [value for at in links for value in evaluate(at, i)]

        return [value for row in self._near.map(one) for value in row]

    def _factor(self, link: Link, light: Light) -> Floats:
        """Return the weights of arrivals at a candidate, relative to the start."""
        half = math.radians(0.5 * link.receivers[0].fov_deg)
        factor = (light.angle <= half).astype(float)
        old, new = self._start.transmitters[0], link.transmitters[0]
        if isinstance(old, Led) and isinstance(new, Led):
            lit = np.maximum(light.lamp, 1e-300)
            factor *= (new.order + 1.0) / (old.order + 1.0) * lit ** (new.order - old.order)
        return factor

    def groups(self, link: Link) -> list[tuple[Floats, Floats]]:
        """Return mean gains of a candidate, and weights: all, without each shift, each sea."""
        gains = self.gains(link)
        found = [(gains.mean(axis=1), self.weights)]
        found += [(np.delete(gains, i, axis=1).mean(axis=1), self.weights) for i in range(SHIFTS)]
        if self._seas > 1:
            sea = np.repeat(np.arange(self._seas), self._places)
            means = gains.mean(axis=1)
            for i in range(self._seas):
                kept = sea != i
                found.append((means[kept], self.weights[kept] * self._seas / (self._seas - 1)))
        return found
