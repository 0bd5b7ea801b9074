"""A hint to the processor that memory will be read soon, which no plain code can give."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

__all__ = ["prefetch"]

# Arguments of LLVM's `prefetch`: to be read, again soon, as data.
_READ, _SOON_AGAIN, _DATA = 0, 3, 1


def _prefetch(_typing: Any, values: Any, _place: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        address = builder.bitcast(builder.gep(array.data, [arguments[1]]), ir.IntType(8).as_pointer())
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [address.type, number, number, number])
        hint = builder.module.declare_intrinsic("llvm.prefetch", [address.type], kind)
        builder.call(hint, [address, number(_READ), number(_SOON_AGAIN), number(_DATA)])
        return context.get_dummy_value()

    return types.void(values, types.uintp), generate


# `prefetch(values, place)` in a kernel has the line of memory about `values[place]` fetched, wherever that is.
prefetch: Any = intrinsic(_prefetch)
