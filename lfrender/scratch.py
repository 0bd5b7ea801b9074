"""Memory that is worked in frame after frame: the system takes longer to give fresh pages than kernels to fill them."""

from __future__ import annotations

from math import prod
from threading import local
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["scratch"]

# Beyond so many bytes memory is not kept: a flat of 24 megapixels is worked on in parts no larger than this.
_MOST = 1 << 27

# Frames may be worked on in several threads at once.
_kept = local()


def scratch(purpose: str, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
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
