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
    """Whether patch sizes differ by no more than a tolerance [all in px]; False where one of them
    is NaN.
    """
    return abs(a - b) <= tolerance


@njit(fastmath=FAST, inline="always")
def depth_order(s, pitch):
    """A monotonic function of nearness to the camera: telescopic patch sizes first, then binocular
    ones (docs/geometry.md).
    """
    return s if s > 0 else s + 2 * pitch
