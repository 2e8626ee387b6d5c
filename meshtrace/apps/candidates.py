"""Evaluate the candidates of an optimisation over common seas, hover errors, tilts and chains."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import chain, cycle, islice
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from meshtrace import Flight, Uav
from meshtrace.comms import OokLink
from meshtrace.errors import Refused
from meshtrace.link import Led, Link
from meshtrace.mesh import SeededSurface
from meshtrace.models import Floats
from meshtrace.parallel import held, ordered_map
from meshtrace.stored import SHIFTS
from meshtrace.studies import Variant
from meshtrace.studies.background import Lights
from meshtrace.studies.campaign import Campaign, realization_seed
from meshtrace.studies.cluster import Restored
from meshtrace.studies.neighbours import Light, Neighbours, Quantity, range_of, without_each
from meshtrace.studies.response import MOST_SEAS, Responses
from meshtrace.studies.store import digest_of

Objective = Literal["outage", "gain", "range", "margin", "capacity"]
Custom = Callable[[Variant, Floats, Floats], float]

_DARK = 1e-30  # gain that stands for no light


def weighted_quantile(values: Floats, weights: Floats, quantile: float) -> float:
    """Return a quantile of weighted values, linear between the middles of their weights."""
    order = np.argsort(values)
    middle = np.cumsum(weights[order]) - 0.5 * weights[order]
    return float(np.interp(quantile, middle / weights.sum(), values[order]))


class Goal:
    """Objective of an optimisation, its cost and its quantity.

    Parameters
    ----------
    objective : {"outage", "gain", "range", "margin", "capacity"} or callable
        "outage": the quantile of -ln(gain / need), smooth where the outage of a sample is a
        step function. A callable takes (candidate, gains, weights) and returns a number to
        minimise.
    quantile : float
        Quantile of the gain for "outage".
    lights : Lights
        Background light of each candidate.
    limit : float
        Bit error rate of a working link.
    """

    def __init__(
        self, objective: Objective | Custom, quantile: float, lights: Lights, limit: float
    ) -> None:
        self.objective = objective
        self._quantile, self._lights = quantile, lights
        self._rates = Quantity("range" if callable(objective) else objective, limit)

    @property
    def name(self) -> str:
        """Name of the objective."""
        return "custom" if callable(self.objective) else self.objective

    def costs(self, at: Variant, sample: Sample) -> Floats:
        """Return the number to minimise: of all gains, then of the groups of the jackknife."""
        gains, ook = self._lit(at, sample)
        # a quantile is no mean over groups, nor is a user's function: each is taken without each
        if callable(self.objective) or self.objective == "outage":
            at, weights = at._replace(detector=ook), sample.weights
            return np.array([self._cost(at, without, weights) for without in without_each(gains)])
        # a closed eye has no need to divide by, yet a search goes on from a number
        if self.objective in ("margin", "range") and math.isinf(self._rates.need(ook)):
            worst = 0.0 if self.objective == "range" else -math.log(_DARK)  # a closed eye
            return np.array([worst for _ in without_each(gains)])
        return self._ranges(at, sample) if self.objective == "range" else -self._logs(at, sample)

    def _lit(self, at: Variant, sample: Sample) -> tuple[Floats, OokLink | None]:
        """Return the gains of a candidate, and its receiver exposed to background light."""
        gains = sample.gains(at)
        if self.objective == "gain":
            return gains, None
        return gains, self._lights.exposed(sample.responses.behind(at))

    def _cost(self, at: Variant, gains: Floats, weights: Floats) -> float:
        """Return the value of the user's function, or the quantile of -ln(gain / need)."""
        means = gains.mean(axis=-1)
        # seas count equally, places by the probability of their strata
        weights = np.tile(weights, len(means)) / len(means)
        if callable(self.objective):
            return float(self.objective(at, means.ravel(), weights))
        assert at.detector is not None
        need = math.log(min(self._rates.need(at.detector), 1.0 / _DARK))
        logs = np.log(np.maximum(means, _DARK))
        return need - weighted_quantile(logs.ravel(), weights, self._quantile)

    def _logs(self, at: Variant, sample: Sample) -> Floats:
        """Return the logarithms of the quantity, see `Quantity.logs`."""
        gains, ook = self._lit(at, sample)
        return self._rates.logs(np.maximum(gains, _DARK), ook, weights=sample.weights)

    def quantity(self, at: Variant, cost: float, sample: Sample) -> float:
        """Return the quantity of the objective, as in `Optimum.value`."""
        if self.objective == "outage":
            gains, ook = self._lit(at, sample)
            assert ook is not None
            missed = gains.mean(axis=-1) < self._rates.need(ook)
            return float((missed @ sample.weights).mean())
        if callable(self.objective):
            return cost
        return -cost if self.objective == "range" else self._rates.value(-cost)

    def error(self, cost: float, stderr: float) -> float:
        """Propagate the standard error of the cost to the quantity; nan for an outage."""
        if self.objective == "outage":
            return math.nan
        if callable(self.objective) or self.objective == "range":
            return stderr
        return stderr * self._rates.slope(self._rates.value(-cost))

    def _ranges(self, at: Variant, sample: Sample) -> Floats:
        """Return the negative depths at which the averaged error rate equals the limit."""

        def there(depth: float) -> Variant:
            return at._replace(link=at.link.at_depth(depth))

        # each group moves the depth by one step of Newton, with the fall of the whole sample
        depth, _, fall = range_of(lambda at: float(self._logs(there(at), sample)[0]), at.link)
        return -depth - self._logs(there(depth), sample) / fall


