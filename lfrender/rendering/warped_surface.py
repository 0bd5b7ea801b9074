"""Warping of the surface to another viewpoint in the main lens' aperture, by ray casting with
occlusion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import FAST, kernel

from ..data.surface import Surface, patch_size_at

__all__ = ["Viewpoint", "virtual_depth"]


@dataclass(frozen=True)
class Viewpoint:
    """A point `q` in the main lens' aperture, and the depth that has no parallax between it and the
    middle.

    A pixel at `q + delta` in lens `c` shows the scene point `X = c - (q + delta) D / s`. Seen from
    `q`, `X` is drawn at `X + q D / s`, where every lens is read about `q` instead of about its
    centre.
    """

    offset: tuple[float, float] = (
        0.0,
        0.0,
    )  # `q` [px], order `x, y`, relative to the centres of the microimages
    still: float = (
        0.0  # signed virtual depth `D / s` of scene points that keep their place in all views
    )

    def max_parallax(self, surface: Surface, lattice: Lattice) -> float:
        """Largest displacement of a point of `surface` [px]."""
        if not any(self.offset):
            return 0.0
        return float(
            np.hypot(*self.offset) * np.abs(virtual_depth(surface.patch_size, lattice.pitch)).max()
        )

    def warp_surface(
        self, surface: Surface, lattice: Lattice, edge: float
    ) -> tuple[Surface, NDArray[np.float64]]:
        """The surface as seen from here, and the shift (2,) [px], order `x, y`, of the picture's
        frame.

        Where it uncovers what the middle view hides, the farther of the surfaces beside it is
        continued; `edge` is as `edge_step`.
        """
        moved = self.still * np.array(self.offset, dtype=float)
        if not any(self.offset):
            return surface, moved
        warped = surface.patch_size
        if warped.size > 1:
            depths = virtual_depth(surface.patch_size, lattice.pitch)
            warped = np.empty_like(surface.patch_size)
            grid = Surface(surface.patch_size, (0.0, 0.0), surface.spacing).grid(edge)
            limits = *self.offset, self.still, depths.min(), depths.max(), lattice.pitch
            rays = _Rays(*map(np.float32, limits))
            bounds = self._nearest_in_reach(depths, surface.spacing)
            _warp(surface.patch_size, grid, rays, bounds, warped)
        first = (surface.first[0] + moved[0], surface.first[1] + moved[1])
        return Surface(warped, first, surface.spacing), moved

    def _nearest_in_reach(self, depths: NDArray[np.float32], spacing: float) -> NDArray[np.float32]:
        """(h, w) virtual depth before which the ray of each grid value meets nothing, found in
        slabs of depth.
        """
        import cv2

        slabs = np.linspace(depths.min(), depths.max(), 5)
        first = np.full(depths.shape, slabs[-1], np.float32)
        for near, far in zip(slabs[-2::-1], slabs[:0:-1], strict=True):
            kernel = []
            anchor = []
            for q in self.offset:
                reach = [-q * (end - self.still) / spacing for end in (near, far)]
                # The neighbours of interpolation; and the grid value itself, which the anchor has
                # to be among.
                low = min(int(np.floor(min(reach))) - 1, 0)
                high = max(int(np.ceil(max(reach))) + 1, 0)
                kernel.append(high - low + 1)
                anchor.append(-low)
            shape = np.ones(kernel[::-1], np.uint8)
            nearest = cv2.erode(
                depths, shape, anchor=tuple(anchor), borderType=cv2.BORDER_REPLICATE
            )
            np.copyto(first, np.maximum(nearest, np.float32(near)), where=nearest <= far)
        return first


@register_jitable
def _least_size(pitch: float) -> np.float32:
    """Bound of `|s|` [px], since `D / s` has a pole at 0; no capture has smaller patches than D /
    12.
    """
    return np.float32(pitch / 12)


def virtual_depth(patch_size: NDArray[np.float32], pitch: float) -> NDArray[np.float32]:
    """Signed virtual depth `D / s`, bounded where `s` is near zero."""
    least = _least_size(pitch)
    bounded = np.where(np.abs(patch_size) < least, np.copysign(least, patch_size), patch_size)
    depth: NDArray[np.float32] = (np.float32(pitch) / bounded).astype(np.float32)
    return depth


class _Rays(NamedTuple):
    """Rays through the pixels of a view, from near to far, float32."""

    view_x: Any  # [px] `q`
    view_y: Any
    still: Any  # virtual depth without parallax
    nearest: Any  # virtual depth of the nearest and of the farthest surface
    farthest: Any
    pitch: Any  # [px]


@kernel(error_model="numpy", fastmath=FAST, share=lambda surface, *_: len(surface))
def _warp(begin, end, surface, grid, rays, bounds, out):
    """Follow the ray of every grid value of `out` (h, w) from near to far until it meets the
    surface.

    Nothing on its way is nearer than `bounds` (h, w). At virtual depth `t`, the ray of pixel `Y`
    passes over `Y - q (t - still)`, relative to the first grid value.
    """
    view_x, view_y, still, nearest, farthest, pitch = rays
    least = _least_size(pitch)
    columns = surface.shape[1]
    cell = grid.spacing
    aside = np.sqrt(view_x * view_x + view_y * view_y)
    zero = np.float32(0.0)
    # Half a grid value per step, so that no part of the surface is missed.
    steps = max(1, int(np.ceil((farthest - nearest) * aside / (np.float32(0.5) * cell))))
    step = (farthest - nearest) / steps
    for v in range(begin, end):
        for u in range(columns):
            before = zero
            above = zero
            found = surface[v, u]
            # One step before, for the height above the surface there.
            start = min(max(int((bounds[v, u] - nearest) / step) - 1, 0), steps) if step > 0 else 0
            for k in range(start, steps + 1):
                depth = nearest + k * step
                x = u * cell - view_x * (depth - still)
                y = v * cell - view_y * (depth - still)
                found = patch_size_at(surface, grid, x, y)
                bounded = found if abs(found) >= least else (least if found >= 0 else -least)
                left = pitch / bounded - depth
                if left <= 0:
                    if k > start and abs(found - before) < grid.edge:
                        found = before + (found - before) * above / (above - left)
                    elif k > start:
                        # The ray passed behind the rim of a nearer surface.
                        found = before
                    break
                before = found
                above = left
            out[v, u] = found
