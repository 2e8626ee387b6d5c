"""Guided photons: directions to the targets, roulette and splitting by a weight window.

A weight window plays Russian roulette with photons of small weight times importance and splits
those of a large one [1]_. Behind collisions copies take directions about the ways to the targets;
all directions that are drawn count by the balance heuristic.

References
----------
.. [1] A. Haghighat and J. C. Wagner, "Monte Carlo variance reduction with deterministic importance
   functions", Progress in Nuclear Energy 42, 25 (2003).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.engine.photons import targets
from meshtrace.engine.photons.state import head, heading, place
from meshtrace.kernels import interface
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.phase import phase_at, sample_s
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.tints import is_tinted
from meshtrace.kernels.vectors import TWO_PI, Vec2, Vec3, dot, norm, row, scaled, turn

_LOWEST = 0.3  # weight times importance, over that of the start
_LEAST_CHANCE = 0.1
_MOST_COPIES = 10


class Guide(NamedTuple):
    """Expected numbers of guided directions drawn at a collision."""

    lobe: float  # by the phase function about the ways to the targets
    cone: float  # even over the cones to what they see


@inlined
def guide_of(q, world):
    """Return the `Guide` of a collision.

    Array twin: none.
    """
    joins, start = world.joins, place(q)
    lobe = cone = 0.0
    if q.is_guided == 1:
        if joins.lobe > 0.0:
            lobe = joins.lobe * targets.collision_chance(
                max(q.level - start.z, targets.LEAST_DEPTH), joins
            )
        cone = joins.cone
        for i in range(len(joins.target)):
            seen = joins.target[i].seen
            x, y = seen[0] - start.x, seen[1] - start.y
            if x * x + y * y + start.z * start.z < seen[2] * seen[2]:
                cone = 0.0
    return Guide(lobe, cone)


@inlined
def _cone_to(i, p, world):
    """Return (axis, sin^2(theta / 2) of the edge) of the cone from p to the view of target i."""
    t = world.joins.target[i]
    way = Vec3(t.seen[0] - p.x, t.seen[1] - p.y, -p.z)
    distance = norm(way)
    sine = min(t.seen[2] / distance, 1.0)
    edge = 0.5 * sine * sine / (1.0 + math.sqrt(1.0 - sine * sine))
    return scaled(1.0 / distance, way), edge


@inlined
def _cone_density(d, p, world):
    """Return the density of directions uniform over the cones to the views [sr-1]."""
    n, total = len(world.joins.target), 0.0
    for i in range(n):
        axis, edge = _cone_to(i, p, world)
        if 0.5 * (1.0 - dot(d, axis)) <= edge:
            total += 1.0 / (n * 4.0 * math.pi * edge)
    return total


@inlined
def _emitted(cos_theta, kind, spread):
    """Return the density of directions of a wide source [sr-1]."""
    if kind == SourceKind.ISOTROPIC:
        return 0.25 / math.pi
    if cos_theta <= 0.0:
        return 0.0
    if kind == SourceKind.LED:
        return (spread + 1.0) / TWO_PI * cos_theta**spread
    seen = math.sin(spread) ** 2
    return cos_theta / (math.pi * seen) if 1.0 - cos_theta * cos_theta <= seen else 0.0


@outlined
def guide_start(d, p, source, photon, uv, world):
    """Return (direction, weight) of a new photon, possibly guided to the view of a target.

    Array twin: photons with `Joins.start` = 0.
    Mixture of the lamp's own light with the phase function about the ways to the targets, by which
    the first collision would turn it on, and with directions even over the cones, where its own
    light may be too little to be drawn.
    """
    joins, sources = world.joins, world.sources
    lobe, cone, n = joins.start * joins.lobe, joins.start * joins.cone, len(joins.target)
    kind = sources.kind[source]
    beam = kind != SourceKind.LED and kind != SourceKind.ISOTROPIC and kind != SourceKind.APERTURE
    if lobe + cone == 0.0 or beam:
        return d, 1.0
    level = targets.level_over(p, world)
    lot, u, v, _ = uniforms(world.seed, photon, 0, Purpose.GUIDE.value)
    if lot < lobe:
        way = _way_to(min(int(lot / lobe * n), n - 1), p, level, uv, world)
        d = turn(way, sample_s(world.medium.phase_water, u), v)
    elif lot < lobe + cone:
        axis, edge = _cone_to(min(int((lot - lobe) / cone * n), n - 1), p, world)
        d = turn(axis, u * edge, v)
    own = _emitted(dot(d, row(sources.axis, source)), kind, sources.spread[source])
    if own == 0.0:
        return d, 0.0
    drawn = (1.0 - lobe - cone) * own
    if cone > 0.0:
        drawn += cone * _cone_density(d, p, world)
    for i in range(n):
        if lobe > 0.0:
            way = _way_to(i, p, level, uv, world)
            drawn += lobe / n * phase_at(joins.water, targets.angle_between(way, d))
    return d, own / drawn


@inlined
def _aim_of(q, world):
    """Return the uniforms of the point of a target about which directions are drawn.

    Array twin: none.
    Over random slopes its centre: a photon is joined to the point of its connection or to another
    one, and the balance heuristic needs one density of its direction for both.
    """
    if interface.is_rough(world.surface.roughness):
        return Vec2(0.0, 0.0)
    return Vec2(q.u, q.v)


@outlined
def drawn_density(d, own, guide, q, start, world):
    """Return the density of all directions drawn behind a collision [sr-1].

    `own` is the phase function, by which the photon itself goes on.
    """
    n = len(world.joins.target)
    total = own
    for i in range(n):
        if guide.lobe > 0.0:
            way = _way_to(i, start, q.level, _aim_of(q, world), world)
            total += guide.lobe / n * targets.mixed_phase(way, d, start, world)
    if guide.cone > 0.0:
        total += guide.cone * _cone_density(d, start, world)
    return total


@outlined
def redirect(q, s, u_phi, world):
    """Turn a scattered photon by an angle, or to the direction for which a copy has waited.

    Array twin: photons without `Joins.lobe` and `Joins.cone`.
    Copies take directions about the ways to the targets, else the connections of photons that
    head almost for a target are too heavy for their number, and directions even over the cones to
    what the targets see. Photon and copies count by the densities of all that is drawn.
    """
    start, before, aimed = place(q), heading(q), q.aimed
    guide, n = guide_of(q, world), len(world.joins.target)
    q.aimed = 0
    lot, u, u_kind, _ = uniforms(world.seed, q.id, q.event, Purpose.GUIDE.value)
    if aimed == 0:
        if lot < guide.lobe + guide.cone and q.copies + 1 < len(world.photon):
            i = min(int(lot / guide.lobe * n), n - 1) if lot < guide.lobe else n
            if i == n:
                i += min(int((lot - guide.lobe) / guide.cone * n), n - 1)
            q.copies += 1
            q.aimed = 1 + i
            world.photon[q.copies] = q
            q.aimed = 0
        d = turn(before, s, u_phi)
    elif aimed <= n:
        d = turn(_way_to(aimed - 1, start, q.level, _aim_of(q, world), world), s, u_phi)
    else:
        axis, edge = _cone_to(aimed - 1 - n, start, world)
        d = turn(axis, u * edge, u_phi)
    own = targets.mixed_phase(before, d, start, world)
    theta = targets.angle_between(before, d) if is_tinted(world.tints) else 0.0
    targets.tint_mixed(q.tint, theta, u_kind, start, world)
    q.density = own
    if guide.lobe + guide.cone > 0.0:
        q.density = drawn_density(d, own, guide, q, start, world)
        q.weight *= own / q.density
    head(q, d)


@outlined
def _way_to(i, p, level, uv, world):
    """Return the direction from p to a point of target i through still water."""
    scene = targets.scene_to(i, world)
    still = targets.still_crossing(p, targets.goal_on(scene.target, uv.x, uv.y), level, scene)
    way = Vec3(still.x - p.x, still.y - p.y, still.depth)
    return scaled(1.0 / norm(way), way)


@outlined
def importance(p, joins):
    """Return the importance of a place, for the weight window.

    Array twin: none, a weight window is unbiased for any importance.
    In turbid water the diffusion flux of a point one transport length below the surface, and its
    image above [1]_, else the attenuated view of what the targets see.

    References
    ----------
    .. [1] T. J. Farrell, M. S. Patterson and B. Wilson, Medical Physics 19 (1992) 879,
       doi:10.1118/1.596777, eq. 11.
    """
    window = joins.window
    depth, total = max(-p.z, 0.0), 1e-12
    for i in range(len(joins.target)):
        seen = joins.target[i].seen
        dx, dy = p.x - seen[0], p.y - seen[1]
        square = dx * dx + dy * dy
        if window.diffuse:
            square += 0.04 * window.length * window.length
            low, high = depth - window.length, depth + window.length + 2.0 * window.beyond
            r1, r2 = math.sqrt(square + low * low), math.sqrt(square + high * high)
            total += math.exp(-window.kappa * r1) / r1 - math.exp(-window.kappa * r2) / r2
        else:
            square += depth * depth
            wide = seen[2] * seen[2]
            total += math.exp(-window.kappa * math.sqrt(square)) / (1.0 + square / wide)
    return total


@inlined
def ratio_of(q, p, joins):
    """Return the weight times importance of a photon at p, relative to its start.

    Array twin: none.
    """
    bent = 1.0 + joins.window.bent * q.bend
    return q.weight * importance(p, joins) / (bent * q.importance)


@inlined
def survives(q, p, share, lot, world):
    """Play Russian roulette with a photon of low weight times importance; return whether it lives.

    Array twin: none.
    `share` is that of its weight that will be left at p.
    """
    ratio = share * ratio_of(q, p, world.joins)
    if ratio >= _LOWEST:
        return True
    chance = max(ratio / (2.0 * _LOWEST), _LEAST_CHANCE)
    if lot < 0.0:
        lot, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.ROULETTE.value)
    if lot >= chance:
        return False
    q.weight /= chance
    return True


@inlined
def copies_of(q, world):
    """Return the number of photons that one of high weight times importance is split into.

    Array twin: none.
    """
    ratio = ratio_of(q, place(q), world.joins)
    if ratio <= world.joins.window.highest:
        return 1
    return max(min(int(ratio), _MOST_COPIES, len(world.photon) - targets.SPARE // 2 - q.copies), 1)
