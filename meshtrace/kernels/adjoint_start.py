"""Starts of adjoint paths: from the aperture against the light through the surface into the water.

Directions are drawn from a mixture of a cosine lobe over the field of view and of lobes about the
directions of unscattered light; `kernels.adjoint` follows the paths in the water.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.aiming import Target, height_on
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
from meshtrace.kernels.line_estimate import Optics, angle_between, phase_at
from meshtrace.kernels.medium import absorption_path
from meshtrace.kernels.phase import sample_s
from meshtrace.kernels.random import uniforms
from meshtrace.kernels.sources import SourceKind
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
_START, _TILT, _LOOK = range(3)
FIRST_STREAM = 3
"""First stream of random numbers behind the start."""

# Paths.state
STARTED, WALKING, WAITING, ENDED = range(4)

PEAK = 0.3
"""Share of directions about a source or a lobe with a density as 1 / sin(theta / 2)."""

_LOBES = 0.75  # share of directions drawn about unscattered arrivals inside the field of view
_LOBES_OUTSIDE = 0.7  # the same, where all arrivals lie outside
_NEWTON = 4  # steps on the plane of one facet


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


@inlined
def put(array, i, v):
    """Write a vector to row i.

    Array twin: assignment of a row.
    """
    array[i, 0], array[i, 1], array[i, 2] = v.x, v.y, v.z


@inlined
def is_flat(surface):
    """Return whether a surface is still water.

    Array twin: numpy.ptp of the heights.
    """
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
            put(paths.lamp, i, along(emitter.position, across, r))
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
def peak_density(theta):
    """Return a density [sr-1] as 1 / sin(theta / 2).

    Array twin: none, elementary.
    Light scattered once goes as the inverse distance of a line from the source: with a density
    that stays finite there the variance is infinite.
    """
    return 1.0 / (8.0 * math.pi * max(math.sin(0.5 * theta), 1e-12))


@inlined
def peaked_s(u, u_kind, share, medium):
    """Draw sin^2(theta / 2) by the mixture of a phase function and `peak_density`.

    Array twin: the integral of the density in the tests.
    """
    if u_kind < PEAK:
        return u * u
    if (u_kind - PEAK) < share * (1.0 - PEAK):
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
    return (1.0 - PEAK) * density + PEAK * peak_density(theta)


@outlined
def _drawn_about(lobe, axis, inside, u, v, u_kind, world):
    """Draw a direction about a lobe: by the phase function, or in the cone beside it."""
    if not inside:
        return _drawn_aside(lobe, axis, u, v, world)
    return turn(lobe, peaked_s(u, u_kind, world.lobe_bubble, world.optics.medium), v)


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
        put(paths.direction, i, w)
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
        put(paths.point, i, p)
        put(paths.direction, i, d)
        paths.weight[i] *= weight
        paths.importance[i] = paths.weight[i] * importance_at(p, row(paths.lamp, i), medium)
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
def importance_at(p, lamp, medium):
    """Return the expected score of a path at p, up to a factor.

    Array twin: none, elementary.
    """
    r = norm(minus(lamp, p))
    if r == 0.0:
        return 1.0
    return math.exp(-absorption_path(medium, p.z, lamp.z, r)) / (r * r)
