"""Forced detection by aiming: chains of scatterings, turned so that they hit the aperture.

Everything random about a photon except its emission direction is drawn; then the directions
that land it on a random point x of the aperture are solved for. With K scatterings

    h_K = E[ |A| sum_{w: X_K(w) = x} I(w) W_K(w) / |det dX_K / dOmega(w)| ],   h = sum_K h_K.

K = 0 is deterministic (`kernels.image`); every K >= 1 has its own chains. The points are
randomly shifted Sobol points: the mean of each shift is an unbiased estimate of its own, and
the scatter of the shifts gives the standard error.

The chains do not depend on the surface: one set serves every frame of a moving sea.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.bvh import EmbreeIntersector
from meshtrace.kernels import aiming
from meshtrace.kernels import chain_gain as kernel
from meshtrace.kernels import chains as chain_kernel
from meshtrace.kernels import sources as source_codes
from meshtrace.kernels import unscattered as image
from meshtrace.kernels.chains import Chains, Nominal
from meshtrace.kernels.facets import Surface
from meshtrace.kernels.medium import Medium
from meshtrace.link import GaussianBeam, Led, Link, Receiver, TopHatBeam, WaterSource
from meshtrace.mesh import TriangleMesh
from meshtrace.stored import SHIFTS
from meshtrace.transport.arrays import (
    interface_arrays,
    medium_arrays,
    surface_arrays,
    with_raster,
)

_TAIL = 1e-7  # orders whose share of a Poisson law is smaller together are left out
_MAX_ORDER = 40
_NARROWEST = 0.1  # [deg], of a lamp: narrower spots are smaller than the parts of a facet
_MOST_CROWDED = 4.0  # density of collisions near the surface over the mean: chains fill the way
_MOST_LEFT_OUT = 1e-3  # share of the light beyond the highest order
_UP = np.array([0.0, 0.0, 1.0])
_ROOTS = 64  # crossings of one chain at most
_CROSSINGS = 4  # of a flat sea, kept for each chain
_PILOT = 128  # chains of each order that set the allocation
_UNSCATTERED_SHARE = 0.3  # chains without a scattering, over the scattered ones


class Stratum(NamedTuple):
    """The chains of one order from one source, and where they cross a flat sea."""

    order: int
    chains: Chains
    flat: list[NDArray[np.float64]]  # by receiver, (n, crossings, columns)
    audit: NDArray[np.float64]


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

    Raises
    ------
    ValueError
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
    ) -> None:
        _check(link)
        self._crest = max(crest, 0.0)
        lowest = min(r.center[2] for r in link.receivers)
        # a chain that ends higher is not looked for; the level must stay below the receivers
        self._ceiling = self._crest + min(
            0.25 * (self._crest + 1.0), 0.5 * max(lowest - self._crest, 0.0)
        )
        self._key = (photons, seed)
        self.link = link
        self.normals = normals
        self.threads = threads
        self._interface = interface_arrays(link)
        self._medium = _effective(link)
        self._emitters = [_emitter(t) for t in link.transmitters if isinstance(t, WaterSource)]
        self._power = np.array([t.power_mw for t in link.transmitters])
        self._power /= self._power.sum()
        self._targets = [_target(r) for r in link.receivers if isinstance(r, Receiver)]
        self._strata = [
            self._stratify(i, max(photons // len(self._emitters), SHIFTS), seed)
            for i in range(len(self._emitters))
        ]

    def _stratify(self, source: int, photons: int, seed: int) -> list[Stratum]:
        """Draw the chains of a source; a pilot over a flat sea allots them to the orders."""
        emitter = self._emitters[source]
        nominal = _nominal(self._medium, emitter, self._targets[0], self._crest)
        orders = range(1, _last_order(self._medium, nominal) + 1)
        flat_sea = _flat_mesh(crossing_reach(self.link) + 10.0)
        spread = []
        for order in orders:
            pilot = self._draw(emitter, nominal, order, _PILOT // SHIFTS, (seed, source, order, 0))
            score = self._over(flat_sea).score(emitter, self._targets[0], 0, pilot)
            spread.append(score.std() / math.sqrt(1.0 + 0.3 * order))
        share = np.array(spread) / max(sum(spread), 1e-300)
        per_shift = np.maximum(np.ceil(share * photons / SHIFTS), 2).astype(int)
        return [
            self._draw(emitter, nominal, order, n, (seed, source, order, 1))
            for order, n in zip(orders, per_shift, strict=True)
        ]

    def _draw(
        self,
        emitter: aiming.Emitter,
        nominal: Nominal,
        order: int,
        per_shift: int,
        key: tuple[int, ...],
    ) -> Stratum:
        """Return the chains of one order, `per_shift` for each shift of the points."""
        from scipy.stats import qmc

        width = chain_kernel.DIMENSIONS * order + 6
        rng = np.random.default_rng(key)
        points = qmc.Sobol(width, scramble=True, rng=rng).random_base2(
            math.ceil(math.log2(max(per_shift, 2)))
        )[:per_shift]
        u = (points[None] + rng.random((SHIFTS, 1, width))) % 1.0
        u = np.clip(u.reshape(-1, width), 1e-12, 1.0 - 1e-12)
        n = len(u)
        chains = Chains(
            vertex=np.empty((n, order, 3)),
            kind=np.zeros((n, order), np.int8),
            last=np.empty((n, 3)),
            path=np.empty(n),
            weight=np.empty(n),
            disk=np.empty((n, 2)),
            tail=np.empty((n, 3)),
            tilt=np.empty((n, 2)),
        )
        chain_kernel.make_chains(
            chains, nominal, self._medium, u, u[:, -1] < chain_kernel.FREE_PATH_SHARE
        )
        empty, no_facets = _empty_locator(), np.zeros((0, aiming.N_FACET_COLUMNS))
        still = surface_arrays(_flat_mesh(1.0), "facet")
        raised = still._replace(level=self._ceiling)
        flat = []
        for target in self._targets:
            out = np.zeros((n, _CROSSINGS, kernel.N_FLAT_COLUMNS))
            scene = aiming.Scene(
                emitter, target, still, empty, no_facets, self._medium, self._interface
            )
            kernel.flat_crossings(
                chains, _starts(emitter, target), scene, scene._replace(surface=raised), out
            )
            flat.append(out)
        return Stratum(order, chains, flat, np.ascontiguousarray(u[:, -2]))

    def _over(self, mesh: TriangleMesh, intersector: EmbreeIntersector | None = None) -> _Aimed:
        return _Aimed(self, mesh, intersector)

    def evaluate(self, mesh: TriangleMesh, intersector: EmbreeIntersector | None = None) -> Parts:
        """Return the gain over a mesh, in parts."""
        top = float(mesh.bounds[1, 2])
        if top > self._ceiling:  # far higher than expected: chains that reach up there
            higher = type(self)(self.link, *self._key, self.normals, self.threads, top)
            return higher.evaluate(mesh, intersector)
        aimed = self._over(mesh, intersector)
        n_rx = len(self._targets)
        strata = self._strata_over(aimed)
        n_orders = 1 + max(len(s) for s in self._strata)
        by_order = np.zeros((n_rx, n_orders, SHIFTS))
        jobs = [
            (s, r, stratum)
            for s in range(len(self._emitters))
            for r in range(n_rx)
            for stratum in strata[s]
        ]
        pairs = [(s, r) for s in range(len(self._emitters)) for r in range(n_rx)]
        with ThreadPoolExecutor(self.threads) as pool:
            images = list(
                pool.map(
                    lambda sr: aimed.ballistic(self._emitters[sr[0]], self._targets[sr[1]]),
                    [] if aimed.rough else pairs,
                )
            )
            scores = list(
                pool.map(
                    lambda job: aimed.score(
                        self._emitters[job[0]], self._targets[job[1]], job[1], job[2]
                    ),
                    jobs,
                )
            )
        for (s, r), value in zip(pairs, images, strict=False):
            by_order[r, 0] += self._power[s] * value
        for (s, r, stratum), score in zip(jobs, scores, strict=True):
            means = score.reshape(SHIFTS, -1).mean(axis=1)
            by_order[r, stratum.order] += self._power[s] * means
        total = sum(len(stratum.audit) for row in strata for stratum in row)
        return Parts(
            by_order[:, 0],
            by_order[:, 1:].sum(axis=1),
            by_order[:, 1:].mean(axis=2),
            Counts(total, *(int(c) for c in aimed.counters)),
        )

    def _strata_over(self, aimed: _Aimed) -> list[list[Stratum]]:
        """Return the chains by source, with unscattered ones where slopes are random."""
        if not aimed.rough:
            return self._strata
        return [[first, *row] for first, row in zip(self._unscattered, self._strata, strict=True)]

    @cached_property
    def _unscattered(self) -> list[Stratum]:
        """Chains without a scattering, by source; only a random slope tells them apart."""
        photons, seed = self._key
        per_shift = max(math.ceil(_UNSCATTERED_SHARE * photons / len(self._emitters) / SHIFTS), 2)
        return [
            self._draw(
                emitter,
                _nominal(self._medium, emitter, self._targets[0], self._crest),
                0,
                per_shift,
                (seed, source, 0, 1),
            )
            for source, emitter in enumerate(self._emitters)
        ]

    def arrivals(self, mesh: TriangleMesh) -> list[NDArray[np.float64]]:
        """Return, by receiver, rows of weight, path in water, path in air [m] and shift.

        The weights of a receiver add up to its gain. Unscattered light without random slopes
        is one row a facet, with shift -1: it has no Monte Carlo error.
        """
        aimed = self._over(mesh)
        strata = self._strata_over(aimed)
        result = []
        for r, target in enumerate(self._targets):
            rows = []
            for s, emitter in enumerate(self._emitters):
                if not aimed.rough:
                    gains = self._power[s] * aimed.facet_gains(emitter, target)
                    lit = np.flatnonzero(gains)
                    centroid = mesh.vertices[mesh.faces[lit]].mean(axis=1)
                    rows.append(
                        np.column_stack(
                            [
                                gains[lit],
                                np.linalg.norm(centroid - emitter.position, axis=1),
                                np.linalg.norm(centroid - target.center, axis=1),
                                np.full(len(lit), -1.0),
                            ]
                        )
                    )
                for stratum in strata[s]:
                    _, found = aimed.aim(emitter, target, r, stratum, keep=True)
                    n = len(stratum.audit)
                    shift = found[:, 0] // (n // SHIFTS)
                    weight = self._power[s] * found[:, 1] / n
                    rows.append(np.column_stack([weight, found[:, 2], found[:, 3], shift]))
            result.append(np.concatenate(rows))
        return result

    def received(
        self, mesh: TriangleMesh, n: int, rng: np.random.Generator
    ) -> list[tuple[NDArray[np.float64], float]]:
        """Return n paths of light into the first receiver, drawn by the light they carry.

        Each is (points, weight) from the source over its scatterings and the crossing to the
        aperture; all carry the same share of the gain.
        """
        aimed = self._over(mesh)
        strata = self._strata_over(aimed)
        target = self._targets[0]
        light: list[float] = []
        paths: list[NDArray[np.float64]] = []
        for s, emitter in enumerate(self._emitters):
            gains = np.zeros(0) if aimed.rough else aimed.facet_gains(emitter, target)
            lit = np.flatnonzero(gains)
            if len(lit):
                facets = rng.choice(lit, n, p=gains[lit] / gains[lit].sum())
                u = rng.random((n, 2))
                disk = np.sqrt(u[:, :1]) * np.stack(
                    [np.cos(2.0 * np.pi * u[:, 1]), np.sin(2.0 * np.pi * u[:, 1])], axis=1
                )
                direct = aimed.direct_paths(emitter, target, facets, disk)
                paths += list(direct)
                light += [self._power[s] * gains.sum() / max(len(direct), 1)] * len(direct)
            for stratum in strata[s]:
                _, found = aimed.aim(emitter, target, 0, stratum, keep=True)
                weight = self._power[s] * found[:, 1] / len(stratum.audit)
                if not weight.sum() > 0.0:
                    continue
                kept = rng.choice(len(found), min(n, len(found)), p=weight / weight.sum())
                for k in kept:
                    paths.append(_placed(stratum.chains, found[k], emitter, target))
                light += [float(weight.sum()) / max(len(kept), 1)] * len(kept)
        if not paths:
            return []
        share = np.array(light) / sum(light)
        total = float(sum(light))
        return [(paths[k], total / n) for k in rng.choice(len(paths), n, p=share)]


def _placed(
    chains: Chains, arrival: NDArray[np.float64], emitter: aiming.Emitter, target: aiming.Target
) -> NDArray[np.float64]:
    """Return the points of a chain turned to its emission direction, up to the aperture."""
    from scipy.spatial.transform import Rotation

    i, w = int(arrival[0]), arrival[8:11]
    axis = np.array([-w[1], w[0], 0.0])
    sine = np.linalg.norm(axis)
    angle = math.atan2(sine, w[2])
    turn = Rotation.from_rotvec(axis * (angle / sine if sine > 0.0 else 0.0))
    vertices = turn.apply(chains.vertex[i]) + emitter.position
    return np.vstack(
        [emitter.position, vertices, arrival[5:8], _on_disk(target, chains.disk[i : i + 1])]
    )


def _on_disk(target: aiming.Target, disk: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of an aperture that belong to points of the unit disk."""
    plane = np.array([target.e1, target.e2])
    return np.asarray(target.center) + target.radius * disk @ plane


