"""First facets along rays without Embree, by walking over the bins of a mesh.

A ray passes the columns of square bins over (x, y) in turn (Amanatides and Woo 1987), and is
compared with the facets of each. The bins of a height field are as fine as its grid.

References
----------
Amanatides, J. and Woo, A. (1987), Proc. Eurographics, 3-10, doi:10.2312/egtp.19871000.
"""

from __future__ import annotations

import math
from enum import IntEnum
from functools import cache
from typing import Any

import numpy as np
from numba import carray, cfunc, types
from numba.extending import register_jitable
from numpy.typing import NDArray

from meshtrace.kernels.jit import foreign_kernels
from meshtrace.kernels.rays import RAY_WORDS, Word
from meshtrace.kernels.scene import Locator


class Place(IntEnum):
    """Positions in the one array that holds a scene: a C function has one address of it."""

    SIZE = 0  # of the array
    X = 1  # corner of the bins [m]
    Y = 2
    STEP = 3  # edge of a bin [m]
    NX = 4
    NY = 5
    LOW = 6  # lowest and highest vertex [m]
    HIGH = 7
    LISTS = 8  # where the facets of the bins, the corners of facets and the vertices begin
    FACES = 9
    VERTICES = 10
    STARTS = 11  # of the lists of the bins, the first number after these


def packed(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], bins: Locator
) -> NDArray[np.float64]:
    """Return a mesh and its bins as one array, see `Place`; integers below 2^53 stay exact."""
    parts: list[NDArray[Any]] = [
        np.zeros(Place.STARTS.value),
        bins.start,
        bins.facet,
        faces.ravel(),
        vertices.ravel(),
    ]
    begins = np.cumsum([len(part) for part in parts])
    scene = np.concatenate(parts, dtype=np.float64)
    z = vertices[:, 2]
    scene[: len(parts[0])] = (
        *(begins[-1], bins.x, bins.y, bins.step, bins.nx, bins.ny, z.min(), z.max()),
        *begins[1:4],
    )
    return scene


@register_jitable
def _between(s, p, d):
    """Return the first and the last distance of a ray inside the bounding box of a mesh."""
    width, height = s[Place.NX.value] * s[Place.STEP.value], s[Place.NY.value] * s[Place.STEP.value]
    # a hair beyond the heights: the box of a flat sea has none
    hair = 1e-9 * s[Place.STEP.value]
    low = s[Place.X.value], s[Place.Y.value], s[Place.LOW.value] - hair
    high = low[0] + width, low[1] + height, s[Place.HIGH.value] + hair
    first, last = 0.0, math.inf
    for k in range(3):
        if d[k] != 0.0:
            a, b = (low[k] - p[k]) / d[k], (high[k] - p[k]) / d[k]
            first, last = max(first, min(a, b)), min(last, max(a, b))
        elif p[k] < low[k] or p[k] > high[k]:
            last = -1.0
    return first, last


@register_jitable
def _distance(s, facet, p, d):
    """Return the distance of a facet along a ray, in lengths of its direction; inf for a miss."""
    face, vertices = int(s[Place.FACES.value]) + 3 * facet, int(s[Place.VERTICES.value])
    a, b = vertices + 3 * int(s[face]), vertices + 3 * int(s[face + 1])
    c = vertices + 3 * int(s[face + 2])
    ax, ay, az = s[a] - p[0], s[a + 1] - p[1], s[a + 2] - p[2]
    bx, by, bz = s[b] - p[0], s[b + 1] - p[1], s[b + 2] - p[2]
    cx, cy, cz = s[c] - p[0], s[c + 1] - p[1], s[c + 2] - p[2]
    # On which side of an edge the ray passes: the volume of d and its two ends. It changes its sign
    # alone where the other facet takes the ends in turn: no ray slips through.
    u = d[0] * (by * cz - bz * cy) + d[1] * (bz * cx - bx * cz) + d[2] * (bx * cy - by * cx)
    v = d[0] * (cy * az - cz * ay) + d[1] * (cz * ax - cx * az) + d[2] * (cx * ay - cy * ax)
    w = d[0] * (ay * bz - az * by) + d[1] * (az * bx - ax * bz) + d[2] * (ax * by - ay * bx)
    total = u + v + w
    if total == 0.0 or min(u, v, w) < 0.0 < max(u, v, w):
        return math.inf
    # u, v and w are barycentrics of the point, up to their sum
    x, y, z = u * ax + v * bx + w * cx, u * ay + v * by + w * cy, u * az + v * bz + w * cz
    length = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    t = (x * d[0] + y * d[1] + z * d[2]) / (total * length)
    return t if t >= 0.0 else math.inf


@register_jitable
def _leaves(s, k, i, p, d):
    """Return the distance at which a ray leaves the bins of index i along x (k = 0) or y (1)."""
    if d[k] == 0.0:
        return math.inf
    return (s[Place.X.value + k] + (i + (d[k] > 0.0)) * s[Place.STEP.value] - p[k]) / d[k]


def _walk(scene, hit, _):
    """Write the first facet along a ray into an `RTCRayHit`, as `rtcIntersect1` does.

    Array twin: `BruteForceIntersector`.
    """
    ray = carray(hit, (RAY_WORDS,), np.float32)
    word = carray(hit, (RAY_WORDS,), np.int32)
    s = carray(scene, (int(carray(scene, (1,), np.float64)[0]),), np.float64)
    p = float(ray[0]), float(ray[1]), float(ray[2])
    d = float(ray[4]), float(ray[5]), float(ray[6])
    first, last = _between(s, p, d)
    if not first <= last:
        return
    step, nx, ny = s[Place.STEP.value], int(s[Place.NX.value]), int(s[Place.NY.value])
    i = math.floor((p[0] + first * d[0] - s[Place.X.value]) / step)
    j = math.floor((p[1] + first * d[1] - s[Place.Y.value]) / step)
    # the far rim of the box belongs to the last bin
    i, j = min(max(i, 0), nx - 1), min(max(j, 0), ny - 1)
    lists, nearest = int(s[Place.LISTS.value]), math.inf
    while 0 <= i < nx and 0 <= j < ny:
        cell = Place.STARTS.value + i * ny + j
        for k in range(lists + int(s[cell]), lists + int(s[cell + 1])):
            t = _distance(s, int(s[k]), p, d)
            if t < nearest:
                nearest = t
                word[Word.FACET.value] = int(s[k])
        x, y = _leaves(s, 0, i, p, d), _leaves(s, 1, j, p, d)
        # a nearer facet would lie in a bin before
        if nearest <= min(x, y) or min(x, y) >= last:
            return
        if x < y:
            i += 1 if d[0] > 0.0 else -1
        else:
            j += 1 if d[1] > 0.0 else -1


@cache
def walker() -> Any:
    """Return the C function of `_walk`, compiled on its first use, then kept."""
    pointers = types.void(types.voidptr, types.voidptr, types.voidptr)
    with foreign_kernels():
        return cfunc(pointers, cache=True, error_model="numpy")(_walk)
