"""The analog photon: from the source through the water to the surface and beyond.

`follow` takes photons one after another through flights in the water, crossings of the surface and
flights in the air until they end. A free path ends at a collision, or at a body before it. The
facet ahead is found on the grid of the mesh where `grid_facet` knows it, else by a ray. At the
surface light is refracted and reflected; what leaves for good is scored at once. The slab is the
layer between the lowest trough and the highest crest.

Names of these kernels: q is the photon under way, a record that is changed in place; p a point, d a
unit direction; g the normal of a facet and n that which refracts light, both up; u, v uniform
numbers in (0, 1). The z axis points up from still water; lengths are in the unit of the frame of
the link, given as [m] here: 1 m but for very small and large links.
"""

from __future__ import annotations

import math
from enum import IntEnum

from meshtrace.engine.photons.state import Vertex, head, heading, place, put, record, write_vertex
from meshtrace.kernels import interface, sources, tally
from meshtrace.kernels.bodies import first_body, reflected
from meshtrace.kernels.interface import branches
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import Absorption, absorption_path, collide, sample_free_path
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.rays import UNKNOWN, first_facet, grid_facet
from meshtrace.kernels.tally import Fate, deposit
from meshtrace.kernels.tints import is_tinted, reset_tint, tint_scattering, tint_way
from meshtrace.kernels.vectors import Vec3, along, dot, plus, row, scaled, turn


class Miss(IntEnum):
    """Rays that missed the surface inside the mesh, `Tallies.misses`."""

    CAST_AGAIN = 0
    GIVEN_UP = 1  # the photon has leaked through the mesh


GOES_ON = -1  # else a function returns the fate that ends the photon


@inlined
def set_weight(q, weight, fate, world):
    """Change the weight of a photon and add the loss to the ledger of a fate."""
    deposit(world.tallies, fate, q.weight - weight)
    q.weight = weight


@inlined
def roulette(q, u_survival, world):
    """Play Russian roulette with a low-weight photon; a negative `u_survival` is drawn anew."""
    if q.weight >= world.least_weight:  # most photons
        return GOES_ON
    # Unbiased for any chance p of survival: survivors carry weight / p.
    p = world.survival if world.survival > 0.0 else q.weight / world.least_weight
    if u_survival < 0.0:
        u_survival, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.ROULETTE.value)
    if u_survival >= p:
        return Fate.ROULETTE.value
    set_weight(q, q.weight / p, Fate.ROULETTE.value, world)
    return GOES_ON


@inlined
def steeper_than_waves(d, surface):
    """Return whether a direction is too steep to meet the surface again once it leads away."""
    # tan of the elevation, |d_z| / |d_xy|, squared: no root and no division
    slope = surface.max_slope
    return d.z * d.z > slope * slope * (d.x * d.x + d.y * d.y)


_NUDGE = 1e-4  # [m], displacement of a missed ray that is cast again


@inlined
def facet_ahead(q, in_water, retry, world):
    """Return the facet that a photon meets, or -1; `retry` counts the rays that missed it.

    Array twin: `BruteForceIntersector`.
    A ray starts at the entry of the photon into the slab of the surface.
    """
    p, d = place(q), heading(q)
    # a walk over grid lines where it is sure of the facet; else, and after a miss, Embree
    if len(world.grid.x.line) > 0 and retry == 0:
        facet = grid_facet(world.grid, world.surface.vertices, p, d)
        if facet != UNKNOWN:
            return facet
    t = 0.0
    if in_water and d.z > 0.0:
        t = (world.surface.low[2] - p.z) / d.z
    elif not in_water and d.z < 0.0:
        t = (world.surface.high[2] - p.z) / d.z
    # Start near the slab, and a little before it: Embree has single precision.
    t = max(t - 1e-3 * (1.0 + t), 0.0)
    # aside by unequal steps, so that a ray along an edge leaves it, and off the surface
    nudge = _NUDGE * retry
    aside = Vec3(nudge, 0.7 * nudge, -nudge if in_water else nudge)
    return first_facet(world.bvh, plus(along(p, d, t), aside), d)


