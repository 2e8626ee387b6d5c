"""Forced detection: crossings of each chain over one surface, and its contribution to the aperture.

A chain (`sampling.Chains`) is a history of scatterings whose direction of emission w is free: it is
turned about its source until its last segment, refracted by the surface at a crossing P, lands on a
chosen point X of the aperture. Its contribution to the gain is |A| I(w) W dOmega/dX: A the area of
the aperture [m2], I the intensity of the source [sr-1], W the product of scattering coefficients
and transmittances over the density of the chain, Omega the solid angle of w.

Newton starts from the crossings of a flat sea, which do not depend on the waves. A random share of
the chains is audited: every facet near the flat crossing is searched for further crossings that
land on the same point. The weights of a chain at other wavelengths follow from its path alone: sums
of logarithms over its segments and scatterings, see `kernels.tints`.

Names are those of `crossing`: P, X, w, d, r, q, v. A chain is stored in the frame of its emission
(along e_z from the origin), everything else is in the frame of the scene, z upwards.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.engine.chains.random_slopes import slope_towards, whitened
from meshtrace.engine.chains.unscattered import aperture_at
from meshtrace.engine.crossing import is_steep
from meshtrace.kernels.bodies import is_hidden
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

# As P moves, X moves with it, and by the change of slope: the ratio of the two is the curvature of
# the sea [m-1] times the lever |dX/dslope| [m]. Near 1 the sea focuses and several crossings may
# land on X. Above this ratio all facets are searched for every chain. Tuned: time against noise.
_FOCUSING = 0.5
# Share of the chains whose Newton fails for which all facets are searched. Tuned: time against
# noise.
_AUDIT_FAILED = 0.25

ARRIVAL = record_type(
    [
        ("chain", np.int64),  # index of the score that it adds to
        ("weight", float),  # what it adds to the gain
        ("water", float),  # path in the water [m]
        ("air", float),  # path in the air [m]
        ("point", float, (3,)),  # crossing P [m]
        ("emission", float, (3,)),  # direction w
    ]
)
"""Contribution of a chain to the aperture."""


class Output(NamedTuple):
    """Results of `contributions`, and a buffer for the crossings of one chain."""

    score: NDArray[np.float64]  # (chains,) gain; (places * chains,) of `blurred_contributions`
    arrivals: NDArray[np.void]  # ARRIVAL; those beyond its length are not recorded
    counters: NDArray[np.int64]  # by `Counter`
    roots: NDArray[np.void]  # ROOT


class Crossing(NamedTuple):
    """Crossing of a chain, and its contribution to the gain."""

    weight: float  # contribution to the gain, if no wave cuts its path off
    # No wave can cut the path off: both segments at P are steeper than every slope of the sea, and
    # all vertices lie below its lowest trough.
    steep: bool
    aim: crossing.Aim
    point: Vec3  # P [m]
    start: Vec3  # of the chain: a point of the source [m]


class Counter(IntEnum):
    """Index of each counted outcome of the search."""

    SOLVED = 0  # crossings that Newton reaches from those of a flat sea, or that are sampled there
    NO_FLAT = 1  # chains without a crossing of a flat sea: no light
    ENUMERATED = 2  # searches of all facets
    EXTRA_ROOTS = 3  # crossings that these searches add
    BLOCKED = 4  # crossings whose paths other waves cut off


@inlined
def shot_of(chains, i, scene, branch, roughness):
    """Return the `Shot` of chain i: its open segment and the point that it aims at.

    The same point (u, v) of the unit disk places the goal on the aperture and the start on an
    extended source.
    """
    u, v = chains.disk[i, 0], chains.disk[i, 1]
    goal = Vec2(scene.target.radius * u, scene.target.radius * v)
    tilt = slope_tilt(roughness, chains.tilt[i, 0], chains.tilt[i, 1])
    start = crossing.start_of(scene.emitter, u, v)
    return crossing.Shot(start, row(chains.tail, i), row(chains.last, i), goal, branch, tilt)


@entry
def flat_crossings(chains, known, starts, still, raised, out):
    """Find the crossings of a flat sea by each chain: `out` (chains, room) of `FLAT` records.

    Array twin: `tests/engine/test_crossing.py`.
    Flat crossings do not depend on the waves: they are the starts for every surface. A record of
    branch 0 ends those of a chain. `starts` (n, 2) are the points (x, y) [m] from which Newton is
    tried; a chain with one crossing at most stops at the first success. `still` is the scene with
    the flat sea at the mean level, z = 0, `raised` that with one above every crest, which is tried
    for chains without a crossing of still water. `known` (chains, room) are records of the same
    chains in a link nearby, or none with a room of 0: Newton follows them from there, and other
    starts are tried only where a chain had no crossing of this sea, or loses one.
    """
    depth = -still.emitter.position.z
    for i in range(len(chains.last)):
        q, v = row(chains.tail, i), row(chains.last, i)
        distance = norm(q)
        # P moves with |P - source| >= depth, and the open segment passes through that sphere. From
        # a last vertex well inside it (5 % margin), and outwards (within 66 degrees, cosine 0.4, of
        # the radius), one crossing is expected. Tuned: time against second crossings missed.
        single = distance < 0.95 * depth and dot(q, v) >= 0.4 * distance
        n = ZERO
        for scene in (still, raised):
            n, followed = _followed(n, known[i], chains, i, scene, out[i])
            # Branch -1, the near intersection, needs a last vertex outside the sphere of radius
            # |P| >= depth.
            for side in range(0 if followed else 1 if distance < depth else 2):
                for k in range(len(starts)):
                    if n < len(out[i]) and not (n > 0 and single):
                        shot = shot_of(chains, i, scene, 1.0 - 2.0 * side, SMOOTH)
                        n = _flat_root(n, Vec2(starts[k, 0], starts[k, 1]), shot, scene, out[i])
            if n > 0:
                break
        if n < len(out[i]):
            out[i, n].branch = 0.0


@inlined
def _followed(n, known, chains, i, scene, out):
    """Append the crossings of a flat sea that lie near known ones; return (number, all found)."""
    expected = n
    for k in range(len(known)):
        if known[k].branch == 0.0:
            break
        if known[k].level == scene.surface.level:
            shot = shot_of(chains, i, scene, known[k].branch, SMOOTH)
            n = _flat_root(n, Vec2(known[k].x, known[k].y), shot, scene, out)
            expected += 1
    return n, n > 0 and n == expected


@outlined
def _flat_root(n, start, shot, scene, out):
    """Append to `out` the flat-sea crossing that Newton reaches from a start, if it is new.

    Return the number of crossings, n before. Crossings within 1e-4 m of each other are the same.
    """
    longest = scene.target.center.z  # step of Newton: the height of the aperture [m]
    converged, x, y, _ = crossing.newton(start.x, start.y, FLAT_SEA, YES, longest, shot, scene)
    if not converged or crossing.is_known(out, ZERO, n, x, y, shot.branch, 1e-4):
        return n
    crossing.flat_crossing(out[n], x, y, shot, scene)
    return n + 1


@outlined
def _roots_near(n, flat, audit, search, shot, scene, roots, counters):
    """Append the crossings near one flat crossing to n others in `roots`; return their number.

    Newton starts from the flat crossing. Further roots are searched in a share of the chains only,
    those whose uniform number `audit` is below it, and are weighted by the inverse of that share,
    so that the mean is that of a search for every chain. `search` is the `crossing.Search`.
    """
    surface, target, tilt = scene.surface, scene.target, shot.tilt
    if search.still and flat.level == surface.level:
        # the flat crossing itself, where the water reaches so far
        if locate(scene.locator, surface, flat.x, flat.y) < 0:
            return n
        counters[Counter.SOLVED.value] += 1
        return crossing.add_root(roots, n, ZERO, flat.x, flat.y, FLAT_SEA, shot.branch, 1.0)
    radius = crossing.radius_of(flat, search, shot, scene)
    # No crossing lies farther than `radius` from the flat one. The cheap bounds come first: they
    # end most searches.
    aside = math.hypot(flat.x - target.center.x, flat.y - target.center.y)
    if aside > target.reach + radius:
        return n  # outside the field of view for any waves
    if shot.branch > 0.0 and not _reaches(flat, radius, shot, scene):
        return n
    share = 1.0
    if surface.interpolate:
        # The random slope of the chain moves the flat crossing by dP/dslope (m11 to m22) times the
        # slope, to first order: a better start.
        x0 = flat.x + flat.m11 * tilt.x + flat.m12 * tilt.y
        y0 = flat.y + flat.m21 * tilt.x + flat.m22 * tilt.y
        converged, x, y, facet = crossing.root_from(x0, y0, radius, shot, scene)
        if converged:
            counters[Counter.SOLVED.value] += 1
            n = crossing.add_root(roots, n, ZERO, x, y, facet, shot.branch, 1.0)
        # A failure of Newton is audited more often than a success: it may hide the only crossing.
        share_solved = 1.0 if search.curvature * flat.lever > _FOCUSING else search.audit
        # Russian roulette: roots of the full search are weighted by 1 / share.
        share = share_solved if converged else max(share_solved, _AUDIT_FAILED)
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
    """Return whether the open segment of a chain can end within `radius` of a flat crossing.

    A segment that leads away from the source (q . v >= 0) only gains distance: its last vertex must
    be nearer to the source than the farthest point of the surface there.
    """
    if dot(shot.q, shot.v) < 0.0:
        return True
    source = shot.start
    side = math.hypot(flat.x - source.x, flat.y - source.y) + radius
    rise = scene.surface.high[2] - source.z  # up to the highest crest
    return dot(shot.q, shot.q) < side * side + rise * rise


@entry
def contributions(chains, flat, search, scene, out):
    """Add the contribution of each chain to `out.score`; return the number of recorded arrivals.

    Array twin: the analog estimator.
    `flat` are the records of `flat_crossings`.
    """
    # Manifold next-event estimation (Hanika et al. 2015), for whole histories that are turned about
    # their source: the track-rotation estimator, see `crossing`.
    arrivals = ZERO
    for i in range(len(chains.last)):
        n = ZERO
        for k in range(len(flat[i])):
            if flat[i, k].branch == 0.0:
                if k == 0:
                    out.counters[Counter.NO_FLAT.value] += 1
                break
            shot = shot_of(chains, i, scene, flat[i, k].branch, scene.surface.roughness)
            audit = chains.audit[i]
            n = _roots_near(n, flat[i, k], audit, search, shot, scene, out.roots, out.counters)
        for k in range(n):
            root = out.roots[k]
            shot = shot_of(chains, i, scene, root.branch, scene.surface.roughness)
            path = weigh(chains, i, root.x, root.y, root.facet, shot, scene)
            w = path.weight * root.multiplicity
            if w > 0.0:
                arrivals = add_path(chains, i, w, path, i, arrivals, scene, out)
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
            # a crossing of the raised sea only: still water does not reach so high
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
    """Add the contribution of each chain to the aperture centred at each of the given places.

    Returns the number of arrivals. Chain i to place m has the index m * chains + i in `out.score`
    and in the arrivals.

    Array twin: `contributions`, which solves for the crossings of a chosen slope.
    Here the crossing is sampled: that of a flat sea, displaced by a random slope of the Gaussian
    `spread`. The slope that sends the light to the goal follows, without iterations. A crossing to
    which several flat ones lead is divided by the sum of their densities. The estimate is unbiased
    wherever the samples are centred: `flat` are the crossings for the aperture of the scene, moved
    to first order for its `places` (m, 3) [m]; `near` is scratch for those of a chain.
    """
    # Next-event estimation through a rough refracting surface: the crossing is sampled, the slope
    # that connects it is unique (Walter et al. 2007), its density is the weight.
    arrivals, n = ZERO, len(chains.last)
    for m in range(len(places)):
        moved = aperture_at(row(places, m), scene)
        x, y = places[m, 0] - scene.target.center.x, places[m, 1] - scene.target.center.y
        for i in range(n):
            if flat[i, 0].branch == 0.0:
                out.counters[Counter.NO_FLAT.value] += 1
                continue
            for k in range(len(near)):
                near[k] = flat[i, k]
                # by dP / d(centre of the aperture): to first order only, since the weight is exact
                # for any proposal
                near[k].x += flat[i, k].c11 * x + flat[i, k].c12 * y
                near[k].y += flat[i, k].c21 * x + flat[i, k].c22 * y
            for k in range(len(near)):
                if near[k].branch == 0.0:
                    break
                path = _sloped_crossing(chains, i, near, k, spread, moved)
                if path.weight > 0.0:
                    out.counters[Counter.SOLVED.value] += 1
                    w, place = path.weight, m * n + i
                    arrivals = add_path(chains, i, w, path, place, arrivals, moved, out)
    return arrivals


@inlined
def _lifted(flat, scene):
    """Return (x, y) of a flat crossing, displaced by the height of the surface there."""
    facet = locate(scene.locator, scene.surface, flat.x, flat.y)
    rise = 0.0
    if facet >= 0:
        rise = height_on(flat.x, flat.y, facet, scene.surface) - flat.level
    return flat.x + flat.h1 * rise, flat.y + flat.h2 * rise


@outlined
def _density(flat, x, y, branch, spread, scene):
    """Return the density of the proposed crossings at (x, y) [m-2], on one branch.

    Summed over the flat crossings that may lead there: each is displaced by M s, where M is
    dP/dslope and the slope s is drawn from the Gaussian `spread`.
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
        # s = M^-1 (P - P0), the slope that leads here
        s = Vec2(flat[k].m22 * dx - flat[k].m12 * dy, flat[k].m11 * dy - flat[k].m21 * dx)
        u = whitened(spread, s)
        # The density of s per slope, over |det M|, is that of P per area.
        law = math.exp(-0.5 * (u.x * u.x + u.y * u.y))
        total += law / (2.0 * math.pi * spread.along * spread.across * abs(det))
    return total


