"""The walk of joined photons: through the water, and back from the surface and the bottom.

Photons are those of `photons.flight` without the light that leaves the water: at each crossing and
collision `photons.next_event` scores the expected value of that light instead. A weight window
plays Russian roulette with photons of small weight times importance and splits those of a large
one [1]_. After collisions extra copies take directions towards the targets; all directions that
are drawn are weighted by the balance heuristic. In clear water collisions are `Joins.often` times
as frequent as those of light, and count by the inverse. Names are those of `photons.flight`; the
way to a target is the direction that reaches it through still water, and s = sin^2(theta / 2)
stands for a scattering angle theta.

References
----------
.. [1] A. Haghighat and J. C. Wagner, "Monte Carlo variance reduction with deterministic importance
   functions", Progress in Nuclear Energy 42, 25 (2003).
"""

from __future__ import annotations

import math

import numpy as np

from meshtrace.engine.photons import targets
from meshtrace.engine.photons.flight import OFFSET, bending_normal, facet_ahead, look_ahead
from meshtrace.engine.photons.in_medium import join_hits
from meshtrace.engine.photons.next_event import hit_crossing, join_collision, join_crossing
from meshtrace.engine.photons.state import head, heading, place, put
from meshtrace.engine.photons.targets import Law
from meshtrace.kernels import interface, medium
from meshtrace.kernels.bodies import is_hidden, normal_facing, reflected
from meshtrace.kernels.jit import NO, YES, ZERO, entry, inlined, outlined
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.sources import SourceKind, lambert_reflection, launch
from meshtrace.kernels.tally import BODY, BOTTOM, SCATTERED
from meshtrace.kernels.tints import reset_tint, tint_way
from meshtrace.kernels.vectors import TWO_PI, Vec2, along, dot, row, scaled, turn, write

_LOWEST = 0.3  # tuned: weight times importance, over that of the start, of roulette below it
_LEAST_CHANCE = 0.1  # least chance of survival: no photon becomes more than tenfold heavier at once
_MOST_COPIES = 10  # of one splitting: a burst of copies shares the errors of its stem
_MOST_EVENTS = 10_000_000  # of a photon and its copies


@inlined
def _emitted(cos_theta, kind, spread):
    """Return the density of directions of a wide source [sr-1].

    `spread` is the Lambertian order of an LED, the half-angle of an aperture [rad].
    """
    if kind == SourceKind.ISOTROPIC:
        return 0.25 / math.pi
    if cos_theta <= 0.0:
        return 0.0
    if kind == SourceKind.LED:
        return (spread + 1.0) / TWO_PI * cos_theta**spread
    # an aperture as a source: cos / (pi sin^2 of its half-angle), even in projected solid angle
    seen = math.sin(spread) ** 2
    return cos_theta / (math.pi * seen) if 1.0 - cos_theta * cos_theta <= seen else 0.0