@inlined
def bending_normal(q, facet, world):
    """Return (facet normal, normal that bends light, spare uniform or -1) at a crossing.

    Array twin: `roughened`.
    """
    # light is refracted by the interpolated normal; the facet's own decides what it blocks
    g = row(world.surface.face_normals, facet)
    n = interface.normal_on(place(q), facet, world.surface)
    if interface.takes_slopes(g, world.surface.roughness):
        u, v, w, u_spare = uniforms(world.seed, q.id, q.event, Purpose.SLOPE.value)
        return g, interface.roughened(heading(q), n, u, v, w, world.surface.roughness), u_spare
    return g, n, -1.0


OFFSET = 1e-5
"""Distance of a ray's start from the facet that it leaves [m]."""


@inlined
def _is_scored(q, world):
    """Return whether light of a photon is scored: unscattered light may be left to the facets."""
    return world.scores_unscattered or q.turned > 0 or q.crossings > 1


@inlined
def to_sky(q, d, weight, world):
    """Score light that leaves the surface for good and deposit its weight."""
    # a photon that runs backwards from a receiver collects the radiance of the sky along its path
    if sources.is_backward(world.back) and (q.water > 0.0 or not world.back.after_water):
        scored_radiance = weight * sources.radiance(world.back.sky, d)
        world.tallies.score[q.id - world.first, sources.SKY_SCORE] += scored_radiance
        if is_tinted(world.tints):
            tally.keep_arrival(
                world.tallies, q.id, sources.SKY_SCORE, scored_radiance, world.tints, q.tint
            )
    # a ray without end: nothing is in its way any more
    scored = _is_scored(q, world)
    received = scored and tally.score_apertures(q, False, d, weight, math.inf, world)
    if scored:
        tally.score_map(q, d, weight, math.inf, world)
    deposit(world.tallies, Fate.RECEIVED.value if received else Fate.LANDED.value, weight)
    if received:
        q.outcome = Fate.RECEIVED.value
    # once received a photon counts as such, whatever its reflected parts do later
    elif q.outcome < 0:
        q.outcome = Fate.LANDED.value
    if q.id < len(world.recorder.length):
        _record_flight(q, d, weight, received, world)


@outlined
def _record_flight(q, d, weight, received, world):
    """Record the point of a path in air at the height of the first aperture."""
    p, t = place(q), 1.0
    if len(world.apertures.radius) > 0 and d.z > 0.0:
        t = max((world.apertures.center[0, 2] - p.z) / d.z, 0.0)
    what = Vertex.RECEIVED if received else Vertex.LANDED
    write_vertex(world.recorder, q.id, along(p, d, t), weight, what)


@inlined
def cross(q, world):
    """Refract and reflect a photon on facet `q.facet`.

    The part that flies free through the air is scored at once; the part in the water goes on
    with its weight. Where the air part may meet the surface again one of the two is chosen.
    """
    in_water = q.in_water == 1
    q.crossings += 1
    foam = world.interface.foam_transmittance
    # Foam is a loss at each crossing: light scattered by whitecaps is not followed.
    if foam < 1.0:
        deposit(world.tallies, Fate.WHITECAP.value, q.weight * (1.0 - foam))
        q.weight *= foam
        if foam == 0.0:
            return Fate.WHITECAP.value
    record(world.recorder, q, Vertex.SURFACE_OUT if in_water else Vertex.SURFACE_IN)
    # reflectance rho: of light from below 1 - rho goes on in the air, of light from above in water
    rho, g, air, water, u_survival = _split(q, in_water, world)
    w_air, w_water = q.weight * (1.0 - rho), q.weight * rho
    if not in_water:
        w_air, w_water = w_water, w_air
    free = not world.interface.follow_second_hit or (  # air part meets no wave again
        air.z > 0.0 and (q.z >= world.surface.high[2] or steeper_than_waves(air, world.surface))
    )
    free = free and _is_clear(q, air, world.bodies)
    # Both parts of the light can be followed only if one of them ends at once; else roulette by
    # their weights.
    if world.interface.fresnel != interface.FresnelMode.WEIGHT or not free:
        u, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.INTERFACE.value)
        if u * (w_air + w_water) < w_air:
            if world.interface.fresnel == interface.FresnelMode.PAPER_BOTH:
                # E4 of docs/paper.md: roulette and weight, twice the loss
                set_weight(q, w_air, Fate.REFLECTED.value, world)
            w_air, w_water = q.weight, 0.0
        else:
            w_air, w_water = 0.0, q.weight
    q.event += 1
    q.in_water = int(w_water > 0.0)
    q.weight = w_water
    if w_air > 0.0:
        if not free:
            q.weight = w_air
            return _leave(q, air, g, world)
        to_sky(q, air, w_air, world)
    if w_water == 0.0:  # nothing is left; `outcome` tells whether it was received
        return Fate.LANDED.value
    if in_water and not world.interface.follow_reflected:
        return Fate.REFLECTED.value
    fate = roulette(q, u_survival, world)
    if fate != GOES_ON:
        return fate
    record(world.recorder, q, Vertex.BRANCH)
    _, u_path, _, _ = uniforms(world.seed, q.id, q.event, Purpose.INTERFACE.value)
    q.free = sample_free_path(world.medium, place(q), u_path)
    return _leave(q, water, scaled(-1.0, g), world)


