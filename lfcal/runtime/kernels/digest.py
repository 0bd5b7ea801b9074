"""Digest of all that the machine code of a kernel is made of: its code, its options, and whatever it refers to.

Numba's own cache knows the file of a kernel alone. If a function of another file that is inlined changes, or a constant
imported from there, it goes on with the old machine code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from hashlib import blake2b
from types import CodeType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .jit import Kernel

__all__ = ["digest_kernel"]

# Whose modules are followed; of others Numba's version stands for all.
_PACKAGES = ("lfcal", "lfrender", "data_synth")
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(...), np.generic, np.dtype, range, slice)
# Kernels whose digest is being made: one that calls itself.
_begun: set[int] = set()


@cache
def digest_kernel(kernel: Kernel) -> bytes:
    """16 bytes that change with the bytecode, constants and options of a kernel and of all functions it calls."""
    _begun.add(id(kernel))
    state = blake2b(digest_size=16)
    try:
        _add(state.update, sorted((name, repr(_ordered(value))) for name, value in kernel.options.items()))
        _add(state.update, kernel.py_func)
    finally:
        _begun.discard(id(kernel))
    return state.digest()


def _is_kernel(value: Any) -> bool:
    return isinstance(getattr(value, "options", None), dict) and hasattr(value, "py_func")


def _ordered(value: Any) -> Any:
    return sorted(value) if isinstance(value, (set, frozenset)) else value


def _add(update: Callable[[bytes], None], value: Any) -> None:
    """Add a value that a function refers to."""
    update(type(value).__name__.encode() + b"\0")
    if _is_kernel(value):
        update(value.__qualname__.encode() if id(value) in _begun else digest_kernel(value))
    elif isinstance(value, FunctionType):
        _add_function(update, value)
    elif isinstance(value, CodeType):
        update(value.co_code)
        _add(update, [value.co_names, value.co_argcount, value.co_consts])
    elif isinstance(value, _PLAIN):
        update(repr(value).encode() + b"\0")
    elif isinstance(value, np.ndarray):
        update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    elif isinstance(value, Mapping):
        _add(update, sorted((repr(key), item) for key, item in value.items()))
    elif isinstance(value, (set, frozenset)):
        _add(update, sorted(map(repr, value)))
    elif isinstance(value, Iterable) and isinstance(value, (tuple, list)):
        for item in value:
            _add(update, item)
        update(b"end")
    else:
        _add_object(update, value)


def _add_object(update: Callable[[bytes], None], value: Any) -> None:
    """Add a module, a class, or an object of Numba that holds a function."""
    # Functions of `numba.njit`, `numba.extending.intrinsic`.
    for name in ("py_func", "_defn"):
        inner = getattr(value, name, None)
        if isinstance(inner, FunctionType):
            _add(update, inner)
            return
    update(
        f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', getattr(value, '__name__', ''))}".encode()
    )
    # The fields of a NamedTuple.
    update(repr(getattr(value, "_fields", "")).encode())


def _add_function(update: Callable[[bytes], None], function: FunctionType) -> None:
    code = function.__code__
    if function.__module__.partition(".")[0] not in _PACKAGES:
        update(f"{function.__module__}.{function.__qualname__}".encode())
        return
    key = id(code)
    if key in _begun:
        return
    _begun.add(key)
    try:
        constants = code.co_consts
        if function.__doc__ is not None and constants and constants[0] == function.__doc__:
            constants = constants[1:]
        update(code.co_code)
        _add(update, [code.co_names, code.co_argcount, constants, function.__defaults__])
        for cell in function.__closure__ or ():
            _add(update, cell.cell_contents)
        names = list(dict.fromkeys(_names(code)))
        for name in names:
            if name in function.__globals__:
                update(name.encode())
                _add_global(update, function.__globals__[name], names)
    finally:
        _begun.discard(key)


def _add_global(update: Callable[[bytes], None], value: Any, names: list[str]) -> None:
    """Add what a global name stands for; of an own module, all that is taken from it."""
    if not isinstance(value, ModuleType):
        _add(update, value)
    elif value.__name__.partition(".")[0] in _PACKAGES:
        for name in names:
            if name in vars(value):
                _add(update, vars(value)[name])
    else:
        update(value.__name__.encode())


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)
