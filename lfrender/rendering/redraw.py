"""Incremental rendering: only pixels that changed since an earlier frame are drawn, the others are taken from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import kernel

from ..data.depth_map import DepthMap
from ..data.rendering import Rendering
from ..data.surface import Surface, mark_changed_places
from ..depth.incremental import changed_since
from ..flat.validation import check_flat
from .plan import RenderPlan

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


def find_changed_pixels(plan: RenderPlan, before: Surface, changed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(rows, columns) bool: pixels of the picture that may differ from those of an earlier frame.

    They are in reach of a lens that is `changed` (n,), or near which the surface differs from `before`: there, what
    occludes what may have changed. All others would be drawn from the same depth and pixels.
    """
    columns, rows = plan.size
    lattice, now = plan.calibration.lattice, plan.surface
    if before.patch_size.shape != now.patch_size.shape or before.first != now.first or before.spacing != now.spacing:
        return np.ones((rows, columns), bool)
    centres = lattice.centres()
    reach = plan.reach * lattice.pitch
    stale = changed.copy()
    # The depth between grid values depends on all four of them.
    mark_changed_places(before, now, centres, reach + 1.5 * now.spacing, stale)
    wanted = np.empty((rows, columns), bool)
    # Large patches are sampled several times per output pixel, all within the pixel.
    farthest = reach + plan.spacing
    places = (centres[stale] - (0.5 * plan.spacing - 0.5)) / plan.spacing
    _mark_pixels(places, farthest / plan.spacing, wanted)
    return wanted


def redraw(
    plan: RenderPlan, pixels: NDArray, depth: DepthMap, earlier: NDArray, before: DepthMap, picture: Rendering
) -> tuple[NDArray, NDArray[np.bool_]]:
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
    channels = picture.image.shape[2] if picture.image.ndim == 3 else 1
    if picture.image.dtype != pixels.dtype or channels != pixels.shape[2]:
        raise ValueError(
            f"the earlier picture is {channels} x {picture.image.dtype}, the flat {pixels.shape[2]} x {pixels.dtype}; "
            "draw without previous"
        )
    earlier = check_flat(earlier, plan.calibration)
    columns, rows = plan.size
    if picture.image.shape[:2] != (rows, columns) or earlier.shape != pixels.shape or earlier.dtype != pixels.dtype:
        raise ValueError("the earlier frame or its picture is of another kind or size; draw without previous")
    changed = changed_since(before, depth, earlier, pixels, plan.calibration)
    wanted = find_changed_pixels(plan, before.surface, changed)
    return plan.render_changed(pixels, wanted, picture.image.reshape(rows, columns, -1), picture.valid)
