"""Joined photons and receivers in the water: light that reaches these straight.

To join a photon is to score, at each event, the light that the event sends to a receiver, instead
of waiting for a hit. A collision, or a reflection by the bottom or a Lambertian body, at p scores
at a point x, drawn evenly over the aperture,

    W f(w) exp(-tau) cos(theta) / r^2 |A|,

W the weight of the photon, f [sr-1] the phase function, or Lambert's law, in the direction w to x,
r [m] and tau distance and optical depth, theta the angle between w and the axis of the aperture,
|A| [m2] its area. Close to the lens 1 / r^2 has no bound, and the variance of this next-event
estimation no limit. The direction that the photon takes next may hit the lens as well, and so may
those of its guided copies, which wait on a stack and leave the event about the ways to receivers
(`targets.Law`). Both ways to the lens have an expected number per solid angle [sr-1]:

- `drawn`, of directions of the photon and its guided copies, f for the photon alone;
- `joined`, of connections, r^2 / (|A| cos(theta)) times `q.chance`, the probability that the event
  is joined at all, which falls with its depth (`targets.collision_chance`).

With the balance heuristic [1]_ both score W f exp(-tau) / (drawn + joined), at most W as
f <= drawn. Once turned, a photon carries W f / drawn as `q.weight` and drawn as `q.density`.

Light that the surface mirrors on its way from the last event to the receiver is joined as light
that it refracts, see `photons.next_event`, with `Scene.reflects`. Without random slopes the
photon that goes on may also hit the receiver after its reflection: the density of connections is
then |dx/dw| / |A|, and both ways are combined as those of straight light. Light that a mirror body
has turned since the last event has no connection: hits alone bring it.

References
----------
.. [1] E. Veach and L. J. Guibas, "Optimally combining sampling techniques for Monte Carlo
   rendering", SIGGRAPH (1995), doi:10.1145/218380.218498.
"""

from __future__ import annotations

import math

from meshtrace.engine import crossing
from meshtrace.engine.photons import targets
from meshtrace.engine.photons.state import heading, place
from meshtrace.kernels import interface
from meshtrace.kernels.bodies import is_hidden
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import depth_between
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.rays import first_facet
from meshtrace.kernels.tally import DIRECT, MIRRORED, REFLECTED, SCATTERED, keep_arrival
from meshtrace.kernels.tints import tint_way
from meshtrace.kernels.vectors import ORIGIN, UP, Vec2, along, dot, minus, norm, scaled, write

# By which a path is shortened at its ends, over 1 m + its length: Embree is float32, and neither
# the facet that the path leaves nor one that touches the aperture shall cut it.
HAIR = 1e-4


@inlined
def _is_unobstructed(p, d, length, world):
    """Return whether neither waves nor bodies cut off a straight path in the water."""
    if is_hidden(p, d, length, world.bodies):
        return False
    # paths below the lowest trough, `low` (x, y, z) of the mesh, most of them, meet no wave
    if max(p.z, p.z + length * d.z) < world.surface.low[2]:
        return True
    hair = HAIR * (1.0 + length)
    start = along(p, d, hair)
    facet = first_facet(world.bvh, start, d)
    if facet < 0:
        return True
    # The ray has no end, and may meet the facet beyond the path: the plane of the facet gives the
    # distance in double precision.
    return interface.plane_distance(p, d, facet, world.surface) > length - hair


@inlined
def _point_density(r, facing, target, chance):
    """Return `joined` [sr-1] of a point of an aperture at r [m]; `facing` is cos(theta)."""
    return chance * r * r / (target.area * facing)


@outlined
def _mirror_density(p, q, scene):
    """Return the density of directions [sr-1] of connections of an event by the mirror at p.

    Array twin: `next_event._join_at`.
    """
    start = targets.vector_of(q.event_at)  # the last event: q has moved on to the mirror at p
    # no scattering in between: last vertex at the start, direction UP until it is turned to p,
    # branch +1 ahead; a smooth facet has no tilt, and the Jacobian does not depend on the goal
    shot = crossing.Shot(start, ORIGIN, UP, Vec2(0.0, 0.0), 1.0, Vec2(0.0, 0.0))
    per_area = crossing.solid_angle_per_area(crossing.jacobian(p.x, p.y, q.facet, shot, scene))
    # on a caustic |dx/dw| = 0, and so is the density of connections: the hit has all the light
    return q.chance / (scene.target.area * per_area) if per_area > 0.0 else 0.0


@inlined
def _part_of(q, under):
    """Return the part of the gain that light of a photon belongs to, see `kernels.tally`."""
    if under is None:
        if q.reflections > 0:
            return REFLECTED
        return SCATTERED if q.order > 0 else DIRECT
    if q.order == 0:
        return MIRRORED
    return q.turned_by


