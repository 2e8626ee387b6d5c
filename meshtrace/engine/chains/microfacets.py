"""Light through a surface with random slopes, by integration over the slopes.

Light that arrives at a crossing P with the direction d leaves it towards a point x of an aperture
if the normal of the surface is parallel to n_w d - n_a r, r the direction from P to x. That slope
s*(P, x) is unique, so the light at x is the density of the random slopes at s* - s(P), times
|det ds*/dx|, s(P) the slope of the mesh: no search for roots, no caustics. This is refraction by
microfacets [1]_, their normals distributed by the slopes of the sea [2]_.

A facet is cut into parts (`unscattered.Part`), light runs from the source to the centroid of each:
a `Pencil`. Its light on the aperture's plane is a `Spot`, roughly Gaussian; where the field of view
of the centroid ends within the aperture, its `ViewDisk` bounds what counts. Points of that plane
are in metres from the centre of the aperture, slopes u in standard deviations along and across the
wind. A mirrored scene is a downlink turned upside down, see `kernels.scene.Scene`: the source lies
in the air below the surface, and the denser side lies behind it. N is `big` in the code.

References
----------
.. [1] B. Walter, S. R. Marschner, H. Li and K. E. Torrance, "Microfacet models for refraction
   through rough surfaces", Eurographics Symposium on Rendering (2007),
   doi:10.2312/EGWR/EGSR07/195-206.
.. [2] C. Cox and W. Munk, J. Opt. Soc. Am. 44, 838 (1954), doi:10.1364/JOSA.44.000838.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.engine.chains import unscattered
from meshtrace.engine.chains.random_slopes import (
    MOST_SLOPE,
    indices,
    normal_from_source,
    normal_to,
    slope_change,
    slope_gradient,
    slope_to,
    slope_towards,
    variation,
    whitened,
)
from meshtrace.kernels.interface import FieldOfView, exposure, normal_at
from meshtrace.kernels.jit import ZERO, entry, inlined, outlined
from meshtrace.kernels.medium import depth_between
from meshtrace.kernels.sources import (
    SourceKind,
    beam_width,
    dark_angle,
    intensity,
    is_dark,
    off_axis,
)
from meshtrace.kernels.vectors import (
    Vec2,
    Vec3,
    along,
    blend,
    dot,
    dot2,
    minus,
    minus2,
    norm,
    plus,
    row,
    scaled,
)

# What each constant costs: the change of the gain and of the time (x) when it is made twice as
# careful, measured over a sea of 5 m/s for (led) the default link, (view) a view of 10 degrees onto
# a radius of 3 m, (beam) a Gaussian beam of 1 degree, (hat) a top hat of 2 degrees. _FINEST,
# _LENS_SHARE and _NEAR changed none of the four by 1e-9. `aimed.LEAST_ERROR` covers the sum. The
# line below a constant has the more careful value, and what that changed.
PART_SLOPE = 0.7  # standard deviations by which the slope may change over a part of a facet
# 0.35: led 2e-4, x 1.6; view 2e-5, x 3.1; hat 1e-5
PART_BEAM = 0.2  # longest edge of a part over the width of the beam at still water
# 0.1: beam 2e-5, x 5; hat 5e-5, x 1.2
RIM_BEAM = 0.02  # the same for parts that the sharp rim of a beam may cross
# 0.01: hat 7e-7, x 1.9
MOST_PARTS = 48
"""Parts along an edge of a facet of a map; facets with more are too large for the blur."""

# A facet that needs more parts along an edge is quartered, and quarters without light are left out:
# changes the time alone.
_FEW = 16
# Errors at the edges of parts cancel between neighbours that are cut alike. Facets with fewer such
# neighbours are cut into more parts, by these factors: a facet that is cut at all,
_FINE = 1.5
# 3.0: led 2e-4, x 1.6; view 2e-5, x 3; beam 2e-5, x 2.8; hat 6e-5
# a quarter, for the profile of the beam, by which all facets in it are cut alike,
_HALF_FINER = 2.0
# 4.0: hat 1e-5, x 1.1
# and a quarter, for edges of light and slopes, by which no two neighbours are cut alike.
_FINER = 4.0
# 8.0: hat 1e-5, x 1.9
_FINEST = 1.0 / 64.0  # least edge of a part for the edge of the view, over PART_BEAM: bounds time
_LENS_SHARE = 0.25  # longest edge of a part over the smaller of aperture and view: its light
# changes smoothly over that length where their rims meet
_NEAR = 2.0  # sizes of a part within which the edge of the field of view may cross it
_FAINT = 3.5  # deviations; parts that need larger slopes are not cut for these: 2e-3 of the light
_EVEN = 5.0  # change of slope over a part [deviations], below which half of it is counted from
# the centre; above it slopes are too far from linear
# without either: led 1.5e-6, x 1.05
_COARSE = 4.0  # factor on the lengths of parts, in the first pass over a Gaussian beam
_DIM = 1e-5  # gain over that of the brightest facet, up to which the first pass is enough
# without them: beam 8e-7, x 2.2
_PER_DEVIATION = 1.2  # Gauss nodes per standard deviation of the light on the aperture
# 2.4: view 4e-7, x 1.8
_AT_LEAST = 2.5  # Gauss nodes: light that hardly changes
# 5.0: view 4e-7, x 1.7
GAUSS = 32
"""Gauss nodes along a line at most: those of a Gaussian profile of 2 x 1.25 x 5 deviations fit."""

# Bounds, tuned: smaller ones could leave out light, larger ones cost time.
BENT = 1.25
"""Factor on extents of light from slopes that are linear in the landing point: not quite true."""
_PROBE = 0.5  # distance over which slopes are taken for linear, over the width of the light
_CLIPPED = 2.0 * MOST_SLOPE  # size of slopes beyond which a change cuts no part

_BESIDE, _MEETS_RIM, _INSIDE = 0, 1, 2  # place of the light of a part on the aperture
_LITTLE = 1e-9  # number of parts that stands for "light, but no cut": 0 means no light
_NODES = np.int64(2**24)  # steps along an edge of a facet: 24 halvings stay whole numbers


class Rule(NamedTuple):
    """Quadratures over an aperture: over all of it, and over its part that the view accepts.

    The first has fixed nodes. It serves where the whole aperture is in view and not much wider than
    the light of a facet. Elsewhere Gauss nodes lie between the rims of aperture and view.
    """

    points: NDArray[np.float64]  # (n, 2) of the unit disk
    shares: NDArray[np.float64]  # (n,) of the area
    is_wide: bool  # the aperture is much wider than the light of a facet
    nodes: NDArray[np.float64]  # (GAUSS, GAUSS), row n - 1 has n nodes of the unit interval
    weights: NDArray[np.float64]  # (GAUSS, GAUSS)
    # factors on the lengths of parts and on the numbers of Gauss nodes: 1, or others to estimate
    # the error of the quadrature by the change
    parts: float
    finer: float


class Work(IntEnum):
    """Indices into the array in which `blurred_gain` counts its work."""

    LEFT = 0  # nodes that may still be evaluated
    LENSES = 1  # parts that are integrated with Gauss nodes between rims, see `_lens_light`
    CUT_SHORT = 2  # gain of facets for which no nodes were left: a bound of their error


class Blocks(NamedTuple):
    """Groups of neighbouring facets, so that one bound excludes most of them at once."""

    start: NDArray[np.int64]  # (blocks + 1,) first row of `facet` of each block, and the end
    facet: NDArray[np.int64]  # indices of the facets, block by block
    middle: NDArray[np.float64]  # (blocks, 3)
    radius: NDArray[np.float64]  # (blocks,) largest distance of a point of a facet from it [m]
    bend: NDArray[np.float64]  # (blocks,) largest change of slope over a facet


@inlined
def _block_may_shine(b, blocks, dark, scene):
    """Return whether a facet of a block may send light to the aperture.

    Array twin: `may_shine` of its facets.
    """
    p, h = row(blocks.middle, b), blocks.radius[b]
    # blocks are those of the surface as it is
    if scene.mirrored:
        p = Vec3(p.x, p.y, -p.z)
    return _is_reached(p, h, blocks.bend[b], scene) and not is_dark(p, h, dark, scene.emitter)


@entry
def blurred_gain(scene, rule, blocks, stack, coarse, work, gain):
    """Write the unscattered gain of each facet.

    `stack` is scratch for (STACK, 3) integers: i, j, side of parts. `coarse` is scratch for a flag
    of each facet, False at the start: it was cut coarsely. For `work` see `Work`. Facets are not
    cut any more when no nodes are left.

    Array twin: chains without scatterings.
    gain = int dOmega I exp(-tau) int_A dx p(s* - s) |det ds*/dx| E T over the facet, p the density
    of random slopes, E the exposure, T the transmittance. A facet is cut into parts over which the
    slope s* - s changes by a fraction of its standard deviation, and the light by a fraction of its
    width. A Gaussian beam has no rim: all facets are cut into few parts first, then the brighter
    ones are cut anew. Five of six facets have a thousandth of the light.
    """
    dark, most = dark_angle(scene.emitter), 0.0
    # two passes for beams: how bright a facet is decides how finely it is cut
    first_length = _COARSE if scene.emitter.kind == SourceKind.GAUSSIAN_BEAM else 1.0
    # Quadrature of the refraction lobe of Walter et al. (2007) over facets and aperture; no
    # sampling.
    for b in range(len(blocks.radius)):
        # thousands of receivers of a map ask: most blocks, and facets, answer by a bound
        if not _block_may_shine(b, blocks, dark, scene):
            continue
        for k in range(blocks.start[b], blocks.start[b + 1]):
            f = blocks.facet[k]
            facet = scene.facets[f]
            p = Vec3(facet.x, facet.y, facet.z)
            if may_shine(f, p, unscattered.spatial_radius(facet), dark, scene):
                total, finer = _facet_light(f, first_length, dark, rule, stack, work, scene)
                gain[f] = unscattered.unless_hidden(total, f, scene)
                # The error of an uncut facet is at most all light onto it.
                if work[Work.LEFT.value] <= 0.0:
                    whole = pencil_to(unscattered.Part(f, _NODES, ZERO, ZERO, _NODES), scene)
                    work[Work.CUT_SHORT.value] += max(gain[f], whole.intensity * whole.omega)
                coarse[f], most = finer and first_length > 1.0, max(most, gain[f])
    for f in range(len(gain)):
        if coarse[f] and gain[f] > _DIM * most:
            if work[Work.LEFT.value] <= 0.0:
                work[Work.CUT_SHORT.value] += gain[f]
                continue
            gain[f], _ = _facet_light(f, 1.0, dark, rule, stack, work, scene)


@inlined
def _turn_within(p, h, scene):
    """Return (bounded, N, turn): |N - N(P)| <= turn, see `normal_to`, within a distance h of P.

    Array twin: `may_shine` of facets there.
    Directions turn by at most h / (D - h), D the distance of the source or of the aperture. Not
    bounded: the source or the aperture may lie as near as h.
    """
    way = minus(p, scene.emitter.position)
    length = norm(way)
    big, _, flight = normal_to(p, scaled(1.0 / length, way), Vec2(0.0, 0.0), scene)
    # any point of the aperture may be aimed at: it adds to the turn of r
    wide = h + scene.target.radius
    if h >= length or wide >= flight:
        return False, big, 0.0
    n_before, n_behind = indices(scene)
    return True, big, n_before * h / (length - h) + n_behind * wide / (flight - wide)


@inlined
def _is_reached(p, h, bend, scene):
    """Return whether the steepest facet within h of P may send light to the aperture.

    Array twin: `may_shine` of facets there, which see.
    """
    bounded, big, turn = _turn_within(p, h, scene)
    if not bounded:
        return True
    if big.z + turn <= 0.0:  # also where N is antiparallel to the normal
        return False
    rough = scene.surface.roughness
    narrow, broad = min(rough.along, rough.across), max(rough.along, rough.across)
    # A facet of slope s refracts along N if N_xy = -s N_z. What is missing from |N_xy| <= |s| N_z
    # must come from random slopes, at most `MOST_SLOPE` deviations. Within h, N_xy + s N_z changes
    # by at most `slack`: turn sqrt(1 + s^2) by N, and bend (|N_z| + turn) by s.
    steep = scene.surface.max_slope + bend
    slack = turn * math.sqrt(1.0 + steep * steep) + bend * (abs(big.z) + turn)
    missing = math.sqrt(big.x * big.x + big.y * big.y) - steep * abs(big.z)
    return missing <= broad * (MOST_SLOPE * (big.z + turn) + slack / narrow)


@inlined
def may_shine(f, p, h, dark, scene):
    """Return whether random slopes may send light through a part of a facet.

    Array twin: `_part_gain` of its parts.
    The bounds hold for any size: within a distance h of its centre P the normal N = n_w d - n_a r
    which refracts to the aperture changes by at most `turn`, see `_turn_within`.
    """
    bend = 2.0 * h * scene.facets[f].curvature
    # most facets lie where the steepest one is not steep enough
    if not _is_reached(p, h, bend, scene):
        return False
    bounded, big, turn = _turn_within(p, h, scene)
    if bounded:
        rough = scene.surface.roughness
        narrow = min(rough.along, rough.across)
        n = normal_at(p.x, p.y, f, scene.surface)
        # N_z times the slope that is missing at P, s* - s = -N_xy / N_z + n_xy / n_z, so that
        # light along the surface (N_z = 0) divides by nothing
        u = whitened(rough, Vec2(n.x / n.z * big.z - big.x, n.y / n.z * big.z - big.y))
        steep = math.sqrt(n.x * n.x + n.y * n.y) / n.z + bend
        slack = turn * math.sqrt(1.0 + steep * steep) + bend * (abs(big.z) + turn)
        if math.sqrt(dot2(u, u)) > MOST_SLOPE * (big.z + turn) + slack / narrow:
            return False
    return not is_dark(p, h, dark, scene.emitter)


@outlined
def _facet_light(f, coarse, dark, rule, stack, work, scene):
    """Return (gain, finer) of a facet, which is cut into parts or quartered first.

    Parts are `coarse` times as long as they should be; `finer` is whether any of them should be
    cut, so that a second pass with shorter parts changes the gain.
    """
    total, finer = 0.0, False
    coarse *= rule.parts
    # A facet of few parts is cut evenly. One of more is quartered, since most of its quarters need
    # fewer, or send no light.
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, _NODES
    top = 1
    while top > 0:
        top -= 1
        part = unscattered.part_on(stack, top, f, _NODES)
        side = abs(part.side)
        smooth, sharp = _parts_along(part, rule, scene)
        if sharp == 0.0:
            continue
        finer = finer or max(smooth, sharp) > 1.0
        smooth, sharp = smooth / coarse, sharp / coarse
        n = max(smooth, sharp, 1.0)
        if side < _NODES:
            n = max(_HALF_FINER * smooth, _FINER * sharp, 1.0)
            p = unscattered.centroid(part, scene.surface)
            h = unscattered.spatial_radius(scene.facets[f]) * side / _NODES
            if not may_shine(f, p, h, dark, scene):
                continue
        if work[Work.LEFT.value] <= 0.0:
            n = 1.0
        if n > _FEW and side > 1:
            top = unscattered.push_quarters(stack, top, part)
            continue
        m = math.ceil(min(n, float(_FEW)))
        if m > 1 and side == _NODES:
            m = math.ceil(_FINE * n)
        for i in range(m):
            for k in range(2 * (m - i) - 1):
                total += _part_gain(unscattered.subpart(part, m, i, k), rule, work, scene)
    return total, finer


@outlined
def _parts_along(part, rule, scene):
    """Return (smooth, sharp): into how many parts each edge of a part should be cut.

    `smooth` resolves the profile of the beam, by which all facets are cut alike, `sharp` edges of
    light and slopes; `sharp` is 0 where no slope that counts sends light to the aperture.
    """
    f, emitter = part.facet, scene.emitter
    facet, share = scene.facets[f], abs(part.side) / _NODES
    p = unscattered.centroid(part, scene.surface)
    h = unscattered.spatial_radius(facet) * share
    width = beam_width(emitter) * -emitter.position.z
    inside, flight = margin(p, Vec2(0.0, 0.0), scene)
    # out of view: no cut, `_part_gain` returns nothing
    if inside < -_NEAR * (h + scene.target.radius):
        return 1.0, 1.0
    # Where the edge of the view may cross, parts are a share of it; the same everywhere in view,
    # as neighbours of the same cut cancel errors, see `_FINE`.
    view = unscattered.view_radius(flight, scene.target, scene.interface.fov)
    share_of_view = unscattered.VIEW_SHARE * view
    if inside <= _NEAR * (h + scene.target.radius) and share_of_view < scene.target.radius:
        share_of_view = _lens_edge(p, h, scene)
    edge = max(share_of_view, _FINEST * PART_BEAM * width)
    where = _MEETS_RIM
    # on a wide aperture Gauss nodes follow the rims: parts need not
    if rule.is_wide:
        where = _spot_place(part, pencil_to(part, scene), scene)
        if where == _BESIDE:
            return 0.0, 0.0
        edge = math.inf
    if emitter.kind == SourceKind.TOP_HAT_BEAM:
        seen = math.asin(min(h / norm(minus(p, emitter.position)), 1.0))
        if abs(off_axis(p, emitter) - emitter.spread) <= seen:  # the rim may pass through
            edge = min(edge, RIM_BEAM * width)
    longest = 2.0 * facet.radius * share
    # all light of the part is collected, whatever its slopes
    if where == _INSIDE:
        return longest / (PART_BEAM * width), max(longest / edge, _LITTLE)
    a, b, c = unscattered.corners_of(part, scene.surface)
    change, least = slope_change(f, a, b, c, scene)
    # The centre is nearer to all points than corners are to each other; slopes far from linear get
    # no such credit.
    from_center = 0.5 if change < _EVEN else 1.0
    # Slopes to the rim of the aperture differ from those to its centre by twice what vertical light
    # needs:
    # ds = n dr / N_z, dr = radius / flight, in the smaller standard deviation.
    big, _, flight = normal_from_source(p, Vec2(0.0, 0.0), scene)
    rough, n = scene.surface.roughness, max(*indices(scene))
    narrow = min(rough.along, rough.across)
    rim = 2.0 * n * scene.target.radius / (flight * max(big.z, 1e-9) * narrow)
    beyond = least - from_center * (change + rim)
    if beyond > MOST_SLOPE:
        return 0.0, 0.0
    if beyond > _FAINT:
        change = 0.0
    elif change > _FEW * PART_SLOPE:
        change = min(change, _clipped_change(f, a, b, c, scene))
    smooth, sharp = longest / (PART_BEAM * width), max(longest / edge, _LITTLE)
    if rule.is_wide:  # light changes smoothly where the rim passes through it
        return max(smooth, change / PART_SLOPE), sharp
    return smooth, max(change / PART_SLOPE, sharp)


@outlined
def _spot_place(part, pencil, scene):
    """Return whether the light of a part falls inside both rims, on a rim, or beside the aperture.

    Array twin: none, a bound.
    The light of its centroid covers its `Spot`; that of other points is taken for the same spot
    about their landing points, which lie no farther off than those of the corners.
    """
    surface, source, radius = scene.surface, scene.emitter.position, scene.target.radius
    f, middle, w = part.facet, pencil.middle, pencil.w
    view = _view_of(middle, scene)
    if view.high <= 0.0:
        return _BESIDE
    m = crossing.land_from(middle, pencil.normal, w, w, pencil.length, scene)
    spot = _spot(pencil, view.ahead, view.high, scene)
    if not m.ok or math.isinf(spot.half_t):
        return _MEETS_RIM
    moves, size = 0.0, 0.0
    for p in unscattered.corners_of(part, surface):
        way = minus(p, source)
        length = norm(way)
        w, normal = scaled(1.0 / length, way), normal_at(p.x, p.y, f, surface)
        at = crossing.land_from(p, normal, w, w, length, scene)
        if not at.ok:
            return _MEETS_RIM
        off = minus2(at.at, m.at)
        moves, size = max(moves, math.sqrt(dot2(off, off))), max(size, norm(minus(p, middle)))
    # Circles: the light of the part, from the centre of the aperture and from that of the view,
    # which moves with the point of the part by at most `slack`.
    reach = math.sqrt(spot.half_t * spot.half_t + spot.half_y * spot.half_y) + BENT * moves
    from_view = math.sqrt((spot.t - view.apart) * (spot.t - view.apart) + spot.y * spot.y)
    from_center, slack = math.sqrt(dot2(m.at, m.at)), size * (1.0 + scene.target.tan_half_fov)
    if from_center - reach > radius:
        return _BESIDE
    if view.radius < math.inf and from_view - reach - slack > view.radius:
        return _BESIDE
    inside_view = math.isinf(view.radius) or from_view + reach + slack <= view.radius
    return _INSIDE if from_center + reach <= radius and inside_view else _MEETS_RIM


@outlined
def _clipped_change(f, p, q, r, scene):
    """Return the largest variation of clipped slopes to points of the aperture, over a part.

    The larger variation of slopes to the centre and to the point of the rim that lies farthest from
    the source: from some parts light reaches that point, but not the centre. In deviations.
    """
    target = scene.target
    way = minus(blend(1.0 / 3.0, 1.0 / 3.0, p, q, r), scene.emitter.position)
    ahead = Vec2(dot(way, target.e1), dot(way, target.e2))
    length = max(math.sqrt(dot2(ahead, ahead)), 1e-12)
    rim = Vec2(target.radius * ahead.x / length, target.radius * ahead.y / length)
    change = 0.0
    for goal in (Vec2(0.0, 0.0), rim):
        u, v, w = (
            _clipped(p, f, goal, scene),
            _clipped(q, f, goal, scene),
            _clipped(r, f, goal, scene),
        )
        change = max(change, variation(u, v, w))
    return math.sqrt(change)


@inlined
def _clipped(p, f, goal, scene):
    """Return the random slope at P that refracts light to a point, at most `_CLIPPED` in size."""
    u, _ = slope_to(p, f, goal, scene)
    # Far beyond `MOST_SLOPE` there is no light, and a change there must not cut parts.
    share = min(_CLIPPED / max(math.sqrt(dot2(u, u)), 1e-12), 1.0)
    return Vec2(share * u.x, share * u.y)


@inlined
def margin(p, goal, scene):
    """Return (`view_margin`, distance) [m] of light from P to a point of the aperture.

    Array twin: see `unscattered.view_margin`.
    """
    target = scene.target
    way = minus(along(along(target.center, target.e1, goal.x), target.e2, goal.y), p)
    flight = norm(way)
    r = scaled(1.0 / flight, way)
    return unscattered.view_margin(p, r, flight, target, scene.interface.fov), flight


@outlined
def _share_in_view(p, q, r, goal, scene):
    """Return the share of a triangle from which a point of the aperture sees light.

    Array twin: fine meshes in the tests.
    The edge of the field of view is taken for a straight line.
    """
    a, b, c = margin(p, goal, scene)[0], margin(q, goal, scene)[0], margin(r, goal, scene)[0]
    # corners in view; ZERO makes the sum an integer
    seen = ZERO + (a >= 0.0) + (b >= 0.0) + (c >= 0.0)
    if seen == 0 or seen == 3:
        return seen / 3.0
    if (a >= 0.0) == (c >= 0.0):
        a, b, c = b, c, a
    elif (a >= 0.0) == (b >= 0.0):
        a, b, c = c, a, b
    # similar triangles: the edges from corner a are cut at a / (a - b) and a / (a - c)
    corner = a * a / ((a - b) * (a - c))
    return corner if seen == 1 else 1.0 - corner


class Pencil(NamedTuple):
    """Pencil of rays from the source to a part of a facet."""

    middle: Vec3  # centroid of the part [m]
    normal: Vec3  # of the mesh there, interpolated
    w: Vec3  # direction from the source
    length: float  # from the source [m]
    omega: float  # solid angle of the part from the source [sr]
    intensity: float  # towards the middle [sr-1], 0 behind the facet


@inlined
def pencil_to(part, scene):
    """Return the `Pencil` of rays from the source to a part of a facet."""
    f, surface, source = part.facet, scene.surface, scene.emitter.position
    p, q, r = unscattered.corners_of(part, surface)
    p, q, r = minus(p, source), minus(q, source), minus(r, source)
    way = blend(1.0 / 3.0, 1.0 / 3.0, p, q, r)
    length = norm(way)
    w = scaled(1.0 / length, way)
    middle = plus(source, way)
    normal = normal_at(middle.x, middle.y, f, surface)
    facing = dot(w, row(surface.face_normals, f))
    strength = intensity(scene.emitter, w) if facing > 0.0 else 0.0
    return Pencil(middle, normal, w, length, unscattered.solid_angle(p, q, r), strength)


class ViewDisk(NamedTuple):
    """Disk of the aperture's plane on which light of a point of the surface is accepted."""

    high: float  # distance of the point from the plane of the aperture, along its axis [m]
    apart: float  # distance of the disk's centre from that of the aperture [m]
    ahead: Vec2  # unit vector from the centre of the aperture to that of the disk
    radius: float  # [m], infinite without an edge


