"""Unscattered light on the cells of a map, from the images of all facets and free of noise.

The field of view is that of an angle, and accepts light alike in all cells. Cells lie on the plane
of the scene's aperture, whose centre is the middle of the map; `gain[k, m]` is the light on the
cell k along x and m along y, as the gain of an aperture of its area. Facets without random slopes
have images (`image_map`), those with them spots (`blurred_map`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.engine.chains import microfacets, pencils, random_slopes, unscattered
from meshtrace.engine.chains.gain import straight_factors
from meshtrace.engine.crossing import acceptance, aim_at, is_steep, straight_shot, transmittance
from meshtrace.kernels.interface import corners, exposure, normal_at
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import depth_between
from meshtrace.kernels.rays import is_free
from meshtrace.kernels.scene import height_on
from meshtrace.kernels.sources import beam_width, dark_angle, is_dark
from meshtrace.kernels.vectors import Vec2, Vec3, along, cross2, minus, minus2, norm, scaled

_ROUNDING = 1e-12  # share of an image below which its overlap with a cell is rounding
_AT_EDGE = 8  # points along a cell at the edge of the field of view: resolves 1/8 of a cell; tuned


class Cells(NamedTuple):
    """Square cells of the aperture's plane; coordinates are from its centre."""

    x: float  # lower corner of the first cell [m]
    y: float
    step: float  # edge of a cell [m]
    n: int  # along each axis


@inlined
def _cell_of(x, low, cells):
    """Return the index of the cell of a coordinate along an axis that starts at `low`.

    -1 or the number of cells outside: clipped before the conversion, which has to fit an integer.
    """
    return math.floor(min(max((x - low) / cells.step, -1.0), cells.n + 0.0))


@outlined
def _clip(poly, n, axis, bound, sign, out):
    """Clip a polygon of n corners to the half plane sign (x_axis - bound) >= 0.

    Writes `out` and returns the number of its corners.
    """
    m = 0
    for k in range(n):
        j = k + 1 if k + 1 < n else 0
        a, b = sign * (poly[k, axis] - bound), sign * (poly[j, axis] - bound)
        if a >= 0.0:
            out[m, 0], out[m, 1] = poly[k, 0], poly[k, 1]
            m += 1
        if (a > 0.0 and b < 0.0) or (a < 0.0 and b > 0.0):
            t = a / (a - b)
            out[m, 0] = poly[k, 0] + t * (poly[j, 0] - poly[k, 0])
            out[m, 1] = poly[k, 1] + t * (poly[j, 1] - poly[k, 1])
            m += 1
    return m


@inlined
def _moments(poly, n):
    """Return signed area and centroid of a polygon of n corners."""
    area, mx, my = 0.0, 0.0, 0.0
    if n < 3:
        return area, Vec2(mx, my)
    # A fan of triangles about the first corner: distances from it keep the digits of small areas.
    ox, oy = poly[0, 0], poly[0, 1]
    for k in range(1, n - 1):
        ax, ay = poly[k, 0] - ox, poly[k, 1] - oy
        bx, by = poly[k + 1, 0] - ox, poly[k + 1, 1] - oy
        s = 0.5 * (ax * by - ay * bx)
        area, mx, my = area + s, mx + s * (ax + bx) / 3.0, my + s * (ay + by) / 3.0
    if area == 0.0:
        return 0.0, Vec2(ox, oy)
    return area, Vec2(ox + mx / area, oy + my / area)


@outlined
def _free(p, m, scene):
    """Return whether no wave cuts unscattered light before or behind its crossing p of `Aim` m."""
    source = scene.emitter.position
    if not is_free(source, m.d, m.length, scene.surface, scene.locator):
        return False
    if not scene.interface.follow_second_hit:
        return True
    return is_free(p, m.r, m.flight, scene.surface, scene.locator)


@outlined
def _radiant(x, y, f, shot, scene):
    """Return the transmitted intensity [sr-1] over (x, y) on facet f; 0 if waves cut it off."""
    m = aim_at(x, y, f, shot, scene)
    if not m.ok:
        return 0.0
    p = Vec3(x, y, height_on(x, y, f, scene.surface))
    # last the test that costs most: rays through the waves
    if not (is_steep(m, scene) or _free(p, m, scene)):
        return 0.0
    return unscattered.carried(1.0, p, m, scene)


