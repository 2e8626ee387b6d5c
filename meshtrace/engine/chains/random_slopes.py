"""Random slopes of a surface that bend light from a point to a point.

The normal of a facet that bends light at P from the direction d to r is parallel to n_w d - n_a r,
so that one slope s* does it. The light at a landing point x is the density of the random slopes at
s* - s(P) times |det ds*/dx|, s(P) the slope of the mesh [1]_. Points x are in metres from the
centre of the aperture, slopes u in standard deviations along and across the wind. A mirrored scene
is a downlink turned upside down, see `kernels.scene.Scene`: the source lies in the air below the
surface, and the denser side lies behind it. N is `big` in the code.

References
----------
.. [1] B. Walter, S. R. Marschner, H. Li and K. E. Torrance, "Microfacet models for refraction
   through rough surfaces", Eurographics Symposium on Rendering (2007),
   doi:10.2312/EGWR/EGSR07/195-206.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.engine import crossing
from meshtrace.kernels.interface import mirror_reflectance, normal_at, over_gaussian, reflectance
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.vectors import Vec2, along, dot, dot2, minus, minus2, norm, scaled

MOST_SLOPE = 5.0
"""Standard deviations of random slopes: 4e-6 of the light meets larger ones.

With 6 the gain of the default link changes by 3e-6, see the table in `microfacets`.
"""


class Slope(NamedTuple):
    """Random slope that refracts light to a point; infinite, of density 0, where none does."""

    along: float  # the wind, in standard deviations
    across: float  # the wind, in standard deviations
    tilt: Vec2  # the same slope along x and y, in addition to that of the mesh
    density: float  # of landing points [m-2], without the factor `exposure`
    aim: crossing.Aim


@inlined
def whitened(roughness, tilt):
    """Return a slope along and across the wind in standard deviations.

    Array twin: the inverse of `slope_tilt`.
    """
    return Vec2(
        (roughness.cos * tilt.x + roughness.sin * tilt.y) / roughness.along,
        (roughness.cos * tilt.y - roughness.sin * tilt.x) / roughness.across,
    )


@inlined
def normal_from_source(p, goal, scene):
    """Return `normal_to` for light straight from the source.

    Array twin: see `normal_to`.
    """
    way = minus(p, scene.emitter.position)
    return normal_to(p, scaled(1.0 / norm(way), way), goal, scene)


@inlined
def normal_to(p, d, goal, scene):
    """Return (N, r, flight); N = n_w d - n_a r is normal to the facet that bends d to a point.

    Array twin: the facet of that normal, on which `crossing.land` meets the point.
    The point is `goal` on the plane of the aperture, r the direction to it, `flight` its distance.
    A facet that reflects has the normal d - r, as if both indices were 1.
    """
    target = scene.target
    n_before, n_behind = indices(scene)
    at = along(along(target.center, target.e1, goal.x), target.e2, goal.y)
    way = minus(at, p)
    flight = norm(way)
    r = scaled(1.0 / flight, way)
    big = along(scaled(n_before, d), r, -n_behind)
    # Into the denser side N points against the light; facets are known by their upward normals.
    against = scene.mirrored and not scene.reflects
    return scaled(-1.0, big) if against else big, r, flight


@inlined
def indices(scene):
    """Return the indices before and behind a facet that weight the directions in `normal_to`.

    Array twin: none, a choice.
    """
    if scene.reflects:
        return 1.0, 1.0
    return scene.medium.n_water, scene.medium.n_air


@outlined
def slope_towards(p, n, w, d, length, goal, scene):
    """Return the `Slope` that refracts or reflects light at P to a point of the aperture's plane.

    Array twin: `crossing.land` of the tilted normal, and its derivatives by the tilt.
    n is the normal of the mesh, w the direction of emission, d that of arrival.
    """
    # Walter et al. (2007), eqs. 13 and 16: the half vector, of refraction n_w d - n_a r and of
    # reflection d - r, is along the normal.
    big, r, flight = normal_to(p, d, goal, scene)
    size = norm(big)
    cos_i, cos_t = dot(big, d) / size, dot(big, r) / size
    aim = crossing.Aim(False, goal, w, d, r, 1.0, length, flight)
    unreachable = Slope(math.inf, math.inf, Vec2(0.0, 0.0), 0.0, aim)
    bends = cos_t < 0.0 if scene.reflects else cos_t > 0.0
    if big.z <= 0.0 or not bends or dot(r, scene.target.axis) <= 1e-9:
        return unreachable
    # slope of the required normal, -N_xy / N_z, less that of the mesh, -n_xy / n_z
    tilt = Vec2(n.x / n.z - big.x / big.z, n.y / n.z - big.y / big.z)
    roughness = scene.surface.roughness
    u = whitened(roughness, tilt)
    square = u.x * u.x + u.y * u.y
    if square > MOST_SLOPE * MOST_SLOPE:
        return unreachable
    # dr/dx = (e - r (r.e)) / flight for either axis e of the aperture; k has all factors but a, b
    k = indices(scene)[1] / (flight * big.z * big.z)
    a = along(scene.target.e1, r, -dot(r, scene.target.e1))
    b = along(scene.target.e2, r, -dot(r, scene.target.e2))
    # s = -N_xy / N_z with dN = -n_a dr: ds = n_a (dr_xy N_z - N_xy dr_z) / N_z^2
    det = (a.x * big.z - big.x * a.z) * (b.y * big.z - big.y * b.z)
    det -= (a.y * big.z - big.y * a.z) * (b.x * big.z - big.x * b.z)
    # Density of slopes times |det ds/dx|, the density of landing points [m-2].
    density = math.exp(-0.5 * square) / (2.0 * math.pi * roughness.along * roughness.across)
    density *= over_gaussian(roughness.series, u.x, u.y)
    rho = 1.0
    if not scene.reflects:
        rho = reflectance(cos_i, cos_t, scene.medium.n_water, scene.medium.n_air)
    else:
        rho = mirror_reflectance(cos_i, scene.medium.n_water, scene.medium.n_air)
    aim = crossing.Aim(True, goal, w, d, r, rho, length, flight)
    return Slope(u.x, u.y, tilt, density * k * k * abs(det), aim)


@outlined
def slope_gradient(p, n, w, length, at, ahead, step, scene):
    """Return (ok, du/dt, du/dy, dv/dt, dv/dy), the change of a `Slope` with its landing point.

    Array twin: finite differences of `slope_towards`.
    [m-1], u and v along and across the wind; t is along the unit vector `ahead` on the plane of the
    aperture, y to the left of it. Forward differences over `step` from the point `at`; not ok where
    one of the three points is out of reach. n, w, length: see `slope_towards`.
    """
    x = Vec2(at.x + step * ahead.x, at.y + step * ahead.y)
    z = Vec2(at.x - step * ahead.y, at.y + step * ahead.x)
    o = slope_towards(p, n, w, w, length, at, scene)
    a = slope_towards(p, n, w, w, length, x, scene)
    b = slope_towards(p, n, w, w, length, z, scene)
    if math.isinf(o.along) or math.isinf(a.along) or math.isinf(b.along):
        return False, 0.0, 0.0, 0.0, 0.0
    g11, g12 = (a.along - o.along) / step, (b.along - o.along) / step
    return True, g11, g12, (a.across - o.across) / step, (b.across - o.across) / step


@outlined
def slope_change(f, p, q, r, scene):
    """Return (largest difference, least size) of the slopes needed at three points of a facet.

    Array twin: see `slope_towards`.
    Slopes to the centre of the aperture, in standard deviations; infinite if none refracts light to
    it at a point.
    """
    u, v, w = _needed(p, f, scene), _needed(q, f, scene), _needed(r, f, scene)
    square = variation(u, v, w)
    least = math.sqrt(min(dot2(u, u), dot2(v, v), dot2(w, w)))
    return math.sqrt(square) if square < math.inf else math.inf, least


@inlined
def _needed(p, f, scene):
    """Return the random slope at P on a facet that refracts light to the centre of the aperture."""
    u, n_z = slope_to(p, f, Vec2(0.0, 0.0), scene)
    return u if n_z > 0.0 else Vec2(math.inf, math.inf)


@inlined
def slope_to(p, f, goal, scene):
    """Return the random slope at P that refracts light to a point, and N_z, see `normal_to`.

    Array twin: `slope_towards`.
    """
    n = normal_at(p.x, p.y, f, scene.surface)
    big, _, _ = normal_from_source(p, goal, scene)
    # N_z <= 0: no facet that faces up refracts there, a huge slope stands for it
    steep = max(big.z, 1e-9)
    tilt = Vec2(n.x / n.z - big.x / steep, n.y / n.z - big.y / steep)
    return whitened(scene.surface.roughness, tilt), big.z


@inlined
def variation(u, v, w):
    """Return the square of the largest difference between three slopes.

    Array twin: none, three distances.
    """
    a, b, c = minus2(u, v), minus2(v, w), minus2(w, u)
    return max(dot2(a, a), dot2(b, b), dot2(c, c))
