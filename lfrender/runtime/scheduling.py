"""Loop order of parallel kernels: each thread gets its share of work that comes in clusters."""

from __future__ import annotations

from lfcal.runtime.kernels.jit import njit

__all__ = ["coprime_stride", "plan_chunks"]

# Chunks of a loop: enough to share clusters, long enough that neighbours stay in the caches.
_CHUNKS = 32


@njit(cache=True, nogil=True, error_model="python", fastmath=False)
def coprime_stride(n):
    """A step near the golden section of `n` that, repeated modulo `n`, visits all of 0..n-1."""
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
    """Number and length of the chunks of 0..n-1, and the step from one to the next in the order of work."""
    length = max(1, -(-n // _CHUNKS))
    count = -(-n // length)
    return count, length, coprime_stride(max(count, 1))
