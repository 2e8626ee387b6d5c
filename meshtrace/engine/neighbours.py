"""Forced detection of neighbouring links with common random numbers.

Two runs of the same seed differ by more than the link: the number of chains of each order, the
law of their free paths, the mesh and the chains whose facets are all searched follow the link.
Here they are those of a base link, so that differences between links have little noise. Lengths
of the law scale with the depth of the source: chains of a deeper source are the same chains,
stretched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.chains.aimed import AimedChains, Nodes, SearchMode
from meshtrace.engine.chains.sampling import Nominal
from meshtrace.engine.chains.sets import ChainDrawer, ChainSet, Request
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.outcome import warn_of_chains
from meshtrace.engine.parts import Light, chain_light, direct_light, merged
from meshtrace.engine.setup.ends import ForcedLink, forced_link
from meshtrace.errors import Refused
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS

_KEPT = 4  # sets of chains for the last geometries


class _Pair(NamedTuple):
    """One source and one receiver: unscattered gain by facet, and the chains of all other light."""

    receiver: int
    share: float  # of the power
    aimed: AimedChains
    ends: tuple[int, int]
    direct: Floats | None
    sets: list[ChainSet]


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
    kept : int
        Last surfaces of which facets and Embree scenes are kept.

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
        kept: int = 8,
    ) -> None:
        base = ForcedDetection(
            link, photons, seed, normals, sea=sea, search=search, scattered="chains"
        )
        warn_of_chains(base, ForcedDetection(link, SHIFTS, seed, normals, sea=sea))
        self._base, self._seed = base, seed
        self._normals, self._search, self._kept = normals, search, kept
        self._nodes: dict[tuple[int, int], Nodes] = {}
        self._drawn: dict[str, Future[list[list[ChainSet]]]] = {}
        self._seas: dict[tuple[int, str], tuple[TriangleMesh, AimedChains]] = {}
        self._lock = Lock()

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
        return self.parts(link, mesh)[0]

    def parts(self, link: Link, mesh: TriangleMesh) -> tuple[Floats, Floats]:
        """Return `gains`, and their unscattered part, shapes (receivers, shifts)."""
        found, direct = np.zeros((2, len(link.receivers), SHIFTS))
        for pair in self._pairs(link, mesh):
            if pair.direct is not None:
                direct[pair.receiver] += pair.share * pair.direct.sum()
            for chains in pair.sets:
                score = pair.aimed.aim(*pair.ends, chains).score
                part = direct if chains.order == 0 else found
                part[pair.receiver] += pair.share * score.reshape(SHIFTS, -1).mean(axis=1)
        return found + direct, direct

    def unscattered(
        self, link: Link, mesh: TriangleMesh, facets: Sequence[NDArray[np.int64]] | None = None
    ) -> Floats:
        """Return the unscattered gain of each receiver of a neighbouring link, without noise.

        Through all facets, or through some for each receiver; 0 where it is sampled with the
        chains.
        """
        found = np.zeros(len(link.receivers))
        arrays, aimed = self._aimed(link, mesh)
        for e, t in [] if aimed.sampled else arrays.pairs:
            r = arrays.receiver(e, t)
            if facets is None or len(facets[r]):
                some = None if facets is None else facets[r]
                found[r] += arrays.share(e, t) * aimed.direct_gains(e, t, facets=some).sum()
        return found

    def light(self, link: Link, mesh: TriangleMesh) -> list[Light]:
        """Return the light that arrives at each receiver of a neighbouring link."""
        rows: list[list[Light]] = [[] for _ in link.receivers]
        for pair in self._pairs(link, mesh):
            row = rows[pair.receiver]
            if pair.direct is not None:
                row.append(direct_light(pair.aimed, *pair.ends, pair.direct))
            row += [chain_light(pair.aimed, *pair.ends, chains) for chains in pair.sets]
        return [merged(row) for row in rows]

    def _pairs(self, link: Link, mesh: TriangleMesh) -> Iterator[_Pair]:
        """Yield the pairs of source and receiver of a neighbouring link."""
        arrays, aimed = self._aimed(link, mesh)
        sets = self._sets(link, arrays, aimed)
        for e, t in arrays.pairs:
            direct = None if aimed.sampled else aimed.direct_gains(e, t)
            yield _Pair(arrays.receiver(e, t), arrays.share(e, t), aimed, (e, t), direct, sets[e])

    def _aimed(self, link: Link, mesh: TriangleMesh) -> tuple[ForcedLink, AimedChains]:
        """Return the arrays of a link and its surface."""
        arrays = forced_link(link, self._base.arrays.frame)
        if len(arrays.emitters) != len(self._base.arrays.emitters):
            name = "receiver" if arrays.down else "transmitter"
            raise Refused(name, len(arrays.emitters), f"as many {name}s as in the base link")
        aimed = self._over(mesh, arrays, link.physics.unresolved)
        aimed.nodes = self._nodes
        return arrays, aimed

    def _over(self, mesh: TriangleMesh, arrays: ForcedLink, unresolved: str) -> AimedChains:
        """Return the chains over a surface (cached for recent ones)."""
        key = id(mesh), unresolved
        known = self._seas.get(key)
        if known is not None:
            return known[1].of_link(arrays)
        made = AimedChains(arrays, mesh, self._normals, unresolved, self._search)
        with self._lock:
            while len(self._seas) >= self._kept:
                del self._seas[next(iter(self._seas))]
            self._seas[key] = mesh, made  # the mesh lives as long as its number
        return made

    def _sets(self, link: Link, arrays: ForcedLink, aimed: AimedChains) -> list[list[ChainSet]]:
        """Return the chains of a link (cached for recent geometries)."""
        lamps = [(e.position, e.axis, e.radius) for e in arrays.emitters]
        ends = [(t.center, t.axis, t.radius) for t in arrays.targets]
        parts = link.water.phase, link.bubbles, link.physics
        models = [part and part.model_dump_json() for part in parts]
        key = repr((lamps, ends, models, link.water.n, link.n_air, aimed.sampled))
        with self._lock:
            known = self._drawn.get(key)
            if known is None:
                while len(self._drawn) >= _KEPT:
                    del self._drawn[next(iter(self._drawn))]
                drawn = self._drawn[key] = Future()
        if known is not None:
            return known.result()
        try:
            drawn.set_result(self._draw(arrays, aimed))
        except BaseException as error:  # of the threads that wait, too
            drawn.set_exception(error)
        return drawn.result()

    def _draw(self, arrays: ForcedLink, aimed: AimedChains) -> list[list[ChainSet]]:
        """Draw the chains of a link by the laws and numbers of the base."""
        base = self._base.drawer
        drawer = ChainDrawer(arrays, base.crest, base.ceiling)
        drawer.nominals = self._stretched(arrays)

        def drawn(s: int, like: ChainSet) -> ChainSet:
            per_shift = len(like.audit) // SHIFTS
            return drawer.draw(Request(s, like.order, per_shift, (self._seed, s, like.order, 1)))

        rows = self._base.sets(aimed.sampled)
        return [[drawn(s, like) for like in row] for s, row in enumerate(rows)]

    def _stretched(self, arrays: ForcedLink) -> list[Nominal]:
        """Return the laws of the base, with lengths times the ratio of the depths."""
        laws = []
        pairs = zip(
            self._base.drawer.nominals, self._base.arrays.emitters, arrays.emitters, strict=True
        )
        for law, before, now in pairs:
            k = now.position.z / before.position.z
            lengths: dict[str, Any] = {"distance": law.distance * k, "step": law.step * k}
            laws.append(law._replace(**lengths, c=law.c / k, density=law.density / k))
        return laws