def crossing_reach(link: Link) -> float:
    """Return how far from the axis z = 0 light can cross to a receiver of the link [m]."""
    _check(link)
    targets = [_target(r) for r in link.receivers if isinstance(r, Receiver)]
    return max(t.reach + math.hypot(t.center[0], t.center[1]) for t in targets)


class _Aimed:
    """The chains' view of one surface."""

    def __init__(
        self, forced: ForcedDetection, mesh: TriangleMesh, intersector: EmbreeIntersector | None
    ) -> None:
        self._forced = forced
        self._mesh = mesh
        self._given = intersector
        self.surface: Surface = surface_arrays(mesh, forced.normals, forced.link.physics.unresolved)
        rough = self.surface.roughness
        self.rough = rough.along > 0.0 or rough.across > 0.0
        self.facets = np.empty((len(mesh.faces), aiming.N_FACET_COLUMNS))
        aiming.facet_summary(self.surface, self.facets)
        self.medium = forced._medium
        if self.medium.depth_mode == 3:
            self.medium = with_raster(self.medium, self.intersector)
        self.locator = _locator(self.surface, forced._targets)
        self.counters = np.zeros(kernel.N_COUNTERS, np.int64)
        self._waves = max(abs(float(self.surface.low[2])), abs(float(self.surface.high[2])))

    @cached_property
    def intersector(self) -> EmbreeIntersector:
        """Embree scene of the mesh, made when a path has to be checked."""
        return self._given or EmbreeIntersector(self._mesh, 1)

    def _scene(self, emitter: aiming.Emitter, target: aiming.Target) -> aiming.Scene:
        return aiming.Scene(
            emitter,
            target,
            self.surface,
            self.locator,
            self.facets,
            self.medium,
            self._forced._interface,
        )

    def _search(self, target: aiming.Target) -> kernel.Search:
        """Return how far and how thoroughly roots are looked for."""
        n = self.medium.n_water / self.medium.n_air
        curvature, radius = self._largest
        focusing = curvature * _lever(n, target, self._waves)
        audit = 1.0 if self._forced.normals == "facet" or focusing > 1.0 else 0.02
        return kernel.Search(audit, self.surface.max_slope, 2.0 * radius, target.reach + 1.0)

    @cached_property
    def _largest(self) -> tuple[float, float]:
        """Largest curvature [1/m] and radius [m] of the facets that light can cross."""
        near = self.locator.facet
        listed = self.facets[near] if len(near) else self.facets
        return float(listed[:, aiming.CURVATURE].max()), float(listed[:, aiming.RADIUS].max())

    def score(
        self, emitter: aiming.Emitter, target: aiming.Target, receiver: int, stratum: Stratum
    ) -> NDArray[np.float64]:
        """Return what each chain of a stratum brings into an aperture."""
        return self.aim(emitter, target, receiver, stratum, keep=False)[0]

    def aim(
        self,
        emitter: aiming.Emitter,
        target: aiming.Target,
        receiver: int,
        stratum: Stratum,
        keep: bool,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the score of each chain and, if wished, its arrivals, blocked ones left out."""
        n = len(stratum.audit)
        score = np.zeros(n)
        most = 2 * n + 64
        doubtful, rays = np.zeros((most, 2)), np.zeros((most * (stratum.order + 2), 8))
        arrivals = np.zeros((most if keep else 0, kernel.N_ARRIVAL_COLUMNS))
        counters = np.zeros(kernel.N_COUNTERS, np.int64)
        n_doubt, n_rays, n_arrivals = kernel.contributions(
            stratum.chains,
            stratum.flat[receiver],
            stratum.audit,
            self._search(target),
            self._scene(emitter, target),
            np.zeros((_ROOTS, 5)),
            score,
            doubtful,
            rays,
            arrivals,
            counters,
        )
        arrivals = arrivals[:n_arrivals]
        if n_doubt:
            cut = np.zeros(n_doubt, bool)
            paths = rays[:n_rays]
            cut[paths[self._cut(paths[:, 1:4], paths[:, 4:7], paths[:, 7]), 0].astype(int)] = True
            clear = doubtful[:n_doubt][~cut]
            np.add.at(score, clear[:, 0].astype(int), clear[:, 1])
            counters[kernel.BLOCKED] += int(cut.sum())
            doubt = arrivals[:, 4].astype(int)
            arrivals = arrivals[(doubt < 0) | ~cut[doubt]]
        self.counters += counters
        return score, arrivals

    def _cut(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        lengths: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Return which straight paths meet the surface before their ends.

        A path that starts or ends on the surface is shortened by a hair at both ends.
        """
        hair = 1e-4 * (1.0 + lengths)
        start = origins + hair[:, None] * directions
        hits = self.intersector.intersect(start, directions)
        return hits.distance < lengths - 3.0 * hair

    def ballistic(self, emitter: aiming.Emitter, target: aiming.Target) -> float:
        """Return the unscattered gain."""
        return float(self.facet_gains(emitter, target).sum())

    def facet_gains(self, emitter: aiming.Emitter, target: aiming.Target) -> NDArray[np.float64]:
        """Return the unscattered gain through each facet."""
        n = self.medium.n_water / self.medium.n_air
        depth = -emitter.position[2]
        stretch = 1.5 * (1.0 + n * (target.center[2] + self._waves) / max(depth - self._waves, 0.1))
        lever = 1.5 * _lever(n, target, self._waves)
        score = np.zeros((len(self._mesh.faces), 2))
        doubtful = image.image_gain(
            self._scene(emitter, target), 1.5 * stretch, lever, np.zeros(3), _UP, score
        )
        if doubtful:
            score[self._hidden(emitter, target, np.flatnonzero(score[:, 1])), 0] = 0.0
        return score[:, 0]

    def direct_paths(
        self,
        emitter: aiming.Emitter,
        target: aiming.Target,
        facets: NDArray[np.intp],
        disk: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return (n, 3, 3): source, crossing and landing of unscattered light near facets."""
        centroid = self._mesh.vertices[self._mesh.faces[facets]].mean(axis=1)
        out = np.zeros((len(facets), 4))
        kernel.direct_crossings(disk, centroid, self._scene(emitter, target), np.zeros(3), _UP, out)
        found = out[:, 0] > 0.0
        paths = np.empty((len(facets), 3, 3))
        paths[:, 0] = emitter.position
        paths[:, 1] = out[:, 1:]
        paths[:, 2] = _on_disk(target, disk)
        return paths[found]

    def _hidden(
        self, emitter: aiming.Emitter, target: aiming.Target, facets: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        """Return the facets whose centroid the source or the aperture's centre cannot see."""
        centroid = self._mesh.vertices[self._mesh.faces[facets]].mean(axis=1)
        cut = np.zeros(len(facets), bool)
        for end in (emitter.position, target.center):
            way = centroid - np.asarray(end)
            length = np.linalg.norm(way, axis=1)
            cut |= self._cut(np.broadcast_to(end, way.shape), way / length[:, None], length)
        return facets[cut]


def _lever(n: float, target: aiming.Target, waves: float) -> float:
    """Return a bound on how far a unit of slope moves the landing point [m]."""
    sin_t = min(target.sin_widest, 0.98)
    cos_t = math.sqrt(1.0 - sin_t**2)
    cos_i = math.sqrt(1.0 - (sin_t / n) ** 2)
    return (target.center[2] + waves) * abs(n * cos_i / cos_t - 1.0) / cos_t**2


def _check(link: Link) -> None:
    for t in link.transmitters:
        if not isinstance(t, WaterSource):
            raise ValueError(
                f"transmitter: {t.kind}, allowed a source in the water; light from the air needs "
                'estimator="analog"'
            )
        if getattr(t, "waist", 0.0) or getattr(t, "radius", 0.0):
            raise ValueError(
                f"{t.kind}: an extended source, allowed a point (waist or radius 0); extended "
                'sources need estimator="analog"'
            )
        for name in ("half_angle_deg", "divergence_deg"):
            angle = getattr(t, name, _NARROWEST)
            if angle < _NARROWEST:
                raise ValueError(
                    f"{t.kind}.{name}: {angle:g}, allowed >= {_NARROWEST:g}; narrower light needs "
                    'estimator="analog"'
                )
    if not link.receivers:
        raise ValueError("receiver: (), allowed at least one")
    for r in link.receivers:
        if not isinstance(r, Receiver):
            raise ValueError(
                f'receiver: {r.kind}, allowed a receiver in the air; else estimator="analog"'
            )
    if link.water.bottom_depth is not None:
        raise ValueError(
            f"water.bottom_depth: {link.water.bottom_depth:g} m, allowed None; light that meets "
            'the bottom needs estimator="analog"'
        )
    if link.planes is not None:
        raise ValueError('planes: given, allowed None; irradiances need estimator="analog"')
    stratified = link.bubbles is not None or link.water.layers is not None
    if stratified and (link.physics.absorption == "paper" or link.physics.free_path == "local_c"):
        raise ValueError(
            'physics: absorption="paper" or free_path="local_c" in stratified water, allowed the '
            'physical forms; the printed ones need estimator="analog"'
        )


def _effective(link: Link) -> Medium:
    """Return the water; the printed Algorithm 1 acts as b -> albedo b (E5)."""
    medium = medium_arrays(link, crest=5.0)
    if link.physics.absorption == "paper":
        medium = medium._replace(b=medium.b * link.water.albedo)
    return medium


def _emitter(source: WaterSource) -> aiming.Emitter:
    if isinstance(source, Led):
        kind, spread = source_codes.LAMBERTIAN, source.order
        norm = (spread + 1.0) / (2.0 * math.pi)
    elif isinstance(source, GaussianBeam):
        kind, spread = source_codes.GAUSSIAN, math.radians(source.divergence_deg)
        norm = 2.0 / (math.pi * spread**2)
    elif isinstance(source, TopHatBeam):
        kind, spread = source_codes.TOP_HAT, math.radians(source.divergence_deg)
        norm = 1.0 / (2.0 * math.pi * (1.0 - math.cos(spread)))
    else:
        kind, spread, norm = source_codes.ISOTROPIC, 0.0, 1.0 / (4.0 * math.pi)
    x, y = source.position
    return aiming.Emitter((x, y, -source.depth), source.axis, kind, float(spread), norm)


def _target(receiver: Receiver) -> aiming.Target:
    axis = np.array(receiver.axis)
    e1 = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.9 else (1.0, 0.0, 0.0))
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    half = math.radians(receiver.fov_deg) / 2.0
    widest = min(half + math.radians(receiver.tilt_deg), math.radians(88.0))
    return aiming.Target(
        center=receiver.center,
        axis=receiver.axis,
        e1=(float(e1[0]), float(e1[1]), float(e1[2])),
        e2=(float(e2[0]), float(e2[1]), float(e2[2])),
        radius=receiver.radius,
        cos_half_fov=0.0 if half >= math.pi / 2.0 else math.cos(half),
        tan_half_fov=math.tan(min(half, 1.55)),
        reach=min((receiver.height + 2.0) * math.tan(widest), 200.0) + 2.0 * receiver.radius,
        sin_widest=math.sin(widest),
    )


def _nominal(
    medium: Medium, emitter: aiming.Emitter, target: aiming.Target, crest: float
) -> Nominal:
    """Return where collisions are expected along the straight way to the highest crest."""
    depth = crest - emitter.position[2]
    n = medium.n_water / medium.n_air
    share = depth / (depth + n * target.center[2])
    offset = share * math.hypot(
        target.center[0] - emitter.position[0], target.center[1] - emitter.position[1]
    )
    distance = math.hypot(depth, offset)
    nodes = 513
    height = np.linspace(0.0, 1.0, nodes) * depth
    below = depth - height
    b = np.interp(below / medium.layer_step, np.arange(len(medium.layer_b)), medium.layer_b)
    if not medium.layered:
        b = np.full(nodes, medium.b)
    # chains are turned and waves rise: what lies a little higher must be likely enough
    at = (np.maximum(below - 0.3, 0.0) - medium.bubble_start) / medium.bubble_step
    b_bub = np.interp(at, np.arange(len(medium.bubble_b)), medium.bubble_b, right=0.0)
    total = np.maximum(b + b_bub, 1e-12)
    step = distance / (nodes - 1)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * step * (total[1:] + total[:-1]))])
    c = max(medium.a + float(b.mean()), 1e-3 / distance)
    return Nominal(
        distance,
        c,
        step,
        cumulative / cumulative[-1],
        total / cumulative[-1],
        np.where(total > 0.0, b_bub / total, 0.0),
        float(cumulative[-1]),
    )


