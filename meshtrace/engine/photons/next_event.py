"""Next-event estimation through the surface: photons in the water joined to ends in the air.

With random slopes a photon is joined in two ways. The crossing P ahead of it follows from its
direction d, and the slope that refracts it to a point x of the aperture is unique: the score is

    W exp(-tau) |A| p(s*) |ds*/dx| T E / C,

W the weight of the photon, tau the optical depth up to P, |A| the area of the aperture, s* that
slope and p the density of the random slopes, T the transmittance, E the exposure of the facet and C
the chance of this connection. At a collision, too, a crossing is drawn about that of still water;
the direction to it and the slope follow. Both ways can produce the same path, so that the balance
heuristic weights them [1]_. Joining to an end in the air has no 1 / r^2 singularity. Without random
slopes a collision is joined by all crossings that refract its light to x: the one of still water,
or those of smooth waves.

Newton's iteration from the crossing of still water leads to one crossing of smooth waves [2]_.
Others follow from a start drawn about it [3]_: a crossing r to which drawn starts lead with the
chance p(r) counts 1 / p(r), estimated by the number of further draws until r is reached again. So
the sum over all crossings is unbiased without a list of them. With faceted normals all facets are
searched, as those of scattering chains (`meshtrace.engine.crossing`).

Names are those of `photons.flight`. Light goes from a start along w to the crossing P (p), and
along r to the goal, a point of the aperture of target i; `still` is the crossing of still water. A
`Shot` with q = `ORIGIN` and v = `UP` has its last vertex at its start.

References
----------
.. [1] E. Veach and L. J. Guibas, "Optimally combining sampling techniques for Monte Carlo
   rendering", SIGGRAPH (1995), doi:10.1145/218380.218498.
.. [2] J. Hanika, M. Droske and L. Fascione, "Manifold next event estimation", Computer Graphics
   Forum 34 (2015), doi:10.1111/cgf.12681.
.. [3] T. Zeltner, I. Georgiev and W. Jakob, "Specular manifold sampling for rendering
   high-frequency caustics and glints", ACM Transactions on Graphics 39 (2020),
   doi:10.1145/3386569.3392408, section 4.1.
"""

from __future__ import annotations

import math

import numpy as np

from meshtrace.engine import crossing
from meshtrace.engine.chains.random_slopes import slope_towards
from meshtrace.engine.photons import targets
from meshtrace.engine.photons.in_medium import join_straight
from meshtrace.engine.photons.state import heading, place
from meshtrace.kernels import interface
from meshtrace.kernels.bodies import is_hidden
from meshtrace.kernels.interface import MeshArrays
from meshtrace.kernels.jit import ONE, ZERO, inlined, outlined
from meshtrace.kernels.medium import depth_between
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.rays import first_facet
from meshtrace.kernels.scene import FLAT_SEA, Scene, height_on
from meshtrace.kernels.tally import DIRECT, MIRRORED, REFLECTED, SCATTERED, keep_arrival
from meshtrace.kernels.tints import tint_way
from meshtrace.kernels.vectors import (
    ORIGIN,
    UP,
    Vec2,
    Vec3,
    along,
    dot,
    minus,
    norm,
    plus,
    row,
    scaled,
    write,
)

_HAIR = 1e-4  # by which a path is shortened at its ends, over 1 m + its length: Embree is float32
_SAME = 3e-4  # [m], two results of Newton that differ by less are one crossing
_MOST_TRIALS = 100_000  # bounds the time; a bias: crossings drawn less often count too little
_CLOSE = 1.0  # depth over the size of a facet, up to which every facet is searched
_STREAMS = 64  # step of purposes between trials, > all of `Purpose`: no stream is used twice