@outlined
def _triangle_cells(triangle, f, cells, poly, shot, scene, colours, gain):
    """Add the light of a triangle, three corners on facet f, to the cells of its image.

    Array twin: `unscattered.image_gain` of one aperture.
    """
    a, b, c = triangle
    # the cells that the bounding box of the image meets
    west = _cell_of(min(a.at.x, b.at.x, c.at.x), cells.x, cells)
    east = _cell_of(max(a.at.x, b.at.x, c.at.x), cells.x, cells)
    south = _cell_of(min(a.at.y, b.at.y, c.at.y), cells.y, cells)
    north = _cell_of(max(a.at.y, b.at.y, c.at.y), cells.y, cells)
    # Most images lie in one cell, which takes all of their light without clipping.
    source, in_one_cell = scene.emitter.position, west == east and south == north
    # The flux of a part is its solid angle at the source times the intensity: exact for any size.
    omega = unscattered.solid_angle(minus(a.p, source), minus(b.p, source), minus(c.p, source))
    for k in range(max(west, 0), min(east, cells.n - 1) + 1):
        x = cells.x + (k + 0.5) * cells.step
        for m in range(max(south, 0), min(north, cells.n - 1) + 1):
            y = cells.y + (m + 0.5) * cells.step
            share, u, v = 1.0, 1.0 / 3.0, 1.0 / 3.0
            if not in_one_cell:
                share, u, v = _overlap(a.at, b.at, c.at, x, y, 0.5 * cells.step, poly)
            if share > 0.0:
                # light that is linear in the image has its mean over the overlap at the centroid
                at = along(along(a.p, minus(b.p, a.p), u), minus(c.p, a.p), v)
                radiant = _radiant(at.x, at.y, f, shot, scene)
                if radiant > 0.0:
                    straight_factors(source, at, colours)
                    factors = colours.factors[0]
                    for colour in range(len(factors)):
                        gain[k, m, colour] += omega * share * radiant * factors[colour]


@outlined
def _overlap(a, b, c, x, y, half, poly):
    """Return (share, u, v): the share of a triangle on a cell, and barycentrics of its centroid.

    Array twin: Monte Carlo areas in the tests.
    (x, y) is the middle of the cell, `half` half of its edge. The image at a caustic, a point or a
    line, lies in the cell of its first corner.
    """
    ab, ac = minus2(b, a), minus2(c, a)
    det = cross2(ab, ac)
    # [m2]: smaller images would divide by rounding
    if abs(det) < 1e-14:
        share = 1.0 if abs(a.x - x) <= half and abs(a.y - y) <= half else 0.0
        return share, 1.0 / 3.0, 1.0 / 3.0
    poly[0, 0, 0], poly[0, 0, 1] = a.x, a.y
    poly[0, 1, 0], poly[0, 1, 1] = b.x, b.y
    poly[0, 2, 0], poly[0, 2, 1] = c.x, c.y
    # Sutherland and Hodgman (1974): half plane by half plane.
    n = _clip(poly[0], 3, 0, x - half, 1.0, poly[1])
    n = _clip(poly[1], n, 0, x + half, -1.0, poly[0])
    n = _clip(poly[0], n, 1, y - half, 1.0, poly[1])
    n = _clip(poly[1], n, 1, y + half, -1.0, poly[0])
    area, center = _moments(poly[0], n)
    share = 2.0 * abs(area) / abs(det)
    if share < _ROUNDING:
        return 0.0, 1.0 / 3.0, 1.0 / 3.0
    middle = minus2(center, a)
    return share, cross2(middle, ac) / det, cross2(ab, middle) / det


@inlined
def _landing(cells, coarse, stretch, scene):
    """Return the `unscattered.Landing` of light on all cells."""
    half, dark = 0.5 * cells.n * cells.step, dark_angle(scene.emitter)
    return unscattered.Landing(cells.x + half, cells.y + half, half, 0.0, dark, coarse, stretch)


@entry
def image_map(scene, cells, longer, stretch, lever, bend, stack, poly, colours, gain):
    """Add the unscattered gains (x, y, wavelengths) of cells, as apertures of their areas.

    Parts of facets are `longer` times as long as usual.

    Array twin: `unscattered.image_gain` of one aperture.
    For stretch, lever and bend see there; `poly` is room for two polygons, (2, 16, 2).
    """
    shot = straight_shot(0.0, 0.0, scene)
    # Facets are the outer loop: the image of a part lies in few cells.
    fine, coarse = unscattered.part_sizes(unscattered.BEAM_SHARE, bend, scene)
    for f in range(len(scene.surface.faces)):
        facet = scene.facets[f]
        landing = _landing(cells, coarse, stretch + lever * facet.curvature, scene)
        n, top = unscattered.whole_facet(2.0 * facet.radius / (longer * fine), stack)
        while top > 0:
            part, top = unscattered.next_part(f, n, landing, stack, top, shot, scene)
            if part.side != 0:
                triangles, first, second = unscattered.triangles_of(part, shot, scene)
                for k in range(triangles):
                    triangle = second if k else first
                    _triangle_cells(triangle, f, cells, poly, shot, scene, colours, gain)


