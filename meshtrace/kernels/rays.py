"""First facets along rays: by the C interface of Embree, on the grid of a height field, in bins.

`first_facet` casts a ray by Embree, or by a function with its signature. `grid_facet` looks up the
facet that steep light meets on a height field over a grid without ray casting: a ray that climbs or
falls much faster than the steepest facet meets a height field once, and Newton steps from cell to
cell lead to that point. A point close to an edge is left to Embree, since the facet that its single
precision would choose there is not known: results are the same bit for bit with and without this
shortcut. `is_free` tests a path against the facets in the bins of a locator.
"""

from __future__ import annotations

import ctypes
import math
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from meshtrace.kernels.interface import inside_facet, plane_distance
from meshtrace.kernels.jit import config, entry, inlined, outlined
from meshtrace.kernels.vectors import along, write

RAY_WORDS = 32
"""Words of 4 bytes that a ray takes here; an `RTCRayHit` of Embree 4.4 has 24 with its padding."""

_FAR = np.float32(1e37)  # longest distance of a hit, finite in single precision
_ALIGNMENT = 64  # bytes, a line of the processor's cache


class Word(IntEnum):
    """Positions of the words of an `RTCRayHit` in rtcore_ray.h."""

    ORIGIN = 0  # x, y, z
    NEAR = 3
    DIRECTION = 4  # x, y, z
    TIME = 7
    FAR = 8  # distance of the hit afterwards
    MASK = 9
    ID = 10
    FLAGS = 11
    FACET = 17  # primID
    GEOMETRY = 18
    INSTANCE = 19