@outlined
def guide_start(d, p, source, photon, uv, world):
    """Return (direction, weight) of a new photon, possibly guided to the view of a target.

    Array twin: photons with `Joins.start_lobe` and `start_cone`.
    d is drawn from the pattern of the source; p is the position, `uv` the two uniforms of the point
    of the apertures that is aimed at. The mixture has three parts: the pattern, the phase function
    about the ways to the targets, as after a first collision, and directions uniform over the cones
    to what the targets see, for which the pattern may draw too few.
    """
    joins, sources = world.joins, world.sources
    # chances of the two guided parts of the mixture, each shared equally by the n guides
    lobe, cone, n = joins.start_lobe, joins.start_cone, len(joins.guide)
    kind = sources.kind[source]
    # Beams have their own direction: others would carry none of their light. Light from the air
    # is bent before any target sees it.
    beam = kind != SourceKind.LED and kind != SourceKind.ISOTROPIC and kind != SourceKind.APERTURE
    if lobe + cone == 0.0 or beam or not sources.in_water[source]:
        return d, 1.0
    # one uniform chooses law and guide: [0, lobe) and [lobe, lobe + cone) in n equal parts each
    level = targets.level_over(p, world)
    u_guide, u, v, _ = uniforms(world.seed, photon, 0, Purpose.GUIDE.value)
    if u_guide < lobe:
        way = targets.way_to(min(int(u_guide / lobe * n), n - 1), p, level, uv, world)
        d = turn(way, medium.sample_s(world.medium.phase_water, u), v)
    elif u_guide < lobe + cone:
        axis, edge = targets.cone_to(min(int((u_guide - lobe) / cone * n), n - 1), p, world)
        d = turn(axis, u * edge, v)  # s even in [0, edge) is even in solid angle
    lamp_density = _emitted(dot(d, row(sources.axis, source)), kind, sources.spread[source])
    # outside the pattern of the lamp: drawn in vain, with weight 0
    if lamp_density == 0.0:
        return d, 0.0
    drawn = (1.0 - lobe - cone) * lamp_density
    if cone > 0.0:
        drawn += cone * targets.cone_density(d, p, world)
    for i in range(n):
        if lobe > 0.0:
            way = targets.way_to(i, p, level, uv, world)
            drawn += lobe / n * medium.phase_at(joins.water, targets.angle_between(way, d))
    return d, lamp_density / drawn


@outlined
def redirect(q, s, u_phi, world):
    """Turn a scattered photon by an angle, or to the direction for which a copy has waited.

    Array twin: photons without `Joins.lobe` and `Joins.cone`.
    s = sin^2(theta / 2) is of the drawn scattering angle, `u_phi` its azimuth over 2 pi. A copy
    waits on the stack with the law and guide by which its own direction is drawn when it resumes:
    about the way to a target, else few photons that head almost for it would carry heavy scores, or
    uniform over the cone to what a target sees. Photon and copies are weighted by phase function
    over the expected density of all directions drawn.
    """
    start, before, law = place(q), heading(q), q.law
    lobe, cone = targets.guided_directions(q, world)
    u_guide, u, u_kind, _ = uniforms(world.seed, q.id, q.event, Purpose.GUIDE.value)
    if law == Law.LOBE:
        uv = targets.aim_of(q, world)
        d = turn(targets.way_to(q.guide, start, q.level, uv, world), s, u_phi)
    elif law == Law.CONE:
        axis, edge = targets.cone_to(q.guide, start, world)
        d = turn(axis, u * edge, u_phi)
    else:
        _push_guided(q, u_guide, lobe, cone, world)
        d = turn(before, s, u_phi)
    q.law = Law.PHASE.value
    phase, theta = targets.after_event(d, q, world)
    # the angle is needed at other wavelengths alone; the bottom has none
    if theta >= 0.0:
        targets.tint_mixed(q.tint, theta, u_kind, start, world)
    q.density = phase
    if lobe + cone > 0.0:
        q.density = targets.drawn_density(d, phase, q, world)
        q.weight *= phase / q.density
    head(q, d)


@inlined
def _push_guided(q, u, lobe, cone, world):
    """Put a copy with a guided direction on the stack, by chance: if u < lobe + cone."""
    if u >= lobe + cone or q.copies + 1 >= len(world.photon):
        return
    # u runs through n equal parts of each law
    n = len(world.joins.guide)
    if u < lobe:
        q.law, q.guide = Law.LOBE.value, min(int(u / lobe * n), n - 1)
    else:
        q.law, q.guide = Law.CONE.value, min(int((u - lobe) / cone * n), n - 1)
    _push(q, world)
    q.law = Law.PHASE.value


@inlined
def _push(q, world):
    """Put a copy of a photon on the stack, to be followed later."""
    q.copies += 1
    world.photon[q.copies] = q  # assignment of a record copies it