@outlined
def _crossings_between(still, shot, q, scene, world, search):
    """Write the crossings from the start of a shot to its goal (`roots`); return their number.

    Array twin: `crossing.enumerate_roots`, which searches every facet.
    `still` is the crossing of still water, at the height of the waves over a start near them.
    """
    surface, target = scene.surface, scene.target
    side = math.hypot(still.x - shot.start.x, still.y - shot.start.y)
    # bound on the displacement by slopes and heights of the waves, as `crossing.radius_of`
    move = crossing.MARGIN * surface.max_slope * max(still.along, still.across)
    move += (
        crossing.MARGIN * (surface.high[2] - surface.low[2]) * side / still.depth + search.margin
    )
    if math.hypot(still.x - target.center.x, still.y - target.center.y) > target.reach + move:
        return ZERO  # outside the field of view for any waves
    if not surface.interpolate:
        return _on_all_facets(still, shot, scene, search, world)
    widths = targets.widths_of(still, world.joins)
    step = widths.x + widths.y  # [m], scale of the steps of Newton
    converged, x, y, facet = crossing.root_from(still.x, still.y, step, shot, scene)
    n = ZERO
    if converged:
        n = _append(n, x, y, facet, 1.0, shot, world.roots)
    converged, rx, ry, facet = _trial(ZERO, still, step, shot, q, scene, world)
    # the crossing that is written already counts fully: reached again it adds nothing
    if not converged or (n == 1 and _is_same(rx, ry, x, y)):
        return n
    count = _inverse_probability(rx, ry, still, step, shot, q, scene, world)
    return _append(n, rx, ry, facet, count, shot, world.roots)


@outlined
def _inverse_probability(x, y, still, step, shot, q, scene, world):
    """Return an unbiased estimate of 1 / p, p the chance that a drawn start leads to (x, y).

    Zeltner et al. (2020), Alg. 2: Bernoulli trials up to the first that finds the crossing again
    are geometrically distributed, with the mean 1 / p.
    """
    trials, again = ONE, False
    while not again and trials < _MOST_TRIALS:
        again, other_x, other_y, _ = _trial(trials, still, step, shot, q, scene, world)
        again = again and _is_same(x, y, other_x, other_y)
        trials += 1
    return float(trials - 1)  # trial 0 drew the crossing itself, not one of these


@inlined
def _is_same(x, y, other_x, other_y):
    """Return whether two results are one crossing."""
    return abs(x - other_x) + abs(y - other_y) < _SAME


@inlined
def _append(n, x, y, facet, multiplicity, shot, roots):
    """Write crossing n of a shot, counted `multiplicity` times; return the new number."""
    root = roots[n]
    root.x, root.y, root.facet = x, y, facet
    root.branch, root.multiplicity = shot.branch, multiplicity
    return n + 1


@outlined
def _trial(k, still, step, shot, q, scene, world):
    """Return (converged, x, y, facet) of Newton's iteration from the drawn start of trial k.

    Starts have a Student law of four degrees of freedom: far crossings are not too rare.
    """
    # a stream of random numbers for each trial
    purpose = Purpose.TRIAL.value + _STREAMS * k
    u, v, _, _ = uniforms(world.seed, q.id, q.event, purpose)
    # Student in the plane, nu = 4: u = P(r > x) = (1 + x^2 / 4)^-2, inverted
    r = 2.0 * math.sqrt(1.0 / math.sqrt(u) - 1.0)
    start = targets.beside(still, r, v, world.joins)
    return crossing.root_from(start.x, start.y, step, shot, scene)


@outlined
def _on_all_facets(still, shot, scene, search, world):
    """Write the crossings on all facets near the flat-sea crossing; return their number."""
    flat = world.flat[0]
    # `still` may belong to a wave above the start, not to the mean level.
    level = shot.start.z + still.depth  # of the flat sea
    sea = MeshArrays(*scene.surface[:-1], level)  # type: ignore[call-arg]
    raised = Scene(scene.emitter, scene.target, sea, *scene[3:])
    crossing.flat_crossing(flat, still.x, still.y, shot, raised)
    if flat.low <= 0.0:
        return ZERO
    widest = scene.target.reach + search.widest
    bounded = crossing.Search(
        search.audit, search.slope, search.margin, widest, search.curvature, search.still
    )
    radius = crossing.radius_of(flat, bounded, shot, scene)
    close = still.depth <= _CLOSE * search.margin
    return crossing.enumerate_roots(world.roots, ZERO, flat, radius, close, shot, scene)


@inlined
def _is_clear(p, d, length, facet, world):
    """Return whether neither waves nor bodies cut a straight path off.

    `facet` is the one where it starts or ends.
    """
    if is_hidden(p, d, length, world.bodies):
        return False
    # A path steeper than every facet leaves a surface once and for all, upwards or downwards.
    slope = world.surface.max_slope
    if abs(d.z) > slope * math.sqrt(d.x * d.x + d.y * d.y):
        return True
    # neither the facets at its ends nor their neighbours are in the way
    hair = _HAIR * (1.0 + length)
    hit = first_facet(world.bvh, along(p, d, hair), d)
    if hit < 0 or hit == facet:
        return True
    return interface.plane_distance(p, d, hit, world.surface) > length - 2.0 * hair


