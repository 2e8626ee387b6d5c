"""Choice of the estimator of the scattered light, receiver by receiver.

Chains that are aimed at the aperture are efficient where a lamp lights much of the surface and
light arrives by small angles; for beams narrower than the spread by random slopes, large angles
and many scatterings joined photons are. Pilots of both over still water decide; those of the
chains also allot their numbers to the orders.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.chains.sets import TURBID, ChainDrawer, ChainSet
from meshtrace.engine.photons.connections import SCATTERED
from meshtrace.engine.photons.joined import JoinedParts
from meshtrace.engine.setup.forced_link import ForcedLink
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.stored import SHIFTS

_PILOT = 128  # chains of each order in the first pilot
_PILOT_GROWTH, _PILOT_STEPS = 4, 3  # further pilots of an order without a hit
_FLOOR = 0.2  # share of the chains allotted by the Poisson law alone

Method = Literal["chains", "joined"]

PILOT_PHOTONS = 8192
"""Joined photons of a pilot."""

_EFFICIENT = 4.0  # relative variance of a chain up to which no other estimator is tried
_COST = 3.0  # time of a chain over that of a joined photon
_TURBID_COST = 2.0  # the same in turbid water, times the scatterings on the way
_HALF = 0.5  # of the light of the photons: chains that see less are not trusted, however sure
_SURE = 10.0  # means over standard errors: that of 100 equal samples
_DOUBT = 3.5  # standard errors by which the pilots may differ: beyond, chains miss light


class Pilot(NamedTuple):
    """Statistics of pilot chains over a flat sea, by receiver and order from 1 on."""

    chains: NDArray[np.int64]  # (orders,)
    mean: Floats  # (receivers, orders)
    spread: Floats  # (receivers, orders) standard deviation of one chain
    scored: NDArray[np.int64]  # (receivers, orders) chains with a score > 0

    def of(self, receivers: NDArray[np.bool_]) -> Pilot:
        """Return the pilot of some receivers."""
        rows = (self.mean[receivers], self.spread[receivers], self.scored[receivers])
        return Pilot(self.chains, *rows)

    def joined(self, power: Floats) -> Pilot:
        """Return the pilot of one receiver with targets of shares of the power."""
        mean, spread = (power @ self.mean)[None], (power @ self.spread)[None]
        return Pilot(self.chains, mean, spread, self.scored.max(axis=0)[None])


def pilot(
    drawer: ChainDrawer,
    source: int,
    seed: tuple[int, int],
    score: Callable[[ChainSet], Floats],
    receivers: int,
    threads: int,
) -> Pilot:
    """Return the statistics of pilot chains by their scores, shape (receivers, chains).

    Orders without a score get more of them.
    """
    orders = drawer.last_order(source)
    chains = np.zeros(orders, np.int64)
    mean, spread = np.zeros((receivers, orders)), np.zeros((receivers, orders))
    scored = np.zeros((receivers, orders), np.int64)

    def scores_of(order: int) -> Floats:
        n = _PILOT // SHIFTS
        for step in range(_PILOT_STEPS):
            chosen = drawer.draw(source, order, n, (*seed, order, 2 + step))
            scores = score(chosen)
            if np.count_nonzero(scores, axis=1).min() >= 4:
                break
            n *= _PILOT_GROWTH
        return scores

    for k, scores in enumerate(ordered_map(scores_of, range(1, orders + 1), threads)):
        chains[k], scored[:, k] = scores.shape[1], np.count_nonzero(scores, axis=1)
        mean[:, k], spread[:, k] = scores.mean(axis=1), scores.std(axis=1)
    return Pilot(chains, mean, spread, scored)


def allotment(photons: int, expected: float, found: Pilot, gain: Floats) -> NDArray[np.int64]:
    """Return the number of chains of each order and shift.

    Parameters
    ----------
    photons : int
        Chains in all.
    expected : float
        Scatterings expected on the way.
    found : Pilot
        Pilot of the receivers that rest on the chains.
    gain : ndarray, shape (receivers,)
        Gain of each receiver, which its errors are compared with.

    Notes
    -----
    The sum over the receivers of the squared relative errors is smallest for
    n_K ~ sqrt(sum_r (sigma_rK / h_r)^2 / cost_K). A share of the chains follows the Poisson law
    of the number of scatterings instead: an order that its pilot missed keeps a share.
    """
    from scipy.stats import poisson

    order = np.arange(1, len(found.chains) + 1)
    cost = 1.0 + 0.3 * order
    light = np.maximum(gain, 1e-300)[:, None]
    # sorted, so that rounding does not depend on the order of the receivers
    share = np.sqrt(np.sort(np.square(found.spread / light) / cost, axis=0).sum(axis=0))
    law = poisson.pmf(order, max(expected, 1e-6))
    law = law / max(law.sum(), 1e-300)
    total = share.sum()
    mixed = law if total == 0.0 else (1.0 - _FLOOR) * share / total + _FLOOR * law
    return np.maximum(np.ceil(mixed * photons / SHIFTS), 2).astype(np.int64)


class ScatteredPilot(NamedTuple):
    """Mean of the scattered gain and variance of one sample, by receiver."""

    mean: Floats
    variance: Floats
    stderr: Floats

    @classmethod
    def of(cls, photons: JoinedParts) -> ScatteredPilot:
        """Return the pilot of joined photons, without light that the surface reflects first."""
        mean, square = photons.parts[SCATTERED], photons.square[SCATTERED]
        return cls(mean, square - mean**2, photons.stderr[SCATTERED])


def chain_pilot(pilots: list[Pilot], link: ForcedLink) -> ScatteredPilot:
    """Combine the pilots of the sources, for the optimal allotment of chains.

    With n_K ~ sigma_K the variance times the number of chains is (sum_K sigma_K)^2.
    """
    mean = link.by_receiver(np.array([p.mean.sum(axis=1) for p in pilots]))
    spread = link.by_receiver(np.array([p.spread.sum(axis=1) for p in pilots]))
    noise = [(p.spread**2 / np.maximum(p.chains, 1)).sum(axis=1) for p in pilots]
    square = link._replace(power=link.power**2).by_receiver(np.array(noise))
    return ScatteredPilot(mean, spread**2, np.sqrt(square))


def is_clear(chains: ScatteredPilot) -> NDArray[np.bool_]:
    """Return the receivers that chains serve well enough to skip the comparison.

    Tails of chains that miss the aperture may be so small that their variance underflows.
    """
    square = chains.mean**2
    return (square > np.finfo(float).tiny) & (chains.variance <= _EFFICIENT * square)


def chain_cost(expected: float) -> float:
    """Return the time of a chain over that of a joined photon.

    In turbid water photons are scattered many times more than light on the way.
    """
    return _COST if expected < TURBID else _TURBID_COST / expected


def choose(chains: ScatteredPilot, photons: ScatteredPilot, expected: float = 0.0) -> list[Method]:
    """Choose the estimator with the smaller variance times time for each receiver.

    Chains that miss much of the light have a small variance: where the photons find twice
    the light or more than chance allows, or few chains bring all of it, chains are not trusted.
    With many scatterings `expected` on the way few photons bring much of the light: twice the
    light counts there only beyond two of their standard errors.
    """
    missed = photons.mean - chains.mean > _DOUBT * np.hypot(photons.stderr, chains.stderr)
    certain = 2.0 * photons.stderr if expected >= TURBID else 0.0
    missed |= (chains.mean < _HALF * photons.mean) & (photons.mean - chains.mean > certain)
    slower = chains.variance * chain_cost(expected) > photons.variance
    few = chains.mean < _SURE * chains.stderr
    surer = photons.stderr * chains.mean < chains.stderr * photons.mean
    better = (photons.mean > 0.0) & (missed | slower | (few & surer) | (chains.mean <= 0.0))
    return ["joined" if b else "chains" for b in better]
