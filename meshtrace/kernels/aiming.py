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

from meshtrace.kernels.facets import Surface, barycentrics, normal_at, tilted
from meshtrace.kernels.interface import (
    DIRECTION_VECTOR,
    SNELL_PHYSICAL,
    Interface,
    reflectance,
    refract,
    refract_as_printed,
)
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import Medium

_STEP = 1e-5  # [m], displacement of P for the derivatives
_TOLERANCE = 1e-4  # [m], step of P behind which the error is its square
_ITERATIONS = 12
_MARGIN = 1.3  # on first-order bounds, for what is beyond the first order

# columns of Scene.facets
RADIUS, CURVATURE, CX, CY, CZ, SLOPE_X, SLOPE_Y = range(7)
N_FACET_COLUMNS = 7


class Target(NamedTuple):
    """An aperture, its plane, and where crossings to it can lie."""

    center: tuple[float, float, float]
    axis: tuple[float, float, float]
    e1: tuple[float, float, float]  # unit vectors in the plane of the aperture
    e2: tuple[float, float, float]
    radius: float
    cos_half_fov: float
    tan_half_fov: float
    reach: float  # largest horizontal distance of a crossing inside the field of view [m]
    sin_widest: float  # sine of the largest angle of accepted light from the vertical


class Locator(NamedTuple):
    """Square bins over (x, y) that list the facets in each: which facet lies over a point."""

    x: float
    y: float
    step: float
    nx: int
    ny: int
    start: NDArray[np.int64]  # (nx * ny + 1,)
    facet: NDArray[np.int32]


class Emitter(NamedTuple):
    """A point source: where it is and how it shines."""

    position: tuple[float, float, float]
    axis: tuple[float, float, float]
    kind: int
    spread: float  # Lambertian order or divergence half-angle [rad]
    norm: float  # intensity on the axis [sr-1]


class Scene(NamedTuple):
    """What chains are aimed through: one source, one surface, one aperture."""

    emitter: Emitter
    target: Target
    surface: Surface
    locator: Locator
    facets: NDArray[np.float64]  # (m, 7), see `facet_summary`
    medium: Medium
    interface: Interface


class Shot(NamedTuple):
    """The open segment of a chain and the point that it shall land on."""

    q: NDArray[np.float64]  # (3,) last vertex, relative to the source
    v: NDArray[np.float64]  # (3,) direction
    x1: float  # landing point in the plane of the aperture [m]
    x2: float
    branch: float  # +1 or -1, see `emission_through`
    tilt_x: float  # slopes on top of those of the mesh
    tilt_y: float


class Flat(NamedTuple):
    """A crossing of a flat sea, and how slopes and heights move it."""

    x: float
    y: float
    low: float  # smallest and largest stretch of dX/dP
    high: float
    lever: float  # |dX / dslope| [m]
    lift: float  # |dX / dz|
    level: float  # height of the flat sea [m]
    m11: float  # dP / dslope [m]
    m12: float
    m21: float
    m22: float
    h1: float  # dP / dz
    h2: float


class Aim(NamedTuple):
    """One evaluation of the map from crossing point to landing point."""

    ok: bool
    x1: float  # landing point in the plane of the aperture, from its centre [m]
    x2: float
    wx: float  # emission direction
    wy: float
    wz: float
    dx: float  # direction in the water at the crossing
    dy: float
    dz: float
    rx: float  # direction in the air
    ry: float
    rz: float
    cos_t: float
    rho: float
    length: float  # of the open segment [m]
    flight: float  # in the air [m]


