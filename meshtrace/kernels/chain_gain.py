"""Forced detection: what each chain brings into the aperture, over one surface."""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.kernels.aiming import (
    _MARGIN,
    Flat,
    Shot,
    enumerate_roots,
    flat_crossing,
    height_on,
    inside_facet,
    jacobian,
    locate,
    newton,
)
from meshtrace.kernels.facets import SMOOTH, exposure, normal_at, slope_tilt
from meshtrace.kernels.interface import FOV_ANGLE, FRESNEL_PAPER_BOTH
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import (
    DEPTH_NONE,
    absorption_path,
    bubble_scattering,
    scattering_path,
    water_coefficients,
)
from meshtrace.kernels.sources import GAUSSIAN, ISOTROPIC, LAMBERTIAN

_AUDIT_FAILED = 0.25  # share of chains without a solution whose facets are all asked

# counters
SOLVED, NO_FLAT, ENUMERATED, EXTRA_ROOTS, BLOCKED = range(5)
N_COUNTERS = 5

N_FLAT_COLUMNS = 14
"""Fields of `Flat`, and the branch (0: no crossing)."""

N_ARRIVAL_COLUMNS = 11


class Search(NamedTuple):
    """How roots are looked for on one surface."""

    audit: float  # share of chains whose facets are all asked; 1 for faceted normals
    slope: float  # steepest slope of the surface
    margin: float  # [m], size of the facets
    widest: float  # [m], no crossing lies farther from the flat one


@inlined
def intensity(emitter, wx, wy, wz):
    """Return the emitted intensity [sr-1] per unit power.

    Array twin: `Led` (m + 1) / (2 pi) cos^m, integrated to 1 in the tests.
    """
    ax, ay, az = emitter.axis
    cos_theta = wx * ax + wy * ay + wz * az
    if emitter.kind == LAMBERTIAN:
        return emitter.norm * cos_theta**emitter.spread if cos_theta > 0.0 else 0.0
    if emitter.kind == ISOTROPIC:
        return emitter.norm
    theta = math.acos(min(max(cos_theta, -1.0), 1.0))
    if emitter.kind == GAUSSIAN:
        # density per solid angle of the sampler: theta Gaussian in the plane
        shape = theta / math.sin(theta) if theta > 1e-6 else 1.0
        return emitter.norm * shape * math.exp(-2.0 * (theta / emitter.spread) ** 2)
    return emitter.norm if theta <= emitter.spread else 0.0


@inlined
def _shot(chains, i, target, branch, roughness):
    """Return the open segment of chain i and the point that it aims at."""
    tilt_x, tilt_y = slope_tilt(roughness, chains.tilt[i, 0], chains.tilt[i, 1])
    return Shot(
        chains.tail[i],
        chains.last[i],
        target.radius * chains.disk[i, 0],
        target.radius * chains.disk[i, 1],
        branch,
        tilt_x,
        tilt_y,
    )


@entry
def flat_crossings(chains, starts, still, raised, out):
    """Write each flat-sea crossing (`Flat` and branch) of each chain.

    Array twin: `tests/unit/test_aiming.py`.
    Flat crossings do not depend on the waves: they are the starts for every surface. `out` has
    room for several of each chain; branch 0 ends them. Chains that turn sharply or reach
    still water before their last scattering are looked for from many `starts` (x, y) and on
    both branches; the others have one crossing, found from below the receiver. A chain that
    ends above still water is looked for on a sea `raised` above every crest.
    """
    depth = -still.emitter.position[2]
    for i in range(len(chains.last)):
        q, v = chains.tail[i], chains.last[i]
        size = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
        forward = q[0] * v[0] + q[1] * v[1] + q[2] * v[2]
        plain = size < 0.95 * depth and forward > 0.8 * size
        n = 0
        for scene in (still, raised):
            for side in range(1 if size < depth else 2):
                for k in range(len(starts)):
                    if n < len(out[i]) and not (n > 0 and plain):
                        shot = _shot(chains, i, scene.target, 1.0 - 2.0 * side, SMOOTH)
                        n = _flat_root(n, starts[k], shot, scene, out[i])
            if n > 0:
                break
        if n < len(out[i]):
            out[i, n, -1] = 0.0


