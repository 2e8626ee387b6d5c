"""Light of a pencil of rays on the aperture, blurred by the random slopes where it crosses.

A `Pencil` runs from the source to the centroid of a part of a facet (`microfacets` cuts the facets
and adds the parts up). Each slope that the mesh leaves out sends it to one point of the aperture's
plane: the density of the slopes gives a `Spot` there, roughly Gaussian. A field of view accepts of
it what lies on a disk (`view_disk`). Where view and aperture are wide against the spot fixed nodes
over the aperture do (`disk_light`); elsewhere Gauss nodes lie between the rims of both disks
(`lens_light`). Points of the plane are in metres from the centre of the aperture.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.engine.chains import unscattered
from meshtrace.engine.chains.random_slopes import MOST_SLOPE, slope_gradient, slope_towards
from meshtrace.kernels.interface import FieldOfView, exposure, normal_at
from meshtrace.kernels.jit import ZERO, inlined, outlined
from meshtrace.kernels.sources import intensity
from meshtrace.kernels.vectors import Vec2, Vec3, along, blend, dot, minus, norm, plus, row, scaled

# What each constant costs: see the table in `microfacets`.
_PER_DEVIATION = 1.2  # Gauss nodes per standard deviation of the light on the aperture
# 2.4: view 4e-7, x 1.8
_AT_LEAST = 2.5  # Gauss nodes: light that hardly changes
# 5.0: view 4e-7, x 1.7
GAUSS = 32
"""Gauss nodes along a line at most: those of a Gaussian profile of 2 x 1.25 x 5 deviations fit."""

# Bounds, tuned: smaller ones could leave out light, larger ones cost time.
BENT = 1.25
"""Factor on extents of light from slopes that are linear in the landing point: not quite true."""
_PROBE = 0.5  # distance over which slopes are taken for linear, over the width of the light


class Rule(NamedTuple):
    """Quadratures over an aperture: over all of it, and over its part that the view accepts.

    The first has fixed nodes. It serves where the whole aperture is in view and not much wider than
    the light of a facet. Elsewhere Gauss nodes lie between the rims of aperture and view.
    """

    points: NDArray[np.float64]  # (n, 2) of the unit disk
    shares: NDArray[np.float64]  # (n,) of the area
    is_wide: bool  # the aperture is much wider than the light of a facet
    nodes: NDArray[np.float64]  # (GAUSS, GAUSS), row n - 1 has n nodes of the unit interval
    weights: NDArray[np.float64]  # (GAUSS, GAUSS)
    # factors on the lengths of parts and on the numbers of Gauss nodes: 1, or others to estimate
    # the error of the quadrature by the change
    parts: float
    finer: float


class Work(IntEnum):
    """Indices into the array in which `blurred_gain` counts its work."""

    LEFT = 0  # nodes that may still be evaluated
    LENSES = 1  # parts that are integrated with Gauss nodes between rims, see `lens_light`
    CUT_SHORT = 2  # gain of facets for which no nodes were left: a bound of their error


class Pencil(NamedTuple):
    """Pencil of rays from the source to a part of a facet."""

    middle: Vec3  # centroid of the part [m]
    normal: Vec3  # of the mesh there, interpolated
    w: Vec3  # direction from the source
    length: float  # from the source [m]
    omega: float  # solid angle of the part from the source [sr]
    intensity: float  # towards the middle [sr-1], 0 behind the facet


@inlined
def pencil_to(part, scene):
    """Return the `Pencil` of rays from the source to a part of a facet."""
    f, surface, source = part.facet, scene.surface, scene.emitter.position
    p, q, r = unscattered.corners_of(part, surface)
    p, q, r = minus(p, source), minus(q, source), minus(r, source)
    way = blend(1.0 / 3.0, 1.0 / 3.0, p, q, r)
    length = norm(way)
    w = scaled(1.0 / length, way)
    middle = plus(source, way)
    normal = normal_at(middle.x, middle.y, f, surface)
    facing = dot(w, row(surface.face_normals, f))
    strength = intensity(scene.emitter, w) if facing > 0.0 else 0.0
    return Pencil(middle, normal, w, length, unscattered.solid_angle(p, q, r), strength)


@inlined
def view_disk(p, scene):
    """Return (high, apart, ahead, radius) of the disk on which light from a point is accepted.

    The plane of the aperture cuts the cone about its axis in a circle: `radius` [m], infinite
    without an edge, about a centre at the distance `apart` [m] from that of the aperture, along the
    unit vector `ahead`. The point lies at the distance `high` [m] from the plane, along the axis.
    """
    target = scene.target
    way = minus(p, target.center)
    high, x, y = -dot(way, target.axis), dot(way, target.e1), dot(way, target.e2)
    apart = math.sqrt(x * x + y * y)
    ahead = Vec2(x / apart, y / apart) if apart > 0.0 else Vec2(1.0, 0.0)
    has_edge = scene.interface.fov == FieldOfView.ANGLE and target.cos_half_fov > 0.0
    return high, apart, ahead, high * target.tan_half_fov if has_edge else math.inf


@inlined
def margin(p, goal, scene):
    """Return (`view_margin`, distance) [m] of light from P to a point of the aperture.

    Array twin: see `unscattered.view_margin`.
    """
    target = scene.target
    way = minus(along(along(target.center, target.e1, goal.x), target.e2, goal.y), p)
    flight = norm(way)
    r = scaled(1.0 / flight, way)
    return unscattered.view_margin(p, r, flight, target, scene.interface.fov), flight


@outlined
def share_in_view(p, q, r, goal, scene):
    """Return the share of a triangle from which a point of the aperture sees light.

    Array twin: fine meshes in the tests.
    The edge of the field of view is taken for a straight line.
    """
    a, b, c = margin(p, goal, scene)[0], margin(q, goal, scene)[0], margin(r, goal, scene)[0]
    # corners in view; ZERO makes the sum an integer
    seen = ZERO + (a >= 0.0) + (b >= 0.0) + (c >= 0.0)
    if seen == 0 or seen == 3:
        return seen / 3.0
    if (a >= 0.0) == (c >= 0.0):
        a, b, c = b, c, a
    elif (a >= 0.0) == (b >= 0.0):
        a, b, c = c, a, b
    # similar triangles: the edges from corner a are cut at a / (a - b) and a / (a - c)
    corner = a * a / ((a - b) * (a - c))
    return corner if seen == 1 else 1.0 - corner


class Spot(NamedTuple):
    """Light of a part on the aperture's plane; t runs along `ahead` of `view_disk`, y leftwards."""

    t: float  # centre, from that of the aperture [m]
    y: float
    half_t: float  # half-width beyond which slopes exceed `MOST_SLOPE` [m]
    half_y: float
    sigma_t: float  # standard deviation along t at a fixed y [m]
    sigma_y: float  # along y at a fixed t


