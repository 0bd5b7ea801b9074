"""Which liberties kernels take with floating point: any order of sums, but NaN keeps its meaning.

A kernel with these liberties that others call is to be inlined (`forceinline`): else it may be linked to another copy
of itself, whose sums are in another order, just compiled than from Numba's cache.
"""

__all__ = ["FAST"]

FAST = {"contract", "arcp", "nsz", "reassoc"}
