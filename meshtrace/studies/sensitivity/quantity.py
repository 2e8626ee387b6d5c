"""Quantities of a link that sensitivities are taken of, and that optimisations improve."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq
from scipy.special import ndtr

from meshtrace.comms.budget import required_gain
from meshtrace.comms.capacity import capacity
from meshtrace.comms.ook import OokLink
from meshtrace.errors import Refused, require_word
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS
from meshtrace.studies.neighbours import without_each
from meshtrace.studies.sensitivity.result import DECIBELS

Of = Literal["gain", "ber", "outage", "range", "margin", "capacity"]

FADES = ("ber", "outage", "range", "capacity")
"""Quantities that depend on the distribution of the gain over seas."""

_NODES = 60  # of the table of informations
_POINTS = 200  # of the table of error rates
_LEAST_OUTAGES = 30
_LEAST_SEAS = 8


class Quantity:
    """A quantity of a link over seas.

    Parameters
    ----------
    of : {"gain", "ber", "outage", "range", "margin", "capacity"}
        Mean gain; bit error rate averaged over the seas; probability that the bit error rate of a
        sea misses the limit; depth at which the averaged rate meets it, or else at which the mean
        gain is that of the link; mean over required gain; rate after hard decisions, averaged
        over the seas (`comms.capacity`).
    limit : float
        Bit error rate of a working link.

    Notes
    -----
    `log` is the natural logarithm of the quantity; for "range" that of the factor by which the
    light exceeds the need, whose zero is the range.
    """

    def __init__(self, of: Of, limit: float) -> None:
        require_word(of, get_args(Of), "of")
        self.of, self.limit = of, limit
        self._laws: dict[str, Callable[[Floats], Floats]] = {}
        self._carried: dict[str, Callable[[Floats], Floats]] = {}
        self._needs: dict[str, float] = {}

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        return {"range": "m", "margin": "dB", "capacity": "bit s-1"}.get(self.of, "1")

    def log(self, gains: Floats, ook: OokLink | None, tilt: Floats | None = None) -> float:
        """Return the logarithm of the quantity for gains (seas, shifts), tilt factors (seas, m)."""
        means = gains.mean(axis=1)
        if not means.min() > 0.0:
            raise Refused("link", float(means.min()), "a gain > 0 over each sea")
        if self.of == "gain" or ook is None:
            return math.log(means.mean())
        if tilt is not None:
            means = (means[:, None] * tilt).ravel()
        if self.of == "margin":
            return math.log(means.mean() / self._need(ook))
        if self.of == "outage":
            return self._outage(np.log(means / self._need(ook)))
        logs = np.log(ook.received_power(means))
        if self.of == "ber":
            return math.log(np.exp(self.law(ook)(logs)).mean())
        if self.of == "capacity":
            return math.log(max(ook.bit_rate * float(self.information(ook)(logs).mean()), 1e-300))
        law = self.law(ook, rising=False)
        goal = math.log(self.limit)
        spread = 30.0

        def excess(shift: float) -> float:
            return math.log(np.exp(law(logs + shift)).mean()) - goal

        if not excess(-spread) > 0.0 > excess(spread):
            raise Refused("limit", self.limit, "a bit error rate that some power reaches")
        return -float(brentq(excess, -spread, spread, xtol=1e-9))

    def logs(self, gains: Floats, ook: OokLink | None, tilt: Floats | None = None) -> Floats:
        """Return the logarithm for all gains and for the groups of the jackknife."""
        found = []
        for i, group in enumerate(without_each(gains)):
            sea = i - 1 - SHIFTS  # that is left out
            kept = tilt if tilt is None or sea < 0 else np.delete(tilt, sea, axis=0)
            found.append(self.log(group, ook, kept))
        return np.array(found)

    def value(self, log: float) -> float:
        """Return the quantity from its logarithm; for "range" the factor of the light."""
        return DECIBELS * log if self.of == "margin" else math.exp(log)

    def slope(self, value: float) -> float:
        """Return d quantity / d log; for "range" 1."""
        return {"margin": DECIBELS, "range": 1.0}.get(self.of, value)

    def _outage(self, logs: Floats) -> float:
        """Return the logarithm of the outage from the logarithms of gain over need.

        With 30 outages at least: smoothed by a normal kernel. Otherwise: lognormal law. No light,
        out of the field of view, is an outage beside either.
        """
        if len(logs) < _LEAST_SEAS - 1:
            raise Refused("realizations", len(logs), f">= {_LEAST_SEAS} for outages")
        lit = logs[np.isfinite(logs)]
        spread = float(lit.std(ddof=1))
        if np.count_nonzero(lit < 0.0) >= _LEAST_OUTAGES:
            width = 1.06 * spread * len(lit) ** -0.2
            share = float(ndtr(-lit / width).mean())
        else:
            share = float(ndtr(-lit.mean() / spread))
        share = 1.0 - (1.0 - share) * len(lit) / len(logs)
        return math.log(max(share, 1e-300))

    def _need(self, ook: OokLink) -> float:
        key = ook.model_dump_json()
        if key not in self._needs:
            self._needs[key] = required_gain(ook, self.limit)
        return self._needs[key]

    def information(self, ook: OokLink) -> Callable[[Floats], Floats]:
        """Return the information of a bit after hard decisions over ln power [bit], tabulated."""
        key = ook.model_dump_json()
        if key not in self._carried:
            self._carried[key] = _information(ook)
        return self._carried[key]

    def law(self, ook: OokLink, rising: bool = True) -> Callable[[Floats], Floats]:
        """Return ln BER over ln power, tabulated once for each receiver.

        Without `rising` rates of an overloaded receiver stay at their minimum.
        """
        key = f"{rising}{ook.model_dump_json()}"
        if key not in self._laws:
            middle = math.log(ook.required_power(self.limit))
            nodes = np.linspace(middle - 9.0, middle + 7.0, _POINTS)
            rates = np.log(np.maximum(ook.ber(np.exp(nodes)), 1e-300))
            table = PchipInterpolator(nodes, rates if rising else np.minimum.accumulate(rates))
            self._laws[key] = lambda logs: table(np.clip(logs, nodes[0], nodes[-1]))
        return self._laws[key]


def _information(ook: OokLink) -> Callable[[Floats], Floats]:
    """Return the information of a bit over ln power, by interpolation between 60 powers."""
    middle = ook.required_power(0.1)
    if math.isinf(middle):  # a closed eye
        return np.zeros_like
    nodes = math.log(middle) + np.linspace(-9.0, 7.0, _NODES)
    gains = np.exp(nodes) / float(ook.received_power(1.0))
    carried = [capacity(ook, gain).hard / ook.bit_rate for gain in gains]
    table = PchipInterpolator(nodes, carried)
    return lambda logs: table(np.clip(logs, nodes[0], nodes[-1]))