@outlined
def spot_of(pencil, ahead, high, scene):
    """Return the `Spot` of a pencil, from slopes that are linear in the landing point.

    Array twin: none, a bound.
    """
    rough = scene.surface.roughness
    n = scene.medium.n_water / scene.medium.n_air
    # Vertical light turns by (n - 1) times a slope, and by twice the slope in a mirror: the width
    # where there is no gradient.
    turn = 2.0 if scene.reflects else abs(n - 1.0)
    narrow = turn * high * min(rough.along, rough.across)
    unknown = Spot(0.0, 0.0, math.inf, math.inf, narrow, narrow)
    middle, normal, w = pencil.middle, pencil.normal, pencil.w
    m = crossing.land_from(middle, normal, w, w, pencil.length, scene)
    if not m.ok:
        return unknown
    ok, g11, g12, g21, g22 = slope_gradient(
        middle, normal, w, pencil.length, m.at, ahead, _PROBE * narrow, scene
    )
    det = abs(g11 * g22 - g12 * g21)
    if not ok or det == 0.0:
        return unknown
    along_t, along_y = math.sqrt(g11 * g11 + g21 * g21), math.sqrt(g12 * g12 + g22 * g22)
    # The ellipse |G x| <= MOST_SLOPE, G the gradient, has a bounding box of the half-widths
    # MOST_SLOPE |column| / det; the column is that of the other axis.
    reach = BENT * MOST_SLOPE / det
    return Spot(
        m.at.x * ahead.x + m.at.y * ahead.y,
        m.at.y * ahead.x - m.at.x * ahead.y,
        reach * along_y,
        reach * along_t,
        1.0 / along_t,
        1.0 / along_y,
    )


@inlined
def _number_of_nodes(length, sigma, rule):
    """Return the number of Gauss nodes for a Gaussian of standard deviation sigma over a length."""
    wanted = rule.finer * (_AT_LEAST + _PER_DEVIATION * length / sigma)
    return math.ceil(min(max(wanted, 2.0), GAUSS + 0.0))