@inlined
def _split(q, in_water, world):
    """Return reflectance, facet normal, directions in air and water and a spare uniform."""
    g, n, u_spare = bending_normal(q, q.facet, world)
    # normals point up; the law of refraction wants them along the light
    side, n1, n2 = 1.0, world.medium.n_water, world.medium.n_air
    if not in_water:
        side, n1, n2 = -1.0, n2, n1
    rho, transmitted, reflected = branches(
        heading(q), scaled(side, n), scaled(side, g), n1, n2, world.interface
    )
    if in_water:
        return rho, g, transmitted, reflected, u_spare
    return rho, g, reflected, transmitted, u_spare


@outlined
def _leave(q, d, g, world):
    """Send a photon off a facet, along d, on the side that g points to."""
    head(q, d)
    # Started on the facet itself, a ray of single precision could meet it again.
    put(q, along(place(q), g, OFFSET))
    if q.in_water == 0:
        q.free = math.inf
    look_ahead(q, world.bodies)
    if q.crossings >= world.max_crossings or q.event >= world.max_events:
        return Fate.EVENT_LIMIT.value
    return GOES_ON


@inlined
def fly_water(q, length, world):
    """Move a photon in water: absorption, planes and apertures along the path."""
    p = along(place(q), heading(q), length)
    # other forms of absorption act at collisions
    a_path = 0.0
    if world.medium.absorption == Absorption.CONTINUOUS:
        a_path = absorption_path(world.medium, q.z, p.z, length)
    if len(world.tallies.planes) > 0 or world.apertures.any_in_water or world.tallies.grid.z < 0.0:
        _score_water(q, length, world)
    tint_way(world.tints, q.tint, q.z, p.z, length)
    put(q, p)
    q.water += length
    if a_path > 0.0:
        set_weight(q, q.weight * math.exp(-a_path), Fate.ABSORBED.value, world)


@inlined
def lowest(world):
    """Return a height below every plane, map and aperture in the water."""
    # below it a photon that sinks can score nothing more; 1 m of margin
    low = min(world.surface.low[2], world.tallies.grid.z)
    for h in world.tallies.planes:
        low = min(low, h)
    for i in range(len(world.apertures.radius)):
        low = min(low, world.apertures.center[i, 2] - world.apertures.radius[i])
    return low - 1.0


@outlined
def _score_water(q, length, world):
    """Score a path in water on planes and apertures; not inlined: rarely used."""
    tally.score_planes(q, length, world)
    if _is_scored(q, world):
        tally.score_apertures(q, True, heading(q), q.weight, length, world)
    if world.tallies.grid.z < 0.0:
        tally.score_map(q, heading(q), q.weight, length, world)