@outlined
def _sloped_crossing(chains, i, flat, k, spread, scene):
    """Sample the `Crossing` of chain i near flat crossing k.

    Its weight is its contribution over the density of the point P.
    """
    x, y = _lifted(flat[k], scene)
    # the random slope of the chain samples P here, it is not the slope of the water
    s = slope_tilt(spread, chains.tilt[i, 0], chains.tilt[i, 1])
    x = x + flat[k].m11 * s.x + flat[k].m12 * s.y
    y = y + flat[k].m21 * s.x + flat[k].m22 * s.y
    facet = locate(scene.locator, scene.surface, x, y)
    shot = shot_of(chains, i, scene, flat[k].branch, scene.surface.roughness)
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))
    ok, length, w, d = crossing.emission_through(shot.q, shot.v, minus(p, shot.start), shot.branch)
    no_aim = crossing.Aim(False, shot.goal, w, d, UP, 1.0, length, 0.0)
    dark = Crossing(0.0, True, no_aim, p, shot.start)
    # outside the mesh, or from above through the facet
    if facet < 0 or not ok or dot(d, row(scene.surface.face_normals, facet)) <= 0.0:
        return dark
    n = normal_at(x, y, facet, scene.surface)
    slope = slope_towards(p, n, w, d, length, shot.goal, scene)
    # Several flat crossings may lead here: the sum of their densities is the balance heuristic for
    # equal numbers of samples (Veach and Guibas 1995).
    density = _density(flat, x, y, shot.branch, spread, scene)
    if slope.density == 0.0 or density == 0.0:
        return dark
    ok_x, w_x = _emission_at(x + crossing.STEP, y, facet, shot, scene)
    ok_y, w_y = _emission_at(x, y + crossing.STEP, facet, shot, scene)
    if not (ok_x and ok_y):  # no derivative: the last vertex is closer to the surface than a step
        return dark
    # P is drawn with `density` per area of the sea; slopes that are drawn at P land on X with
    # `slope.density` per area of the aperture. The ratio takes the place of |det dX/dP|.
    turns = crossing.quotients(w, w_x, w_y)
    per_area = crossing.emission_per_area(turns, w, density / slope.density)
    shot = crossing.Shot(shot.start, shot.q, shot.v, shot.goal, shot.branch, slope.tilt)
    weight, deep = weight_of(chains, i, p, slope.aim, per_area, facet, shot, scene)
    return Crossing(weight, is_steep(slope.aim, scene) and deep, slope.aim, p, shot.start)