@entry
def blurred_map(scene, cells, longer, stretch, most, across, rules, colours, gain):
    """Add the unscattered light (x, y, wavelengths) of cells through random slopes.

    Returns False if a facet has to be cut into more than `most` parts along an edge. `across` Gauss
    nodes along an edge of a cell suffice except at the edge of the field of view. Parts of facets
    are `longer` times as long as usual. `rules` are `aimed.gauss_rules`.

    Array twin: `microfacets.blurred_gain` of one aperture.
    """
    shot = straight_shot(0.0, 0.0, scene)
    edge = microfacets.PART_BEAM * beam_width(scene.emitter) * -scene.emitter.position.z
    source, center = scene.emitter.position, scene.target.center
    landing = _landing(cells, 0.0, stretch, scene)
    for f in range(len(scene.surface.faces)):
        facet = scene.facets[f]
        reach = scene.target.reach + facet.radius
        if unscattered.is_out_of_reach(facet.x - center.x, facet.y - center.y, reach, landing):
            continue
        p = Vec3(facet.x, facet.y, facet.z)
        if is_dark(p, unscattered.spatial_radius(facet), landing.dark, scene.emitter):
            continue
        # Light of the centroid by the normal of the mesh alone; random slopes spread it from there.
        m = aim_at(p.x, p.y, f, shot, scene)
        x, y = (m.at.x, m.at.y) if m.ok else (0.0, 0.0)
        size = 2.0 * facet.radius * stretch
        box = _cells_in_reach(p, minus(p, source), m, f, size, across, cells, scene)
        west, east, south, north, _ = box
        if west > east or south > north:
            continue
        a, b, c = corners(scene.surface.vertices, f, scene.surface.faces)
        # An aperture where that light lands. The slopes that refract light there tell the number of
        # parts, since light is brightest there.
        here = unscattered.aperture_at(Vec3(center.x + x, center.y + y, center.z), scene)
        change, _ = random_slopes.slope_change(f, a, b, c, here)
        if math.isinf(change) and not m.ok:
            change = 0.0  # light is reflected there
        parts = max(change / microfacets.PART_SLOPE, 2.0 * facet.radius / edge, 1.0) / longer
        if parts > most:
            return False
        n, whole = math.ceil(parts), unscattered.Part(f, 1, 0, 0, 1)
        for i in range(n):
            for k in range(2 * (n - i) - 1):
                part = unscattered.subpart(whole, n, i, k)
                _blurred_part(part, box, cells, rules, scene, colours, gain)
    return True


@outlined
def _cells_in_reach(p, way, m, f, size, most, cells, scene):
    """Return (west, east, south, north, nodes): the cells that random slopes send light to.

    Array twin: none, a bound.
    Indices of the first and last cells along x and y that light may reach through a facet, and the
    number of Gauss nodes along a cell that resolve it: the box about the ellipse of the largest
    slopes, for slopes linear in the landing point. `way` leads from the source to the centroid p, m
    is the `Aim` there without random slopes, `size` [m] that of the image of the facet, `most` the
    largest number of nodes along a cell.
    """
    whole = 0, cells.n - 1, 0, cells.n - 1, most
    length = norm(way)
    # 1/20 of the height: some 0.1 in the slope, over which landing points are linear
    w, step = scaled(1.0 / length, way), 0.05 * m.flight
    n = normal_at(p.x, p.y, f, scene.surface)
    if not m.ok:
        # Totally reflected by the mesh: random slopes may still let light pass. `most` is also the
        # size of a cell in deviations of the light. Cells smaller than a spot can be tested one by
        # one, see `_reached`.
        if most < random_slopes.MOST_SLOPE:
            return _reached(p, n, w, length, size, most, cells, scene)
        return whole
    ok, g11, g12, g21, g22 = random_slopes.slope_gradient(
        p, n, w, length, m.at, Vec2(1.0, 0.0), step, scene
    )
    det = g11 * g22 - g12 * g21
    if not ok or det == 0.0:
        return whole
    # bounding box of the ellipse |G x| <= MOST_SLOPE, as in `pencils.spot_of`
    reach = pencils.BENT * random_slopes.MOST_SLOPE / abs(det)
    dx = reach * math.sqrt(g12 * g12 + g22 * g22) + size
    dy = reach * math.sqrt(g11 * g11 + g21 * g21) + size
    square = g11 * g11 + g12 * g12 + g21 * g21 + g22 * g22
    # largest singular value of G: one point along a cell for each standard deviation
    steepest = math.sqrt(0.5 * (square + math.sqrt(max(square * square - 4.0 * det * det, 0.0))))
    return (
        max(_cell_of(m.at.x - dx, cells.x, cells), 0),
        min(_cell_of(m.at.x + dx, cells.x, cells), cells.n - 1),
        max(_cell_of(m.at.y - dy, cells.y, cells), 0),
        min(_cell_of(m.at.y + dy, cells.y, cells), cells.n - 1),
        min(math.ceil(cells.step * steepest), most),
    )