@outlined
def _score_air(q, length, world):
    """Score a path in air that does not leave for the sky; not inlined: rarely used.

    Light of a lamp in the air before it meets the sea, or light between two waves.
    """
    if _is_scored(q, world):
        tally.score_apertures(q, False, heading(q), q.weight, length, world)
        if world.tallies.grid.z > 0.0:
            tally.score_map(q, heading(q), q.weight, length, world)


@inlined
def _continue(q, u_path, world):
    """Draw the next free path after a collision; end a photon by its limits."""
    q.free = sample_free_path(world.medium, place(q), u_path) if q.in_water == 1 else math.inf
    look_ahead(q, world.bodies)
    if q.event >= world.max_events:
        return Fate.EVENT_LIMIT.value
    return roulette(q, -1.0, world)


@inlined
def _meet_sun(q, world):
    """Score the sunlight that a collision scatters into a path."""
    # water and bubbles apart: their phase functions change with the wavelength in other ways
    scattered = sources.sunlight(world.back, world.medium, place(q), heading(q), q.weight)
    for i in range(2):
        score = sources.SUN_SCORE + i
        world.tallies.score[q.id - world.first, score] += scattered[i]
        if is_tinted(world.tints) and scattered[i] > 0.0:
            n = tally.keep_arrival(world.tallies, q.id, score, scattered[i], world.tints, q.tint)
            # height and angle of the last scattering, for its factors at other wavelengths, are
            # stored in the fields of the paths
            if n >= 0:
                a, cosine = world.tallies.arrivals[n], dot(heading(q), world.back.sun)
                a.air, a.water = q.z, math.acos(min(max(cosine, -1.0), 1.0))


@inlined
def look_ahead(q, bodies):
    """End the free path of a photon at the first body in its way."""
    if bodies is not None:  # an argument: not compiled for links without bodies
        facet, distance = first_body(place(q), heading(q), bodies)
        q.body = facet if distance < q.free else -1
        q.free = min(distance, q.free)


@inlined
def _is_clear(q, d, bodies):
    """Return whether no body lies in a direction from a photon."""
    if bodies is None:  # an argument: the rest is not compiled for links without bodies
        return True
    facet, _ = first_body(place(q), d, bodies)
    return facet < 0


@inlined
def _end_path(q, world, bodies):
    """Apply what ends a free path: a body in its way, or a collision."""
    if bodies is not None:  # an argument: not compiled for links without bodies
        if q.body >= 0:
            return _meet(q, world, bodies)
    return scatter(q, world)


@outlined
def _meet(q, world, bodies):
    """Apply the reflection or absorption by the body that a photon has reached."""
    # weighted by the albedo, as by the bottom
    remaining = q.weight * bodies.albedo[bodies.body[q.body]]
    if remaining == 0.0:
        return Fate.BODY.value
    set_weight(q, remaining, Fate.BODY.value, world)
    q.event += 1
    u_cos, u_phi, u_path, _ = uniforms(world.seed, q.id, q.event, Purpose.BODY.value)
    record(world.recorder, q, Vertex.BODY)
    p, d = reflected(place(q), heading(q), q.body, u_cos, u_phi, bodies)
    put(q, p)
    head(q, d)
    q.turned += 1
    q.turned_by = tally.BODY
    return _continue(q, u_path, world)


@inlined
def scatter(q, world):
    """Apply a collision at the position of a photon."""
    q.event += 1
    if world.back.irradiance > 0.0:
        _meet_sun(q, world)
    u_kind, u_theta, u_phi, u_path = uniforms(world.seed, q.id, q.event, Purpose.COLLISION.value)
    s, weight, by_bubble = collide(world.medium, place(q), q.weight, u_kind, u_theta)
    if weight != q.weight:
        set_weight(q, weight, Fate.ABSORBED.value, world)
        if weight == 0.0:
            return Fate.ABSORBED.value
    if s >= 0.0:
        head(q, turn(heading(q), s, u_phi))
        # s = sin^2(theta / 2); the angle itself is needed at other wavelengths alone
        theta = 2.0 * math.asin(math.sqrt(s)) if is_tinted(world.tints) else 0.0
        tint_scattering(world.tints, q.tint, q.z, theta, by_bubble)
        q.turned += 1
        q.turned_by = tally.SCATTERED
        record(world.recorder, q, Vertex.SCATTER)
    return _continue(q, u_path, world)


