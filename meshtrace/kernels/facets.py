"""Points on facets: distances, barycentrics and normals in double precision."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import allocating_entry, inlined


class Roughness(NamedTuple):
    """Gaussian slopes of waves that the mesh leaves out; standard deviations, wind direction."""

    along: float
    across: float
    cos: float
    sin: float


SMOOTH = Roughness(0.0, 0.0, 1.0, 0.0)


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
def plane_distance(x, y, z, dx, dy, dz, facet, vertices, faces, face_normals):
    """Return the distance along a ray to the plane of a facet.

    Array twin: `facet_hits`.
    The plane equation in double precision removes the single precision of Embree.
    """
    a = faces[facet, 0]
    nx, ny, nz = face_normals[facet, 0], face_normals[facet, 1], face_normals[facet, 2]
    along = dx * nx + dy * ny + dz * nz
    if along == 0.0:
        return math.inf
    return (
        (vertices[a, 0] - x) * nx + (vertices[a, 1] - y) * ny + (vertices[a, 2] - z) * nz
    ) / along


@inlined
def barycentrics(x, y, facet, vertices, faces):
    """Return (u, v) of the point of a facet over (x, y).

    Array twin: `facet_hits`.
    Facets face up, so their projections to the plane keep the barycentrics.
    """
    a, b, c = faces[facet, 0], faces[facet, 1], faces[facet, 2]
    bx, by = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
    cx, cy = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1]
    px, py = x - vertices[a, 0], y - vertices[a, 1]
    area = bx * cy - by * cx
    return (px * cy - py * cx) / area, (bx * py - by * px) / area


@inlined
def interpolated_normal(u, v, facet, faces, vertex_normals):
    """Return the unit normal interpolated from the corners of a facet.

    Array twin: `TriangleMesh.vertex_normals` averaged with (1 - u - v, u, v).
    Interpolated exact slopes make refraction converge as the square of the spacing.
    """
    a, b, c = faces[facet, 0], faces[facet, 1], faces[facet, 2]
    w = 1.0 - u - v
    nx = w * vertex_normals[a, 0] + u * vertex_normals[b, 0] + v * vertex_normals[c, 0]
    ny = w * vertex_normals[a, 1] + u * vertex_normals[b, 1] + v * vertex_normals[c, 1]
    nz = w * vertex_normals[a, 2] + u * vertex_normals[b, 2] + v * vertex_normals[c, 2]
    scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@inlined
def normal_at(x, y, facet, surface):
    """Return the unit normal of a facet over (x, y): its own, or interpolated and continued.

    Array twin: `interpolated_normal`.
    """
    if surface.interpolate:
        u, v = barycentrics(x, y, facet, surface.vertices, surface.faces)
        return interpolated_normal(u, v, facet, surface.faces, surface.vertex_normals)
    g = surface.face_normals
    return g[facet, 0], g[facet, 1], g[facet, 2]


@inlined
def is_rough(roughness):
    """Return whether the mesh leaves slopes out."""
    return roughness.along > 0.0 or roughness.across > 0.0


@inlined
def slope_tilt(roughness, along, across):
    """Return the slopes along x and y of two standard normal numbers.

    Array twin: their covariance in `tests/unit/test_kernels_facets.py`.
    """
    a, c = roughness.along * along, roughness.across * across
    return roughness.cos * a - roughness.sin * c, roughness.sin * a + roughness.cos * c


@inlined
def tilted(nx, ny, nz, tilt_x, tilt_y):
    """Return an upward normal whose slopes are larger by (tilt_x, tilt_y).

    Array twin: (-sx, -sy, 1) / norm.
    """
    nx, ny = nx - tilt_x * nz, ny - tilt_y * nz
    scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@inlined
def exposure(dx, dy, dz, nx, ny, nz, tilt_x, tilt_y):
    """Return how often light meets a tilted piece of the surface, over how common it is.

    Array twin: areas of facets seen along a ray.
    Pieces that lean towards the light show it more of their area: with slopes s + t,
    d.(-s - t, 1) / d.(-s, 1), whose mean is 1. Tilts that would show their back are taken for
    those that lean as far towards the light, so that the mean stays.
    """
    facing = dx * nx + dy * ny + dz * nz
    if facing == 0.0:
        return 1.0
    return min(max(1.0 - nz * (dx * tilt_x + dy * tilt_y) / facing, 0.0), 2.0)


@allocating_entry
def facet_hits(facet, origins, directions, vertices, faces, face_normals):
    """Return distances and barycentrics of rays on their facets; inf and nan for misses.

    Array twin: Moller-Trumbore in `meshtrace.bvh.BruteForceIntersector`.
    """
    n = len(facet)
    distance = np.full(n, np.inf)
    us = np.full(n, np.nan)
    vs = np.full(n, np.nan)
    for i in range(n):
        f = facet[i]
        if f >= 0:
            x, y, z = origins[i, 0], origins[i, 1], origins[i, 2]
            dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
            t = plane_distance(x, y, z, dx, dy, dz, f, vertices, faces, face_normals)
            distance[i] = t
            us[i], vs[i] = barycentrics(x + t * dx, y + t * dy, f, vertices, faces)
    return distance, us, vs
