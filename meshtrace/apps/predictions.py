"""Measurements of a link, and their predictions with derivatives by unknown parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused, require_array, require_between, within
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS
from meshtrace.studies import Variant
from meshtrace.studies.background import Lights
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.cluster import Restored
from meshtrace.studies.keys import Parameter
from meshtrace.studies.neighbours import (
    WATER,
    Light,
    Neighbours,
    Quantity,
    has_moments,
    in_water,
    moments,
)
from meshtrace.studies.response import Responses
from meshtrace.studies.store import digest_of

OF_DETECTOR = ("power", "ber")
"""Measurements behind the optics: received power [W], and bit error rate."""

SCALE = "scale"
"""Unknown factor of all measurements: the calibration of the receiver."""

_LARGEST = 64  # measurements whose chains are kept
_LIGHTS = 3  # of each: the base and the sides of a difference
_STEP = 0.01  # of differences in the logarithm


class Measurements(NamedTuple):
    """Gains, counts, powers or error rates with errors, and the keys that belong to each."""

    value: Floats  # (n,)
    stderr: Floats  # (n,) nan of counts, which follow the law of Poisson
    keys: list[dict[str, Any]]  # (n,) values by dotted key
    names: list[str]  # (n,) quantities

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Whether each measurement is a count."""
        return np.isnan(self.stderr)


def read_measurements(source: Any) -> Measurements:
    """Return measurements from rows, or from a table of columns.

    Raises
    ------
    Refused
        If a value or an error is missing or not above 0, or no count is.
    """
    table = _rows(source)
    if not table:
        raise Refused("measurements", Described("empty"), "at least one")
    values, errors, keys, names = [], [], [], []
    for i, row in enumerate(table):
        rest, path = dict(row), f"measurements[{i}]"
        # counts without an error follow the law of Poisson, whose error is that of the prediction
        if "counts" in rest and "stderr" not in rest and "gain" not in rest:
            name, counts = "counts", rest.pop("counts")
            allowed = "a number >= 0"
            values.append(require_between(counts, 0.0, math.inf, f"{path}.counts", "[)", allowed))
            errors.append(math.nan)
        else:
            name = next((k for k in ("gain", "counts", *OF_DETECTOR) if k in rest), "gain")
            for key, numbers in ((name, values), ("stderr", errors)):
                value, allowed = rest.pop(key, None), "a number > 0"
                numbers.append(
                    require_between(value, 0.0, math.inf, f"{path}.{key}", allowed=allowed)
                )
        keys.append(rest)
        names.append(name)
    if not any(values):
        raise Refused("measurements.counts", Described("all 0"), "a count > 0 in one of them")
    return Measurements(np.array(values), np.array(errors), keys, names)


def _rows(source: Any) -> list[Mapping[str, Any]]:
    """Convert a table of columns to rows; return rows unchanged."""
    if isinstance(source, Mapping) or hasattr(source, "columns"):
        if not all(isinstance(key, str) for key in source):
            raise Refused("measurements", Described("a column without name"), "texts as keys")
        columns = {
            key: np.atleast_1d(
                require_array(source[key], f"measurements.{key}", "a column of values", None)
            ).tolist()
            for key in source
        }
        n = max((len(column) for column in columns.values()), default=0)
        uneven = [key for key, column in columns.items() if len(column) not in (1, n)]
        if uneven:
            raise Refused(f"measurements.{uneven[0]}", Described("too short"), f"{n} values")
        return [{k: c[i % len(c)] for k, c in columns.items()} for i in range(n)]
    if isinstance(source, Sequence) and all(isinstance(row, Mapping) for row in source):
        return list(source)
    raise Refused("measurements", Described(type(source).__name__), "rows, or a table")


class Prediction(NamedTuple):
    """Predicted measurements with their derivatives and errors."""

    log: Floats  # (n,) ln of the measurement
    slope: Floats  # (n, unknowns) its derivatives by ln p, or by p for offsets and angles
    covariance: Floats  # (n, n) of the logarithms, by the chains


