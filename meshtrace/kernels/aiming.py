"""Aiming: the emission directions that land a chain on a point of an aperture.

The unknown is not the direction but the point P where the light crosses the surface. For any P
there is one emission direction w whose minimal rotation R(w) (e_z to w) carries the chain's
open segment through P, in closed form: R turns about a horizontal axis, so it keeps the
components along that axis, and the distance |P| from the source fixes the point of the segment.
From P on Snell's law gives the landing point X(P). Newton steps on a facet's plane solve
X(P) = x; two small displacements of P give dX/dP and dw/dP together, hence dX/dOmega.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.facets import (
    Surface,
    corners,
    inside_facet,
    normal_at,
    tilted,
)
from meshtrace.kernels.interface import Interface, transmit
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.vectors import (
    ORIGIN,
    UP,
    Vec2,
    Vec3,
    along,
    dot,
    minus,
    minus2,
    row,
    scaled,
)

FLAT_SEA = np.int64(-1)
"""Facet that stands for a flat sea; of the type of all facets, so that kernels compile once."""

STEP = 1e-5  # [m], displacement of P for the derivatives
_TOLERANCE = 1e-4  # [m], step of P behind which the error is its square
_ITERATIONS = 12
MARGIN = 1.3  # on first-order bounds, for the higher orders

FACET = np.dtype(
    [
        ("radius", float),  # [m], from the centroid
        ("curvature", float),  # largest change of slope along an edge [m-1]
        ("x", float),  # centroid
        ("y", float),
        ("z", float),
        ("slope_x", float),
        ("slope_y", float),
    ]
)
"""Summary of a facet, see `facet_summary`."""

FLAT = np.dtype(
    [
        ("x", float),
        ("y", float),
        ("branch", float),  # see `Shot`; 0: no crossing
        ("low", float),  # smallest and largest stretch of dX/dP
        ("high", float),
        ("lever", float),  # |dX / dslope| [m]
        ("lift", float),  # |dX / dz|
        ("level", float),  # height of the flat sea [m]
        ("m11", float),  # dP / dslope [m]
        ("m12", float),
        ("m21", float),
        ("m22", float),
        ("h1", float),  # dP / dz
        ("h2", float),
    ]
)
"""A crossing of a flat sea, and its displacement by slopes and heights."""

ROOT = np.dtype(
    [
        ("x", float),
        ("y", float),
        ("branch", float),
        ("facet", np.int64),
        ("multiplicity", float),  # number of crossings that it stands for
    ]
)
"""A crossing of the surface that lands on the point aimed at."""


class Target(NamedTuple):
    """An aperture, its plane, and the region of crossings to it."""

    center: Vec3
    axis: Vec3
    e1: Vec3  # unit vectors in the plane of the aperture
    e2: Vec3
    radius: float
    cos_half_fov: float
    tan_half_fov: float
    reach: float  # largest horizontal distance of a crossing inside the field of view [m]
    sin_widest: float  # sine of the largest angle of accepted light from the vertical


class Locator(NamedTuple):
    """Square bins over (x, y) with lists of their facets, to locate the facet over a point."""

    x: float
    y: float
    step: float
    nx: int
    ny: int
    start: NDArray[np.int64]  # (nx * ny + 1,)
    facet: NDArray[np.int32]


class Emitter(NamedTuple):
    """A point source: position, axis and angular distribution."""

    position: Vec3
    axis: Vec3
    kind: int  # SourceKind
    spread: float  # Lambertian order or divergence half-angle [rad]
    norm: float  # intensity on the axis [sr-1]


class Scene(NamedTuple):
    """One source, one surface and one aperture."""

    emitter: Emitter
    target: Target
    surface: Surface
    locator: Locator
    facets: NDArray[np.void]  # (m,) FACET
    medium: Medium
    interface: Interface


class Shot(NamedTuple):
    """The open segment of a chain and the point aimed at."""

    q: Vec3  # last vertex, relative to the source
    v: Vec3  # direction
    goal: Vec2  # point in the plane of the aperture [m]
    branch: float  # +1 or -1, see `emission_through`
    tilt: Vec2  # slopes on top of those of the mesh


class Aim(NamedTuple):
    """One evaluation of the map from crossing point to landing point."""

    ok: bool
    at: Vec2  # landing point in the plane of the aperture, from its centre [m]
    w: Vec3  # emission direction
    d: Vec3  # direction in the water at the crossing
    r: Vec3  # direction in the air
    rho: float
    length: float  # of the open segment [m]
    flight: float  # in the air [m]


class Jacobian(NamedTuple):
    """The map near a crossing: dX/dP = ((a, b), (c, d)), d(w_x, w_y)/dP = ((wa, wb), (wc, wd))."""

    ok: bool
    aim: Aim
    a: float
    b: float
    c: float
    d: float
    wa: float
    wb: float
    wc: float
    wd: float


@inlined
def emission_through(q, v, p, branch):
    """Return (ok, t, w, d): emission direction w of the chain through P, and its direction d there.

    Array twin: `tests/kernels/test_aiming.py` builds R(w) and compares R (q + t v) with P.
    P is relative to the source. `branch` +1 is the forward intersection of the open segment
    with the sphere of radius |P|, -1 the near one, which exists when q lies outside.
    """
    qv = dot(q, v)
    disc = qv * qv - dot(q, q) + p.x * p.x + p.y * p.y + p.z * p.z
    if disc < 0.0:
        return False, 0.0, UP, v
    t = -qv + branch * math.sqrt(disc)
    if t <= 0.0:
        return False, 0.0, UP, v
    y = along(q, v, t)
    hx, hy = p.x - y.x, p.y - y.y
    h = math.sqrt(hx * hx + hy * hy)
    if h < 1e-14:
        return p.z * y.z > 0.0, t, UP, v
    kx, ky = -hy / h, hx / h  # horizontal axis of the rotation
    shift = kx * y.x + ky * y.y
    a = Vec3(y.x - shift * kx, y.y - shift * ky, y.z)  # parts of y and P across the axis
    b = Vec3(p.x - shift * kx, p.y - shift * ky, p.z)
    square = dot(a, a)
    if square < 1e-20:
        return False, 0.0, UP, v
    cos_phi = dot(a, b) / square
    # k . (a x b) with k horizontal
    sin_phi = (kx * (a.y * b.z - a.z * b.y) + ky * (a.z * b.x - a.x * b.z)) / square
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

    Array twin: `tests/kernels/test_aiming.py`, against rays traced forwards.
    """
    target, medium = scene.target, scene.medium
    source = scene.emitter.position
    ok, length, w, d = emission_through(shot.q, shot.v, minus(p, source), shot.branch)
    cos_i = dot(d, n)
    cos_t, rho, r = -1.0, 1.0, ORIGIN
    if ok and cos_i > 0.0:
        cos_i = min(cos_i, 1.0)
        cos_t, rho, r = transmit(d, n, cos_i, medium.n_water, medium.n_air, scene.interface)
    facing = dot(r, target.axis)
    if cos_t <= 0.0 or facing <= 1e-9:
        return Aim(False, Vec2(0.0, 0.0), w, d, r, rho, length, 0.0)
    way = minus(target.center, p)
    flight = dot(way, target.axis) / facing
    off = minus(scaled(flight, r), way)
    at = Vec2(dot(off, target.e1), dot(off, target.e2))
    return Aim(flight > 0.0, at, w, d, r, rho, length, flight)


