"""Measured gains, and the model that predicts them for any values of the unknowns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.backward.view import only_aperture
from meshtrace.engine.parts import Light
from meshtrace.errors import Described, Refused, require_array, require_real
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign, same
from meshtrace.studies.neighbours import Neighbours, has_moments, moments
from meshtrace.studies.sensitivity.parameters import Parameter, Setting
from meshtrace.studies.store import digest_of

WATER = ("water.a", "water.b")
SCALE = "scale"
"""Unknown factor of all measurements: the calibration of the receiver."""

_LARGEST = 64  # measurements whose chains are kept
_LIGHTS = 3  # of each: the base and the sides of a difference
_STEP = 0.01  # of differences in the logarithm


class Measurements(NamedTuple):
    """Gains, or counts, with errors, and the values of the link that belong to each."""

    value: Floats  # (n,)
    stderr: Floats  # (n,) nan of counts, which follow the law of Poisson
    keys: list[dict[str, Any]]  # (n,) values by dotted key

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Whether each measurement is a count."""
        return np.isnan(self.stderr)


def read_measurements(given: Any) -> Measurements:
    """Return measurements from rows, or from a table of columns.

    Raises
    ------
    Refused
        If a value or an error is missing or not above 0, or no count is.
    """
    rows: list[Mapping[str, Any]]
    if isinstance(given, Mapping) or hasattr(given, "columns"):
        columns = {
            str(key): np.atleast_1d(
                require_array(given[key], f"measurements.{key}", "a column of values", None)
            ).tolist()
            for key in given
        }
        n = max((len(column) for column in columns.values()), default=0)
        uneven = [key for key, column in columns.items() if len(column) not in (1, n)]
        if uneven:
            raise Refused(f"measurements.{uneven[0]}", Described("too short"), f"{n} values")
        rows = [{k: c[i % len(c)] for k, c in columns.items()} for i in range(n)]
    elif isinstance(given, Sequence) and all(isinstance(row, Mapping) for row in given):
        rows = list(given)
    else:
        raise Refused("measurements", Described(type(given).__name__), "rows, or a table")
    if not rows:
        raise Refused("measurements", Described("empty"), "at least one")
    values, errors, keys = [], [], []
    for i, row in enumerate(rows):
        rest, path = dict(row), f"measurements[{i}]"
        if "counts" in rest and "stderr" not in rest and "gain" not in rest:
            counts = rest.pop("counts")
            number = require_real(counts, f"{path}.counts", "a number >= 0")
            if not 0.0 <= number < math.inf:
                raise Refused(f"{path}.counts", counts, "a number >= 0")
            values.append(number)
            errors.append(math.nan)
        else:
            name = "gain" if "gain" in rest or "counts" not in rest else "counts"
            values.append(_positive(rest.pop(name, None), f"{path}.{name}"))
            errors.append(_positive(rest.pop("stderr", None), f"{path}.stderr"))
        keys.append(rest)
    if not any(values):
        raise Refused("measurements.counts", Described("all 0"), "a count > 0 in one of them")
    return Measurements(np.array(values), np.array(errors), keys)


def _positive(value: Any, path: str) -> float:
    """Return a finite number above 0; refuse any other value."""
    number = require_real(value, path, "a number > 0")
    if not 0.0 < number < math.inf:
        raise Refused(path, value, "a number > 0")
    return number


class Prediction(NamedTuple):
    """Predicted gains with their derivatives and errors."""

    log: Floats  # (n,) ln gain
    slope: Floats  # (n, unknowns) d ln gain / d unknown: of ln p, or of p for offsets and angles
    covariance: Floats  # (n, n) of ln gain, by the chains


