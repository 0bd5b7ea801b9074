"""Reused memory for large arrays: fresh pages from the system take longer than the kernels that fill them."""

from __future__ import annotations

import sys
from math import prod
from threading import local
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["allocate_pooled", "allocate_scratch"]

# Larger scratch arrays are not kept [bytes]: parts of a flat of 24 megapixels are no larger than this.
_MOST_SCRATCH = 1 << 27
# Larger pooled arrays are not kept [bytes], nor is more than this in all.
_MOST_POOLED = 1 << 26
_POOL_SIZE = 1 << 28
# Pooled memory is reused for arrays down to its size over this.
_ROOMY = 2
# Largest size that the GNU allocator takes as a threshold below which it keeps freed memory [bytes].
_LARGEST_FREED = 31 << 20
# Per thread, since several may work on frames at once.
_kept = local()


def allocate_scratch(purpose: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of undefined content, whose memory the next call for the same `purpose` in this thread returns again.

    So nothing in it may outlive the function that calls this.
    """
    count, kind = prod(shape), np.dtype(dtype)
    if count * kind.itemsize > _MOST_SCRATCH:
        return np.empty(shape, kind)
    memory = getattr(_kept, purpose, None)
    if memory is None or len(memory) < count or memory.dtype != kind:
        memory = np.empty(count, kind)
        setattr(_kept, purpose, memory)
    return memory[:count].reshape(shape)


def _references(pool: list[NDArray[Any]], place: int) -> int:
    return sys.getrefcount(pool[place])


# References that Python counts to memory that only the pool refers to.
_UNUSED = _references([np.empty(0)], 0)


def allocate_pooled(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of undefined content, in memory allocated here earlier in this thread that no array refers to now."""
    count, kind = prod(shape), np.dtype(dtype)
    if count * kind.itemsize > _MOST_POOLED:
        return np.empty(shape, kind)
    pool: list[NDArray[Any]] | None = getattr(_kept, "_pool", None)
    if pool is None:
        pool = _kept._pool = []
        # The GNU allocator returns memory to the system once twice the largest freed piece is free: free a large piece
        # first, or all small arrays would get fresh pages again and again.
        np.empty(_LARGEST_FREED, np.uint8)
    for place in range(len(pool)):
        fits = pool[place].dtype == kind and count <= len(pool[place]) <= _ROOMY * count
        if fits and _references(pool, place) <= _UNUSED:
            memory = pool.pop(place)
            break
    else:
        memory = np.empty(count, kind)
    # The last used comes first.
    pool.insert(0, memory)
    while sum(kept.nbytes for kept in pool) > _POOL_SIZE:
        pool.pop()
    return memory[:count].reshape(shape)
