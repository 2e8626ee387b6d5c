"""Rays over the bins of a mesh, where no Embree is: the first facet by double precision.

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
        np.zeros(Place.STARTS),
        bins.start,
        bins.facet,
        faces.ravel(),
        vertices.ravel(),
    ]
    begins = np.cumsum([len(part) for part in parts])
    scene = np.concatenate(parts, dtype=np.float64)
    z = vertices[:, 2]
    scene[: Place.STARTS] = (
        *(begins[-1], bins.x, bins.y, bins.step, bins.nx, bins.ny, z.min(), z.max()),
        *begins[1:4],
    )
    return scene


def _walk(scene, hit, _):
    """Write the first facet along a ray into an `RTCRayHit`, as `rtcIntersect1` does.

    Array twin: `BruteForceIntersector`.
    """
    ray = carray(hit, (RAY_WORDS,), np.float32)
    word = carray(hit, (RAY_WORDS,), np.int32)
    size = carray(scene, (1,), np.float64)[0]
    s = carray(scene, (int(size),), np.float64)
    px, py, pz = float(ray[0]), float(ray[1]), float(ray[2])
    dx, dy, dz = float(ray[4]), float(ray[5]), float(ray[6])
    step, nx, ny = s[Place.STEP.value], int(s[Place.NX.value]), int(s[Place.NY.value])
    # the part of the ray in the box about the mesh, a hair wider for rounding
    first, last = 0.0, math.inf
    for p, d, low, high in (
        (px, dx, s[Place.X.value], s[Place.X.value] + nx * step),
        (py, dy, s[Place.Y.value], s[Place.Y.value] + ny * step),
        (pz, dz, s[Place.LOW.value] - 1e-9 * step, s[Place.HIGH.value] + 1e-9 * step),
    ):
        if d == 0.0:
            if p < low or p > high:
                return
            continue
        a, b = (low - p) / d, (high - p) / d
        first, last = max(first, min(a, b)), min(last, max(a, b))
    if not first <= last:
        return
    u, v = (px + first * dx - s[Place.X.value]) / step, (py + first * dy - s[Place.Y.value]) / step
    i = min(max(math.floor(u), 0), nx - 1)
    j = min(max(math.floor(v), 0), ny - 1)
    # distances at which the ray leaves the column of bins i, and the row j
    along_x, along_y = 1 if dx > 0.0 else -1, 1 if dy > 0.0 else -1
    next_x = (s[Place.X.value] + (i + (dx > 0.0)) * step - px) / dx if dx != 0.0 else math.inf
    next_y = (s[Place.Y.value] + (j + (dy > 0.0)) * step - py) / dy if dy != 0.0 else math.inf
    lists, faces, vertices = (
        int(s[Place.LISTS.value]),
        int(s[Place.FACES.value]),
        int(s[Place.VERTICES.value]),
    )
    nearest, length = math.inf, dx * dx + dy * dy + dz * dz
    while True:
        cell = Place.STARTS.value + i * ny + j
        for k in range(lists + int(s[cell]), lists + int(s[cell + 1])):
            facet = int(s[k])
            a, b, c = faces + 3 * facet, faces + 3 * facet + 1, faces + 3 * facet + 2
            a, b, c = (vertices + 3 * int(s[a]), vertices + 3 * int(s[b]), vertices + 3 * int(s[c]))
            ax, ay, az = s[a] - px, s[a + 1] - py, s[a + 2] - pz
            bx, by, bz = s[b] - px, s[b + 1] - py, s[b + 2] - pz
            cx, cy, cz = s[c] - px, s[c + 1] - py, s[c + 2] - pz
            # On which side of an edge the ray passes: the volume of d and its two ends. It changes
            # its sign alone where the other facet takes the ends in turn: no ray slips through.
            w_a = dx * (by * cz - bz * cy) + dy * (bz * cx - bx * cz) + dz * (bx * cy - by * cx)
            w_b = dx * (cy * az - cz * ay) + dy * (cz * ax - cx * az) + dz * (cx * ay - cy * ax)
            w_c = dx * (ay * bz - az * by) + dy * (az * bx - ax * bz) + dz * (ax * by - ay * bx)
            if min(w_a, w_b, w_c) < 0.0 < max(w_a, w_b, w_c):
                continue
            total = w_a + w_b + w_c
            if total == 0.0:
                continue
            # the w are barycentrics of the point, up to their sum
            x, y = w_a * ax + w_b * bx + w_c * cx, w_a * ay + w_b * by + w_c * cy
            z = w_a * az + w_b * bz + w_c * cz
            t = (x * dx + y * dy + z * dz) / (total * length)
            if 0.0 <= t < nearest:
                nearest = t
                word[Word.FACET.value] = facet
        # a nearer facet would lie in a bin before
        leaves = min(next_x, next_y)
        if nearest <= leaves or leaves >= last:
            return
        if next_x < next_y:
            i += along_x
            next_x = (s[Place.X.value] + (i + (dx > 0.0)) * step - px) / dx
        else:
            j += along_y
            next_y = (s[Place.Y.value] + (j + (dy > 0.0)) * step - py) / dy
        if i < 0 or j < 0 or i >= nx or j >= ny:
            return


@cache
def walker() -> Any:
    """Return the C function of `_walk`, compiled on its first use, then kept."""
    pointers = types.void(types.voidptr, types.voidptr, types.voidptr)
    with foreign_kernels():
        return cfunc(pointers, cache=True, error_model="numpy")(_walk)
