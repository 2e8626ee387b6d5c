"""The point of the surface that sends light from one point to another: a specular manifold walk.

A chain is drawn as if it were emitted along e_z, and is then turned as a whole. The unknown is not
the direction but the point P where the light crosses the surface. For any P there is one emission
direction w whose minimal rotation R(w), which takes e_z to w, carries the chain's open segment, the
ray from its last vertex, through P. It has a closed form: R turns about a horizontal axis, so it
keeps the components along that axis, and the distance |P| from the source fixes the point of the
segment.
From P on Snell's law gives the landing point X(P). Newton steps on a facet's plane solve
X(P) = x; two small displacements of P give dX/dP and dw/dP together, hence dX/dOmega.

A history rotated to end at its detector is known as the track-rotation estimator [1]_, the path
through a refracting mesh with interpolated normals from single scattering [2]_.

Light that leaves the source along a straight way is a chain without a scattering. `newton` finds
one crossing from a start, `enumerate_roots` all near that of a flat sea, facet by facet.

Notation: P crossing, X landing point (on the plane of the aperture, from its centre), w direction
of emission, d direction in the water at P, r direction in the air; q last vertex and v direction of
the open segment, in the frame of the chain, whose emission is along e_z. Lengths are in the unit of
the frame, called m here.

References
----------
.. [1] TREEDE, program IAEA0833 of the NEA Data Bank.
.. [2] B. Walter, S. Zhao, N. Holzschuch and K. Bala, "Single scattering in refractive media with
   triangle mesh boundaries", ACM Transactions on Graphics 28 (2009),
   doi:10.1145/1531326.1531398.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from meshtrace.kernels.interface import (
    FieldOfView,
    FresnelMode,
    corners,
    exposure,
    inside_facet,
    normal_at,
    tilted,
    transmit,
)
from meshtrace.kernels.jit import NO, YES, inlined, outlined, record_type
from meshtrace.kernels.scene import FLAT_SEA, bins_near, height_on, is_first_bin, locate
from meshtrace.kernels.sources import intensity
from meshtrace.kernels.vectors import (
    ORIGIN,
    UP,
    Vec2,
    Vec3,
    along,
    dot,
    minus,
    minus2,
    norm,
    row,
    scaled,
)

STEP = 1e-5  # displacement of P for forward differences [m], of slopes [1] and heights [m], too:
# the derivatives have relative errors near 1e-6
_TOLERANCE = 1e-4  # last step of Newton's method [m]: about its square is left, see `newton`
_ITERATIONS = 12  # of Newton: what takes longer jumps between facets and is searched otherwise

_STRETCHES = ("low", "high", "lever", "lift", "level")
_MOVES = ("m11", "m12", "m21", "m22", "h1", "h2", "c11", "c12", "c21", "c22")
FLAT = record_type([(name, float) for name in ("x", "y", "branch", *_STRETCHES, *_MOVES)])
"""A crossing of a flat sea, and its displacement by slopes and heights.