@outlined
def _flat_root(n, start, shot, scene, out):
    """Add the flat-sea crossing that Newton finds from a start, if it is new."""
    found, x, y, _ = newton(start[0], start[1], -1, True, scene.target.center[2], shot, scene)
    if not found:
        return n
    for k in range(n):
        if out[k, -1] == shot.branch and abs(out[k, 0] - x) + abs(out[k, 1] - y) < 1e-4:
            return n
    f = flat_crossing(x, y, shot, scene)
    row = out[n]
    row[0], row[1], row[2], row[3], row[4], row[5], row[6] = (
        f.x,
        f.y,
        f.low,
        f.high,
        f.lever,
        f.lift,
        f.level,
    )
    row[7], row[8], row[9], row[10], row[11], row[12] = f.m11, f.m12, f.m21, f.m22, f.h1, f.h2
    row[13] = shot.branch
    return n + 1


@entry
def contributions(
    chains, flat, audits, search, scene, roots, score, doubtful, rays, arrivals, counters
):
    """Write what each chain brings into the aperture; return (doubtful crossings, rays, arrivals).

    Array twin: the analog estimator.
    Crossings that a wave may cut off before or behind are not scored but listed: `doubtful`
    holds (chain, weight), `rays` the paths to be checked (doubtful crossing, origin,
    direction, length). The caller asks Embree for them. `arrivals` takes, if it has rows,
    (chain, weight, path in water, path in air, doubtful crossing or -1, crossing, emission).
    """
    n_doubt = n_rays = n_arrivals = 0
    for i in range(len(chains.last)):
        n = _find(chains, i, flat[i], audits[i], search, scene, roots, counters)
        for k in range(n):
            w, steep, aim, x, y, z = _weigh(chains, i, roots[k], scene)
            w *= roots[k, 4]
            if w <= 0.0:
                continue
            first = n_rays
            if not steep:
                n_rays = _list_paths(chains, i, aim, x, y, z, n_doubt, scene, rays, n_rays)
            if n_arrivals < len(arrivals):
                row = arrivals[n_arrivals]
                row[0], row[1], row[2], row[3] = i, w, chains.path[i] + aim.length, aim.flight
                row[4] = n_doubt if n_rays > first else -1
                row[5], row[6], row[7] = x, y, z
                row[8], row[9], row[10] = aim.wx, aim.wy, aim.wz
                n_arrivals += 1
            if n_rays > first:
                doubtful[n_doubt, 0], doubtful[n_doubt, 1] = i, w
                n_doubt += 1
            else:
                score[i] += w
    return n_doubt, n_rays, n_arrivals


@entry
def direct_crossings(points, starts, scene, ray, forward, out):
    """Write (found, x, y, z) of unscattered light that lands on points of the unit disk.

    Array twin: `meshtrace.transport.forced.ForcedDetection`, by the images of the facets.
    """
    for i in range(len(points)):
        radius = scene.target.radius
        x1, x2 = radius * points[i, 0], radius * points[i, 1]
        shot = Shot(ray, forward, x1, x2, 1.0, 0.0, 0.0)
        x, y = starts[i, 0], starts[i, 1]
        facet = locate(scene.locator, scene.surface, x, y)
        found = False
        if facet >= 0:
            found, x, y, facet = newton(x, y, facet, False, 1.0, shot, scene)
        out[i, 0] = 1.0 if found else 0.0
        out[i, 1], out[i, 2], out[i, 3] = x, y, height_on(x, y, facet, scene.surface)


@outlined
def _find(chains, i, flat, audit, search, scene, roots, counters):
    """Write the crossings (x, y, facet, branch, multiplicity) of chain i; return their number.

    Newton starts from the flat crossings. More roots, if the sea focuses, are asked for in a
    share of the chains and count by the inverse of that share: unbiased.
    """
    n = 0
    for k in range(len(flat)):
        branch = flat[k, -1]
        if branch == 0.0:
            if k == 0:
                counters[NO_FLAT] += 1
            break
        r = flat[k]
        near = Flat(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11], r[12])
        shot = _shot(chains, i, scene.target, branch, scene.surface.roughness)
        n = _near(n, near, audit, search, shot, scene, roots, counters)
    return n


