"""Forced detection: contribution of each chain to the aperture over one surface."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.aiming import (
    FLAT_SEA,
    MARGIN,
    Shot,
    enumerate_roots,
    flat_crossing,
    height_on,
    is_known,
    jacobian,
    locate,
    newton,
)
from meshtrace.kernels.facets import SMOOTH, exposure, inside_facet, normal_at, slope_tilt
from meshtrace.kernels.interface import FieldOfView, FresnelMode
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import (
    DepthMode,
    absorption_path,
    bubble_scattering,
    scattering_path,
    water_coefficients,
)
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.vectors import (
    ORIGIN,
    UP,
    Vec2,
    Vec3,
    along,
    dot,
    minus,
    norm,
    plus,
    row,
    write,
)

_FOCUSING = 0.5  # change of the landing point by curvature, over that by the way, that is much
_AUDIT_FAILED = 0.25  # share of chains without a solution whose facets are all searched

RAY = np.dtype(
    [
        ("crossing", np.int64),  # row of `Output.doubtful`
        ("origin", float, (3,)),
        ("direction", float, (3,)),
        ("length", float),
    ]
)
"""A straight part of a path that a wave may cut."""

DOUBT = np.dtype([("chain", np.int64), ("weight", float)])
"""A crossing that counts only if no wave cuts its path."""

ARRIVAL = np.dtype(
    [
        ("chain", np.int64),
        ("weight", float),
        ("water", float),  # path in the water [m]
        ("air", float),
        ("doubt", np.int64),  # row of `Output.doubtful`, or -1
        ("point", float, (3,)),  # crossing [m]
        ("emission", float, (3,)),  # direction
    ]
)
"""Contribution of a chain to the aperture."""


class Counter(IntEnum):
    """Counted outcomes of the search."""

    SOLVED = 0
    NO_FLAT = 1
    ENUMERATED = 2
    EXTRA_ROOTS = 3
    BLOCKED = 4


class Search(NamedTuple):
    """Extent of the search for roots on one surface."""

    audit: float  # share of chains whose facets are all searched; 1 for faceted normals
    slope: float  # steepest slope of the surface
    margin: float  # [m], size of the facets
    widest: float  # [m], no crossing lies farther from the flat one
    curvature: float  # largest change of slope along an edge of the facets [m-1]


class Output(NamedTuple):
    """Results of `contributions`, and its room for the crossings of one chain."""

    score: NDArray[np.float64]  # (chains,)
    doubtful: NDArray[np.void]  # DOUBT
    rays: NDArray[np.void]  # RAY
    arrivals: NDArray[np.void]  # ARRIVAL; no rows: not kept
    counters: NDArray[np.int64]  # by `Counter`
    roots: NDArray[np.void]  # ROOT


@inlined
def intensity(emitter, w):
    """Return the emitted intensity [sr-1] per unit power.

    Array twin: `Led` (m + 1) / (2 pi) cos^m, integrated to 1 in the tests.
    """
    cos_theta = dot(w, emitter.axis)
    if emitter.kind == SourceKind.LED:
        return emitter.norm * cos_theta**emitter.spread if cos_theta > 0.0 else 0.0
    if emitter.kind == SourceKind.ISOTROPIC:
        return emitter.norm
    theta = math.acos(min(max(cos_theta, -1.0), 1.0))
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        # density per solid angle of the sampler: theta Gaussian in the plane
        shape = theta / math.sin(theta) if theta > 1e-6 else 1.0
        return emitter.norm * shape * math.exp(-2.0 * (theta / emitter.spread) ** 2)
    return emitter.norm if theta <= emitter.spread else 0.0


@inlined
def shot_of(chains, i, target, branch, roughness):
    """Return the open segment of chain i and its target point."""
    goal = Vec2(target.radius * chains.disk[i, 0], target.radius * chains.disk[i, 1])
    tilt = slope_tilt(roughness, chains.tilt[i, 0], chains.tilt[i, 1])
    return Shot(row(chains.tail, i), row(chains.last, i), goal, branch, tilt)


@inlined
def straight_shot(x, y):
    """Return the open segment of unscattered light to a point in the plane of the aperture."""
    return Shot(ORIGIN, UP, Vec2(x, y), 1.0, Vec2(0.0, 0.0))


@entry
def flat_crossings(chains, starts, still, raised, out):
    """Write the flat-sea crossings (`FLAT` records) of each chain.

    Array twin: `tests/kernels/test_aiming.py`.
    Flat crossings do not depend on the waves: they are the starts for every surface. `out` has
    room for several of each chain; branch 0 ends them. Chains that turn sharply or reach
    still water before their last scattering are searched from many `starts` (x, y) and on
    both branches; the others have one crossing, found from below the receiver. A chain that
    ends above still water is searched on a sea `raised` above every crest.
    """
    depth = -still.emitter.position.z
    for i in range(len(chains.last)):
        q, v = row(chains.tail, i), row(chains.last, i)
        size = norm(q)
        plain = size < 0.95 * depth and dot(q, v) > 0.8 * size
        n = 0
        for scene in (still, raised):
            for side in range(1 if size < depth else 2):
                for k in range(len(starts)):
                    if n < len(out[i]) and not (n > 0 and plain):
                        shot = shot_of(chains, i, scene.target, 1.0 - 2.0 * side, SMOOTH)
                        n = _flat_root(n, starts[k], shot, scene, out[i])
            if n > 0:
                break
        if n < len(out[i]):
            out[i, n].branch = 0.0


@outlined
def _flat_root(n, start, shot, scene, out):
    """Add the flat-sea crossing found by Newton's method from a start, if new."""
    longest = scene.target.center.z
    found, x, y, _ = newton(start[0], start[1], FLAT_SEA, True, longest, shot, scene)
    if not found or is_known(out, 0, n, x, y, shot.branch, 1e-4):
        return n
    flat_crossing(out[n], x, y, shot, scene)
    return n + 1


