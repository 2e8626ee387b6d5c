"""Rays cast by the C interface of Embree, through the address of its function."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from meshtrace.kernels.jit import entry

RAY_WORDS = 32
"""Words of 4 bytes for an `RTCRayHit`, of which Embree 4.4 has 24 with its padding."""

_FAR = np.float32(1e37)


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
def _call(typing_context: Any, address: Any, scene: Any, ray: Any) -> Any:
    """Call `void f(RTCScene, RTCRayHit *, RTCIntersectArguments * = NULL)`."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte] * 3).as_pointer()
        scene, ray = (builder.inttoptr(argument, byte) for argument in arguments[1:])
        builder.call(builder.inttoptr(arguments[0], kind), [scene, ray, ir.Constant(byte, None)])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp), emit


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
            ray[Word.NEAR.value] = ray[Word.TIME.value] = 0.0
            ray[Word.FAR.value] = _FAR
            word[Word.MASK.value] = -1
            word[Word.ID.value] = word[Word.FLAGS.value] = 0
            word[Word.FACET.value] = word[Word.GEOMETRY.value] = word[Word.INSTANCE.value] = -1
        for i in range(n):
            _call(intersect, scene, start + 4 * RAY_WORDS * i)  # type: ignore[call-arg]
        for i in range(n):
            out[first + i] = words[i, Word.FACET.value]
