"""Which liberties kernels take with floating point: any order of sums, but NaN keeps its meaning.

A kernel with these liberties that others call is to be inlined (`forceinline`): else it may be linked to another copy
of itself, whose sums are in another order, just compiled than from Numba's cache.

Nothing may depend on what a process has compiled before, or the same kernel rounds otherwise in another process.
Numba compiles `x ** 2` once, with the liberties of the kernel that asks for it first: kernels with liberties have
products instead. And a kernel that says nothing of liberties has those of its first caller: one with callers of both
kinds says `fastmath=False`.
"""

from numba import njit

__all__ = ["FAST", "square"]

FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, nogil=True, inline="always")
def square(value):
    """The value times itself."""
    return value * value
