"""Floating-point options of Numba kernels: sums may be reordered, but NaN keeps its meaning.

Results must not depend on what a process has compiled before, so there are three rules (checked by a test):

- A kernel with these options that other kernels call is inlined (`forceinline`). Otherwise it may be linked to another
  copy of itself with sums in another order, depending on whether it is just compiled or comes from Numba's cache.
- Kernels with these options use products instead of `x ** 2`, which Numba compiles only once, with the options of the
  first kernel that needs it.
- A kernel without options of its own takes those of its first caller; one with callers of both kinds states
  `fastmath=False`.
"""

from numba import njit

__all__ = ["FAST", "square"]

FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(inline="always")
def square(value):
    """The square of a value, for kernels with `FAST`."""
    return value * value