@outlined
def _through(p, n, g, d, goal, facet, scene, world):
    """Return (density, share) of light along d through P to a goal, by the slope that bends it.

    The density is that of landing points about the goal [m-2], the share what transmittance,
    exposure of the facet and acceptance of the aperture leave.
    """
    # emission and arrival directions are both d, and the length before P is not needed: 0
    s = slope_towards(p, n, d, d, 0.0, goal, scene)
    # no slope refracts d to the goal, or the facet is seen from behind
    if s.density <= 0.0 or dot(d, g) <= 0.0:
        return 0.0, 0.0
    share = crossing.passed(1.0, s.aim, p, n, facet, s.tilt, scene)
    if share > 0.0 and (world.interface.follow_second_hit or scene.reflects):
        if not _is_clear(p, s.aim.r, s.aim.flight, facet, world):
            return 0.0, 0.0
    return s.density, share * _passed_behind(p, s.aim, scene)


@inlined
def _passed_behind(p, m, scene):
    """Return the transmittance of the water behind a crossing, where light is reflected back."""
    if not scene.reflects:
        return 1.0
    return math.exp(-depth_between(scene.medium, p, along(p, m.r, m.flight), m.flight))


@outlined
def _landing(p, n, d, u, v, scene, world):
    """Return (lands, goal): whether and where light bent by a drawn slope meets the aperture."""
    tilt = interface.drawn_tilt(world.surface.roughness, u, v)
    # a start 1 m before P, as only the direction matters
    m = crossing.land(
        p,
        interface.tilted(n, tilt),
        crossing.Shot(minus(p, d), ORIGIN, UP, Vec2(0.0, 0.0), 1.0, tilt),
        scene,
    )
    r = scene.target.radius
    return m.ok and m.at.x * m.at.x + m.at.y * m.at.y < r * r, m.at


@inlined
def _point_density(i, by_slopes, world):
    """Return the density of the points of target i that are drawn at a crossing [m-2].

    `by_slopes` is that of landing points of drawn slopes.
    """
    t = world.joins.target[i]
    # mixture of even points of the aperture and of landing points of drawn slopes
    return (1.0 - t.sloped) / t.area + t.sloped * by_slopes


@inlined
def _score(q, i, weight, theta, p, goal, water, world):
    """Score light of a photon at a point of target i, by a path of `water` [m] up to P.

    `theta` is the angle of a scattering at the start of the path [rad], < 0 without one.
    """
    weight *= world.joins.target[i].share
    n = keep_arrival(world, q.id, i, weight, world.tints, q.tint)
    if n >= 0:  # there is room for it
        a, target = world.arrivals[n], targets.scene_to(world.joins.target[i], world).target
        # from the crossing to the point of the aperture, off its centre
        off = plus(scaled(goal.x, target.e1), scaled(goal.y, target.e2))
        way = minus(plus(target.center, off), p)
        a.water, a.air, a.order = q.water + water, q.air + norm(way), q.order
        a.part = _part_of(q, world.under)
        # photons to a lamp run backwards: their light arrives where they start
        write(a.way, scaled(-1.0, targets.vector_of(q.first)) if target.is_lamp else way)
        tint_way(world.tints, a.tint, q.z, p.z, water)
        if targets.is_mirrored(world.under):
            # the way behind the crossing lies in the water, too
            a.water, a.air = a.water + norm(way), 0.0
            tint_way(world.tints, a.tint, p.z, p.z + way.z, norm(way))
        if theta >= 0.0:
            _, _, _, u = uniforms(world.seed, q.id, q.event, Purpose.JOIN_SLOPE.value)
            targets.tint_mixed(a.tint, theta, u, place(q), world)


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
def join_crossing(q, facet, length, chance, world):
    """Join a photon that meets a facet from below at a distance to every target.

    Array twin: the analog photon, whose slope is drawn.
    """
    joins, start, d = world.joins, place(q), heading(q)
    if is_hidden(start, d, length, world.bodies):
        return
    p = along(start, d, length)
    g = row(world.surface.face_normals, facet)
    n = interface.normal_on(p, facet, world.surface)
    u, v, u_target, _ = uniforms(world.seed, q.id, q.event, Purpose.APERTURE.value)
    # Expected weight that reaches the surface without a collision: exp(-tau).
    weight = q.weight * math.exp(-depth_between(world.medium, start, p, length))
    for i in range(len(joins.target)):
        if q.returns + 1 < joins.target[i].first:
            continue
        scene = targets.scene_to(joins.target[i], world)
        lands, goal = True, targets.goal_on(scene.target, u, v)
        if u_target < joins.target[i].sloped:
            lands, goal = _landing(p, n, d, u, v, scene, world)
        if not lands:
            continue
        density, share = _through(p, n, g, d, goal, facet, scene, world)
        if share <= 0.0:
            continue
        # balance heuristic: `here` for this connection, `other` for that of the last collision
        here, other = chance * _point_density(i, density, world), 0.0
        if q.density > 0.0:
            still = targets.still_crossing(start, goal, q.level, scene)
            other = targets.collision_chance(still.depth, joins) * targets.crossing_density(
                p.x, p.y, still, joins
            )
            # From crossings per horizontal area to directions and aperture points: the facet area
            # dA = length^2 / (d.g) dOmega has the horizontal area g_z dA, and points are drawn with
            # 1 / area; over the density of the direction that was drawn.
            other *= length * length * g.z / (dot(d, g) * scene.target.area * q.density)
        score = weight * density * share / (here + other)
        _score(q, i, score, -1.0, p, goal, length, world)


