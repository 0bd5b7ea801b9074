"""Incremental rendering: only the part that changed since an earlier frame is drawn, all else is taken from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.kernels import FAST, kernel

from ..data.depth_map import DepthMap
from ..data.rendering import PictureGrid, Rendering
from ..data.surface import Surface, mark_changed_places
from ..depth.incremental import changed_since
from ..detail.draw import DetailRenderer
from ..detail.settings import HALO
from ..flat.validation import check_flat
from .renderer import Renderer

__all__ = ["find_changed_pixels", "redraw"]

# Rows that one thread marks together.
_STRIP = 16


@kernel(error_model="numpy", fastmath=FAST, share=lambda places, side, out: -(-len(out) // _STRIP))
def _mark_pixels(begin, end, places, side, out):
    """Set the pixels of `out` within `side` of some of `places` (m, 2), and unset the rest."""
    rows, columns = out.shape
    for strip in range(begin, end):
        top, bottom = strip * _STRIP, min(rows, (strip + 1) * _STRIP)
        # How many more lenses reach a pixel than the one to its left, summed up along the row below.
        more = np.zeros((bottom - top, columns + 1), np.int32)
        for n in range(len(places)):
            x, y = places[n, 0], places[n, 1]
            if y + side < top or y - side > bottom:
                continue
            for v in range(max(top, int(np.ceil(y - side))), min(bottom - 1, int(np.floor(y + side))) + 1):
                half = np.sqrt(max(side * side - (v - y) * (v - y), 0.0))
                left, right = max(0, int(np.ceil(x - half))), min(columns, int(np.floor(x + half)) + 1)
                if left < right:
                    more[v - top, left] += 1
                    more[v - top, right] -= 1
        for v in range(top, bottom):
            reached = 0
            for u in range(columns):
                reached += more[v - top, u]
                out[v, u] = reached > 0


def find_changed_pixels(
    grid: PictureGrid, centres: NDArray[np.float64], reach: float, before: Surface, now: Surface,
    changed: NDArray[np.bool_],
) -> NDArray[np.bool_]:  # fmt: skip
    """(rows, columns) bool: pixels of the picture that may differ from those of an earlier frame.

    They are in `reach` [px] of a lens that is `changed` (n,), or near which the surface differs from `before`: there,
    what occludes what may have changed. All others would be drawn from the same depth and pixels.
    """
    columns, rows = grid.size
    if before.patch_size.shape != now.patch_size.shape or before.first != now.first or before.spacing != now.spacing:
        return np.ones((rows, columns), bool)
    stale = changed.copy()
    # The depth between grid values depends on all four of them.
    mark_changed_places(before, now, centres, reach + 1.5 * now.spacing, stale)
    wanted = np.empty((rows, columns), bool)
    # Large patches are sampled several times per output pixel, all within the pixel.
    _mark_pixels((centres[stale] - grid.first) / grid.spacing, (reach + grid.spacing) / grid.spacing, wanted)
    return wanted


def redraw(
    renderer: Renderer | DetailRenderer, pixels: NDArray, calibration: Calibration, depth: DepthMap, earlier: NDArray,
    before: DepthMap, picture: Rendering,
) -> tuple[NDArray, NDArray[np.bool_]]:  # fmt: skip
    """Draw the pixels (h, w, C) that may differ from the `picture` of an `earlier` flat with the depth map `before`.

    Returns
    -------
    image : (rows, columns, C) array
    valid : (rows, columns) bool
        Pixels that some lens shows.

    Raises
    ------
    ValueError
        If the earlier flat or its picture is of another size, dtype or number of channels.
    """
    import cv2

    channels = picture.image.shape[2] if picture.image.ndim == 3 else 1
    if picture.image.dtype != pixels.dtype or channels != pixels.shape[2]:
        raise ValueError(
            f"the earlier picture is {channels} x {picture.image.dtype}, the flat {pixels.shape[2]} x {pixels.dtype}; "
            "draw without previous"
        )
    earlier = check_flat(earlier, calibration)
    columns, rows = renderer.grid.size
    if picture.image.shape[:2] != (rows, columns) or earlier.shape != pixels.shape or earlier.dtype != pixels.dtype:
        raise ValueError("the earlier frame or its picture is of another kind or size; draw without previous")
    plain, halo = (renderer.plain, HALO) if isinstance(renderer, DetailRenderer) else (renderer, 0)
    changed = changed_since(before, depth, earlier, pixels, calibration)
    lattice = calibration.lattice
    wanted = find_changed_pixels(
        renderer.grid, lattice.centres(), plain.reach * lattice.pitch, before.surface, depth.surface, changed
    )
    wanted = cv2.dilate(wanted.view(np.uint8), np.ones((2 * halo + 1,) * 2, np.uint8)).view(bool)
    image, valid = picture.image.reshape(rows, columns, -1).copy(), picture.valid.copy()
    if wanted.any():
        left, top, wide, tall = cv2.boundingRect(wanted.view(np.uint8))
        box = slice(top, top + tall), slice(left, left + wide)
        drawn, seen = renderer.draw(pixels, part=(left, top, left + wide, top + tall), dtype=pixels.dtype)
        np.copyto(image[box], drawn, where=wanted[box][..., None])
        np.copyto(valid[box], seen, where=wanted[box])
    return image, valid