@inlined
def _view_of(p, scene):
    """Return the `ViewDisk` of a point: the plane cuts the cone about the axis in a circle."""
    target = scene.target
    way = minus(p, target.center)
    high, x, y = -dot(way, target.axis), dot(way, target.e1), dot(way, target.e2)
    apart = math.sqrt(x * x + y * y)
    ahead = Vec2(x / apart, y / apart) if apart > 0.0 else Vec2(1.0, 0.0)
    has_edge = scene.interface.fov == FieldOfView.ANGLE and target.cos_half_fov > 0.0
    return ViewDisk(high, apart, ahead, high * target.tan_half_fov if has_edge else math.inf)


@inlined
def _lens_edge(p, h, scene):
    """Return the longest edge of a part where the view may end within the aperture [m].

    Infinite where the view of all points within h of P lies inside the aperture: no rims meet.
    """
    view, radius = _view_of(p, scene), scene.target.radius
    # As P moves by h, the centre of the view moves by h at most, its radius by h tan(half view).
    moves = h * (1.0 + scene.target.tan_half_fov)
    if scene.interface.fov != FieldOfView.ANGLE:  # the view does not depend on the direction
        return unscattered.VIEW_SHARE * unscattered.view_radius(
            view.high, scene.target, scene.interface.fov
        )
    if view.apart + view.radius + moves < radius:
        return math.inf
    return _LENS_SHARE * min(radius, max(view.radius, 0.0))