@inlined
def land_sloped(p, slope_x, slope_y, shot, scene):
    """Return the `Aim` of a crossing at P of a surface with these slopes.

    Array twin: see `land`.
    """
    scale = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return land(p, Vec3(-slope_x * scale, -slope_y * scale, scale), shot, scene)


@inlined
def height_on(x, y, facet, surface):
    """Return the height of a facet's plane over (x, y); facet -1 is a flat sea.

    Array twin: barycentric interpolation of the corners.
    """
    if facet < 0:
        return surface.level
    a = row(surface.vertices, surface.faces[facet, 0])
    n = row(surface.face_normals, facet)
    return a.z - ((x - a.x) * n.x + (y - a.y) * n.y) / n.z


@inlined
def aim_at(x, y, facet, shot, scene):
    """Return the `Aim` of a crossing over (x, y) on the plane of a facet.

    Array twin: see `land`.
    Interpolated normals are continued beyond the facet, so that the map for Newton is smooth.
    """
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))  # first: the rest waits for it
    n = UP
    if facet >= 0:
        n = normal_at(x, y, facet, scene.surface)
        if shot.tilt.x != 0.0 or shot.tilt.y != 0.0:
            n = tilted(n, shot.tilt)
    return land(p, n, shot, scene)


@inlined
def locate(locator, surface, x, y):
    """Return the facet over (x, y), -1 outside.

    Array twin: vertical rays of `BruteForceIntersector`.
    """
    i = math.floor((x - locator.x) / locator.step)
    j = math.floor((y - locator.y) / locator.step)
    if i < 0 or j < 0 or i >= locator.nx or j >= locator.ny:
        return FLAT_SEA
    cell = i * locator.ny + j
    for k in range(locator.start[cell], locator.start[cell + 1]):
        f = np.int64(locator.facet[k])
        if inside_facet(x, y, f, surface):
            return f
    return FLAT_SEA