@outlined
def bounce(q, world):
    """Apply the reflection or absorption at the bottom; not inlined: rarely used."""
    fly_water(q, (world.medium.bottom_z - q.z) / q.dz, world)
    q.z = world.medium.bottom_z
    # weighted by the albedo, no roulette: a bright bottom sends most photons back
    remaining = q.weight * world.medium.bottom_albedo
    if remaining == 0.0:
        return Fate.BOTTOM.value
    set_weight(q, remaining, Fate.BOTTOM.value, world)
    q.event += 1
    u_cos, u_phi, u_path, _ = uniforms(world.seed, q.id, q.event, Purpose.BOTTOM.value)
    head(q, sources.lambert_reflection(u_cos, u_phi))
    q.turned += 1
    q.turned_by = tally.BOTTOM
    record(world.recorder, q, Vertex.BOTTOM)
    return _continue(q, u_path, world)


_RETRIES = 3  # times that a ray which missed is cast again


@inlined
def _start(q, photon, world):
    """Start a photon at its source."""
    if sources.is_backward(world.back):
        p, d, in_water, u_path = sources.launch_back(world.back, world.seed, photon)
    else:
        p, d, source, u_path = sources.launch(world.sources, world.seed, photon)
        in_water = world.sources.in_water[source]
    put(q, p)
    head(q, d)
    reset_tint(world.tints, q.tint)
    q.weight, q.water, q.air = 1.0, 0.0, 0.0
    q.free = sample_free_path(world.medium, p, u_path) if in_water else math.inf
    q.id, q.event, q.crossings, q.facet = photon, 0, 0, -1
    q.in_water, q.retry, q.turned, q.outcome = int(in_water), 0, 0, -1
    q.turned_by = tally.DIRECT
    look_ahead(q, world.bodies)
    record(world.recorder, q, Vertex.SOURCE)


@inlined
def _inside(q, t, surface):
    """Return whether a photon is over the mesh after a distance t."""
    x, y = q.x + t * q.dx, q.y + t * q.dy
    return surface.low[0] <= x <= surface.high[0] and surface.low[1] <= y <= surface.high[1]


@inlined
def _needs_ray(q, world):
    """Return whether the next flight of a photon may meet the surface."""
    if q.in_water == 0:
        return True
    # collisions in deep water need no search for a facet
    low = world.surface.low[2]
    z_end = q.z + q.free * q.dz if q.dz != 0.0 else q.z
    # below the waves: only a path that starts among them, and not steep, may meet one
    if z_end < low:
        return q.z >= low and not steeper_than_waves(heading(q), world.surface)
    return True


@outlined
def _settle_miss(q, from_behind, world):
    """Return (fate, distance) for a ray that hit no facet from its own side.

    The photon advances by the distance, and by none if its ray is cast again; LANDED means
    that it left for the sky. A miss is right where the path ends inside the slab, leaves it
    downwards or lies outside the mesh. `from_behind`: a facet was met from its wrong side, where
    rounding put the start of the ray.
    """
    # t: where the path leaves the slab between the lowest trough and the highest crest
    t = math.inf
    low, high = world.surface.low[2], world.surface.high[2]
    # in the air a body alone ends a free path
    if not from_behind and q.in_water == 0 and q.free < math.inf and q.z + q.free * q.dz >= low:
        return GOES_ON, q.free
    if not from_behind and q.in_water == 0 and q.dz > 0.0:
        return Fate.LANDED.value, 0.0
    if q.in_water == 0:
        if q.dz < 0.0:
            t = (low - q.z) / q.dz
    # downwards out of the slab: no facet was to be met
    elif not from_behind and q.dz < 0.0 and q.z + q.free * q.dz < low:
        return GOES_ON, (low - q.z) / q.dz + 1e-9  # just below the slab
    elif not from_behind and q.free < math.inf and q.z + q.free * q.dz <= high:
        if _inside(q, q.free, world.surface):
            return GOES_ON, q.free
    elif q.dz > 0.0:
        t = (high - q.z) / q.dz
    if not from_behind and not (t < math.inf and _inside(q, t, world.surface)):
        return Fate.LEFT_DOMAIN.value, 0.0
    # single precision may slip through an edge: cast again from a point aside
    if q.retry < _RETRIES:
        world.tallies.misses[Miss.CAST_AGAIN.value] += 1
        q.retry += 1
        return GOES_ON, 0.0
    world.tallies.misses[Miss.GIVEN_UP.value] += 1
    return Fate.LEAKED.value, 0.0