@outlined
def hit_crossing(q, facet, length, world):
    """Score a photon on every target to which a smooth facet at a distance refracts it.

    Array twin: the analog photon.
    For light that a mirror body has turned: without random slopes no connection brings it.
    """
    start, d = place(q), heading(q)
    if is_hidden(start, d, length, world.bodies):
        return
    p = along(start, d, length)
    n = interface.normal_on(p, facet, world.surface)
    weight = q.weight * math.exp(-depth_between(world.medium, start, p, length))
    for i in range(len(world.joins.target)):
        scene = targets.scene_to(world.joins.target[i], world)
        m, radius = crossing.land_from(p, n, d, d, length, scene), scene.target.radius
        if not m.ok or m.at.x * m.at.x + m.at.y * m.at.y > radius * radius:
            continue
        share = crossing.acceptance(m, p, scene.target, world.interface.fov)
        share *= crossing.transmittance(m, scene)
        ahead = dot(m.r, row(world.surface.face_normals, facet))
        if share > 0.0 and ahead > 0.0 and _is_clear(p, m.r, m.flight, facet, world):
            _score(q, i, weight * share, -1.0, p, m.at, length, world)


@outlined
def join_collision(q, turned_by, world):
    """Join a photon that is scattered, or reflected by the bottom or a body, to every target.

    Array twin: `join_crossing` of the photon that goes on.
    """
    joins = world.joins
    q.order += 1
    q.is_guided = 1 if q.copies + targets.SPARE < len(world.photon) else 0
    start, q.density, q.turned_by = place(q), 0.0, turned_by
    targets.note_event(q, world.under)
    q.level = level = targets.level_over(start, world)
    if q.returns + 1 < joins.first:
        return
    # By chance: connections of deep collisions bring exp(-c depth), and cost as much as others.
    chance = targets.collision_chance(max(level - start.z, targets.LEAST_DEPTH), joins)
    q.chance = chance
    q.density = 1.0  # > 0: may be joined; replaced when the next direction is drawn
    u_connection, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.JOIN.value)
    if u_connection >= chance:
        return
    u, v, wide, _ = uniforms(world.seed, q.id, q.event, Purpose.JOIN_SLOPE.value)
    # Box and Muller: distance of the crossing from that of still water, in standard deviations; v
    # is its azimuth, `wide` chooses the component of the mixture
    r = math.sqrt(-2.0 * math.log(u))
    # second component of the law of crossings, see `targets.crossing_density`
    if wide < targets.WIDE_SHARE:
        r *= targets.WIDE
    rough = interface.is_rough(world.surface.roughness)
    for i in range(len(joins.target)):
        if q.returns + 1 < joins.target[i].first:
            continue
        scene = targets.scene_to(joins.target[i], world)
        goal = targets.goal_on(scene.target, q.u, q.v)
        join_straight(q, i, world, world.under)
        still = targets.still_crossing(start, goal, level, scene)
        if rough:
            p = targets.beside(still, r, v, joins)
            _join_by_slope(p, q, i, goal, still, scene, world, world.search)
        else:
            _join_bent(q, i, goal, still, scene, world, world.search)


