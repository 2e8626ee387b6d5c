"""Next-event estimation through the surface: photons in the water joined to ends in the air.

With random slopes a photon is joined in two ways. The crossing P ahead of it follows from its
direction d, and the slope that refracts it to a point x of the aperture is unique: the score is

    W exp(-tau) |A| p(s*) |ds*/dx| T E / C,

tau the optical depth up to P, p the density of the random slopes, T the transmittance, E the
exposure of the facet and C the chance of this connection. At a collision a crossing is drawn about
that of still water, too; the direction to it and the slope follow. Either way may bring any light;
both together count once by the balance heuristic [1]_. Joining to an end in the air has no 1 / r^2
singularity. Without random slopes a collision is joined by all crossings that refract its light to
x: the one of still water, or those of smooth waves (`meshtrace.engine.crossing.manifold`).

References
----------
.. [1] E. Veach and L. J. Guibas, "Optimally combining sampling techniques for Monte Carlo
   rendering", SIGGRAPH (1995), doi:10.1145/218380.218498.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh.grid import Grid, facet_over
from meshtrace.engine.chains.blurred import slope_towards
from meshtrace.engine.chains.gain import acceptance, forwards, transmittance
from meshtrace.engine.crossing.aiming import Shot, jacobian, land
from meshtrace.engine.crossing.manifold import Drawn, Manifold, crossings_between
from meshtrace.engine.photons.state import head, heading, place
from meshtrace.kernels.facets import (
    Surface,
    drawn_tilt,
    exposure,
    is_rough,
    normal_at,
    normal_on,
    plane_distance,
    tilted,
)
from meshtrace.kernels.interface import Interface
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import Medium, depth_between, scattering_coefficients
from meshtrace.kernels.phase import AngleTable, phase_at, sample_s
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.rays import Bvh, first_facet
from meshtrace.kernels.scene import (
    FLAT_SEA,
    Emitter,
    Locator,
    Scene,
    Target,
    height_on,
    locate,
)
from meshtrace.kernels.sources import SourceKind, Sources
from meshtrace.kernels.vectors import (
    ORIGIN,
    TWO_PI,
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
    turn,
)

PHOTON = np.dtype(
    [
        ("x", float),  # position [m]
        ("y", float),
        ("z", float),
        ("dx", float),  # direction
        ("dy", float),
        ("dz", float),
        ("weight", float),
        ("free", float),  # way to the next collision [m]
        ("water", float),  # path in the water [m]
        ("id", np.int64),
        ("event", np.int64),
        ("order", np.int64),  # scatterings and reflections by the bottom
        ("reflections", np.int64),  # by the surface
        ("level", float),  # of the surface above its last event [m]
        ("bend", float),  # of its direction, see `bend_ahead`
        ("density", float),  # of its direction [sr-1], 0 without a connection at its last event
        ("importance", float),  # of the start
        ("u", float),  # numbers of the point of each aperture that its collisions are joined to
        ("v", float),
        ("copies", np.int64),  # that wait
        ("is_guided", np.int64),  # whether copies take directions to the targets
        ("aimed", np.int64),  # a copy's direction: 0 by the phase function, 1 ... by target
    ]
)
"""A joined photon under way."""

TARGET = np.dtype(
    [
        ("center", float, (3,)),
        ("axis", float, (3,)),
        ("e1", float, (3,)),
        ("e2", float, (3,)),
        ("area", float),
        ("radius", float),
        ("cos_half_fov", float),
        ("tan_half_fov", float),
        ("reach", float),
        ("sin_widest", float),
        ("is_lamp", bool),
        ("lamp_axis", float, (3,)),
        ("lamp_kind", np.int64),
        ("lamp_spread", float),
        ("lamp_norm", float),
        ("share", float),  # factor on its scores
        ("first", np.int64),  # crossing from which on light is scored; 2: reflected first
        ("sloped", float),  # share of the points that drawn slopes land on, instead of even ones
        ("seen", float, (3,)),  # point of still water that it sees, and its surroundings [m]
    ]
)
"""An end that photons are joined to, see `meshtrace.kernels.scene.Target`."""


class Window(NamedTuple):
    """Weight window: importance of a place, and the bounds of weight times importance."""

    diffuse: bool  # the flux of diffuse light, else the attenuated view
    kappa: float  # attenuation of either [m-1]
    length: float  # transport mean free path [m]
    beyond: float  # extrapolated boundary [m]
    highest: float  # weight times importance, over that of the start, from which photons split
    bent: float  # fall of the importance with the bend of the light at the crossing


class Joins(NamedTuple):
    """Ends that photons are joined to."""

    target: NDArray[np.void]  # (n,) TARGET
    first: int  # least of the targets' first crossings that are scored
    direct: bool  # score unscattered light, too
    water: AngleTable
    bubble: AngleTable
    locator: Locator  # of a mesh that is no grid
    facets: NDArray[np.void]  # FACET; none but for smooth waves
    spread: float  # standard deviation of the law of slopes
    decay: float  # of the chance of a connection with the depth [m-1]
    b: float  # mean rate of collisions [m-1]
    often: float  # rate of collisions, over that of light
    start: float  # factor on the next shares for the directions in which photons start
    lobe: float  # share of directions drawn about the ways to the targets
    cone: float  # share of those drawn even over the cones to what they see
    window: Window


DIRECT, SCATTERED, REFLECTED = range(3)
N_PARTS = 3
"""Parts of the light at a target: without an event in the water, scattered, and reflected first."""

_WIDE, _WIDE_SHARE = 3.0, 0.15  # second part of the law of crossings
_LEAST_WIDTH = 0.02  # of that law, over the depth of the collision
_LEAST_DEPTH = 1e-3  # [m], of a collision below the surface
_NEAR = 3.0  # troughs below which depths are those below still water
_HAIR = 1e-4
_LEAST_ANGLE = 1e-8  # [rad]

_LOWEST = 0.3  # weight times importance, over that of the start
_LEAST_CHANCE = 0.1
_MOST_COPIES = 10
_AHEAD = 4.0  # connections ahead for one that analog photons would have
_LEAST_BENT = 0.01  # of their chance, where no slope bends the light to a target
_MOST_BEND = 100.0
_BENT = 0.1  # of the square of such a slope over its variance
_SPARE = 16  # places for copies at which none is aimed any more


class World(NamedTuple):
    """Everything that the joined photons of a block share."""

    first: int  # id of the first photon
    seed: np.uint64
    sources: Sources
    surface: Surface
    grid: Grid
    medium: Medium
    interface: Interface
    joins: Joins
    manifold: Manifold | None  # for smooth waves
    events: int  # after which a photon is ended
    bvh: Bvh
    photon: NDArray[np.void]  # PHOTON: the one under way, and copies of it that wait
    score: NDArray[np.float64]  # (photons, targets, `N_PARTS`)
    order: NDArray[np.float64]  # (targets, scatterings) of light not reflected first
    arrivals: NDArray[np.void]  # (capacity,) ARRIVAL
    n_arrivals: NDArray[np.int64]  # (1,) also those without room


@inlined
def _vector(a):
    return Vec3(a[0], a[1], a[2])


@inlined
def _scene(i, world):
    """Return the surface with target i; nothing is read of its emitter."""
    t = world.joins.target[i]
    kind, spread = t.lamp_kind, t.lamp_spread
    center, axis = _vector(t.center), _vector(t.axis)
    lamp = Emitter(
        center, _vector(t.lamp_axis), kind, spread, t.lamp_norm, 1.0, 0.0, ORIGIN, ORIGIN
    )
    target = Target(
        center, axis, _vector(t.e1), _vector(t.e2), t.area, t.radius, t.cos_half_fov,
        t.tan_half_fov, t.reach, t.sin_widest, t.is_lamp, lamp,
    )  # fmt: skip
    joins, surface = world.joins, world.surface
    bins, facets = joins.locator, joins.facets
    return Scene(lamp, target, surface, bins, facets, world.medium, world.interface, False)


@inlined
def _goal(target, u, v):
    """Return a point of the aperture from two uniforms."""
    r = target.radius * math.sqrt(u)
    c, s = on_circle(v)
    return Vec2(r * c, r * s)


@inlined
def facet_below(x, y, world):
    """Return the facet over (x, y), -1 beside the mesh."""
    if len(world.grid.x.line) > 0:
        return facet_over(world.grid, x, y)
    return locate(world.joins.locator, world.surface, x, y)


@inlined
def level_over(p, world):
    """Return the height of the surface over a point near it, and of still water over others."""
    if p.z < _NEAR * world.surface.low[2] or world.surface.low[2] == world.surface.high[2]:
        return world.surface.level
    facet = facet_below(p.x, p.y, world)
    return height_on(p.x, p.y, facet, world.surface) if facet >= 0 else world.surface.level


class Still(NamedTuple):
    """Crossing of still water on the way to a point, and its displacement by slopes."""

    x: float
    y: float
    ux: float  # direction of the way
    uy: float
    along: float  # displacement by a slope along the way [m]
    across: float
    depth: float


@outlined
def still_crossing(p, goal, level, scene):
    """Return the `Still` crossing from p to a point of the aperture, at the height of the sea.

    Array twin: `aiming.newton` on the flat sea.
    Fermat's principle: n sin(theta_w) = sin(theta_a), by Newton in the distance; the levers are
    the inverse second derivatives of the optical path.
    """
    t = scene.target
    n = scene.medium.n_water / scene.medium.n_air
    at = along(along(t.center, t.e1, goal.x), t.e2, goal.y)
    h, z = max(at.z - level, _LEAST_DEPTH), max(level - p.z, _LEAST_DEPTH)
    gx, gy = at.x - p.x, at.y - p.y
    r = math.sqrt(gx * gx + gy * gy)
    u = r * z / (z + n * h)
    low, high = 0.0, r
    for _ in range(20):
        q = r - u
        a, b = math.sqrt(u * u + z * z), math.sqrt(q * q + h * h)
        g = n * u / a - q / b
        if g > 0.0:
            high = u
        else:
            low = u
        step = g / (n * z * z / (a * a * a) + h * h / (b * b * b))
        u -= step
        if not low <= u <= high:
            u = 0.5 * (low + high)
        if abs(step) < 1e-9 * (1e-3 + r):
            break
    q = r - u
    a, b = math.sqrt(u * u + z * z), math.sqrt(q * q + h * h)
    cos_w, cos_a = z / a, h / b
    ux, uy = (gx / r, gy / r) if r > 1e-9 else (1.0, 0.0)
    bend = n * cos_w - cos_a
    lever = bend / (n * cos_w * cos_w / a + cos_a * cos_a / b)
    return Still(p.x + u * ux, p.y + u * uy, ux, uy, lever, bend / (n / a + 1.0 / b), z)


@inlined
def _widths(still, joins):
    """Return the standard deviations of the law of crossings along and across the way [m]."""
    least = _LEAST_WIDTH * still.depth
    return joins.spread * still.along + least, joins.spread * still.across + least


@inlined
def _crossing_density(x, y, still, joins):
    """Return the density of the crossings drawn about that of still water [m-2]."""
    sa, sc = _widths(still, joins)
    dx, dy = x - still.x, y - still.y
    p = (dx * still.ux + dy * still.uy) / sa
    q = (dy * still.ux - dx * still.uy) / sc
    e, wide = p * p + q * q, _WIDE * _WIDE
    law = (1.0 - _WIDE_SHARE) * math.exp(-0.5 * e) + _WIDE_SHARE / wide * math.exp(-0.5 * e / wide)
    return law / (TWO_PI * sa * sc)


@inlined
def _chance(depth, joins):
    """Return the chance of a connection of a collision: deep ones bring exp(-c depth)."""
    return min(1.0, 1.5 * math.exp(-joins.decay * depth))


@inlined
def _angle(d, w):
    """Return the angle between two directions [rad], at least `_LEAST_ANGLE`.

    By the chord: the cosine of small angles is rounded to 1, and the phase function of water has a
    pole there. Ways to a point of an aperture agree within the least angle along a way.
    """
    chord = 0.5 * norm(minus(d, w))
    return max(2.0 * math.asin(min(chord, 1.0)), _LEAST_ANGLE)


@inlined
def mixed_phase(d, w, p, world):
    """Return the phase function of water and bubbles at a point, from d to w [sr-1]."""
    theta = _angle(d, w)
    b, bubbles = scattering_coefficients(world.medium, p)
    density = phase_at(world.joins.water, theta)
    if bubbles > 0.0:
        density = (b * density + bubbles * phase_at(world.joins.bubble, theta)) / (b + bubbles)
    return density


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
    return plane_distance(p, d, found, world.surface) > length - 2.0 * hair


class Light(NamedTuple):
    """Light of a unit photon through a crossing to a point of the aperture."""

    density: float  # of landing points [m-2]
    share: float  # transmittance, exposure and acceptance
    flight: float  # through the air [m]


@outlined
def _through(p, n, g, d, goal, facet, scene, world):
    """Return the `Light` along d through P by its random slope."""
    dark = Light(0.0, 0.0, 0.0)
    s = slope_towards(p, n, d, d, 0.0, goal, scene)
    if s.density <= 0.0 or dot(d, g) <= 0.0:
        return dark
    share = acceptance(s.aim, p, scene.target, world.interface.fov)
    if share <= 0.0:
        return dark
    share *= transmittance(s.aim, world.interface)
    if scene.target.is_lamp:
        share *= forwards(s.aim, p, facet, s.tilt, world.surface)
    else:
        share *= exposure(d, n, s.tilt)
    if share > 0.0 and world.interface.follow_second_hit:
        if not _is_clear(p, s.aim.r, s.aim.flight, facet, world):
            return dark
    return Light(s.density, share, s.aim.flight)


@outlined
def _landing(p, n, d, u, v, scene, world):
    """Return (found, goal): where a drawn slope lands the light on the aperture."""
    tilt = drawn_tilt(world.surface.roughness, u, v)
    m = land(p, tilted(n, tilt), Shot(minus(p, d), ORIGIN, UP, Vec2(0.0, 0.0), 1.0, tilt), scene)
    r = scene.target.radius
    return m.ok and m.at.x * m.at.x + m.at.y * m.at.y < r * r, m.at


@inlined
def _point_density(i, light, world):
    """Return the density of the points of target i that are drawn at a crossing [m-2]."""
    t = world.joins.target[i]
    return (1.0 - t.sloped) / t.area + t.sloped * light.density


@inlined
def _score(q, i, light, water, air, world):
    """Score light of a photon on target i."""
    light *= world.joins.target[i].share
    part = SCATTERED if q.order > 0 else DIRECT
    if q.reflections > 0:
        part = REFLECTED
    else:
        world.order[i, min(q.order, world.order.shape[1] - 1)] += light
    world.score[q.id - world.first, i, part] += light
    n = world.n_arrivals[0]
    world.n_arrivals[0] = n + 1
    if n < len(world.arrivals):
        a = world.arrivals[n]
        a.photon, a.receiver, a.weight, a.water, a.air = q.id, i, light, water, air


@outlined
def bend_ahead(p, d, level, world):
    """Return the squared slope that bends a straight path to a target, over its variance.

    Array twin: `slope_towards` on still water.
    The least of all targets, `_MOST_BEND` at most, and for a path that leads down.
    """
    joins, medium, bend = world.joins, world.medium, _MOST_BEND
    if d.z <= 0.0:
        return bend
    way = max(level - p.z, 0.0) / d.z
    at = Vec3(p.x + way * d.x, p.y + way * d.y, level)
    for i in range(len(joins.target)):
        t = joins.target[i]
        to = minus(_vector(t.center), at)
        flight = norm(to)
        big = along(scaled(medium.n_water, d), to, -medium.n_air / flight)
        if big.z > 0.0:
            soft = medium.n_air * t.radius / flight
            square = big.x * big.x + big.y * big.y
            bend = min(bend, square / ((joins.spread * big.z) ** 2 + soft * soft))
    return bend


@inlined
def chance_ahead(p, d, level, bend, joins):
    """Return the chance of a connection at the crossing ahead.

    Array twin: none, connections are unbiased for any chance.
    It falls with the light that arrives there, and with the slopes that bend it to the targets.
    """
    if d.z <= 0.0:
        return 1.0
    way = max(level - p.z, 0.0) / d.z
    bent = max(1.0 / (1.0 + (_BENT * bend) ** 2), _LEAST_BENT)
    return min(1.0, _AHEAD * bent * math.exp(-joins.b * way))


@outlined
def join_crossing(q, facet, length, chance, world):
    """Join a photon that meets a facet from below at a distance to every target.

    Array twin: the analog photon, whose slope is drawn.
    """
    joins, start, d = world.joins, place(q), heading(q)
    p = along(start, d, length)
    g = row(world.surface.face_normals, facet)
    n = normal_on(p, facet, world.surface)
    u, v, lot, _ = uniforms(world.seed, q.id, q.event, Purpose.APERTURE.value)
    weight = q.weight * math.exp(-depth_between(world.medium, start, p, length))
    for i in range(len(joins.target)):
        if q.reflections + 1 < joins.target[i].first:
            continue
        scene = _scene(i, world)
        found, goal = True, _goal(scene.target, u, v)
        if lot < joins.target[i].sloped:
            found, goal = _landing(p, n, d, u, v, scene, world)
        if not found:
            continue
        light = _through(p, n, g, d, goal, facet, scene, world)
        if light.share <= 0.0:
            continue
        own, other = chance * _point_density(i, light, world), 0.0
        if q.density > 0.0:
            still = still_crossing(start, goal, q.level, scene)
            other = _chance(still.depth, joins) * _crossing_density(p.x, p.y, still, joins)
            other *= length * length * g.z / (dot(d, g) * scene.target.area * q.density)
        score = weight * light.density * light.share / (own + other)
        _score(q, i, score, q.water + length, light.flight, world)


@outlined
def join_collision(q, at_bottom, world):
    """Join a photon that is scattered, or reflected by the bottom, to every target.

    Array twin: `join_crossing` of the photon that goes on.
    """
    joins = world.joins
    q.order += 1
    q.is_guided = 1 if q.copies + _SPARE < len(world.photon) else 0
    start, q.density = place(q), 0.0
    q.level = level = level_over(start, world)
    if q.reflections + 1 < joins.first:
        return
    chance = _chance(max(level - start.z, _LEAST_DEPTH), joins)
    q.density = 1.0  # until the direction is known
    lot, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.JOIN.value)
    if lot >= chance:
        return
    s, t, wide, _ = uniforms(world.seed, q.id, q.event, Purpose.JOIN_SLOPE.value)
    r = math.sqrt(-2.0 * math.log(s))
    if wide < _WIDE_SHARE:
        r *= _WIDE
    c, s = on_circle(t)
    rough = is_rough(world.surface.roughness)
    for i in range(len(joins.target)):
        if q.reflections + 1 < joins.target[i].first:
            continue
        scene = _scene(i, world)
        goal = _goal(scene.target, q.u, q.v)
        still = still_crossing(start, goal, level, scene)
        if rough:
            sa, sc = _widths(still, joins)
            a, b = r * c * sa, r * s * sc
            x, y = still.x + a * still.ux - b * still.uy, still.y + a * still.uy + b * still.ux
            p = Vec2(x, y)
            light, length, flight = _by_slope(
                p, q, i, goal, still, chance, at_bottom, scene, world, world.manifold
            )
            if light > 0.0:
                _score(q, i, q.weight * light, q.water + length, flight, world)
        else:
            _join_bent(q, i, goal, still, chance, at_bottom, scene, world, world.manifold)


@inlined
def _scattered(w, d, start, at_bottom, world):
    """Return the density of directions [sr-1] behind an event."""
    if at_bottom:
        return max(w.z, 0.0) / math.pi
    return mixed_phase(d, w, start, world)


@outlined
def _by_slope(at, q, i, goal, still, chance, at_bottom, scene, world, manifold):
    """Return (light, way in the water, flight) of a crossing over (x, y), see `join_collision`."""
    if manifold is not None:
        return 0.0, 0.0, 0.0
    joins, start, d = world.joins, place(q), heading(q)
    x, y = at.x, at.y
    facet = facet_below(x, y, world)
    if facet < 0:
        return 0.0, 0.0, 0.0
    p = Vec3(x, y, height_on(x, y, facet, world.surface))
    g = row(world.surface.face_normals, facet)
    way = minus(p, start)
    length = norm(way)
    w = scaled(1.0 / length, way)
    facing = dot(w, g)
    if facing <= 0.0:
        return 0.0, 0.0, 0.0
    n = normal_at(x, y, facet, world.surface)
    light = _through(p, n, g, w, goal, facet, scene, world)
    if light.share <= 0.0 or not _is_clear(start, w, length, facet, world):
        return 0.0, 0.0, 0.0
    turned = _scattered(w, d, start, at_bottom, world)
    drawn = turned
    if not at_bottom:
        drawn = _drawn_density(w, turned, guide_of(q, world), q, start, world)
    own = chance * _crossing_density(x, y, still, joins) * length * length * g.z
    own /= facing * scene.target.area
    bend = bend_ahead(start, w, q.level, world)
    other = drawn * chance_ahead(start, w, q.level, bend, joins) * _point_density(i, light, world)
    turned *= math.exp(-depth_between(world.medium, start, p, length))
    return turned * light.density * light.share / (own + other), length, light.flight


@outlined
def _join_bent(q, i, goal, still, chance, at_bottom, scene, world, manifold):
    """Join an event to target i by all crossings without random slopes, see `join_collision`."""
    start = place(q)
    shot = Shot(start, ORIGIN, UP, goal, 1.0, Vec2(0.0, 0.0))
    if manifold is None:  # an argument: the other branch is not compiled
        at = Vec2(still.x, still.y)
        light, length, flight = _bent(at, FLAT_SEA, q, shot, chance, at_bottom, scene, world)
        if light > 0.0:
            _score(q, i, q.weight * light, q.water + length, flight, world)
    else:
        drawn = Drawn(world.seed, q.id, q.event, *_widths(still, world.joins))
        for k in range(crossings_between(still, shot, drawn, scene, manifold)):
            root = manifold.roots[k]
            at, facet = Vec2(root.x, root.y), np.int64(root.facet)
            light, length, flight = _bent(at, facet, q, shot, chance, at_bottom, scene, world)
            light *= root.multiplicity
            if light > 0.0:
                _score(q, i, q.weight * light, q.water + length, flight, world)


@outlined
def _bent(at, facet, q, shot, chance, at_bottom, scene, world):
    """Return (light, way in the water, flight) of a crossing that refracts light to the goal."""
    start, d = place(q), heading(q)
    j = jacobian(at.x, at.y, facet, shot, scene)
    m, spread = j.aim, abs(j.a * j.d - j.b * j.c)
    if not j.ok or spread == 0.0 or m.w.z == 0.0:
        return 0.0, 0.0, 0.0
    p = Vec3(at.x, at.y, height_on(at.x, at.y, facet, world.surface))
    light = acceptance(m, p, scene.target, world.interface.fov)
    if light <= 0.0:
        return 0.0, 0.0, 0.0
    if facet >= 0:
        g = row(world.surface.face_normals, facet)
        if dot(m.w, g) <= 0.0 or dot(m.r, g) <= 0.0:
            return 0.0, 0.0, 0.0
        if scene.target.is_lamp:
            light *= forwards(m, p, facet, shot.tilt, world.surface)
        if not _is_clear(start, m.w, m.length, facet, world):
            return 0.0, 0.0, 0.0
        if world.interface.follow_second_hit and not _is_clear(p, m.r, m.flight, facet, world):
            return 0.0, 0.0, 0.0
    solid_angle = abs(j.wa * j.wd - j.wb * j.wc) / (abs(m.w.z) * spread)
    light *= scene.target.area * solid_angle * transmittance(m, world.interface) / chance
    light *= _scattered(m.w, d, start, at_bottom, world)
    light *= math.exp(-depth_between(world.medium, start, p, m.length))
    return light, m.length, m.flight


class Guide(NamedTuple):
    """Numbers of directions that are drawn behind a collision beside that of the photon."""

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
            lobe = joins.lobe * _chance(max(q.level - start.z, _LEAST_DEPTH), joins)
        cone = joins.cone
        for i in range(len(joins.target)):
            seen = joins.target[i].seen
            x, y = seen[0] - start.x, seen[1] - start.y
            if x * x + y * y + start.z * start.z < seen[2] * seen[2]:
                cone = 0.0
    return Guide(lobe, cone)


@inlined
def _cone_to(i, p, world):
    """Return (axis, sin^2(theta / 2) of the edge) of the cone from p to what target i sees."""
    t = world.joins.target[i]
    way = Vec3(t.seen[0] - p.x, t.seen[1] - p.y, -p.z)
    distance = norm(way)
    sine = min(t.seen[2] / distance, 1.0)
    edge = 0.5 * sine * sine / (1.0 + math.sqrt(1.0 - sine * sine))
    return scaled(1.0 / distance, way), edge


@inlined
def _cone_density(d, p, world):
    """Return the density of directions even over the cones to what the targets see [sr-1]."""
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
    """Return (direction, weight) of a new photon, guided to what the targets see or not.

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
    level = level_over(p, world)
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
            drawn += lobe / n * phase_at(joins.water, _angle(way, d))
    return d, own / drawn