class Spot(NamedTuple):
    """Light of a part on the aperture's plane: axes t along `ViewDisk.ahead`, y to its left."""

    t: float  # centre, from that of the aperture [m]
    y: float
    half_t: float  # half-width beyond which slopes exceed `MOST_SLOPE` [m]
    half_y: float
    sigma_t: float  # standard deviation along t at a fixed y [m]
    sigma_y: float  # along y at a fixed t


@outlined
def _spot(pencil, ahead, high, scene):
    """Return the `Spot` of a pencil, from slopes that are linear in the landing point.

    Array twin: none, a bound.
    """
    rough = scene.surface.roughness
    n = scene.medium.n_water / scene.medium.n_air
    # Vertical light turns by (n - 1) times a slope, and by twice the slope in a mirror: the width
    # where there is no gradient.
    turn = 2.0 if scene.reflects else abs(n - 1.0)
    narrow = turn * high * min(rough.along, rough.across)
    unknown = Spot(0.0, 0.0, math.inf, math.inf, narrow, narrow)
    middle, normal, w = pencil.middle, pencil.normal, pencil.w
    m = crossing.land_from(middle, normal, w, w, pencil.length, scene)
    if not m.ok:
        return unknown
    ok, g11, g12, g21, g22 = slope_gradient(
        middle, normal, w, pencil.length, m.at, ahead, _PROBE * narrow, scene
    )
    det = abs(g11 * g22 - g12 * g21)
    if not ok or det == 0.0:
        return unknown
    along_t, along_y = math.sqrt(g11 * g11 + g21 * g21), math.sqrt(g12 * g12 + g22 * g22)
    # The ellipse |G x| <= MOST_SLOPE, G the gradient, has a bounding box of the half-widths
    # MOST_SLOPE |column| / det; the column is that of the other axis.
    reach = BENT * MOST_SLOPE / det
    return Spot(
        m.at.x * ahead.x + m.at.y * ahead.y,
        m.at.y * ahead.x - m.at.x * ahead.y,
        reach * along_y,
        reach * along_t,
        1.0 / along_t,
        1.0 / along_y,
    )


