"""The sea surface: points, normals and random slopes of facets; Snell, Fresnel and whitecaps."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import allocating_entry, entry, inlined, outlined
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.vectors import (
    ORIGIN,
    UP,
    Vec2,
    Vec3,
    along,
    blend,
    combine,
    cross2,
    dot,
    minus,
    minus2,
    norm,
    on_circle,
    row,
    scaled,
    unit,
    write,
)


class Series(NamedTuple):
    """Ratio of the density of slopes to the Gaussian density, a polynomial cut off at 0.

    The fields are the coefficients of 1, a, a^2, a^3, a^4, c^2, a c^2, a^2 c^2, c^4, where a is the
    slope along the wind and c the slope across it, each over its standard deviation.
    """

    constant: float
    a: float
    aa: float
    aaa: float
    aaaa: float
    cc: float
    acc: float
    aacc: float
    cccc: float
    most: float  # largest ratio of the density to the Gaussian of variance `WIDE`; 0: no series


GAUSSIAN = Series(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
WIDE = 1.5
"""Variance of the Gaussian from which slopes of a series are proposed, in units of their own.

Above 1, for tails heavier than those of the density; tuned: a larger one rejects more proposals.
"""


class Roughness(NamedTuple):
    """Slopes of unresolved waves: standard deviations, wind direction, departure from Gaussian."""

    along: float  # standard deviation of the slope along the wind [1]
    across: float  # and across it [1]
    cos: float  # cosine and sine of the angle from +x to the direction that the wind blows to
    sin: float
    series: Series = GAUSSIAN


SMOOTH = Roughness(0.0, 0.0, 1.0, 0.0)
_RESOLUTION = 2.0**-52  # a uniform (k + 1/2) 2^-32 over it is a whole number: no bit is lost
_LEAST_ROUGH = 0.3  # least z of the unit normal of a facet that gets random slopes


class Triangles(NamedTuple):
    """Corners and normals of facets; a `MeshArrays` may stand in its place."""

    vertices: NDArray[np.float64]  # (n, 3)
    faces: NDArray[np.int32]  # (m, 3)
    face_normals: NDArray[np.float64]  # (m, 3)


class MeshArrays(NamedTuple):
    """A triangle mesh as arrays, see `meshtrace.mesh.TriangleMesh`."""

    vertices: NDArray[np.float64]  # (n, 3)
    faces: NDArray[np.int32]  # (m, 3)
    face_normals: NDArray[np.float64]  # (m, 3)
    vertex_normals: NDArray[np.float64]  # (n, 3)
    low: NDArray[np.float64]  # (3,) lowest corner of the bounds
    high: NDArray[np.float64]  # (3,)
    max_slope: float  # steepest slope of a facet [1], inf under overhangs
    interpolate: bool  # True: normals interpolated between the corners, False: the facet's own
    roughness: Roughness = SMOOTH
    level: float = 0.0  # height of the flat sea that facet -1 stands for [m]


@inlined
def corners(array, facet, faces):
    """Return the rows of an (n, 3) array that belong to the corners of a facet.

    Array twin: `array[faces[facet]]`.
    """
    return row(array, faces[facet, 0]), row(array, faces[facet, 1]), row(array, faces[facet, 2])


@inlined
def plane_distance(p, d, facet, mesh):
    """Return the distance along a ray to the plane of a facet.

    Array twin: `facet_hits`.
    p is the origin of the ray, d its direction; the distance is in units of |d|, inf for a ray
    parallel to the plane. Embree finds the facet in single precision; its plane equation gives the
    distance in double precision.
    """
    n = row(mesh.face_normals, facet)
    facing = dot(d, n)
    if facing == 0.0:
        return math.inf
    return dot(minus(row(mesh.vertices, mesh.faces[facet, 0]), p), n) / facing


@inlined
def barycentrics(x, y, facet, mesh):
    """Return the barycentrics (u, v) of the point of a facet at (x, y).

    Array twin: `facet_hits`.
    The point is (1 - u - v) a + u b + v c of the corners a, b, c. Facets of height fields face up,
    so their projections to the horizontal plane keep the barycentrics.
    """
    a, b, c = corners(mesh.vertices, facet, mesh.faces)
    ab, ac, ap = minus2(b, a), minus2(c, a), minus2(Vec2(x, y), a)
    area = cross2(ab, ac)
    return cross2(ap, ac) / area, cross2(ab, ap) / area


@inlined
def barycentrics_of(p, facet, mesh):
    """Return the barycentrics (u, v) of a point on a facet of any orientation.

    Array twin: least squares in `tests/kernels/test_kernels_facets.py`.
    The facet is projected along the axis nearest to its normal: that projection is the largest.
    """
    a, b, c = corners(mesh.vertices, facet, mesh.faces)
    ab, ac, ap = minus(b, a), minus(c, a), minus(p, a)
    n = row(mesh.face_normals, facet)
    x, y, z = abs(n.x), abs(n.y), abs(n.z)
    if z >= x and z >= y:
        ab, ac, ap = Vec2(ab.x, ab.y), Vec2(ac.x, ac.y), Vec2(ap.x, ap.y)
    elif x >= y:
        ab, ac, ap = Vec2(ab.y, ab.z), Vec2(ac.y, ac.z), Vec2(ap.y, ap.z)
    else:
        ab, ac, ap = Vec2(ab.z, ab.x), Vec2(ac.z, ac.x), Vec2(ap.z, ap.x)
    area = cross2(ab, ac)
    return cross2(ap, ac) / area, cross2(ab, ap) / area


@inlined
def inside_facet(x, y, facet, mesh):
    """Return whether (x, y) lies on a facet, edges included.

    Array twin: `barycentrics`.
    """
    u, v = barycentrics(x, y, facet, mesh)
    return u >= 0.0 and v >= 0.0 and u + v <= 1.0


@inlined
def interpolated_normal(u, v, facet, surface):
    """Return the unit normal interpolated from the corners of a facet.

    Array twin: `TriangleMesh.vertex_normals` averaged with (1 - u - v, u, v).
    The error of refraction then falls as the square of the spacing of the mesh.
    """
    # Phong interpolation, of normals that are those of the sea itself at the corners (not averages
    # of the facets around them).
    a, b, c = corners(surface.vertex_normals, facet, surface.faces)
    return unit(blend(u, v, a, b, c))


@inlined
def normal_at(x, y, facet, surface):
    """Return the unit normal of a facet at (x, y): constant, or interpolated.

    Beyond the edges of the facet the interpolation is continued.

    Array twin: `interpolated_normal`.
    """
    if surface.interpolate:
        u, v = barycentrics(x, y, facet, surface)
        return interpolated_normal(u, v, facet, surface)
    return row(surface.face_normals, facet)


@inlined
def normal_on(p, facet, surface):
    """Return the unit normal at a point on a facet of any orientation: constant, or interpolated.

    Array twin: `interpolated_normal`.
    """
    if surface.interpolate:
        u, v = barycentrics_of(p, facet, surface)
        return interpolated_normal(u, v, facet, surface)
    return row(surface.face_normals, facet)


@inlined
def is_rough(roughness):
    """Return whether the mesh has unresolved slopes."""
    return roughness.along > 0.0 or roughness.across > 0.0


@inlined
def slope_tilt(roughness, along, across):
    """Return the slopes along x and y from standard slopes along and across the wind.

    Array twin: their covariance in `tests/kernels/test_kernels_facets.py`.
    Standard slopes are slopes over their standard deviations.
    """
    a, c = roughness.along * along, roughness.across * across
    # rotation from the axes of the wind to x and y
    return Vec2(roughness.cos * a - roughness.sin * c, roughness.sin * a + roughness.cos * c)


@inlined
def over_gaussian(series, a, c):
    """Return the ratio of the density of standard slopes to the Gaussian density.

    Array twin: its own Python code.
    a is the slope along the wind and c the slope across it, each over its standard deviation.
    """
    if series.most == 0.0:
        return 1.0
    a2, c2 = a * a, c * c
    p = series.constant + series.a * a + (series.aa + series.aaa * a + series.aaaa * a2) * a2
    p += (series.cc + series.acc * a + series.aacc * a2 + series.cccc * c2) * c2
    # max(p, 0) without a branch: a truncated Gram-Charlier series is negative in its far tails.
    return 0.5 * (p + abs(p))


@outlined
def _tilt_of_series(d, n, u, v, roughness):
    """Draw slopes along x and y from a Gram-Charlier series, as light along d meets them on n.

    Array twin: chi-square in `tests/kernels/test_kernels_series.py`.
    Rejection from a wider Gaussian: slopes t and -t are proposed as a pair, accepted by the sum of
    their densities times exposures, and one of the two is taken in proportion to its term.
    """
    series = roughness.series
    # Further uniforms come from a stream of which these two are seed and photon: however many
    # proposals are rejected, no other random number of the photon changes.
    key, number = np.uint64(u / _RESOLUTION), np.uint64(v / _RESOLUTION)
    attempt = 0
    while True:
        # Box-Muller, with the variance WIDE: tails heavier than the Gaussian's keep the ratio of
        # the densities bounded.
        r = math.sqrt(-2.0 * WIDE * math.log(u))
        cos_phi, sin_phi = on_circle(v)
        a, c = r * cos_phi, r * sin_phi
        tilt = slope_tilt(roughness, a, c)
        exposed = exposure(d, n, tilt)
        # both over the Gaussian density; exposures of a slope and its opposite add up to 2
        density = exposed * over_gaussian(series, a, c)
        opposite = (2.0 - exposed) * over_gaussian(series, -a, -c)
        # Proposal over Gaussian density, exp(r^2 (1 - 1 / WIDE) / 2) / WIDE, times the largest
        # ratio of the density to the proposal, times the sum 2 of the exposures.
        bound = 2.0 * series.most / WIDE * math.exp(0.5 * r * r * (1.0 - 1.0 / WIDE))
        # u and v make the next proposal, should this one be rejected
        u, v, u_accept, side = uniforms(key, number, attempt, Purpose.SERIES.value)
        if u_accept * bound < density + opposite:
            return tilt if side * (density + opposite) < density else Vec2(-tilt.x, -tilt.y)
        attempt += 1


@inlined
def drawn_tilt(roughness, u, v):
    """Draw slopes along x and y as seen from above, from two uniforms."""
    if roughness.series.most > 0.0:
        # straight up on level water every slope has the exposure 1
        return _tilt_of_series(UP, UP, u, v, roughness)
    r = math.sqrt(-2.0 * math.log(u))
    cos_phi, sin_phi = on_circle(v)
    return slope_tilt(roughness, r * cos_phi, r * sin_phi)


@inlined
def tilted(n, tilt):
    """Return an upward normal with a tilt added to its slopes.

    Array twin: (-sx, -sy, 1) / norm.
    """
    # n ~ (-s, 1), so that n - n.z (t, 0) ~ (-s - t, 1)
    return unit(Vec3(n.x - tilt.x * n.z, n.y - tilt.y * n.z, n.z))


@inlined
def exposure(d, n, tilt):
    """Return the projected area of a tilted piece of surface along d, over that without the tilt.

    Array twin: areas of facets seen along a ray.
    The probability that light meets a tilt is its frequency times this exposure. With the slopes s
    of the normal n and the tilt t it is d.(-s - t, 1) / d.(-s, 1), of mean 1 and of either sign of
    d. A tilt that would show its back has 0, and its opposite 2.
    """
    facing = dot(d, n)
    if facing == 0.0:
        return 1.0
    # Clipped at 2, where the opposite tilt is clipped at 0: their sum stays 2, and the mean 1.
    return min(max(1.0 - n.z * (d.x * tilt.x + d.y * tilt.y) / facing, 0.0), 2.0)


@inlined
def takes_slopes(g, roughness):
    """Return whether random slopes tilt a facet: the steep facets of jets are smooth.

    Array twin: none.
    """
    # g is the facet's normal: slopes on the almost upright facets of a breaker could turn it over.
    return g.z > _LEAST_ROUGH and is_rough(roughness)


@outlined
def roughened(d, n, u, v, w, roughness):
    """Return a normal tilted by random unresolved slopes, from three uniforms.

    Array twin: the flux over both sides in `tests/engine/chains/test_unresolved_slopes.py`.
    Gaussian slopes t and -t are equally frequent: one of the two is taken, with probabilities of
    half their exposures, which add up to 2.
    """
    if roughness.series.most > 0.0:
        return tilted(n, _tilt_of_series(d, n, u, v, roughness))
    tilt = drawn_tilt(roughness, u, v)
    if 2.0 * w >= exposure(d, n, tilt):
        tilt = Vec2(-tilt.x, -tilt.y)
    return tilted(n, tilt)


@allocating_entry
def facet_hits(facet, origins, directions, mesh):
    """Return distances and barycentrics of rays on given facets (n,); inf and nan for a facet -1.

    Array twin: Moller-Trumbore in `meshtrace.engine.bvh.BruteForceIntersector`.
    """
    n = len(facet)
    distance = np.full(n, np.inf)
    us = np.full(n, np.nan)
    vs = np.full(n, np.nan)
    for i in range(n):
        f = np.int64(facet[i])
        if f >= 0:
            p, d = row(origins, i), row(directions, i)
            distance[i] = plane_distance(p, d, f, mesh)
            us[i], vs[i] = barycentrics_of(along(p, d, distance[i]), f, mesh)
    return distance, us, vs


# PAPER: the form as published, of which E2, E3 ... number the errata in `docs/paper.md`.
class Snell(IntEnum):
    """Form of the law of refraction, `Physics.snell`."""

    PHYSICAL = 0
    PAPER = 1


class Direction(IntEnum):
    """Form of the refracted direction, `Physics.direction`."""

    VECTOR = 0
    PAPER = 1


class FresnelMode(IntEnum):
    """Treatment of the reflectance, `Physics.fresnel`."""

    WEIGHT = 0
    ROULETTE = 1
    PAPER_BOTH = 2


class FieldOfView(IntEnum):
    """Test of the field of view, `Physics.fov`."""

    ANGLE = 0
    PAPER_POSITION = 1


class Interface(NamedTuple):
    """Switches of the crossing, see `meshtrace.link.Physics`."""

    snell: int  # Snell
    direction: int  # Direction
    fresnel: int  # FresnelMode
    follow_reflected: bool  # light that the surface sends back into the water
    follow_second_hit: bool  # light in the air that meets another wave
    foam_transmittance: float  # of the surface with its foam over that without, T_u
    fov: int  # FieldOfView


PHYSICAL = Interface(0, 0, 0, True, True, 1.0, 0)
"""All switches at their physical values, no foam."""


@inlined
def reflectance(cos_i, cos_t, n1, n2):
    """Return the Fresnel reflectance of unpolarised light from index n1 into n2.

    Array twin: `meshtrace.optics.fresnel.fresnel_reflectance`.
    In terms of cosines: the form in sines and tangents of angles is 0/0 at normal incidence.
    """
    # Fresnel's amplitudes (Born and Wolf, Principles of Optics, sec. 1.5.2); unpolarised light
    # takes the mean of both intensities.
    rs = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t)
    rp = (n2 * cos_i - n1 * cos_t) / (n2 * cos_i + n1 * cos_t)
    return 0.5 * (rs * rs + rp * rp)


@inlined
def mirror_reflectance(cos_i, n1, n2):
    """Return the Fresnel reflectance at an angle of incidence, 1 for total reflection.

    Array twin: `meshtrace.optics.fresnel.fresnel_reflectance`.
    """
    sin2_t = (n1 / n2) ** 2 * (1.0 - cos_i * cos_i)
    return reflectance(cos_i, math.sqrt(1.0 - sin2_t), n1, n2) if sin2_t < 1.0 else 1.0


@inlined
def refract(d, n, cos_i, n1, n2):
    """Return (cos_t, direction) behind the surface; cos_t < 0: total internal reflection.

    Array twin: `meshtrace.optics.fresnel.refract`.
    The normal points to the side that the light goes to: cos_i = d.n > 0.
    """
    eta = n1 / n2
    # Vector form of Snell's law: t = eta d + (cos_t - eta cos_i) n.
    sin2_t = eta * eta * (1.0 - cos_i * cos_i)
    if sin2_t >= 1.0:
        return -1.0, ORIGIN
    cos_t = math.sqrt(1.0 - sin2_t)
    return cos_t, combine(eta, d, cos_t - eta * cos_i, n)


@outlined
def refract_as_printed(d, n, cos_i, n1, n2, interface):
    """Return (cos_t, rho, direction) in the forms of the paper; cos_t < 0: reflected.

    Array twin: none, the formulas are those of the paper (eqs. theta_r, mu_post_surface).
    Errata E2 (Snell upside-down) and E3 (sine of the components), each by its switch.
    """
    sin_i = math.sqrt(max(1.0 - cos_i * cos_i, 0.0))
    # The paper tests for total reflection with the correct index ratio, even where it refracts by
    # the inverted one.
    if sin_i >= n2 / n1:
        return -1.0, 1.0, ORIGIN
    sin_t = sin_i * (n2 / n1 if interface.snell == Snell.PAPER else n1 / n2)
    if sin_t >= 1.0:  # upside-down Snell, from the air
        return -1.0, 1.0, ORIGIN
    theta_t = math.asin(sin_t)
    cos_t = math.cos(theta_t)
    if interface.snell == Snell.PAPER:
        # The published Fresnel formula knows the angles alone; those of the inverted law are those
        # of a passage from n2 into n1.
        rho = reflectance(cos_i, cos_t, n2, n1)
    else:
        rho = reflectance(cos_i, cos_t, n1, n2)
    t = along(d, n, -cos_i)
    length = norm(t)
    if length > 0.0:
        t = Vec3(t.x / length, t.y / length, t.z / length)
    if interface.direction == Direction.PAPER:
        tangential = Vec3(math.sin(theta_t * t.x), math.sin(theta_t * t.y), math.sin(theta_t * t.z))
    else:
        tangential = scaled(sin_t, t)
    return cos_t, rho, along(tangential, n, cos_t)


@inlined
def transmit(d, n, cos_i, n1, n2, interface):
    """Return (cos_t, rho, direction) behind the surface; cos_t < 0 and rho = 1: reflected.

    Array twin: `refract` and `reflectance`.
    """
    if interface.snell == Snell.PHYSICAL and interface.direction == Direction.VECTOR:
        cos_t, out = refract(d, n, cos_i, n1, n2)
        return cos_t, reflectance(cos_i, cos_t, n1, n2) if cos_t >= 0.0 else 1.0, out
    return refract_as_printed(d, n, cos_i, n1, n2, interface)


@inlined
def branches(d, n, g, n1, n2, interface):
    """Return reflectance, transmitted and reflected direction of light along d.

    Array twin: `meshtrace.optics.fresnel`.
    n is the normal of the refraction, g that of the facet, both to the side that the light goes to.
    An interpolated or tilted n may send light to the wrong side of the facet. Then g is taken in
    its place, which cannot.
    """
    rho, transmitted, reflected = 1.0, ORIGIN, ORIGIN
    for _ in range(2):
        cos_i = min(dot(d, n), 1.0)
        _, rho, transmitted = transmit(d, n, cos_i, n1, n2, interface)
        reflected = along(d, n, -2.0 * cos_i)
        sound = cos_i > 0.0 and not (rho < 1.0 and dot(transmitted, g) <= 0.0)
        if sound and dot(reflected, g) < 0.0:
            break
        # the second pass refracts by the facet's own normal
        n = g
    return rho, transmitted, reflected


@entry
def split_rays(directions, normals, facet_normals, u, roughness, n, rho, mirrored, refracted):
    """Write reflectance, reflected and refracted directions of rays that reach the sea from above.

    Array twin: `meshtrace.optics.fresnel`.
    `directions`, upward `normals` and `facet_normals`, and the uniforms `u` are (rays, 3); n is the
    refractive index of the water over that of the air. Results are `rho` (rays,) and the
    directions `mirrored` and `refracted` (rays, 3).
    """
    for i in range(len(directions)):
        d, normal, g = row(directions, i), row(normals, i), row(facet_normals, i)
        if takes_slopes(g, roughness):
            normal = roughened(d, normal, u[i, 0], u[i, 1], u[i, 2], roughness)
        # `branches` takes normals to the side that the light goes to, here down.
        down, g = scaled(-1.0, normal), scaled(-1.0, g)
        rho[i], transmitted, reflected = branches(d, down, g, 1.0, n, PHYSICAL)
        write(mirrored[i], reflected)
        write(refracted[i], transmitted)
