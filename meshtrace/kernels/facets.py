"""Points on facets: distances, barycentrics and normals in double precision."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from meshtrace.kernels.jit import inlined


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


@njit(cache=True, nogil=True)
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
