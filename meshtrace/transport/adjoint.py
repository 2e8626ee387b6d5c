"""Adjoint paths: scattered light traced from the receiver to the source.

Where light arrives only by scattering, hardly any chain aimed at the aperture contributes; paths
from the aperture cross the surface first, and their connection to the source lies entirely in the
water. With x on the aperture and w in the field of view,

    h = E[ |A| cos(x, w) / p(w) T (n_air / n_water)^2 sum_k W_k L_k ],

W_k the weight behind k scatterings and L_k the light that the path's segment receives by one more
(`meshtrace.kernels.line_estimate`). Unscattered light is not included.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.bvh import EmbreeIntersector
from meshtrace.errors import Refused
from meshtrace.kernels import adjoint as kernel
from meshtrace.kernels import adjoint_look as looking
from meshtrace.kernels import adjoint_start as starting
from meshtrace.kernels.interface import FieldOfView
from meshtrace.kernels.line_estimate import Optics
from meshtrace.kernels.medium import DepthMode, Medium
from meshtrace.kernels.scene import Emitter
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.link.sources import AirLamp
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.stored import SHIFTS
from meshtrace.transport.arrays import angle_table, interface_arrays, surface_arrays, with_raster
from meshtrace.transport.forced_link import (
    emitter_of,
    expected_water,
    lamp_target,
    require_followable,
    target_of,
)
from meshtrace.transport.frame import frame_of

_BLOCK = 4096  # paths of one block; sums of blocks do not depend on threads
_ORDERS = 40  # separate numbers of scatterings; the last holds all beyond
_EVEN, _AIMED = 0.5, 0.3  # shares of free paths and of directions, see `World`
_FAN, _LIT, _MORE = 0.6, 0.2, 0.5  # the same in the beam of a narrow source; more side paths there
_SPENT = 0.1  # exp(-b z / 2) below which a beam is not aimed at
_WIDEST = 0.5  # [rad] standard deviation of a beam that is aimed at
_BRANCHES = 8  # side paths of one path that wait at a time
_ROUNDS = 3  # of looking for the facets below the crossings
_SWITCHES = {"snell": "physical", "direction": "vector", "second_hit": "trace"}


class Sums(NamedTuple):
    """Sums over the paths of a block."""

    groups: Floats  # (SHIFTS,)
    orders: Floats  # (orders,)
    square: float
    scored: int
    beside: int
    arrivals: Floats | None  # (arrivals, 4) weight, way in water and air, group


@dataclass(frozen=True)
class AdjointParts:
    """Scattered gain over one surface.

    Attributes
    ----------
    photons : int
        Paths for each receiver.
    scattered : ndarray, shape (receivers, SHIFTS)
        Scattered gain of each group of paths; its mean over the groups is the scattered gain.
    orders : ndarray, shape (receivers, orders)
        Scattered gain by the number of scatterings, from 1 on; the last holds all beyond.
    scored : ndarray of int, shape (receivers,)
        Paths that received light.
    variance : ndarray, shape (receivers,)
        Variance of the gain of one path.
    beside : ndarray, shape (receivers,)
        Share of the paths that passed beside the mesh, where no surface is known.
    arrivals : list of ndarray, shape (arrivals, 4), or None
        By receiver: weight, path in water, path in air [m] and group. The weights of a receiver
        add up to its scattered gain.
    """

    photons: int
    scattered: Floats
    orders: Floats
    scored: NDArray[np.int64]
    variance: Floats
    beside: Floats
    arrivals: list[Floats] | None = None

    @property
    def gain(self) -> Floats:
        """Scattered gain of each receiver."""
        return self.scattered.mean(axis=1)

    @property
    def stderr(self) -> Floats:
        """Standard error of the scattered gain of each receiver."""
        return self.scattered.std(axis=1, ddof=1) / math.sqrt(SHIFTS)


class AdjointPaths:
    """Adjoint paths of a link, for any surface.

    Parameters
    ----------
    link : Link
        The link; sources on the other side of the surface than the receivers.
    photons : int
        Paths for each receiver, >= 32 for each source.
    seed : int
        Key of the random numbers, 0 <= seed < 2^64. The numbers of a receiver depend on the
        seed and its rank among the receivers sorted by their fields, not on their order.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; results do not depend on them.

    Raises
    ------
    Refused
        If the link has a feature that the paths do not follow.

    Notes
    -----
    Light crosses the surface once: light reflected back into the water is omitted.
    """

    def __init__(
        self, link: Link, photons: int, seed: int, normals: str = "vertex", threads: int = 1
    ) -> None:
        require_followable(link)
        for name, kept in _SWITCHES.items():
            if getattr(link.physics, name) != kept:
                raise Refused(f"physics.{name}", getattr(link.physics, name), f'"{kept}"')
        if photons < SHIFTS * len(link.transmitters):
            raise Refused("photons", photons, f">= {SHIFTS} for each source")
        self.link = link
        self.photons = photons
        self.seed = seed
        self.normals = normals
        self.threads = threads

    def evaluate(
        self,
        mesh: TriangleMesh,
        intersector: EmbreeIntersector | None = None,
        arrivals: bool = False,
    ) -> AdjointParts:
        """Return the scattered gain over a mesh.

        Parameters
        ----------
        mesh : TriangleMesh
            The surface.
        intersector : EmbreeIntersector, optional
            Embree scene of the mesh, if there is one.
        arrivals : bool
            Keep every contribution to the gain with its path lengths.
        """
        over = _Over(self, mesh, intersector, arrivals)
        receivers = range(len(self.link.receivers))
        share = np.array([t.power_mw for t in self.link.transmitters])
        share /= share.sum()
        n = self.photons // len(share)
        jobs = [
            (r, s, first)
            for r in receivers
            for s in range(len(share))
            for first in range(0, n, _BLOCK)
        ]
        blocks = ordered_map(
            lambda job: over.block(*job, min(_BLOCK, n - job[2])), jobs, self.threads
        )
        per_group = np.bincount(np.arange(n) % SHIFTS, minlength=SHIFTS)
        groups, orders = np.zeros((len(receivers), SHIFTS)), np.zeros((len(receivers), _ORDERS))
        scored, beside = np.zeros(len(receivers), np.int64), np.zeros(len(receivers))
        square, total = np.zeros((2, len(receivers), len(share)))
        rows: list[list[Floats]] = [[np.zeros((0, 4))] for _ in receivers]
        for (r, s, _), sums in zip(jobs, blocks, strict=True):
            if sums.arrivals is not None:
                per_arrival = share[s] / (SHIFTS * per_group[sums.arrivals[:, 3].astype(np.int64)])
                sums.arrivals[:, 0] *= per_arrival
                rows[r].append(sums.arrivals)
            groups[r] += share[s] * sums.groups / per_group
            orders[r] += share[s] * sums.orders / n
            scored[r] += sums.scored
            beside[r] += sums.beside / self.photons
            square[r, s] += sums.square / n
            total[r, s] += sums.groups.sum() / n
        variance = ((square - total**2) * share**2).sum(axis=1) * len(share)
        kept = [np.concatenate(row) for row in rows] if arrivals else None
        return AdjointParts(self.photons, groups, orders, scored, variance, beside, kept)


class _Over:
    """Adjoint paths over one mesh."""

    def __init__(
        self,
        paths: AdjointPaths,
        mesh: TriangleMesh,
        intersector: EmbreeIntersector | None,
        arrivals: bool,
    ) -> None:
        link, frame = paths.link, frame_of(paths.link)
        local = frame.mesh(mesh)
        given = intersector if local is mesh else None
        self._arrivals, self._unit = arrivals, frame.unit
        forms = [repr(r) for r in link.receivers]
        self._rank = np.argsort(np.argsort(forms, kind="stable"))
        self._seed, self._smooth = paths.seed, paths.normals == "vertex"
        self._intersector = given or EmbreeIntersector(local, 1)
        surface = surface_arrays(local, paths.normals, link.physics.unresolved)
        self._surface = surface._replace(level=float(surface.high[2]))
        self._flat = local.max_slope == 0.0 and surface.low[2] == surface.high[2]
        self._rough = surface.roughness.along > 0.0 or surface.roughness.across > 0.0
        medium = frame.medium(expected_water(link, frame.unit * float(surface.high[2])))
        self._medium = medium = with_raster(medium, self._intersector)
        by_depth = medium.depth_mode == DepthMode.LOCAL
        sampled = medium._replace(depth_mode=DepthMode.CLAMPED) if by_depth else medium
        self._interface = interface_arrays(link)
        water = angle_table(link.water.phase)
        bubble = angle_table(link.bubbles.phase_function()) if link.bubbles else water
        self._sources = []
        self._down = link.direction == "down"
        for end in link.receivers if self._down else link.transmitters:
            size = getattr(end, "radius" if self._down else "size") / frame.unit
            rate = -frame.unit / end.center[2] + medium.a + medium.b
            bubbly = link.bubbles is not None
            optics = Optics(emitter_of(end, frame), medium, sampled, water, bubble, bubbly, rate)
            self._sources.append((optics, size))
        self._targets = [
            lamp_target(end, link, frame) if isinstance(end, AirLamp) else target_of(end, frame)
            for end in (link.transmitters if self._down else link.receivers)
        ]

    def _world(self, receiver: int, source: int, first: int) -> starting.World:
        # paths from the lamps are common to all receivers, in any order
        low, high = (receiver, source) if self._down else (source, receiver)
        stream = 0 if self._down else int(self._rank[receiver])
        (optics, size), target = self._sources[low], self._targets[high]
        axis = target.lamp.axis if self._down else Vec3(*(-x for x in target.axis))
        cos_cone = target.cos_half_fov
        if self._interface.fov != FieldOfView.ANGLE:  # a disk about the point below the receiver
            axis = Vec3(0.0, 0.0, -1.0)
            fall = target.center[2] - float(self._surface.high[2])
            nearest = fall - target.radius * math.hypot(target.axis[0], target.axis[1])
            rise = target.center[2] - float(self._surface.low[2])
            widest = 2.0 * target.radius + rise * target.tan_half_fov
            cos_cone = nearest / math.hypot(nearest, widest) if nearest > 0.0 else 0.0
        seeds = np.random.SeedSequence((self._seed, source, stream, 0xAD))
        key = seeds.generate_state(1, np.uint64)[0]
        b, bubbles = _vertical_depths(self._medium, -optics.emitter.position[2])
        lobe_bubble = bubbles / (b + bubbles) if bubbles > 0.0 else 0.0
        beam = _beam_width(optics.emitter)
        alive = math.exp(-0.5 * (b + bubbles)) if beam > 0.0 else 0.0
        if alive < _SPENT:
            alive = beam = 0.0
        aimed = _AIMED + _MORE * alive
        return starting.World(
            optics,
            target,
            self._surface,
            self._interface,
            size,
            lobe_bubble,
            axis,
            float(cos_cone),
            _EVEN / (1.0 + b + bubbles) ** 1.5,
            aimed,
            beam,
            _FAN * alive / aimed,
            _LIT * alive,
            key,
            first,
        )

    def block(self, receiver: int, source: int, first: int, n: int) -> Sums:
        """Trace n paths, the first of a given index."""
        world = self._world(receiver, source, first)
        starts = self._starts(world)
        sets = 1 if self._flat or (self._smooth and not self._rough) else 2
        paths = starting.Paths(
            lamp=np.empty((n, 3)),
            point=np.empty((n, 3)),
            direction=np.empty((n, 3)),
            tilt=np.empty((n, 2)),
            root=np.empty((n, len(starts), 2)),
            lobe=np.empty((n, sets * len(starts), 3)),
            weight=np.empty(n),
            length=np.empty(n),
            water=np.empty(n),
            importance=np.empty(n),
            state=np.empty(n, np.int64),
            heaviest=np.empty(n),
            order=np.empty(n, np.int64),
            event=np.empty(n, np.int64),
            branch=np.empty((n, _BRANCHES, 9)),
            branches=np.empty(n, np.int64),
            score=np.zeros((n, _ORDERS)),
        )
        starting.begin(paths, starts, world)
        rounds = 1 if self._flat else _ROUNDS + sets - 1
        for k in range(rounds):
            facets = self._below(paths.root)
            starting.improve(paths, facets, k - (rounds - sets), world)
        origins, directions = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        looking.look(paths, origins, directions, world)
        start = paths.point.copy()
        beside = starting.enter(paths, self._intersector.facets(origins, directions), world)
        air = np.linalg.norm(paths.point - start, axis=1)
        scores = self._follow(paths, world)
        total = paths.score.sum(axis=1)
        groups = np.bincount((first + np.arange(n)) % SHIFTS, total, SHIFTS).astype(float)
        return Sums(
            groups,
            paths.score.sum(axis=0),
            float(total @ total),
            int(np.count_nonzero(total)),
            int(beside),
            self._arrivals_of(scores, air, first) if self._arrivals else None,
        )

    def _arrivals_of(self, scores: Floats, air: Floats, first: int) -> Floats:
        """Return weight, way in water and air [m] and group of scores."""
        path = scores[:, 0].astype(np.int64)
        ways = self._unit * scores[:, 3], self._unit * air[path]
        return np.column_stack([scores[:, 2], *ways, (first + path) % SHIFTS])

    def _follow(self, paths: starting.Paths, world: starting.World) -> Floats:
        """Trace paths to their ends, with rays for doubtful visibility; return the scores."""
        n = len(paths.weight)
        most = 6 * n + 64
        checks = kernel.Checks(self._arrivals, np.empty((most, 4)), np.empty((2 * most + n, 8)))
        clear, rows = np.zeros(n, bool), [np.zeros((0, 4))]
        while True:
            listed, rays = kernel.follow(paths, clear, checks, world)
            if listed == 0 and rays == 0:
                return np.concatenate(rows)
            ray = checks.ray[:rays]
            cut = self._cut(ray)
            what = ray[:, 0].astype(np.int64)
            clear[-1 - what[what < 0]] = ~cut[what < 0]
            free = np.ones(listed, bool)
            free[what[(what >= 0) & cut]] = False
            kept = checks.score[:listed][free]
            if self._arrivals:
                rows.append(kept)
            path, order = kept[:, :2].astype(np.int64).T
            np.add.at(paths.score, (path, order), kept[:, 2])

    def _cut(self, ray: Floats) -> NDArray[np.bool_]:
        """Return the paths that meet the surface; rays start slightly off the first facet."""
        hair = 1e-4 * ray[:, 7]
        start = ray[:, 1:4] + hair[:, None] * ray[:, 4:7]
        hits = self._intersector.intersect(start, ray[:, 4:7])
        return hits.distance < ray[:, 7] - hair

    def _below(self, root: Floats) -> NDArray[np.int32]:
        """Return the facets over points (x, y); -1 outside the mesh and for still water."""
        shape = root.shape[:2]
        if self._flat:
            return np.full(shape, -1, np.int32)
        low, high = self._surface.low[2], self._surface.high[2]
        origins = np.empty((shape[0] * shape[1], 3), np.float32)
        origins[:, :2] = root.reshape(-1, 2)
        origins[:, 2] = high + 0.1 * (high - low)
        down = np.zeros_like(origins)
        down[:, 2] = -1.0
        return self._intersector.facets(origins, down).reshape(shape)

    def _starts(self, world: starting.World) -> Floats:
        """Return crossings (x, y) of light from the source to the centre of the aperture."""
        n = self._medium.n_water / self._medium.n_air
        target, emitter = world.target, world.optics.emitter
        height, depth = target.center[2], max(-emitter.position[2], 0.0)
        share = n * height / (n * height + depth)
        center, lamp = np.array(target.center), np.array(emitter.position)
        return (center + share * (lamp - center))[None, :2].copy()


def _beam_width(emitter: Emitter) -> float:
    """Return the standard deviation [rad] of the beam of a source, 0 of a wide one."""
    if emitter.kind == SourceKind.ISOTROPIC:
        return 0.0
    led = emitter.kind == SourceKind.LED
    width = 1.0 / math.sqrt(max(emitter.spread, 1.0)) if led else 0.5 * emitter.spread
    return width if width < _WIDEST else 0.0


def _vertical_depths(medium: Medium, depth: float) -> tuple[float, float]:
    """Return the vertical optical depths of scattering by water and bubbles, down to a depth."""
    b = medium.b * depth
    if medium.layered:
        z = np.linspace(0.0, depth, 257) / medium.layer_step
        b = depth * float(np.interp(z, np.arange(len(medium.layer_b)), medium.layer_b).mean())
    if medium.depth_mode == DepthMode.NONE:
        return b, 0.0
    return b, float(medium.bubble_path[-1])