@entry
def contributions(chains, flat, audits, search, scene, out):
    """Write the contribution of each chain to the aperture.

    Returns (doubtful crossings, rays, arrivals).

    Array twin: the analog estimator.
    Crossings that a wave may cut off before or behind are not scored but listed as doubtful,
    with the rays of their paths, which the caller checks by Embree.
    """
    n_doubt = n_rays = n_arrivals = 0
    for i in range(len(chains.last)):
        for k in range(_find(chains, i, flat[i], audits[i], search, scene, out)):
            root = out.roots[k]
            shot = shot_of(chains, i, scene.target, root.branch, scene.surface.roughness)
            p = Vec3(root.x, root.y, height_on(root.x, root.y, root.facet, scene.surface))
            w, steep, aim = weigh(chains, i, p, root.facet, shot, scene)
            w *= root.multiplicity
            if w <= 0.0:
                continue
            first = n_rays
            if not steep:
                n_rays = list_paths(chains, i, aim, p, n_doubt, scene, out.rays, n_rays)
            if n_arrivals < len(out.arrivals):
                a = out.arrivals[n_arrivals]
                a.chain, a.weight = i, w
                a.water, a.air = chains.path[i] + aim.length, aim.flight
                a.doubt = n_doubt if n_rays > first else -1
                write(a.point, p)
                write(a.emission, aim.w)
                n_arrivals += 1
            if n_rays > first:
                out.doubtful[n_doubt].chain, out.doubtful[n_doubt].weight = i, w
                n_doubt += 1
            else:
                out.score[i] += w
    return n_doubt, n_rays, n_arrivals


@entry
def direct_crossings(points, starts, scene, found, out):
    """Write the crossings of unscattered light to points of the unit disk.

    Array twin: `meshtrace.transport.forced.ForcedDetection`, by the images of the facets.
    """
    for i in range(len(points)):
        shot = straight_shot(scene.target.radius * points[i, 0], scene.target.radius * points[i, 1])
        x, y = starts[i, 0], starts[i, 1]
        facet = locate(scene.locator, scene.surface, x, y)
        if facet >= 0:
            found[i], x, y, facet = newton(x, y, facet, False, 1.0, shot, scene)
        out[i, 0], out[i, 1], out[i, 2] = x, y, height_on(x, y, facet, scene.surface)


@inlined
def _find(chains, i, flat, audit, search, scene, out):
    """Write the crossings of chain i (`Output.roots`); return their number.

    Newton starts from the flat crossings. More roots, if the sea focuses, are searched in a
    share of the chains and count by the inverse of that share: unbiased.
    """
    n = 0
    for k in range(len(flat)):
        if flat[k].branch == 0.0:
            if k == 0:
                out.counters[Counter.NO_FLAT] += 1
            break
        shot = shot_of(chains, i, scene.target, flat[k].branch, scene.surface.roughness)
        n = _near(n, flat[k], audit, search, shot, scene, out.roots, out.counters)
    return n