def _last_order(medium: Medium, nominal: Nominal) -> int:
    """Return the order behind which a Poisson law of the scatterings holds less than 1e-7."""
    from scipy.stats import poisson

    b = medium.layer_b.mean() if medium.layered else medium.b
    expected = 1.2 * max(nominal.expected, b * nominal.distance + float(medium.bubble_path[-1]))
    if b == 0.0 and medium.bubble_path[-1] == 0.0:
        return 0
    if poisson.sf(_MAX_ORDER, 1.2 * nominal.expected) > _MOST_LEFT_OUT:
        raise ValueError(
            f"water: {nominal.expected:.3g} scatterings expected on the way to the surface, "
            f'allowed: nearly all light within {_MAX_ORDER}; more need estimator="analog"'
        )
    upper = float(nominal.density[len(nominal.density) // 2 :].max()) * nominal.distance
    if medium.layered and upper > _MOST_CROWDED and nominal.expected > 2.0:
        raise ValueError(
            f"water.layers: {nominal.expected:.3g} scatterings expected, {upper:.3g} times "
            f"as dense near the surface as on average, allowed up to {_MOST_CROWDED:g}; light that "
            'wanders in a thin turbid layer needs estimator="analog"'
        )
    return int(min(max(poisson.isf(_TAIL, expected), 1), _MAX_ORDER))


def _flat_mesh(extent: float) -> TriangleMesh:
    corners = [
        (-extent, -extent, 0.0),
        (extent, -extent, 0.0),
        (extent, extent, 0.0),
        (-extent, extent, 0.0),
    ]
    return TriangleMesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]))


