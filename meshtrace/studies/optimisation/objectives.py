"""Objectives of an optimisation as numbers to be minimised."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np

from meshtrace.comms.budget import required_gain
from meshtrace.comms.ook import OokLink
from meshtrace.errors import Refused
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.studies.sensitivity.quantities import Quantity

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
    """An objective and the quantity that it stands for.

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
        """Return the standard error of the quantity of that of the cost; of an outage nan."""
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
