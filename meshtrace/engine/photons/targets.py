"""Joined photons and their targets: records, probabilities, and laws of drawn directions.

Targets are apertures in the air, or lamps for photons that run backwards. Some of them are guides:
directions are drawn about the straight ways to them, up to the crossing of still water. A goal is a
point of an aperture, by its coordinates along the two axes across it. Names are those of
`photons.flight`.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.engine.photons.state import UNDER_WAY, heading, place
from meshtrace.kernels import interface
from meshtrace.kernels.bodies import BodyArrays, normal_facing
from meshtrace.kernels.interface import Interface, MeshArrays
from meshtrace.kernels.jit import inlined, outlined, record_type
from meshtrace.kernels.medium import Medium, phase_at, scattering_coefficients
from meshtrace.kernels.rays import Bvh, Grid, facet_over
from meshtrace.kernels.scene import Emitter, Locator, Scene, Target, height_on, locate
from meshtrace.kernels.sources import Sources
from meshtrace.kernels.tally import BODY, SCATTERED
from meshtrace.kernels.tints import Tints, is_tinted, tint_scattering
from meshtrace.kernels.vectors import (
    TWO_PI,
    UP,
    Vec2,
    Vec3,
    along,
    dot,
    minus,
    norm,
    on_circle,
    scaled,
    write,
)

JOINED_PHOTON = record_type(
    [
        *UNDER_WAY,
        ("order", np.int64),  # scatterings, and reflections by the bottom and by bodies
        ("reflections", np.int64),  # by the surface
        ("returns", np.int64),  # by the surface, the bottom or bodies
        ("level", float),  # height of the surface above its last event [m], see `level_over`
        ("bend", float),  # squared slope that its direction needs, over its variance: `bend_ahead`
        # of its direction [sr-1], see `drawn_density`; 0: not joined; < 0: turned by a mirror body
        ("density", float),
        ("importance", float),  # of the start
        ("u", float),  # u, v: uniforms of the point of each aperture that collisions are joined to
        ("v", float),
        ("copies", np.int64),  # that wait: the index of the last one on the stack
        ("is_guided", np.int64),  # whether copies take directions to the targets
        ("law", np.int64),  # `Law` of a copy's next direction
        ("guide", np.int64),  # index into `Joins.guide` for that law
        ("chance", float),  # of the connection of its last event
        ("air", float),  # path in the air from the source to the water [m]
        ("first", float, (3,)),  # direction in which it started
        ("event_at", float, (3,)),  # place of its last event, of links on one side [m]
        ("facet", np.int64),  # that has reflected it since, -1 without one
        ("turned_by", np.int64),  # its last event: SCATTERED, BOTTOM or BODY of `kernels.tally`
        ("body", np.int64),  # facet of a body at the end of the free path, -1: none
    ]
)
"""A joined photon under way."""


class Law(IntEnum):
    """Law by which the next direction of a photon is drawn."""

    PHASE = 0  # phase function about the direction before
    LOBE = 1  # phase function about the way to a guide
    CONE = 2  # even over the cone to what a guide sees


_TYPES: Any = {float: (float,), int: (np.int64,), bool: (bool,), Vec3: (float, (3,))}


def _fields_of(kind: type) -> list[tuple[Any, ...]]:
    """Return the record fields for a NamedTuple of numbers."""
    return [(name, *_TYPES[item]) for name, item in get_type_hints(kind).items() if item in _TYPES]


TARGET = record_type(
    [
        *_fields_of(Target),
        ("lamp", _fields_of(Emitter)),
        ("share", float),  # factor on its scores
        ("first", np.int64),  # 1: scores all light; 2: that which surface or bottom reflect first
        ("sloped", float),  # share of the points that drawn slopes land on, instead of even ones
        ("mirror", np.int64),  # 1: a guide by the mirror of still water to a receiver in the water
        # what it sees: centre (x, y, z) and radius of a disk of still water, or of a sphere about a
        # receiver on the side of the lamp [m]
        ("seen", float, (4,)),
    ]
)
"""An end that photons are joined to, see `meshtrace.kernels.scene.Target`."""


class Window(NamedTuple):
    """Weight window: importance of a place, and the bounds of weight times importance."""

    diffuse: bool  # the flux of diffuse light, else the attenuated view
    kappa: float  # attenuation of either [m-1]
    length: float  # transport mean free path [m]
    beyond: float  # height of the extrapolated boundary above still water [m]
    highest: float  # weight times importance, over that of the start, from which photons split
    bent: float  # fall of the importance with the bend of the light at the crossing


class Joins(NamedTuple):
    """Ends that photons are joined to."""

    target: NDArray[np.void]  # (n,) TARGET
    guide: NDArray[np.void]  # (m,) TARGET, those to which directions are guided: all, or some
    first: int  # least of the targets' `first`
    direct: bool  # score unscattered light, too
    water: NDArray[np.float64]  # phase function of the water [sr-1], see `phase_at`
    bubble: NDArray[np.float64]  # and of the bubbles
    locator: Locator  # of a mesh that is no grid
    facets: NDArray[np.void]  # FACET; none but for smooth waves
    spread: float  # standard deviation of the slopes by which crossings are drawn
    decay: float  # of the chance of a connection with the depth [m-1]
    b: float  # mean rate of the collisions that are drawn [m-1]
    often: float  # rate of collisions, over that of light
    start_lobe: float  # shares of the directions in which photons start, as the next two
    start_cone: float
    lobe: float  # directions drawn about the ways to the guides, per collision
    cone: float  # those drawn even over the cones to what they see
    window: Window


# Law of crossings, a mixture of two Gaussians: width of the second over that of the first, and its
# share. Tails of slopes are heavier than those of one Gaussian.
WIDE, WIDE_SHARE = 3.0, 0.15
# added to the widths of that law, over the depth of the collision: flat water has a width, too
_LEAST_WIDTH = 0.02
LEAST_DEPTH = 1e-3  # [m], of a collision below the surface: levers divide by it
_NEAR = 3.0  # tuned: depths of the lowest trough, below which the waves above are ignored
_LEAST_ANGLE = 1e-8  # [rad], see `angle_between`
_AHEAD = 4.0  # tuned: chance of a connection ahead over that of flight without a collision
# least factor on that chance, where hardly a slope bends the light to a target: 0 would be a bias
_LEAST_BENT = 0.01
_MOST_BEND = 100.0  # squared slope over its variance: none of ten standard deviations occurs
_BENT = 0.1  # tuned: fall of that chance with the squared slope over its variance
# room on the stack, below which directions are not guided any more: the copies that splitting
# makes come first
SPARE = 16


class JoinedWorld(NamedTuple):
    """Everything that the joined photons of a block share."""

    seed: np.uint64
    sources: Sources
    surface: MeshArrays
    grid: Grid
    medium: Medium
    interface: Interface
    joins: Joins
    search: crossing.Search | None  # of crossings of smooth waves, without the reach of a target
    flat: NDArray[np.void]  # (1,) FLAT, scratch for the crossing of still water
    roots: NDArray[np.void]  # ROOT, scratch for those of waves
    bodies: BodyArrays | None  # None: kernels of links without bodies compile nothing of them
    # lamps and receivers lie under the surface, or over it (False); None: on two sides, so that
    # kernels compile nothing of ways that stay on one
    under: bool | None
    tints: Tints | None
    bvh: Bvh
    photon: NDArray[np.void]  # JOINED_PHOTON: the one under way, and copies of it that wait
    arrivals: NDArray[np.void]  # (capacity,) ARRIVAL
    n_arrivals: NDArray[np.int64]  # (1,) also those without room


@inlined
def vector_of(a):
    """Return the components of an array of three."""
    return Vec3(a[0], a[1], a[2])


@inlined
def scene_to(t, world):
    """Return the `Scene` of a target record; nothing is read of its emitter."""
    # records have no nested tuples: the emitter and the target are put together again; what photons
    # never read of them is 0
    pattern, center, axis = t.lamp, vector_of(t.center), vector_of(t.axis)
    lamp = Emitter(
        center, vector_of(pattern.axis), pattern.kind, pattern.spread, pattern.norm, 1.0, 0.0,
        vector_of(pattern.e1), vector_of(pattern.e2), pattern.table,
    )  # fmt: skip
    target = Target(
        center, axis, vector_of(t.e1), vector_of(t.e2), t.area, t.radius, t.cos_half_fov,
        t.tan_half_fov, t.reach, t.sin_widest, t.is_lamp, lamp,
    )  # fmt: skip
    joins, surface = world.joins, world.surface
    bins, facets = joins.locator, joins.facets
    return Scene(
        lamp, target, surface, bins, facets, world.medium, world.interface, False,
        is_mirrored(world.under), None,
    )  # fmt: skip


@inlined
def is_mirrored(under):
    """Return whether light reaches the targets by reflection at the surface."""
    return under is not None and under


@inlined
def goal_on(target, u, v):
    """Return a point of the aperture from two uniforms."""
    # even over the disk: P(r < R x) = x^2, inverted
    r = target.radius * math.sqrt(u)
    c, s = on_circle(v)
    return Vec2(r * c, r * s)


@inlined
def point_of(goal, target):
    """Return a point of the aperture in space from its coordinates along the axes of the disk."""
    return along(along(target.center, target.e1, goal.x), target.e2, goal.y)


@inlined
def facet_below(x, y, world):
    """Return the facet at (x, y), -1 off the mesh."""
    if len(world.grid.x.line) > 0:
        return facet_over(world.grid, x, y)
    return locate(world.joins.locator, world.surface, x, y)


@inlined
def level_over(p, world):
    """Return the height of the surface over a point near it, that of still water over others."""
    # far below, the height of one wave matters less than the time to find it
    if p.z < _NEAR * world.surface.low[2] or world.surface.low[2] == world.surface.high[2]:
        return world.surface.level
    facet = facet_below(p.x, p.y, world)
    return height_on(p.x, p.y, facet, world.surface) if facet >= 0 else world.surface.level


class Still(NamedTuple):
    """Flat-sea crossing of the path to a point, and its displacement by slopes."""

    x: float
    y: float
    ux: float  # horizontal unit vector from the start to the point
    uy: float
    along: float  # displacement by unit slope, along (ux, uy) [m]
    across: float  # across it [m]
    depth: float  # of the start below the surface [m]


@outlined
def still_crossing(p, goal, level, scene):
    """Return the `Still` crossing from p to a point of the aperture, at the height of the sea.

    Array twin: `crossing.newton` on the flat sea.
    Fermat's principle: n sin(theta_w) = sin(theta_a), by Newton in the distance; the levers are
    the inverse second derivatives of the optical path.
    """
    t = scene.target
    n = scene.medium.n_water / scene.medium.n_air
    at = point_of(goal, t)
    height, z = max(at.z - level, LEAST_DEPTH), max(level - p.z, LEAST_DEPTH)
    if scene.reflects:
        # to the image of the point above the surface, as if the water went on there
        n, height = 1.0, max(level - at.z, LEAST_DEPTH)
    gx, gy = at.x - p.x, at.y - p.y
    r = math.sqrt(gx * gx + gy * gy)
    # u: horizontal distance of the crossing from p, from Snell's law for small angles,
    # n u / z = (r - u) / height, on
    u = r * z / (z + n * height)
    low, high = 0.0, r
    for _ in range(20):
        beyond = r - u
        a, b = math.sqrt(u * u + z * z), math.sqrt(beyond * beyond + height * height)
        # derivative of the optical path n a + b, which rises with u: the bracket always holds its
        # one root
        gradient = n * u / a - beyond / b
        if gradient > 0.0:
            high = u
        else:
            low = u
        # Newton's step by the second derivative, which is positive: the path is convex in u
        step = gradient / (n * z * z / (a * a * a) + height * height / (b * b * b))
        u -= step
        # bisection where Newton leaves the bracket, as for grazing light
        if not low <= u <= high:
            u = 0.5 * (low + high)
        if abs(step) < 1e-9 * (1e-3 + r):
            break
    beyond = r - u
    a, b = math.sqrt(u * u + z * z), math.sqrt(beyond * beyond + height * height)
    cos_w, cos_a = z / a, height / b
    # straight above the start any direction is along the way
    ux, uy = (gx / r, gy / r) if r > 1e-9 else (1.0, 0.0)
    # vertical component of n d_w - d_a: change of the optical path per height of the crossing
    bend = n * cos_w + cos_a if scene.reflects else n * cos_w - cos_a
    # A slope ds adds bend ds to the gradient of the path: dP = bend / (second derivative) ds.
    lever = bend / (n * cos_w * cos_w / a + cos_a * cos_a / b)
    return Still(p.x + u * ux, p.y + u * uy, ux, uy, lever, bend / (n / a + 1.0 / b), z)


@inlined
def widths_of(still, joins):
    """Return the standard deviations of the crossings drawn, along and across the path [m]."""
    least = _LEAST_WIDTH * still.depth
    return Vec2(joins.spread * still.along + least, joins.spread * still.across + least)


@inlined
def offset_crossing(still, r, u, joins):
    """Offset a flat-sea crossing by r standard deviations at azimuth 2 pi u."""
    widths = widths_of(still, joins)
    c, s = on_circle(u)
    a, b = r * c * widths.x, r * s * widths.y
    return Vec2(still.x + a * still.ux - b * still.uy, still.y + a * still.uy + b * still.ux)


@inlined
def crossing_density(x, y, still, joins):
    """Return the density of the crossings drawn about the flat-sea crossing [m-2]."""
    width_along, width_across = widths_of(still, joins)
    # a, c: offset along and across the way, in standard deviations
    dx, dy = x - still.x, y - still.y
    a = (dx * still.ux + dy * still.uy) / width_along
    c = (dy * still.ux - dx * still.uy) / width_across
    r2, wide = a * a + c * c, WIDE * WIDE
    # Defensive mixture (Hesterberg 1995) with the wider Gaussian: weights stay bounded.
    law = (1.0 - WIDE_SHARE) * math.exp(-0.5 * r2) + WIDE_SHARE / wide * math.exp(-0.5 * r2 / wide)
    return law / (TWO_PI * width_along * width_across)


@inlined
def collision_chance(depth, joins):
    """Return the chance that a collision at a depth [m] is joined."""
    # Deep ones bring exp(-c depth) only. 1.5: those above the depth 0.4 / decay, ln 1.5 = 0.4, are
    # always joined.
    return min(1.0, 1.5 * math.exp(-joins.decay * depth))


@inlined
def angle_between(d, w):
    """Return the angle between two directions [rad], at least `_LEAST_ANGLE`.

    By the chord: the cosine of small angles is rounded to 1, and the phase function of water has a
    pole there. Ways to a point of an aperture agree within the least angle along a way.
    """
    # |d - w| = 2 sin(theta / 2)
    chord = 0.5 * norm(minus(d, w))
    return max(2.0 * math.asin(min(chord, 1.0)), _LEAST_ANGLE)


@inlined
def mixed_phase(d, w, p, world):
    """Return the phase function of water and bubbles at a point, from d to w [sr-1]."""
    theta = angle_between(d, w)
    b, bubbles = scattering_coefficients(world.medium, p)
    density = phase_at(world.joins.water, theta)
    if bubbles > 0.0:
        density = (b * density + bubbles * phase_at(world.joins.bubble, theta)) / (b + bubbles)
    return density


@inlined
def note_event(q, under):
    """Record the place of an event of a photon, from which a mirrored way starts."""
    if under is not None:
        write(q.event_at, place(q))
        q.facet = -1


@inlined
def _wall_normal(q, bodies):
    """Return the normal of the bottom or body that a photon has met, on its side."""
    if bodies is not None:  # an argument: not compiled for links without bodies
        if q.turned_by == BODY:
            return normal_facing(heading(q), q.body, bodies)
    return UP


@inlined
def after_event(w, q, world):
    """Return the density of directions [sr-1] along w after an event, and the scattering angle.

    The angle [rad] is -1 at the bottom or a body, 0 where no other wavelengths need it.
    """
    start, d = place(q), heading(q)
    if q.turned_by != SCATTERED:
        # Lambert's law
        return max(dot(w, _wall_normal(q, world.bodies)), 0.0) / math.pi, -1.0
    theta = angle_between(d, w) if is_tinted(world.tints) else 0.0
    return mixed_phase(d, w, start, world), theta


@inlined
def tint_mixed(log_weights, theta, u, p, world):
    """Add a scattering by an angle to the sums of a path, see `meshtrace.kernels.tints`.

    Array twin: direct runs of the wavelengths.
    Water and bubbles scatter as a mixture: u draws which of them it was, since only then are the
    factors at other wavelengths products along the path.
    """
    if is_tinted(world.tints):
        b, bubbles = scattering_coefficients(world.medium, p)
        by_bubble = False
        if bubbles > 0.0:
            water = b * phase_at(world.joins.water, theta)
            by_bubble = u * (water + bubbles * phase_at(world.joins.bubble, theta)) >= water
        tint_scattering(world.tints, log_weights, p.z, theta, by_bubble)


@outlined
def bend_ahead(p, d, level, world):
    """Return the squared slope that bends a straight path to a target, over its variance.

    Array twin: `slope_towards` on still water.
    The least of all guides and at most `_MOST_BEND`, which stands for a path that leads down, too.
    """
    joins, bend = world.joins, _MOST_BEND
    if d.z <= 0.0:
        return bend
    n_before, n_behind = world.medium.n_water, world.medium.n_air
    if is_mirrored(world.under):
        n_before, n_behind = 1.0, 1.0
    way = max(level - p.z, 0.0) / d.z
    at = Vec3(p.x + way * d.x, p.y + way * d.y, level)
    for i in range(len(joins.guide)):
        t = joins.guide[i]
        to = minus(vector_of(t.center), at)
        flight = norm(to)
        # normal that refracts or reflects d to the target, and its slope: (x, y) / z
        normal = along(scaled(n_before, d), to, -n_behind / flight)
        if normal.z > 0.0:
            # the aperture itself accepts a range of slopes
            soft = n_behind * t.radius / flight
            square = normal.x * normal.x + normal.y * normal.y
            bend = min(bend, square / ((joins.spread * normal.z) ** 2 + soft * soft))
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


@inlined
def guided_directions(q, world):
    """Return the expected numbers of directions drawn by `Law.LOBE` and `Law.CONE` at a collision.

    Array twin: none.
    """
    joins, start = world.joins, place(q)
    lobe = cone = 0.0
    if q.is_guided == 1:
        if joins.lobe > 0.0:
            lobe = joins.lobe * collision_chance(max(q.level - start.z, LEAST_DEPTH), joins)
        cone = joins.cone
        for i in range(len(joins.guide)):
            seen = joins.guide[i].seen
            x, y, z = seen[0] - start.x, seen[1] - start.y, seen[2] - start.z
            # from inside the view the cone would be the whole sphere
            if x * x + y * y + z * z < seen[3] * seen[3]:
                cone = 0.0
    return lobe, cone


@inlined
def cone_to(i, p, world):
    """Return axis and edge, sin^2(half-angle / 2), of the cone from p to the view of guide i."""
    t = world.joins.guide[i]
    way = Vec3(t.seen[0] - p.x, t.seen[1] - p.y, t.seen[2] - p.z)
    distance = norm(way)
    # a disk of still water, as a sphere of its radius: the cone covers it from any side
    sine = min(t.seen[3] / distance, 1.0)
    # (1 - cos) / 2 without cancellation for narrow cones
    edge = 0.5 * sine * sine / (1.0 + math.sqrt(1.0 - sine * sine))
    return scaled(1.0 / distance, way), edge


@inlined
def cone_density(d, p, world):
    """Return the density at d of directions uniform over the cones to the views [sr-1]."""
    n, total = len(world.joins.guide), 0.0
    for i in range(n):
        axis, edge = cone_to(i, p, world)
        if 0.5 * (1.0 - dot(d, axis)) <= edge:
            # solid angle 2 pi (1 - cos) = 4 pi edge
            total += 1.0 / (n * 4.0 * math.pi * edge)
    return total


@inlined
def aim_of(q, world):
    """Return the uniforms of the point of a target about which directions are drawn.

    Array twin: none.
    Over random slopes, and to receivers in the water, the centre, (0, 0): a crossing or hit ahead
    is joined to another point than a collision, and the balance heuristic needs one density of the
    direction for both.
    """
    if interface.is_rough(world.surface.roughness) or is_mirrored(world.under):
        return Vec2(0.0, 0.0)
    return Vec2(q.u, q.v)


@outlined
def drawn_density(d, phase, q, world):
    """Return the expected number of directions drawn at d after a collision [sr-1].

    `phase` is the phase function at d, by which the photon itself goes on: one direction. Copies
    add the expected numbers `guided_directions`.
    """
    start, n = place(q), len(world.joins.guide)
    lobe, cone = guided_directions(q, world)
    total = phase
    for i in range(n):
        if lobe > 0.0:
            way = way_to(i, start, q.level, aim_of(q, world), world)
            total += lobe / n * mixed_phase(way, d, start, world)
    if cone > 0.0:
        total += cone * cone_density(d, start, world)
    return total


@inlined
def drawn_after(w, phase, q, world):
    """Return `drawn_density` after an event; off walls only links on one side are guided."""
    if q.turned_by != SCATTERED and world.under is None:
        return phase
    return drawn_density(w, phase, q, world)


@outlined
def way_to(i, p, level, uv, world):
    """Return the direction from p to a point of guide i: straight, or through still water."""
    scene = scene_to(world.joins.guide[i], world)
    goal = goal_on(scene.target, uv.x, uv.y)
    if scene.reflects and world.joins.guide[i].mirror == 0:
        way = minus(point_of(goal, scene.target), p)
        return scaled(1.0 / norm(way), way)
    still = still_crossing(p, goal, level, scene)
    way = Vec3(still.x - p.x, still.y - p.y, still.depth)
    return scaled(1.0 / norm(way), way)
