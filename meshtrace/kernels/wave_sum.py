"""Aiming over the sum of waves itself: what meshes of it converge to.

A mesh of the same sea names the crossings; Newton moves each to where the light crosses the
exact surface, and the exact slopes and curvatures weigh it there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.aiming import Shot, forward_differences, land_sloped, locate
from meshtrace.kernels.chain_gain import (
    _shot,
    _transmit,
    _weigh,
    accepted,
    intensity,
    transmittance,
)
from meshtrace.kernels.jit import entry, inlined, outlined

_STEP = 1e-5  # [m], displacement of a crossing for the derivatives
_TOLERANCE = 1e-8  # [m]: tells crossings apart that a caustic brings close together
_SAME = 1e-6  # [m], crossings nearer to each other are one
_ITERATIONS = 40
_STRIDE = 0.5  # [m], longest step of Newton

# counters
MOVED, LOST, MERGED = range(3)
N_COUNTERS = 3


class Waves(NamedTuple):
    """Plane waves at one instant, z = sum a cos(phase - kx x - ky y)."""

    amplitude: NDArray[np.float64]  # (n,) [m]
    kx: NDArray[np.float64]  # (n,) [rad m-1]
    ky: NDArray[np.float64]
    phase: NDArray[np.float64]  # (n,) at the origin and this instant [rad]


@outlined
def shape_at(waves, x, y):
    """Return elevation, slopes and second derivatives (z, zx, zy, zxx, zxy, zyy) at (x, y).

    Array twin: `meshtrace.surfaces.waves.sum_elevation` and its derivatives.
    All six in one pass: sine and cosine are what costs.
    """
    z = zx = zy = zxx = zxy = zyy = 0.0
    for i in range(len(waves.amplitude)):
        kx, ky = waves.kx[i], waves.ky[i]
        angle = waves.phase[i] - kx * x - ky * y
        c, s = waves.amplitude[i] * math.cos(angle), waves.amplitude[i] * math.sin(angle)
        z += c
        zx += kx * s
        zy += ky * s
        zxx -= kx * kx * c
        zxy -= kx * ky * c
        zyy -= ky * ky * c
    return z, zx, zy, zxx, zxy, zyy


@inlined
def _aim_beside(x, y, dx, dy, shape, shot, scene):
    """Return the `Aim` of a crossing at (x + dx, y + dy), a hair from where the shape is known."""
    z, zx, zy, zxx, zxy, zyy = shape
    slope_x, slope_y = zx + zxx * dx + zxy * dy, zy + zxy * dx + zyy * dy
    height = z + zx * dx + zy * dy
    return land_sloped(x + dx, y + dy, height, slope_x, slope_y, shot, scene)


@outlined
def _exact_jacobian(x, y, waves, shot, scene):
    """Return (ok, aim, z, dX/dP, d(wx, wy)/dP) of a crossing over (x, y).

    As `aiming.jacobian`; the waves are summed once for all three points.
    """
    shape = shape_at(waves, x, y)
    m = _aim_beside(x, y, 0.0, 0.0, shape, shot, scene)
    a = _aim_beside(x, y, _STEP, 0.0, shape, shot, scene)
    b = _aim_beside(x, y, 0.0, _STEP, shape, shot, scene)
    return (m.ok and a.ok and b.ok, m, shape[0], *forward_differences(m, a, b, _STEP))


@outlined
def _exact_newton(x, y, waves, shot, scene):
    """Return (found, x, y): the crossing of the exact surface next to (x, y)."""
    for _ in range(_ITERATIONS):
        ok, m, _z, a, b, c, d, _1, _2, _3, _4 = _exact_jacobian(x, y, waves, shot, scene)
        det = a * d - b * c
        if not ok or det == 0.0:
            return False, x, y
        f1, f2 = m.x1 - shot.x1, m.x2 - shot.x2
        sx, sy = (d * f1 - b * f2) / det, (a * f2 - c * f1) / det
        size = math.sqrt(sx * sx + sy * sy)
        if size > _STRIDE:
            sx, sy = sx * _STRIDE / size, sy * _STRIDE / size
        x, y = x - sx, y - sy
        if size < _TOLERANCE:
            return True, x, y
    return False, x, y


@outlined
def _exact_weight(chains, i, x, y, waves, shot, scene):
    """Return |A| I(w) W / |det dX/dOmega| of chain i through a crossing of the exact surface.

    As the weight on a mesh, `forced._weigh`, but for slopes and curvatures of the waves.
    """
    ok, m, z, a, b, c, d, wa, wb, wc, wd = _exact_jacobian(x, y, waves, shot, scene)
    spread = abs(a * d - b * c)
    if not ok or m.wz <= -0.999999 or spread == 0.0 or not accepted(m, x, y, z, scene):
        return 0.0
    solid_angle = abs(wa * wd - wb * wc) / (abs(m.wz) * spread)
    light = intensity(scene.emitter, m.wx, m.wy, m.wz) * transmittance(m, scene)
    w, _ = _transmit(chains, i, m, x, y, z, scene)
    return math.pi * scene.target.radius**2 * light * solid_angle * w * chains.weight[i]


@entry
def move_crossings(chains, arrivals, waves, scene, score, counters):
    """Add to `score` what each chain brings through the exact surface.

    Array twin: meshes of vanishing spacing.
    Each arrival over the mesh is moved to the exact crossing next to it, and its weight changed
    in proportion, which keeps how often the mesh counted it. `arrivals` comes back with the
    crossings moved. The mesh has no random slopes: the sum of waves leaves none out.
    """
    for k in range(len(arrivals)):
        row = arrivals[k]
        i = int(row[0])
        q, v = chains.tail[i], chains.last[i]
        along = q[0] * v[0] + q[1] * v[1] + q[2] * v[2]
        branch = 1.0 if row[2] - chains.path[i] + along >= 0.0 else -1.0
        facet = locate(scene.locator, scene.surface, row[5], row[6])
        meshed = 0.0
        if facet >= 0:
            meshed = _weigh(chains, i, (row[5], row[6], float(facet), branch), scene)[0]
        shot = _shot(chains, i, scene.target, branch, scene.surface.roughness)
        found, x, y = _exact_newton(row[5], row[6], waves, shot, scene)
        if not found or meshed == 0.0:
            counters[LOST] += 1
            continue
        row[5], row[6] = x, y
        if k > 0 and arrivals[k - 1, 0] == row[0] and _near(arrivals[k - 1, 5:7], x, y):
            counters[MERGED] += 1
            continue
        counters[MOVED] += 1
        score[i] += row[1] * _exact_weight(chains, i, x, y, waves, shot, scene) / meshed


@inlined
def _near(point, x, y):
    return abs(point[0] - x) + abs(point[1] - y) < _SAME


@entry
def direct_light(points, starts, waves, scene, ray, forward, found, score):
    """Write the unscattered light through all crossings that land on each point.

    Array twin: rays traced forwards, in the tests.
    `points` are chains without scatterings. Newton starts from every (x, y) of `starts`: the
    facets through which a mesh sends light to the aperture. `found` is room for the crossings.
    """
    radius = scene.target.radius
    for i in range(len(points.weight)):
        x1, x2 = radius * points.disk[i, 0], radius * points.disk[i, 1]
        shot = Shot(ray, forward, x1, x2, 1.0, 0.0, 0.0)
        n = 0
        for k in range(len(starts)):
            ok, x, y = _exact_newton(starts[k, 0], starts[k, 1], waves, shot, scene)
            for j in range(n):
                ok = ok and not _near(found[j], x, y)
            if ok:
                found[n, 0], found[n, 1] = x, y
                n += 1
                score[i] += _exact_weight(points, i, x, y, waves, shot, scene)
