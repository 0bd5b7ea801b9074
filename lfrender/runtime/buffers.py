"""Reused memory for large arrays, since getting new memory takes longer than filling it."""

from __future__ import annotations

from collections import deque
from math import prod
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["allocate_pooled"]

# Larger pooled arrays are not kept [bytes], nor is more than this in all.
_MOST_POOLED = 1 << 27
_POOL_SIZE = 1 << 28
# Memory that no array refers to any more.
_pool: deque[NDArray[np.uint8]] = deque()


class _Lease:
    """Owner of a piece of memory: it is reused when the last array in it has been deleted."""

    __slots__ = ("__array_interface__", "__weakref__")

    def __init__(self, memory: NDArray[np.uint8]) -> None:
        self.__array_interface__ = memory.__array_interface__
        finalize(self, _give_back, memory).atexit = False


def _give_back(memory: NDArray[np.uint8]) -> None:
    _pool.append(memory)
    while sum(kept.nbytes for kept in list(_pool)) > _POOL_SIZE:
        _pool.popleft()


def _take(size: int) -> NDArray[np.uint8]:
    """Pooled memory of at least a size [bytes], not twice as large, or new memory."""
    for _ in range(len(_pool)):
        try:
            memory = _pool.pop()
        except IndexError:  # another thread took it
            break
        if size <= memory.nbytes <= 2 * size:
            return memory
        _pool.appendleft(memory)
    return np.empty(size, np.uint8)


def allocate_pooled(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of undefined content, in memory of an earlier array if that has been deleted."""
    kind = np.dtype(dtype)
    size = prod(shape) * kind.itemsize
    if size == 0 or size > _MOST_POOLED:
        return np.empty(shape, kind)
    return np.asarray(_Lease(_take(size)))[:size].view(kind).reshape(shape)
