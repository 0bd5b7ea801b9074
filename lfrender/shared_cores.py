"""Whether two frames may be worked on at once: one core need not wait while the other does what has no parts."""

from __future__ import annotations

import numba

__all__ = ["can_share"]

# Flats of more bytes keep all cores busy by themselves, and take memory.
_MOST_SHARED = 1 << 26
# What Numba runs kernels on that may be called from several threads.
_SAFE_LAYERS = ("omp", "tbb")


def can_share(size: int) -> bool:
    """Whether this may be done with flats of `size` bytes; once a kernel has run."""
    return size <= _MOST_SHARED and numba.threading_layer() in _SAFE_LAYERS