@outlined
def _near(n, flat, audit, search, shot, scene, roots, counters):
    """Append the crossings near one flat crossing."""
    surface, target, tilt = scene.surface, scene.target, shot.tilt
    waves = max(abs(surface.high[2] - flat.level), abs(surface.low[2] - flat.level))
    slope = search.slope + math.hypot(tilt.x, tilt.y)
    move = MARGIN * (slope * flat.lever + waves * flat.lift) / max(flat.low, 1e-3)
    radius = min(move + search.margin, search.widest)
    off = math.hypot(flat.x - target.center.x, flat.y - target.center.y)
    if off > target.reach + radius:
        return n  # outside the field of view for any waves
    if shot.branch > 0.0 and not _reaches(flat, radius, shot, scene):
        return n
    first, share = n, 1.0
    if surface.interpolate:
        x0 = flat.x + flat.m11 * tilt.x + flat.m12 * tilt.y
        y0 = flat.y + flat.m21 * tilt.x + flat.m22 * tilt.y
        found, x, y, facet = False, x0, y0, locate(scene.locator, surface, x0, y0)
        start = facet
        for step in (0.5, 0.1):  # the second time more carefully
            if start >= 0 and not found:
                found, x, y, facet = newton(x0, y0, start, False, step * radius, shot, scene)
                found = found and inside_facet(x, y, facet, surface)
        if found:
            counters[Counter.SOLVED] += 1
            n = _add(roots, n, x, y, facet, shot.branch, 1.0)
        # most chains that Newton gives up have no crossing: a quarter of them shows it
        audited = 1.0 if search.curvature * flat.lever > _FOCUSING else search.audit
        share = audited if found else max(audited, _AUDIT_FAILED)
        if audit >= share:
            return n
    counters[Counter.ENUMERATED] += 1
    kept = n
    for k in range(n, enumerate_roots(roots, n, flat, radius, shot, scene)):
        r = roots[k]
        kept = _add(roots, kept, r.x, r.y, r.facet, shot.branch, 1.0 / share)
    counters[Counter.EXTRA_ROOTS] += kept - max(n, first)
    return kept


@inlined
def _reaches(flat, radius, shot, scene):
    """Return whether the open segment of a chain can end on the surface near a flat crossing.

    A segment that goes outwards must start nearer to the source than the surface lies.
    """
    if dot(shot.q, shot.v) < 0.0:
        return True
    source = scene.emitter.position
    side = math.hypot(flat.x - source.x, flat.y - source.y) + radius
    rise = scene.surface.high[2] - source.z
    return dot(shot.q, shot.q) < side * side + rise * rise


@inlined
def _add(roots, n, x, y, facet, branch, multiplicity):
    """Append a crossing unless it is known; return the number of crossings."""
    if n == len(roots) or is_known(roots, 0, n, x, y, branch, 1e-6):
        return n
    r = roots[n]
    r.x, r.y, r.branch, r.facet, r.multiplicity = x, y, branch, facet, multiplicity
    return n + 1


@inlined
def is_steep(m, scene):
    """Return whether no wave can block a path before or after its crossing.

    Array twin: `_cut` of `meshtrace.transport.forced`, by Embree.
    """
    slope = scene.surface.max_slope
    return m.d.z > slope * math.hypot(m.d.x, m.d.y) and (
        not scene.interface.follow_second_hit or m.r.z > slope * math.hypot(m.r.x, m.r.y)
    )


@inlined
def transmittance(m, interface):
    """Return the transmittance of the surface at a crossing.

    Array twin: `meshtrace.optics.fresnel` and `Whitecaps.transmittance`.
    """
    t = (1.0 - m.rho) * interface.foam_transmittance
    if interface.fresnel == FresnelMode.PAPER_BOTH:
        t *= 1.0 - m.rho
    return t


@inlined
def accepted(m, p, target, fov):
    """Return whether light that crosses at P arrives inside the field of view.

    Array twin: `meshtrace.kernels.tally.crosses_aperture`.
    """
    if fov == FieldOfView.ANGLE:
        return dot(m.r, target.axis) >= target.cos_half_fov * norm(m.r)
    reach = target.radius + (target.center.z - p.z) * target.tan_half_fov
    return (p.x - target.center.x) ** 2 + (p.y - target.center.y) ** 2 < reach * reach