@outlined
def _near(n, flat, audit, search, shot, scene, roots, counters):
    """Append the crossings that belong to one flat crossing."""
    surface = scene.surface
    waves = max(abs(surface.high[2] - flat.level), abs(surface.low[2] - flat.level))
    slope = search.slope + math.hypot(shot.tilt_x, shot.tilt_y)
    move = _MARGIN * (slope * flat.lever + waves * flat.lift) / max(flat.low, 1e-3)
    radius = min(move + search.margin, search.widest)
    off = math.hypot(flat.x - scene.target.center[0], flat.y - scene.target.center[1])
    if off > scene.target.reach + radius:
        return n  # outside the field of view, whatever the waves do
    if shot.branch > 0.0 and not _reaches(flat, radius, shot, scene):
        return n
    first, share = n, 1.0
    if surface.interpolate:
        x0 = flat.x + flat.m11 * shot.tilt_x + flat.m12 * shot.tilt_y
        y0 = flat.y + flat.m21 * shot.tilt_x + flat.m22 * shot.tilt_y
        found, x, y, facet = False, x0, y0, locate(scene.locator, surface, x0, y0)
        start = facet
        for step in (0.5, 0.1):  # the second time more carefully
            if start >= 0 and not found:
                found, x, y, facet = newton(x0, y0, start, False, step * radius, shot, scene)
                found = found and inside_facet(x, y, facet, surface)
        if found:
            counters[SOLVED] += 1
            n = _add(roots, n, x, y, facet, shot.branch, 1.0)
        # most chains that Newton gives up have no crossing: a quarter of them tells
        share = search.audit if found else max(search.audit, _AUDIT_FAILED)
        if audit >= share:
            return n
    counters[ENUMERATED] += 1
    kept = n
    last = enumerate_roots(roots, n, flat, radius, shot, scene)
    for k in range(n, last):
        kept = _add(roots, kept, roots[k, 0], roots[k, 1], roots[k, 2], shot.branch, 1.0 / share)
    counters[EXTRA_ROOTS] += kept - max(n, first)
    return kept


@inlined
def _reaches(flat, radius, shot, scene):
    """Return whether the open segment of a chain can end on the surface near a flat crossing.

    A segment that goes outwards must start nearer to the source than the surface lies.
    """
    q, v = shot.q, shot.v
    if q[0] * v[0] + q[1] * v[1] + q[2] * v[2] < 0.0:
        return True
    x, y, z = scene.emitter.position
    side = math.hypot(flat.x - x, flat.y - y) + radius
    rise = scene.surface.high[2] - z
    return q[0] * q[0] + q[1] * q[1] + q[2] * q[2] < side * side + rise * rise


@inlined
def _add(roots, n, x, y, facet, branch, multiplicity):
    """Append a crossing unless it is known; return the number of crossings."""
    for k in range(n):
        if roots[k, 3] == branch and abs(roots[k, 0] - x) + abs(roots[k, 1] - y) < 1e-6:
            return n
    if n == len(roots):
        return n
    roots[n, 0], roots[n, 1], roots[n, 2] = x, y, facet
    roots[n, 3], roots[n, 4] = branch, multiplicity
    return n + 1


@inlined
def is_steep(m, scene):
    """Return whether no wave can cut a path off before or behind its crossing.

    Array twin: `_cut` of `meshtrace.transport.forced`, which asks Embree.
    """
    slope = scene.surface.max_slope
    return m.dz > slope * math.hypot(m.dx, m.dy) and (
        not scene.interface.follow_second_hit or m.rz > slope * math.hypot(m.rx, m.ry)
    )


@inlined
def transmittance(m, scene):
    """Return what the surface lets through at a crossing.

    Array twin: `meshtrace.optics.fresnel` and `Whitecaps.transmittance`.
    """
    t = (1.0 - m.rho) * scene.interface.foam_transmittance
    if scene.interface.fresnel == FRESNEL_PAPER_BOTH:
        t *= 1.0 - m.rho
    return t


@inlined
def accepted(m, x, y, z, scene):
    """Return whether light that crosses at (x, y, z) arrives inside the field of view.

    Array twin: `meshtrace.kernels.tally.crosses_aperture`.
    """
    target = scene.target
    if scene.interface.fov == FOV_ANGLE:
        ax, ay, az = target.axis
        norm = math.sqrt(m.rx * m.rx + m.ry * m.ry + m.rz * m.rz)
        return m.rx * ax + m.ry * ay + m.rz * az >= target.cos_half_fov * norm
    reach = target.radius + (target.center[2] - z) * target.tan_half_fov
    return (x - target.center[0]) ** 2 + (y - target.center[1]) ** 2 < reach * reach