@inlined
def emission_through(qx, qy, qz, vx, vy, vz, px, py, pz, branch):
    """Return (ok, t, w, d): emission direction whose chain passes through P, direction there.

    Array twin: `tests/unit/test_aiming.py` builds R(w) and compares R (q + t v) with P.
    P is relative to the source. `branch` +1 is the forward intersection of the open segment
    with the sphere of radius |P|, -1 the near one, which exists when q lies outside.
    """
    qv = qx * vx + qy * vy + qz * vz
    disc = qv * qv - (qx * qx + qy * qy + qz * qz) + px * px + py * py + pz * pz
    if disc < 0.0:
        return False, 0.0, 0.0, 0.0, 1.0, vx, vy, vz
    t = -qv + branch * math.sqrt(disc)
    if t <= 0.0:
        return False, 0.0, 0.0, 0.0, 1.0, vx, vy, vz
    yx, yy, yz = qx + t * vx, qy + t * vy, qz + t * vz
    hx, hy = px - yx, py - yy
    h = math.sqrt(hx * hx + hy * hy)
    if h < 1e-14:
        return pz * yz > 0.0, t, 0.0, 0.0, 1.0, vx, vy, vz
    kx, ky = -hy / h, hx / h  # horizontal axis of the rotation
    along = kx * yx + ky * yy
    ax, ay = yx - along * kx, yy - along * ky  # parts of y and P across the axis
    bx, by = px - along * kx, py - along * ky
    norm = ax * ax + ay * ay + yz * yz
    if norm < 1e-20:
        return False, 0.0, 0.0, 0.0, 1.0, vx, vy, vz
    cos_phi = (ax * bx + ay * by + yz * pz) / norm
    # k . (a x b) with k horizontal
    sin_phi = (kx * (ay * pz - yz * by) + ky * (yz * bx - ax * pz)) / norm
    wx, wy, wz = ky * sin_phi, -kx * sin_phi, cos_phi
    kv = (kx * vx + ky * vy) * (1.0 - cos_phi)
    dx = vx * cos_phi + ky * vz * sin_phi + kx * kv
    dy = vy * cos_phi - kx * vz * sin_phi + ky * kv
    dz = vz * cos_phi + (kx * vy - ky * vx) * sin_phi
    return True, t, wx, wy, wz, dx, dy, dz


@inlined
def land(px, py, pz, nx, ny, nz, q, v, source, target, branch, n1, n2, snell, direction):
    """Return the `Aim` of a crossing at P with unit normal n.

    Array twin: `tests/unit/test_aiming.py`, against rays traced forwards.
    """
    ok, t, wx, wy, wz, dx, dy, dz = emission_through(
        q[0],
        q[1],
        q[2],
        v[0],
        v[1],
        v[2],
        px - source[0],
        py - source[1],
        pz - source[2],
        branch,
    )
    cos_i = dx * nx + dy * ny + dz * nz
    cos_t, rho, rx, ry, rz = -1.0, 1.0, 0.0, 0.0, 0.0
    if ok and cos_i > 0.0:
        cos_i = min(cos_i, 1.0)
        if snell == SNELL_PHYSICAL and direction == DIRECTION_VECTOR:
            cos_t, rx, ry, rz = refract(dx, dy, dz, nx, ny, nz, cos_i, n1, n2)
            if cos_t > 0.0:
                rho = reflectance(cos_i, cos_t, n1, n2)
        else:
            cos_t, rho, rx, ry, rz = refract_as_printed(
                dx, dy, dz, nx, ny, nz, cos_i, n1, n2, snell, direction
            )
    ax, ay, az = target.axis
    along = rx * ax + ry * ay + rz * az
    if cos_t <= 0.0 or along <= 1e-9:
        return Aim(False, 0.0, 0.0, wx, wy, wz, dx, dy, dz, rx, ry, rz, cos_t, rho, t, 0.0)
    cx, cy, cz = target.center[0] - px, target.center[1] - py, target.center[2] - pz
    flight = (cx * ax + cy * ay + cz * az) / along
    ox, oy, oz = flight * rx - cx, flight * ry - cy, flight * rz - cz
    x1 = ox * target.e1[0] + oy * target.e1[1] + oz * target.e1[2]
    x2 = ox * target.e2[0] + oy * target.e2[1] + oz * target.e2[2]
    return Aim(flight > 0.0, x1, x2, wx, wy, wz, dx, dy, dz, rx, ry, rz, cos_t, rho, t, flight)


@inlined
def height_on(x, y, facet, surface):
    """Return the height of a facet's plane over (x, y); facet -1 is a flat sea.

    Array twin: barycentric interpolation of the corners.
    """
    if facet < 0:
        return surface.level
    a = surface.faces[facet, 0]
    n = surface.face_normals[facet]
    return (
        surface.vertices[a, 2]
        - ((x - surface.vertices[a, 0]) * n[0] + (y - surface.vertices[a, 1]) * n[1]) / n[2]
    )


@inlined
def land_from(x, y, z, nx, ny, nz, shot, scene):
    """Return the `Aim` of a crossing at (x, y, z) with a unit normal.

    Array twin: see `land`.
    """
    return land(
        x,
        y,
        z,
        nx,
        ny,
        nz,
        shot.q,
        shot.v,
        scene.emitter.position,
        scene.target,
        shot.branch,
        scene.medium.n_water,
        scene.medium.n_air,
        scene.interface.snell,
        scene.interface.direction,
    )


@inlined
def land_sloped(x, y, z, slope_x, slope_y, shot, scene):
    """Return the `Aim` of a crossing at (x, y, z) of a surface with these slopes.

    Array twin: see `land`.
    """
    scale = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return land_from(x, y, z, -slope_x * scale, -slope_y * scale, scale, shot, scene)