@inlined
def _passed(s, pencil, scene):
    """Return the transmittance of the surface at a `Slope`, and of the path behind it."""
    if unscattered.is_shadowed(pencil.middle, s.aim.r, s.aim.flight, scene, scene.bodies):
        return 0.0
    share = exposure(pencil.w, pencil.normal, s.tilt)
    share *= crossing.transmittance(s.aim, scene)
    # water before the surface dims a pencil as a whole, see `_part_gain`
    if scene.mirrored != scene.reflects and share > 0.0:
        share *= math.exp(-unscattered.depth_behind(pencil.middle, s.aim, scene))
    return share


@outlined
def lens_light(pencil, rule, work, scene):
    """Return the share of a pencil that lands on the aperture where the view accepts it.

    Array twin: `still_gain` in the tests, over rows of the aperture.
    Aperture (radius r) and view (radius R, at a distance D) are disks, whose overlap is a lens;
    light beyond `MOST_SLOPE` is left out. Along the line of their centres, t, the chord is
    half = sqrt(min(r^2 - t^2, R^2 - (t - D)^2)): a root at either end, which t = end + L v^2 makes
    linear in v, and a bend where the rims meet, at which two Gauss rules join. Across it light is
    smooth.
    """
    height, apart, ahead, seen = view_disk(pencil.middle, scene)  # R is `seen`, D `apart`
    radius = scene.target.radius
    low, high = max(-radius, apart - seen), min(radius, apart + seen)
    if height <= 0.0 or low >= high:
        return 0.0
    s = spot_of(pencil, ahead, height, scene)
    # Where the two rules join: the centre of the smaller disk where it lies inside the other one,
    # else where the rims meet, r^2 - t^2 = R^2 - (t - D)^2.
    bend = 0.0
    if apart + seen <= radius:
        bend = apart
    elif apart + radius > seen:
        bend = 0.5 * (apart + (radius - seen) * (radius + seen) / apart)
    total = 0.0
    for side in range(2):
        end = low if side == 0 else high
        near, far = max(low, s.t - s.half_t), min(high, s.t + s.half_t)
        if side == 0:
            far = min(far, bend)
        else:
            near = max(near, bend)
        if near >= far:
            continue
        start, length = (near, far - near) if side == 0 else (far, near - far)
        # The chord vanishes like a square root at the rim only: a stretch that stops short of it,
        # or at the bend, is smooth.
        rooted = start == end
        n = _number_of_nodes(far - near, s.sigma_t, rule)
        for i in range(n):
            v = rule.nodes[n - 1, i]
            t = start + length * (v * v if rooted else v)
            weight = rule.weights[n - 1, i] * (far - near) * (2.0 * v if rooted else 1.0)
            # half-chords of either disk at t; the smaller one bounds the lens
            off = t - apart
            half = math.sqrt(max(min(radius * radius - t * t, seen * seen - off * off), 0.0))
            total += weight * _chord_light(pencil, t, half, ahead, s, rule, work, scene)
    return total


@inlined
def _chord_light(pencil, t, half, ahead, s, rule, work, scene):
    """Return the light on the chord of a lens at t, see `lens_light`."""
    low, high = max(-half, s.y - s.half_y), min(half, s.y + s.half_y)
    if low >= high:
        return 0.0
    total = 0.0
    n = _number_of_nodes(high - low, s.sigma_y, rule)
    work[Work.LEFT.value] -= n
    for i in range(n):
        y = low + (high - low) * rule.nodes[n - 1, i]
        goal = Vec2(t * ahead.x - y * ahead.y, t * ahead.y + y * ahead.x)
        slope = slope_towards(
            pencil.middle, pencil.normal, pencil.w, pencil.w, pencil.length, goal, scene
        )
        if slope.density > 0.0:
            total += rule.weights[n - 1, i] * slope.density * _passed(slope, pencil, scene)
    return (high - low) * total


@inlined
def disk_light(pencil, near, inside, corner, rule, scene):
    """Return (area, mean density) of the light of a pencil on the whole aperture.

    `inside` is how far the centroid lies inside the view of the centre of the aperture [m]. Within
    `near` [m] of its edge each node is weighted by the share that it sees of the part, the triangle
    of the given corners.
    """
    p, q, r = corner
    total, radius, area = 0.0, scene.target.radius, scene.target.area
    for k in range(len(rule.points)):
        goal = Vec2(radius * rule.points[k, 0], radius * rule.points[k, 1])
        s = slope_towards(
            pencil.middle, pencil.normal, pencil.w, pencil.w, pencil.length, goal, scene
        )
        if s.density > 0.0:
            share = 1.0 if inside > near else share_in_view(p, q, r, s.aim.at, scene)
            total += rule.shares[k] * s.density * (share * _passed(s, pencil, scene))
    return area, total