@outlined
def _reached(p, n, w, length, size, most, cells, scene):
    """Return `_cells_in_reach` of a facet whose own slope reflects all light.

    Array twin: none, a bound.
    A cell counts if some random slope refracts light to its centre.
    The light of a point of the facet is wider than a cell, so that none falls between two centres.
    """
    # The landing points of a facet spread by its size about those of its centroid.
    pad = math.ceil(size / cells.step)
    west, east, south, north = cells.n, -1, cells.n, -1
    for i in range(cells.n):
        for j in range(cells.n):
            at = Vec2(cells.x + (i + 0.5) * cells.step, cells.y + (j + 0.5) * cells.step)
            if random_slopes.slope_towards(p, n, w, w, length, at, scene).density > 0.0:
                west, east = min(west, i - pad), max(east, i + pad)
                south, north = min(south, j - pad), max(north, j + pad)
    last = cells.n - 1
    return max(west, 0), min(east, last), max(south, 0), min(north, last), most


@outlined
def _blurred_part(part, box, cells, rules, scene, colours, gain):
    """Add the light of a part of a facet, blurred by random slopes, to the cells of a box.

    Array twin: see `blurred_map`.
    """
    pencil = pencils.pencil_to(part, scene)
    if pencil.intensity == 0.0:
        return
    tau = depth_between(scene.medium, scene.emitter.position, pencil.middle, pencil.length)
    flux = pencil.intensity * math.exp(-tau) * pencil.omega
    flux *= cells.step * cells.step
    straight_factors(scene.emitter.position, pencil.middle, colours)
    west, east, south, north, nodes = box
    for k in range(west, east + 1):
        x = cells.x + (k + 0.5) * cells.step
        for m in range(south, north + 1):
            y = cells.y + (m + 0.5) * cells.step
            across = nodes
            inside, _ = pencils.margin(pencil.middle, Vec2(x, y), scene)
            if abs(inside) < 0.75 * cells.step:  # the edge of the field of view may pass through
                across = max(across, min(4 * across, _AT_EDGE))
            collected = flux * _blur(pencil, x, y, cells, across, rules, scene)
            if collected > 0.0:
                factors = colours.factors[0]
                for colour in range(len(factors)):
                    gain[k, m, colour] += collected * factors[colour]


@outlined
def _blur(pencil, x, y, cells, across, rules, scene):
    """Return the mean over a cell of the density [m-2] of a pencil's light, for a flux of 1.

    (x, y) is the middle of the cell.
    """
    total = 0.0
    middle, normal, w = pencil.middle, pencil.normal, pencil.w
    nodes, shares = rules[0, across - 1], rules[1, across - 1]
    for k in range(across * across):
        i, j = k // across, k % across
        goal = Vec2(x + cells.step * nodes[i], y + cells.step * nodes[j])
        s = random_slopes.slope_towards(middle, normal, w, w, pencil.length, goal, scene)
        if s.density > 0.0:
            share = acceptance(s.aim, middle, scene.target, scene.interface.fov)
            if share > 0.0 and (is_steep(s.aim, scene) or _free(middle, s.aim, scene)):
                share *= exposure(w, normal, s.tilt) * transmittance(s.aim, scene)
                total += shares[i] * shares[j] * s.density * share
    return total
