"""Which of two patch sizes is nearer to the camera."""

from __future__ import annotations

from numba import njit

from lfcal.runtime.kernels import FAST

__all__ = ["depth_order"]


@njit(fastmath=FAST, inline="always")
def depth_order(s, pitch):
    """A monotonic function of nearness to the camera: telescopic patch sizes first, then binocular ones.

    With the image at a = D * b / s in front of the microlenses, nearer objects have their image farther back: s rises
    from 0 to D, goes on at -D behind the microlenses, and rises to 0 again.
    """
    return s if s > 0 else s + 2 * pitch
