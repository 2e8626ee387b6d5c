"""Pilots of the chains: their scatter by order over a flat sea, and the numbers allotted by it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.stored import SHIFTS
from meshtrace.transport.chain_sets import ChainDrawer

_PILOT = 128  # chains of each order in the first pilot
_PILOT_GROWTH, _PILOT_STEPS = 4, 3  # further pilots of an order without a hit
_FLOOR = 0.2  # share of the chains allotted by the Poisson law alone


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
    drawer: ChainDrawer, source: int, seed: tuple[int, int], receivers: int, threads: int
) -> Pilot:
    """Return the statistics of pilot chains; orders without a score get more of them."""
    orders = drawer.last_order(source)
    chains = np.zeros(orders, np.int64)
    mean, spread = np.zeros((receivers, orders)), np.zeros((receivers, orders))
    scored = np.zeros((receivers, orders), np.int64)

    def scores_of(order: int) -> Floats:
        n = _PILOT // SHIFTS
        for step in range(_PILOT_STEPS):
            chosen = drawer.draw(source, order, n, (*seed, order, 2 + step))
            scores = drawer.flat_scores(source, chosen)
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
