"""Forced detection: crossings of each chain over one surface, and its contribution to the aperture.

A chain (`sampling.Chains`) is a history of scatterings whose direction of emission w is free: it is
turned about its source until its last segment, refracted by the surface at a crossing P, lands on a
chosen point X of the aperture. Its contribution to the gain is |A| I(w) W dOmega/dX: A the area of
the aperture, I the intensity of the source, W scatterings and transmittance, Omega the solid angle
of w.

Newton starts from the crossings of a flat sea, which do not depend on the waves. An audit searches
every facet for all crossings near that of a flat sea that land on one point. Chains at other
wavelengths are sums over their ways and scatterings, see `kernels.tints`.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.engine.chains.microfacets import slope_towards, whitened
from meshtrace.engine.chains.unscattered import aperture_at
from meshtrace.engine.crossing import is_steep
from meshtrace.kernels.interface import SMOOTH, normal_at, over_gaussian, slope_tilt
from meshtrace.kernels.jit import NO, YES, ZERO, entry, inlined, outlined, record_type
from meshtrace.kernels.medium import (
    Medium,
    absorption_path,
    bubble_scattering,
    is_uniform,
    scattering_path,
    water_coefficients,
)
from meshtrace.kernels.rays import is_free
from meshtrace.kernels.scene import FLAT_SEA, height_on, locate
from meshtrace.kernels.sources import intensity
from meshtrace.kernels.tints import (
    Factors,
    Mixture,
    Tints,
    fill_factors,
    reset_tint,
    tint_scattering,
    tint_way,
)
from meshtrace.kernels.vectors import (
    UP,
    Vec2,
    Vec3,
    along,
    dot,
    minus,
    norm,
    plus,
    row,
    unit,
    write,
)

_FOCUSING = 0.5  # change of the landing point by curvature, over that by the way, from which a sea
# focuses: there may be several crossings, and all facets are searched; tuned, time against noise
_AUDIT_FAILED = 0.25  # share of chains without a solution whose facets are all searched: the same

ARRIVAL = record_type(
    [
        ("chain", np.int64),
        ("weight", float),
        ("water", float),  # path in the water [m]
        ("air", float),
        ("point", float, (3,)),  # crossing [m]
        ("emission", float, (3,)),  # direction
    ]
)
"""Contribution of a chain to the aperture."""


class Output(NamedTuple):
    """Results of `contributions`, and a buffer for the crossings of one chain."""

    score: NDArray[np.float64]  # (chains,)
    arrivals: NDArray[np.void]  # ARRIVAL; no rows: not kept
    counters: NDArray[np.int64]  # by `Counter`
    roots: NDArray[np.void]  # ROOT


class Crossing(NamedTuple):
    """Crossing of a chain, and the light that it brings."""

    weight: float  # contribution to the gain, if no wave cuts it off
    steep: bool  # no wave can: its paths are steeper than all slopes, its vertices below troughs
    aim: crossing.Aim
    point: Vec3  # P [m]
    start: Vec3  # of the chain


class Counter(IntEnum):
    """Outcomes of the search that are counted."""

    SOLVED = 0  # crossings that Newton finds from those of a flat sea
    NO_FLAT = 1  # chains without a crossing of a flat sea: no light
    ENUMERATED = 2  # searches of all facets
    EXTRA_ROOTS = 3  # crossings that these add
    BLOCKED = 4  # crossings whose paths other waves cut off


@inlined
def shot_of(chains, i, scene, branch, roughness):
    """Return the open segment of chain i and the point that it aims at."""
    u, v = chains.disk[i, 0], chains.disk[i, 1]
    goal = Vec2(scene.target.radius * u, scene.target.radius * v)
    tilt = slope_tilt(roughness, chains.tilt[i, 0], chains.tilt[i, 1])
    start = crossing.start_of(scene.emitter, u, v)
    return crossing.Shot(start, row(chains.tail, i), row(chains.last, i), goal, branch, tilt)


@entry
def flat_crossings(chains, starts, still, raised, out):
    """Write the flat-sea crossings (`FLAT` records) of each chain.

    Array twin: `tests/engine/test_crossing.py`.
    Flat crossings do not depend on the waves: they are the starts for every surface. `out` has
    room for several of each chain; branch 0 ends them. Chains that turn by more than 66 degrees
    or reach still water before their last scattering are searched from many `starts` (x, y) and
    on both branches; the others have one crossing, found from below the receiver. A chain that
    ends above still water is searched on a sea `raised` above every crest.
    """
    depth = -still.emitter.position.z
    for i in range(len(chains.last)):
        q, v = row(chains.tail, i), row(chains.last, i)
        size = norm(q)
        # A chain that ends well below still water (a margin of 5 %) and goes on outwards (cos 66
        # degrees = 0.4) meets the sphere of each P once: one crossing at most.
        plain = size < 0.95 * depth and dot(q, v) >= 0.4 * size
        n = ZERO
        for scene in (still, raised):
            # Branch -1 needs a segment that starts outside the sphere of radius |P| >= depth.
            for side in range(1 if size < depth else 2):
                for k in range(len(starts)):
                    if n < len(out[i]) and not (n > 0 and plain):
                        shot = shot_of(chains, i, scene, 1.0 - 2.0 * side, SMOOTH)
                        n = _flat_root(n, starts[k], shot, scene, out[i])
            if n > 0:
                break
        if n < len(out[i]):
            out[i, n].branch = 0.0


@outlined
def _flat_root(n, start, shot, scene, out):
    """Add the flat-sea crossing that Newton finds from a start, if it is new."""
    longest = scene.target.center.z
    converged, x, y, _ = crossing.newton(start[0], start[1], FLAT_SEA, YES, longest, shot, scene)
    if not converged or crossing.is_known(out, ZERO, n, x, y, shot.branch, 1e-4):
        return n
    crossing.flat_crossing(out[n], x, y, shot, scene)
    return n + 1


@outlined
def _near(n, flat, audit, search, shot, scene, roots, counters):
    """Append the crossings that belong to one flat crossing to n others; return their number.

    Newton starts from the flat crossing. More roots, if the sea focuses, are searched in a share of
    the chains, those whose uniform `audit` is smaller, and count by the inverse of that share:
    unbiased.
    """
    surface, target, tilt = scene.surface, scene.target, shot.tilt
    radius = crossing.radius_of(flat, search, shot, scene)
    # first the cheap bounds, which end most searches
    off = math.hypot(flat.x - target.center.x, flat.y - target.center.y)
    if off > target.reach + radius:
        return n  # outside the field of view for any waves
    if shot.branch > 0.0 and not _reaches(flat, radius, shot, scene):
        return n
    share = 1.0
    if surface.interpolate:
        # The random slope of the chain moves the crossing of still water to first order: a better
        # start.
        x0 = flat.x + flat.m11 * tilt.x + flat.m12 * tilt.y
        y0 = flat.y + flat.m21 * tilt.x + flat.m22 * tilt.y
        converged, x, y, facet = crossing.root_from(x0, y0, radius, shot, scene)
        if converged:
            counters[Counter.SOLVED.value] += 1
            n = crossing.add_root(roots, n, ZERO, x, y, facet, shot.branch, 1.0)
        # most chains that Newton gives up have no crossing: a quarter of them shows it
        audited = 1.0 if search.curvature * flat.lever > _FOCUSING else search.audit
        # Russian roulette for the search of all facets: counted by 1 / share, so the expectation is
        # that of a full search.
        share = audited if converged else max(audited, _AUDIT_FAILED)
        if audit >= share:
            return n
    unique = n
    counters[Counter.ENUMERATED.value] += 1
    last = crossing.enumerate_roots(roots, n, flat, radius, NO, shot, scene)
    # `enumerate_roots` has written behind the first n: those that are new move up
    for k in range(n, last):
        r = roots[k]
        unique = crossing.add_root(roots, unique, ZERO, r.x, r.y, r.facet, shot.branch, 1.0 / share)
    counters[Counter.EXTRA_ROOTS.value] += unique - n
    return unique


@inlined
def _reaches(flat, radius, shot, scene):
    """Return whether the open segment of a chain can end on the surface near a flat crossing.

    A segment that goes outwards must start nearer to the source than the surface lies.
    """
    if dot(shot.q, shot.v) < 0.0:
        return True
    source = shot.start
    side = math.hypot(flat.x - source.x, flat.y - source.y) + radius
    rise = scene.surface.high[2] - source.z
    return dot(shot.q, shot.q) < side * side + rise * rise


@entry
def contributions(chains, flat, audits, search, scene, out):
    """Write the contribution of each chain to the aperture; return the number of arrivals.

    Array twin: the analog estimator.
    """
    # Manifold next-event estimation (Hanika et al. 2015) for whole histories turned about their
    # source, as the track-rotation estimator.
    arrivals = ZERO
    for i in range(len(chains.last)):
        n = ZERO
        for k in range(len(flat[i])):
            if flat[i, k].branch == 0.0:
                if k == 0:
                    out.counters[Counter.NO_FLAT.value] += 1
                break
            shot = shot_of(chains, i, scene, flat[i, k].branch, scene.surface.roughness)
            n = _near(n, flat[i, k], audits[i], search, shot, scene, out.roots, out.counters)
        for k in range(n):
            root = out.roots[k]
            shot = shot_of(chains, i, scene, root.branch, scene.surface.roughness)
            path = weigh(chains, i, root.x, root.y, root.facet, shot, scene)
            w = path.weight * root.multiplicity
            if w > 0.0:
                arrivals = keep(chains, i, w, path, i, arrivals, scene, out)
    return arrivals


@entry
def flat_contributions(chains, flat, scene, score):
    """Write the contribution of each chain to the aperture over still water.

    Array twin: `contributions` over a flat mesh.
    The crossings are known; still water cuts off a path with a vertex above it.
    """
    for i in range(len(chains.last)):
        score[i] = 0.0
        for k in range(len(flat[i])):
            f = flat[i, k]
            if f.branch == 0.0:
                break
            # found on the raised sea, for crests that still water does not have
            if f.level != scene.surface.level:
                continue
            shot = shot_of(chains, i, scene, f.branch, SMOOTH)
            j = crossing.jacobian(f.x, f.y, FLAT_SEA, shot, scene)
            p, per_area = Vec3(f.x, f.y, f.level), crossing.solid_angle_per_area(j)
            w, deep = weight_of(chains, i, p, j.aim, per_area, FLAT_SEA, shot, scene)
            if deep:
                score[i] += w


@entry
def blurred_contributions(chains, flat, places, near, spread, scene, out):
    """Write the contribution of each chain to the aperture at each of the given places.

    Returns the number of arrivals; their chains, and the rows of the scores, count the chains to
    the first place, to the second, and so on.

    Array twin: `contributions`, which finds the crossings of a chosen slope.
    Here the crossing is chosen, as that of a flat sea moved by slopes of the law `spread`, and the
    slope follows: one evaluation a crossing. Crossings that several flat ones may lead to count
    by the sum of their densities. They are unbiased about any point: `flat` are the crossings to
    the aperture of the scene, moved to first order to its `places` (m, 3); `near` has room for
    those of a chain.
    """
    # Next-event estimation through a rough refracting surface: the crossing is sampled, the slope
    # that connects it is unique (Walter et al. 2007), its density is the weight.
    arrivals, n = ZERO, len(chains.last)
    for m in range(len(places)):
        there = aperture_at(row(places, m), scene)
        x, y = places[m, 0] - scene.target.center.x, places[m, 1] - scene.target.center.y
        for i in range(n):
            if flat[i, 0].branch == 0.0:
                out.counters[Counter.NO_FLAT.value] += 1
                continue
            for k in range(len(near)):
                near[k] = flat[i, k]
                # To first order only: the proposal moves, the weight is exact for any proposal.
                near[k].x += flat[i, k].c11 * x + flat[i, k].c12 * y
                near[k].y += flat[i, k].c21 * x + flat[i, k].c22 * y
            for k in range(len(near)):
                if near[k].branch == 0.0:
                    break
                path = _sloped_crossing(chains, i, near, k, spread, there)
                if path.weight > 0.0:
                    out.counters[Counter.SOLVED.value] += 1
                    w, place = path.weight, m * n + i
                    arrivals = keep(chains, i, w, path, place, arrivals, there, out)
    return arrivals


@inlined
def _lifted(flat, scene):
    """Return a crossing of the flat sea, raised to the height of the surface there."""
    facet = locate(scene.locator, scene.surface, flat.x, flat.y)
    rise = 0.0
    if facet >= 0:
        rise = height_on(flat.x, flat.y, facet, scene.surface) - flat.level
    return flat.x + flat.h1 * rise, flat.y + flat.h2 * rise


@outlined
def _density(flat, x, y, branch, spread, scene):
    """Return the density of the proposed crossings at (x, y) [m-2], on one branch.

    Summed over the crossings `flat` of still water that may lead there.
    """
    total = 0.0
    for k in range(len(flat)):
        if flat[k].branch == 0.0:
            break
        det = flat[k].m11 * flat[k].m22 - flat[k].m12 * flat[k].m21
        if flat[k].branch != branch or det == 0.0:
            continue
        x0, y0 = _lifted(flat[k], scene)
        dx, dy = (x - x0) / det, (y - y0) / det
        s = Vec2(flat[k].m22 * dx - flat[k].m12 * dy, flat[k].m11 * dy - flat[k].m21 * dx)
        u = whitened(spread, s)
        # Slopes of the proposal are Gaussian; |det dP/dslope| turns their density into one of
        # crossings.
        law = math.exp(-0.5 * (u.x * u.x + u.y * u.y))
        total += law / (2.0 * math.pi * spread.along * spread.across * abs(det))
    return total


@outlined
def _sloped_crossing(chains, i, flat, k, spread, scene):
    """Return the `Crossing` of chain i that is proposed for crossing k of the flat sea.

    Its weight is its light over the density of the point.
    """
    x, y = _lifted(flat[k], scene)
    s = slope_tilt(spread, chains.tilt[i, 0], chains.tilt[i, 1])  # displaces the crossing
    x = x + flat[k].m11 * s.x + flat[k].m12 * s.y
    y = y + flat[k].m21 * s.x + flat[k].m22 * s.y
    facet = locate(scene.locator, scene.surface, x, y)
    shot = shot_of(chains, i, scene, flat[k].branch, scene.surface.roughness)
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))
    ok, length, w, d = crossing.emission_through(shot.q, shot.v, minus(p, shot.start), shot.branch)
    none = crossing.Aim(False, shot.goal, w, d, UP, 1.0, length, 0.0)
    nothing = Crossing(0.0, True, none, p, shot.start)
    if facet < 0 or not ok or dot(d, row(scene.surface.face_normals, facet)) <= 0.0:
        return nothing
    n = normal_at(x, y, facet, scene.surface)
    slope = slope_towards(p, n, w, d, length, shot.goal, scene)
    # Several crossings of still water may lead here: the sum of their densities, as the balance
    # heuristic for equal numbers of samples.
    density = _density(flat, x, y, shot.branch, spread, scene)
    if slope.density == 0.0 or density == 0.0:
        return nothing
    ok_x, w_x = _emission_at(x + crossing.STEP, y, facet, shot, scene)
    ok_y, w_y = _emission_at(x, y + crossing.STEP, facet, shot, scene)
    if not (ok_x and ok_y):  # a scattering closer to the surface than a step has no derivative
        return nothing
    # The crossing is drawn with `density` per area and lands with `slope.density` per area: their
    # ratio takes the place of |det dX/dP|.
    turns = crossing.quotients(w, w_x, w_y)
    per_area = crossing.emission_per_area(turns, w, density / slope.density)
    shot = crossing.Shot(shot.start, shot.q, shot.v, shot.goal, shot.branch, slope.tilt)
    weight, deep = weight_of(chains, i, p, slope.aim, per_area, facet, shot, scene)
    return Crossing(weight, is_steep(slope.aim, scene) and deep, slope.aim, p, shot.start)


@inlined
def _emission_at(x, y, facet, shot, scene):
    """Return (ok, direction of emission) through the plane of a facet over (x, y)."""
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))
    ok, _, w, _ = crossing.emission_through(shot.q, shot.v, minus(p, shot.start), shot.branch)
    return ok, w


@outlined
def keep(chains, i, w, path, place, n, scene, out):
    """Score the light w of chain i by its `Crossing`, unless a wave cuts its path off.

    Array twin: none, sums.
    `place` is the row of its score, n the number of arrivals, which is returned with this one.
    """
    if not (path.steep or _is_clear(chains, i, path, scene)):
        # Light that meets another wave is left out.
        out.counters[Counter.BLOCKED.value] += 1
        return n
    out.score[place] += w
    if n < len(out.arrivals):
        a, aim = out.arrivals[n], path.aim
        a.chain, a.weight = place, w
        a.water, a.air = chains.path[i] + aim.length, aim.flight
        write(a.point, path.point)
        write(a.emission, aim.w)
        n += 1
    return n


@inlined
def weigh(chains, i, x, y, facet, shot, scene):
    """Return the `Crossing` of chain i over (x, y) on a facet.

    The random slope of a chain is Gaussian: another density is in the weight.
    """
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))
    j = crossing.jacobian(x, y, facet, shot, scene)
    per_area = crossing.solid_angle_per_area(j)
    weight, deep = weight_of(chains, i, p, j.aim, per_area, facet, shot, scene)
    weight *= over_gaussian(scene.surface.roughness.series, chains.tilt[i, 0], chains.tilt[i, 1])
    return Crossing(weight, is_steep(j.aim, scene) and deep, j.aim, p, shot.start)


@inlined
def weight_of(chains, i, p, m, per_area, facet, shot, scene):
    """Return (|A| I(w) W dOmega/dX, all vertices deep) of chain i through a crossing.

    m is the `Aim` at P, `per_area` = dOmega/dX, 0 without light; `shot` has the random slope.
    """
    if per_area == 0.0:
        return 0.0, True
    n = normal_at(p.x, p.y, facet, scene.surface) if facet >= 0 else UP
    passed = crossing.passed(intensity(scene.emitter, m.w), m, p, n, facet, shot.tilt, scene)
    if passed == 0.0:
        return 0.0, True
    # last: it is the dearest factor
    w, deep = _transmit(chains, i, m, p, shot.start, scene)
    area = scene.target.area * scene.emitter.power
    return area * passed * per_area * w * chains.weight[i], deep


@inlined
def turned(w, p):
    """Rotate a vector by the minimal rotation from e_z to the emission direction.

    Array twin: the rotation matrix of the tests.
    """
    # Rodrigues for the axis e_z x w, in a form without square roots (Moller and Hughes 1999).
    along = (-w.y * p.x + w.x * p.y) / (1.0 + w.z)
    return Vec3(
        p.x * w.z + w.x * p.z - w.y * along,
        p.y * w.z + w.y * p.z + w.x * along,
        p.z * w.z - w.x * p.x - w.y * p.y,
    )


@inlined
def _vertex(chains, i, k, m, start):
    """Return vertex k of chain i."""
    return plus(turned(m.w, row(chains.vertex[i], k)), start)


@inlined
def _transmit(chains, i, m, p, start, scene):
    """Return (coefficients of the scatterings times transmittance, all vertices deep)."""
    medium = scene.medium
    before = start
    simple = is_uniform(medium)
    weight, tau, deep = 1.0, 0.0, True
    for k in range(chains.vertex.shape[1]):
        v = _vertex(chains, i, k, m, start)
        # Above the lowest trough a vertex may lie in the air: its ways are checked by rays.
        if v.z > scene.surface.low[2]:
            deep = False
        if v.z < medium.bottom_z:  # straight ways between points above it do not meet it
            return 0.0, True
        if simple:
            # The phase function is in the law of the directions, the coefficient is not.
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
        # The weight of a chain has 1 / density of its distances: exp(-tau) is whole here.
        tau = (medium.a + medium.b) * (chains.path[i] + m.length)
    else:
        tau += absorption_path(medium, before.z, p.z, m.length)
        tau += scattering_path(medium, before, p, m.length)
    return weight * math.exp(-tau), deep


@outlined
def _is_clear(chains, i, path, scene):
    """Return whether no wave cuts a straight part of the path of a `Crossing`.

    A vertex above the highest crest needs no part of its own: the path to it or from it is cut.
    """
    m, start, slope = path.aim, path.start, scene.surface.max_slope
    order = chains.vertex.shape[1]
    for k in range(order + (2 if scene.interface.follow_second_hit else 1)):
        if k < order:
            end = _vertex(chains, i, k, m, path.start)
        elif k == order:
            end = path.point
        else:
            end = along(path.point, m.r, m.flight)
        way = minus(end, start)
        length = norm(way)
        climbs = way.z > slope * math.hypot(way.x, way.y) and k >= order
        if length > 0.0 and not climbs:
            if not is_free(start, unit(way), length, scene.surface, scene.locator):
                return False
        start = end
    return True


class Colours(NamedTuple):
    """Wavelengths of straight ways, and their factors on the weight of the last one."""

    tints: Tints | None
    mixture: Mixture
    clear: Medium  # the water with its bubbles alone
    log_weights: NDArray[np.float64]  # (tints,) scratch: sums along the way
    factors: Factors


@outlined
def straight_factors(p, q, colours):
    """Write the factors of all wavelengths on light along a straight way from p to q.

    Array twin: see `tint_chains`.
    """
    reset_tint(colours.tints, colours.log_weights)
    _add_way(p, q, colours.clear, colours.tints, colours.log_weights)
    fill_factors(colours.mixture, colours.log_weights, colours.factors)


@inlined
def _add_way(p, q, clear, tints, log_weights):
    """Add a straight way from p to q."""
    if tints is not None:
        length = norm(minus(q, p))
        tint_way(tints, log_weights, p.z, q.z, length)
        # bubbles scatter alike at all wavelengths but for a factor on their optical depth
        depth = scattering_path(clear, p, q, length)
        for r in range(len(tints.c)):
            log_weights[r] -= tints.bubble_c[r] * depth


@entry
def tint_chains(chains, arrivals, emitter, clear, tints, out):
    """Write the sums (arrivals, tints) of chains that arrive, see `kernels.tints`.

    Array twin: direct runs of the wavelengths.
    `clear` is the water with its bubbles alone.
    """
    for n in range(len(arrivals)):
        a, log_weights = arrivals[n], out[n]
        i, w = a.chain, Vec3(a.emission[0], a.emission[1], a.emission[2])
        start = crossing.start_of(emitter, chains.disk[i, 0], chains.disk[i, 1])
        end = Vec3(a.point[0], a.point[1], a.point[2])
        reset_tint(tints, log_weights)
        before, last = start, w
        order = chains.vertex.shape[1]
        for k in range(order + 1):
            at = end
            if k < order:
                at = plus(turned(w, row(chains.vertex[i], k)), start)
            way = minus(at, before)
            if k > 0:
                # By the chord, which keeps the digits of small angles.
                s = 0.5 * norm(minus(unit(way), unit(last)))
                theta = 2.0 * math.asin(min(s, 1.0))
                tint_scattering(tints, log_weights, before.z, theta, chains.kind[i, k - 1] == 1)
            _add_way(before, at, clear, tints, log_weights)
            before, last = at, way


@entry
def tint_straight(start, ends, clear, tints, out):
    """Write the sums (ways, tints) of straight ways from a point to ends (ways, 3).

    Array twin: see `tint_chains`.
    """
    for n in range(len(ends)):
        reset_tint(tints, out[n])
        _add_way(start, row(ends, n), clear, tints, out[n])