@outlined
def score(q, i, weight, theta, water, p, way, world):
    """Score light of a photon at target i, by a path of `water` [m] up to p and by `way` [m] on.

    Array twin: none, sums.
    `theta` is the angle of a scattering at the start of the path [rad], < 0 without one, or where
    the photon has turned already: `q.tint`, sums that give the weight at other wavelengths, has
    counted the angle then.
    """
    target = world.joins.target[i]
    # `share`: constant factor on all scores of a target, set by `photons.joined`
    n = keep_arrival(world, q.id, i, weight * target.share, world.tints, q.tint)
    if n < 0:  # there is no room for it
        return
    a, r = world.arrivals[n], norm(way)
    a.water, a.air, a.order = q.water + water, q.air + r, q.order
    a.part = _part_of(q, world.under)
    # photons to a lamp run backwards: their light arrives where they start
    write(a.way, scaled(-1.0, targets.vector_of(q.first)) if target.is_lamp else way)
    tint_way(world.tints, a.tint, q.z, p.z, water)
    if targets.is_mirrored(world.under):
        # the way behind p lies in the water, too
        a.water, a.air = a.water + r, 0.0
        tint_way(world.tints, a.tint, p.z, p.z + way.z, r)
    if theta >= 0.0:
        # the fourth uniform, of which the connection itself uses three
        _, _, _, u = uniforms(world.seed, q.id, q.event, Purpose.JOIN_SLOPE.value)
        targets.tint_mixed(a.tint, theta, u, place(q), world)


@outlined
def join_straight(q, i, world, under):
    """Join a photon that is scattered, or reflected by the bottom, straight to target i.

    Array twin: `join_hits` of the photon that goes on.
    """
    # Receivers in the air are met through the surface alone. `under` is an argument, None for
    # links that change sides: numba then leaves out the rest by its type.
    if not targets.is_mirrored(under):
        return
    start, target = place(q), targets.scene_to(world.joins.target[i], world).target
    # q.u, q.v: uniforms drawn at the start, the same point of an aperture for all events of q
    way = minus(targets.point_of(targets.goal_on(target, q.u, q.v), target), start)
    r = norm(way)
    if r == 0.0:
        return
    w = scaled(1.0 / r, way)
    facing = dot(w, target.axis)
    if facing <= 0.0 or facing < target.cos_half_fov or not _is_unobstructed(start, w, r, world):
        return
    phase, theta = targets.after_event(w, q, world)
    drawn = targets.drawn_after(w, phase, q, world)
    joined = _point_density(r, facing, target, q.chance)
    weight = q.weight * phase * math.exp(-depth_between(world.medium, start, along(start, w, r), r))
    if weight > 0.0:
        score(q, i, weight / (joined + drawn), theta, 0.0, start, way, world)


@outlined
def join_hits(q, world, under):
    """Score a photon on every target that its new direction hits.

    Array twin: `join_straight`.
    """
    # Receivers in the air are met through the surface alone. `under` is an argument, None for
    # links that change sides: numba then leaves out the rest by its type.
    if not targets.is_mirrored(under):
        return
    # Unscattered light is integrated elsewhere (`engine.straight`). Density 0: the event was not
    # joined, or a rough or a second mirror has turned its light, see `joined_walk._note_mirror`.
    if q.order == 0 or q.density == 0.0:
        return
    start, d = place(q), heading(q)
    for i in range(len(world.joins.target)):
        scene = targets.scene_to(world.joins.target[i], world)
        target = scene.target
        facing = dot(d, target.axis)
        # along the plane of the aperture: 1e-9 keeps r finite, as in `crossing.land_from`
        if facing <= 1e-9 or facing < target.cos_half_fov:
            continue
        to_center = minus(target.center, start)
        r = dot(to_center, target.axis) / facing
        if r <= 0.0:
            continue
        from_center = minus(scaled(r, d), to_center)
        if dot(from_center, from_center) > target.radius * target.radius:
            continue
        if not _is_unobstructed(start, d, r, world):
            continue
        weight = q.weight
        if q.density > 0.0:  # else a mirror body has turned it, and no connection brings its light
            # q.weight = W f / drawn by now: times drawn / (drawn + joined)
            joined = _point_density(r, facing, target, q.chance)
            if q.facet >= 0:  # mirrored since its event: the rival connection is by that facet
                joined = _mirror_density(start, q, scene)
            weight = q.weight * q.density / (q.density + joined)
        weight *= math.exp(-depth_between(world.medium, start, along(start, d, r), r))
        if weight > 0.0:
            score(q, i, weight, -1.0, 0.0, start, scaled(r, d), world)