class Model:
    """Predictions of all measurements with common chains.

    Parameters
    ----------
    campaign : Campaign
        The link at the starting values, the surface and the options.
    keys : list of dict
        Values of the link that belong to each measurement.
    unknowns : list of Parameter
        Unknown parameters; a and b of uniform water weigh the arrivals again.
    """

    def __init__(
        self, campaign: Campaign, keys: list[dict[str, Any]], unknowns: list[Parameter]
    ) -> None:
        link, self._campaign, self._unknowns = campaign.link, campaign, unknowns
        self._links = []
        for i, row in enumerate(keys):
            at = link
            for key, value in row.items():
                try:
                    at = at.replace(key, value)
                except Refused as refused:
                    raise refused.inside("measurements", i) from None
            only_aperture(at)
            self._links.append(at)
        self._quick = has_moments(link)
        alone = campaign.alone
        self._near = lru_cache(_LARGEST)(lambda i: Neighbours(alone.of(self._links[i])))
        self._light = lru_cache(_LIGHTS * _LARGEST)(self._lit)
        known = [link.model_dump(mode="json") for link in self._links]
        self._identity = {"measured": digest_of(known), "unknown": [p.name for p in unknowns]}

    def at(self, x: Floats) -> Prediction:
        """Return the predictions at a point: ln(p / start), or p - start for offsets and angles."""
        steps = [(i, *x.tolist()) for i in range(len(self._links))]
        setup = partial(same, self._one)
        rows = np.array(list(self._campaign.over(setup, steps, "predictions", self._identity)))
        shifts, slopes = rows[:, :SHIFTS], rows[:, SHIFTS:]
        means = shifts.mean(axis=1)
        off = shifts / means[:, None] - 1.0
        covariance = off @ off.T / (SHIFTS * (SHIFTS - 1))
        return Prediction(np.log(means), slopes, covariance)

    def _one(self, step: tuple[Any, ...]) -> Floats:
        """Return gains by shift and logarithmic slopes of one measurement."""
        number, *values = step
        x = tuple(values)
        gains = self._gains(number, x)
        slopes = []
        for i, p in enumerate(self._unknowns):
            if self._quick and p.name in WATER:
                at, light = self._weighed(number, x)
                slope = float(moments(at, light)[p.name].mean() / gains.mean())
            else:
                width = p.step if p.absolute else _STEP
                sides = [
                    self._gains(number, (*x[:i], x[i] + side * width, *x[i + 1 :])).mean()
                    for side in (-1.0, 1.0)
                ]
                slope = math.log(sides[1] / sides[0]) / (2.0 * width)
            slopes.append(slope)
        return np.concatenate([gains, slopes])

    def _gains(self, number: int, x: tuple[float, ...]) -> Floats:
        _, light = self._weighed(number, x)
        gains = light.by_shift(np.ones(len(light.weight)))
        if not gains.mean() > 0.0:
            raise Refused("measurements", Described("a dark link"), "links with light")
        return gains

    def _weighed(self, number: int, x: tuple[float, ...]) -> tuple[Link, Light]:
        """Return a measured link at a point of the unknowns, and its light.

        w' = w exp(-(a' - a + b' - b) L) (b' / b)^K
        """
        quick = [self._quick and p.name in WATER for p in self._unknowns]
        traced = tuple(None if q else step for q, step in zip(quick, x, strict=True))
        link, light = self._at(number, x), self._light(number, traced)
        old, new = self._at(number, traced).water, link.water
        if (old.a, old.b) != (new.a, new.b):
            factor = np.exp((old.a - new.a + old.b - new.b) * light.water)
            if new.b != old.b:
                factor *= (new.b / old.b) ** light.order
            light = light._replace(weight=light.weight * factor)
        return link, light

    def _at(self, number: int, x: tuple[float | None, ...]) -> Link:
        """Return a measured link with the unknowns that have a value."""
        setting = Setting(self._links[number], self._campaign.surface, None)
        for p, step in zip(self._unknowns, x, strict=True):
            if step is not None:
                setting = p.at(setting, p.moved(step))
        return setting.link

    def _lit(self, number: int, x: tuple[float | None, ...]) -> Light:
        return self._near(number).light(self._at(number, x), 0)[0]
