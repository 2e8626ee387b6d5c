"""Forced detection of one link at several wavelengths with common chains and photons.

The geometry of paths is the same for all wavelengths, up to the index of the water: paths of one
of them, the base, bring light of all others by factors on their weights (`setup.tinting`). Weights
follow the index through two bases at its extremes, between which gains are linear.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.outcome import FEW_PHOTONS, receivers_of_few
from meshtrace.engine.parts import Counts, Parts
from meshtrace.engine.photons.analog import PhotonSums, run_analog, tinted
from meshtrace.engine.photons.joined import JoinedParts
from meshtrace.engine.setup.arrays import frame_of
from meshtrace.engine.setup.options import Analog, Arrivals
from meshtrace.engine.setup.tinting import UNTINTED, Tinting, tinting
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.tallies import ArrivalTally
from meshtrace.stored import SHIFTS

_OWN_PATHS = {"absorption": "paper", "free_path": "local_c"}  # forms whose weights are no products


class _Base(NamedTuple):
    """Paths of one link, and the weights that they have at the wavelengths of a group."""

    detection: ForcedDetection
    tinting: Tinting | None  # None for the link itself

    def evaluate(self, mesh: TriangleMesh, links: Sequence[Link]) -> list[Parts]:
        if self.tinting is None:
            return [self.detection.evaluate(mesh)]
        return self.detection.tinted(mesh, self.tinting, links)

    def arrivals(self, mesh: TriangleMesh, links: Sequence[Link]) -> list[ArrivalTally]:
        return self.detection.tinted_arrivals(mesh, self.tinting or UNTINTED, links)


class _Group(NamedTuple):
    """Wavelengths with common paths."""

    rows: list[int]
    links: list[Link]
    bases: list[_Base]
    shares: Floats  # (rows,) of the second base, by the index

    def evaluate(self, mesh: TriangleMesh) -> list[Parts]:
        found = [base.evaluate(mesh, self.links) for base in self.bases]
        if len(found) == 1:
            return found[0]
        low, high = found
        rows = zip(low, high, self.shares.tolist(), strict=True)
        return [_mixed(a, b, share) for a, b, share in rows]

    def arrivals(self, mesh: TriangleMesh) -> list[ArrivalTally]:
        found = [base.arrivals(mesh, self.links) for base in self.bases]
        if len(found) == 1:
            return found[0]
        rows = zip(*found, self.shares.tolist(), strict=True)
        return [low.weighted(1.0 - share).plus(high.weighted(share)) for low, high, share in rows]


class SpectralDetection:
    """Gains of one link at several wavelengths over any surface, with common paths.

    Parameters
    ----------
    links : sequence of Link
        The link at each wavelength: alike but for water, bubbles and wavelengths.
    photons, seed, normals, threads, sea
        As in `ForcedDetection`.
    mesh : TriangleMesh
        A surface over which effective sample sizes decide which wavelengths have common paths.

    Notes
    -----
    The base of a group is the link that scatters most: no order of scattering of the others is
    missing among its chains, and (b_j / b)^K has no large values. Wavelengths whose scattered
    light rests on too few effective samples (`outcome.receivers_of_few`), although that of the
    base does not, have paths from a base of their own. A wavelength alone is a run by itself.
    """

    def __init__(
        self,
        links: Sequence[Link],
        photons: int,
        seed: int,
        normals: str = "vertex",
        threads: int = 1,
        sea: TypicalSea = TypicalSea(),  # noqa: B008 - frozen
        *,
        mesh: TriangleMesh,
    ) -> None:
        self.links = list(links)
        self._run: dict[str, Any] = {"normals": normals, "threads": threads, "sea": sea}
        self._photons, self._seed = photons, seed
        self._groups: list[_Group] = []
        self._first = mesh, self._grouped(mesh)

    def evaluate(self, mesh: TriangleMesh) -> list[Parts]:
        """Return the gain over a mesh at each wavelength, in parts."""
        if mesh is self._first[0]:
            return self._first[1]
        found: dict[int, Parts] = {}
        for group in self._groups:
            found |= dict(zip(group.rows, group.evaluate(mesh), strict=True))
        return [found[row] for row in range(len(self.links))]

    def arrivals(self, mesh: TriangleMesh) -> list[ArrivalTally]:
        """Return the light that arrives over a mesh at each wavelength.

        Unscattered light has the length of its way to the centroid of a facet.
        """
        found: dict[int, ArrivalTally] = {}
        for group in self._groups:
            found |= dict(zip(group.rows, group.arrivals(mesh), strict=True))
        return [found[row] for row in range(len(self.links))]

    def _grouped(self, mesh: TriangleMesh) -> list[Parts]:
        """Form the groups; return the gains over a mesh."""
        waiting, found = list(range(len(self.links))), dict[int, Parts]()
        while waiting:
            base = max(waiting, key=lambda i: scattering(self.links[i]))
            group = self._group(base, waiting)
            parts = dict(zip(group.rows, group.evaluate(mesh), strict=True))
            few = receivers_of_few(parts[base])
            good = [i for i, one in parts.items() if receivers_of_few(one) <= few]
            if len(good) < len(parts):
                group = self._only(group, good)
            self._groups.append(group)
            found |= {i: parts[i] for i in good}
            waiting = [i for i in waiting if i not in good]
        return [found[i] for i in range(len(self.links))]

    @staticmethod
    def _only(group: _Group, rows: list[int]) -> _Group:
        """Return some wavelengths of a group."""
        kept = [group.rows.index(row) for row in rows]
        bases = []
        for base in group.bases:
            some = base.tinting and base.tinting._replace(shares=base.tinting.shares[kept])
            bases.append(base._replace(tinting=some))
        return _Group(rows, [group.links[i] for i in kept], bases, group.shares[kept])

    def _group(self, base: int, waiting: list[int]) -> _Group:
        """Return the wavelengths whose paths a base has, all if possible."""
        common = common_paths(self.links, base, waiting)
        links, bases = [self.links[i] for i in common.rows], []
        for k, link in enumerate(common.bases):
            photons = max(self._photons // len(common.bases), SHIFTS)
            seed = self._seed if k == 0 else realization_seed(self._seed, k)
            most = scattering(link)[0] or 1.0
            ratios = [scattering(one)[0] / most for one in links]
            detection = ForcedDetection(link, photons, seed, **self._run, ratios=ratios)
            bases.append(_Base(detection, common.tinting))
        return _Group(common.rows, links, bases, common.shares)


class CommonPaths(NamedTuple):
    """Wavelengths with common paths, and the links that have these."""

    rows: list[int]
    bases: list[Link]  # one, or those of the smallest and the largest index
    tinting: Tinting | None  # None for a wavelength alone
    shares: Floats  # (rows,) of the second base


def common_paths(links: Sequence[Link], base: int, waiting: Sequence[int]) -> CommonPaths:
    """Return the waiting links that can share the paths of a base, all if possible."""
    first, frame = links[base], frame_of(links[base])
    rows = [i for i in waiting if i == base or _is_alike(first, links[i])]
    found = tinting(first, [links[i] for i in rows], frame) if len(rows) > 1 else None
    if found is None:
        rows = [i for i in rows if tinting(first, [links[i]], frame) is not None]
        found = tinting(first, [links[i] for i in rows], frame)
    if len(rows) == 1:
        return CommonPaths(rows, [first], None, np.zeros(1))
    index = np.array([links[i].water.n for i in rows])
    low, high = index.min(), index.max()
    bases = [first.replace("water.n", float(n)) for n in dict.fromkeys((low, high))]
    return CommonPaths(rows, bases, found, (index - low) / (high - low or 1.0))


def _is_alike(first: Link, link: Link) -> bool:
    """Return whether two links differ in the wavelength, water and bubbles alone."""
    bubbles = (first.bubbles is None) == (link.bubbles is None)
    same = {"water": first.water, "bubbles": first.bubbles}
    waves = [t.wavelength_nm for t in first.transmitters]
    lamps = tuple(
        t.model_copy(update={"wavelength_nm": nm})
        for t, nm in zip(link.transmitters, waves, strict=False)
    )
    lamp = lamps if isinstance(link.transmitter, tuple) else lamps[0]
    floor = [(w.bottom_depth, w.bottom_albedo) for w in (first.water, link.water)]
    printed = any(getattr(link.physics, name) == form for name, form in _OWN_PATHS.items())
    if printed or not bubbles or floor[0] != floor[1]:
        return False
    return link.model_copy(update={**same, "transmitter": lamp}) == first


def clearest(links: Sequence[Link]) -> Link:
    """Return the link whose light reaches farthest: the mesh of all is fine and wide enough."""
    return min(links, key=lambda link: link.water.a)


def scattering(link: Link) -> tuple[float, float]:
    """Return the mean scattering coefficient above the deepest end, and less absorption."""
    depth = np.linspace(0.0, max(-item.center[2] for _, item in link.items()), 257)
    a, b = (float(np.mean(x)) for x in link.water.profile(depth))
    if link.bubbles is not None:
        b += float(np.mean(link.bubbles.b(depth)))
    return b, -a


def _mixed(low: Parts, high: Parts, share: float) -> Parts:
    """Return the mean of independent parts, with the share of the second."""

    def mean(a: Floats, b: Floats) -> Floats:
        return (1.0 - share) * a + share * b

    width = max(low.orders.shape[1], high.orders.shape[1])
    orders = [np.pad(p.orders, ((0, 0), (0, width - p.orders.shape[1]))) for p in (low, high)]
    scattered = mean(low.scattered, high.scattered)
    light = low.scattered.mean(axis=1), high.scattered.mean(axis=1)
    effective = _effective(*light, low.effective, high.effective, share)
    photons = low.photons
    if low.photons is not None and high.photons is not None:
        photons = _mixed_photons(low.photons, high.photons, share)
    return Parts(
        mean(low.direct, high.direct), scattered, mean(*orders),
        Counts(*(a + b for a, b in zip(low.counts, high.counts, strict=True))),
        low.method, low.samples + high.samples, low.scored + high.scored, effective, photons,
    )  # fmt: skip


def _mixed_photons(low: JoinedParts, high: JoinedParts, share: float) -> JoinedParts:
    """Return the mean of the light of independent joined photons."""
    n, groups = low.photons + high.photons, (1.0 - share) * low.groups + share * high.groups
    a, b = (p.photons * p.parts**2 / np.maximum(p.square, 1e-300) for p in (low, high))
    effective = _effective(low.parts, high.parts, a, b, share)
    square = n * groups.mean(axis=2) ** 2 / np.maximum(effective, 1e-300)
    orders = (1.0 - share) * low.orders + share * high.orders
    return replace(low, photons=n, groups=groups, orders=orders, scored=low.scored + high.scored,
                   square=square)  # fmt: skip


def _effective(a: Floats, b: Floats, na: Floats, nb: Floats, share: float) -> Floats:
    """Return the effective samples of the mean of a and b: (sum w)^2 / sum w^2."""
    a, b = (1.0 - share) * a, share * b
    squares = a**2 / np.maximum(na, 1e-300) + b**2 / np.maximum(nb, 1e-300)
    return np.asarray((a + b) ** 2 / np.maximum(squares, 1e-300))


def analog_sums(
    links: Sequence[Link], intersector: EmbreeIntersector, options: Analog, photons: int,
    progress: Callable[[int], None] | None, arrivals: bool = False, **how: Any,
) -> list[PhotonSums]:  # fmt: skip
    """Return the tallies of analog photons at each wavelength, of common photons where possible.

    Fates are those of the base. Below bubbles each wavelength has its own photons, see
    `JoinedPhotons.at_wavelengths`.
    """
    waiting, found = list(range(len(links))), dict[int, PhotonSums]()
    while waiting:
        base, common = photon_paths(links, waiting)
        sums = _analog_group(common, intersector, options, photons, progress, arrivals, **how)
        effective = {
            i: one.score**2 / np.maximum(one.score_squared, 1e-300)
            for i, one in zip(common.rows, sums, strict=True)
        }
        limit = min(FEW_PHOTONS, 0.5 * float(effective[base].min()))
        for i, one in zip(common.rows, sums, strict=True):
            if i == base or (effective[i] >= limit).all():
                found[i] = one
        waiting = [i for i in waiting if i not in found]
    return [found[i] for i in range(len(links))]


def photon_paths(links: Sequence[Link], waiting: Sequence[int]) -> tuple[int, CommonPaths]:
    """Return the base of the waiting links that scatters most, and those with its photons."""
    base = max(waiting, key=lambda i: scattering(links[i]))
    own = links[base].bubbles is not None
    common = common_paths(links, base, [base] if own else waiting)
    if common.tinting is not None and not common.tinting.follows:
        common = common_paths(links, base, [base])
    return base, common


def _analog_group(
    common: CommonPaths, intersector: EmbreeIntersector, options: Analog, photons: int,
    progress: Callable[[int], None] | None, arrivals: bool, **how: Any,
) -> list[PhotonSums]:  # fmt: skip
    """Return the tallies of wavelengths with common photons."""
    if common.tinting is None:
        (link,) = common.bases
        how = {**how, "photons": photons, "progress": progress}
        how["record"] = [Arrivals()] if arrivals else ()
        return [run_analog(link, intersector, options, **how)]
    ends, first = len(common.bases), options.first_photon
    cuts = [first + k * photons // ends for k in range(ends + 1)]
    found: list[PhotonSums] = []
    for k, link in enumerate(common.bases):
        n = cuts[k + 1] - cuts[k]
        sums = run_analog(
            link, intersector, options.replace(first_photon=cuts[k]), photons=n,
            progress=progress, record=[Arrivals()], tinting=common.tinting, **how,
        )  # fmt: skip
        part = common.shares if k else 1.0 - common.shares
        scale = part * photons / n if ends > 1 else np.ones(len(common.rows))
        some = tinted(sums, common.tinting, cuts[k], scale, arrivals)
        found = [a.plus(b) for a, b in zip(found, some, strict=True)] if found else some
    return found
