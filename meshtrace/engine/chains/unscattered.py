"""Unscattered light through smooth facets: the image of each facet on the plane of the aperture.

Light from the source through a facet is a narrow beam, refracted at each corner. A facet is cut
into parts so small that intensity and refraction are linear over each: the image of a part is a
triangle, whose overlap with the disk of the aperture has a closed form. Coordinates of images are
in metres from the centre of the aperture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from meshtrace.engine import crossing
from meshtrace.engine.crossing import transmittance
from meshtrace.kernels.bodies import is_hidden
from meshtrace.kernels.interface import FieldOfView, corners, normal_at
from meshtrace.kernels.jit import ONE, ZERO, entry, inlined, outlined
from meshtrace.kernels.medium import depth_between
from meshtrace.kernels.rays import is_free
from meshtrace.kernels.scene import Scene, Target, height_on
from meshtrace.kernels.sources import SourceKind, beam_width, dark_angle, intensity, is_dark
from meshtrace.kernels.vectors import (
    Vec2,
    Vec3,
    along,
    blend,
    cross,
    cross2,
    dot,
    dot2,
    minus,
    minus2,
    norm,
    unit,
)

# Sizes of parts, tuned: an image's error falls with the square of its size, the time rises with its
# inverse square. `tests/engine/chains/test_unscattered.py` holds the result.
_EDGE = 0.002  # longest edge of a part whose image is taken for a triangle, over the source's depth
BEAM_SHARE = 0.03  # longest edge of a part over the width of the beam: its light is near linear
_GAUSSIAN_SHARE = 0.07  # BEAM_SHARE of Gaussian beams: sums over equal parts converge exponentially
VIEW_SHARE = 0.06  # longest edge of a part at the edge of the view, over the radius of the view
_FINEST = 1.0 / 64.0  # least edge for a narrow view, over the longest of _EDGE: bounds the time
_STRAIGHT = 0.1  # relative change of the stretch of an image along the longest edge of a part
_GRAZING = 0.1  # cosine of the edge of views that accept light along the surface
_FLATTEST = 1e-4  # least cosine of light through such a view: bounds its stretch, else infinite
_MIRROR_SHARE = 0.25  # size of parts in whose image the bounds hold, over the nearer end's distance
_ROUNDING = 1e-13  # share of the disk's squared radius: smaller overlaps are none
STACK = 128
"""Parts of a large facet that wait to be cut: three more at each of 40 halvings."""


class Part(NamedTuple):
    """Part of a facet: a triangle of the grid of n parts along each of its edges.

    All of a facet f is Part(f, n, 0, 0, n).

    Corners are the nodes (i, j), (i + side, j), (i, j + side) of that grid: a part of negative side
    points the other way. Integers name a part exactly, so that neighbours share their corners.
    """

    facet: int | np.int64
    n: int | np.int64
    i: int | np.int64  # steps from the first corner of the facet towards the second
    j: int | np.int64  # and towards the third
    side: int | np.int64


class Corner(NamedTuple):
    """Corner of a part of a facet, and its image."""

    ok: bool
    p: Vec3  # [m]
    at: Vec2  # landing point in the plane of the aperture [m]
    inside: float  # see `view_margin`


class Landing(NamedTuple):
    """Target region of unscattered light, and bounds that rule out parts of facets.

    The region is a square with rounded corners: the disk of an aperture, or a map.
    """

    x: float  # centre of the square, from that of the aperture [m]
    y: float
    half: float  # half of its edge, 0 for a disk [m]
    radius: float  # of the corners [m]
    dark: float  # angle to the axis beyond which the source sends no light [rad]
    coarse: float  # [m], size of a part up to which `stretch` holds
    stretch: float  # largest size of the image of a part, over that of the part


@inlined
def aperture_at(place, scene):
    """Return a scene with its aperture moved to a place.

    Array twin: none, a tuple.
    """
    # compiled code has no `_replace`: `center` and `target` are first and second
    return Scene(scene.emitter, Target(place, *scene.target[1:]), *scene[2:])


@inlined
def spatial_radius(facet):
    """Return the largest distance of a facet's points from its centroid [m].

    Array twin: numpy.linalg.norm over corners.
    """
    return facet.radius * math.sqrt(1.0 + facet.slope_x**2 + facet.slope_y**2)


@inlined
def solid_angle(a, b, c):
    """Return the solid angle of a triangle seen from the origin.

    Array twin: van Oosterom and Strackee (1983), eq. 8, in numpy.
    """
    la, lb, lc = norm(a), norm(b), norm(c)
    triple = dot(a, cross(b, c))
    return 2.0 * math.atan2(
        abs(triple), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    )


@inlined
def _sector(p, q, r):
    """Return signed area [m2] and first moments [m3] of a sector of the disk of radius r about O.

    It lies between the rays from the origin O through p and q.
    """
    # signed, and right for any two rays less than half a turn apart
    angle = math.atan2(cross2(p, q), dot2(p, q))
    s, t = r / math.hypot(p.x, p.y), r / math.hypot(q.x, q.y)
    # first moments r^3 / 3 (sin, -cos) of the azimuth, between both rays; s p, t q lie on the rim
    k = r * r / 3.0
    return 0.5 * r * r * angle, k * (t * q.y - s * p.y), k * (s * p.x - t * q.x)


@inlined
def _edge_part(a, b, r):
    """Return signed area and first moments of the overlap of disk r and triangle (origin, a, b).

    Units are those of `_sector`.
    """
    d = minus2(b, a)
    d2 = dot2(d, d)
    if d2 == 0.0 or a.x * b.y == a.y * b.x:
        return 0.0, 0.0, 0.0
    shift = dot2(a, d)
    disc = shift * shift - d2 * (a.x * a.x + a.y * a.y - r * r)
    if disc <= 0.0:
        return _sector(a, b, r)
    # The edge meets the circle at t0 and t1: a triangle between, sectors outside.
    root = math.sqrt(disc)
    t0, t1 = max((-shift - root) / d2, 0.0), min((-shift + root) / d2, 1.0)
    if t0 >= t1:
        return _sector(a, b, r)
    p, q = Vec2(a.x + t0 * d.x, a.y + t0 * d.y), Vec2(a.x + t1 * d.x, a.y + t1 * d.y)
    area = 0.5 * cross2(p, q)
    mx, my = area * (p.x + q.x) / 3.0, area * (p.y + q.y) / 3.0
    if t0 > 0.0:
        s, sx, sy = _sector(a, p, r)
        area, mx, my = area + s, mx + sx, my + sy
    if t1 < 1.0:
        s, sx, sy = _sector(q, b, r)
        area, mx, my = area + s, mx + sx, my + sy
    return area, mx, my


@inlined
def disk_overlap(a, b, c, r):
    """Return area and centroid of the overlap of a triangle and the disk r about the origin.

    Array twin: Monte Carlo areas in the tests.
    Green's theorem: the sum over the edges of the signed parts seen from the origin.
    """
    a0, x0, y0 = _edge_part(a, b, r)
    a1, x1, y1 = _edge_part(b, c, r)
    a2, x2, y2 = _edge_part(c, a, r)
    area = a0 + a1 + a2
    if abs(area) < _ROUNDING * r * r:  # nothing but rounding, whose centroid may lie anywhere
        return 0.0, Vec2(0.0, 0.0)
    return abs(area), Vec2((x0 + x1 + x2) / area, (y0 + y1 + y2) / area)


@inlined
def view_margin(p, r, flight, target, fov):
    """Return how far a crossing at P lies inside the field of view [m]; negative outside.

    Array twin: its sign is that of `meshtrace.kernels.tally.crosses_aperture`.
    r is the direction in the air.
    """
    if fov == FieldOfView.ANGLE:
        # flight * sin(half - theta) for an arc: exact at the edge, where it decides
        cosine, half = dot(r, target.axis), target.cos_half_fov
        # sin(half - theta) = cos(theta) sin(half) - cos(half) sin(theta)
        inside = cosine * math.sqrt(max(1.0 - half * half, 0.0))
        return flight * (inside - half * math.sqrt(max(1.0 - cosine * cosine, 0.0)))
    reach = target.radius + (target.center.z - p.z) * target.tan_half_fov
    return reach - math.hypot(p.x - target.center.x, p.y - target.center.y)


@inlined
def view_radius(height, target, fov):
    """Return the size of the field of view at a distance along its axis [m].

    For a cone it is its sine times the distance, the scale of `view_margin`.

    Array twin: none, a scale.
    """
    if fov == FieldOfView.ANGLE:
        return height * math.sqrt(max(1.0 - target.cos_half_fov**2, 0.0))
    return target.radius + height * target.tan_half_fov


@inlined
def carried(share, p, m, scene):
    """Return `share` times intensity [sr-1] and transmittances of the surface and the water.

    m is the `Aim` at the crossing p.
    """
    share *= intensity(scene.emitter, m.w) * transmittance(m, scene)
    return share * math.exp(-straight_depth(p, m, scene.emitter.position, scene))


@inlined
def straight_depth(p, m, source, scene):
    """Return the optical depth of unscattered light that crosses at P.

    Array twin: `meshtrace.kernels.medium` along straight ways in the tests.
    In a mirrored scene the water lies behind the crossing, at the heights -z. Light that is
    reflected stays in the air there, and else in the water.
    """
    tau = depth_behind(p, m, scene)
    return tau if scene.mirrored else tau + depth_between(scene.medium, source, p, m.length)


@inlined
def depth_behind(p, m, scene):
    """Return the optical depth of the way from the surface to the aperture, 0 in the air.

    Array twin: see `straight_depth`.
    """
    # on the way on, light is in the water if it came from the air, or else was reflected
    if scene.mirrored == scene.reflects:
        return 0.0
    end = along(p, m.r, m.flight)
    if scene.reflects:
        return depth_between(scene.medium, p, end, m.flight)
    return depth_between(scene.medium, Vec3(p.x, p.y, -p.z), Vec3(end.x, end.y, -end.z), m.flight)


@inlined
def _flat_stretch(m, scene):
    """Return the stretch of the image of a flat sea at a crossing, 1 + (n h / d) (cos i / cos t)^3.

    Of a mirror it is 1 + h / d along the light, and more on an aperture that it meets aslant.

    Array twin: finite differences of the landing point in the tests of light along the surface.
    A narrow view accepts no flatter light than its edge.
    """
    if scene.reflects:
        # the image of a plane mirror on a plane across the light, which meets the aperture aslant
        return (1.0 + m.flight / max(m.length, 1e-9)) / max(dot(m.r, scene.target.axis), _FLATTEST)
    edge = math.sqrt(max(1.0 - scene.target.sin_widest**2, 0.0))
    cos_t = max(m.r.z, edge if edge > _GRAZING else _FLATTEST)
    n = scene.medium.n_water / scene.medium.n_air
    deep, high = m.length * m.d.z, m.flight * m.r.z
    return 1.0 + n * high / max(deep, 1e-9) * (m.d.z / cos_t) ** 3


@entry
def image_gain(scene, facets, longer, stretch, lever, bend, stack, gain):
    """Write the unscattered gain of the given facets.

    Array twin: quadrature over the aperture with the analytic sinusoid.
    The image of a part of a facet is taken for a triangle: its gain is the light in its solid
    angle times the share of the image that lies on the disk. Folds and caustics need no care:
    overlapping images add up. `stretch` and `lever` [m] bound |dX/dP| of a flat sea and
    |dX/dslope|, `bend` [m-1] the relative change of the first (`AimedChains.bounds_of`); `stack` is
    scratch for (STACK, 3) integers. Parts are `longer` times as long as usual: the change of the
    gain tells the error of the usual ones.
    """
    # Beam tracing (Heckbert and Hanrahan 1984; Watt 1990 for caustics of water): a facet's beam is
    # refracted by its corners and clipped by the aperture.
    shot = crossing.straight_shot(0.0, 0.0, scene)
    gaussian = scene.emitter.kind == SourceKind.GAUSSIAN_BEAM
    fine, coarse = part_sizes(_GAUSSIAN_SHARE if gaussian else BEAM_SHARE, bend, scene)
    aperture = 0.0, 0.0, 0.0, scene.target.radius, dark_angle(scene.emitter), coarse
    for f in facets:
        landing = Landing(*aperture, stretch + lever * scene.facets[f].curvature)
        n, top = whole_facet(2.0 * scene.facets[f].radius / (longer * fine), stack)
        total = 0.0
        while top > 0:
            part, top = next_part(f, n, landing, stack, top, shot, scene)
            if part.side != 0:
                triangles, first, second = triangles_of(part, shot, scene)
                of_part = 0.0
                for k in range(triangles):
                    of_part += _image_light(second if k else first, f, shot, scene)
                total += of_part
        gain[f] = unless_hidden(total, f, scene)


@inlined
def part_sizes(share, bend, scene):
    """Return the longest edge of a part, and the size up to which bounds on its image hold [m].

    Array twin: none, lengths.
    `share` is that of the width of the beam; for `bend` see `image_gain`.
    """
    depth = -scene.emitter.position.z
    # 5 mm at least, far below the waves of a mesh; 0.1 m at most, as they bend over that length
    edge = min(max(_EDGE * depth, 0.005), 0.1)
    height = mirror_distance(scene)
    view = VIEW_SHARE * view_radius(height, scene.target, scene.interface.fov)
    # Where light leaves along the surface, only the image of a small part is a triangle, and only
    # over a small part the limit of total reflection is a straight line.
    straight = _STRAIGHT / max(bend, 1e-300)
    fine = min(edge, share * beam_width(scene.emitter) * depth, max(view, _FINEST * edge), straight)
    # The bound on the image is of first order; larger parts are cut without it. 5 and 20 are tuned:
    # light that is missed against time.
    # Light into the denser side is nowhere stretched more than at normal incidence; the image in a
    # mirror changes on the scale of the distances of both ends.
    if scene.reflects:
        return fine, _MIRROR_SHARE * min(depth, height)
    return fine, math.inf if scene.mirrored else min(5.0 * edge, 20.0 * straight)


@inlined
def mirror_distance(scene):
    """Return the least vertical distance of the aperture from the waves, on either side [m].

    Array twin: none, a length.
    """
    z = scene.target.center.z
    return max(scene.surface.low[2] - z if scene.reflects else z - scene.surface.high[2], 1e-6)


@outlined
def unless_hidden(total, f, scene):
    """Return the total light of a facet, or 0 where waves hide the paths to its centroid.

    Array twin: `EmbreeIntersector.intersect`.
    """
    if total == 0.0:
        return total
    p = Vec3(scene.facets[f].x, scene.facets[f].y, scene.facets[f].z)
    slope, below, above = scene.surface.max_slope, scene.emitter.position, scene.target.center
    # One ray to either end serves a whole facet: facets are small, or the water is level and hides
    # nothing.
    for end, is_air in ((below, scene.mirrored), (above, scene.mirrored == scene.reflects)):
        way = minus(p, end)
        steep = abs(way.z) > slope * math.hypot(way.x, way.y)
        if not (steep or (is_air and not scene.interface.follow_second_hit)):
            if not is_free(end, unit(way), norm(way), scene.surface, scene.locator):
                return 0.0
    return total


@inlined
def is_shadowed(p, d, length, scene, bodies):
    """Return whether a body cuts the straight path from p along d over a length.

    Array twin: `kernels.bodies.is_hidden`, in a scene that is not mirrored.
    """
    if bodies is None:  # an argument: the rest is not compiled for links without bodies
        return False
    up = -1.0 if scene.mirrored else 1.0
    return is_hidden(Vec3(p.x, p.y, up * p.z), Vec3(d.x, d.y, up * d.z), length, bodies)


@inlined
def whole_facet(n, stack):
    """Put a facet on a stack; return the least power of two >= n, and the stack's height.

    Array twin: numpy.log2.
    The stack holds (i, j, side) of parts, see `Part`.
    """
    # a power of two: quarters of quarters stay on the grid, down to a side of 1
    parts = 1
    while parts < n:
        parts *= 2
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, parts
    return parts, ONE


@outlined
def next_part(f, n, landing, stack, top, shot, scene):
    """Return the next `Part` of side 1 that may send light to a `Landing`, and the stack's height.

    Array twin: all parts of a facet.
    Larger parts that may send light there are quartered. A part of side 0: the stack is empty.
    """
    while top > 0:
        top -= 1
        part = part_on(stack, top, f, n)
        # the smallest parts of the grid are returned without a test of their own
        if abs(part.side) == 1:
            return part, top
        if _may_shine(part, landing, shot, scene):
            top = push_quarters(stack, top, part)
    return Part(f, n, ZERO, ZERO, ZERO), top


@inlined
def is_out_of_reach(x, y, reach, landing):
    """Return whether a point lies farther than `reach` from the square of a `Landing`.

    Array twin: numpy.maximum.
    """
    dx = max(abs(x - landing.x) - landing.half, 0.0)
    dy = max(abs(y - landing.y) - landing.half, 0.0)
    return dx * dx + dy * dy > reach * reach


@outlined
def _may_shine(part, landing, shot, scene):
    """Return whether unscattered light may reach a `Landing` through a part of a facet."""
    f, p = part.facet, centroid(part, scene.surface)
    share, facet = abs(part.side) / part.n, scene.facets[f]
    # cheap bounds first: beam, then field of view, then the image
    if is_dark(p, spatial_radius(facet) * share, landing.dark, scene.emitter):
        return False
    size, center = facet.radius * share, scene.target.center
    if is_out_of_reach(p.x - center.x, p.y - center.y, scene.target.reach + size, landing):
        return False
    # Bounds on the image hold for small parts. Larger ones are cut in any case, unless all light is
    # totally reflected.
    if size > landing.coarse:
        return not _is_reflected(p, size, f, scene)
    m = crossing.aim_at(p.x, p.y, f, shot, scene)
    if m.ok:
        # Flat light at this crossing may be stretched more than `stretch`, which bounds light that
        # lands; 1.5, tuned, leaves room for higher orders over a part.
        reach = size * max(landing.stretch, 1.5 * _flat_stretch(m, scene))
        if scene.reflects:
            # a change of slope turns the light by twice as much
            turned = 2.0 * m.flight * facet.curvature / max(dot(m.r, scene.target.axis), _FLATTEST)
            reach = size * 1.5 * (_flat_stretch(m, scene) + turned)
        return not is_out_of_reach(m.at.x, m.at.y, landing.radius + reach, landing)
    for q in corners_of(part, scene.surface):
        if crossing.aim_at(q.x, q.y, f, shot, scene).ok:
            return True
    return False


@inlined
def part_on(stack, k, f, n):
    """Return element k of a stack as a `Part` of facet f, whose edges have n parts."""
    return Part(f, n, stack[k, 0], stack[k, 1], stack[k, 2])


@inlined
def push_quarters(stack, top, part):
    """Push the four quarters of a part on a stack; return its height."""
    half = part.side // 2
    for k in range(4):  # one at each corner, and the middle one the other way round
        stack[top, 0] = part.i + (half if k in (1, 3) else 0)
        stack[top, 1] = part.j + (half if k in (2, 3) else 0)
        stack[top, 2] = -half if k == 3 else half
        top += 1
    return top


@inlined
def _is_reflected(p, size, f, scene):
    """Return whether unscattered light is lost by total reflection all over a part of a facet.

    Angles of incidence within `size` of the point p differ from that at p by the angle under
    which the source sees the part, and by the bend of the interpolated normals.
    """
    if scene.reflects:
        return False
    facet, way = scene.facets[f], minus(p, scene.emitter.position)
    slope = math.hypot(facet.slope_x, facet.slope_y)
    seen = size * math.sqrt(1.0 + slope * slope) / norm(way)
    n = normal_at(p.x, p.y, f, scene.surface)
    if seen >= 1.0 or dot(way, n) <= 0.0:
        return False
    # sin(theta_c) = n_air / n_water
    critical = math.asin(min(scene.medium.n_air / scene.medium.n_water, 1.0))
    bend = 2.0 * facet.curvature * size
    return math.acos(dot(way, n) / norm(way)) > critical + math.asin(seen) + bend


@inlined
def subpart(part, m, i, k):
    """Return part k of row i of the m rows that a part is cut into: m^2 parts in all.

    Row i has 2 (m - i) - 1 parts, of either side in turn.
    """
    odd = k % 2
    # in units of the small parts: even ones point as the part does, odd ones lie between them
    x, y, z = i + odd, k // 2 + odd, ONE - 2 * odd
    return Part(
        part.facet,
        m * part.n,
        m * part.i + x * part.side,
        m * part.j + y * part.side,
        z * part.side,
    )


@inlined
def _node(f, n, i, j, surface):
    """Return the point (i, j) of the n parts along two edges of a facet.

    Array twin: barycentrics (i / n, j / n).
    """
    a, b, c = corners(surface.vertices, f, surface.faces)
    return blend(i / n, j / n, a, b, c)


@inlined
def centroid(part, surface):
    """Return the centroid of a part [m]."""
    # a node of the grid three times as fine: exact for all parts
    i, j = 3 * part.i + part.side, 3 * part.j + part.side
    return _node(part.facet, 3 * part.n, i, j, surface)


@inlined
def corners_of(part, surface):
    """Return the three corners of a part [m]."""
    f, n, i, j, side = part
    p, q = _node(f, n, i, j, surface), _node(f, n, i + side, j, surface)
    return p, q, _node(f, n, i, j + side, surface)


@outlined
def triangles_of(part, shot, scene):
    """Return the number of triangles of a part inside the field of view, and their corners.

    Array twin: see `in_view`.
    A part with a corner that sends no light towards the aperture counts for nothing.
    """
    p, q, r = corners_of(part, scene.surface)
    a, b = _corner(p, part.facet, shot, scene), _corner(q, part.facet, shot, scene)
    c = _corner(r, part.facet, shot, scene)
    if not (a.ok and b.ok and c.ok):
        return ZERO, (a, b, c), (a, b, c)
    return in_view(a, b, c)


@inlined
def in_view(a, b, c):
    """Return the number of triangles of a part inside the field of view, and their corners.

    Array twin: the share of random points of a triangle inside the view, in the tests.
    The edge of the view is a straight line between the corners of a part: it leaves none, one or
    two triangles.
    """
    first, second, third = a.inside >= 0.0, b.inside >= 0.0, c.inside >= 0.0
    seen = ZERO + first + second + third
    if seen == 3 or seen == 0:
        return seen // 3, (a, b, c), (a, b, c)
    # Turn the triangle until corner a is the one that the edge of the view parts from both others.
    if first == third:
        a, b, c = b, c, a
    elif first == second:
        a, b, c = c, a, b
    ab, ac = _at_edge(a, b), _at_edge(a, c)
    if seen == 1:
        return ONE, (a, ab, ac), (a, ab, ac)
    # two corners in view: a quadrangle, as two triangles
    return ONE + 1, (ab, b, c), (ab, c, ac)


@inlined
def _corner(p, f, shot, scene):
    """Return the `Corner` at a point P of facet f."""
    m = crossing.aim_at(p.x, p.y, f, shot, scene)
    inside = 0.0
    if m.ok:
        inside = view_margin(p, m.r, m.flight, scene.target, scene.interface.fov)
    return Corner(m.ok, p, m.at, inside)


@inlined
def _at_edge(a, b):
    """Return the corner at the edge of the field of view between two others."""
    # linear interpolation of the margin, which vanishes at the edge
    t = a.inside / (a.inside - b.inside)
    off = minus2(b.at, a.at)
    at = Vec2(a.at.x + t * off.x, a.at.y + t * off.y)
    return Corner(True, along(a.p, minus(b.p, a.p), t), at, 0.0)


@outlined
def _image_light(triangle, f, shot, scene):
    """Return the light through a triangle of facet f that lands on the aperture, as a gain."""
    a, b, c = triangle
    ab, ac = minus2(b.at, a.at), minus2(c.at, a.at)
    det = cross2(ab, ac)
    radius = scene.target.radius
    u = v = 1.0 / 3.0
    if abs(det) < 1e-14:  # [m2], a caustic: the image is a point or a line
        share = 1.0 if dot2(a.at, a.at) <= radius * radius else 0.0
    else:
        area, center = disk_overlap(a.at, b.at, c.at, radius)
        share = 2.0 * area / abs(det)
        # the image is linear: barycentrics of a landing point are those of its crossing
        middle = minus2(center, a.at)
        u, v = cross2(middle, ac) / det, cross2(ab, middle) / det
    if share == 0.0:
        return 0.0
    # light that is linear in the image has its mean over the overlap at the centroid
    middle3 = along(along(a.p, minus(b.p, a.p), u), minus(c.p, a.p), v)
    m = crossing.aim_at(middle3.x, middle3.y, f, shot, scene)
    if not m.ok:
        return 0.0
    p = Vec3(middle3.x, middle3.y, height_on(middle3.x, middle3.y, f, scene.surface))
    source = scene.emitter.position
    if is_shadowed(source, m.w, m.length, scene, scene.bodies):
        return 0.0
    if is_shadowed(p, m.r, m.flight, scene, scene.bodies):
        return 0.0
    omega = solid_angle(minus(a.p, source), minus(b.p, source), minus(c.p, source))
    return omega * share * carried(1.0, p, m, scene)