@inlined
def _emission_at(x, y, facet, shot, scene):
    """Return (ok, w): the direction of emission that leads through a facet's plane at (x, y)."""
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))
    ok, _, w, _ = crossing.emission_through(shot.q, shot.v, minus(p, shot.start), shot.branch)
    return ok, w


@outlined
def add_path(chains, i, w, path, place, n, scene, out):
    """Add the contribution w of chain i by a `Crossing` to the score, unless its path is cut off.

    Array twin: none, sums.
    `place` is the index of the score, n the number of arrivals before; returned is that after.
    """
    aim, bodies = path.aim, scene.bodies
    clear = path.steep or _is_clear(chains, i, path, scene)
    # beside bodies chains have no scatterings: their paths are two straight ways
    clear = clear and not is_hidden(path.start, aim.w, aim.length, bodies)
    if not clear or is_hidden(path.point, aim.r, aim.flight, bodies):
        # The estimator has no second crossing: light that meets another wave is left out.
        out.counters[Counter.BLOCKED.value] += 1
        return n
    out.score[place] += w
    if n < len(out.arrivals):
        a = out.arrivals[n]
        a.chain, a.weight = place, w
        a.water, a.air = chains.path[i] + aim.length, aim.flight
        write(a.point, path.point)
        write(a.emission, aim.w)
        n += 1
    return n


