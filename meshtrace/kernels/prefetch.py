"""Request of memory ahead of its use."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from meshtrace.kernels.jit import config


@intrinsic
def _prefetch(typing_context: Any, array: Any, i: Any) -> Any:
    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rows = context.make_array(signature.args[0])(context, builder, arguments[0])
        first = [arguments[1], *[ir.Constant(ir.IntType(64), 0)] * (signature.args[0].ndim - 1)]
        item = cgutils.get_item_pointer(context, builder, signature.args[0], rows, first)
        byte, word = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, word, word, word])
        request = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        read, keep, data = (ir.Constant(word, n) for n in (0, 3, 1))
        builder.call(request, [builder.bitcast(item, byte), read, keep, data])
        return context.get_dummy_value()

    return types.void(array, types.intp), emit


def _nothing(array: Any, i: Any) -> None:
    """Stand in for `prefetch` without the JIT."""


prefetch: Any = _nothing if config.DISABLE_JIT else _prefetch
"""Request the first 64 bytes of row i of an array; no effect on any result."""