@inlined
def _weigh(chains, i, root, scene):
    """Return (weight, steep, aim, crossing) of a crossing of chain i.

    weight = |A| I(w) W / |det dX/dOmega|; `steep`: no wave can cut its paths off.
    """
    x, y, facet = root[0], root[1], int(root[2])
    z = height_on(x, y, facet, scene.surface)
    shot = _shot(chains, i, scene.target, root[3], scene.surface.roughness)
    ok, m, a, b, c, d, wa, wb, wc, wd = jacobian(x, y, facet, shot, scene)
    spread = abs(a * d - b * c)
    if not ok or m.wz <= -0.999999 or spread == 0.0 or not accepted(m, x, y, z, scene):
        return 0.0, True, m, x, y, z
    solid_angle = abs(wa * wd - wb * wc) / (abs(m.wz) * spread)
    light = intensity(scene.emitter, m.wx, m.wy, m.wz) * transmittance(m, scene)
    if shot.tilt_x != 0.0 or shot.tilt_y != 0.0:
        nx, ny, nz = normal_at(x, y, facet, scene.surface)
        light *= exposure(m.dx, m.dy, m.dz, nx, ny, nz, shot.tilt_x, shot.tilt_y)
    w, deep = _transmit(chains, i, m, x, y, z, scene)
    weight = math.pi * scene.target.radius**2 * light * solid_angle * w * chains.weight[i]
    return weight, is_steep(m, scene) and deep, m, x, y, z


@inlined
def turned(m, x, y, z):
    """Return a vector turned by the minimal rotation that takes e_z to the emission direction.

    Array twin: the rotation matrix of the tests.
    """
    along = (-m.wy * x + m.wx * y) / (1.0 + m.wz)
    return (
        x * m.wz + m.wx * z - m.wy * along,
        y * m.wz + m.wy * z + m.wx * along,
        z * m.wz - m.wx * x - m.wy * y,
    )


@inlined
def _transmit(chains, i, m, x, y, z, scene):
    """Return (coefficients of the scatterings times transmittance, all vertices deep)."""
    medium = scene.medium
    sx, sy, sz = scene.emitter.position
    ox, oy, oz = sx, sy, sz
    simple = not medium.layered and medium.depth_mode == DEPTH_NONE
    weight, tau, deep = 1.0, 0.0, True
    for k in range(chains.vertex.shape[1]):
        p = chains.vertex[i, k]
        vx, vy, vz = turned(m, p[0], p[1], p[2])
        vx, vy, vz = vx + sx, vy + sy, vz + sz
        if vz > scene.surface.low[2]:
            deep = False
        if simple:
            weight *= medium.b
        else:
            if chains.kind[i, k] == 1:
                weight *= bubble_scattering(medium, vx, vy, vz)
            else:
                weight *= water_coefficients(medium, vz)[1]
            length = math.sqrt((vx - ox) ** 2 + (vy - oy) ** 2 + (vz - oz) ** 2)
            tau += absorption_path(medium, oz, vz, length)
            tau += scattering_path(medium, ox, oy, oz, vx, vy, vz, length)
        ox, oy, oz = vx, vy, vz
    if simple:
        tau = (medium.a + medium.b) * (chains.path[i] + m.length)
    else:
        tau += absorption_path(medium, oz, z, m.length)
        tau += scattering_path(medium, ox, oy, oz, x, y, z, m.length)
    return weight * math.exp(-tau), deep


@outlined
def _list_paths(chains, i, m, x, y, z, crossing, scene, rays, n):
    """List the straight parts of a path that a wave may cut; return the number of rays.

    A vertex above the highest crest needs no ray of its own: the path to it or from it is cut.
    """
    low, high, slope = scene.surface.low[2], scene.surface.high[2], scene.surface.max_slope
    sx, sy, sz = scene.emitter.position
    ox, oy, oz = sx, sy, sz
    order = chains.vertex.shape[1]
    for k in range(order + 2):
        if k < order:
            p = chains.vertex[i, k]
            ex, ey, ez = turned(m, p[0], p[1], p[2])
            ex, ey, ez = ex + sx, ey + sy, ez + sz
        elif k == order:
            ex, ey, ez = x, y, z
        else:
            if not scene.interface.follow_second_hit:
                break
            ox, oy, oz = x, y, z
            ex, ey, ez = x + m.flight * m.rx, y + m.flight * m.ry, z + m.flight * m.rz
        dx, dy, dz = ex - ox, ey - oy, ez - oz
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        level = max(oz, ez) > low and min(oz, ez) < high
        climbs = dz > slope * math.hypot(dx, dy) and k >= order
        if length > 0.0 and level and not climbs and n < len(rays):
            rays[n, 0] = crossing
            rays[n, 1], rays[n, 2], rays[n, 3] = ox, oy, oz
            rays[n, 4], rays[n, 5], rays[n, 6] = dx / length, dy / length, dz / length
            rays[n, 7] = length
            n += 1
        ox, oy, oz = ex, ey, ez
    return n