@inlined
def _number_of_nodes(length, sigma, rule):
    """Return the number of Gauss nodes for a length [m] of light of a standard deviation sigma."""
    wanted = rule.finer * (_AT_LEAST + _PER_DEVIATION * length / sigma)
    return math.ceil(min(max(wanted, 2.0), GAUSS + 0.0))


@inlined
def _passed(s, pencil, scene):
    """Return the share of light that passes the surface by a `Slope`, and the way behind it."""
    if unscattered.is_shadowed(pencil.middle, s.aim.r, s.aim.flight, scene, scene.bodies):
        return 0.0
    share = exposure(pencil.w, pencil.normal, s.tilt)
    share *= crossing.transmittance(s.aim, scene)
    # water before the surface dims a pencil as a whole, see `_part_gain`
    if scene.mirrored != scene.reflects and share > 0.0:
        share *= math.exp(-unscattered.depth_behind(pencil.middle, s.aim, scene))
    return share


@outlined
def _lens_light(pencil, rule, work, scene):
    """Return the share of a pencil that lands on the aperture where the view accepts it.

    Array twin: `still_gain` in the tests, over rows of the aperture.
    Aperture (radius r) and view (radius R, at a distance D) are disks, whose overlap is a lens;
    light beyond `MOST_SLOPE` is left out. Along the line of their centres, t, the chord is
    half = sqrt(min(r^2 - t^2, R^2 - (t - D)^2)): a root at either end, which t = end + L v^2 makes
    linear in v, and a bend where the rims meet, at which two Gauss rules join. Across it light is
    smooth.
    """
    view, radius = _view_of(pencil.middle, scene), scene.target.radius
    low, high = max(-radius, view.apart - view.radius), min(radius, view.apart + view.radius)
    if view.high <= 0.0 or low >= high:
        return 0.0
    s = _spot(pencil, view.ahead, view.high, scene)
    # Where the two rules join: the centre of the smaller disk where it lies inside the other one,
    # else where the rims meet, r^2 - t^2 = R^2 - (t - D)^2.
    bend = 0.0
    if view.apart + view.radius <= radius:
        bend = view.apart
    elif view.apart + radius > view.radius:
        bend = 0.5 * (view.apart + (radius - view.radius) * (radius + view.radius) / view.apart)
    total = 0.0
    for side in range(2):
        end = low if side == 0 else high
        near, far = max(low, s.t - s.half_t), min(high, s.t + s.half_t)
        if side == 0:
            far = min(far, bend)
        else:
            near = max(near, bend)
        if near >= far:
            continue
        start, length = (near, far - near) if side == 0 else (far, near - far)
        # The chord vanishes like a square root at the rim only: a stretch that stops short of it,
        # or at the bend, is smooth.
        rooted = start == end
        n = _number_of_nodes(far - near, s.sigma_t, rule)
        for i in range(n):
            v = rule.nodes[n - 1, i]
            t = start + length * (v * v if rooted else v)
            weight = rule.weights[n - 1, i] * (far - near) * (2.0 * v if rooted else 1.0)
            # half-chords of either disk at t; the smaller one bounds the lens
            off = t - view.apart
            square = min(radius * radius - t * t, view.radius * view.radius - off * off)
            half = math.sqrt(max(square, 0.0))
            total += weight * _chord_light(pencil, t, half, view.ahead, s, rule, work, scene)
    return total