@outlined
def _drawn_density(d, own, guide, q, start, world):
    """Return the density of all directions drawn behind a collision [sr-1].

    `own` is the phase function, by which the photon itself goes on.
    """
    n = len(world.joins.target)
    total = own
    for i in range(n):
        if guide.lobe > 0.0:
            way = _way_to(i, start, q.level, Vec2(q.u, q.v), world)
            total += guide.lobe / n * mixed_phase(way, d, start, world)
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
    lot, u, _, _ = uniforms(world.seed, q.id, q.event, Purpose.GUIDE.value)
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
        d = turn(_way_to(aimed - 1, start, q.level, Vec2(q.u, q.v), world), s, u_phi)
    else:
        axis, edge = _cone_to(aimed - 1 - n, start, world)
        d = turn(axis, u * edge, u_phi)
    own = mixed_phase(before, d, start, world)
    q.density = own
    if guide.lobe + guide.cone > 0.0:
        q.density = _drawn_density(d, own, guide, q, start, world)
        q.weight *= own / q.density
    head(q, d)


@outlined
def _way_to(i, p, level, uv, world):
    """Return the direction from p to a point of target i through still water."""
    scene = _scene(i, world)
    still = still_crossing(p, _goal(scene.target, uv.x, uv.y), level, scene)
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
    """Return the weight times importance of a photon at p, over that of the start.

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
    return max(min(int(ratio), _MOST_COPIES, len(world.photon) - _SPARE // 2 - q.copies), 1)
