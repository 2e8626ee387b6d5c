"""Correlated sampling: links at several wavelengths, or neighbouring links, that share paths.

Paths have the same geometry at all wavelengths but for the index of the water: those of one
wavelength, the base, serve all others with factors on their weights (`setup.tinting`). To correct
for the index, some paths are refracted by its smallest and largest value, between which gains are
taken as linear.

Two runs with the same seed for neighbouring links differ in more than the links: the number of
chains of each order, the law of their free paths, the mesh, and the chains whose crossings are
searched over all facets depend on the link. Here they are those of a base link, so that differences
between links have little noise. Lengths of the law scale with the depth of the source: a deeper
source has the same chains, stretched.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from itertools import product
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains.aimed import AimedChains, Nodes, SearchMode
from meshtrace.engine.chains.sets import ChainSet
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.gains import Gains, widened, with_error
from meshtrace.engine.outcome import warn_of_chains
from meshtrace.engine.parts import Light, chain_light, direct_light, merged
from meshtrace.engine.photons.analog import PhotonSums, run_analog, tinted
from meshtrace.engine.plan import Planner
from meshtrace.engine.setup.ends import ForcedLink, forced_link
from meshtrace.engine.setup.options import Analog, Arrivals, Record
from meshtrace.engine.setup.tinting import CommonPaths, photon_paths
from meshtrace.errors import Refused
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS

_INDEX_SHARE = 0.0625
"""Share of the paths that extreme indices refract as well; tuned: time, noise of the correction.

A small share suffices, as the noise of the same paths cancels in differences."""

_RECENT_LINKS = 4  # last geometries whose chains stay in memory; tuned: memory, time
# Moves of ends over the way between them, turns [rad] and relative changes of the index up to which
# crossings are followed. Tuned: over steps of 3 % none is lost that the search finds.
_NEAR = 0.1


class SpectralDetection:
    """Gains of one link at several wavelengths over any surface, with shared paths.

    Parameters
    ----------
    links : sequence of Link
        The link at each wavelength: they differ in water, bubbles and wavelength alone.
    photons, seed, normals, threads, sea
        As in `ForcedDetection`.

    Notes
    -----
    The base is the link that scatters most, so that its chains miss no order of scattering of the
    others; they are allotted to the orders for all wavelengths at once. Joined photons belong to
    several bases in turn (`setup.tinting.Tinting.mixed`). All are refracted by the mean of the
    smallest and the largest index of the water, and a share of them, with the same random numbers,
    also by these two, between which gains are taken as linear in the index. Links that cannot share
    paths form groups, each with a base.
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
        # paths, the estimator at the middle index, and those at the extreme ones if they differ
        self._groups: list[tuple[CommonPaths, ForcedDetection, list[ForcedDetection]]] = []
        waiting = list(range(len(self.links)))
        while waiting:
            _, paths = photon_paths(self.links, waiting, chains=True)
            # the middle index: none is farther from it than half of their range
            planner = Planner(paths.middle(), seed, normals, threads, sea, wavelengths=paths)
            detection = ForcedDetection.following(planner, planner.plan(photons, planner.compare()))
            # bases have the smallest and the largest index, a single one if these are equal
            extremes = paths.bases if len(paths.bases) > 1 else []
            ends = [detection.at_index(link.water.n, _INDEX_SHARE) for link in extremes]
            self._groups.append((paths, detection, ends))
            waiting = [i for i in waiting if i not in paths.wavelengths]

    def at_wavelengths(
        self, mesh: TriangleMesh, record: bool = False, per_lamp: bool = False
    ) -> list[Gains]:
        """Return the gain over a mesh at each wavelength, with all its arrivals if `record`.

        Paths of unscattered light through a facet lead to its centroid. `per_lamp` adds the gains
        by lamp.
        """
        gains: dict[int, Gains] = {}
        for paths, detection, ends in self._groups:
            # the mesh is prepared once for all three indices
            aimed = detection.planner.aim_over(mesh) if ends else None
            at_paths = detection.at_wavelengths(mesh, aimed, record, per_lamp)
            if ends:
                low, high = (end.at_wavelengths(mesh, aimed, per_lamp=per_lamp) for end in ends)
                # place of each index in the range: from -1/2 to 1/2 about the middle
                shares = (paths.shares - 0.5).tolist()
                at_paths = list(map(_moved, at_paths, low, high, shares))
            gains |= dict(zip(paths.wavelengths, at_paths, strict=True))
        return [gains[i] for i in range(len(self.links))]


