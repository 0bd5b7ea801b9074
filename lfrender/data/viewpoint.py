"""The surface as it is seen from a place in the main lens' aperture, nearer places hiding farther ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.fastmath import FAST

from .surface import Surface, patch_size_at

__all__ = ["Viewpoint"]

# Patches of less than a twelfth of the pitch are not found in any capture; without a bound, parallax has a pole.
_LARGEST_MAGNIFICATION = 12.0


@dataclass(frozen=True)
class Viewpoint:
    """A place in the main lens' aperture, and what stays in place when the view moves there.

    A pixel at `q + delta` in lens `c` shows `X = c - (q + delta) D / s`. Seen from `q`, the place `X` hence lies at
    `X + q D / s`: there, all lenses show it beside `q` as they show `X` itself beside their centres.

    Parameters
    ----------
    offset : (float, float) [px]
        `q`, the position in every microimage at which the view is seen, relative to its centre, order `x, y`.
    still : float
        Signed virtual depth `D / s` of places that lie where they lie from the middle of the aperture.
    """

    offset: tuple[float, float] = (0.0, 0.0)
    still: float = 0.0

    def max_parallax(self, surface: Surface, lattice: Lattice) -> float:
        """How far places of `surface` move at most [px]."""
        if not any(self.offset):
            return 0.0
        return float(np.hypot(*self.offset) * np.abs(virtual_depth(surface.patch_size, lattice.pitch)).max())

    def warp_surface(self, surface: Surface, lattice: Lattice, edge: float) -> tuple[Surface, NDArray[np.float64]]:
        """The surface over the places at which it is seen, and how far the picture's frame moves.

        What is hidden from the middle of the aperture continues the farther of the surfaces beside it.

        Parameters
        ----------
        surface : Surface
            As seen from the middle.
        lattice : Lattice
        edge : float [px]
            Patch sizes that differ by less belong to one surface.

        Returns
        -------
        surface : Surface
        moved : (2,) float64 [px]
            Order `x, y`.
        """
        moved = self.still * np.array(self.offset, dtype=float)
        if not any(self.offset):
            return surface, moved
        warped = surface.patch_size
        if warped.size > 1:
            depths = virtual_depth(surface.patch_size, lattice.pitch)
            warped = np.empty_like(surface.patch_size)
            single = np.float32
            _warp(
                surface.patch_size, single(surface.spacing), single(self.offset[0]), single(self.offset[1]),
                single(self.still), depths.min(), depths.max(), single(lattice.pitch), single(edge), warped,
            )  # fmt: skip
        first = (surface.first[0] + moved[0], surface.first[1] + moved[1])
        return Surface(warped, first, surface.spacing), moved


def virtual_depth(patch_size: NDArray[np.float32], pitch: float) -> NDArray[np.float32]:
    """Signed virtual depth `D / s`, bounded where `s` is near zero."""
    least = np.float32(pitch / _LARGEST_MAGNIFICATION)
    bounded = np.where(np.abs(patch_size) < least, np.copysign(least, patch_size), patch_size)
    depth: NDArray[np.float32] = (np.float32(pitch) / bounded).astype(np.float32)
    return depth


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _warp(surface, cell, view_x, view_y, still, nearest, farthest, pitch, edge, out):
    """Follow the ray of every grid value of `out` (h, w) from near to far until it meets the surface.

    Positions are counted from the first grid value. At virtual depth `t`, the ray to the place `Y` passes over
    `Y - q (t - still)`.
    """
    rows, columns = surface.shape
    aside = np.sqrt(view_x * view_x + view_y * view_y)
    least = pitch / np.float32(_LARGEST_MAGNIFICATION)
    zero = np.float32(0.0)
    # Half a grid value per step: no part of the surface is stepped over.
    steps = max(1, int(np.ceil((farthest - nearest) * aside / (np.float32(0.5) * cell))))
    step = (farthest - nearest) / steps
    for v in prange(rows):
        for u in range(columns):
            before, above = zero, zero
            found = surface[v, u]
            for k in range(steps + 1):
                depth = nearest + k * step
                x = u * cell - view_x * (depth - still)
                y = v * cell - view_y * (depth - still)
                found = patch_size_at(surface, x, y, zero, zero, cell, edge)
                bounded = found if abs(found) >= least else (least if found >= 0 else -least)
                left = pitch / bounded - depth
                if left <= 0:
                    if k > 0 and abs(found - before) < edge:
                        found = before + (found - before) * above / (above - left)
                    elif k > 0:
                        # The ray has passed behind the rim of a nearer surface.
                        found = before
                    break
                before, above = found, left
            out[v, u] = found
