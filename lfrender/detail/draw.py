"""Pictures with their detail restored: any part is blended with a margin around it, and gets the bits of the whole."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfcal.runtime.kernels.jit import kernel

from ..flat.gray_flat import white_level
from ..runtime.buffers import allocate_pooled
from ..runtime.cache import cached
from .filters import DetailFilters, make_filters
from .noise import is_encoded
from .restore import Places, restore_detail
from .settings import HALO, RESTORE

if TYPE_CHECKING:
    from ..rendering.plan import Part, RenderPlan

__all__ = ["draw_changed_detail", "draw_detail"]


def draw_detail(
    plan: RenderPlan, pixels: NDArray[Any], corner: tuple[int, int], part: Part, dtype: DTypeLike
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """As `RenderPlan.draw`, (rows, columns, C) of this type."""
    wide = left, top, _, _ = plan.expand_part(part, HALO)
    shape = wide[3] - top, wide[2] - left, pixels.shape[2]
    image, valid = plan.blend_part(pixels, corner, wide, allocate_pooled(shape, np.float32))
    image = _restore(plan, pixels, wide, image, valid, dtype)
    inside = slice(part[1] - top, part[3] - top), slice(part[0] - left, part[2] - left)
    return np.ascontiguousarray(image[inside]), np.ascontiguousarray(valid[inside])


def draw_changed_detail(
    plan: RenderPlan, pixels: NDArray[Any], wanted: NDArray[np.bool_], valid: NDArray[np.bool_]
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Draw what depends on the `wanted` pixels (rows, columns), and bring `valid` up to date.

    Returns
    -------
    image : (rows, columns, C), of the type of `pixels`
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
    return _restore(plan, pixels, whole, image, valid, pixels.dtype), changed.view(bool)


def _restore(
    plan: RenderPlan,
    pixels: NDArray[Any],
    part: Part,
    image: NDArray[np.float32],
    valid: NDArray[np.bool_],
    dtype: DTypeLike,
) -> NDArray[Any]:
    filters, kinds = cached(plan, "detail", lambda: _prepare(plan))
    surface, first = plan.surface, plan.affine[:, 2]
    nearest, inner = [], []
    for k in (0, 1):
        at = np.arange(part[k], part[k + 2])
        scene = first[k] + plan.spacing * at
        node = np.rint((scene - surface.first[k]) / surface.spacing).astype(np.int64)
        nearest.append(np.clip(node, 0, kinds.shape[1 - k] - 1))
        # 0 at the border of the whole, where few lenses are averaged.
        inside = np.minimum(at + 0.5, plan.size[k] - 0.5 - at) / (RESTORE.border * plan.scale) - 1
        inner.append(np.clip(inside, 0, 1).astype(np.float32))
    places = Places(kinds, nearest[1], nearest[0], inner[1], inner[0])
    white, encoded = white_level(pixels, plan.calibration), is_encoded(pixels.dtype, plan.calibration)
    return restore_detail(image, valid, places, filters, white, encoded, dtype)


def _prepare(plan: RenderPlan) -> tuple[DetailFilters, NDArray[np.uint16]]:
    """The filters of a picture, and which of them each value of its surface takes: none beside a depth edge."""
    import cv2

    assert plan.noise is not None
    pitch, sizes = plan.calibration.lattice.pitch, plan.surface.patch_size
    depths = float(sizes.min()), float(sizes.max())
    filters = make_filters(plan.calibration, plan.noise, plan.scale, plan.reach, plan.blur, depths)
    side = 2 * max(1, round(RESTORE.beside_edge * plan.spacing / plan.surface.spacing)) + 1
    around = np.ones((side, side), np.uint8)
    kinds = np.empty(sizes.shape, np.uint16)
    ends = cv2.erode(sizes, around), cv2.dilate(sizes, around)
    _choose(sizes, *ends, np.float32(RESTORE.edge * pitch), np.float32(filters.per_ratio / pitch), filters.count, kinds)
    return filters, kinds


@kernel(share=lambda sizes, *_: len(sizes))
def _choose(begin, end, sizes, lowest, highest, edge, per_size, count, out):
    """Index of the filter of each patch size, of `count`: negative ones from zero, positive ones, none at an edge."""
    each, half = count // 2, np.float32(0.5)
    last = np.float32(each - 1)
    for y in range(begin, end):
        for x in range(sizes.shape[1]):
            size = sizes[y, x]
            at = np.uint16(min(abs(size) * per_size, last) + half)
            kind = at + np.uint16(each) if size > 0 else at
            out[y, x] = kind if highest[y, x] - lowest[y, x] <= edge else np.uint16(count)
