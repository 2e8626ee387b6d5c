"""Next-event estimation through the surface: photons in the water joined to ends in the air.

With random slopes a photon is joined in two ways. The crossing P ahead of it follows from its
direction d, and the slope that refracts it to a point x of the aperture is unique: the score is

    W exp(-tau) |A| p(s*) |ds*/dx| T E / C,

tau the optical depth up to P, p the density of the random slopes, T the transmittance, E the
exposure of the facet and C the chance of this connection. At a collision a crossing is drawn about
that of still water, too; the direction to it and the slope follow. Either way may bring any light;
both together count once by the balance heuristic [1]_. Joining to an end in the air has no 1 / r^2
singularity. Without random slopes a collision is joined by all crossings that refract its light to
x: the one of still water, or those of smooth waves (`meshtrace.engine.photons.manifold`).

References
----------
.. [1] E. Veach and L. J. Guibas, "Optimally combining sampling techniques for Monte Carlo
   rendering", SIGGRAPH (1995), doi:10.1145/218380.218498.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from meshtrace.engine import crossing
from meshtrace.engine.chains.microfacets import slope_towards
from meshtrace.engine.photons import targets
from meshtrace.engine.photons.guides import drawn_density, guide_of
from meshtrace.engine.photons.manifold import Drawn, crossings_between
from meshtrace.engine.photons.state import heading, place
from meshtrace.kernels import interface
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import depth_between
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.rays import first_facet
from meshtrace.kernels.scene import FLAT_SEA, height_on
from meshtrace.kernels.tints import copy_tint, is_tinted, tint_way
from meshtrace.kernels.vectors import (
    ORIGIN,
    UP,
    Vec2,
    Vec3,
    along,
    dot,
    minus,
    norm,
    on_circle,
    row,
    scaled,
)

_HAIR = 1e-4


@inlined
def _is_clear(p, d, length, facet, world):
    """Return whether no wave cuts a straight path off.

    `facet` is the one where it starts or ends.
    """
    slope = world.surface.max_slope
    if d.z > slope * math.sqrt(d.x * d.x + d.y * d.y):
        return True
    hair = _HAIR * (1.0 + length)
    found = first_facet(world.bvh, along(p, d, hair), d)
    if found < 0 or found == facet:
        return True
    return interface.plane_distance(p, d, found, world.surface) > length - 2.0 * hair


class Passage(NamedTuple):
    """Passage of a unit photon through a crossing to a point of the aperture."""

    density: float  # of landing points [m-2]
    share: float  # transmittance, exposure and acceptance
    flight: float  # through the air [m]


@outlined
def _through(p, n, g, d, goal, facet, scene, world):
    """Return the `Passage` along d through P by its random slope."""
    dark = Passage(0.0, 0.0, 0.0)
    s = slope_towards(p, n, d, d, 0.0, goal, scene)
    if s.density <= 0.0 or dot(d, g) <= 0.0:
        return dark
    share = crossing.passed(1.0, s.aim, p, n, facet, s.tilt, scene)
    if share > 0.0 and world.interface.follow_second_hit:
        if not _is_clear(p, s.aim.r, s.aim.flight, facet, world):
            return dark
    return Passage(s.density, share, s.aim.flight)


@outlined
def _landing(p, n, d, u, v, scene, world):
    """Return (found, goal): the landing point of a drawn slope on the aperture."""
    tilt = interface.drawn_tilt(world.surface.roughness, u, v)
    m = crossing.land(
        p,
        interface.tilted(n, tilt),
        crossing.Shot(minus(p, d), ORIGIN, UP, Vec2(0.0, 0.0), 1.0, tilt),
        scene,
    )
    r = scene.target.radius
    return m.ok and m.at.x * m.at.x + m.at.y * m.at.y < r * r, m.at


@inlined
def _point_density(i, light, world):
    """Return the density of the points of target i that are drawn at a crossing [m-2]."""
    t = world.joins.target[i]
    return (1.0 - t.sloped) / t.area + t.sloped * light.density


class Way(NamedTuple):
    """Way of a photon through a crossing to a target."""

    theta: float  # angle of a scattering at its start [rad], < 0 without one
    z: float  # height of the crossing [m]
    water: float  # [m]
    air: float


@inlined
def _score(q, i, light, way, world):
    """Score light of a photon on target i."""
    light *= world.joins.target[i].share
    part = targets.SCATTERED if q.order > 0 else targets.DIRECT
    if q.reflections > 0:
        part = targets.REFLECTED
    else:
        world.order[i, min(q.order, world.order.shape[1] - 1)] += light
    world.score[q.id - world.first, i, part] += light
    n = world.n_arrivals[0]
    world.n_arrivals[0] = n + 1
    if n < len(world.arrivals):
        a = world.arrivals[n]
        a.photon, a.receiver, a.weight = q.id, i, light
        a.water, a.air, a.part, a.order = q.water + way.water, way.air, part, q.order
        copy_tint(world.tints, q.tint, a.tint)
        tint_way(world.tints, a.tint, q.z, way.z, way.water)
        if way.theta >= 0.0:
            _, _, _, u = uniforms(world.seed, q.id, q.event, Purpose.JOIN_SLOPE.value)
            targets.tint_mixed(a.tint, way.theta, u, place(q), world)


@outlined
def join_crossing(q, facet, length, chance, world):
    """Join a photon that meets a facet from below at a distance to every target.

    Array twin: the analog photon, whose slope is drawn.
    """
    joins, start, d = world.joins, place(q), heading(q)
    p = along(start, d, length)
    g = row(world.surface.face_normals, facet)
    n = interface.normal_on(p, facet, world.surface)
    u, v, lot, _ = uniforms(world.seed, q.id, q.event, Purpose.APERTURE.value)
    weight = q.weight * math.exp(-depth_between(world.medium, start, p, length))
    for i in range(len(joins.target)):
        if q.reflections + 1 < joins.target[i].first:
            continue
        scene = targets.scene_to(i, world)
        found, goal = True, targets.goal_on(scene.target, u, v)
        if lot < joins.target[i].sloped:
            found, goal = _landing(p, n, d, u, v, scene, world)
        if not found:
            continue
        light = _through(p, n, g, d, goal, facet, scene, world)
        if light.share <= 0.0:
            continue
        own, other = chance * _point_density(i, light, world), 0.0
        if q.density > 0.0:
            still = targets.still_crossing(start, goal, q.level, scene)
            other = targets.collision_chance(still.depth, joins) * targets.crossing_density(
                p.x, p.y, still, joins
            )
            other *= length * length * g.z / (dot(d, g) * scene.target.area * q.density)
        score = weight * light.density * light.share / (own + other)
        _score(q, i, score, Way(-1.0, p.z, length, light.flight), world)


@outlined
def join_collision(q, at_bottom, world):
    """Join a photon that is scattered, or reflected by the bottom, to every target.

    Array twin: `join_crossing` of the photon that goes on.
    """
    joins = world.joins
    q.order += 1
    q.is_guided = 1 if q.copies + targets.SPARE < len(world.photon) else 0
    start, q.density = place(q), 0.0
    q.level = level = targets.level_over(start, world)
    if q.reflections + 1 < joins.first:
        return
    chance = targets.collision_chance(max(level - start.z, targets.LEAST_DEPTH), joins)
    q.density = 1.0  # until the direction is known
    lot, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.JOIN.value)
    if lot >= chance:
        return
    s, t, wide, _ = uniforms(world.seed, q.id, q.event, Purpose.JOIN_SLOPE.value)
    r = math.sqrt(-2.0 * math.log(s))
    if wide < targets.WIDE_SHARE:
        r *= targets.WIDE
    c, s = on_circle(t)
    rough = interface.is_rough(world.surface.roughness)
    for i in range(len(joins.target)):
        if q.reflections + 1 < joins.target[i].first:
            continue
        scene = targets.scene_to(i, world)
        goal = targets.goal_on(scene.target, q.u, q.v)
        still = targets.still_crossing(start, goal, level, scene)
        if rough:
            sa, sc = targets.widths_of(still, joins)
            a, b = r * c * sa, r * s * sc
            x, y = still.x + a * still.ux - b * still.uy, still.y + a * still.uy + b * still.ux
            p = Vec2(x, y)
            _join_by_slope(p, q, i, goal, still, chance, at_bottom, scene, world, world.manifold)
        else:
            _join_bent(q, i, goal, still, chance, at_bottom, scene, world, world.manifold)


@inlined
def _turn(w, d, at_bottom, world):
    """Return the scattering angle of an event [rad], -1 at the bottom and if not needed."""
    if at_bottom:
        return -1.0
    return targets.angle_between(d, w) if is_tinted(world.tints) else 0.0


@inlined
def _scattered(w, d, start, at_bottom, world):
    """Return the density of directions [sr-1] behind an event."""
    if at_bottom:
        return max(w.z, 0.0) / math.pi
    return targets.mixed_phase(d, w, start, world)


@outlined
def _join_by_slope(at, q, i, goal, still, chance, at_bottom, scene, world, manifold):
    """Join an event to target i by the slope at a crossing over (x, y), see `join_collision`."""
    if manifold is not None:
        return
    joins, start, d = world.joins, place(q), heading(q)
    x, y = at.x, at.y
    facet = targets.facet_below(x, y, world)
    if facet < 0:
        return
    p = Vec3(x, y, height_on(x, y, facet, world.surface))
    g = row(world.surface.face_normals, facet)
    way = minus(p, start)
    length = norm(way)
    w = scaled(1.0 / length, way)
    facing = dot(w, g)
    if facing <= 0.0:
        return
    n = interface.normal_at(x, y, facet, world.surface)
    light = _through(p, n, g, w, goal, facet, scene, world)
    if light.share <= 0.0 or not _is_clear(start, w, length, facet, world):
        return
    turned = _scattered(w, d, start, at_bottom, world)
    drawn = turned
    if not at_bottom:
        drawn = drawn_density(w, turned, guide_of(q, world), q, start, world)
    own = chance * targets.crossing_density(x, y, still, joins) * length * length * g.z
    own /= facing * scene.target.area
    bend = targets.bend_ahead(start, w, q.level, world)
    other = (
        drawn
        * targets.chance_ahead(start, w, q.level, bend, joins)
        * _point_density(i, light, world)
    )
    turned *= math.exp(-depth_between(world.medium, start, p, length))
    light_in = turned * light.density * light.share / (own + other)
    if light_in > 0.0:
        theta = _turn(w, d, at_bottom, world)
        _score(q, i, q.weight * light_in, Way(theta, p.z, length, light.flight), world)


@outlined
def _join_bent(q, i, goal, still, chance, at_bottom, scene, world, manifold):
    """Join an event to target i by all crossings without random slopes, see `join_collision`."""
    start = place(q)
    shot = crossing.Shot(start, ORIGIN, UP, goal, 1.0, Vec2(0.0, 0.0))
    if manifold is None:  # an argument: the other branch is not compiled
        at = Vec2(still.x, still.y)
        _join_at(at, FLAT_SEA, 1.0, q, i, shot, chance, at_bottom, scene, world)
    else:
        drawn = Drawn(world.seed, q.id, q.event, *targets.widths_of(still, world.joins))
        for k in range(crossings_between(still, shot, drawn, scene, manifold)):
            root = manifold.roots[k]
            at, facet = Vec2(root.x, root.y), np.int64(root.facet)
            _join_at(at, facet, root.multiplicity, q, i, shot, chance, at_bottom, scene, world)


@outlined
def _join_at(at, facet, multiplicity, q, i, shot, chance, at_bottom, scene, world):
    """Join an event to target i by a crossing that refracts its light to the goal."""
    start, d = place(q), heading(q)
    j = crossing.jacobian(at.x, at.y, facet, shot, scene)
    m, spread = j.aim, abs(j.a * j.d - j.b * j.c)
    if not j.ok or spread == 0.0 or m.w.z == 0.0:
        return
    p = Vec3(at.x, at.y, height_on(at.x, at.y, facet, world.surface))
    light = crossing.acceptance(m, p, scene.target, world.interface.fov)
    if light <= 0.0:
        return
    if facet >= 0:
        g = row(world.surface.face_normals, facet)
        if dot(m.w, g) <= 0.0 or dot(m.r, g) <= 0.0:
            return
        if scene.target.is_lamp:
            light *= crossing.forwards(m, p, facet, shot.tilt, world.surface)
        if not _is_clear(start, m.w, m.length, facet, world):
            return
        if world.interface.follow_second_hit and not _is_clear(p, m.r, m.flight, facet, world):
            return
    solid_angle = abs(j.wa * j.wd - j.wb * j.wc) / (abs(m.w.z) * spread)
    light *= scene.target.area * solid_angle * crossing.transmittance(m, world.interface) / chance
    light *= _scattered(m.w, d, start, at_bottom, world)
    light *= math.exp(-depth_between(world.medium, start, p, m.length))
    light *= multiplicity
    if light > 0.0:
        theta = _turn(m.w, d, at_bottom, world)
        _score(q, i, q.weight * light, Way(theta, p.z, m.length, m.flight), world)
