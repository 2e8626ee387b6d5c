"""Light through a surface with random slopes, by integration over the slopes.

Light that arrives at a crossing P with the direction d leaves it towards a point x of an aperture
if the normal of the surface is parallel to n_w d - n_a r, r the direction from P to x. That slope
s*(P, x) is unique, so the light at x is the density of the random slopes at s* - s(P), times
|det ds*/dx|, s(P) the slope of the mesh: no search for roots, no caustics. This is refraction by
microfacets [1]_, their normals distributed by the slopes of the sea [2]_.

A facet is cut into parts (`unscattered.Part`), light runs from the source to the centroid of each:
a `pencils.Pencil`, whose light on the aperture is computed there. Slopes u are in standard
deviations along and across the wind. A mirrored scene is a downlink turned upside down, see
`kernels.scene.Scene`: the source lies in the air below the surface, and the denser side lies behind
it. N is `big` in the code.

References
----------
.. [1] B. Walter, S. R. Marschner, H. Li and K. E. Torrance, "Microfacet models for refraction
   through rough surfaces", Eurographics Symposium on Rendering (2007),
   doi:10.2312/EGWR/EGSR07/195-206.
.. [2] C. Cox and W. Munk, J. Opt. Soc. Am. 44, 838 (1954), doi:10.1364/JOSA.44.000838.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.engine.chains import pencils, random_slopes, unscattered
from meshtrace.kernels import sources
from meshtrace.kernels.interface import FieldOfView, normal_at
from meshtrace.kernels.jit import ZERO, entry, inlined, outlined
from meshtrace.kernels.medium import depth_between
from meshtrace.kernels.vectors import Vec2, Vec3, blend, dot, dot2, minus, minus2, norm, row, scaled

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

# Bounds, tuned: smaller ones could leave out light, larger ones cost time.
_CLIPPED = 2.0 * random_slopes.MOST_SLOPE  # size of slopes beyond which a change cuts no part

_BESIDE, _MEETS_RIM, _INSIDE = 0, 1, 2  # place of the light of a part on the aperture
_LITTLE = 1e-9  # number of parts that stands for "light, but no cut": 0 means no light
_NODES = np.int64(2**24)  # steps along an edge of a facet: 24 halvings stay whole numbers


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
    if not _is_reached(p, h, blocks.bend[b], scene):
        return False
    return not sources.is_dark(p, h, dark, scene.emitter)


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
    dark, most = sources.dark_angle(scene.emitter), 0.0
    # two passes for beams: how bright a facet is decides how finely it is cut
    first_length = _COARSE if scene.emitter.kind == sources.SourceKind.GAUSSIAN_BEAM else 1.0
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
                if work[pencils.Work.LEFT.value] <= 0.0:
                    whole = pencils.pencil_to(
                        unscattered.Part(f, _NODES, ZERO, ZERO, _NODES), scene
                    )
                    work[pencils.Work.CUT_SHORT.value] += max(
                        gain[f], whole.intensity * whole.omega
                    )
                coarse[f], most = finer and first_length > 1.0, max(most, gain[f])
    for f in range(len(gain)):
        if coarse[f] and gain[f] > _DIM * most:
            if work[pencils.Work.LEFT.value] <= 0.0:
                work[pencils.Work.CUT_SHORT.value] += gain[f]
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
    big, _, flight = random_slopes.normal_to(p, scaled(1.0 / length, way), Vec2(0.0, 0.0), scene)
    # any point of the aperture may be aimed at: it adds to the turn of r
    wide = h + scene.target.radius
    if h >= length or wide >= flight:
        return False, big, 0.0
    n_before, n_behind = random_slopes.indices(scene)
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
    return missing <= broad * (random_slopes.MOST_SLOPE * (big.z + turn) + slack / narrow)


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
        u = random_slopes.whitened(
            rough, Vec2(n.x / n.z * big.z - big.x, n.y / n.z * big.z - big.y)
        )
        steep = math.sqrt(n.x * n.x + n.y * n.y) / n.z + bend
        slack = turn * math.sqrt(1.0 + steep * steep) + bend * (abs(big.z) + turn)
        if math.sqrt(dot2(u, u)) > random_slopes.MOST_SLOPE * (big.z + turn) + slack / narrow:
            return False
    return not sources.is_dark(p, h, dark, scene.emitter)


@outlined
def _facet_light(f, coarse, dark, rule, stack, work, scene):
    """Return (gain, finer) of a facet, as the sum over its parts.

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
        if work[pencils.Work.LEFT.value] <= 0.0:
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
    width = sources.beam_width(emitter) * -emitter.position.z
    inside, flight = pencils.margin(p, Vec2(0.0, 0.0), scene)
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
        where = _spot_place(part, pencils.pencil_to(part, scene), scene)
        if where == _BESIDE:
            return 0.0, 0.0
        edge = math.inf
    if emitter.kind == sources.SourceKind.TOP_HAT_BEAM:
        seen = math.asin(min(h / norm(minus(p, emitter.position)), 1.0))
        if abs(sources.off_axis(p, emitter) - emitter.spread) <= seen:  # the rim may pass through
            edge = min(edge, RIM_BEAM * width)
    longest = 2.0 * facet.radius * share
    # all light of the part is collected, whatever its slopes
    if where == _INSIDE:
        return longest / (PART_BEAM * width), max(longest / edge, _LITTLE)
    a, b, c = unscattered.corners_of(part, scene.surface)
    change, least = random_slopes.slope_change(f, a, b, c, scene)
    # The centre is nearer to all points than corners are to each other; slopes far from linear get
    # no such credit.
    from_center = 0.5 if change < _EVEN else 1.0
    # Slopes to the rim of the aperture differ from those to its centre by twice what vertical light
    # needs:
    # ds = n dr / N_z, dr = radius / flight, in the smaller standard deviation.
    big, _, flight = random_slopes.normal_from_source(p, Vec2(0.0, 0.0), scene)
    rough, n = scene.surface.roughness, max(*random_slopes.indices(scene))
    narrow = min(rough.along, rough.across)
    rim = 2.0 * n * scene.target.radius / (flight * max(big.z, 1e-9) * narrow)
    beyond = least - from_center * (change + rim)
    if beyond > random_slopes.MOST_SLOPE:
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
    height, apart, ahead, seen = pencils.view_disk(middle, scene)
    if height <= 0.0:
        return _BESIDE
    m = crossing.land_from(middle, pencil.normal, w, w, pencil.length, scene)
    spot = pencils.spot_of(pencil, ahead, height, scene)
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
    reach = math.sqrt(spot.half_t * spot.half_t + spot.half_y * spot.half_y) + pencils.BENT * moves
    from_view = math.sqrt((spot.t - apart) * (spot.t - apart) + spot.y * spot.y)
    from_center, slack = math.sqrt(dot2(m.at, m.at)), size * (1.0 + scene.target.tan_half_fov)
    if from_center - reach > radius:
        return _BESIDE
    if seen < math.inf and from_view - reach - slack > seen:
        return _BESIDE
    inside_view = math.isinf(seen) or from_view + reach + slack <= seen
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
        change = max(change, random_slopes.variation(u, v, w))
    return math.sqrt(change)


