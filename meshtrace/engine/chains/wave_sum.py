"""Chains aimed through an exact sum of waves, the limit of ever finer meshes.

Crossings on a mesh of the same sea are the starts; Newton moves each to where the light crosses the
exact surface, and its weight follows from the exact slopes and curvatures there.
`studies.convergence` takes the difference for the error of the mesh.
"""

from __future__ import annotations

import math
from enum import IntEnum

from meshtrace.engine import crossing
from meshtrace.engine.chains.gain import shot_of, weigh, weight_of
from meshtrace.kernels.jit import ZERO, entry, inlined, outlined
from meshtrace.kernels.scene import FLAT_SEA, locate
from meshtrace.kernels.vectors import Vec3, dot, row

_TOLERANCE = 1e-8  # [m]: separates crossings that lie close together at a caustic
_SAME = 1e-6  # [m], crossings nearer to each other are one
_ITERATIONS = 40  # of Newton: more than on a mesh, as no search of facets takes over
_STRIDE = 0.5  # [m], longest step of Newton: a longer one jumps to another wave


class Moved(IntEnum):
    """Counted outcomes of the displacement of a crossing to the exact surface."""

    MOVED = 0  # crossings that add to the score
    LOST = 1  # Newton does not converge, or the crossing has no weight on the mesh
    MERGED = 2  # lead to the same exact crossing as one before


@outlined
def shape_at(waves, x, y):
    """Return (z, z_x, z_y, z_xx, z_xy, z_yy) at (x, y) of waves at time 0.

    Array twin: `meshtrace.surfaces.waves.sum_waves`.
    Elevation z = sum a cos(phase - kx x - ky y) [m], slopes, and second derivatives [m-1], all in
    one pass: sine and cosine are the cost.
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
def _aim_near(x, y, dx, dy, shape, shot, scene):
    """Return the `Aim` of a crossing at (x + dx, y + dy), close to a point of known shape."""
    z, zx, zy, zxx, zxy, zyy = shape
    # Taylor: linear slopes, heights on the tangent. Derivatives are exact in the limit of small
    # steps, and the waves need no further sum.
    slope_x, slope_y = zx + zxx * dx + zxy * dy, zy + zxy * dx + zyy * dy
    p = Vec3(x + dx, y + dy, z + zx * dx + zy * dy)
    return crossing.land_sloped(p, slope_x, slope_y, shot, scene)


@outlined
def _exact_jacobian(x, y, waves, shot, scene):
    """Return (z, `Jacobian`) of a crossing over (x, y).

    As `crossing.jacobian`; the waves are summed once for all three points.
    """
    shape = shape_at(waves, x, y)
    return shape[0], crossing.differences(
        _aim_near(x, y, 0.0, 0.0, shape, shot, scene),
        _aim_near(x, y, crossing.STEP, 0.0, shape, shot, scene),
        _aim_near(x, y, 0.0, crossing.STEP, shape, shot, scene),
    )


@outlined
def _exact_newton(x, y, waves, shot, scene):
    """Return (converged, x, y), the crossing of the exact surface next to (x, y)."""
    for _ in range(_ITERATIONS):
        _, j = _exact_jacobian(x, y, waves, shot, scene)
        ok, dx, dy, size = crossing.newton_step(j, shot, _STRIDE)
        if not ok:
            return False, x, y
        x, y = x - dx, y - dy
        if size < _TOLERANCE:
            return True, x, y
    return False, x, y


@outlined
def _exact_weight(chains, i, x, y, waves, shot, scene):
    """Return |A| I(w) W / |det dX/dOmega| of chain i through a crossing of the exact surface.

    As `gain.weigh` on a mesh, with slopes and curvatures of the waves; symbols as in `gain`.
    """
    # Facet -1: the normal is in the `Aim` already, no random slope is added.
    z, j = _exact_jacobian(x, y, waves, shot, scene)
    p, per_area = Vec3(x, y, z), crossing.solid_angle_per_area(j)
    return weight_of(chains, i, p, j.aim, per_area, FLAT_SEA, shot, scene)[0]


@entry
def move_crossings(chains, arrivals, waves, scene, score, counters):
    """Add the contribution of each chain through the exact surface to its score.

    Array twin: meshes of vanishing spacing.
    Each arrival over the mesh is moved to the exact crossing next to it, and its weight changed
    in proportion, which keeps the multiplicity on the mesh. `arrivals` comes back with the
    crossings moved, nan for those lost. The mesh has no random slopes: the sum of waves leaves none
    out.
    """
    for k in range(len(arrivals)):
        a = arrivals[k]
        i, x, y = a.chain, a.point[0], a.point[1]
        forward = dot(row(chains.tail, i), row(chains.last, i))
        # t = -q.v +- sqrt(...), see `crossing.emission_through`: the open segment t tells which
        # branch it was on
        branch = 1.0 if a.water - chains.path[i] + forward >= 0.0 else -1.0
        shot = shot_of(chains, i, scene, branch, scene.surface.roughness)
        facet = locate(scene.locator, scene.surface, x, y)
        meshed = 0.0
        if facet >= 0:
            meshed = weigh(chains, i, x, y, facet, shot, scene).weight
        converged, x, y = _exact_newton(x, y, waves, shot, scene)
        if not converged or meshed == 0.0:
            counters[Moved.LOST.value] += 1
            a.point[0] = a.point[1] = math.nan  # meets no other crossing
            continue
        # Several crossings of the mesh may lead to one of the exact surface, also with others
        # between them: counted once. Those of a chain follow each other.
        j = k - 1
        while j >= 0 and arrivals[j].chain == i:
            before = arrivals[j].point
            if abs(before[0] - x) + abs(before[1] - y) < _SAME:
                break
            j -= 1
        a.point[0], a.point[1] = x, y
        if j >= 0 and arrivals[j].chain == i:
            counters[Moved.MERGED.value] += 1
            continue
        counters[Moved.MOVED.value] += 1
        # The weight on the mesh keeps the multiplicity by roulette; the ratio of exact to meshed
        # weights replaces the surface.
        score[i] += a.weight * _exact_weight(chains, i, x, y, waves, shot, scene) / meshed


@entry
def direct_light(points, starts, waves, scene, roots, score):
    """Add the unscattered light to each point of the aperture, over all crossings.

    Array twin: rays traced forwards, in the tests.
    `points` are chains without scatterings. Newton starts from every (x, y) of `starts`: the
    facets through which a mesh sends light to the aperture. `roots` is room for the crossings.
    """
    for i in range(len(points.weight)):
        shot = crossing.straight_shot(points.disk[i, 0], points.disk[i, 1], scene)
        n = ZERO
        for k in range(len(starts)):
            ok, x, y = _exact_newton(starts[k, 0], starts[k, 1], waves, shot, scene)
            # starts on several facets lead to one crossing
            if ok and not crossing.is_known(roots, ZERO, n, x, y, shot.branch, _SAME):
                roots[n].x, roots[n].y, roots[n].branch = x, y, shot.branch
                n += 1
                score[i] += _exact_weight(points, i, x, y, waves, shot, scene)