@intrinsic
def _compiled_call(typing_context: Any, address: Any, scene: Any, ray: Any) -> Any:
    """Call `void f(RTCScene, RTCRayHit *, RTCIntersectArguments * = NULL)` from a kernel."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte] * 3).as_pointer()
        scene, ray = (builder.inttoptr(argument, byte) for argument in arguments[1:])
        builder.call(builder.inttoptr(arguments[0], kind), [scene, ray, ir.Constant(byte, None)])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp), emit


def _plain_call(address: int, scene: int, ray: int) -> None:
    """Call the function of `_compiled_call` from Python, under NUMBA_DISABLE_JIT."""
    ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)(address)(scene, ray, None)


_call: Any = _plain_call if config.DISABLE_JIT else _compiled_call


@inlined
def _prepare(ray, word):
    """Reset a ray of Embree, apart from its origin and direction."""
    # Embree writes its answer over some of these words: they are set before every ray.
    ray[Word.NEAR.value] = ray[Word.TIME.value] = 0.0
    ray[Word.FAR.value] = _FAR
    word[Word.MASK.value] = -1
    word[Word.ID.value] = word[Word.FLAGS.value] = 0
    word[Word.FACET.value] = word[Word.GEOMETRY.value] = word[Word.INSTANCE.value] = -1


@entry
def cast(intersect, scene, rays, words, origins, directions, out):
    """Write the first facet of each ray, -1 for a miss.

    Array twin: `run` of embreex.
    `rays` and `words` are one buffer with a row for each ray of a block, as single precision and
    as 32-bit integers. A block is written as a whole before Embree reads it: a vector read right
    after the writes of its parts would wait for them.
    """
    start, block = rays.ctypes.data, len(rays)
    for first in range(0, len(origins), block):
        n = min(block, len(origins) - first)
        for i in range(n):
            ray, word = rays[i], words[i]
            for k in range(3):
                ray[Word.ORIGIN + k] = origins[first + i, k]
                ray[Word.DIRECTION + k] = directions[first + i, k]
            _prepare(ray, word)
        for i in range(n):
            _call(intersect, scene, start + 4 * RAY_WORDS * i)
        for i in range(n):
            out[first + i] = words[i, Word.FACET.value]


class Bvh(NamedTuple):
    """Function that looks up the first facet along a ray, with a buffer for one ray."""

    intersect: int  # address of `rtcIntersect1`, or of a function of its signature
    scene: int  # its first argument
    ray: NDArray[np.float32]  # (RAY_WORDS,)
    word: NDArray[np.int32]  # the same memory as integers


def bvh_of(intersect: int, scene: int) -> Bvh:
    """Return the function at an address with a new buffer for a ray."""
    ray = aligned_rays(1)[0]
    return Bvh(intersect, scene, ray, ray.view(np.int32))


def aligned_rays(n: int) -> NDArray[np.float32]:
    """Return a buffer for n rays, aligned as Embree reads them."""
    buffer = np.zeros(n * RAY_WORDS + _ALIGNMENT // 4, np.float32)
    # Embree reads rays by aligned vector instructions; numpy aligns to 16 bytes only.
    skipped = -buffer.ctypes.data % _ALIGNMENT // 4
    return buffer[skipped : skipped + n * RAY_WORDS].reshape(n, RAY_WORDS)


NO_BVH = bvh_of(0, 0)
"""Null pointers for kernels that cast no ray: not to be called."""


@inlined
def first_facet(bvh, p, d):
    """Return the first facet along a ray from p, -1 for a miss.

    Array twin: `cast`.
    """
    ray, word = bvh.ray, bvh.word
    write(ray[Word.ORIGIN.value :], p)
    write(ray[Word.DIRECTION.value :], d)
    _prepare(ray, word)
    _call(bvh.intersect, bvh.scene, ray.ctypes.data)
    return np.int64(word[Word.FACET.value])


# Length cut off the start of a path, and twice at its end, over 1 + its length: more than the
# errors of Newton's method and of normals that differ from the facet's, less than any wave.
_HAIR = 1e-4


@outlined
def is_free(p, d, length, surface, grid):
    """Return whether no facet cuts the straight path from p along d over a length.

    Array twin: `EmbreeIntersector.intersect`.
    A path that starts or ends on the surface is not cut there: it is shortened at both ends. Only
    its part between the lowest trough and the highest crest is searched, in the bins of a locator;
    the few paths that leave these are compared with every facet.
    """
    hair = _HAIR * (1.0 + length)
    first, last = _between(p.z, d.z, hair, length - 2.0 * hair, surface)
    return first >= last or not _is_cut(p, d, first, last, surface, grid)


@inlined
def _between(z, rise, first, last, surface):
    """Return the part of a path between the lowest trough and the highest crest.

    Only there can it meet the surface. The path is first <= t <= last, from the height z with
    d.z = rise; without such a part the first number is above the last.
    """
    low, high = surface.low[2], surface.high[2]
    if rise == 0.0:
        return first, (last if low <= z <= high else -math.inf)
    a, b = (low - z) / rise, (high - z) / rise
    return max(first, min(a, b)), min(last, max(a, b))


@inlined
def _meets(p, d, first, last, f, surface):
    """Return whether the part first <= t <= last of a path meets a facet."""
    t = plane_distance(p, d, f, surface)
    if not first <= t <= last:
        return False
    q = along(p, d, t)
    return inside_facet(q.x, q.y, f, surface)


@outlined
def _is_cut(p, d, first, last, surface, grid):
    """Return whether a facet cuts the part first <= t <= last of a path, by columns of bins."""
    a, b = along(p, d, first), along(p, d, last)
    west, east = (min(a.x, b.x) - grid.x) / grid.step, (max(a.x, b.x) - grid.x) / grid.step
    south, north = (min(a.y, b.y) - grid.y) / grid.step, (max(a.y, b.y) - grid.y) / grid.step
    # Bins cover what the light of a link reaches; few paths leave it.
    if west < 0.0 or south < 0.0 or east >= grid.nx or north >= grid.ny:
        for f in range(len(surface.faces)):
            if _meets(p, d, first, last, f, surface):
                return True
        return False
    for i in range(math.floor(west), math.floor(east) + 1):
        # the part of the path over this column of bins, i
        t0, t1 = first, last
        if d.x != 0.0:
            enter = (grid.x + i * grid.step - p.x) / d.x
            leave = (grid.x + (i + 1) * grid.step - p.x) / d.x
            t0, t1 = max(t0, min(enter, leave)), min(t1, max(enter, leave))
        y0, y1 = p.y + t0 * d.y, p.y + t1 * d.y
        # 1e-6 of a bin for rounding: a facet at the border of two bins is listed in both.
        j0 = max(math.floor((min(y0, y1) - grid.y) / grid.step - 1e-6), 0)
        j1 = min(math.floor((max(y0, y1) - grid.y) / grid.step + 1e-6), grid.ny - 1)
        for j in range(j0, j1 + 1):
            cell = i * grid.ny + j
            for k in range(grid.start[cell], grid.start[cell + 1]):
                if _meets(p, d, first, last, np.int64(grid.facet[k]), surface):
                    return True
    return False


UNKNOWN = np.int64(-2)
"""Answer of `grid_facet` for a ray that must be cast."""

ROUNDING = 128 * 2.0**-24
"""Margin about edges of facets, relative to coordinates: 128 times the rounding of a float32.