@inlined
def weigh(chains, i, x, y, facet, shot, scene):
    """Return the `Crossing` of chain i over (x, y) on a facet.

    Random slopes are drawn from a Gaussian; the ratio of the law of the slopes to it (its
    Gram-Charlier series, see `over_gaussian`) is a factor on the weight.
    """
    p = Vec3(x, y, height_on(x, y, facet, scene.surface))
    j = crossing.jacobian(x, y, facet, shot, scene)
    per_area = crossing.solid_angle_per_area(j)
    weight, deep = weight_of(chains, i, p, j.aim, per_area, facet, shot, scene)
    weight *= over_gaussian(scene.surface.roughness.series, chains.tilt[i, 0], chains.tilt[i, 1])
    return Crossing(weight, is_steep(j.aim, scene) and deep, j.aim, p, shot.start)


@inlined
def weight_of(chains, i, p, aim, per_area, facet, shot, scene):
    """Return (|A| I(w) W dOmega/dX, whether all vertices are deep) of chain i at a crossing.

    `aim` is that at P, `per_area` dOmega/dX [sr m-2], 0 if no light lands; `shot` has the random
    slope. The emitter's power multiplies A: 1, or the etendue of a receiver that emits in reverse.
    """
    if per_area == 0.0:
        return 0.0, True
    n = normal_at(p.x, p.y, facet, scene.surface) if facet >= 0 else UP
    passed = crossing.passed(intensity(scene.emitter, aim.w), aim, p, n, facet, shot.tilt, scene)
    if passed == 0.0:
        return 0.0, True
    # last, since it costs most
    w, deep = _transmit(chains, i, aim, p, shot.start, scene)
    area = scene.target.area * scene.emitter.power
    return area * passed * per_area * w * chains.weight[i], deep


