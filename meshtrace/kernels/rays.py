"""Rays cast by the C interface of Embree, or by a function with the same signature."""

from __future__ import annotations

import ctypes
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from meshtrace.kernels.jit import config, entry, inlined
from meshtrace.kernels.vectors import write

RAY_WORDS = 32
"""Words of 4 bytes for an `RTCRayHit`, of which Embree 4.4 has 24 with its padding."""

_FAR = np.float32(1e37)
_ALIGNMENT = 64


class Word(IntEnum):
    """Words of an `RTCRayHit` in rtcore_ray.h."""

    ORIGIN = 0
    NEAR = 3
    DIRECTION = 4
    TIME = 7
    FAR = 8
    MASK = 9
    ID = 10
    FLAGS = 11
    FACET = 17
    GEOMETRY = 18
    INSTANCE = 19


@intrinsic
def _compiled_call(typing_context: Any, address: Any, scene: Any, ray: Any) -> Any:
    """Call `void f(RTCScene, RTCRayHit *, RTCIntersectArguments * = NULL)`."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte] * 3).as_pointer()
        scene, ray = (builder.inttoptr(argument, byte) for argument in arguments[1:])
        builder.call(builder.inttoptr(arguments[0], kind), [scene, ray, ir.Constant(byte, None)])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp), emit


def _plain_call(address: int, scene: int, ray: int) -> None:
    """Call the same function without the JIT."""
    ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)(address)(scene, ray, None)


_call: Any = _plain_call if config.DISABLE_JIT else _compiled_call


@inlined
def _prepare(ray, word):
    """Write all that Embree reads of a ray but its origin and direction."""
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
    as integers: a row is complete some time before Embree reads it, else that read would wait.
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
    """A function that finds the first facet along a ray, with room for one ray."""

    intersect: int  # address of `rtcIntersect1`, or of a function of its signature
    scene: int  # its first argument
    ray: NDArray[np.float32]  # (RAY_WORDS,)
    word: NDArray[np.int32]  # the same memory


def bvh_of(intersect: int, scene: int) -> Bvh:
    """Return the function at an address with room for a ray of its own."""
    ray = aligned_rays(1)[0]
    return Bvh(intersect, scene, ray, ray.view(np.int32))


def aligned_rays(n: int) -> NDArray[np.float32]:
    """Return room for n rays, aligned as Embree reads them."""
    room = np.zeros(n * RAY_WORDS + _ALIGNMENT // 4, np.float32)
    skipped = -room.ctypes.data % _ALIGNMENT // 4
    return room[skipped : skipped + n * RAY_WORDS].reshape(n, RAY_WORDS)


NO_BVH = bvh_of(0, 0)
"""No function: it must not be called."""


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
