"""Forced detection of neighbouring links with common random numbers.

Two runs of the same seed differ by more than the link: the number of chains of each order, the
law of their free paths, the mesh and the chains whose facets are all searched follow the link.
Here they are those of a base link, so that differences between links have little noise. Lengths
of the law scale with the depth of the source: chains of a deeper source are the same chains,
stretched.
"""

from __future__ import annotations

from collections.abc import Sequence
from threading import Lock
from typing import Any

import numpy as np

from meshtrace.engine.chains.aimed import NO_LISTS, AimedChains, SearchMode
from meshtrace.engine.chains.nearby import LONGEST, PROBES, Lists, list_facets, near_rows
from meshtrace.engine.chains.sampling import Nominal
from meshtrace.engine.chains.sets import ChainDrawer, ChainSet
from meshtrace.engine.crossing import Near, Search
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.outcome import warn_of_chains
from meshtrace.engine.parts import Light, chain_light, direct_light, merged
from meshtrace.engine.setup.forced_link import ForcedLink, forced_link
from meshtrace.errors import Refused
from meshtrace.kernels.scene import Scene
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS

_KEPT = 4  # sets of chains for the last geometries
_SLACK = 0.04  # displacement of landing points that a list allows, over the receiver's height


class FrozenForced:
    """Chains of a base link that serve its neighbours, too.

    Parameters
    ----------
    link : Link
        The base link.
    photons, seed : int
        Chains in all, and the seed of their points.
    sea : TypicalSea
        What is known of the surfaces.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    search : {"thorough", "usual"}
        Search of crossings over surfaces without random slopes, see `AimedChains`.
    meshes : sequence of TriangleMesh, optional
        Surfaces that serve several neighbours without random slopes: for these a thorough search
        lists the facets near the crossings of the base, which alone are searched for neighbours.

    Raises
    ------
    Refused
        If the link has a feature that chains do not follow.

    Warns
    -----
    FewSamplesWarning
        If `simulate` would use joined photons for a receiver, or few chains contribute over still
        water.
    DomainWarning
        If more than 0.1 % of a gain is light that the surface reflects first, which chains omit.
    """

    def __init__(
        self,
        link: Link,
        photons: int,
        seed: int,
        sea: TypicalSea = TypicalSea(),  # noqa: B008 - frozen
        normals: str = "vertex",
        search: SearchMode = "thorough",
        meshes: Sequence[TriangleMesh] = (),
    ) -> None:
        base = ForcedDetection(
            link, photons, seed, normals, sea=sea, search=search, scattered="chains"
        )
        warn_of_chains(base, ForcedDetection(link, SHIFTS, seed, normals, sea=sea))
        self._base, self._seed = base, seed
        self._options = normals, search
        top = max(sea.crest, 0.0) / base.arrays.frame.unit
        lowest = min(t.center.z for t in base.arrays.targets)
        self._levels = top, top + min(0.25 * (top + 1.0), 0.5 * max(lowest - top, 0.0))
        self._nominals = ChainDrawer(base.arrays, *self._levels).nominals
        self._nodes: dict[tuple[int, int], tuple[int, int]] = {}
        self._drawn: dict[str, list[list[ChainSet]]] = {}
        self._lock = Lock()
        self._nearby: list[tuple[TriangleMesh, NearbyFacets]] = []
        if search == "thorough":
            self._nearby = [
                (mesh, NearbyFacets(base.over(mesh), base.scattered_sets)) for mesh in meshes
            ]

    def gains(self, link: Link, mesh: TriangleMesh) -> Floats:
        """Return the gain of a neighbouring link by the shift of the points.

        Parameters
        ----------
        link : Link
            A link with as many sources as the base; its receivers may be others.
        mesh : TriangleMesh
            The surface, which covers all neighbours.

        Returns
        -------
        ndarray, shape (receivers, shifts)
        """
        arrays, aimed, sets = self._aimed(link, mesh)
        found = np.zeros((len(link.receivers), SHIFTS))
        for e, t in np.ndindex(len(arrays.emitters), len(arrays.targets)):
            row, power = found[arrays.receiver(e, t)], arrays.share(e, t)
            direct = aimed.direct_gains(e, t)
            if direct is not None:
                row += power * direct.sum()
            for chains in sets[e]:
                if chains.order > 0 or direct is None:
                    row += power * aimed.score(e, t, chains).reshape(SHIFTS, -1).mean(axis=1)
        return found

    def unscattered(self, link: Link, mesh: TriangleMesh) -> Floats:
        """Return the unscattered gain of each receiver of a neighbouring link, without noise.

        0 where it is sampled with the chains.
        """
        arrays, aimed, _ = self._aimed(link, mesh)
        found = np.zeros(len(link.receivers))
        for e, t in np.ndindex(len(arrays.emitters), len(arrays.targets)):
            direct = aimed.direct_gains(e, t)
            if direct is not None:
                found[arrays.receiver(e, t)] += arrays.share(e, t) * direct.sum()
        return found

    def light(self, link: Link, mesh: TriangleMesh) -> list[Light]:
        """Return the light that arrives at each receiver of a neighbouring link."""
        arrays, aimed, sets = self._aimed(link, mesh)
        rows: list[list[Light]] = [[] for _ in link.receivers]
        for e, t in np.ndindex(len(arrays.emitters), len(arrays.targets)):
            row, power = rows[arrays.receiver(e, t)], arrays.share(e, t)
            direct = aimed.direct_gains(e, t)
            if direct is not None:
                row.append(direct_light(aimed, e, t, power * direct))
            shown = (c for c in sets[e] if c.order > 0 or direct is None)
            row += [chain_light(aimed, e, t, chains) for chains in shown]
        return [merged(row) for row in rows]

    def _aimed(
        self, link: Link, mesh: TriangleMesh
    ) -> tuple[ForcedLink, AimedChains, list[list[ChainSet]]]:
        """Return the arrays of a link, its surface and its chains."""
        normals, search = self._options
        arrays = forced_link(link, self._base.arrays.frame)
        if len(arrays.emitters) != len(self._nominals):
            name = "receiver" if arrays.down else "transmitter"
            raise Refused(name, len(arrays.emitters), f"as many {name}s as in the base link")
        aimed = AimedChains(arrays, mesh, None, normals, link.physics.unresolved, search)
        aimed.nodes = self._nodes
        if not aimed.blurred:
            aimed.near = next((n.near for surface, n in self._nearby if surface is mesh), None)
        return arrays, aimed, self._sets(link, arrays, aimed)

    def _sets(self, link: Link, arrays: ForcedLink, aimed: AimedChains) -> list[list[ChainSet]]:
        """Return the chains of a link; those of the last geometries are kept."""
        lamps = [(e.position, e.axis, e.radius) for e in arrays.emitters]
        ends = [(t.center, t.axis, t.radius) for t in arrays.targets]
        parts = link.water.phase, link.bubbles, link.physics
        models = [part and part.model_dump_json() for part in parts]
        key = repr((lamps, ends, models, link.water.n, link.n_air, aimed.rough))
        with self._lock:
            if key not in self._drawn:
                while len(self._drawn) >= _KEPT:
                    del self._drawn[next(iter(self._drawn))]
                self._drawn[key] = self._draw(arrays, aimed)
            return self._drawn[key]

    def _draw(self, arrays: ForcedLink, aimed: AimedChains) -> list[list[ChainSet]]:
        """Draw the chains of a link by the laws and numbers of the base."""
        drawer = ChainDrawer(arrays, *self._levels)
        drawer.nominals = self._stretched(arrays)

        def drawn(s: int, like: ChainSet) -> ChainSet:
            per_shift = len(like.audit) // SHIFTS
            return drawer.draw(s, like.order, per_shift, (self._seed, s, like.order, 1))

        return [[drawn(s, like) for like in row] for s, row in enumerate(self._base.sets(aimed))]

    def _stretched(self, arrays: ForcedLink) -> list[Nominal]:
        """Return the laws of the base, with lengths times the ratio of the depths."""
        laws = []
        pairs = zip(self._nominals, self._base.arrays.emitters, arrays.emitters, strict=True)
        for law, before, now in pairs:
            k = now.position.z / before.position.z
            lengths: dict[str, Any] = {"distance": law.distance * k, "step": law.step * k}
            laws.append(law._replace(**lengths, c=law.c / k, density=law.density / k))
        return laws


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
        self, source: int, receiver: int, chains: ChainSet, scene: Scene, search: Search
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