@inlined
def _clipped(p, f, goal, scene):
    """Return the random slope at P that refracts light to a point, at most `_CLIPPED` in size."""
    u, _ = random_slopes.slope_to(p, f, goal, scene)
    # Far beyond `MOST_SLOPE` there is no light, and a change there must not cut parts.
    share = min(_CLIPPED / max(math.sqrt(dot2(u, u)), 1e-12), 1.0)
    return Vec2(share * u.x, share * u.y)


@inlined
def _lens_edge(p, h, scene):
    """Return the longest edge of a part where the view may end within the aperture [m].

    Infinite where the view of all points within h of P lies inside the aperture: no rims meet.
    """
    radius = scene.target.radius
    height, apart, _, seen = pencils.view_disk(p, scene)
    # As P moves by h, the centre of the view moves by h at most, its radius by h tan(half view).
    moves = h * (1.0 + scene.target.tan_half_fov)
    if scene.interface.fov != FieldOfView.ANGLE:  # the view does not depend on the direction
        return unscattered.VIEW_SHARE * unscattered.view_radius(
            height, scene.target, scene.interface.fov
        )
    if apart + seen + moves < radius:
        return math.inf
    return _LENS_SHARE * min(radius, max(seen, 0.0))


@outlined
def _part_gain(part, rule, work, scene):
    """Return the gain of a part of a facet.

    Where a part is smaller than the aperture the view of its centroid stands for all of it; a
    larger one is cut at the edge of the view of each node.
    """
    pencil = pencils.pencil_to(part, scene)
    middle, radiant, radius = pencil.middle, pencil.intensity, scene.target.radius
    inside, _ = pencils.margin(middle, Vec2(0.0, 0.0), scene)
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
    area, total = 1.0, 0.0  # 1: `pencils.lens_light` is integrated over the area already
    if at_edge or rule.is_wide:
        work[pencils.Work.LENSES.value] += 1.0
        total = pencils.lens_light(pencil, rule, work, scene)
        if scene.interface.fov != FieldOfView.ANGLE and inside <= near:  # the same for all nodes
            total *= pencils.share_in_view(p, q, r, Vec2(0.0, 0.0), scene)
    else:
        work[pencils.Work.LEFT.value] -= len(rule.points)
        area, total = pencils.disk_light(pencil, near, inside, (p, q, r), rule, scene)
    # the way to the centroid stands for those of the part; all nodes share it
    if not scene.mirrored:
        tau = depth_between(scene.medium, source, middle, pencil.length)
        radiant *= math.exp(-tau)
    return area * radiant * pencil.omega * total