@inlined
def turned(w, p):
    """Rotate a vector p of a chain by the minimal rotation from e_z to the emission direction w.

    Array twin: the rotation matrix of the tests.
    Undefined for w = -e_z, see `crossing.emission_per_area`.
    """
    # Rodrigues for the axis e_z x w, in a form without square roots (Moller and Hughes 1999).
    axial = (-w.y * p.x + w.x * p.y) / (1.0 + w.z)
    return Vec3(
        p.x * w.z + w.x * p.z - w.y * axial,
        p.y * w.z + w.y * p.z + w.x * axial,
        p.z * w.z - w.x * p.x - w.y * p.y,
    )


@inlined
def _vertex(chains, i, k, aim, start):
    """Return vertex k of chain i in the scene [m]."""
    return plus(turned(aim.w, row(chains.vertex[i], k)), start)


@inlined
def _transmit(chains, i, aim, p, start, scene):
    """Return (scattering coefficients times transmittance [m-K], whether all vertices are deep).

    K is the number of scatterings, "deep" means below the lowest trough of the sea.
    """
    medium = scene.medium
    before = start
    uniform = is_uniform(medium)
    weight, tau, deep = 1.0, 0.0, True
    for k in range(chains.vertex.shape[1]):
        v = _vertex(chains, i, k, aim, start)
        # Above the lowest trough a vertex may lie in the air: rays must check its segments.
        if v.z > scene.surface.low[2]:
            deep = False
        # Light that meets the bottom is not followed; segments between points above do not.
        if v.z < medium.bottom_z:
            return 0.0, True
        if uniform:
            # Directions are drawn from the phase function, which cancels; the coefficient remains.
            weight *= medium.b
        else:
            if chains.kind[i, k] == 1:  # a bubble
                weight *= bubble_scattering(medium, v)
            else:
                weight *= water_coefficients(medium, v.z)[1]
            length = norm(minus(v, before))
            tau += absorption_path(medium, before.z, v.z, length)
            tau += scattering_path(medium, before, v, length)
        before = v
    if uniform:
        # `chains.weight` is divided by the density of the distances already: the whole exp(-tau)
        # is a factor here.
        tau = (medium.a + medium.b) * (chains.path[i] + aim.length)
    else:
        tau += absorption_path(medium, before.z, p.z, aim.length)
        tau += scattering_path(medium, before, p, aim.length)
    return weight * math.exp(-tau), deep


