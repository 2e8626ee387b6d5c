"""Common seas, hover errors, tilts and chains for averages over candidates of a link."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np

from meshtrace.engine.parts import Light
from meshtrace.errors import Refused
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Led, Link
from meshtrace.mesh import RandomSea
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign, same
from meshtrace.studies.neighbours import Neighbours
from meshtrace.studies.store import digest_of
from meshtrace.uav.airframe import Flight

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
        random = isinstance(campaign.surface, RandomSea)
        self._seas = realizations if random else 1
        self._places = 1
        if flight is not None or any(hover_std):
            self._places = _POSITIONS if random else realizations
        self._draw(campaign, hover_std)
        self._near = Neighbours(
            campaign, self._seas, phases=random, fading=True,
            kept=self._seas, around=self._spread(link, 0),
        )  # fmt: skip
        self._lights = lru_cache(_CASES)(self._light)
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

    def _apart(self, link: Link, i: int) -> list[Link]:
        """Return the links whose receivers are those of all places over sea i.

        Lamps at several places are several links: their light would add up.
        """
        spread = self._spread(link, i)
        if link.direction != "down":
            return [spread]
        return [link.model_copy(update={"transmitter": lamp}) for lamp in spread.transmitters]

    def _light(self, link: Link) -> list[Light]:
        """Return the light at each place over each sea."""
        return self._over_seas(self._near.light, link)

    def gains(self, link: Link) -> Floats:
        """Return the gains of a candidate, kept in the store, shape (seas * places, shifts)."""
        candidate = digest_of(link.model_dump(mode="json"))
        name = f"candidates of seed {self._seed}"
        evaluate = partial(same, lambda _: self._computed(link))
        (found,) = self._near.campaign.over(evaluate, [candidate], name, self._identity)
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
            if not any(_cuts_facets(light, half) for light in lights):
                return np.array([light.by_shift(self._factor(link, light)) for light in lights])
            sampled = [self._factor(link, light) * (light.shift >= 0) for light in lights]
            rows = [light.by_shift(part) for light, part in zip(lights, sampled, strict=True)]
            return np.array(rows) + np.array(self._over_seas(self._near.unscattered, link))[:, None]
        return np.array(self._over_seas(self._near.gains, link))

    def _over_seas(self, evaluate: Callable[[Link, int], Any], link: Link) -> list[Any]:
        """Return the values of a candidate at all places over all seas."""

        def one(i: int) -> list[Any]:
            return [value for at in self._apart(link, i) for value in evaluate(at, i)]

        return [value for row in self._near.map(one) for value in row]

    def _factor(self, link: Link, light: Light) -> Floats:
        """Return the weights of arrivals at a candidate over those at the start."""
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


def _cuts_facets(light: Light, half: float) -> bool:
    """Return whether the edge of a view cuts facets with unscattered light that counts."""
    near = (light.shift < 0) & (np.abs(light.angle - half) < _EDGE)
    return bool(light.weight[near].sum() > _SMALL * light.weight.sum())
