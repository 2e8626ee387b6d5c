"""Facets near the crossings of a base link, for the search of crossings of its neighbours."""

from __future__ import annotations

from threading import Lock

import numpy as np

from meshtrace.kernels.crossings import Near
from meshtrace.kernels.crossings import Search as SearchExtent
from meshtrace.kernels.nearby import LONGEST, PROBES, Lists, list_facets, near_rows
from meshtrace.kernels.scene import Scene
from meshtrace.transport.aimed import NO_LISTS, AimedChains
from meshtrace.transport.chain_sets import ChainSet

_SLACK = 0.04  # displacement of landing points that a list allows, over the receiver's height


class NearbyFacets:
    """Lists of facets of a base link over one surface, made when they are first used.

    Parameters
    ----------
    aimed : AimedChains
        The base link over the surface.
    sets : list of list of ChainSet
        Its chains, by source.
    """

    def __init__(self, aimed: AimedChains, sets: list[list[ChainSet]]) -> None:
        self._aimed = aimed
        self._sets = {(s, c.order): c for s, row in enumerate(sets) for c in row}
        self._lists: dict[tuple[int, int, int], Lists] = {}
        self._lock = Lock()

    def near(
        self, source: int, receiver: int, chains: ChainSet, scene: Scene, search: SearchExtent
    ) -> Near:
        """Return the facets to search for each chain of a neighbouring link."""
        base = self._sets.get((source, chains.order))
        if base is None or receiver >= len(base.flat) or not self._covers(scene):
            return NO_LISTS
        key = source, receiver, chains.order
        with self._lock:
            if key not in self._lists:
                self._lists[key] = self._list(*key)
        lists, slack = self._lists[key], self._slack(receiver)
        rows = np.empty_like(lists.rows)
        near_rows(chains.chains, chains.flat[receiver], lists, search, slack, scene, rows)
        return Near(rows, lists.facet)

    def _slack(self, receiver: int) -> float:
        return _SLACK * float(self._aimed.link.targets[receiver].center.z)

    def _covers(self, scene: Scene) -> bool:
        """Return whether the base sees all of the surface that the neighbour sees."""
        at, target = self._aimed.locator, scene.target
        edges = zip((at.x, at.y), (at.nx, at.ny), (0, 1), strict=True)
        for low, n, i in edges:
            first = max(target.center[i] - target.reach, float(scene.surface.low[i]))
            last = min(target.center[i] + target.reach, float(scene.surface.high[i]))
            if first < low or last > low + n * at.step:
                return False
        return True

    def _list(self, source: int, receiver: int, order: int) -> Lists:
        """Return the lists of one set of chains."""
        chains, aimed = self._sets[source, order], self._aimed
        flat = chains.flat[receiver]
        target = aimed.link.targets[receiver]
        scene = aimed.scene(aimed.link.emitters[source], target)
        out = Lists(
            flat,
            np.full((*flat.shape, 2), -1, np.int64),
            np.empty(LONGEST * (len(flat) + 1), np.int32),
            np.zeros(flat.shape),
            np.zeros((*flat.shape, PROBES, 2)),
        )
        n = list_facets(chains.chains, aimed.search_of(target), self._slack(receiver), scene, out)
        return out._replace(facet=out.facet[:n].copy())