def _moved(gains: Gains, low: Gains, high: Gains, share: float) -> Gains:
    """Return gains moved by a share of the difference between two, gains + share (high - low).

    `low` and `high` are by a smaller number of paths. The weights of the arrivals, if they are
    recorded, are scaled to add up to the new gain.
    """
    # a smaller number of paths may lack the highest orders
    width = max(part.all_orders.shape[1] for part in (gains, low, high))
    orders, first, last = (widened(part.all_orders, width) for part in (gains, low, high))
    # group by group: both have the same paths, whose noise cancels in the difference
    groups = gains.groups + share * (high.groups - low.groups)
    moved = replace(gains, groups=groups, all_orders=orders + share * (last - first))
    if gains.by_lamp is not None and low.by_lamp is not None and high.by_lamp is not None:
        moved = replace(moved, by_lamp=_moved(gains.by_lamp, low.by_lamp, high.by_lamp, share))
    return replace(moved, table=[table.with_gains(moved.gain) for table in gains.table])


def analog_sums(
    links: Sequence[Link],
    intersector: EmbreeIntersector,
    options: Analog,
    photons: int,
    progress: Callable[[int], None] | None,
    record: Collection[Record] = (),
    *,
    seed: int,
    normals: str = "vertex",
    threads: int = 1,
) -> list[PhotonSums]:
    """Return the tallies of analog photons at each wavelength, from shared photons where possible.

    Photons are divided between several bases, and those of each between the smallest and the
    largest index of the water; fates are those of all of them. Below bubbles that differ in number
    each wavelength has separate photons. Wavelengths that share photons record arrivals alone.
    """
    waiting, by_wavelength = list(range(len(links))), dict[int, PhotonSums]()
    first = options.first_photon
    trace = partial(run_analog, seed=seed, normals=normals, threads=threads, progress=progress)
    while waiting:
        _, paths = photon_paths(links, waiting)
        waiting = [i for i in waiting if i not in paths.wavelengths]
        tinting, ends = paths.tinting, len(paths.bases)
        if len(paths.links) == 1:
            sums = trace(paths.links[0], intersector, options, photons=photons, record=record)
            by_wavelength[paths.wavelengths[0]] = sums
            continue
        several = [paths.links[i] for i in tinting.bases] or [paths.bases[0]]
        # strata of photons, one for each base and index, with consecutive, disjoint ranges of ids:
        # they are independent, so that their variances add
        runs = [(base, end) for base in range(len(several)) for end in range(ends)]
        cuts = [first + k * photons // len(runs) for k in range(len(runs) + 1)]
        numbers = np.diff(cuts).reshape(len(several), ends)
        strata: list[list[PhotonSums]] = []
        for k, (base, end) in enumerate(runs):
            link = several[base].replace("water.n", paths.bases[end].water.n)
            sums = trace(
                link, intersector, options.replace(first_photon=cuts[k]),
                photons=cuts[k + 1] - cuts[k], record=[Arrivals()], tinting=tinting,
            )  # fmt: skip
            at_index = int(numbers[:, end].sum())
            # gains are linear in the index: mean over the photons of each of the two indices,
            # weighted by the place of the index of a wavelength between them
            part = paths.shares if end else 1.0 - paths.shares
            scale = part * photons / at_index if ends > 1 else np.ones(len(paths.links))
            shares = numbers[:, end] / numbers[:, end].sum()
            # balance heuristic over the bases, see `Tinting.mixed`
            mixed = partial(tinting.mixed, base=base, parts=shares)
            strata.append(tinted(sums, mixed, scale, cuts[k], bool(record)))
        each = (PhotonSums.of_strata(stratum) for stratum in zip(*strata, strict=True))
        by_wavelength |= dict(zip(paths.wavelengths, each, strict=True))
    return [by_wavelength[i] for i in range(len(links))]


class FrozenForced:
    """Chains of a base link, reused for its neighbours.

    Parameters
    ----------
    link : Link
        The base link.
    photons, seed : int
        Chains in all, and the seed of their points.
    sea : TypicalSea
        Crest and random slopes that are expected of the surfaces.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    search : {"thorough", "usual"}
        Search of crossings over surfaces without random slopes, see `AimedChains`.
    recent : int
        Number of last surfaces whose facets and Embree scenes stay in memory.

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
        recent: int = 8,
    ) -> None:
        # chains alone: joined photons are followed under one surface and one link
        planner = Planner(link, seed, normals, sea=sea, search=search, scattered="chains")
        base = ForcedDetection.following(planner, planner.plan(photons, planner.compare()))
        # chains for all receivers, beside the estimators that `simulate` would choose
        warn_of_chains(base, Planner(link, seed, normals, sea=sea).compare().method)
        self._base, self._seed = base, seed
        self._histories, self._ends = _histories(link, base.arrays), _ends(base.arrays)
        self._normals, self._search, self._recent = normals, search, recent
        self._nodes: dict[tuple[int, int], Nodes] = {}
        self._drawn: dict[str, Future[list[list[ChainSet]]]] = {}
        self._seas: dict[tuple[int, str], tuple[TriangleMesh, AimedChains]] = {}
        self._lock = Lock()

    def gains(self, link: Link, mesh: TriangleMesh, shifts: int = SHIFTS) -> Floats:
        """Return the gain of a neighbouring link for each shift of the Sobol points.

        Parameters
        ----------
        link : Link
            A link with as many sources as the base (as many receivers for a downlink); its other
            ends may differ in number and place.
        mesh : TriangleMesh
            The surface, wide enough for all neighbours.
        shifts : int
            Number of shifts, the first of all: fewer chains take less time.

        Returns
        -------
        ndarray, shape (receivers, shifts)
        """
        return self.parts(link, mesh, shifts)[0]

    def parts(self, link: Link, mesh: TriangleMesh, shifts: int = SHIFTS) -> tuple[Floats, Floats]:
        """Return `gains` and their unscattered part, both of shape (receivers, shifts)."""
        arrays, aimed = self._aimed(link, mesh)
        sets = self._sets(link, arrays, aimed, shifts)
        scattered, direct = np.zeros((2, len(link.receivers), shifts))
        for e, t in arrays.pairs:
            r, share = arrays.receiver(e, t), arrays.share(e, t)
            if not aimed.sampled:
                gain = aimed.direct_gains(e, t).sum(keepdims=True)
                # the errors of chains are far larger: beside them the quadrature counts only where
                # a view ends within the aperture
                counts = aimed.meets_rim(e, t) or not any(sets)
                error = aimed.relative_error(e, t) if counts else 0.0
                direct[r] += share * with_error(gain, error)[:shifts]
            for chains in sets[e]:
                score, _ = aimed.aim(e, t, chains)
                part = direct if chains.order == 0 else scattered
                part[r] += share * score.reshape(shifts, -1).mean(axis=1)
        return scattered + direct, direct

    def unscattered(
        self, link: Link, mesh: TriangleMesh, facets: Sequence[NDArray[np.int64]] | None = None
    ) -> Floats:
        """Return the unscattered gain of each receiver of a neighbouring link, without noise.

        `facets` lists the facets that count for each receiver, all by default. The gain is 0 where
        random slopes are so narrow that chains sample unscattered light.
        """
        gain = np.zeros(len(link.receivers))
        arrays, aimed = self._aimed(link, mesh)
        for e, t in [] if aimed.sampled else arrays.pairs:
            r = arrays.receiver(e, t)
            if facets is None or len(facets[r]):
                chosen = None if facets is None else facets[r]
                gain[r] += arrays.share(e, t) * aimed.direct_gains(e, t, facets=chosen).sum()
        return gain

    def arrivals(self, link: Link, mesh: TriangleMesh) -> list[Light]:
        """Return the arrivals at each receiver of a neighbouring link."""
        arrays, aimed = self._aimed(link, mesh)
        sets = self._sets(link, arrays, aimed)
        by_receiver: list[list[Light]] = [[] for _ in link.receivers]
        for e, t in arrays.pairs:
            pieces = by_receiver[arrays.receiver(e, t)]
            if not aimed.sampled:
                pieces.append(direct_light(aimed, e, t, aimed.direct_gains(e, t)))
            pieces += [chain_light(aimed, e, t, chains) for chains in sets[e]]
        return [merged(pieces) for pieces in by_receiver]

    def _aimed(self, link: Link, mesh: TriangleMesh) -> tuple[ForcedLink, AimedChains]:
        """Return the arrays of a link and the surface prepared for it, cached if recent."""
        # in the frame of the base: another frame would scale chains and facets anew
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
                while len(self._seas) >= self._recent:
                    del self._seas[next(iter(self._seas))]
                # holds the mesh: its id is not given to another one as long as it is a key
                self._seas[key] = mesh, aimed
        # neighbours share the numbers of quadrature nodes: differences between them have no jumps
        aimed.nodes = self._nodes
        return arrays, aimed

    def _sets(
        self, link: Link, arrays: ForcedLink, aimed: AimedChains, shifts: int = SHIFTS
    ) -> list[list[ChainSet]]:
        """Return the chains of a link by source, cached for recent geometries."""
        histories, ends = _histories(link, arrays), _ends(arrays)
        key = repr((ends, histories, aimed.sampled, shifts))
        # chains that another thread is drawing are waited for, not drawn twice
        with self._lock:
            known = self._drawn.get(key)
            if known is None:
                while len(self._drawn) >= _RECENT_LINKS:
                    del self._drawn[next(iter(self._drawn))]
                drawn = self._drawn[key] = Future()
        # wait or draw outside of the lock, so that other links are not held up
        if known is not None:
            return known.result()  # no bound: work of another thread, which always sets it
        try:
            same, fixed = histories == self._histories, ends == self._ends
            drawn.set_result(self._draw(link, arrays, aimed, shifts, same, fixed))
        except BaseException as error:  # passed on to the threads that wait, too
            drawn.set_exception(error)
        return drawn.result()

    def _draw(
        self, link: Link, arrays: ForcedLink, aimed: AimedChains, shifts: int, same: bool,
        fixed: bool,
    ) -> list[list[ChainSet]]:  # fmt: skip
        """Draw as many chains of a shift as the base has, from the distributions of the base.

        With the `same` histories as the base its chains are taken, if they are stored; between
        `fixed` ends, those of the base, also their crossings of still water. Between ends nearby
        the crossings of the base are followed.
        """
        drawer, by_source = self._base.drawer.of_link(arrays), list[list[ChainSet]]()
        near = _is_near(link, arrays, self._base.link, self._base.arrays)
        for s, drawings in enumerate(self._base.sets(aimed.sampled)):
            # keys by source also for a downlink, whose receivers share one key in `Planner`
            chains = []
            for old, known in drawings:
                request = old._replace(key=(self._seed, s, old.order, 1))
                of_base = known and known.part(slice(old.per_shift * shifts))
                followed = of_base if near and request == old else None
                if same and of_base is not None and request == old:
                    moved = of_base if fixed else drawer.retargeted(s, of_base, followed)
                else:
                    moved = drawer.draw(request._replace(shifts=shifts), known=followed)
                chains.append(moved)
            by_source.append(chains)
        return by_source


def _is_near(link: Link, arrays: ForcedLink, base: Link, of_base: ForcedLink) -> bool:
    """Return whether a link is so close to a base that crossings of still water move little."""
    places, base_places = _places(arrays), _places(of_base)
    if places.shape != base_places.shape or _models(link) != _models(base):
        return False
    pairs = product(of_base.emitters, of_base.targets)
    way = min(math.dist(e.position, t.center) for e, t in pairs)
    # the first columns are lengths, the others directions and ratios
    moves = np.abs(places - base_places) / ([way] * 4 + [1.0] * 6)
    bent = abs(link.water.n / link.n_air * base.n_air / base.water.n - 1.0)
    return max(float(moves.max()), bent) <= _NEAR


def _places(arrays: ForcedLink) -> Floats:
    """Return position, radius, axis and first direction of the disk of each end, (ends, 10)."""
    ends = [(*e.position, e.radius, *e.axis, *e.e1) for e in arrays.emitters]
    ends += [(*t.center, t.radius, *t.axis, *t.e1) for t in arrays.targets]
    return np.array(ends)


def _ends(arrays: ForcedLink) -> str:
    """Return a key of the inputs of still-water crossings other than the histories of chains."""
    lamps = [(e.position, e.axis, e.radius) for e in arrays.emitters]
    return repr((lamps, [(t.center, t.axis, t.radius) for t in arrays.targets]))


def _histories(link: Link, arrays: ForcedLink) -> str:
    """Return a key of the inputs of chain histories other than the distributions of the base.

    Coefficients of the water are not part of it: weights have them.
    """
    depths = [e.position.z for e in arrays.emitters]
    return repr((depths, _models(link), link.water.n, link.n_air))


def _models(link: Link) -> list[str | None]:
    """Return the phase function, the bubbles and the physics of a link as text."""
    parts = link.water.phase, link.bubbles, link.physics
    return [None if part is None else part.model_dump_json() for part in parts]