@outlined
def importance(p, world):
    """Return the importance of a place for the weight window.

    Array twin: none, a weight window is unbiased for any importance.
    In turbid water the diffusion flux of a point one transport length below the surface, and its
    image above [1]_, else the attenuated view of what the targets see.

    References
    ----------
    .. [1] T. J. Farrell, M. S. Patterson and B. Wilson, Medical Physics 19 (1992) 879,
       doi:10.1118/1.596777, eq. 11.
    """
    joins, window = world.joins, world.joins.window
    depth, total = max(-p.z, 0.0), 1e-12  # not 0: ratios divide by the importance of the start
    for i in range(len(joins.guide)):
        seen = joins.guide[i].seen  # see `targets.TARGET`
        dx, dy = p.x - seen[0], p.y - seen[1]
        square = dx * dx + dy * dy
        if targets.is_mirrored(world.under):
            # falls with the distance from the receiver, or its image in the surface; in turbid
            # water softened within a transport length
            soft = window.length if window.diffuse else 0.0
            square += (p.z - seen[2]) * (p.z - seen[2])
            r = math.sqrt(square)
            total += math.exp(-window.kappa * r) / (
                1.0 + square / (seen[3] * seen[3] + soft * soft)
            )
        elif window.diffuse:
            # softened within a fifth of a transport length, where diffusion does not hold
            square += 0.04 * window.length * window.length
            low, high = depth - window.length, depth + window.length + 2.0 * window.beyond
            r1, r2 = math.sqrt(square + low * low), math.sqrt(square + high * high)
            # point source less its image above the extrapolated boundary (Farrell et al. 1992)
            total += math.exp(-window.kappa * r1) / r1 - math.exp(-window.kappa * r2) / r2
        else:
            square += depth * depth
            wide = seen[3] * seen[3]
            # attenuated, and falling as 1 / r^2 beyond the radius of the view
            total += math.exp(-window.kappa * math.sqrt(square)) / (1.0 + square / wide)
    return total


@inlined
def ratio_of(q, p, world):
    """Return the weight times importance of a photon at p, relative to its start.

    Array twin: none.
    """
    # light that no slope can bend to a target is worth less
    bent = 1.0 + world.joins.window.bent * q.bend
    return q.weight * importance(p, world) / (bent * q.importance)


@inlined
def survives(q, p, share, u_survival, world):
    """Play Russian roulette with a photon of low weight times importance; return whether it lives.

    Array twin: none.
    `share` is the part of its weight that will be left at p; a negative `u_survival` is drawn anew.
    """
    ratio = share * ratio_of(q, p, world)
    if ratio >= _LOWEST:
        return True
    # Survivors have twice the lowest ratio, in the middle of the window.
    chance = max(ratio / (2.0 * _LOWEST), _LEAST_CHANCE)
    if u_survival < 0.0:
        u_survival, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.ROULETTE.value)
    if u_survival >= chance:
        return False
    q.weight /= chance
    return True


