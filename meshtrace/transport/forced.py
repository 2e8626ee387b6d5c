"""Forced detection by aiming: chains of scatterings, turned so that they hit the aperture.

Everything random about a photon except its emission direction is drawn; then the directions
that land it on a random point x of the aperture are solved for. With K scatterings

    h_K = E[ |A| sum_{w: X_K(w) = x} I(w) W_K(w) / |det dX_K / dOmega(w)| ],   h = sum_K h_K.

K = 0 is deterministic (`kernels.unscattered`); every K >= 1 has its own chains. The points are
randomly shifted Sobol points: the mean of each shift is an unbiased estimate of its own, and
the scatter of the shifts gives the standard error.

The chains do not depend on the surface: one set serves every frame of a moving sea.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.bvh import EmbreeIntersector
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.parallel import ordered_map
from meshtrace.results.gain import SHIFTS
from meshtrace.transport.aimed import AimedChains, Search
from meshtrace.transport.chain_sets import (
    ChainDrawer,
    ChainSet,
    allotment,
    flat_mesh,
    pilot,
)
from meshtrace.transport.forced_link import crossing_reach, forced_link

_UNSCATTERED_SHARE = 0.3  # chains without a scattering, over the scattered ones


class Counts(NamedTuple):
    """What became of the chains."""

    chains: int
    solved: int
    no_flat: int
    enumerated: int
    extra_roots: int
    blocked: int


@dataclass(frozen=True)
class Parts:
    """Gain over one surface, in parts.

    Attributes
    ----------
    direct : ndarray, shape (receivers, shifts)
        Unscattered gain of each shift of the points; all the same where it is deterministic.
    scattered : ndarray, shape (receivers, shifts)
        Scattered gain of each shift of the points.
    orders : ndarray, shape (receivers, orders)
        Scattered gain by the number of scatterings, from 1 on.
    counts : Counts
    """

    direct: NDArray[np.float64]
    scattered: NDArray[np.float64]
    orders: NDArray[np.float64]
    counts: Counts

    @property
    def ballistic(self) -> NDArray[np.float64]:
        """Unscattered gain of each receiver."""
        return self.direct.mean(axis=1)

    @property
    def shifts(self) -> NDArray[np.float64]:
        """Gain of each receiver by the shift of the points, shape (receivers, shifts)."""
        return self.direct + self.scattered

    @property
    def gain(self) -> NDArray[np.float64]:
        """Gain of each receiver."""
        return self.shifts.mean(axis=1)

    @property
    def stderr(self) -> NDArray[np.float64]:
        """Standard error of the gain of each receiver."""
        return self.shifts.std(axis=1, ddof=1) / math.sqrt(SHIFTS)


class ForcedDetection:
    """Chains of a link, ready to be aimed over any surface.

    Parameters
    ----------
    link : Link
        The link; sources must be points in the water, receivers in the air.
    photons : int
        Chains in all.
    seed : int
        Seed of the points and their shifts.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; results do not depend on them.
    crest : float
        Height up to which collisions are expected [m]: about the highest crest of the surfaces.
        Unbiased for any value; a good one saves chains.
    search : {"usual", "thorough"}
        How crossings are looked for, see `AimedChains`.

    Raises
    ------
    Refused
        If the link has a feature that only the analog estimator follows.
    """

    def __init__(
        self,
        link: Link,
        photons: int,
        seed: int,
        normals: str = "vertex",
        threads: int = 1,
        crest: float = 0.0,
        search: Search = "usual",
    ) -> None:
        self.link = link
        self.arrays = forced_link(link)
        self._options = normals, threads
        self._search: Search = search
        self._key = photons, seed
        unit = self.arrays.frame.unit
        top = max(crest, 0.0) / unit
        lowest = min(t.center[2] for t in self.arrays.targets)
        # a chain that ends higher is not looked for; the level must stay below the receivers
        self._ceiling = top + min(0.25 * (top + 1.0), 0.5 * max(lowest - top, 0.0))
        self._drawer = ChainDrawer(self.arrays, top, self._ceiling)
        self.scattered_sets = self._draw(max(photons // len(self.arrays.emitters), SHIFTS), seed)

    def _draw(self, photons: int, seed: int) -> list[list[ChainSet]]:
        """Return the chains by source; a pilot over a flat sea allots them to the orders."""
        sources, receivers = range(len(self.arrays.emitters)), len(self.arrays.targets)
        aimed = self.over(flat_mesh(crossing_reach(self.link) + 10.0 * self.arrays.frame.unit))
        pilots = [pilot(self._drawer, aimed, s, seed, receivers) for s in sources]
        gain = np.zeros(receivers)
        for s in sources:
            direct = [aimed.facet_gains(s, r).sum() for r in range(receivers)]
            gain += self.arrays.power[s] * (pilots[s].mean.sum(axis=1) + direct)
        sets = []
        for s in sources:
            counts = allotment(photons, self._drawer.nominals[s].expected, pilots[s], gain)
            sets.append(
                [self._drawer.draw(s, k, int(n), (seed, s, k, 1)) for k, n in enumerate(counts, 1)]
            )
        return sets

    def over(self, mesh: TriangleMesh, intersector: EmbreeIntersector | None = None) -> AimedChains:
        """Return the chains' view of a mesh."""
        normals, unresolved = self._options[0], self.link.physics.unresolved
        return AimedChains(self.arrays, mesh, intersector, normals, unresolved, self._search)

    def sets(self, aimed: AimedChains) -> list[list[ChainSet]]:
        """Return the chains by source, with unscattered ones where slopes are random."""
        if not aimed.rough:
            return self.scattered_sets
        return [
            [first, *row] for first, row in zip(self._unscattered, self.scattered_sets, strict=True)
        ]

    @cached_property
    def _unscattered(self) -> list[ChainSet]:
        """Chains without a scattering, by source; only a random slope tells them apart."""
        photons, seed = self._key
        sources = len(self.arrays.emitters)
        per_shift = max(math.ceil(_UNSCATTERED_SHARE * photons / sources / SHIFTS), 2)
        return [self._drawer.draw(s, 0, per_shift, (seed, s, 0, 1)) for s in range(sources)]

    def evaluate(self, mesh: TriangleMesh, intersector: EmbreeIntersector | None = None) -> Parts:
        """Return the gain over a mesh, in parts."""
        top = float(mesh.bounds[1, 2])
        unit = self.arrays.frame.unit
        if top > self._ceiling * unit:  # far higher than expected: chains that reach up there
            higher = ForcedDetection(self.link, *self._key, *self._options, top, self._search)
            return higher.evaluate(mesh, intersector)
        aimed = self.over(mesh, intersector)
        sets = self.sets(aimed)
        sources, receivers = len(self.arrays.emitters), len(self.arrays.targets)
        by_order = np.zeros((receivers, 1 + max(len(row) for row in self.scattered_sets), SHIFTS))
        pairs = [(s, r) for s in range(sources) for r in range(receivers)]
        jobs = [(s, r, chains) for s, r in pairs for chains in sets[s]]
        threads = self._options[1]
        if not aimed.rough:
            gains = ordered_map(lambda pair: aimed.facet_gains(*pair).sum(), pairs, threads)
            for (s, r), gain in zip(pairs, gains, strict=True):
                by_order[r, 0] += self.arrays.power[s] * gain
        scores = ordered_map(lambda job: aimed.score(*job), jobs, threads)
        for (s, r, chains), score in zip(jobs, scores, strict=True):
            means = score.reshape(SHIFTS, -1).mean(axis=1)
            by_order[r, chains.order] += self.arrays.power[s] * means
        total = sum(len(chains.audit) for row in sets for chains in row)
        return Parts(
            by_order[:, 0],
            by_order[:, 1:].sum(axis=1),
            by_order[:, 1:].mean(axis=2),
            Counts(total, *(int(c) for c in aimed.counters)),
        )

    def arrivals(self, mesh: TriangleMesh) -> list[NDArray[np.float64]]:
        """Return, by receiver, rows of weight, path in water, path in air [m] and shift.

        The weights of a receiver add up to its gain. Unscattered light without random slopes
        is one row a facet, with shift -1: it has no Monte Carlo error.
        """
        aimed = self.over(mesh)
        sets, unit = self.sets(aimed), self.arrays.frame.unit
        result = []
        for r, target in enumerate(self.arrays.targets):
            rows = []
            for s, emitter in enumerate(self.arrays.emitters):
                power = self.arrays.power[s]
                if not aimed.rough:
                    gains = power * aimed.facet_gains(s, r)
                    lit = np.flatnonzero(gains)
                    crossing = aimed.centroids[lit]
                    rows.append(
                        np.column_stack(
                            [
                                gains[lit],
                                unit * np.linalg.norm(crossing - emitter.position, axis=1),
                                unit * np.linalg.norm(crossing - target.center, axis=1),
                                np.full(len(lit), -1.0),
                            ]
                        )
                    )
                for chains in sets[s]:
                    _, found = aimed.aim(s, r, chains, keep=True)
                    n = len(chains.audit)
                    shift = found["chain"] // (n // SHIFTS)
                    weight = power * found["weight"] / n
                    rows.append(
                        np.column_stack([weight, unit * found["water"], unit * found["air"], shift])
                    )
            result.append(np.concatenate(rows))
        return result
