"""Incremental rendering: only the part that changed since an earlier frame is drawn, all else is
taken from it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..data.depth_map import DepthMap
from ..data.rendering import PictureGrid, Rendering
from ..data.surface import Surface
from ..depth.incremental import changed_since
from ..flat.validation import check_flat
from .blend.occlusion import projection_reach
from .renderer import Renderer

__all__ = ["find_changed_pixels", "redraw"]


def find_changed_pixels(
    grid: PictureGrid,
    centres: NDArray[np.float64],
    reach: float,
    sight: float,
    before: Surface,
    now: Surface,
    changed: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """(rows, columns) bool: pixels of the picture that may differ from those of an earlier frame:
    those in `reach` [px] of a lens that is `changed` (n,), or that has points in `sight` [px] where
    the surface differs from `before`.
    """
    columns, rows = grid.size
    if (
        before.patch_size.shape != now.patch_size.shape
        or before.first != now.first
        or before.spacing != now.spacing
    ):
        return np.ones((rows, columns), bool)
    import cv2

    # The depth between grid values depends on all four of them; lenses beyond the grid have its
    # nearest value.
    differ = (before.patch_size != now.patch_size).astype(np.uint8)
    beside = np.ones((2 * int(np.ceil(sight / now.spacing)) + 5,) * 2, np.uint8)
    near = replace(now, patch_size=cv2.dilate(differ, beside).astype(np.float32))
    stale = changed | (near.at(centres) > 0)
    if not stale.any():
        return np.zeros((rows, columns), bool)
    # Lenses may lie beyond the border of the picture. Large patches are sampled several times per
    # output pixel, all within the pixel; another one for the rounding of the centres, and 2 % for
    # that of the distances.
    side = 1.02 * reach / grid.spacing + 2
    beyond = int(np.ceil(side))
    at = np.rint((centres[stale] - grid.first) / grid.spacing).astype(int) + beyond
    still = np.ones((rows + 2 * beyond, columns + 2 * beyond), np.uint8)
    inside = ((at >= 0) & (at < still.shape[::-1])).all(1)
    still[at[inside, 1], at[inside, 0]] = 0
    away = cv2.distanceTransform(still, cv2.DIST_L2, cv2.DIST_MASK_5)
    return away[beyond : beyond + rows, beyond : beyond + columns] <= side


def redraw(
    renderer: Renderer,
    pixels: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    earlier: NDArray,
    before: DepthMap,
    picture: Rendering,
) -> tuple[NDArray, NDArray[np.bool_]]:
    """Draw the pixels (h, w, C) that may differ from the `picture` of an `earlier` flat with the
    depth map `before`.

    Returns the image and the pixels that some lens shows; ValueError if the earlier flat or picture
    is of another kind.
    """
    import cv2

    channels = picture.image.shape[2] if picture.image.ndim == 3 else 1
    if picture.image.dtype != pixels.dtype or channels != pixels.shape[2]:
        raise ValueError(
            f"the earlier picture is {channels} x {picture.image.dtype}, the flat "
            f"{pixels.shape[2]} x {pixels.dtype}; draw without previous"
        )
    earlier = check_flat(earlier, calibration)
    columns, rows = renderer.grid.size
    if (
        picture.image.shape[:2] != (rows, columns)
        or earlier.shape != pixels.shape
        or earlier.dtype != pixels.dtype
    ):
        raise ValueError(
            "the earlier frame or its picture is of another kind or size; draw without previous"
        )
    changed = changed_since(before, depth, earlier, pixels, calibration)
    lattice = calibration.lattice
    reach = renderer.reach * lattice.pitch
    wanted = find_changed_pixels(
        renderer.grid,
        lattice.centres(),
        reach,
        projection_reach(lattice, reach),
        before.surface,
        depth.surface,
        changed,
    )
    wanted = cv2.dilate(
        wanted.view(np.uint8), np.ones((2 * renderer.halo + 1,) * 2, np.uint8)
    ).view(bool)
    image = picture.image.reshape(rows, columns, -1).copy()
    valid = picture.valid.copy()
    if wanted.any():
        left, top, wide, tall = cv2.boundingRect(wanted.view(np.uint8))
        box = slice(top, top + tall), slice(left, left + wide)
        drawn, seen = renderer.draw(
            pixels, part=(left, top, left + wide, top + tall), dtype=pixels.dtype
        )
        np.copyto(image[box], drawn, where=wanted[box][..., None])
        np.copyto(valid[box], seen, where=wanted[box])
    return image, valid