def _starts(emitter: aiming.Emitter, target: aiming.Target) -> NDArray[np.float64]:
    """Return points (x, y) from which flat crossings are looked for: the likely one first.

    Light that arrives flatter than 60 degrees crosses far out, where Newton comes from anywhere.
    """
    rx, ry = target.center[:2]
    sx, sy = emitter.position[:2]
    rows = [(rx, ry), (0.5 * (rx + sx), 0.5 * (ry + sy)), (sx, sy)]
    reach = min(target.reach, 2.0 * (target.center[2] + 2.0))
    for radius in (0.3, 0.8):
        for azimuth in np.arange(6) * math.pi / 3.0 + radius:
            rows.append(
                (
                    rx + radius * reach * math.cos(azimuth),
                    ry + radius * reach * math.sin(azimuth),
                )
            )
    return np.array(rows)


def _empty_locator() -> aiming.Locator:
    return aiming.Locator(0.0, 0.0, 1.0, 0, 0, np.zeros(1, np.int64), np.zeros(0, np.int32))


def _locator(surface: Surface, targets: Sequence[aiming.Target]) -> aiming.Locator:
    """Return bins over the part of the surface that the receivers can see."""
    pad = 2.0
    low = [min(t.center[i] - t.reach - pad for t in targets) for i in range(2)]
    high = [max(t.center[i] + t.reach + pad for t in targets) for i in range(2)]
    low = [max(low[i], float(surface.low[i])) for i in range(2)]
    high = [min(high[i], float(surface.high[i])) for i in range(2)]
    width = max(high[0] - low[0], high[1] - low[1])
    step = max(0.1, width / 400.0)
    nx, ny = (max(math.ceil((high[i] - low[i]) / step), 1) for i in range(2))
    start = np.zeros(nx * ny + 1, np.int64)
    aiming.count_bins(surface, low[0], low[1], step, nx, ny, start)
    np.cumsum(start, out=start)
    facet = np.empty(start[-1], np.int32)
    aiming.fill_bins(surface, low[0], low[1], step, nx, ny, start, start[:-1].copy(), facet)
    return aiming.Locator(low[0], low[1], step, nx, ny, start, facet)
