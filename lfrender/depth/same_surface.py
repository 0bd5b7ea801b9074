"""The one test of whether two patch sizes belong to one surface of the scene."""

from __future__ import annotations

from numba.extending import register_jitable

__all__ = ["TOLERANCE", "same_surface"]

#: Tolerance of neighbouring lenses on one surface [pitch], default of several stages; set by hand.
TOLERANCE = 0.04


@register_jitable(inline="always")
def same_surface(a, b, tolerance):
    """Whether patch sizes differ by no more than a tolerance [all in px]; False where one of them is NaN.

    Takes scalars and arrays in Python, and scalars inside Numba kernels. Patch sizes also vary along a slanted surface,
    so the tolerance depends on how far apart `a` and `b` were measured and how noisy they are: each stage has its own,
    a field of its settings, in shares of the pitch.
    """
    return abs(a - b) <= tolerance