@outlined
def _is_clear(chains, i, path, scene):
    """Return whether no wave cuts a segment of the path of a `Crossing`.

    The segments lead to each vertex, to P, and on to the aperture if the paths in the air are
    followed. A vertex in the air needs no test of its own: the segment to it crosses the surface.
    """
    aim, start, slope = path.aim, path.start, scene.surface.max_slope
    order = chains.vertex.shape[1]
    for k in range(order + (2 if scene.interface.follow_second_hit else 1)):
        if k < order:
            end = _vertex(chains, i, k, aim, path.start)
        elif k == order:
            end = path.point
        else:
            end = along(path.point, aim.r, aim.flight)
        segment = minus(end, start)
        length = norm(segment)
        climbs = segment.z > slope * math.hypot(segment.x, segment.y) and k >= order
        # Segments at P that are steeper than every slope of the sea do not meet it again.
        if length > 0.0 and not climbs:
            if not is_free(start, unit(segment), length, scene.surface, scene.locator):
                return False
        start = end
    return True


class Colours(NamedTuple):
    """Tints, their mixtures for the wavelengths, and the factors on a straight path."""

    tints: Tints | None  # None: one wavelength
    mixture: Mixture
    clear: Medium  # water with b = 0: its `scattering_path` is that of the bubbles alone
    log_weights: NDArray[np.float64]  # (tints,) scratch: logarithms along the path
    # (2, wavelengths) row 0: factors on the weight of the last path; row 1: scratch
    factors: NDArray[np.float64]


@outlined
def straight_factors(p, q, colours):
    """Write the factors of all wavelengths on light along a straight path from p to q.

    Array twin: see `tint_chains`.
    """
    reset_tint(colours.tints, colours.log_weights)
    _add_way(p, q, colours.clear, colours.tints, colours.log_weights)
    fill_factors(colours.mixture, colours.log_weights, colours.factors)


@inlined
def _add_way(p, q, clear, tints, log_weights):
    """Add the logarithms of the transmittance from p to q, one for each tint, to `log_weights`."""
    if tints is not None:
        length = norm(minus(q, p))
        tint_way(tints, log_weights, p.z, q.z, length)
        # the excess optical depth by bubbles is that of the base times a factor of each tint
        depth = scattering_path(clear, p, q, length)
        for r in range(len(tints.c)):
            log_weights[r] -= tints.bubble_c[r] * depth


@entry
def tint_chains(chains, arrivals, emitter, clear, tints, out):
    """Write the log weights (arrivals, tints) of chains that arrive, see `kernels.tints`.

    Array twin: direct runs of the wavelengths.
    `clear` is the water with b = 0, see `Colours`.
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
                # 2 asin(chord / 2) keeps the digits of small angles, acos of a product does not.
                s = 0.5 * norm(minus(unit(way), unit(last)))
                theta = 2.0 * math.asin(min(s, 1.0))
                tint_scattering(tints, log_weights, before.z, theta, chains.kind[i, k - 1] == 1)
            _add_way(before, at, clear, tints, log_weights)
            before, last = at, way


@entry
def tint_straight(start, ends, clear, tints, out):
    """Write the log weights (paths, tints) of straight paths from a point to ends (paths, 3).

    Array twin: see `tint_chains`.
    """
    for n in range(len(ends)):
        reset_tint(tints, out[n])
        _add_way(start, row(ends, n), clear, tints, out[n])