@inlined
def weigh(chains, i, p, facet, shot, scene):
    """Return (weight, steep, aim) of a crossing of chain i on a facet.

    `steep`: no wave can cut its paths off.
    """
    j = jacobian(p.x, p.y, facet, shot, scene)
    weight, deep = weight_of(chains, i, p, j, facet, shot.tilt, scene)
    return weight, is_steep(j.aim, scene) and deep, j.aim


@inlined
def weight_of(chains, i, p, j, facet, tilt, scene):
    """Return (|A| I(w) W / |det dX/dOmega|, all vertices deep) of chain i through a crossing."""
    m, target = j.aim, scene.target
    spread = abs(j.a * j.d - j.b * j.c)
    if not j.ok or m.w.z <= -0.999999 or spread == 0.0:
        return 0.0, True
    if not accepted(m, p, target, scene.interface.fov):
        return 0.0, True
    solid_angle = abs(j.wa * j.wd - j.wb * j.wc) / (abs(m.w.z) * spread)
    light = intensity(scene.emitter, m.w) * transmittance(m, scene.interface)
    if tilt.x != 0.0 or tilt.y != 0.0:
        light *= exposure(m.d, normal_at(p.x, p.y, facet, scene.surface), tilt)
    w, deep = _transmit(chains, i, m, p, scene)
    return math.pi * target.radius**2 * light * solid_angle * w * chains.weight[i], deep


@inlined
def turned(w, p):
    """Rotate a vector by the minimal rotation from e_z to the emission direction.

    Array twin: the rotation matrix of the tests.
    """
    along = (-w.y * p.x + w.x * p.y) / (1.0 + w.z)
    return Vec3(
        p.x * w.z + w.x * p.z - w.y * along,
        p.y * w.z + w.y * p.z + w.x * along,
        p.z * w.z - w.x * p.x - w.y * p.y,
    )


@inlined
def _vertex(chains, i, k, m, scene):
    """Return vertex k of chain i."""
    return plus(turned(m.w, row(chains.vertex[i], k)), scene.emitter.position)


@inlined
def _transmit(chains, i, m, p, scene):
    """Return (coefficients of the scatterings times transmittance, all vertices deep)."""
    medium = scene.medium
    before = scene.emitter.position
    simple = not medium.layered and medium.depth_mode == DepthMode.NONE
    weight, tau, deep = 1.0, 0.0, True
    for k in range(chains.vertex.shape[1]):
        v = _vertex(chains, i, k, m, scene)
        if v.z > scene.surface.low[2]:
            deep = False
        if simple:
            weight *= medium.b
        else:
            if chains.kind[i, k] == 1:
                weight *= bubble_scattering(medium, v)
            else:
                weight *= water_coefficients(medium, v.z)[1]
            length = norm(minus(v, before))
            tau += absorption_path(medium, before.z, v.z, length)
            tau += scattering_path(medium, before, v, length)
        before = v
    if simple:
        tau = (medium.a + medium.b) * (chains.path[i] + m.length)
    else:
        tau += absorption_path(medium, before.z, p.z, m.length)
        tau += scattering_path(medium, before, p, m.length)
    return weight * math.exp(-tau), deep


@outlined
def list_paths(chains, i, m, p, crossing, scene, rays, n):
    """List the straight parts of a path that a wave may block; return the number of rays.

    Array twin: none, a list for Embree.
    A vertex above the highest crest needs no ray of its own: the path to it or from it is cut.
    """
    low, high, slope = scene.surface.low[2], scene.surface.high[2], scene.surface.max_slope
    start = scene.emitter.position
    order = chains.vertex.shape[1]
    for k in range(order + (2 if scene.interface.follow_second_hit else 1)):
        if k < order:
            end = _vertex(chains, i, k, m, scene)
        elif k == order:
            end = p
        else:
            end = along(p, m.r, m.flight)
        way = minus(end, start)
        length = norm(way)
        level = max(start.z, end.z) > low and min(start.z, end.z) < high
        climbs = way.z > slope * math.hypot(way.x, way.y) and k >= order
        if length > 0.0 and level and not climbs and n < len(rays):
            rays[n].crossing, rays[n].length = crossing, length
            write(rays[n].origin, start)
            write(rays[n].direction, Vec3(way.x / length, way.y / length, way.z / length))
            n += 1
        start = end
    return n