Inside of it the single precision of Embree may choose either facet.
"""

_STEPS = 8  # cells visited at most: steep light needs two or three, other rays are cast


class Axis(NamedTuple):
    """Increasing grid lines, and equal bins by which the cell of a coordinate is looked up."""

    line: NDArray[np.float64]  # (n,) [m], the last one replaced by infinity
    per_edge: NDArray[np.float64]  # (n - 1,) 1 over the width of a cell [m-1]
    guide: NDArray[np.int64]  # (bins,) index of the last line at or before the start of a bin
    per_bin: float  # 1 over the width of a bin, which holds one line at most [m-1]


class Grid(NamedTuple):
    """Height field on a tensor grid, cut as by `meshtrace.surfaces.triangulate`."""

    x: Axis
    y: Axis
    level: float  # height of the first guess, between lowest and highest vertex [m]
    steep: float  # least (dz / dxy)^2 of a ray that is answered
    height: float  # range of the heights plus the largest |z|, for the rounding of z [m]
    clear: float  # least distance to the facet: a ray must not meet the one that it leaves [m]
    flat: bool  # whether all heights are the level


@inlined
def cell_of(axis, x):
    """Return the index of the grid cell that holds a coordinate, -1 outside.

    Array twin: numpy.searchsorted.
    """
    # A bin holds one grid line at most: the cell is that of its start, or the next one.
    position = (x - axis.line[0]) * axis.per_bin
    if not 0.0 <= position < len(axis.guide):
        return -1
    i = axis.guide[int(position)]
    return i + np.int64(axis.line[i + 1] <= x)


@inlined
def grid_facet(grid, vertices, p, d):
    """Return the facet that a ray meets, `UNKNOWN` if it is not steep or passes close to an edge.

    Array twin: `BruteForceIntersector`.
    p is the origin of the ray, d its unit direction; vertex i ny + j lies at (line i, line j).
    """
    # A ray less steep than the steepest facet may meet the surface several times, in any order.
    if d.z * d.z < grid.steep * (d.x * d.x + d.y * d.y):
        return UNKNOWN
    ny = len(grid.y.line)
    t = (grid.level - p.z) / d.z
    if not grid.flat:
        i, j = cell_of(grid.x, p.x + t * d.x), cell_of(grid.y, p.y + t * d.y)
        if i < 0 or j < 0:
            return UNKNOWN
        # A corner near the first guess gives a better height than the mean level.
        t = (vertices[i * ny + j, 2] - p.z) / d.z
    for _ in range(_STEPS):
        x, y, z = p.x + t * d.x, p.y + t * d.y, p.z + t * d.z
        i, j = cell_of(grid.x, x), cell_of(grid.y, y)
        if i < 0 or j < 0:
            return UNKNOWN
        # (u, v) from 0 to 1 over the cell, with u reflected in odd cells, whose diagonal is the
        # other one: it is u = v in all. Corners a, b, c, d lie at (0, 0), (1, 0), (1, 1), (0, 1).
        # Without branches, of which half would be predicted wrongly.
        odd = (i + j) & 1
        sign, corner = 1.0 - 2.0 * odd, i * ny + j
        a, b = corner + odd * ny, corner + (1 - odd) * ny
        za, zb, zc, zd = vertices[a, 2], vertices[b, 2], vertices[b + 1, 2], vertices[a + 1, 2]
        per_x, per_y = grid.x.per_edge[i], grid.y.per_edge[j]
        u = odd + sign * (x - grid.x.line[i]) * per_x
        v = (y - grid.y.line[j]) * per_y
        # Height is linear in (u, v) on either triangle: one Newton step meets its plane exactly.
        du, dv = sign * d.x * per_x, d.y * per_y
        below_diagonal = u > v
        rise_u = zb - za if below_diagonal else zc - zd
        rise_v = zc - zb if below_diagonal else zd - za
        step = (za + u * rise_u + v * rise_v - z) / (d.z - du * rise_u - dv * rise_v)
        t += step
        u, v = u + step * du, v + step * dv
        inside = min(min(u, 1.0 - u), min(v, 1.0 - v))
        inside = min(inside, u - v if below_diagonal else v - u)
        # `inside` is the least distance to an edge of the triangle in cells, negative outside.
        margin = ROUNDING * (abs(x) + abs(y) + grid.height) * max(per_x, per_y)
        if inside > margin:
            facet = 2 * (corner - i) + np.int64(u <= v)
            return facet if t > grid.clear else UNKNOWN
        if inside > -margin:
            return UNKNOWN
    return UNKNOWN


@inlined
def facet_over(grid, x, y):
    """Return the facet of a grid at (x, y), -1 outside.

    Array twin: `scene.locate`.
    """
    i, j = cell_of(grid.x, x), cell_of(grid.y, y)
    if i < 0 or j < 0:
        return np.int64(-1)
    u = (x - grid.x.line[i]) * grid.x.per_edge[i]
    v = (y - grid.y.line[j]) * grid.y.per_edge[j]
    if (i + j) & 1:
        u = 1.0 - u
    return 2 * (i * (len(grid.y.line) - 1) + j) + np.int64(u <= v)