_POSITIONS = 12  # of the receiver over each of several seas
_GOLDEN = math.pi * (3.0 - math.sqrt(5.0))  # azimuths that fill a disk evenly
_CANDIDATES = 64  # whose gains are kept
_CASES = 6  # candidates whose arrivals are kept for other fields of view


_EDGE = math.radians(2.0)  # more than a facet is seen under
_SMALL = 1e-4  # share of the light

REWEIGHED = ("receiver.fov_deg", "transmitter.half_angle_deg")
"""Variables for which the arrivals stay: the view cuts them off, a lamp in the water weighs them
again."""


def _by_edge(arrivals: Light, half_deg: float) -> NDArray[np.bool_]:
    """Return a mask of arrivals at the edge of the field of view, all False if negligible."""
    off = np.abs(arrivals.angle - math.radians(half_deg))
    near_edge = (arrivals.facet >= 0) & (off < _EDGE)
    return near_edge & (arrivals.weight[near_edge].sum() > _SMALL * arrivals.weight.sum())


class Sample(Restored):
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
    reweighed : tuple of str
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
        reweighed: tuple[str, ...],
    ) -> None:
        if flight is not None:
            flight = flight._replace(wind=campaign.wind_of(flight))
        self.inputs = (campaign.alone, realizations, hover_std, flight, reweighed)
        link, self._seed = campaign.link, campaign.run.seed
        self._flight, self._start, self._reweighed = flight, link, reweighed
        random = isinstance(campaign.surface, SeededSurface)
        self._seas = realizations if random else 1
        self._places = 1
        if flight is not None or any(hover_std):
            self._places = _POSITIONS if random else realizations
        self._draw(campaign, hover_std)
        uav = flight and flight.uav
        self._near = Neighbours(
            campaign, self._seas, phases=random, fading=True,
            meshes_kept=self._seas, around=self._spread(link, uav, 0),
        )  # fmt: skip
        # without such variables only the response asks for arrivals, and of a few seas
        traced = self._seas if reweighed else min(self._seas, MOST_SEAS)
        self._lights = lru_cache(_CASES * traced)(self._light)
        self.responses = Responses(self.some_light, Variant(link, None, uav=uav))
        self._known = lru_cache(_CANDIDATES)(self._kept)
        self._identity = {
            "realizations": realizations,
            "hover_std": hover_std,
            "flight": flight and campaign.of_flight(flight),
            "reweighed": list(reweighed),
        }

    def _draw(self, campaign: Campaign, hover_std: tuple[float, float]) -> None:
        """Draw places, their weights and the winds of all seas."""
        flight, m = self._flight, self._places
        rng = np.random.default_rng([self._seed, 1])
        # beyond r lies a share exp(-r^2 / 2) of a normal law of two axes; rings by its inverse
        edges = (1.0 - np.arange(m + 1) / m) ** 2
        share = rng.random() if m == 1 else 0.5
        beyond = edges[1:] + share * (edges[:-1] - edges[1:])
        radius = np.sqrt(-2.0 * np.log(beyond)) if m > 1 else np.zeros(1)
        # steps of the golden angle spread any number of places evenly over the rings
        azimuth = 2.0 * math.pi * rng.random() + _GOLDEN * np.arange(m)
        places = radius[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        self._offsets = places * np.array(hover_std)
        self.weights = edges[:-1] - edges[1:]
        if flight is not None:
            wind, seed = campaign.wind_of(flight), realization_seed(self._seed, 0)
            self._winds = wind.sample_wind(self._seas * m, seed).reshape(self._seas, m, 3)

    def _spread(self, link: Link, uav: Uav | None, i: int) -> Link:
        """Return a link with a copy of its end in the air at each place over sea i."""
        name, end = link.air_end
        if end.tilt_deg != 0.0 and uav is not None:
            raise Refused(f"{name}.tilt_deg", end.tilt_deg, "0: the aircraft tilts it")
        tilts = None if uav is None else uav.tilt(self._winds[i])
        ends = []
        for k, (x, y) in enumerate(self._offsets.tolist()):
            there = end.replace(position=(end.position[0] + x, end.position[1] + y))
            if tilts is not None:
                angle, azimuth = math.degrees(tilts.angle[k]), math.degrees(tilts.azimuth[k])
                there = there.replace(tilt_deg=angle, tilt_azimuth_deg=azimuth)
            ends.append(there)
        return link.model_copy(update={name: tuple(ends)})

    def gains(self, at: Variant) -> Floats:
        """Return the gains of a candidate, shape (seas, places, shifts).

        They are kept, in the store as well: keys of the detector need no new light.
        """
        return self._known(at.link, None if self._flight is None else at.uav)

    def _kept(self, link: Link, uav: Uav | None) -> Floats:
        """Return the gains of a candidate from the store, or compute them."""
        parts = [link.model_dump(mode="json"), None if uav is None else uav.model_dump(mode="json")]
        steps = [(digest_of(parts), i) for i in range(self._seas)]

        def setup() -> Callable[[tuple[str, int]], Floats]:
            return lambda step: self._over_sea(link, uav, step[1])

        name = f"candidates of seed {self._seed}"
        places = sum(len(at.receivers) for at in self._links(link, uav, 0))
        gains = self._near.campaign.evaluate(
            setup, steps, name, self._identity, lambda step: (places, SHIFTS)
        )
        return np.array(list(gains))

    def _over_sea(self, link: Link, uav: Uav | None, i: int) -> Floats:
        """Return the gains of a candidate over sea i, shape (places, shifts)."""
        links, frozen, mesh = self._links(link, uav, i), self._near.frozen, self._near.mesh(i)
        if not self._reweighed:
            return np.concatenate([frozen.gains(at, mesh) for at in links])
        lights, per_place = iter(self.arrivals(link, uav, i)), []
        for at in links:
            at_place = list(islice(lights, len(at.receivers)))
            # a facet at the edge of a view is cut as a whole, or not: its light is integrated again
            cut = [_by_edge(arrivals, 0.5 * link.receivers[0].fov_deg) for arrivals in at_place]
            facets = [arrivals.facet[near] for arrivals, near in zip(at_place, cut, strict=True)]
            exact = frozen.unscattered(at, mesh, facets) if any(map(len, facets)) else None
            for r, arrivals in enumerate(at_place):
                row = arrivals.by_shift(np.where(cut[r], 0.0, self._factor(link, arrivals)))
                per_place.append(row if exact is None else row + exact[r])
        return np.array(per_place)

    def arrivals(self, link: Link, uav: Uav | None, i: int) -> list[Light]:
        """Return the arrivals of a candidate at all places over sea i, before they are reweighted.

        Variables that only weigh it are those of the start.
        """
        for name in self._reweighed:
            link = link.replace(name, Variant(self._start, None).value(name))
        return self._lights(link, uav, i)

    def _light(self, link: Link, uav: Uav | None, i: int) -> list[Light]:
        return [
            arrivals for at in self._links(link, uav, i) for arrivals in self._near.arrivals(at, i)
        ]

    @held
    def some_light(self, at: Variant) -> list[Light]:
        """Return the arrivals of a candidate over a few seas, for its impulse response."""
        link, uav = at.link, None if self._flight is None else at.uav
        seas, threads = range(min(MOST_SEAS, self._seas)), self._near.campaign.threads
        over_each = ordered_map(lambda i: self.arrivals(link, uav, i), seas, threads)
        lights = []
        for arrivals, weight in zip(chain.from_iterable(over_each), cycle(self.weights)):
            factor = weight * self._factor(link, arrivals) if self._reweighed else weight
            lights.append(arrivals._replace(weight=factor * arrivals.weight))
        return lights

    def _links(self, link: Link, uav: Uav | None, i: int) -> list[Link]:
        """Return the links with the ends in the air of a candidate over sea i."""
        spread = self._spread(link, uav, i)
        if link.direction == "up":
            return [spread]
        # the light of lamps at several places would add up
        return [link.model_copy(update={"transmitter": lamp}) for lamp in spread.transmitters]

    def _factor(self, link: Link, arrivals: Light) -> Floats:
        """Return the weights of arrivals for a candidate, relative to the start."""
        half = math.radians(0.5 * link.receivers[0].fov_deg)
        # arrivals are those of the widest view
        factor = (arrivals.angle <= half).astype(float)
        old, new = self._start.transmitters[0], link.transmitters[0]
        if isinstance(old, Led) and isinstance(new, Led):
            lamp = np.maximum(arrivals.lamp, 1e-300)
            # a Lambertian lamp of order m emits (m + 1) / (2 pi) cos^m
            factor *= (new.order + 1.0) / (old.order + 1.0) * lamp ** (new.order - old.order)
        return factor