class Predictor(Restored):
    """Predictions of all measurements with common chains.

    Parameters
    ----------
    campaign : Campaign
        The link, the surface and the options.
    start : Variant
        The link with its detector and daylight at the starting values.
    data : Measurements
        Measurements with the keys that belong to each.
    unknowns : list of Parameter
        Unknown parameters of the link, and the scale; a and b of uniform water weigh the arrivals
        again.
    """

    def __init__(
        self, campaign: Campaign, start: Variant, data: Measurements, unknowns: list[Parameter]
    ) -> None:
        self.inputs = (campaign.alone, start, data, unknowns)
        self._campaign, self.data, self._names = campaign, data, data.names
        self._lights, self._rates = Lights(campaign), Quantity("ber", 1e-3)
        self._of_link = np.array([p.name != SCALE for p in unknowns])
        self._unknowns = [p for p in unknowns if p.name != SCALE]
        self._starts = []
        for i, (row, name) in enumerate(zip(data.keys, data.names, strict=True)):
            at = start
            if name in OF_DETECTOR and start.detector is None:
                raise Refused(f"measurements[{i}].{name}", Described("no [detector]"), "a detector")
            with within("measurements", i):
                for key, value in row.items():
                    at = at.set(key, value)
            ends = len(at.link.receivers)
            if ends != 1:
                raise Refused("receiver", Described(f"{ends} apertures"), "one aperture")
            self._starts.append(at)
        # a and b enter the weights of paths alone: their derivatives are moments of one run
        self._quick = has_moments(start.link)
        alone = campaign.alone
        self._near = lru_cache(_LARGEST)(lambda i: Neighbours(alone.for_link(self._starts[i].link)))
        self._light = lru_cache(_LIGHTS * _LARGEST)(
            lambda i, x: self._near(i).arrivals(self._at(i, x).link, 0)[0]
        )
        self._responses = lru_cache(_LARGEST)(
            lambda i: Responses(
                lambda at: [self._near(i).arrivals(at.link, 0)[0]], self._starts[i], aligned=True
            )
        )
        known = [at.link.model_dump(mode="json") for at in self._starts]
        names = [p.name for p in self._unknowns]
        self._identity = {"measured": digest_of(known), "unknown": names}

    def at(self, x: Floats) -> Prediction:
        """Return the predictions at a point: ln(p / start), or p - start for offsets and angles."""
        point = tuple(x[self._of_link].tolist())
        steps = [(i, *point) for i in range(len(self._starts))]
        each = self._campaign.evaluate(
            lambda: self._one, steps, "predictions", self._identity,
            lambda step: (SHIFTS + len(point),),
        )  # fmt: skip
        gains = np.array(list(each))
        shifts, slopes = gains[:, :SHIFTS], gains[:, SHIFTS:]
        means = shifts.mean(axis=1)
        off = shifts / means[:, None] - 1.0
        # groups of chains are independent, and common to all predictions: so are their errors
        covariance = off @ off.T / (SHIFTS * (SHIFTS - 1))
        by_all = np.ones((len(gains), len(x)))
        by_all[:, self._of_link] = slopes
        prediction = Prediction(np.log(means) + x[~self._of_link].sum(), by_all, covariance)
        behind = any(name in OF_DETECTOR for name in self._names)
        return self._detected(point, prediction) if behind else prediction

    def _detected(self, x: tuple[float, ...], gains: Prediction) -> Prediction:
        """Return the predicted powers and error rates from predicted gains.

        d ln q / dx = (d ln q / d ln g) (d ln g / dx) + (d ln q / dx at a fixed gain)
        """
        n = len(self._starts)
        # a scale of all gains adds to their logarithms, and needs no prediction
        logs, growth, slopes = gains.log.copy(), np.ones(n), np.zeros((n, len(x)))
        for i, gain in enumerate(gains.log):
            logs[i] = self._of_gain(i, x, gain)
            # at a given light, a difference is free of the noise of the chains
            low, high = (self._of_gain(i, x, gain + step) for step in (-_STEP, _STEP))
            growth[i] = (high - low) / (2.0 * _STEP)
            for k in range(len(x)):
                (below, above), width = self._sides(x, k)
                slopes[i, k] = self._of_gain(i, above, gain) - self._of_gain(i, below, gain)
                slopes[i, k] /= 2.0 * width
        slope = growth[:, None] * gains.slope
        slope[:, self._of_link] += slopes
        return Prediction(logs, slope, gains.covariance * np.outer(growth, growth))

    def _sides(self, x: tuple[float, ...], k: int) -> tuple[list[tuple[float, ...]], float]:
        """Return the points one step of unknown k below and above x, and the step."""
        p = self._unknowns[k]
        width = p.step if p.absolute else _STEP
        return [(*x[:k], x[k] + side * width, *x[k + 1 :]) for side in (-1.0, 1.0)], width

    def _of_gain(self, i: int, x: tuple[float, ...], log_gain: float) -> float:
        """Return the logarithm of a measurement at a gain."""
        name, at = self._names[i], self._at(i, x)
        if name not in OF_DETECTOR or at.detector is None:
            return log_gain
        power = log_gain + math.log(float(at.detector.received_power(1.0)))
        receiver = self._lights.exposed(self._responses(i).behind(at)) if name == "ber" else None
        return power if receiver is None else float(self._rates.law(receiver)(np.array([power]))[0])

    def _one(self, step: tuple[Any, ...]) -> Floats:
        """Return gains by shift and logarithmic slopes of one measurement."""
        number, *values = step
        x = tuple(values)
        gains = self._gains(number, x)
        slopes = np.zeros(len(x))  # none by keys behind the light
        for i, p in enumerate(self._unknowns):
            if self._quick and p.name in WATER:
                change = moments(*self._weighed(number, x))[WATER.index(p.name)]
                slopes[i] = change.mean() / gains.mean()
            elif p.name.split(".")[0] not in ("detector", "daylight"):
                sides, width = self._sides(x, i)
                low, high = (self._gains(number, side).mean() for side in sides)
                slopes[i] = math.log(high / low) / (2.0 * width)
        return np.concatenate([gains, slopes])

    def _gains(self, number: int, x: tuple[float, ...]) -> Floats:
        _, arrivals = self._weighed(number, x)
        gains = arrivals.by_shift(np.ones(len(arrivals.weight)))
        if not gains.mean() > 0.0:
            raise Refused("measurements", Described("a dark link"), "links with light")
        return gains

    def _weighed(self, number: int, x: tuple[float, ...]) -> tuple[Link, Light]:
        """Return a measured link and its arrivals for values of the unknowns."""
        quick = [self._quick and p.name in WATER for p in self._unknowns]
        # the light at the start serves all values of a and b, other unknowns trace their own
        traced = tuple(None if q else step for q, step in zip(quick, x, strict=True))
        link, arrivals = self._at(number, x).link, self._light(number, traced)
        old, new = self._at(number, traced).link.water, link.water
        same = (old.a, old.b) == (new.a, new.b)
        return link, arrivals if same else in_water(arrivals, old, new)

    def _at(self, number: int, x: tuple[float | None, ...]) -> Variant:
        """Return a measured link with the unknowns that have a value."""
        pairs = zip(self._unknowns, x, strict=True)
        values = ((p, p.moved(step)) for p, step in pairs if step is not None)
        return self._starts[number].at(values)
