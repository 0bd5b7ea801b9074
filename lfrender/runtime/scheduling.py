"""An order of work that gives every thread its share of what lies together: threads take whole stretches of a loop."""

from __future__ import annotations

from numba import njit

__all__ = ["coprime_stride", "plan_chunks"]

# Work that comes in clusters is dealt out in so many stretches: what lies beside each other stays in the caches.
_STRETCHES = 32


@njit(cache=True, nogil=True, error_model="python", fastmath=False)
def coprime_stride(n):
    """A step near the golden section of `n` that visits all of 0..n-1."""
    stride = max(1, int(0.618 * n))
    while True:
        a, b = n, stride
        while b:
            a, b = b, a % b
        if a == 1:
            return stride
        stride -= 1


@njit(cache=True, nogil=True, error_model="python", fastmath=False)
def plan_chunks(n):
    """How many stretches of 0..n-1 are worked on one after the other, their length, and the step from one to the
    next, so that each thread has its share of what lies together."""
    length = max(1, -(-n // _STRETCHES))
    count = -(-n // length)
    return count, length, coprime_stride(max(count, 1))
