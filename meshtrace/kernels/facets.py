"""Points on facets: distances, barycentrics and normals in double precision."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import allocating_entry, inlined
from meshtrace.kernels.vectors import (
    Vec2,
    Vec3,
    along,
    blend,
    cross2,
    dot,
    minus,
    minus2,
    on_circle,
    row,
    unit,
)


class Roughness(NamedTuple):
    """Gaussian slopes of unresolved waves: standard deviations and wind direction."""

    along: float
    across: float
    cos: float
    sin: float


SMOOTH = Roughness(0.0, 0.0, 1.0, 0.0)


class Triangles(NamedTuple):
    """Corners and normals of facets; a `Surface` may stand in its place."""

    vertices: NDArray[np.float64]  # (n, 3)
    faces: NDArray[np.int32]  # (m, 3)
    face_normals: NDArray[np.float64]  # (m, 3)


class Surface(NamedTuple):
    """A triangle mesh as arrays, see `meshtrace.mesh.TriangleMesh`."""

    vertices: NDArray[np.float64]  # (n, 3)
    faces: NDArray[np.int32]  # (m, 3)
    face_normals: NDArray[np.float64]  # (m, 3)
    vertex_normals: NDArray[np.float64]  # (n, 3)
    low: NDArray[np.float64]  # (3,) lowest corner of the bounds
    high: NDArray[np.float64]  # (3,)
    max_slope: float
    interpolate: bool  # normals from the corners, or the facet's own
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
    The plane equation in double precision removes the single precision of Embree.
    """
    n = row(mesh.face_normals, facet)
    facing = dot(d, n)
    if facing == 0.0:
        return math.inf
    return dot(minus(row(mesh.vertices, mesh.faces[facet, 0]), p), n) / facing


@inlined
def barycentrics(x, y, facet, mesh):
    """Return (u, v) of the point of a facet over (x, y).

    Array twin: `facet_hits`.
    Facets of height fields face up, so their projections to the plane keep the barycentrics.
    """
    a, b, c = corners(mesh.vertices, facet, mesh.faces)
    ab, ac, ap = minus2(b, a), minus2(c, a), minus2(Vec2(x, y), a)
    area = cross2(ab, ac)
    return cross2(ap, ac) / area, cross2(ab, ap) / area


@inlined
def barycentrics_of(p, facet, mesh):
    """Return (u, v) of a point on a facet of any orientation.

    Array twin: least squares in `tests/kernels/test_kernels_facets.py`.
    The largest component of the normal is dropped: that projection has the largest area.
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
    Interpolated exact slopes make refraction converge as the square of the spacing.
    """
    a, b, c = corners(surface.vertex_normals, facet, surface.faces)
    return unit(blend(u, v, a, b, c))


@inlined
def normal_at(x, y, facet, surface):
    """Return the unit normal of a facet over (x, y): its own, or interpolated and continued.

    Array twin: `interpolated_normal`.
    """
    if surface.interpolate:
        u, v = barycentrics(x, y, facet, surface)
        return interpolated_normal(u, v, facet, surface)
    return row(surface.face_normals, facet)


@inlined
def normal_on(p, facet, surface):
    """Return the unit normal at a point on a facet of any orientation: its own, or interpolated.

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
    """Return the slopes along x and y of two standard normal numbers.

    Array twin: their covariance in `tests/kernels/test_kernels_facets.py`.
    """
    a, c = roughness.along * along, roughness.across * across
    return Vec2(roughness.cos * a - roughness.sin * c, roughness.sin * a + roughness.cos * c)


@inlined
def drawn_tilt(roughness, u, v):
    """Return the slopes along x and y of two uniforms."""
    r = math.sqrt(-2.0 * math.log(u))
    cos_phi, sin_phi = on_circle(v)
    return slope_tilt(roughness, r * cos_phi, r * sin_phi)


@inlined
def tilted(n, tilt):
    """Return an upward normal with a tilt added to its slopes.

    Array twin: (-sx, -sy, 1) / norm.
    """
    return unit(Vec3(n.x - tilt.x * n.z, n.y - tilt.y * n.z, n.z))


@inlined
def exposure(d, n, tilt):
    """Return the probability that light meets a tilted element, relative to its abundance.

    Array twin: areas of facets seen along a ray.
    Pieces that lean towards the light show it more of their area: with slopes s + t,
    d.(-s - t, 1) / d.(-s, 1), whose mean is 1. Tilts that would show their back are taken for
    those that lean as far towards the light, so that the mean stays.
    """
    facing = dot(d, n)
    if facing == 0.0:
        return 1.0
    return min(max(1.0 - n.z * (d.x * tilt.x + d.y * tilt.y) / facing, 0.0), 2.0)


@allocating_entry
def facet_hits(facet, origins, directions, mesh):
    """Return distances and barycentrics of rays on their facets; inf and nan for misses.

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
