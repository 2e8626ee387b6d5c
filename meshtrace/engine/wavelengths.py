"""Forced detection of one link at several wavelengths with common chains and photons.

The geometry of paths is the same for all wavelengths, up to the index of the water: paths of one
of them, the base, bring light of all others by factors on their weights (`setup.tinting`). The
index is followed by some paths at its extremes, between which gains are linear.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.parts import Parts
from meshtrace.engine.photons.analog import PhotonSums, run_analog, tinted
from meshtrace.engine.setup.options import Analog, Arrivals
from meshtrace.engine.setup.tinting import (
    UNTINTED,
    Common,
    CommonPaths,
    Tinting,
    common_paths,
    photon_paths,
    scattering,
)
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.tallies import ArrivalTally

_INDEX_SHARE = 0.0625
"""Share of the paths that are refracted again by the extreme indices: their noise cancels."""


class _Group(NamedTuple):
    """Wavelengths with common paths."""

    rows: list[int]
    links: list[Link]
    detection: ForcedDetection
    tinting: Tinting | None  # None for a wavelength alone
    ends: list[ForcedDetection]  # some of the paths at the extreme indices, if these differ
    shares: Floats  # (rows,) of their difference, by the index

    def evaluate(self, mesh: TriangleMesh) -> list[Parts]:
        if self.tinting is None:
            return [self.detection.evaluate(mesh)]
        aimed, every = self.detection.over(mesh), [self.detection, *self.ends]
        found = [one.tinted(mesh, self.tinting, self.links, aimed) for one in every]
        if len(found) == 1:
            return found[0]
        rows = zip(*found, self.shares.tolist(), strict=True)
        return [_moved(*row) for row in rows]

    def arrivals(self, mesh: TriangleMesh) -> list[ArrivalTally]:
        tinting = self.tinting or UNTINTED
        found = self.detection.tinted_arrivals(mesh, tinting, self.links)
        if not self.ends:
            return found
        pairs = zip(found, self.evaluate(mesh), strict=True)
        return [tally.with_gains(parts.gain) for tally, parts in pairs]


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
        found = [scattering(link) for link in links]
        waiting = list(range(len(self.links)))
        while waiting:
            base = max(waiting, key=lambda i: found[i])
            common = common_paths(self.links, base, waiting, mixed=True)
            first, some = common.middle(), [self.links[i] for i in common.rows]
            most = found[base][0] or 1.0
            ratios = [found[i][0] / most for i in common.rows]
            kept = None if common.tinting is None else Common(common.tinting, some, ratios)
            detection = ForcedDetection(first, photons, seed, normals, threads, sea, common=kept)
            ends = [
                detection.at_index(link.water.n, _INDEX_SHARE)
                for link in common.bases
                if len(common.bases) > 1
            ]
            self._groups.append(
                _Group(common.rows, some, detection, common.tinting, ends, common.shares - 0.5)
            )
            waiting = [i for i in waiting if i not in common.rows]

    def evaluate(self, mesh: TriangleMesh) -> list[Parts]:
        """Return the gain over a mesh at each wavelength, in parts."""
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


def _moved(parts: Parts, low: Parts, high: Parts, share: float) -> Parts:
    """Return parts with a share of the difference between two, of fewer paths."""

    def moved(name: str, of: Any = parts, ends: tuple[Any, Any] = (low, high)) -> Floats:
        rows = [getattr(one, name) for one in (of, *ends)]
        width = max(row.shape[1] for row in rows)
        wide = [row if row.shape[1] == width else _widened(row, width) for row in rows]
        return np.asarray(wide[0] + share * (wide[2] - wide[1]))

    photons = parts.photons
    if photons is not None and low.photons is not None and high.photons is not None:
        groups = photons.groups + share * (high.photons.groups - low.photons.groups)
        by_order = moved("orders", photons, (low.photons, high.photons))
        photons = replace(photons, groups=groups, orders=by_order)
    direct, scattered, orders = map(moved, ("direct", "scattered", "orders"))
    return replace(parts, direct=direct, scattered=scattered, orders=orders, photons=photons)


def _widened(row: Floats, width: int) -> Floats:
    """Return an array with more columns, of zeros."""
    return np.pad(row, ((0, 0), (0, width - row.shape[1])))


def analog_sums(
    links: Sequence[Link], intersector: EmbreeIntersector, options: Analog, photons: int,
    progress: Callable[[int], None] | None, arrivals: bool = False, **how: Any,
) -> list[PhotonSums]:  # fmt: skip
    """Return the tallies of analog photons at each wavelength, of common photons where possible.

    Photons are those of several bases in turn, half of them with the smallest and half with the
    largest index of the water; so are their fates. Below bubbles that differ in number each
    wavelength has its own photons.
    """
    waiting, found = list(range(len(links))), dict[int, PhotonSums]()
    while waiting:
        _, common = photon_paths(links, waiting, mixed=True)
        group = [links[i] for i in common.rows]
        sums = _analog_group(
            common, group, intersector, options, photons, progress, arrivals, **how
        )
        found |= dict(zip(common.rows, sums, strict=True))
        waiting = [i for i in waiting if i not in found]
    return [found[i] for i in range(len(links))]


def _analog_group(
    common: CommonPaths, links: Sequence[Link], intersector: EmbreeIntersector, options: Analog,
    photons: int, progress: Callable[[int], None] | None, arrivals: bool, **how: Any,
) -> list[PhotonSums]:  # fmt: skip
    """Return the tallies of wavelengths with common photons."""
    tinting = common.tinting
    if tinting is None:
        (link,) = common.bases
        how = {**how, "photons": photons, "progress": progress}
        how["record"] = [Arrivals()] if arrivals else ()
        return [run_analog(link, intersector, options, **how)]
    several = [links[i] for i in tinting.bases] or [common.bases[0]]
    first, ends = options.first_photon, len(common.bases)
    runs = [(base, end) for base in range(len(several)) for end in range(ends)]
    cuts = [first + k * photons // len(runs) for k in range(len(runs) + 1)]
    numbers = np.diff(cuts).reshape(len(several), ends)
    strata: list[list[PhotonSums]] = []
    for k, (base, end) in enumerate(runs):
        link = several[base].replace("water.n", common.bases[end].water.n)
        n = cuts[k + 1] - cuts[k]
        sums = run_analog(
            link, intersector, options.replace(first_photon=cuts[k]), photons=n,
            progress=progress, record=[Arrivals()], tinting=tinting, **how,
        )  # fmt: skip
        of_end = int(numbers[:, end].sum())
        part = common.shares if end else 1.0 - common.shares
        scale = part * photons / of_end if ends > 1 else np.ones(len(links))

        def factors(sums: Floats, base: int = base, end: int = end, by: Floats = scale) -> Floats:
            found = tinting.mixed(sums, base, numbers[:, end] / numbers[:, end].sum())
            found *= by[:, None]
            return found

        strata.append(tinted(sums, factors, cuts[k], arrivals))
    return [PhotonSums.of_strata(rows) for rows in zip(*strata, strict=True)]
