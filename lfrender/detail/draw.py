"""Pictures with their detail restored: any part is blended with a margin around it, and gets the bits of the whole."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..data.surface import nearest_patch_size
from ..flat.gray_flat import white_level
from ..runtime.buffers import allocate_pooled
from ..runtime.cache import cached_latest
from .filters import make_filters
from .restore import restore_detail
from .settings import HALO, RESTORE
from .spectra import is_encoded

if TYPE_CHECKING:
    from ..rendering.plan import Part, RenderPlan

__all__ = ["draw_changed_detail", "draw_detail"]


def draw_detail(
    plan: RenderPlan, pixels: NDArray[Any], corner: tuple[int, int], part: Part
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """As `RenderPlan.draw`, (rows, columns, C) float32."""
    wide = left, top, _, _ = plan.expand_part(part, HALO)
    shape = wide[3] - top, wide[2] - left, pixels.shape[2]
    image, valid = plan.blend_part(pixels, corner, wide, allocate_pooled(shape, np.float32))
    image = _restore(plan, pixels, wide, image, valid)
    inside = slice(part[1] - top, part[3] - top), slice(part[0] - left, part[2] - left)
    return np.ascontiguousarray(image[inside]), np.ascontiguousarray(valid[inside])


def draw_changed_detail(
    plan: RenderPlan, pixels: NDArray[Any], wanted: NDArray[np.bool_], valid: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Draw what depends on the `wanted` pixels (rows, columns), and bring `valid` up to date.

    Returns
    -------
    image : (rows, columns, C) float32
    changed : (rows, columns) bool
        Where it is drawn.
    """
    import cv2

    around = np.ones((2 * HALO + 1,) * 2, np.uint8)
    changed = cv2.dilate(wanted.view(np.uint8), around)
    needed = cv2.dilate(changed, around).view(bool)
    whole = 0, 0, *plan.size
    image = np.zeros((*valid.shape, pixels.shape[2]), np.float32)
    plan.blend_part(pixels, (0, 0), whole, image, valid, needed)
    return _restore(plan, pixels, whole, image, valid), changed.view(bool)


def _restore(
    plan: RenderPlan, pixels: NDArray[Any], part: Part, image: NDArray[np.float32], valid: NDArray[np.bool_]
) -> NDArray[np.float32]:
    assert plan.defocus is not None
    pitch, channels, defocus = plan.calibration.lattice.pitch, image.shape[2], plan.defocus
    sizes = plan.surface.patch_size
    depths = float(sizes.min()), float(sizes.max())
    key = channels, plan.scale, plan.reach, plan.blur, depths
    filters = cached_latest(
        defocus, "filters", key,
        lambda: make_filters(defocus, plan.calibration, plan.scale, plan.reach, plan.blur, channels, depths),
    )  # fmt: skip
    first, (left, top, right, bottom) = plan.affine[:, 2], part
    x, y = (first[k] + plan.spacing * np.arange(*ends) for k, ends in enumerate(((left, right), (top, bottom))))
    shown = nearest_patch_size(plan.surface, x, y)
    white, encoded = white_level(pixels, plan.calibration), is_encoded(pixels.dtype, plan.calibration)
    return restore_detail(image, valid, shown, filters, white, encoded, pitch, plan_border(plan, part))


def plan_border(plan: RenderPlan, part: Part) -> NDArray[np.float32]:
    """(rows, columns) of a part of the picture: 0 at the border of the whole, where few lenses are averaged, else 1."""
    columns, rows = plan.size
    beside = [
        np.minimum(np.arange(low, high) + 0.5, total - 0.5 - np.arange(low, high)) / (RESTORE.border * plan.scale) - 1
        for low, high, total in ((part[1], part[3], rows), (part[0], part[2], columns))
    ]
    across, along = (np.clip(one, 0, 1).astype(np.float32) for one in beside)
    return np.minimum(across[:, None], along)