@inlined
def _chord_light(pencil, t, half, ahead, s, rule, work, scene):
    """Return the light on the chord of a lens at t, see `_lens_light`."""
    low, high = max(-half, s.y - s.half_y), min(half, s.y + s.half_y)
    if low >= high:
        return 0.0
    total = 0.0
    n = _number_of_nodes(high - low, s.sigma_y, rule)
    work[Work.LEFT.value] -= n
    for i in range(n):
        y = low + (high - low) * rule.nodes[n - 1, i]
        goal = Vec2(t * ahead.x - y * ahead.y, t * ahead.y + y * ahead.x)
        slope = slope_towards(
            pencil.middle, pencil.normal, pencil.w, pencil.w, pencil.length, goal, scene
        )
        if slope.density > 0.0:
            total += rule.weights[n - 1, i] * slope.density * _passed(slope, pencil, scene)
    return (high - low) * total


@inlined
def _disk_light(pencil, near, inside, corner, rule, scene):
    """Return (area, mean density) of the light of a pencil on the whole aperture.

    `inside` is how far the centroid lies inside the view of the centre of the aperture [m]. Within
    `near` [m] of its edge each node is weighted by the share that it sees of the part, the triangle
    of the given corners.
    """
    p, q, r = corner
    total, radius, area = 0.0, scene.target.radius, scene.target.area
    for k in range(len(rule.points)):
        goal = Vec2(radius * rule.points[k, 0], radius * rule.points[k, 1])
        s = slope_towards(
            pencil.middle, pencil.normal, pencil.w, pencil.w, pencil.length, goal, scene
        )
        if s.density > 0.0:
            share = 1.0 if inside > near else _share_in_view(p, q, r, s.aim.at, scene)
            total += rule.shares[k] * s.density * (share * _passed(s, pencil, scene))
    return area, total


