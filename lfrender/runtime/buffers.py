"""Memory that is worked in frame after frame: the system takes longer to give fresh pages than kernels to fill them."""

from __future__ import annotations

import sys
from math import prod
from threading import local
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["allocate_pooled", "allocate_scratch"]

# Beyond so many bytes memory is not kept: a flat of 24 megapixels is worked on in parts no larger than this.
_MOST = 1 << 27

# What is recycled is smaller than this, and no more than the second number is kept [bytes].
_MOST_RECYCLED, _MOST_KEPT = 1 << 26, 1 << 28
# Memory this many times as large as is asked for is left to others.
_ROOMY = 2
_LARGEST_FREED = 31 << 20
# Frames may be worked on in several threads at once.
_kept = local()


def allocate_scratch(purpose: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of any content, whose memory the next call for the same `purpose` in this thread hands out again.

    So nothing may be left in it that outlives the function that has asked for it.
    """
    count, kind = prod(shape), np.dtype(dtype)
    if count * kind.itemsize > _MOST:
        return np.empty(shape, kind)
    memory = getattr(_kept, purpose, None)
    if memory is None or len(memory) < count or memory.dtype != kind:
        memory = np.empty(count, kind)
        setattr(_kept, purpose, memory)
    return memory[:count].reshape(shape)


def _references(pool: list[NDArray[Any]], place: int) -> int:
    return sys.getrefcount(pool[place])


# How many references versions of Python count to memory that only the pool refers to.
_UNUSED = _references([np.empty(0)], 0)


def allocate_pooled(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of any content, in memory that was asked for earlier in this thread and that no array refers to now."""
    count, kind = prod(shape), np.dtype(dtype)
    if count * kind.itemsize > _MOST_RECYCLED:
        return np.empty(shape, kind)
    pool: list[NDArray[Any]] | None = getattr(_kept, "_pool", None)
    if pool is None:
        pool = _kept._pool = []
        # The GNU allocator gives memory back to the system as soon as twice the largest piece is free that it has ever
        # got back: let that be the largest it looks at, or all small arrays take fresh pages again and again.
        np.empty(_LARGEST_FREED, np.uint8)
    for place in range(len(pool)):
        fits = pool[place].dtype == kind and count <= len(pool[place]) <= _ROOMY * count
        if fits and _references(pool, place) <= _UNUSED:
            memory = pool.pop(place)
            break
    else:
        memory = np.empty(count, kind)
    # Those used last come first.
    pool.insert(0, memory)
    while sum(kept.nbytes for kept in pool) > _MOST_KEPT:
        pool.pop()
    return memory[:count].reshape(shape)
