"""The unscattered light: every facet's image on the aperture plane, all crossings at once."""

from __future__ import annotations

import math

from meshtrace.kernels.aiming import (
    CURVATURE,
    CX,
    CY,
    RADIUS,
    Shot,
    aim_at,
    corner_shines,
    height_on,
)
from meshtrace.kernels.chain_gain import accepted, intensity, is_steep, transmittance
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import absorption_path, scattering_path

_EDGE = 0.002  # longest edge of a part whose image is taken for a triangle, over the depth

_ROUNDING = 1e-13  # of the disk's radius squared


@inlined
def solid_angle(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Return the solid angle of a triangle seen from the origin.

    Array twin: van Oosterom and Strackee (1983), eq. 8, in numpy.
    """
    a = math.sqrt(ax * ax + ay * ay + az * az)
    b = math.sqrt(bx * bx + by * by + bz * bz)
    c = math.sqrt(cx * cx + cy * cy + cz * cz)
    triple = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    ab = ax * bx + ay * by + az * bz
    bc = bx * cx + by * cy + bz * cz
    ca = cx * ax + cy * ay + cz * az
    return 2.0 * math.atan2(abs(triple), a * b * c + ab * c + bc * a + ca * b)


@inlined
def _triangle(px, py, qx, qy):
    """Return signed area and first moments of the triangle (origin, p, q)."""
    area = 0.5 * (px * qy - py * qx)
    return area, area * (px + qx) / 3.0, area * (py + qy) / 3.0


@inlined
def _sector(px, py, qx, qy, r):
    """Return signed area and first moments of the sector of the disk r between two rays."""
    angle = math.atan2(px * qy - py * qx, px * qx + py * qy)
    p, q = r / math.hypot(px, py), r / math.hypot(qx, qy)
    k = r * r / 3.0
    return 0.5 * r * r * angle, k * (q * qy - p * py), k * (p * px - q * qx)


@inlined
def _edge_part(ax, ay, bx, by, r):
    """Return signed area and moments common to the disk r and the triangle (origin, a, b)."""
    dx, dy = bx - ax, by - ay
    d2 = dx * dx + dy * dy
    if d2 == 0.0 or ax * by == ay * bx:
        return 0.0, 0.0, 0.0
    along = ax * dx + ay * dy
    disc = along * along - d2 * (ax * ax + ay * ay - r * r)
    if disc <= 0.0:
        return _sector(ax, ay, bx, by, r)
    root = math.sqrt(disc)
    t0, t1 = max((-along - root) / d2, 0.0), min((-along + root) / d2, 1.0)
    if t0 >= t1:
        return _sector(ax, ay, bx, by, r)
    px, py = ax + t0 * dx, ay + t0 * dy
    qx, qy = ax + t1 * dx, ay + t1 * dy
    area, mx, my = _triangle(px, py, qx, qy)
    if t0 > 0.0:
        s, sx, sy = _sector(ax, ay, px, py, r)
        area, mx, my = area + s, mx + sx, my + sy
    if t1 < 1.0:
        s, sx, sy = _sector(qx, qy, bx, by, r)
        area, mx, my = area + s, mx + sx, my + sy
    return area, mx, my


@inlined
def disk_overlap(ax, ay, bx, by, cx, cy, r):
    """Return area and centroid of what a triangle and the disk r about the origin share.

    Array twin: Monte Carlo areas in the tests.
    Green's theorem: the sum over the edges of the signed parts seen from the origin.
    """
    a0, x0, y0 = _edge_part(ax, ay, bx, by, r)
    a1, x1, y1 = _edge_part(bx, by, cx, cy, r)
    a2, x2, y2 = _edge_part(cx, cy, ax, ay, r)
    area = a0 + a1 + a2
    if abs(area) < _ROUNDING * r * r:  # nothing but rounding, whose centroid may lie anywhere
        return 0.0, 0.0, 0.0
    return abs(area), (x0 + x1 + x2) / area, (y0 + y1 + y2) / area


@outlined
def _light(x, y, f, shot, scene):
    """Return (ok, x1, x2, light per solid angle, steep) of a crossing on facet f."""
    m = aim_at(x, y, f, shot, scene)
    if not m.ok:
        return False, 0.0, 0.0, 0.0, True
    z = height_on(x, y, f, scene.surface)
    light = 0.0
    if accepted(m, x, y, z, scene):
        sx, sy, sz = scene.emitter.position
        tau = absorption_path(scene.medium, sz, z, m.length)
        tau += scattering_path(scene.medium, sx, sy, sz, x, y, z, m.length)
        light = intensity(scene.emitter, m.wx, m.wy, m.wz) * math.exp(-tau)
        light *= transmittance(m, scene)
    return True, m.x1, m.x2, light, is_steep(m, scene)


@entry
def image_gain(scene, stretch, lever, ray, forward, score):
    """Write the unscattered gain through each facet; return the number of doubtful facets.

    Array twin: quadrature over the aperture with the analytic sinusoid.
    The image of a part of a facet is taken for a triangle: its gain is the light in its solid
    angle times the share of the image that lies on the disk. Folds and caustics count
    themselves, since images overlap. `stretch` and `lever` bound |dX/dP| of a flat sea and
    |dX/dslope|. `score[f, 1]` marks facets whose light a wave may cut.
    """
    doubtful = 0
    shot = Shot(ray, forward, 0.0, 0.0, 1.0, 0.0, 0.0)
    edge = min(max(-_EDGE * scene.emitter.position[2], 0.005), 0.1)
    for f in range(len(scene.surface.faces)):
        size = scene.facets[f, RADIUS]
        m = aim_at(scene.facets[f, CX], scene.facets[f, CY], f, shot, scene)
        if m.ok:
            reach = size * (stretch + lever * scene.facets[f, CURVATURE])
            if math.hypot(m.x1, m.x2) > scene.target.radius + reach:
                continue
        elif not corner_shines(f, shot, scene):
            continue
        gain, steep = _facet_gain(f, math.ceil(2.0 * size / edge), shot, scene)
        score[f, 0] = gain
        if gain > 0.0 and not steep:
            score[f, 1] = 1.0
            doubtful += 1
    return doubtful


@outlined
def _facet_gain(f, n, shot, scene):
    """Sum the parts of a facet cut into n^2 triangles."""
    gain, steep = 0.0, True
    for i in range(n):
        for j in range(n - i):
            g, s = _triangle_gain(f, n, i, j, i + 1, j, i, j + 1, shot, scene)
            gain, steep = gain + g, steep and s
            if i + j <= n - 2:
                g, s = _triangle_gain(f, n, i + 1, j + 1, i, j + 1, i + 1, j, shot, scene)
                gain, steep = gain + g, steep and s
    return gain, steep


@inlined
def _corner(f, n, i, j, surface):
    a, b, c = surface.faces[f, 0], surface.faces[f, 1], surface.faces[f, 2]
    p = surface.vertices
    u, v = i / n, j / n
    w = 1.0 - u - v
    return (
        w * p[a, 0] + u * p[b, 0] + v * p[c, 0],
        w * p[a, 1] + u * p[b, 1] + v * p[c, 1],
        w * p[a, 2] + u * p[b, 2] + v * p[c, 2],
    )


@outlined
def _triangle_gain(f, n, ia, ja, ib, jb, ic, jc, shot, scene):
    """Return (gain, steep) of one part of a facet."""
    ax, ay, az = _corner(f, n, ia, ja, scene.surface)
    bx, by, bz = _corner(f, n, ib, jb, scene.surface)
    cx, cy, cz = _corner(f, n, ic, jc, scene.surface)
    a = aim_at(ax, ay, f, shot, scene)
    b = aim_at(bx, by, f, shot, scene)
    c = aim_at(cx, cy, f, shot, scene)
    if not (a.ok and b.ok and c.ok):
        return 0.0, True
    det = (b.x1 - a.x1) * (c.x2 - a.x2) - (b.x2 - a.x2) * (c.x1 - a.x1)
    radius = scene.target.radius
    u = v = 1.0 / 3.0
    if abs(det) < 1e-14:  # a caustic: the image is a point or a line
        share = 1.0 if a.x1 * a.x1 + a.x2 * a.x2 <= radius * radius else 0.0
    else:
        area, x1, x2 = disk_overlap(a.x1, a.x2, b.x1, b.x2, c.x1, c.x2, radius)
        share = 2.0 * area / abs(det)
        u = ((x1 - a.x1) * (c.x2 - a.x2) - (x2 - a.x2) * (c.x1 - a.x1)) / det
        v = ((b.x1 - a.x1) * (x2 - a.x2) - (b.x2 - a.x2) * (x1 - a.x1)) / det
    if share == 0.0:
        return 0.0, True
    # light that is linear in the image has its mean over the overlap at the centroid
    _, _, _, light, steep = _light(
        ax + u * (bx - ax) + v * (cx - ax), ay + u * (by - ay) + v * (cy - ay), f, shot, scene
    )
    sx, sy, sz = scene.emitter.position
    omega = solid_angle(
        ax - sx, ay - sy, az - sz, bx - sx, by - sy, bz - sz, cx - sx, cy - sy, cz - sz
    )
    return omega * share * light, steep