@outlined
def _part_gain(part, rule, work, scene):
    """Return the gain of a part of a facet.

    Where a part is smaller than the aperture the view of its centroid stands for all of it; a
    larger one is cut at the edge of the view of each node.
    """
    pencil = pencil_to(part, scene)
    middle, radiant, radius = pencil.middle, pencil.intensity, scene.target.radius
    inside, _ = margin(middle, Vec2(0.0, 0.0), scene)
    p, q, r = unscattered.corners_of(part, scene.surface)
    size = max(norm(minus(p, middle)), norm(minus(q, r)))
    near = _NEAR * (size + radius)
    if radiant == 0.0 or inside < -near:
        return 0.0
    source = scene.emitter.position
    if unscattered.is_shadowed(source, pencil.w, pencil.length, scene, scene.bodies):
        return 0.0
    # Small parts see the rims of aperture and view alike: integrate over the lens. Larger ones take
    # fixed nodes and are cut at the view of each.
    at_edge = inside <= near and size <= radius and scene.interface.fov == FieldOfView.ANGLE
    area, total = 1.0, 0.0  # 1: `_lens_light` is integrated over the area already
    if at_edge or rule.is_wide:
        work[Work.LENSES.value] += 1.0
        total = _lens_light(pencil, rule, work, scene)
        if scene.interface.fov != FieldOfView.ANGLE and inside <= near:  # the same for all nodes
            total *= _share_in_view(p, q, r, Vec2(0.0, 0.0), scene)
    else:
        work[Work.LEFT.value] -= len(rule.points)
        area, total = _disk_light(pencil, near, inside, (p, q, r), rule, scene)
    # the way to the centroid stands for those of the part; all nodes share it
    if not scene.mirrored:
        tau = depth_between(scene.medium, source, middle, pencil.length)
        radiant *= math.exp(-tau)
    return area * radiant * pencil.omega * total