@inlined
def forward_differences(m, a, b, step):
    """Return dX/dP and d(wx, wy)/dP of `Aim` m from those a step along x (a) and along y (b)."""
    h = 1.0 / step
    return (
        (a.x1 - m.x1) * h,
        (b.x1 - m.x1) * h,
        (a.x2 - m.x2) * h,
        (b.x2 - m.x2) * h,
        (a.wx - m.wx) * h,
        (b.wx - m.wx) * h,
        (a.wy - m.wy) * h,
        (b.wy - m.wy) * h,
    )


@inlined
def aim_at(x, y, facet, shot, scene):
    """Return the `Aim` of a crossing over (x, y) on the plane of a facet.

    Array twin: see `land`.
    Interpolated normals are continued beyond the facet, so that Newton sees a smooth map.
    """
    surface = scene.surface
    z = height_on(x, y, facet, surface)
    nx, ny, nz = 0.0, 0.0, 1.0
    if facet >= 0:
        nx, ny, nz = normal_at(x, y, facet, surface)
        if shot.tilt_x != 0.0 or shot.tilt_y != 0.0:
            nx, ny, nz = tilted(nx, ny, nz, shot.tilt_x, shot.tilt_y)
    return land_from(x, y, z, nx, ny, nz, shot, scene)


@inlined
def locate(locator, surface, x, y):
    """Return the facet over (x, y), -1 outside.

    Array twin: vertical rays of `BruteForceIntersector`.
    """
    i = math.floor((x - locator.x) / locator.step)
    j = math.floor((y - locator.y) / locator.step)
    if i < 0 or j < 0 or i >= locator.nx or j >= locator.ny:
        return -1
    cell = i * locator.ny + j
    for k in range(locator.start[cell], locator.start[cell + 1]):
        f = locator.facet[k]
        u, v = barycentrics(x, y, f, surface.vertices, surface.faces)
        if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
            return f
    return -1


@outlined
def jacobian(x, y, facet, shot, scene):
    """Return (ok, aim, dX/dP, d(wx, wy)/dP) at a crossing point, by forward differences.

    Array twin: central differences of `aim_at` in the tests.
    A step of 1e-5 m leaves a relative error of some 1e-6, far below any Monte Carlo error.
    """
    m = aim_at(x, y, facet, shot, scene)
    a = aim_at(x + _STEP, y, facet, shot, scene)
    b = aim_at(x, y + _STEP, facet, shot, scene)
    return (m.ok and a.ok and b.ok, m, *forward_differences(m, a, b, _STEP))


@outlined
def flat_crossing(x, y, shot, scene):
    """Return the `Flat` of a crossing of the flat sea at height `scene.surface.level`.

    Array twin: finite differences of `land` in the tests.
    It tells where on a wavy sea the crossings of the same chain lie.
    """
    _, m, a, b, c, d, _1, _2, _3, _4 = jacobian(x, y, -1, shot, scene)
    total = a * a + b * b + c * c + d * d
    det = a * d - b * c
    high = math.sqrt(0.5 * (total + math.sqrt(max(total * total - 4.0 * det * det, 0.0))))
    level = scene.surface.level
    p = land_sloped(x, y, level, _STEP, 0.0, shot, scene)
    q = land_sloped(x, y, level, 0.0, _STEP, shot, scene)
    r = land_sloped(x, y, level + _STEP, 0.0, 0.0, shot, scene)
    h = 1.0 / _STEP
    p1, p2 = (p.x1 - m.x1) * h, (p.x2 - m.x2) * h
    q1, q2 = (q.x1 - m.x1) * h, (q.x2 - m.x2) * h
    r1, r2 = (r.x1 - m.x1) * h, (r.x2 - m.x2) * h
    k = 1.0 / det if det != 0.0 else 0.0
    return Flat(
        x,
        y,
        abs(det) / high if high > 0.0 else 0.0,
        high,
        math.sqrt(p1 * p1 + p2 * p2 + q1 * q1 + q2 * q2),
        math.hypot(r1, r2),
        level,
        -(d * p1 - b * p2) * k,
        -(d * q1 - b * q2) * k,
        -(a * p2 - c * p1) * k,
        -(a * q2 - c * q1) * k,
        -(d * r1 - b * r2) * k,
        -(a * r2 - c * r1) * k,
    )


