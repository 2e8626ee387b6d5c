"""Adjoint paths: from the aperture through the surface into the water, connected to the source.

A path starts on the aperture against the light, crosses the surface and is scattered in the
water. Each of its segments receives light that the source sends straight to a point of it and
that is scattered into it there (`kernels.line_estimate`): the segment behind k scatterings scores
light of order k + 1. At a scattering the segment that goes on is drawn by the phase function; a
second one, drawn by the phase function about the direction to the source, only scores. The
balance heuristic joins both, so that neither forward peak makes a heavy tail and no weight grows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.aiming import Target, height_on
from meshtrace.kernels.chain_gain import intensity
from meshtrace.kernels.facets import (
    Surface,
    exposure,
    normal_at,
    plane_distance,
    slope_tilt,
    tilted,
)
from meshtrace.kernels.interface import (
    FieldOfView,
    FresnelMode,
    Interface,
    reflectance,
    refract,
)
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.line_estimate import (
    Optics,
    angle_between,
    coefficients,
    distance_at,
    optical_depth,
    phase_at,
    point_of_beam,
    scattered_at,
    scattered_into,
    scattering_depth,
)
from meshtrace.kernels.medium import absorption_path
from meshtrace.kernels.phase import sample_s
from meshtrace.kernels.random import uniforms
from meshtrace.kernels.sources import SourceKind, lambert_reflection
from meshtrace.kernels.vectors import (
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
    unit,
)

# what a draw is for; the key of the stream belongs to one source and one receiver
_START, _TILT, _LOOK, _LINE, _COLLISION, _TURN, _SIDE, _BEAM = range(8)

# Paths.state
STARTED, WALKING, WAITING, ENDED = range(4)

_LOBES = 0.75  # share of directions drawn about unscattered arrivals inside the field of view
_LOBES_OUTSIDE = 0.7  # the same, where all arrivals lie outside
_PEAK = 0.3  # share of directions about a source or a lobe with a density as 1 / sin(theta / 2)
_NEWTON = 4  # steps on the plane of one facet
_LIGHT = 0.25  # importance over that of the crossing, below which roulette is played
_ASIDE = 0.3  # [rad], beyond which a path does not head for the source
_BEYOND = 1.5  # distances to the source, up to which free paths are drawn evenly
_MANY = 64  # scatterings behind which paths end with a chance of 0.1 each
_ROOM = 8  # deferred scores and rays that one event may write


class Paths(NamedTuple):
    """A block of paths."""

    lamp: NDArray[np.float64]  # (n, 3) point of the source
    point: NDArray[np.float64]  # (n, 3) on the aperture, then the start of the segment
    direction: NDArray[np.float64]  # (n, 3) of the segment, against the light
    tilt: NDArray[np.float64]  # (n, 2) slopes on top of those of the mesh
    root: NDArray[np.float64]  # (n, roots, 2) crossings (x, y) of unscattered light
    lobe: NDArray[np.float64]  # (n, lobes, 3) directions from the aperture to crossings
    weight: NDArray[np.float64]  # (n,)
    length: NDArray[np.float64]  # (n,) of the segment, where a wave may cut it
    water: NDArray[np.float64]  # (n,) way in the water up to `point`
    importance: NDArray[np.float64]  # (n,) of the crossing
    heaviest: NDArray[np.float64]  # (n,) weight behind the crossing
    state: NDArray[np.int64]  # (n,)
    order: NDArray[np.int64]  # (n,) scatterings so far
    event: NDArray[np.int64]  # (n,) draws so far
    branch: NDArray[np.float64]  # (n, branches, 9) point, direction, weight, order, way
    branches: NDArray[np.int64]  # (n,) side paths that are left
    score: NDArray[np.float64]  # (n, orders)


class World(NamedTuple):
    """Inputs common to the paths of one source and one receiver."""

    optics: Optics
    target: Target
    surface: Surface
    interface: Interface
    size: float  # radius of the source [m]
    lobe_bubble: float  # share of lobes drawn by the phase function of the bubbles
    axis: Vec3  # of the cone of directions, away from the aperture
    cos_cone: float
    even: float  # share of free paths drawn evenly over the distance to the source
    aimed: float  # chance of a side path about the direction to the source
    key: np.uint64
    first: int  # index of the first path of the block


class Checks(NamedTuple):
    """Scores that a wave may cut off, and the paths to be checked; every score if `whole`."""

    whole: bool
    score: NDArray[np.float64]  # (m, 4) path, order, value, way in the water
    ray: NDArray[np.float64]  # (2 m, 8) score or -1 - path, origin, direction, length


@inlined
def _put(array, i, v):
    array[i, 0], array[i, 1], array[i, 2] = v.x, v.y, v.z


@inlined
def _is_flat(surface):
    return surface.max_slope == 0.0 and surface.low[2] == surface.high[2]


@entry
def begin(paths, starts, world):
    """Draw points of the aperture and of the source, random slopes and guesses of crossings.

    Array twin: moments in the tests.
    `starts` are crossings (x, y) of light to the centre of the aperture.
    """
    emitter, target = world.optics.emitter, world.target
    n = world.optics.medium.n_water / world.optics.medium.n_air
    for i in range(len(paths.weight)):
        u, v, u_lamp, v_lamp = uniforms(world.key, world.first + i, 0, _START)
        r = target.radius * math.sqrt(u)
        cos_phi, sin_phi = on_circle(v)
        p, q = r * cos_phi, r * sin_phi
        for k in range(3):
            paths.point[i, k] = target.center[k] + p * target.e1[k] + q * target.e2[k]
            paths.lamp[i, k] = emitter.position[k]
        if world.size > 0.0:
            if emitter.kind == SourceKind.TOP_HAT_BEAM:
                r = world.size * math.sqrt(u_lamp)
            else:
                r = world.size * math.sqrt(-0.5 * math.log(u_lamp))
            across = turn(emitter.axis, 0.5, v_lamp)
            _put(paths.lamp, i, along(emitter.position, across, r))
        u, v, _, _ = uniforms(world.key, world.first + i, 0, _TILT)
        r = math.sqrt(-2.0 * math.log(u))
        cos_phi, sin_phi = on_circle(v)
        tilt = slope_tilt(world.surface.roughness, r * cos_phi, r * sin_phi)
        paths.tilt[i, 0], paths.tilt[i, 1] = tilt.x, tilt.y
        height, depth = target.center[2], max(-emitter.position[2], 0.0)
        share = n * height / (n * height + depth)
        for k in range(len(starts)):
            for j in range(2):
                paths.root[i, k, j] = (
                    starts[k, j]
                    + (1.0 - share) * (paths.point[i, j] - target.center[j])
                    + share * (paths.lamp[i, j] - emitter.position[j])
                )
        paths.weight[i], paths.state[i] = 0.0, STARTED
        paths.order[i], paths.event[i], paths.branches[i] = 0, 0, 0
        paths.water[i] = 0.0


@inlined
def _normal(x, y, facet, surface, tilt_x, tilt_y):
    n = UP
    if facet >= 0:
        n = normal_at(x, y, facet, surface)
    if tilt_x != 0.0 or tilt_y != 0.0:
        n = tilted(n, Vec2(tilt_x, tilt_y))
    return n


@inlined
def _imbalance(x, y, facet, a, b, tilt_x, tilt_y, n, surface):
    """Return the derivative of the optical path from a (air) to b (water) along the surface.

    It vanishes where Snell's law holds.
    """
    p = Vec3(x, y, height_on(x, y, facet, surface))
    m = _normal(x, y, facet, surface, tilt_x, tilt_y)
    up, down = unit(minus(a, p)), unit(minus(b, p))
    hx, hy, hz = up.x + n * down.x, up.y + n * down.y, up.z + n * down.z
    return hx - m.x / m.z * hz, hy - m.y / m.z * hz


@outlined
def _stationary(x, y, facet, a, b, tilt_x, tilt_y, n, surface):
    """Return the crossing (x, y) on the plane of a facet of unscattered light from b to a."""
    size = norm(minus(a, b))
    for _ in range(_NEWTON if facet >= 0 else 3 * _NEWTON):
        h = 1e-6 * size
        f, g = _imbalance(x, y, facet, a, b, tilt_x, tilt_y, n, surface)
        fx, gx = _imbalance(x + h, y, facet, a, b, tilt_x, tilt_y, n, surface)
        fy, gy = _imbalance(x, y + h, facet, a, b, tilt_x, tilt_y, n, surface)
        fx, gx, fy, gy = (fx - f) / h, (gx - g) / h, (fy - f) / h, (gy - g) / h
        det = fx * gy - fy * gx
        if det == 0.0:
            break
        dx, dy = (fy * g - gy * f) / det, (gx * f - fx * g) / det
        step = math.sqrt(dx * dx + dy * dy)
        if step > 0.3 * size:
            dx, dy = 0.3 * size * dx / step, 0.3 * size * dy / step
        x, y = x + dx, y + dy
        if step < 1e-9 * size:
            break
    return x, y


@entry
def improve(paths, facets, kept, world):
    """Solve for the crossings of unscattered light on the facets below the last guesses.

    Array twin: Fermat's principle by scipy in the tests.
    `facets` has one row a path; `kept` is the set of lobes that takes the directions, -1 for
    none. A crossing that is wrong costs variance, never bias.
    """
    n = world.optics.medium.n_water / world.optics.medium.n_air
    roots = paths.root.shape[1]
    for i in range(len(paths.weight)):
        a, b = row(paths.point, i), row(paths.lamp, i)
        for k in range(roots):
            x, y = paths.root[i, k, 0], paths.root[i, k, 1]
            x, y = _stationary(
                x, y, facets[i, k], a, b, paths.tilt[i, 0], paths.tilt[i, 1], n, world.surface
            )
            if not (abs(x) < math.inf and abs(y) < math.inf):
                x, y = a.x, a.y
            paths.root[i, k, 0], paths.root[i, k, 1] = x, y
            if kept >= 0:
                p = Vec3(x, y, height_on(x, y, facets[i, k], world.surface))
                w = unit(minus(p, a))
                j = kept * roots + k
                paths.lobe[i, j, 0], paths.lobe[i, j, 1], paths.lobe[i, j, 2] = w.x, w.y, w.z


@inlined
def _in_cone(w, world):
    return dot(w, world.axis) >= world.cos_cone


class Rim(NamedTuple):
    """The cone of directions seen from a lobe outside it: between s0 and s1, within an azimuth."""

    s0: float  # sin^2(theta / 2)
    s1: float
    half: float  # azimuth [rad]


@inlined
def _rim(lobe, axis, world):
    apart, half = angle_between(lobe, axis), math.acos(min(world.cos_cone, 1.0))
    s0 = math.sin(0.5 * max(apart - half, 0.0)) ** 2
    s1 = math.sin(0.5 * min(apart + half, math.pi)) ** 2
    widest = math.pi
    if half < apart < math.pi - half:
        widest = math.asin(min(math.sin(half) / math.sin(apart), 1.0))
    return Rim(max(s0, 1e-12), s1, widest)


@outlined
def _drawn_aside(lobe, axis, u, v, world):
    """Draw a direction of the cone about a lobe outside it, with a density as s^-2."""
    rim = _rim(lobe, axis, world)
    s = 1.0 / (1.0 / rim.s0 - u * (1.0 / rim.s0 - 1.0 / rim.s1))
    sin, cos = 2.0 * math.sqrt(max(s * (1.0 - s), 0.0)), 1.0 - 2.0 * s
    along_lobe = dot(axis, lobe)
    e = minus(axis, Vec3(along_lobe * lobe.x, along_lobe * lobe.y, along_lobe * lobe.z))
    if norm(e) < 1e-9:
        return turn(lobe, s, v)
    e = unit(e)
    f = Vec3(lobe.y * e.z - lobe.z * e.y, lobe.z * e.x - lobe.x * e.z, lobe.x * e.y - lobe.y * e.x)
    phi = rim.half * (2.0 * v - 1.0)
    p, q = sin * math.cos(phi), sin * math.sin(phi)
    return Vec3(
        cos * lobe.x + p * e.x + q * f.x,
        cos * lobe.y + p * e.y + q * f.y,
        cos * lobe.z + p * e.z + q * f.z,
    )


@inlined
def _peak(theta):
    """Return a density [sr-1] as 1 / sin(theta / 2).

    Light scattered once goes as the inverse distance of a line from the source: with a density
    that stays finite there the variance is infinite.
    """
    return 1.0 / (8.0 * math.pi * max(math.sin(0.5 * theta), 1e-12))


@inlined
def _peaked_s(u, u_kind, share, medium):
    """Draw sin^2(theta / 2) by the mixture of a phase function and `_peak`."""
    if u_kind < _PEAK:
        return u * u
    if (u_kind - _PEAK) < share * (1.0 - _PEAK):
        return sample_s(medium.phase_bubble, u)
    return sample_s(medium.phase_water, u)


@outlined
def _lobe_density(w, lobe, axis, inside, world):
    """Return the density [sr-1] of directions of the cone that are drawn about a lobe."""
    theta = angle_between(w, lobe)
    if not inside:
        rim, s = _rim(lobe, axis, world), math.sin(0.5 * theta) ** 2
        return 1.0 / (s * s * (1.0 / rim.s0 - 1.0 / rim.s1) * 4.0 * rim.half)
    density = (1.0 - world.lobe_bubble) * phase_at(world.optics.water, theta)
    if world.lobe_bubble > 0.0:
        density += world.lobe_bubble * phase_at(world.optics.bubble, theta)
    return (1.0 - _PEAK) * density + _PEAK * _peak(theta)


@outlined
def _drawn_about(lobe, axis, inside, u, v, u_kind, world):
    """Draw a direction about a lobe: by the phase function, or in the cone beside it."""
    if not inside:
        return _drawn_aside(lobe, axis, u, v, world)
    return turn(lobe, _peaked_s(u, u_kind, world.lobe_bubble, world.optics.medium), v)


@entry
def look(paths, origins, directions, world):
    """Draw the directions in which the paths leave the aperture, and write their first rays.

    Array twin: the integral of the density in the tests.
    A mixture of a cosine lobe over the field of view and of lobes about the directions of
    unscattered light: the phase function about those inside the field of view, or, where all lie
    outside, the field of view beside them. Rays start above the highest crest.
    """
    target, high = world.target, world.surface.high[2]
    axis = world.axis
    sin2 = 1.0 - world.cos_cone * world.cos_cone
    lobes = paths.lobe.shape[1]
    for i in range(len(paths.weight)):
        n_inside = 0
        for j in range(lobes):
            n_inside += _in_cone(row(paths.lobe[i], j), world)
        inside = n_inside > 0
        used = n_inside if inside else lobes
        share = 0.0
        if lobes > 0:
            share = _LOBES if inside else _LOBES_OUTSIDE
        u_kind, u, v, u_lobe = uniforms(world.key, world.first + i, 0, _LOOK)
        if u_kind >= share:
            w = turn(axis, 0.5 * u * sin2 / (1.0 + math.sqrt(1.0 - u * sin2)), v)
        else:
            pick, j = int(u_kind / share * used), 0
            for j in range(lobes):
                if not inside or _in_cone(row(paths.lobe[i], j), world):
                    if pick == 0:
                        break
                    pick -= 1
            w = _drawn_about(row(paths.lobe[i], j), axis, inside, u, v, u_lobe, world)
        p = row(paths.point, i)
        a = target.axis
        facing = -(w.x * a[0] + w.y * a[1] + w.z * a[2])
        paths.state[i] = ENDED
        if facing > 0.0 and w.z < 0.0 and _in_cone(w, world):
            density = 0.0
            for j in range(lobes):
                lobe = row(paths.lobe[i], j)
                if not inside or _in_cone(lobe, world):
                    density += _lobe_density(w, lobe, axis, inside, world)
            density *= share / max(used, 1)
            density += (1.0 - share) * max(dot(w, axis), 0.0) / (math.pi * sin2)
            paths.weight[i] = math.pi * target.radius**2 * facing / density
            paths.state[i] = STARTED
        _put(paths.direction, i, w)
        t = max((high - p.z) / w.z, 0.0) * (1.0 - 1e-3) if w.z < 0.0 else 0.0
        for k in range(3):
            origins[i, k] = paths.point[i, k] + t * paths.direction[i, k]
            directions[i, k] = paths.direction[i, k]


@entry
def enter(paths, facets, world):
    """Let the paths cross the surface; return how many passed beside the mesh.

    Array twin: the analog crossing, `kernels.photon`.
    Radiance over n^2 is kept but for the transmittance; interpolated and tilted normals add the
    projected areas that the analog photon meets, so that both estimate one integral.
    """
    medium, surface, target = world.optics.medium, world.surface, world.target
    beside = 0
    for i in range(len(paths.weight)):
        if paths.state[i] == ENDED:
            continue
        paths.state[i] = ENDED
        f = facets[i]
        if f < 0:
            beside += 1
            continue
        p, d = row(paths.point, i), row(paths.direction, i)
        t = plane_distance(p, d, f, surface)
        g = row(surface.face_normals, f)
        if not t > 0.0 or dot(d, g) >= 0.0:
            continue
        p = along(p, d, t)
        if world.interface.fov != FieldOfView.ANGLE:
            reach = target.radius + (target.center[2] - p.z) * target.tan_half_fov
            if (p.x - target.center[0]) ** 2 + (p.y - target.center[1]) ** 2 >= reach * reach:
                continue
        weight, d = _crossed(p, d, f, g, paths.tilt[i, 0], paths.tilt[i, 1], world)
        if weight == 0.0:
            continue
        _put(paths.point, i, p)
        _put(paths.direction, i, d)
        paths.weight[i] *= weight
        paths.importance[i] = paths.weight[i] * _importance(p, row(paths.lamp, i), medium)
        if paths.importance[i] == 0.0:  # what it may score underflows
            continue
        paths.heaviest[i] = paths.weight[i]
        paths.state[i] = WALKING
    return beside


@outlined
def _crossed(p, d, f, g, tilt_x, tilt_y, world):
    """Return (factor of the weight, direction in the water) of a path that meets facet f."""
    medium = world.optics.medium
    n = _normal(p.x, p.y, f, world.surface, 0.0, 0.0)
    m = _normal(p.x, p.y, f, world.surface, tilt_x, tilt_y)
    cos_air = -dot(d, m)
    if cos_air <= 0.0:
        return 0.0, d
    cos_water, inwards = refract(
        d, scaled(-1.0, m), min(cos_air, 1.0), medium.n_air, medium.n_water
    )
    # the light comes along -inwards: it must meet the facet from below, and its reflection stay
    from_below = -dot(inwards, g)
    if from_below <= 0.0 or from_below - 2.0 * cos_water * dot(m, g) >= 0.0:
        return 0.0, d
    through = 1.0 - reflectance(cos_water, cos_air, medium.n_water, medium.n_air)
    if world.interface.fresnel == FresnelMode.PAPER_BOTH:
        through *= through
    through *= world.interface.foam_transmittance
    through *= (medium.n_air / medium.n_water) ** 2
    through *= from_below * cos_air / (cos_water * -dot(d, g))
    if tilt_x != 0.0 or tilt_y != 0.0:
        through *= exposure(scaled(-1.0, inwards), n, Vec2(tilt_x, tilt_y))
    return through, inwards


@inlined
def _importance(p, lamp, medium):
    """Return the expected score of a path at p, up to a factor."""
    r = norm(minus(lamp, p))
    if r == 0.0:
        return 1.0
    return math.exp(-absorption_path(medium, p.z, lamp.z, r)) / (r * r)


@inlined
def _is_clear(p, q, d, surface):
    """Return whether no wave can cut the straight path from p to q along d."""
    low = surface.low[2]
    if (p.z <= low and q.z <= low) or _is_flat(surface):
        return True
    slope = surface.max_slope
    return d.z < 0.0 and d.z * d.z > slope * slope * (d.x * d.x + d.y * d.y)


@inlined
def _list_ray(checks, n, what, p, d, length):
    r = checks.ray[n]
    r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7] = what, p.x, p.y, p.z, d.x, d.y, d.z, length
    return n + 1


@inlined
def _gather(paths, i, p, d, value, at, checks, n, rays, world):
    """Score a value that a segment receives at a point; return (n, rays)."""
    if not value > 0.0:
        return n, rays
    order = min(paths.order[i], paths.score.shape[1] - 1)
    lamp = row(paths.lamp, i)
    return _score(paths, i, order, value, p, at.at, d, at.t, lamp, checks, n, rays, world)


@inlined
def _score(paths, i, order, value, p, q, d, t, lamp, checks, n, rays, world):
    """Score light that goes from the source to q and on to p, or list it; return (n, rays)."""
    way = unit(minus(lamp, q))
    here, there = _is_clear(p, q, d, world.surface), _is_clear(q, lamp, way, world.surface)
    if here and there and not checks.whole:
        paths.score[i, order] += value
        return n, rays
    checks.score[n, 0], checks.score[n, 1], checks.score[n, 2] = i, order, value
    checks.score[n, 3] = paths.water[i] + t + norm(minus(lamp, q))
    if not here:
        rays = _list_ray(checks, rays, n, p, d, t)
    if not there:
        rays = _list_ray(checks, rays, n, q, way, norm(minus(lamp, q)))
    return n + 1, rays


@inlined
def _longest(p, d, world):
    """Return how far a segment can go before it has passed every wave or meets the bottom."""
    if d.z > 0.0:
        return max((world.surface.high[2] - p.z) / d.z, 0.0)
    if d.z < 0.0 and world.optics.medium.bottom_z > -math.inf:
        return max((world.optics.medium.bottom_z - p.z) / d.z, 0.0)
    return math.inf


@entry
def follow(paths, clear, checks, world):
    """Move every path until it ends or needs a ray; return (listed scores, rays).

    Array twin: `tests/transport/single_scattering.py` for the first order.
    `clear` tells of waiting paths whether no wave cut their segment.
    """
    n = rays = 0
    room = len(checks.score) - _ROOM
    for i in range(len(paths.weight)):
        if paths.state[i] == WAITING:
            paths.state[i] = ENDED
            if clear[i]:
                n, rays = _arrive(paths, i, checks, n, rays, world)
        while n < room:
            if paths.state[i] == ENDED:
                if paths.branches[i] == 0:
                    break
                _resume(paths, i)
            p, d = row(paths.point, i), row(paths.direction, i)
            if paths.event[i] == 0:
                u_kind, u, _, _ = uniforms(world.key, world.first + i, 0, _LINE)
                lamp, longest = row(paths.lamp, i), _longest(p, d, world)
                at = scattered_into(p, d, longest, lamp, u_kind, u, world.optics)
                value = paths.weight[i] * at.light / at.density
                n, rays = _gather(paths, i, p, d, value, at, checks, n, rays, world)
            paths.event[i] += 1
            longest = _longest(p, d, world)
            t = _draw_length(paths, i, p, d, longest, world)
            paths.length[i] = t
            if t == longest and not (d.z < 0.0 and t < math.inf):
                paths.state[i] = ENDED  # up through the surface, or down for ever
            elif _is_clear(p, along(p, d, t), d, world.surface):
                n, rays = _arrive(paths, i, checks, n, rays, world)
            else:
                rays = _list_ray(checks, rays, -1 - i, p, d, t)
                paths.state[i] = WAITING
                break
    return n, rays


@inlined
def _resume(paths, i):
    """Go on with the last side path."""
    paths.branches[i] -= 1
    b = paths.branch[i, paths.branches[i]]
    _put(paths.point, i, Vec3(b[0], b[1], b[2]))
    _put(paths.direction, i, Vec3(b[3], b[4], b[5]))
    paths.weight[i], paths.order[i], paths.water[i] = b[6], int(b[7]), b[8]
    paths.state[i] = WALKING


@inlined
def _branch_off(paths, i, p, d, weight):
    """Keep a side path for later."""
    b = paths.branch[i, paths.branches[i]]
    b[0], b[1], b[2], b[3], b[4], b[5] = p.x, p.y, p.z, d.x, d.y, d.z
    b[6], b[7], b[8] = weight, paths.order[i], paths.water[i]
    paths.branches[i] += 1


@inlined
def _even_range(p, lamp, longest):
    """Return the distance up to which collisions are also drawn evenly."""
    return min(_BEYOND * norm(minus(lamp, p)), longest)


@inlined
def _draw_length(paths, i, p, d, longest, world):
    """Return a free path: by the scattering depth, or even up to a little beyond the source."""
    u, u_kind, _, _ = uniforms(world.key, world.first + i, paths.event[i], _COLLISION)
    lamp = row(paths.lamp, i)
    if u_kind < world.even:
        return u * _even_range(p, lamp, longest)
    scale = norm(minus(lamp, p))
    return distance_at(world.optics.sampled, p, d, -math.log(u), longest, scale)


@outlined
def _arrive(paths, i, checks, n, rays, world):
    """Let a path scatter at the end of its segment, in the water or on the bottom."""
    optics = world.optics
    medium = optics.medium
    p, d, t = row(paths.point, i), row(paths.direction, i), paths.length[i]
    lamp, weight = row(paths.lamp, i), paths.weight[i]
    at = along(p, d, t)
    paths.water[i] += t
    on_bottom = d.z < 0.0 and t == _longest(p, d, world)
    weight *= math.exp(-optical_depth(medium, p, d, t))
    b, bubbles = coefficients(medium, at)
    near_b, near_bubbles = coefficients(optics.sampled, at)
    passed = (1.0 - world.even) * math.exp(-scattering_depth(optics.sampled, p, d, t))
    u_kind, u, v, lot = uniforms(world.key, world.first + i, paths.event[i], _TURN)
    if on_bottom:
        weight *= medium.bottom_albedo / passed
    else:
        density = passed * (near_b + near_bubbles)
        even = _even_range(p, lamp, _longest(p, d, world))
        if t <= even:
            density += world.even / even
        weight *= (b + bubbles) / density
    paths.order[i] += 1
    if weight == 0.0:
        paths.state[i] = ENDED
        return n, rays
    share = bubbles / (b + bubbles) if bubbles > 0.0 and not on_bottom else 0.0
    if on_bottom:
        n, rays = _gather_bottom(paths, i, p, at, d, t, weight, checks, n, rays, world)
        plain = lambert_reflection(u, v)
    else:
        s = sample_s(medium.phase_bubble if u_kind < share else medium.phase_water, u)
        plain = turn(d, s, v)
    n, rays = _connect(
        paths, i, at, d, plain, weight, share, on_bottom, lot, checks, n, rays, world
    )
    return n, rays


@outlined
def _connect(paths, i, at, d, plain, weight, share, on_bottom, lot, checks, n, rays, world):
    """Score the segments that leave a scattering, and choose those that go on; return (n, rays).

    Three points are joined by the balance heuristic: on a segment drawn by the phase function, on
    one drawn about the direction to the source, and in the beam of the source.
    """
    optics, lamp = world.optics, row(paths.lamp, i)
    medium = optics.medium
    to_lamp = unit(minus(lamp, at))
    u_kind, u, v, u_side = uniforms(world.key, world.first + i, paths.event[i], _SIDE)
    aimed = turn(to_lamp, _peaked_s(u, u_kind, share, medium), v)
    u_a, v_a, u_b, v_b = uniforms(world.key, world.first + i, paths.event[i], _LINE)
    u, v, u_length, _ = uniforms(world.key, world.first + i, paths.event[i], _BEAM)
    lit = minus(point_of_beam(lamp, u, v, u_length, optics), at)
    paths.state[i] = ENDED
    aside = world.aimed if paths.branches[i] < paths.branch.shape[1] else 0.0
    _put(paths.point, i, at)
    for k in range(3):
        w = plain if k == 0 else (aimed if k == 1 else unit(lit))
        forward = _forward(d, w, share, on_bottom, optics)
        if not forward > 0.0:
            continue
        theta = angle_between(to_lamp, w)
        towards = (1.0 - _PEAK) * _mixed_phase(theta, share, optics) + _PEAK * _peak(theta)
        longest = _longest(at, w, world)
        if k == 2:
            q = scattered_at(at, w, norm(lit), longest, lamp, optics)
        else:
            u_line, v_line = (u_a, v_a) if k == 0 else (u_b, v_b)
            q = scattered_into(at, w, longest, lamp, u_line, v_line, optics)
        density = (forward + towards) * q.density + q.beam_density
        value = weight * forward * q.light / density
        n, rays = _gather(paths, i, at, w, value, q, checks, n, rays, world)
        kept = weight * forward / (forward + aside * towards)
        if k == 0:
            _put(paths.direction, i, w)
            paths.weight[i] = _roulette(kept, at, lamp, theta, lot, paths, i, optics)
            if paths.weight[i] > 0.0:
                paths.state[i] = WALKING
        elif k == 1 and u_side < aside:
            kept = _roulette(kept, at, lamp, theta, u_side / aside, paths, i, optics)
            if kept > 0.0:
                _branch_off(paths, i, at, w, kept)
    return n, rays


@inlined
def _forward(d, w, share, on_bottom, optics):
    """Return the density [sr-1] of directions that a scattering or the bottom gives."""
    if on_bottom:
        return max(w.z, 0.0) / math.pi
    return _mixed_phase(angle_between(d, w), share, optics)


@inlined
def _mixed_phase(theta, share, optics):
    beta = (1.0 - share) * phase_at(optics.water, theta)
    if share > 0.0:
        beta += share * phase_at(optics.bubble, theta)
    return beta


@inlined
def _roulette(weight, at, lamp, theta, u, paths, i, optics):
    """Return the weight after Russian roulette, 0 for a terminated path.

    A path that heads for the source scores in proportion to the phase function: it is light
    because that direction was drawn often, and must not be made heavy by roulette.
    """
    survival = 1.0
    ratio = weight * _importance(at, lamp, optics.medium) / paths.importance[i]
    ratio *= max(phase_at(optics.water, theta) / phase_at(optics.water, _ASIDE), 1.0)
    if ratio < _LIGHT:
        survival = min(max(ratio / _LIGHT, weight / paths.heaviest[i]), 1.0)
    if paths.order[i] > _MANY:
        survival = min(survival, 0.9)
    if not u < survival:
        return 0.0
    return weight / survival


@outlined
def _gather_bottom(paths, i, p, at, d, t, weight, checks, n, rays, world):
    """Score light that comes straight from the source to the bottom; return (n, rays)."""
    lamp = row(paths.lamp, i)
    away = minus(at, lamp)
    r = norm(away)
    w = unit(away)
    if w.z >= 0.0:
        return n, rays
    light = intensity(world.optics.emitter, w)
    if light == 0.0:
        return n, rays
    tau = optical_depth(world.optics.medium, lamp, w, r)
    value = weight * light * math.exp(-tau) * -w.z / (math.pi * r * r)
    order = min(paths.order[i] - 1, paths.score.shape[1] - 1)
    # the segment to the bottom itself has been found clear
    return _score(paths, i, order, value, at, at, w, 0.0, lamp, checks, n, rays, world)