@inlined
def differences(m, a, b):
    """Return the `Jacobian` of `Aim` m from those a step along x (a) and along y (b)."""
    h = 1.0 / STEP
    return Jacobian(
        m.ok and a.ok and b.ok,
        m,
        (a.at.x - m.at.x) * h,
        (b.at.x - m.at.x) * h,
        (a.at.y - m.at.y) * h,
        (b.at.y - m.at.y) * h,
        (a.w.x - m.w.x) * h,
        (b.w.x - m.w.x) * h,
        (a.w.y - m.w.y) * h,
        (b.w.y - m.w.y) * h,
    )


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
    It bounds the crossings of the same chain on a wavy sea.
    """
    j = jacobian(x, y, FLAT_SEA, shot, scene)
    total = j.a * j.a + j.b * j.b + j.c * j.c + j.d * j.d
    det = j.a * j.d - j.b * j.c
    high = math.sqrt(0.5 * (total + math.sqrt(max(total * total - 4.0 * det * det, 0.0))))
    level = scene.surface.level
    h = 1.0 / STEP
    px, py = _moved(land_sloped(Vec3(x, y, level), STEP, 0.0, shot, scene), j.aim, h)
    qx, qy = _moved(land_sloped(Vec3(x, y, level), 0.0, STEP, shot, scene), j.aim, h)
    rx, ry = _moved(land_sloped(Vec3(x, y, level + STEP), 0.0, 0.0, shot, scene), j.aim, h)
    k = 1.0 / det if det != 0.0 else 0.0
    flat.x, flat.y, flat.branch, flat.level = x, y, shot.branch, level
    flat.low, flat.high = abs(det) / high if high > 0.0 else 0.0, high
    flat.lever = math.sqrt(px * px + py * py + qx * qx + qy * qy)
    flat.lift = math.hypot(rx, ry)
    flat.m11, flat.m12 = -(j.d * px - j.b * py) * k, -(j.d * qx - j.b * qy) * k
    flat.m21, flat.m22 = -(j.a * py - j.c * px) * k, -(j.a * qy - j.c * qx) * k
    flat.h1, flat.h2 = -(j.d * rx - j.b * ry) * k, -(j.a * ry - j.c * rx) * k


@inlined
def _moved(moved, m, h):
    return (moved.at.x - m.at.x) * h, (moved.at.y - m.at.y) * h


@inlined
def newton_step(j, shot, longest):
    """Return (ok, step along x and y limited to `longest`, size before that) [m].

    Array twin: numpy.linalg.solve.
    """
    det = j.a * j.d - j.b * j.c
    if not j.ok or det == 0.0:
        return False, 0.0, 0.0, 0.0
    f = minus2(j.aim.at, shot.goal)
    x, y = (j.d * f.x - j.b * f.y) / det, (j.a * f.y - j.c * f.x) / det
    size = math.sqrt(x * x + y * y)
    if size > longest:
        x, y = x * longest / size, y * longest / size
    return True, x, y, size


@outlined
def newton(x, y, facet, fixed, longest, shot, scene):
    """Return (found, x, y, facet): the crossing that lands on a point of the aperture.

    Array twin: `enumerate_roots`, which looks at every facet.
    `fixed` keeps the facet (-1: flat sea); else the facet follows the point. Steps are limited
    to `longest` [m]. Between facets the derivatives jump: a point that does not settle is handed
    to the enumeration by the caller.
    """
    for _ in range(_ITERATIONS):
        ok, dx, dy, size = newton_step(jacobian(x, y, facet, shot, scene), shot, longest)
        if not ok:
            return False, x, y, facet
        x, y = x - dx, y - dy
        if size < _TOLERANCE:
            return True, x, y, facet
        if not fixed:
            facet = locate(scene.locator, scene.surface, x, y)
            if facet < 0:
                return False, x, y, facet
    return False, x, y, facet


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
def enumerate_roots(roots, n, flat, radius, shot, scene):
    """Append every crossing near a flat-sea crossing that lands on the point; return the number.

    Array twin: the roots of the analytic sinusoid in the tests.
    Every facet within `radius` is searched.
    """
    grid = scene.locator
    i0 = max(int((flat.x - radius - grid.x) / grid.step), 0)
    i1 = min(int((flat.x + radius - grid.x) / grid.step), grid.nx - 1)
    j0 = max(int((flat.y - radius - grid.y) / grid.step), 0)
    j1 = min(int((flat.y + radius - grid.y) / grid.step), grid.ny - 1)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(grid.start[i * grid.ny + j], grid.start[i * grid.ny + j + 1]):
                f = np.int64(grid.facet[k])
                if _may_hold(scene.facets[f], flat, shot.tilt):
                    fi, fj = _first_bin(scene.surface, f, grid)
                    if i == max(fi, i0) and j == max(fj, j0):  # no earlier bin lists the facet
                        n = _facet_roots(roots, n, f, flat, shot, scene)
    return n


@inlined
def _may_hold(facet, flat, tilt):
    """Return whether a crossing may lie on a facet, to first order in its slope and height.

    Array twin: `_facet_roots` without it finds the same roots.
    The flat crossing moves by dP/dslope and dP/dz; half of the move is left for the
    higher orders, and the facet's size grows by its curvature.
    """
    sx, sy = facet.slope_x + tilt.x, facet.slope_y + tilt.y
    dz = facet.z - flat.level
    mx, my = flat.m11 * sx + flat.m12 * sy, flat.m21 * sx + flat.m22 * sy
    hx, hy = flat.h1 * dz, flat.h2 * dz
    move = abs(mx) + abs(my) + abs(hx) + abs(hy)
    bend = abs(flat.m11) + abs(flat.m12) + abs(flat.m21) + abs(flat.m22)
    reach = 0.5 * move + 2.0 * facet.radius * (1.0 + bend * facet.curvature)
    ex, ey = flat.x + mx + hx - facet.x, flat.y + my + hy - facet.y
    return ex * ex + ey * ey <= reach * reach


@inlined
def _first_bin(surface, f, grid):
    """Return the lowest bin that a facet overlaps, possibly outside the grid."""
    a, b, c = corners(surface.vertices, f, surface.faces)
    return (
        _bin_of(min(a.x, b.x, c.x), grid.x, grid.step, grid.nx),
        _bin_of(min(a.y, b.y, c.y), grid.y, grid.step, grid.ny),
    )


@inlined
def _bin_of(x, start, step, n):
    """Return the bin of a coordinate, clipped before the conversion to an integer."""
    return math.floor(max(min((x - start) / step, float(n)), -1.0))


@outlined
def corner_shines(f, shot, scene):
    """Return whether light is transmitted at a corner of a facet, but not at its centroid.

    Array twin: fine meshes of the same water in the tests.
    """
    for k in range(3):
        p = row(scene.surface.vertices, scene.surface.faces[f, k])
        if aim_at(p.x, p.y, f, shot, scene).ok:
            return True
    return False


@outlined
def _facet_roots(roots, n, f, flat, shot, scene):
    """Add the roots on facet f.

    If its centroid lands farther from the point than |dX/dP| of a curved surface could bring
    over the facet's size, it holds none. Where a fold of the map runs through a facet there
    may be two: Newton starts from its corners too.
    """
    facet = scene.facets[f]
    x, y = facet.x, facet.y
    m = aim_at(x, y, f, shot, scene)
    bend = flat.lever * facet.curvature
    if m.ok:
        reach = MARGIN * facet.radius * (flat.high + bend)
        if math.hypot(m.at.x - shot.goal.x, m.at.y - shot.goal.y) > reach:
            return n
    elif not corner_shines(f, shot, scene):
        return n
    first = n
    n = _add_root(roots, n, first, x, y, f, shot, scene)
    if not m.ok or (scene.surface.interpolate and bend > 0.5 * flat.high):
        for k in range(3):
            p = row(scene.surface.vertices, scene.surface.faces[f, k])
            n = _add_root(roots, n, first, p.x, p.y, f, shot, scene)
    return n


@inlined
def _add_root(roots, n, first, x, y, f, shot, scene):
    found, x, y, _ = newton(x, y, f, True, 2.0 * scene.facets[f].radius, shot, scene)
    if not found or n >= len(roots) or not inside_facet(x, y, f, scene.surface):
        return n
    if is_known(roots, first, n, x, y, shot.branch, 1e-6):
        return n
    roots[n].x, roots[n].y, roots[n].branch, roots[n].facet = x, y, shot.branch, f
    return n + 1


@inlined
def _span(p, q):
    return math.hypot(p.x - q.x, p.y - q.y)


@inlined
def _bend(m, n):
    return math.hypot(m.x / m.z - n.x / n.z, m.y / m.z - n.y / n.z)


@entry
def facet_summary(surface, out):
    """Write the `FACET` record of each facet.

    Array twin: numpy.linalg.norm over corners.
    The curvature of faceted normals is 0.
    """
    for f in range(len(surface.faces)):
        a, b, c = corners(surface.vertices, f, surface.faces)
        k, m, n = corners(surface.vertex_normals, f, surface.faces)
        x, y, z = (a.x + b.x + c.x) / 3.0, (a.y + b.y + c.y) / 3.0, (a.z + b.z + c.z) / 3.0
        middle = Vec2(x, y)
        out[f].radius = max(_span(a, middle), _span(b, middle), _span(c, middle))
        curvature = max(_bend(k, m) / _span(a, b), _bend(m, n) / _span(b, c))
        curvature = max(curvature, _bend(n, k) / _span(c, a))
        out[f].curvature = curvature if surface.interpolate else 0.0
        out[f].x, out[f].y, out[f].z = x, y, z
        g = row(surface.face_normals, f)
        out[f].slope_x, out[f].slope_y = -g.x / g.z, -g.y / g.z


@entry
def count_bins(surface, grid):
    """Count the facets of each bin into `grid.start[1:]`."""
    for f in range(len(surface.faces)):
        i0, i1, j0, j1 = _bin_range(surface, f, grid)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                grid.start[i * grid.ny + j + 1] += 1


@entry
def fill_bins(surface, grid, cursor):
    """Write the facets of each bin into `grid.facet`; cursor is a copy of `grid.start[:-1]`."""
    for f in range(len(surface.faces)):
        i0, i1, j0, j1 = _bin_range(surface, f, grid)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                cell = i * grid.ny + j
                grid.facet[cursor[cell]] = f
                cursor[cell] += 1


@inlined
def _bin_range(surface, f, grid):
    a, b, c = corners(surface.vertices, f, surface.faces)
    i0, j0 = _first_bin(surface, f, grid)
    i1 = _bin_of(max(a.x, b.x, c.x), grid.x, grid.step, grid.nx)
    j1 = _bin_of(max(a.y, b.y, c.y), grid.y, grid.step, grid.ny)
    return max(i0, 0), min(i1, grid.nx - 1), max(j0, 0), min(j1, grid.ny - 1)