@outlined
def _join_by_slope(at, q, i, goal, still, scene, world, search):
    """Join an event to target i by the slope at a crossing at (x, y), see `join_collision`."""
    if search is not None:  # an argument: for smooth waves the rest is not compiled
        return
    joins, start = world.joins, place(q)
    x, y = at.x, at.y
    facet = targets.facet_below(x, y, world)
    if facet < 0:
        return
    p = Vec3(x, y, height_on(x, y, facet, world.surface))
    g = row(world.surface.face_normals, facet)
    way = minus(p, start)
    length = norm(way)
    w = scaled(1.0 / length, way)
    facing = dot(w, g)  # cosine of incidence on the facet
    if facing <= 0.0:
        return
    n = interface.normal_at(x, y, facet, world.surface)
    density, share = _through(p, n, g, w, goal, facet, scene, world)
    if share <= 0.0 or not _is_clear(start, w, length, facet, world):
        return
    phase, theta = targets.after_event(w, q, world)
    drawn = targets.drawn_after(w, phase, q, world)
    # the drawn crossing as a density of directions: dOmega = cos dA / length^2, dA = dx dy / g_z
    here = q.chance * targets.crossing_density(x, y, still, joins) * length * length * g.z
    here /= facing * scene.target.area
    bend = targets.bend_ahead(start, w, q.level, world)
    other = (
        drawn
        * targets.chance_ahead(start, w, q.level, bend, joins)
        * _point_density(i, density, world)
    )
    # balance heuristic: `here` for this connection, `other` for one at the crossing ahead
    phase *= math.exp(-depth_between(world.medium, start, p, length))
    factor = phase * density * share / (here + other)
    if factor > 0.0:
        _score(q, i, q.weight * factor, theta, p, goal, length, world)


@outlined
def _join_bent(q, i, goal, still, scene, world, search):
    """Join an event to target i by all crossings without random slopes, see `join_collision`."""
    start = place(q)
    shot = crossing.Shot(start, ORIGIN, UP, goal, 1.0, Vec2(0.0, 0.0))
    if search is None:  # an argument: the other branch is not compiled
        at = Vec2(still.x, still.y)
        _join_at(at, FLAT_SEA, 1.0, q, i, shot, scene, world)
    else:
        for k in range(_crossings_between(still, shot, q, scene, world, search)):
            root = world.roots[k]
            at, facet = Vec2(root.x, root.y), np.int64(root.facet)
            _join_at(at, facet, root.multiplicity, q, i, shot, scene, world)


@outlined
def _join_at(at, facet, multiplicity, q, i, shot, scene, world):
    """Join an event to target i by a crossing that refracts its light to the goal."""
    start, j = place(q), crossing.jacobian(at.x, at.y, facet, shot, scene)
    m, per_area = j.aim, crossing.solid_angle_per_area(j)
    if per_area == 0.0:
        return
    p = Vec3(at.x, at.y, height_on(at.x, at.y, facet, world.surface))
    weight = crossing.acceptance(m, p, scene.target, world.interface.fov)
    if weight <= 0.0:
        return
    if facet >= 0:
        g = row(world.surface.face_normals, facet)
        ahead = -dot(m.r, g) if scene.reflects else dot(m.r, g)
        if dot(m.w, g) <= 0.0 or ahead <= 0.0:
            return
        if scene.target.is_lamp:
            weight *= crossing.forwards(m, p, facet, shot.tilt, world.surface)
        if not _is_clear(start, m.w, m.length, facet, world):
            return
        second = world.interface.follow_second_hit or scene.reflects
        if second and not _is_clear(p, m.r, m.flight, facet, world):
            return
    phase, theta = targets.after_event(m.w, q, world)
    # all points of the aperture: |A| dOmega / dx at the one that photons are joined to, the inverse
    # of a density of directions
    per_direction = scene.target.area * per_area / q.chance
    if scene.reflects:
        # balance heuristic: the photon that goes on may hit the aperture by this mirror, too
        drawn = targets.drawn_after(m.w, phase, q, world)
        per_direction /= 1.0 + drawn * per_direction
    weight *= per_direction * crossing.transmittance(m, scene)
    weight *= phase
    weight *= math.exp(-depth_between(world.medium, start, p, m.length))
    weight *= multiplicity * _passed_behind(p, m, scene)
    if weight > 0.0:
        _score(q, i, q.weight * weight, theta, p, shot.goal, m.length, world)
