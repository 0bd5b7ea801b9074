"""LLVM instructions that Numba does not find by itself: bilinear interpolation of 16 bytes at once, and prefetching.

It would reverse pixels of three bytes one by one, not multiply to the upper half of a product, and not load two
neighbouring pixels of four bytes at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

__all__ = [
    "GAIN_BITS", "LEFT_BITS", "TOGETHER", "TURNED", "prefetch", "read_bytes", "read_turned", "read_turned_with_gain",
    "read_with_gain", "two_at",
]  # fmt: skip

#: Bytes that are read together.
TOGETHER = 16
#: Pixels of three bytes that are read together and reversed; the last byte is not used.
TURNED = 5
_ORDER = [3 * (TURNED - 1 - k // 3) + k % 3 for k in range(3 * TURNED)] + [TOGETHER - 1]
#: Fractional bits of a gain below 4 in 16 bits.
GAIN_BITS = 14
#: Fractional bits of the upper half of its product with a byte weighted by 256ths.
LEFT_BITS = 6
_WEIGHT_BITS = 8


def _vector(bits: int) -> Any:
    return ir.VectorType(ir.IntType(bits), TOGETHER)


def _all(bits: int, value: int) -> Any:
    return ir.Constant(_vector(bits), [value] * TOGETHER)


def _addresses(context: Any, builder: Any, signature: Any, arguments: Any) -> Callable[[int, Any, int], Any]:
    """A function for the address of a vector of numbers of so many bits at some place of an argument."""

    def address(which: int, place: Any, bits: int) -> Any:
        array = context.make_array(signature.args[which])(context, builder, arguments[which])
        return builder.bitcast(builder.gep(array.data, [place]), _vector(bits).as_pointer())

    return address


def _weighted(builder: Any, address: Any, places: Any, weights: Any) -> Any:
    """Sum of the bytes at four places, times the weights."""
    total = _all(16, 0)
    for k in range(4):
        read = builder.load(address(0, builder.extract_value(places, k), 8), align=1)
        first = builder.insert_element(
            ir.Constant(_vector(16), ir.Undefined), builder.extract_value(weights, k), ir.IntType(32)(0)
        )
        weight = builder.shuffle_vector(first, first, _all(32, 0))
        total = builder.add(total, builder.mul(builder.zext(read, _vector(16)), weight))
    return total


def _rounded(builder: Any, values: Any, bits: int) -> Any:
    return builder.lshr(builder.add(values, _all(16, 1 << (bits - 1))), _all(16, bits))


def _store(builder: Any, values: Any, where: Any, turned: bool) -> None:
    narrow = builder.trunc(values, _vector(8))
    if turned:
        narrow = builder.shuffle_vector(narrow, narrow, ir.Constant(_vector(32), _ORDER))
    builder.store(narrow, where, align=1)


def _plain(turned: bool) -> Callable[..., Any]:
    def read(_typing: Any, values: Any, places: Any, weights: Any, out: Any, _into: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            address = _addresses(context, builder, signature, arguments)
            mean = _rounded(builder, _weighted(builder, address, arguments[1], arguments[2]), _WEIGHT_BITS)
            _store(builder, mean, address(3, arguments[4], 8), turned)
            return context.get_dummy_value()

        return types.void(values, places, weights, out, types.uintp), generate

    return read


def _with_gain(turned: bool) -> Callable[..., Any]:
    def read(
        _typing: Any, values: Any, places: Any, weights: Any, gain: Any, _gain_at: Any, out: Any, _into: Any
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            address = _addresses(context, builder, signature, arguments)
            total = builder.zext(_weighted(builder, address, arguments[1], arguments[2]), _vector(32))
            factor = builder.zext(builder.load(address(3, arguments[4], 16), align=1), _vector(32))
            product = builder.lshr(builder.mul(total, factor), _all(32, 16))
            value = _rounded(builder, builder.trunc(product, _vector(16)), LEFT_BITS)
            top = _all(16, 255)
            value = builder.select(builder.icmp_unsigned("<", value, top), value, top)
            _store(builder, value, address(5, arguments[6], 8), turned)
            return context.get_dummy_value()

        return types.void(values, places, weights, gain, types.uintp, out, types.uintp), generate

    return read


def _two_at(_typing: Any, line: Any, place: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        address = builder.gep(array.data, [arguments[1]])
        return builder.load(builder.bitcast(address, ir.IntType(64).as_pointer()), align=4)

    return types.uint64(line, place), generate


# `read_bytes(values, places, weights, out, into)` stores the means of the bytes from four `places` on, weighted by
# 256ths, in `out`; `read_turned` does so in reverse order of pixels.
read_bytes: Any = intrinsic(_plain(turned=False))
read_turned: Any = intrinsic(_plain(turned=True))
# `read_with_gain(values, places, weights, gain, gain_at, out, into)` multiplies them by the gains from `gain[gain_at]`
# on, in units of 2^-14.
read_with_gain: Any = intrinsic(_with_gain(turned=False))
read_turned_with_gain: Any = intrinsic(_with_gain(turned=True))
# `two_at(line, place)` loads the two numbers of four bytes from a place on, the first in the lower half.
two_at: Any = intrinsic(_two_at)


def _prefetch(_typing: Any, values: Any, _place: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        address = builder.bitcast(builder.gep(array.data, [arguments[1]]), ir.IntType(8).as_pointer())
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [address.type, number, number, number])
        hint = builder.module.declare_intrinsic("llvm.prefetch", [address.type], kind)
        # For reading, to be kept in all caches, as data.
        builder.call(hint, [address, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(values, types.uintp), generate


# `prefetch(values, place)` in a kernel prefetches the cache line of `values[place]`, wherever that is.
prefetch: Any = intrinsic(_prefetch)