@outlined
def newton(x, y, facet, fixed, scale, shot, scene):
    """Return (found, x, y, facet): the crossing that lands on a point of the aperture.

    Array twin: `enumerate_roots`, which looks at every facet.
    `fixed` keeps the facet (-1: flat sea); else the facet follows the point. Steps are limited
    to `scale` [m]. Between facets the derivatives jump: a point that does not settle is handed
    to the enumeration by the caller.
    """
    for _ in range(_ITERATIONS):
        ok, m, a, b, c, d, _1, _2, _3, _4 = jacobian(x, y, facet, shot, scene)
        det = a * d - b * c
        if not ok or det == 0.0:
            return False, x, y, facet
        f1, f2 = m.x1 - shot.x1, m.x2 - shot.x2
        sx, sy = (d * f1 - b * f2) / det, (a * f2 - c * f1) / det
        size = math.sqrt(sx * sx + sy * sy)
        if size > scale:
            sx, sy = sx * scale / size, sy * scale / size
        x, y = x - sx, y - sy
        if size < _TOLERANCE:
            return True, x, y, facet
        if not fixed:
            facet = locate(scene.locator, scene.surface, x, y)
            if facet < 0:
                return False, x, y, facet
    return False, x, y, facet


@inlined
def inside_facet(x, y, facet, surface):
    """Return whether (x, y) lies on a facet, edges included.

    Array twin: `barycentrics`.
    """
    u, v = barycentrics(x, y, facet, surface.vertices, surface.faces)
    return u >= 0.0 and v >= 0.0 and u + v <= 1.0


@outlined
def enumerate_roots(roots, n, flat, radius, shot, scene):
    """Append every crossing near a flat-sea crossing that lands on the point; return the number.

    Array twin: the roots of the analytic sinusoid in the tests.
    Every facet within `radius` is asked.
    """
    grid = scene.locator
    i0 = max(int((flat.x - radius - grid.x) / grid.step), 0)
    i1 = min(int((flat.x + radius - grid.x) / grid.step), grid.nx - 1)
    j0 = max(int((flat.y - radius - grid.y) / grid.step), 0)
    j1 = min(int((flat.y + radius - grid.y) / grid.step), grid.ny - 1)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(grid.start[i * grid.ny + j], grid.start[i * grid.ny + j + 1]):
                f = grid.facet[k]
                if _may_hold(f, flat, shot, scene.facets) and _first_bin(scene, f, i, j, i0, j0):
                    n = _facet_roots(roots, n, f, flat, shot, scene)
    return n


@inlined
def _may_hold(f, flat, shot, facets):
    """Return whether a crossing may lie on a facet, to first order in its slope and height.

    Array twin: `_facet_roots` without it finds the same roots.
    The flat crossing moves by dP/dslope and dP/dz; half of the move is left for what is beyond
    the first order, and the facet's size grows by its curvature.
    """
    sx, sy = facets[f, SLOPE_X] + shot.tilt_x, facets[f, SLOPE_Y] + shot.tilt_y
    dz = facets[f, CZ] - flat.level
    mx, my = flat.m11 * sx + flat.m12 * sy, flat.m21 * sx + flat.m22 * sy
    hx, hy = flat.h1 * dz, flat.h2 * dz
    move = abs(mx) + abs(my) + abs(hx) + abs(hy)
    bend = abs(flat.m11) + abs(flat.m12) + abs(flat.m21) + abs(flat.m22)
    reach = 0.5 * move + 2.0 * facets[f, RADIUS] * (1.0 + bend * facets[f, CURVATURE])
    ex, ey = flat.x + mx + hx - facets[f, CX], flat.y + my + hy - facets[f, CY]
    return ex * ex + ey * ey <= reach * reach


@inlined
def _first_bin(scene, f, i, j, i0, j0):
    """Return whether bin (i, j) is the first of the search that lists facet f."""
    p, t, grid = scene.surface.vertices, scene.surface.faces, scene.locator
    x = min(p[t[f, 0], 0], p[t[f, 1], 0], p[t[f, 2], 0])
    y = min(p[t[f, 0], 1], p[t[f, 1], 1], p[t[f, 2], 1])
    fi = math.floor((x - grid.x) / grid.step)
    fj = math.floor((y - grid.y) / grid.step)
    return i == max(fi, i0) and j == max(fj, j0)


@outlined
def corner_shines(f, shot, scene):
    """Return whether light gets out at a corner of a facet, where none does at its centroid.

    Array twin: fine meshes of the same water in the tests.
    """
    for corner in range(3):
        g = scene.surface.faces[f, corner]
        x, y = scene.surface.vertices[g, 0], scene.surface.vertices[g, 1]
        if aim_at(x, y, f, shot, scene).ok:
            return True
    return False


