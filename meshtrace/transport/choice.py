"""Choice of the estimator of the scattered light, receiver by receiver.

Chains that are aimed at the aperture are efficient where light arrives by small angles; where it
arrives by large angles only, or after many scatterings, paths from the receiver are.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.models import Floats
from meshtrace.transport.chain_sets import TURBID
from meshtrace.transport.forced_link import ForcedLink
from meshtrace.transport.pilots import Pilot

Method = Literal["chains", "adjoint"]

PILOT_PATHS = 2048
"""Adjoint paths of a pilot for each source and receiver."""

_EFFICIENT = 4.0  # relative variance of a chain up to which no other estimator is tried
_COST = 3.0  # time of a chain over that of an adjoint path
_TURBID_COST = 2.0  # the same in turbid water, times the scatterings on the way
_HALF = 0.5  # of the light of the paths: chains that see less are not trusted, however sure
_SURE = 10.0  # means over standard errors: that of 100 equal samples
_DOUBT = 3.5  # standard errors by which the pilots may differ: beyond, chains miss light


class ScatteredPilot(NamedTuple):
    """Mean of the scattered gain and variance of one sample, by receiver."""

    mean: Floats
    variance: Floats
    stderr: Floats


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
    """Return the time of a chain over that of an adjoint path.

    In turbid water paths are scattered many times more than light on the way: measured 0.2 and
    0.1 at 10 and 20 scatterings on the way.
    """
    return _COST if expected < TURBID else _TURBID_COST / expected


def choose(chains: ScatteredPilot, paths: ScatteredPilot, expected: float = 0.0) -> list[Method]:
    """Choose the estimator with the smaller variance times time for each receiver.

    Chains that miss much of the light have a small variance: where the paths find twice
    the light or more than chance allows, or few chains bring all of it, chains are not trusted.
    With many scatterings `expected` on the way single paths near the source make the tail of the
    paths: twice the light counts there only beyond two of their standard errors.
    """
    missed = paths.mean - chains.mean > _DOUBT * np.hypot(paths.stderr, chains.stderr)
    certain = 2.0 * paths.stderr if expected >= TURBID else 0.0
    missed |= (chains.mean < _HALF * paths.mean) & (paths.mean - chains.mean > certain)
    slower = chains.variance * chain_cost(expected) > paths.variance
    few = chains.mean < _SURE * chains.stderr
    surer = paths.stderr * chains.mean < chains.stderr * paths.mean
    adjoint = (paths.mean > 0.0) & (missed | slower | (few & surer) | (chains.mean <= 0.0))
    return ["adjoint" if a else "chains" for a in adjoint]
