"""An order of work that gives every thread its share of what lies together: threads take whole stretches of a loop."""

from __future__ import annotations

from numba import njit

__all__ = ["coprime_stride"]


@njit(cache=True, nogil=True)
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