@inlined
def _settle(q, world):
    """Fly to the facet ahead: crossing, collision before it, or a miss."""
    facet = q.facet
    t = math.inf
    if facet >= 0:
        g = row(world.surface.face_normals, facet)
        # single precision may find the facet that the ray leaves, or its neighbour, from behind
        if (dot(heading(q), g) > 0.0) == (q.in_water == 1):
            t = max(interface.plane_distance(place(q), heading(q), facet, world.surface), 0.0)
    if math.isinf(t):
        # no facet ahead: to the sky, out of the slab, or lost
        fate, length = _settle_miss(q, facet >= 0, world)
        if fate == Fate.LANDED.value:
            to_sky(q, heading(q), q.weight, world)
            q.weight = 0.0
        elif fate == Fate.LEFT_DOMAIN.value and q.in_water == 0 and world.apertures.any_in_air:
            # beyond the mesh the sea is met at some place that is far away
            _score_air(q, math.inf, world)
        if fate != GOES_ON or length == 0.0:
            return fate
        q.retry = 0
        if length < q.free:
            fly_water(q, length, world)
            q.free -= length
            return GOES_ON
    q.retry = 0
    length = min(t, q.free)
    if q.in_water == 1:
        fly_water(q, length, world)
    else:
        if world.apertures.any_in_air:
            _score_air(q, length, world)
        put(q, along(place(q), heading(q), length))
        q.air += length
    if q.free < t:
        return _end_path(q, world, world.bodies)
    return cross(q, world)


@inlined
def _move(q, world):
    """Advance a photon until it needs a ray (GOES_ON) or has ended."""
    while True:
        if q.retry > 0 or _needs_ray(q, world):
            low = world.surface.low[2]
            if q.in_water == 1 and q.dz > 0.0 and q.z < low:
                t = (low - q.z) / q.dz
                if not _inside(q, t, world.surface):  # rises outside the mesh
                    fly_water(q, t, world)
                    return Fate.LEFT_DOMAIN.value
            return GOES_ON
        if q.dz < 0.0 and q.z + q.free * q.dz < world.medium.bottom_z:
            fate = bounce(q, world)
        elif math.isinf(q.free):
            # descends without collision or bottom: past all planes, then only its end is left
            low = lowest(world)
            if q.z > low and q.dz < 0.0:
                fly_water(q, (low - q.z) / q.dz, world)
            return Fate.ABSORBED.value if world.medium.a > 0.0 else Fate.DEEP.value
        else:
            fly_water(q, q.free, world)
            fate = _end_path(q, world, world.bodies)
        if fate != GOES_ON:
            return fate


@entry
def follow(first, last, world):
    """Follow the photons first <= id < last to their ends.

    Array twin: the plain tracer of `tests/benchmarks`.
    """
    # Monte Carlo with absorption by weight (Prahl et al. 1989), roulette below `World.least_weight`
    q = world.photon[0]
    for photon in range(first, last):
        _start(q, photon, world)
        fate = GOES_ON
        while fate == GOES_ON:
            fate = _move(q, world)
            if fate == GOES_ON:
                q.facet = facet_ahead(q, q.in_water == 1, q.retry, world)
                fate = _settle(q, world)
        deposit(world.tallies, fate, q.weight)
        world.tallies.n_photons[q.outcome if q.outcome >= 0 else fate] += 1
        record(world.recorder, q, Vertex.END)
