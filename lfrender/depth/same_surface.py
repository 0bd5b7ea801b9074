"""Whether two patch sizes belong to one surface of the scene, and which is nearer to the camera."""

from __future__ import annotations

from numba import njit
from numba.extending import register_jitable

from lfcal.runtime.kernels import FAST

__all__ = ["TOLERANCE", "depth_order", "same_surface"]

#: Tolerance of neighbouring lenses on one surface [pitch], default of several stages; set by hand.
TOLERANCE = 0.04


@register_jitable(inline="always")
def same_surface(a, b, tolerance):
    """Whether patch sizes differ by no more than a tolerance [all in px]; False where one of them is NaN.

    Takes scalars and arrays in Python, and scalars inside Numba kernels. Patch sizes also vary along a slanted surface,
    so the tolerance depends on how far apart `a` and `b` were measured and how noisy they are.
    """
    return abs(a - b) <= tolerance


@njit(fastmath=FAST, inline="always")
def depth_order(s, pitch):
    """A monotonic function of nearness to the camera: telescopic patch sizes first, then binocular ones.

    With the image at a = D * b / s in front of the microlenses, nearer objects have their image farther back: s rises
    from 0 to D, goes on at -D behind the microlenses, and rises to 0 again.
    """
    return s if s > 0 else s + 2 * pitch