@inlined
def copies_of(q, world):
    """Return the number of photons that one of high weight times importance is split into.

    Array twin: none.
    """
    ratio = ratio_of(q, place(q), world)
    if ratio <= world.joins.window.highest:
        return 1
    # at most the room on the stack for waiting copies, half of `SPARE` left for guided ones
    return max(min(int(ratio), _MOST_COPIES, len(world.photon) - targets.SPARE // 2 - q.copies), 1)


_LEANING = 2.0  # standard deviations by which waves lean in a bound on their reflectance


@inlined
def _draw_path(q, u, world):
    """Draw the free path to the next collision, or to a body before it."""
    q.free = medium.sample_free_path(world.medium, place(q), u) / world.joins.often
    look_ahead(q, world.bodies)


@inlined
def _start(q, photon, world):
    """Start a photon at its source."""
    p, d, source, u_path = launch(world.sources, world.seed, photon)
    # the point of the apertures that all collisions of this photon are joined to
    q.u, q.v, _, _ = uniforms(world.seed, photon, 0, Purpose.JOIN.value)
    d, q.weight = guide_start(d, p, source, photon, Vec2(q.u, q.v), world)
    put(q, p)
    head(q, d)
    write(q.first, d)
    q.water, q.id, q.event, q.order, q.reflections, q.returns = 0.0, photon, 0, 0, 0, 0
    q.air, q.turned_by = 0.0, SCATTERED
    if not world.sources.in_water[source]:
        _enter(q, world, world.under)
        p = place(q)
    q.level, q.density, q.bend = targets.level_over(p, world), 0.0, 0.0
    q.copies, q.is_guided, q.law = 0, 0, Law.PHASE.value
    reset_tint(world.tints, q.tint)
    q.importance = importance(p, world)
    _draw_path(q, u_path, world)
    _look_ahead(q, world, world.search)


@outlined
def _enter(q, world, under):
    """Refract a photon that starts in the air into the water; weight 0 if it misses the mesh.

    Array twin: `photons.flight.cross`. What the surface reflects is not followed here.
    """
    if under is None:  # an argument: not compiled for links that change sides
        return
    facet = facet_ahead(q, NO, ZERO, world)
    p, d = place(q), heading(q)
    if facet < 0 or dot(d, row(world.surface.face_normals, facet)) >= 0.0:
        q.weight = 0.0
        return
    length = max(interface.plane_distance(p, d, facet, world.surface), 0.0)
    if is_hidden(p, d, length, world.bodies):  # bodies in the air are black, see `joined`
        q.weight = 0.0
        return
    put(q, along(p, d, length))
    q.air = length
    g, n, _ = bending_normal(q, facet, world)
    # normals point up; the law of refraction wants them along the light
    n_air, n_water = world.medium.n_air, world.medium.n_water
    below, inward = scaled(-1.0, n), scaled(-1.0, g)
    rho, refracted, _ = interface.branches(d, below, inward, n_air, n_water, world.interface)
    q.weight *= (1.0 - rho) * world.interface.foam_transmittance
    q.event += 1
    put(q, along(place(q), g, -OFFSET))
    head(q, refracted)


@outlined
def _facet_ahead(q, world):
    """Return (facet, distance) of the surface ahead of a photon; facet -1 off the mesh."""
    p, d, facet = place(q), heading(q), facet_ahead(q, YES, ZERO, world)
    # a facet that light in the water meets from above: rounding put the start on its wrong side
    if facet < 0 or dot(d, row(world.surface.face_normals, facet)) <= 0.0:
        return np.int64(-1), math.inf
    return facet, max(interface.plane_distance(p, d, facet, world.surface), 0.0)


@outlined
def _look_ahead(q, world, search):
    """Join, by chance, the light of a photon that meets the surface before another collision.

    Light that goes on straight to a receiver in the water is joined first.
    """
    join_hits(q, world, world.under)
    _hit_beyond(q, world, world.bodies)
    # smooth waves; a separate argument, so that numba leaves the rest out by its type
    if search is not None:
        return
    joins = world.joins
    # Without random slopes a given direction never hits a given point of an aperture: collisions
    # alone are joined. The crossing ahead is number `returns` + 1, scored from `first` on.
    if not interface.is_rough(world.surface.roughness) or q.returns + 1 < joins.first:
        return
    # for the weight window, whether or not a connection follows
    q.bend = targets.bend_ahead(place(q), heading(q), q.level, world)
    # unscattered light is evaluated over the facets, unless `direct` asks for it here
    if q.order == 0 and q.reflections == 0 and not joins.direct:
        return
    # heads down from below the waves: meets no facet
    if q.dz <= 0.0 and q.z < world.surface.low[2]:
        return
    chance = targets.chance_ahead(place(q), heading(q), q.level, q.bend, joins)
    _, _, _, u_connection = uniforms(world.seed, q.id, q.event, Purpose.APERTURE.value)
    if u_connection < chance:
        facet, distance = _facet_ahead(q, world)
        if facet >= 0:
            join_crossing(q, facet, distance, chance, world)


@outlined
def _hit_beyond(q, world, bodies):
    """Score light of a mirror body on receivers that it hits through smooth water.

    Array twin: `join_hits` of receivers in the water.
    """
    if bodies is None:  # an argument: not compiled for links without bodies
        return
    # A negative density: a mirror body has turned it, whose one direction no connection can draw.
    # Receivers in the water are met by `join_hits`.
    if q.density >= 0.0 or targets.is_mirrored(world.under):
        return
    # over random slopes its crossing is joined, see `_look_ahead`
    if interface.is_rough(world.surface.roughness):
        return
    facet, distance = _facet_ahead(q, world)
    if facet >= 0:
        hit_crossing(q, facet, distance, world)


@inlined
def _fly(q, length, world):
    """Move a photon through the water."""
    start, often = place(q), world.joins.often
    put(q, along(start, heading(q), length))
    q.water += length
    tint_way(world.tints, q.tint, start.z, q.z, length)
    if world.medium.absorption == medium.Absorption.CONTINUOUS:
        tau = medium.absorption_path(world.medium, start.z, q.z, length)
        # tau so far is that of absorption. Collisions are drawn `often` times too frequently: the
        # factor exp(+(often - 1) tau_b), tau_b the optical depth of scattering, corrects the chance
        # to pass without a collision, 1 / often at each collision that of its density.
        if often > 1.0:
            tau -= (often - 1.0) * medium.scattering_path(world.medium, start, place(q), length)
        q.weight *= math.exp(-tau)


@inlined
def _most_reflected(q, world):
    """Return the reflectance of waves that lean away from the light by `_LEANING` deviations."""
    n, lean = world.medium.n_water / world.medium.n_air, _LEANING * world.joins.spread
    flat = math.sqrt(max(1.0 - q.dz * q.dz, 0.0))
    # cosine of incidence on a wave that leans by that slope away from the light
    c = (q.dz - lean * flat) / math.sqrt(1.0 + lean * lean)
    square = 1.0 - n * n * (1.0 - c * c)
    if c <= 0.0 or square <= 0.0:
        return 1.0
    return interface.reflectance(c, math.sqrt(square), world.medium.n_water, world.medium.n_air)


@outlined
def _stays(q, world):
    """Return whether a photon that meets the surface is followed back into the water."""
    if not world.interface.follow_reflected:
        return False
    if not interface.is_rough(world.surface.roughness):
        return True  # `_reflect` plays, by the reflectance itself
    # random number of the next event, which the reflection is: the last one may have used its own
    _, _, u_survival, _ = uniforms(world.seed, q.id, q.event + 1, Purpose.INTERFACE.value)
    q.bend = 0.0
    way = max(q.level - q.z, 0.0) / q.dz if q.dz > 0.0 else 0.0
    # A bound on the weight that reflection can leave: roulette before the facet is searched.
    share = _most_reflected(q, world)  # upper bound of the reflectance on likely slopes
    if world.medium.absorption == medium.Absorption.CONTINUOUS:
        share *= math.exp(-medium.absorption_path(world.medium, q.z, q.z + way * q.dz, way))
    return survives(q, along(place(q), heading(q), way), share, u_survival, world)


@inlined
def _note_mirror(q, facet, world, under):
    """Record the facet that reflects a photon, if hits join its way to a receiver, too.

    Without random slopes that is the first facet after an event; light of further ones, and over
    random slopes, is joined by its crossing or at its next collision.
    """
    is_joined = q.density > 0.0 and not interface.is_rough(world.surface.roughness)
    if targets.is_mirrored(under) and is_joined and q.facet < 0:
        q.facet = facet
    elif q.density > 0.0 or interface.is_rough(world.surface.roughness):
        q.density = 0.0


@outlined
def _reflect(q, facet, world):
    """Reflect a photon off a facet; return whether it lives."""
    p, d = place(q), heading(q)
    g, n, u_survival = bending_normal(q, facet, world)
    n1, n2 = world.medium.n_water, world.medium.n_air
    rho, _, reflected = interface.branches(d, n, g, n1, n2, world.interface)
    q.event += 1
    q.reflections += 1
    q.returns += 1
    q.weight *= rho * world.interface.foam_transmittance
    _note_mirror(q, facet, world, world.under)
    if q.weight == 0.0 or not survives(q, place(q), 1.0, u_survival, world):
        return False
    put(q, along(p, g, -OFFSET))
    head(q, reflected)
    q.level = targets.level_over(place(q), world)
    _, u_path, _, _ = uniforms(world.seed, q.id, q.event, Purpose.INTERFACE.value)
    _draw_path(q, u_path, world)
    _look_ahead(q, world, world.search)
    return True


@inlined
def _is_worth(q, is_turned, world):
    """Play the roulette of an event; return whether the photon lives.

    Where the importance depends on the direction (`Window.bent`), it is played after the turn, else
    before: guided copies have small weights by design, and roulette would end them.
    """
    if (world.joins.window.bent > 0.0) != is_turned:
        return True
    return survives(q, place(q), 1.0, -1.0, world)


@outlined
def _guide_from_wall(q, d, world, under):
    """Guide copies of a photon off the bottom or a body to the targets, as after a collision.

    Array twin: photons without `Joins.lobe`.
    The photon itself goes on along d. Light from the bottom that almost heads for a target, and is
    scattered forwards on its way, is most of what comes back to a narrow view: few photons would
    carry it in heavy scores.
    """
    if under is None:  # an argument: not compiled for links that change sides
        return
    lobe, cone = targets.guided_directions(q, world)
    if lobe + cone == 0.0:
        return
    phase = q.density
    u_guide, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.GUIDE.value)
    _push_guided(q, u_guide, lobe, cone, world)
    q.density = targets.drawn_density(d, phase, q, world)
    q.weight *= phase / q.density


@outlined
def _bounce(q, world):
    """Reflect a photon off the bottom; return whether it lives."""
    q.z = world.medium.bottom_z
    q.weight *= world.medium.bottom_albedo
    q.event += 1
    q.returns += 1
    if q.weight == 0.0:
        return False
    # joined before its direction is drawn, like a collision; by Lambert's law in place of a phase
    # function
    join_collision(q, BOTTOM, world)
    if not _is_worth(q, NO, world):
        return False
    u_cos, u_phi, u_path, _ = uniforms(world.seed, q.id, q.event, Purpose.BOTTOM.value)
    d = lambert_reflection(u_cos, u_phi)
    return _leave_wall(q, d, d.z, u_path, world)


@outlined
def _leave_wall(q, d, cosine, u_path, world):
    """Send a photon along d, by its cosine to the normal of a wall; return whether it lives."""
    if q.density > 0.0:  # the wall was joined: density of Lambert's law for its direction
        q.density = cosine / math.pi
        _guide_from_wall(q, d, world, world.under)
    head(q, d)
    _draw_path(q, u_path, world)
    _look_ahead(q, world, world.search)
    return _is_worth(q, YES, world)


@inlined
def _end_path(q, world, bodies):
    """Apply what ends a free path, a body or a collision; return whether the photon lives."""
    if bodies is not None:  # an argument: not compiled for links without bodies
        if q.body >= 0:
            return _meet(q, world, bodies)
    return _scatter(q, world)


@outlined
def _meet(q, world, bodies):
    """Reflect a photon off the body that it has reached; return whether it lives."""
    body, incoming = bodies.body[q.body], heading(q)
    q.weight *= bodies.albedo[body]
    q.event += 1
    q.returns += 1
    if q.weight == 0.0:
        return False
    u_cos, u_phi, u_path, _ = uniforms(world.seed, q.id, q.event, Purpose.BODY.value)
    p, d = reflected(place(q), incoming, q.body, u_cos, u_phi, bodies)
    put(q, p)
    if bodies.is_mirror[body]:
        q.order += 1
        q.turned_by, q.density, q.level = BODY, -1.0, targets.level_over(p, world)
        targets.note_event(q, world.under)
    else:
        join_collision(q, BODY, world)
        if not _is_worth(q, NO, world):
            return False
    return _leave_wall(q, d, dot(d, normal_facing(incoming, q.body, bodies)), u_path, world)


@outlined
def _scatter(q, world):
    """Apply a collision; return whether the photon lives."""
    q.event += 1
    u_kind, u_theta, u_phi, u_path = uniforms(world.seed, q.id, q.event, Purpose.COLLISION.value)
    s, q.weight, _ = medium.collide(world.medium, place(q), q.weight, u_kind, u_theta)
    if q.weight == 0.0:
        return False
    if s >= 0.0:
        q.weight /= world.joins.often
        if q.order == 0:
            # ratio to the start unchanged: no roulette for the factor 1 / often
            q.importance /= world.joins.often
        join_collision(q, SCATTERED, world)
        if not _is_worth(q, NO, world):
            return False
        # Splitting before the direction is drawn: copies take different ways.
        n = copies_of(q, world)
        q.weight /= n
        for _ in range(n - 1):
            _push(q, world)
        redirect(q, s, u_phi, world)
        _look_ahead(q, world, world.search)
        if not _is_worth(q, YES, world):
            return False
    # a null collision of delta tracking: many in clear water below bubbles, so roulette here too
    elif not survives(q, place(q), 1.0, -1.0, world):
        return False
    _draw_path(q, u_path, world)
    return True


@outlined
def _resume(q, world):
    """Take the last copy from the stack; return whether it lives.

    Its random numbers are those of the next event: no two of a photon's tree are the same.
    """
    event, copies = q.event, q.copies
    world.photon[0] = world.photon[copies]
    # the event of the photon that went on before, so that no numbers are used twice
    q.event, q.copies = event + 1, copies - 1
    u_kind, u_theta, u_phi, u_path = uniforms(world.seed, q.id, q.event, Purpose.COLLISION.value)
    b, bubbles = medium.scattering_coefficients(world.medium, place(q))
    # water or bubble as in `medium.collide`, given that it scatters
    phase = world.medium.phase_water
    if u_kind * (b + bubbles) >= b:
        phase = world.medium.phase_bubble
    redirect(q, medium.sample_s(phase, u_theta), u_phi, world)
    if q.weight == 0.0:  # into the bottom that the copy has left
        return False
    _look_ahead(q, world, world.search)
    _draw_path(q, u_path, world)
    return _is_worth(q, YES, world)


@outlined
def _walk(q, world):
    """Follow a photon to its end."""
    low, high, bottom = world.surface.low[2], world.surface.high[2], world.medium.bottom_z
    alive = q.weight > 0.0
    while alive and q.event < _MOST_EVENTS:
        # facets are searched only where the path rises into the slab of the waves, or starts in it
        t, facet = q.free, np.int64(-1)
        if q.z + t * q.dz > low or (q.z >= low and q.dz > -1.0):
            # the path ends beyond the highest crest: it meets the surface on any sea, so that
            # roulette can come before the search for the facet, which costs most
            surely = q.z + t * q.dz > high
            if surely and not _stays(q, world):
                return
            facet, distance = _facet_ahead(q, world)
            if facet >= 0 and distance < t:
                if not surely and not _stays(q, world):
                    return
                _fly(q, distance, world)
                alive = _reflect(q, facet, world)
                continue
            if facet < 0 and surely:
                return  # beside the mesh
        if q.dz < 0.0 and q.z + t * q.dz < bottom:
            _fly(q, (bottom - q.z) / q.dz, world)
            alive = _bounce(q, world)
        elif math.isinf(t):
            return
        else:
            _fly(q, t, world)
            alive = _end_path(q, world, world.bodies)


@entry
def follow_joined(first, last, world):
    """Follow the photons first <= id < last and all their copies to their ends.

    Array twin: the analog photon, `meshtrace.engine.photons.flight.follow`.
    """
    # Next-event estimation (Kalos 1963) with splitting and roulette by a weight window (Haghighat
    # and Wagner 2003); copies wait on a stack, the last one goes first.
    q = world.photon[0]
    for photon in range(first, last):
        _start(q, photon, world)
        _walk(q, world)
        while q.copies > 0:
            if _resume(q, world):
                _walk(q, world)
