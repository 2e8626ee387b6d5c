"""Correlated sampling: links with common chains and photons, at other wavelengths or nearby.

The geometry of paths is the same for all wavelengths, up to the index of the water: paths of one
of them, the base, bring light of all others by factors on their weights (`setup.tinting`). The
index is followed by some paths at its extremes, between which gains are linear.

Two runs of the same seed for neighbouring links differ by more than the link: the number of chains
of each order, the law of their free paths, the mesh and the chains whose facets are all searched
follow the link. Here they are those of a base link, so that differences between links have little
noise. Lengths of the law scale with the depth of the source: chains of a deeper source are the
same chains, stretched.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains.aimed import AimedChains, Nodes, SearchMode
from meshtrace.engine.chains.sets import ChainSet
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.gains import Gains, with_error
from meshtrace.engine.outcome import warn_of_chains
from meshtrace.engine.parts import Light, chain_light, direct_light, merged
from meshtrace.engine.photons.analog import PhotonSums, run_analog, tinted
from meshtrace.engine.setup.ends import ForcedLink, forced_link
from meshtrace.engine.setup.options import Analog, Arrivals, Record
from meshtrace.engine.setup.tinting import Common, photon_paths, scattering
from meshtrace.errors import Refused
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS

_INDEX_SHARE = 0.0625
"""Share of the paths that are refracted again by the extreme indices: their noise cancels."""

_KEPT = 4  # sets of chains for the last geometries


class _Group(NamedTuple):
    """Wavelengths with common paths."""

    rows: list[int]
    detection: ForcedDetection
    ends: list[ForcedDetection]  # some of the paths at the extreme indices, if these differ
    shares: Floats  # (rows,) of their difference, by the index

    def at_wavelengths(self, mesh: TriangleMesh, record: bool) -> list[Gains]:
        if not self.ends:
            return self.detection.at_wavelengths(mesh, record=record)
        # the mesh is prepared once: the three waters differ in their index alone
        aimed = self.detection.planner.aim_over(mesh)
        gains = self.detection.at_wavelengths(mesh, aimed, record)
        low, high = (end.at_wavelengths(mesh, aimed) for end in self.ends)
        return [_moved(*row) for row in zip(gains, low, high, self.shares.tolist(), strict=True)]


class SpectralDetection:
    """Gains of one link at several wavelengths over any surface, with common paths.

    Parameters
    ----------
    links : sequence of Link
        The link at each wavelength: alike but for water, bubbles and wavelengths.
    photons, seed, normals, threads, sea
        As in `ForcedDetection`.

    Notes
    -----
    The base is the link that scatters most: no order of scattering of the others is missing among
    its chains, which are allotted to the orders for all wavelengths alike. Joined photons are those
    of several bases in turn (`setup.tinting.Tinting.mixed`). All have the index of the water in the
    middle; a share of them is refracted by the smallest and the largest one as well, with the same
    random numbers, and gains are linear in the index between.
    """

    def __init__(
        self,
        links: Sequence[Link],
        photons: int,
        seed: int,
        normals: str = "vertex",
        threads: int = 1,
        sea: TypicalSea = TypicalSea(),  # noqa: B008 - frozen
    ) -> None:
        self.links = list(links)
        self._groups: list[_Group] = []
        found = [scattering(link)[0] for link in links]
        waiting = list(range(len(self.links)))
        while waiting:
            base, common = photon_paths(self.links, waiting, chains=True)
            # the middle index halves the longest way of the linear correction
            first, alike = common.middle(), [self.links[i] for i in common.rows]
            ratios = [found[i] / (found[base] or 1.0) for i in common.rows]
            shared = None if common.tinting is None else Common(common.tinting, alike, ratios)
            detection = ForcedDetection(
                first, photons, seed, normals, threads, sea, wavelengths=shared
            )
            ends = [
                detection.at_index(link.water.n, _INDEX_SHARE)
                for link in common.bases
                if len(common.bases) > 1
            ]
            # from the middle index: shares run from -1/2 to 1/2
            self._groups.append(_Group(common.rows, detection, ends, common.shares - 0.5))
            waiting = [i for i in waiting if i not in common.rows]

    def at_wavelengths(self, mesh: TriangleMesh, record: bool = False) -> list[Gains]:
        """Return the gain over a mesh at each wavelength, on demand with every row of its light.

        Unscattered light has the length of its way to the centroid of a facet.
        """
        gains: dict[int, Gains] = {}
        for group in self._groups:
            gains |= dict(zip(group.rows, group.at_wavelengths(mesh, record), strict=True))
        return [gains[row] for row in range(len(self.links))]


def _moved(gains: Gains, low: Gains, high: Gains, share: float) -> Gains:
    """Return gains with a share of the difference between two, of fewer paths.

    Their rows, if they are kept, get weights that add up to the gain.
    """
    width = max(part.all_orders.shape[1] for part in (gains, low, high))
    orders, first, last = (  # orders of scattering may be missing
        np.pad(part.all_orders, ((0, 0), (0, width - part.all_orders.shape[1])))
        for part in (gains, low, high)
    )
    groups = gains.groups + share * (high.groups - low.groups)
    moved = replace(gains, groups=groups, all_orders=orders + share * (last - first))
    return replace(moved, table=[table.with_gains(moved.gain) for table in gains.table])


def analog_sums(
    links: Sequence[Link],
    intersector: EmbreeIntersector,
    options: Analog,
    photons: int,
    progress: Callable[[int], None] | None,
    record: Collection[Record] = (),
    **how: Any,
) -> list[PhotonSums]:
    """Return the tallies of analog photons at each wavelength, of common photons where possible.

    Photons are those of several bases in turn, half of them with the smallest and half with the
    largest index of the water; so are their fates. Below bubbles that differ in number each
    wavelength has its own photons. Of several wavelengths arrivals alone are recorded.
    """
    waiting, found = list(range(len(links))), dict[int, PhotonSums]()
    first = options.first_photon
    while waiting:
        _, common = photon_paths(links, waiting)
        waiting = [i for i in waiting if i not in common.rows]
        tinting, ends = common.tinting, len(common.bases)
        if tinting is None:
            (row,) = common.rows
            of = {**how, "photons": photons, "progress": progress, "record": record}
            found[row] = run_analog(links[row], intersector, options, **of)
            continue
        several = [links[common.rows[i]] for i in tinting.bases] or [common.bases[0]]
        # disjoint ids: the strata are independent, so that their variances add
        runs = [(base, end) for base in range(len(several)) for end in range(ends)]
        cuts = [first + k * photons // len(runs) for k in range(len(runs) + 1)]
        numbers = np.diff(cuts).reshape(len(several), ends)
        strata: list[list[PhotonSums]] = []
        for k, (base, end) in enumerate(runs):
            link = several[base].replace("water.n", common.bases[end].water.n)
            sums = run_analog(
                link, intersector, options.replace(first_photon=cuts[k]),
                photons=cuts[k + 1] - cuts[k], progress=progress, record=[Arrivals()],
                tinting=tinting, **how,
            )  # fmt: skip
            of_end = int(numbers[:, end].sum())
            # linear in the index between the two ends, as the gains of chains are
            part = common.shares if end else 1.0 - common.shares
            scale = part * photons / of_end if ends > 1 else np.ones(len(common.rows))
            shares = numbers[:, end] / numbers[:, end].sum()
            mixed = partial(tinting.mixed, base=base, parts=shares)
            strata.append(tinted(sums, mixed, scale, cuts[k], bool(record)))
        each = (PhotonSums.of_strata(rows) for rows in zip(*strata, strict=True))
        found |= dict(zip(common.rows, each, strict=True))
    return [found[i] for i in range(len(links))]


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
        arrays, aimed = self._aimed(link, mesh)
        sets = self._sets(link, arrays, aimed)
        found, direct = np.zeros((2, len(link.receivers), SHIFTS))
        for e, t in arrays.pairs:
            r, share = arrays.receiver(e, t), arrays.share(e, t)
            if not aimed.sampled:
                light = aimed.direct_gains(e, t).sum(keepdims=True)
                # beside chains, whose errors are far larger, the rim of a view alone counts
                counts = aimed.meets_rim(e, t) or not any(sets)
                error = aimed.relative_error(e, t) if counts else 0.0
                direct[r] += share * with_error(light, error)
            for chains in sets[e]:
                score = aimed.aim(e, t, chains).score
                part = direct if chains.order == 0 else found
                part[r] += share * score.reshape(SHIFTS, -1).mean(axis=1)
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
        arrays, aimed = self._aimed(link, mesh)
        sets = self._sets(link, arrays, aimed)
        rows: list[list[Light]] = [[] for _ in link.receivers]
        for e, t in arrays.pairs:
            row = rows[arrays.receiver(e, t)]
            if not aimed.sampled:
                row.append(direct_light(aimed, e, t, aimed.direct_gains(e, t)))
            row += [chain_light(aimed, e, t, chains) for chains in sets[e]]
        return [merged(row) for row in rows]

    def _aimed(self, link: Link, mesh: TriangleMesh) -> tuple[ForcedLink, AimedChains]:
        """Return the arrays of a link and its surface (cached for recent ones)."""
        arrays = forced_link(link, self._base.arrays.frame)
        if len(arrays.emitters) != len(self._base.arrays.emitters):
            name = "receiver" if arrays.down else "transmitter"
            raise Refused(name, len(arrays.emitters), f"as many {name}s as in the base link")
        key = id(mesh), link.physics.unresolved
        known = self._seas.get(key)
        if known is not None:
            aimed = known[1].of_link(arrays)
        else:
            aimed = AimedChains(arrays, mesh, self._normals, key[1], self._search)
            with self._lock:
                while len(self._seas) >= self._kept:
                    del self._seas[next(iter(self._seas))]
                self._seas[key] = mesh, aimed  # the mesh lives as long as its number
        aimed.nodes = self._nodes
        return arrays, aimed

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
            return known.result()  # no bound: work of another thread, which always sets it
        try:
            drawn.set_result(self._draw(arrays, aimed))
        except BaseException as error:  # of the threads that wait, too
            drawn.set_exception(error)
        return drawn.result()

    def _draw(self, arrays: ForcedLink, aimed: AimedChains) -> list[list[ChainSet]]:
        """Draw the chains of a link by the laws and numbers of the base."""
        drawer, found = self._base.drawer.of_link(arrays), list[list[ChainSet]]()
        for s, row in enumerate(self._base.sets(aimed.sampled)):
            requests = (drawing.request for drawing in row)
            keyed = (one._replace(key=(self._seed, s, one.order, 1)) for one in requests)
            found.append([drawer.draw(one) for one in keyed])
        return found