@outlined
def _facet_roots(roots, n, f, flat, shot, scene):
    """Add the roots on facet f.

    If its centroid lands farther from the point than |dX/dP| of a curved surface could bring
    over the facet's size, it holds none. Where a fold of the map runs through a facet there
    may be two: Newton starts from its corners too.
    """
    x, y, curvature = scene.facets[f, CX], scene.facets[f, CY], scene.facets[f, CURVATURE]
    m = aim_at(x, y, f, shot, scene)
    bend = flat.lever * curvature
    if m.ok:
        reach = _MARGIN * scene.facets[f, RADIUS] * (flat.high + bend)
        if math.hypot(m.x1 - shot.x1, m.x2 - shot.x2) > reach:
            return n
    elif not corner_shines(f, shot, scene):
        return n
    first = n
    n = _add_root(roots, n, first, x, y, f, shot, scene)
    if not m.ok or (scene.surface.interpolate and bend > 0.5 * flat.high):
        for corner in range(3):
            g = scene.surface.faces[f, corner]
            x, y = scene.surface.vertices[g, 0], scene.surface.vertices[g, 1]
            n = _add_root(roots, n, first, x, y, f, shot, scene)
    return n


@inlined
def _add_root(roots, n, first, x, y, f, shot, scene):
    found, x, y, _ = newton(x, y, f, True, 2.0 * scene.facets[f, RADIUS], shot, scene)
    if not found or n >= len(roots) or not inside_facet(x, y, f, scene.surface):
        return n
    for k in range(first, n):
        if abs(roots[k, 0] - x) + abs(roots[k, 1] - y) < 1e-6:
            return n
    roots[n, 0], roots[n, 1], roots[n, 2] = x, y, f
    return n + 1


@entry
def facet_summary(surface, out):
    """Write radius, curvature, centroid and slope of each facet: (m, 7), [m] and [m-1].

    Array twin: numpy.linalg.norm over corners.
    The radius is from the centroid; the curvature is the largest change of slope along an edge
    (none for faceted normals).
    """
    p, t, normals = surface.vertices, surface.faces, surface.vertex_normals
    for f in range(len(t)):
        a, b, c = t[f, 0], t[f, 1], t[f, 2]
        x = (p[a, 0] + p[b, 0] + p[c, 0]) / 3.0
        y = (p[a, 1] + p[b, 1] + p[c, 1]) / 3.0
        radius = curvature = 0.0
        for k in range(3):
            i, j = t[f, k], t[f, (k + 1) % 3]
            radius = max(radius, math.hypot(p[i, 0] - x, p[i, 1] - y))
            m, n = normals[i], normals[j]
            bend = math.hypot(m[0] / m[2] - n[0] / n[2], m[1] / m[2] - n[1] / n[2])
            curvature = max(curvature, bend / math.hypot(p[i, 0] - p[j, 0], p[i, 1] - p[j, 1]))
        g = surface.face_normals[f]
        out[f, RADIUS], out[f, CURVATURE] = radius, curvature if surface.interpolate else 0.0
        out[f, CX], out[f, CY], out[f, CZ] = x, y, (p[a, 2] + p[b, 2] + p[c, 2]) / 3.0
        out[f, SLOPE_X], out[f, SLOPE_Y] = -g[0] / g[2], -g[1] / g[2]


@entry
def count_bins(surface, x, y, step, nx, ny, start):
    """Count the facets of each bin into start[1:], see `Locator`."""
    for f in range(len(surface.faces)):
        i0, i1, j0, j1 = _bin_range(surface, f, x, y, step, nx, ny)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                start[i * ny + j + 1] += 1


@entry
def fill_bins(surface, x, y, step, nx, ny, start, cursor, facet):
    """Write the facets of each bin, see `Locator`; cursor is a copy of start[:-1]."""
    for f in range(len(surface.faces)):
        i0, i1, j0, j1 = _bin_range(surface, f, x, y, step, nx, ny)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                cell = i * ny + j
                facet[cursor[cell]] = f
                cursor[cell] += 1


@inlined
def _bin_range(surface, f, x, y, step, nx, ny):
    a, b, c = surface.faces[f, 0], surface.faces[f, 1], surface.faces[f, 2]
    p = surface.vertices
    i0 = math.floor((min(p[a, 0], p[b, 0], p[c, 0]) - x) / step)
    i1 = math.floor((max(p[a, 0], p[b, 0], p[c, 0]) - x) / step)
    j0 = math.floor((min(p[a, 1], p[b, 1], p[c, 1]) - y) / step)
    j1 = math.floor((max(p[a, 1], p[b, 1], p[c, 1]) - y) / step)
    return max(i0, 0), min(i1, nx - 1), max(j0, 0), min(j1, ny - 1)