Branch 0, see `Shot`: no crossing. `low` and `high` are the smallest and the largest stretch
(singular value) of dX/dP, `lever` |dX / dslope| [m], `lift` |dX / dz|, `level` the height of the
flat sea [m]. Displacements of P at a fixed landing point are m = dP / dslope [m], h = dP / dz, and
c = dP / d(x, y) of the aperture's centre: `m12` is that of P_x by the slope along y, and so on.
"""


class Shot(NamedTuple):
    """The open segment of a chain and the point aimed at."""

    start: Vec3  # of the chain
    q: Vec3  # last vertex, relative to the start
    v: Vec3  # direction from q on
    goal: Vec2  # point in the plane of the aperture [m]
    branch: float  # +1 or -1: which intersection with a sphere, see `emission_through`
    tilt: Vec2  # random slopes along x and y, on top of those of the mesh


class Aim(NamedTuple):
    """One evaluation of the map from crossing point to landing point."""

    ok: bool  # False: total reflection, or no light towards the aperture
    at: Vec2  # landing point in the plane of the aperture, from its centre [m]
    w: Vec3  # emission direction
    d: Vec3  # direction in the water at the crossing
    r: Vec3  # direction in the air
    rho: float  # reflectance
    length: float  # of the open segment [m]
    flight: float  # in the air [m]


class Jacobian(NamedTuple):
    """The map near a crossing: dX/dP = ((a, b), (c, d)) and d(w_x, w_y)/dP.

    Rows are components of X and w, columns those of P; P moves on the plane of a facet.
    """

    ok: bool
    aim: Aim
    a: float
    b: float
    c: float
    d: float
    turns: tuple[float, float, float, float]  # d(w_x, w_y)/dP, row by row


@inlined
def emission_through(q, v, p, branch):
    """Return (ok, t, w, d): emission direction w of the chain through P, and its direction d there.

    Array twin: `tests/engine/test_crossing.py` builds R(w) and compares R (q + t v) with P.
    P is relative to the source, t the length of the open segment. `branch` +1 is the far
    intersection of the open segment with the sphere of radius |P|, -1 the near one, which lies
    ahead only if q is outside of the sphere.
    """
    # |q + t v| = |p|: a rotation about the source keeps distances, so the crossing lies where the
    # open segment meets the sphere of radius |P|.
    qv = dot(q, v)
    disc = qv * qv - dot(q, q) + p.x * p.x + p.y * p.y + p.z * p.z
    if disc < 0.0:
        return False, 0.0, UP, v
    t = -qv + branch * math.sqrt(disc)
    if t <= 0.0:
        return False, 0.0, UP, v
    y = along(q, v, t)  # the point of the segment that is to be turned onto P
    hx, hy = p.x - y.x, p.y - y.y
    h = math.sqrt(hx * hx + hy * hy)
    # no rotation: P lies above the point of the segment already; the axis would be 0 / 0
    if h < 1e-14:
        return p.z * y.z > 0.0, t, UP, v
    # The minimal rotation from e_z to w has a horizontal axis k, and k . y = k . P: k is across the
    # horizontal part of P - y.
    kx, ky = -hy / h, hx / h  # horizontal axis of the rotation
    shift = kx * y.x + ky * y.y
    a = Vec3(y.x - shift * kx, y.y - shift * ky, y.z)  # parts of y and P across the axis
    b = Vec3(p.x - shift * kx, p.y - shift * ky, p.z)
    square = dot(a, a)
    # y along the axis (1e-20 m2: to rounding): no rotation about it moves it to P
    if square < 1e-20:
        return False, 0.0, UP, v
    cos_phi = dot(a, b) / square
    # k . (a x b) with k horizontal
    sin_phi = (kx * (a.y * b.z - a.z * b.y) + ky * (a.z * b.x - a.x * b.z)) / square
    # Rodrigues: d = v cos + (k x v) sin + k (k . v)(1 - cos)
    kv = (kx * v.x + ky * v.y) * (1.0 - cos_phi)
    d = Vec3(
        v.x * cos_phi + ky * v.z * sin_phi + kx * kv,
        v.y * cos_phi - kx * v.z * sin_phi + ky * kv,
        v.z * cos_phi + (kx * v.y - ky * v.x) * sin_phi,
    )
    return True, t, Vec3(ky * sin_phi, -kx * sin_phi, cos_phi), d


@inlined
def land(p, n, shot, scene):
    """Return the `Aim` of a crossing at P with unit normal n.

    Array twin: `tests/engine/test_crossing.py`, against rays traced forwards.
    """
    ok, length, w, d = emission_through(shot.q, shot.v, minus(p, shot.start), shot.branch)
    if not ok:
        return Aim(False, Vec2(0.0, 0.0), w, d, ORIGIN, 1.0, length, 0.0)
    return land_from(p, n, w, d, length, scene)


@inlined
def land_from(p, n, w, d, length, scene):
    """Return the `Aim` of light that leaves its source along w and arrives at P along d.

    Array twin: see `land`.
    """
    target, medium = scene.target, scene.medium
    cos_i = dot(d, n)
    cos_t, rho, r = -1.0, 1.0, ORIGIN
    if cos_i > 0.0:
        cos_i = min(cos_i, 1.0)
        cos_t, rho, r = transmit(d, n, cos_i, medium.n_water, medium.n_air, scene.interface)
        if scene.reflects:
            # law of reflection; total reflection has rho = 1 and brings light, too
            r = along(d, n, -2.0 * cos_i)
    leaves = cos_i > 0.0 if scene.reflects else cos_t > 0.0
    facing = dot(r, target.axis)
    # Light along the plane of the aperture, or from behind, lands nowhere on it; neither does
    # light that is to be refracted and is totally reflected. 1e-9 keeps `flight` finite.
    if not leaves or facing <= 1e-9:
        return Aim(False, Vec2(0.0, 0.0), w, d, r, rho, length, 0.0)
    way = minus(target.center, p)
    flight = dot(way, target.axis) / facing  # from P to the plane of the aperture
    off = minus(scaled(flight, r), way)  # from the centre of the aperture to the landing point
    at = Vec2(dot(off, target.e1), dot(off, target.e2))
    return Aim(flight > 0.0, at, w, d, r, rho, length, flight)


@inlined
def land_sloped(p, slope_x, slope_y, shot, scene):
    """Return the `Aim` of a crossing at P of a surface with these slopes.

    Array twin: see `land`.
    """
    # normal (-z_x, -z_y, 1) / norm
    scale = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return land(p, Vec3(-slope_x * scale, -slope_y * scale, scale), shot, scene)


@inlined
def aim_at(x, y, facet, shot, scene):
    """Return the `Aim` of a crossing over (x, y) on the plane of a facet.

    Array twin: see `land`.
    Interpolated normals are continued beyond the facet, so that the map for Newton is smooth.
    """
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))  # first: all that follows needs it
    n = UP
    if facet >= 0:
        n = normal_at(x, y, facet, scene.surface)
        if shot.tilt.x != 0.0 or shot.tilt.y != 0.0:
            n = tilted(n, shot.tilt)
    return land(p, n, shot, scene)


@inlined
def quotients(m, a, b):
    """Return the derivatives (xx, xy, yx, yy) of a vector by x and y, as forward differences.

    It is m at a point, a one step along x from there and b one step along y.
    """
    h = 1.0 / STEP
    return (a.x - m.x) * h, (b.x - m.x) * h, (a.y - m.y) * h, (b.y - m.y) * h


@inlined
def differences(m, a, b):
    """Return the `Jacobian` of `Aim` m from the `Aim` one step along x (a) and along y (b)."""
    ok = m.ok and a.ok and b.ok
    xx, xy, yx, yy = quotients(m.at, a.at, b.at)
    return Jacobian(ok, m, xx, xy, yx, yy, quotients(m.w, a.w, b.w))


@inlined
def emission_per_area(turns, w, spread):
    """Return dOmega / dX [sr m-2], the solid angle of emission per area of landing points.

    `turns`: derivatives of (w_x, w_y) by (P_x, P_y); `spread`: |det dX/dP|. 0 on a caustic.
    """
    # w_x and w_y are coordinates of the sphere: dOmega = dw_x dw_y / |w_z|. The rotation from e_z
    # to w has no axis at w = -e_z: `gain.turned` divides by 1 + w_z.
    if spread == 0.0 or w.z == 0.0 or w.z <= -0.999999:
        return 0.0
    return abs(turns[0] * turns[3] - turns[1] * turns[2]) / (abs(w.z) * spread)


@inlined
def solid_angle_per_area(j):
    """Return `emission_per_area` of a `Jacobian`, 0 where it has none."""
    if not j.ok:
        return 0.0
    return emission_per_area(j.turns, j.aim.w, abs(j.a * j.d - j.b * j.c))


@outlined
def jacobian(x, y, facet, shot, scene):
    """Return the `Jacobian` at a crossing point, by forward differences.

    Array twin: central differences of `aim_at` in the tests.
    A step of 1e-5 m leaves a relative error of some 1e-6, far below any Monte Carlo error.
    """
    return differences(
        aim_at(x, y, facet, shot, scene),
        aim_at(x + STEP, y, facet, shot, scene),
        aim_at(x, y + STEP, facet, shot, scene),
    )


@outlined
def flat_crossing(flat, x, y, shot, scene):
    """Write the `FLAT` record of a crossing of the flat sea at height `scene.surface.level`.

    Array twin: finite differences of `land` in the tests.
    The record bounds the crossings of the same chain on a wavy sea.
    """
    j = jacobian(x, y, FLAT_SEA, shot, scene)
    # Singular values of dX/dP: their squares sum up to the squared Frobenius norm, their product is
    # |det|.
    total = j.a * j.a + j.b * j.b + j.c * j.c + j.d * j.d
    det = j.a * j.d - j.b * j.c
    high = math.sqrt(0.5 * (total + math.sqrt(max(total * total - 4.0 * det * det, 0.0))))
    level = scene.surface.level
    # derivatives of the landing point by the slope along x (p), that along y (q), and the height
    # (r): forward differences
    h = 1.0 / STEP
    px, py = _moved(land_sloped(Vec3(x, y, level), STEP, 0.0, shot, scene), j.aim, h)
    qx, qy = _moved(land_sloped(Vec3(x, y, level), 0.0, STEP, shot, scene), j.aim, h)
    rx, ry = _moved(land_sloped(Vec3(x, y, level + STEP), 0.0, 0.0, shot, scene), j.aim, h)
    k = 1.0 / det if det != 0.0 else 0.0
    flat.x, flat.y, flat.branch, flat.level = x, y, shot.branch, level
    flat.low, flat.high = abs(det) / high if high > 0.0 else 0.0, high
    flat.lever = math.sqrt(px * px + py * py + qx * qx + qy * qy)
    flat.lift = math.hypot(rx, ry)
    # Implicit derivative at a fixed landing point: dP/dslope = -(dX/dP)^-1 dX/dslope, and likewise
    # for the height and the aperture's centre; the inverse of ((a, b), (c, d)) is
    # ((d, -b), (-c, a)) / det.
    flat.m11, flat.m12 = -(j.d * px - j.b * py) * k, -(j.d * qx - j.b * qy) * k
    flat.m21, flat.m22 = -(j.a * py - j.c * px) * k, -(j.a * qy - j.c * qx) * k
    flat.h1, flat.h2 = -(j.d * rx - j.b * ry) * k, -(j.a * ry - j.c * rx) * k
    ax, ay = _relative_change(Vec3(1.0, 0.0, 0.0), j.aim.r, scene.target)
    bx, by = _relative_change(Vec3(0.0, 1.0, 0.0), j.aim.r, scene.target)
    flat.c11, flat.c12 = -(j.d * ax - j.b * ay) * k, -(j.d * bx - j.b * by) * k
    flat.c21, flat.c22 = -(j.a * ay - j.c * ax) * k, -(j.a * by - j.c * bx) * k


@inlined
def _relative_change(move, r, target):
    """Return the change of a landing point, relative to the centre, as the aperture moves.

    The plane cuts the same ray at another point, and the centre moves by `move`.
    """
    off = along(scaled(-1.0, move), r, dot(move, target.axis) / dot(r, target.axis))
    return dot(off, target.e1), dot(off, target.e2)


@inlined
def _moved(moved, m, h):
    """Return the change of the landing point from `Aim` m to `moved`, times h (1 over the step)."""
    return (moved.at.x - m.at.x) * h, (moved.at.y - m.at.y) * h


@inlined
def newton_step(j, shot, longest):
    """Return (ok, dx, dy, size): the next P is P - (dx, dy) [m], a step limited to `longest`.

    Array twin: numpy.linalg.solve.
    `size` is the length of the step before it is limited.
    """
    det = j.a * j.d - j.b * j.c
    if not j.ok or det == 0.0:
        return False, 0.0, 0.0, 0.0
    f = minus2(j.aim.at, shot.goal)
    x, y = (j.d * f.x - j.b * f.y) / det, (j.a * f.y - j.c * f.x) / det
    size = math.sqrt(x * x + y * y)
    # A full step from far off may leave the sea, or jump to the crossing of another wave.
    if size > longest:
        x, y = x * longest / size, y * longest / size
    return True, x, y, size


@outlined
def newton(x, y, facet, fixed, longest, shot, scene):
    """Return (converged, x, y, facet): the crossing that lands on a point of the aperture.

    Array twin: `enumerate_roots`, which looks at every facet.
    `fixed` keeps the facet (-1: flat sea); else the facet follows the point. Steps are limited
    to `longest` [m]. Between facets the derivatives jump: a caller hands a point that does not
    settle to the enumeration.
    """
    # Newton on the specular manifold (Jakob and Marschner 2012), in the plane of the facet.
    for _ in range(_ITERATIONS):
        ok, dx, dy, size = newton_step(jacobian(x, y, facet, shot, scene), shot, longest)
        if not ok:
            return False, x, y, facet
        x, y = x - dx, y - dy
        # Newton converges quadratically: the error left is about size^2 over the radius of
        # curvature, below 1e-8 m for radii of a metre or more.
        if size < _TOLERANCE:
            return True, x, y, facet
        if not fixed:
            facet = locate(scene.locator, scene.surface, x, y)
            if facet < 0:
                return False, x, y, facet
    return False, x, y, facet


MARGIN = 1.3
"""Factor on first-order bounds for the higher orders; tuned: time, or crossings that are missed."""

ROOT = record_type(
    [
        ("x", float),
        ("y", float),
        ("branch", float),
        ("facet", np.int64),
        ("multiplicity", float),  # number of crossings that it stands for
    ]
)
"""A crossing of the surface that lands on the point aimed at."""


@inlined
def is_known(roots, first, last, x, y, branch, tolerance):
    """Return whether a crossing is one of the records first <= k < last.

    Array twin: numpy.abs of differences.
    """
    for k in range(first, last):
        r = roots[k]
        if r.branch == branch and abs(r.x - x) + abs(r.y - y) < tolerance:
            return True
    return False


@outlined
def enumerate_roots(roots, n, flat, radius, close, shot, scene):
    """Append every crossing near a flat-sea crossing that lands on the point; return the number.

    Array twin: the roots of the analytic sinusoid in the tests.
    Every facet within `radius` [m] is searched; `roots` holds n of them before. Where light starts
    `close` to the surface, within few facets, the landing point of the centroid and the size of a
    facet do not bound its light: there Newton runs on the plane of every facet.
    """
    grid = scene.locator
    # Walter et al. (2009) prune a hierarchy of triangles by bounds on normals; bins and first-order
    # bounds serve a surface that is nearly flat.
    i0, i1, j0, j1 = bins_near(flat.x, flat.y, radius, grid)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(grid.start[i * grid.ny + j], grid.start[i * grid.ny + j + 1]):
                f = np.int64(grid.facet[k])
                if not (close or _may_hold(scene.facets[f], flat, shot.tilt)):
                    continue
                # a facet lies in several bins: it is searched in the first of them alone
                if is_first_bin(i, j, i0, j0, f, scene.surface, grid):
                    if close:
                        middle = Vec2(flat.x, flat.y)
                        n = _root_on(roots, n, n, middle, f, radius, shot, scene)
                    else:
                        n = _facet_roots(roots, n, f, flat, shot, scene)
    return n


@inlined
def _may_hold(facet, flat, tilt):
    """Return whether a crossing may lie on a facet, to first order.

    Slope and height at the facet move the flat crossing, by dP/dslope and dP/dz: the facet is kept
    if that ends within `reach` of its centroid. The factors 0.5 and 2 are margins for the higher
    orders; tuned: time, or crossings that are missed.
    """
    sx, sy = facet.slope_x + tilt.x, facet.slope_y + tilt.y
    dz = facet.z - flat.level
    mx, my = flat.m11 * sx + flat.m12 * sy, flat.m21 * sx + flat.m22 * sy
    hx, hy = flat.h1 * dz, flat.h2 * dz
    move = abs(mx) + abs(my) + abs(hx) + abs(hy)
    # per change of slope on the facet, curvature times size, the crossing moves by at most `bend`
    bend = abs(flat.m11) + abs(flat.m12) + abs(flat.m21) + abs(flat.m22)
    reach = 0.5 * move + 2.0 * facet.radius * (1.0 + bend * facet.curvature)
    ex, ey = flat.x + mx + hx - facet.x, flat.y + my + hy - facet.y
    return ex * ex + ey * ey <= reach * reach


@outlined
def corner_shines(f, shot, scene):
    """Return whether light leaves the water, towards the aperture, at any corner of a facet.

    Array twin: fine meshes of the same water in the tests.
    It is asked where the centroid is totally reflecting, which says nothing of the corners.
    """
    for p in corners(scene.surface.vertices, f, scene.surface.faces):
        if aim_at(p.x, p.y, f, shot, scene).ok:
            return True
    return False


@outlined
def _facet_roots(roots, n, f, flat, shot, scene):
    """Append the roots on facet f; return their number.

    The facet is skipped if its centroid lands farther from the goal than landing points can move
    over its size. Where a fold of the map runs through a facet there may be two roots: Newton
    starts from its corners, too.
    """
    facet = scene.facets[f]
    x, y = facet.x, facet.y
    m = aim_at(x, y, f, shot, scene)
    bend = flat.lever * facet.curvature
    if m.ok:
        # Lipschitz bound: per length on the facet the landing point moves by at most |dX/dP| of a
        # flat sea, plus the change of slope times `lever`.
        spread = MARGIN * facet.radius * (flat.high + bend)
        if math.hypot(m.at.x - shot.goal.x, m.at.y - shot.goal.y) > spread:
            return n
    elif not corner_shines(f, shot, scene):
        return n
    first, longest = n, 2.0 * facet.radius
    n = _root_on(roots, n, first, Vec2(x, y), f, longest, shot, scene)
    # a fold may lie where the bend of the normals makes up more than half of the stretch (tuned)
    if not m.ok or (scene.surface.interpolate and bend > 0.5 * flat.high):
        for p in corners(scene.surface.vertices, f, scene.surface.faces):
            n = _root_on(roots, n, first, Vec2(p.x, p.y), f, longest, shot, scene)
    return n


@inlined
def _root_on(roots, n, first, start, f, longest, shot, scene):
    """Append the crossing on facet f that Newton finds from a start (x, y); return the number."""
    converged, x, y, _ = newton(start.x, start.y, f, YES, longest, shot, scene)
    if not converged or not inside_facet(x, y, f, scene.surface):
        return n
    return add_root(roots, n, first, x, y, f, shot.branch, 1.0)


@inlined
def add_root(roots, n, first, x, y, facet, branch, multiplicity):
    """Append a crossing unless it is known from `first` on; return the number of crossings.

    Array twin: list.append.
    """
    # Two facets may both claim a crossing on their edge: to 1e-6 m it is one. The rest of a full
    # array is lost.
    if n == len(roots) or is_known(roots, first, n, x, y, branch, 1e-6):
        return n
    r = roots[n]
    r.x, r.y, r.branch, r.facet, r.multiplicity = x, y, branch, facet, multiplicity
    return n + 1


_BEYOND = 1.0  # [m] beyond the reach of a target: no crossing lies farther from the flat one


class Search(NamedTuple):
    """Extent of the search for roots on one surface."""

    audit: float  # share of chains for which all facets are searched; 1 for faceted normals
    margin: float  # [m], size of the facets
    curvature: float  # largest change of slope along an edge of the facets [m-1]
    still: bool  # whether the surface is level at z = 0: crossings of still water are its own


@inlined
def start_of(emitter, u, v):
    """Return the start of a chain: the source, or the point (u, v) of an extended source."""
    # the same point of the unit disk as on the aperture: chains of an extended downlink need no
    # dimensions of their own for it
    if emitter.radius == 0.0:
        return emitter.position
    side = along(emitter.position, emitter.e1, emitter.radius * u)
    return along(side, emitter.e2, emitter.radius * v)


@inlined
def straight_shot(u, v, scene):
    """Return the `Shot` of unscattered light that belongs to a point (u, v) of the unit disk."""
    goal = Vec2(scene.target.radius * u, scene.target.radius * v)
    return Shot(start_of(scene.emitter, u, v), ORIGIN, UP, goal, 1.0, Vec2(0.0, 0.0))


@inlined
def root_from(x0, y0, radius, shot, scene):
    """Return (converged, x, y, facet): the crossing that Newton finds from a point.

    Array twin: `enumerate_roots`, which searches every facet.
    """
    converged, x, y, facet = False, x0, y0, locate(scene.locator, scene.surface, x0, y0)
    start = facet
    # Long steps first, tuned: nearly all starts converge, and short steps cost iterations.
    for step in (0.5, 0.1):  # longest step over the radius
        if start >= 0 and not converged:
            converged, x, y, facet = newton(x0, y0, start, NO, step * radius, shot, scene)
            converged = converged and inside_facet(x, y, facet, scene.surface)
    return converged, x, y, facet


@inlined
def radius_of(flat, search, shot, scene):
    """Return the largest distance of crossings of the wavy sea from that of the flat one [m].

    Array twin: `enumerate_roots` over all of the sea finds no others.
    """
    surface = scene.surface
    waves = max(abs(surface.high[2] - flat.level), abs(surface.low[2] - flat.level))
    slope = surface.max_slope + math.hypot(shot.tilt.x, shot.tilt.y)
    # |dP| <= (|dX/dslope| |slope| + |dX/dz| |z|) / smallest stretch, from the implicit derivative;
    # near a caustic, where the stretch vanishes, 1e-3 keeps it finite.
    move = MARGIN * (slope * flat.lever + waves * flat.lift) / max(flat.low, 1e-3)
    return min(move + search.margin, scene.target.reach + _BEYOND)


@inlined
def is_steep(m, scene):
    """Return whether no wave can block a path before or after its crossing.

    Array twin: `meshtrace.kernels.rays.is_free` of both ways.
    Both directions are steeper than any slope of the surface.
    """
    slope = scene.surface.max_slope
    return m.d.z > slope * math.hypot(m.d.x, m.d.y) and (
        not scene.interface.follow_second_hit or m.r.z > slope * math.hypot(m.r.x, m.r.y)
    )


@inlined
def transmittance(m, scene):
    """Return the transmittance of the surface at a crossing, or its reflectance in a mirror.

    Array twin: `meshtrace.optics.fresnel` and `Whitecaps.transmittance`.
    """
    interface = scene.interface
    # foam is opaque: it takes its share from either side, of what is reflected, too
    if scene.reflects:
        return m.rho * interface.foam_transmittance
    t = (1.0 - m.rho) * interface.foam_transmittance
    # PAPER_BOTH: that paper applies Fresnel's transmittance at the crossing and in its budget
    if interface.fresnel == FresnelMode.PAPER_BOTH:
        t *= 1.0 - m.rho
    return t


@inlined
def acceptance(m, p, target, fov):
    """Return the weight of arriving light: 1 inside the field of view, else 0.

    Array twin: `meshtrace.kernels.tally.crosses_aperture`.
    A lamp that is reached backwards weighs by its intensity over the cosine on its plane.
    """
    if target.is_lamp:
        return intensity(target.lamp, scaled(-1.0, m.r)) / dot(m.r, target.axis)
    if fov == FieldOfView.ANGLE:
        seen = dot(m.r, target.axis) >= target.cos_half_fov * norm(m.r)
    else:
        # by the crossing: inside the cone of the view about a vertical axis, at the height of P
        reach = target.radius + (target.center.z - p.z) * target.tan_half_fov
        seen = (p.x - target.center.x) ** 2 + (p.y - target.center.y) ** 2 < reach * reach
    return 1.0 if seen else 0.0


@inlined
def forwards(m, p, facet, tilt, surface):
    """Return the exposure of a facet to light from the air, relative to that to light from below.

    Array twin: the analog photon from a lamp in the air.
    A facet of normal g takes |a.g| of the flux along a in the air, and |w.g| of that along w in the
    water; refraction at the tilted normal s conserves flux between areas |a.s| and |w.s|. Light
    comes from the air, so that its direction a counts in the exposure to tilts.
    """
    if facet < 0:
        return 1.0
    n, g = normal_at(p.x, p.y, facet, surface), row(surface.face_normals, facet)
    s = tilted(n, tilt)
    # chains run from the water to the air: m.d is w, m.r is a, against the light
    below, above = dot(m.d, g) * dot(m.r, s), dot(m.r, g) * dot(m.d, s)
    return exposure(m.r, n, tilt) * above / below if below > 0.0 and above > 0.0 else 0.0


@inlined
def passed(share, m, p, n, facet, tilt, scene):
    """Multiply `share` by the part of light that a crossing at P lets pass.

    Array twin: the analog photon.
    The part is a product of acceptance, transmittance and exposure to `tilt`, the random slope; n
    is the normal of the mesh without it.
    """
    share *= acceptance(m, p, scene.target, scene.interface.fov)
    if share == 0.0:
        return 0.0
    share *= transmittance(m, scene)
    if scene.target.is_lamp:
        return share * forwards(m, p, facet, tilt, scene.surface)
    if tilt.x != 0.0 or tilt.y != 0.0:
        share *= exposure(m.d, n, tilt)
    return share
