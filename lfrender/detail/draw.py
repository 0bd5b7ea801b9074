"""Pictures with their detail restored: any part is blended with a margin around it, and gets the bits of the whole."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfcal import Calibration
from lfcal.runtime.kernels import kernel

from ..data.rendering import Part, PictureGrid
from ..data.surface import Surface
from ..flat.gray_flat import white_level
from .filters import DetailFilters, make_filters
from .noise import is_encoded
from .restore import Places, restore_detail
from .settings import HALO, RESTORE

__all__ = ["DetailRenderer", "PlainRenderer"]


class PlainRenderer(Protocol):
    """What draws the picture whose detail is restored."""

    @property
    def calibration(self) -> Calibration: ...
    @property
    def surface(self) -> Surface: ...
    @property
    def reach(self) -> float: ...
    @property
    def blur(self) -> float: ...
    @property
    def grid(self) -> PictureGrid: ...
    def required_part(self, part: Part) -> Part: ...
    def draw(
        self, pixels: NDArray[Any], corner: tuple[int, int], part: Part
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]: ...


@dataclass(frozen=True)
class DetailRenderer:
    """Draws as another renderer, and restores the detail.

    Parameters
    ----------
    plain : PlainRenderer
    noise : float [white]
        Of the flat, as `measure_noise`.
    """

    plain: PlainRenderer
    noise: float

    @property
    def grid(self) -> PictureGrid:
        """Where the pixels of the picture lie."""
        return self.plain.grid

    def required_part(self, part: Part) -> Part:
        """The part of the flat that a part of the picture is drawn from."""
        return self.plain.required_part(self.grid.expand(part, HALO))

    def draw(
        self,
        pixels: NDArray[Any],
        corner: tuple[int, int] = (0, 0),
        part: Part | None = None,
        dtype: DTypeLike = np.float32,
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Draw a part of the picture, (rows, columns, C) of this type, and which pixels some lens shows."""
        part = part or self.grid.whole
        wide = left, top, _, _ = self.grid.expand(part, HALO)
        image, valid = self.plain.draw(pixels, corner, wide)
        white, encoded = white_level(pixels, self.plain.calibration), is_encoded(pixels.dtype, self.plain.calibration)
        image = restore_detail(image, valid, self._places(wide), self._filters[0], white, encoded, dtype)
        inside = slice(part[1] - top, part[3] - top), slice(part[0] - left, part[2] - left)
        return np.ascontiguousarray(image[inside]), np.ascontiguousarray(valid[inside])

    def _places(self, part: Part) -> Places:
        """Which filter each pixel of a part takes."""
        surface, grid, kinds = self.plain.surface, self.grid, self._filters[1]
        nearest = []
        for k in (0, 1):
            at = np.arange(part[k], part[k + 2])
            node = np.rint((grid.first + grid.spacing * at - surface.first[k]) / surface.spacing).astype(np.int64)
            nearest.append(np.clip(node, 0, kinds.shape[1 - k] - 1))
        return Places(kinds, nearest[1], nearest[0])

    @cached_property
    def _filters(self) -> tuple[DetailFilters, NDArray[np.uint16]]:
        """The filters of the picture, and which of them each value of its surface takes: none beside a depth edge."""
        import cv2

        plain, surface, grid = self.plain, self.plain.surface, self.grid
        sizes = surface.patch_size
        depths = float(sizes.min()), float(sizes.max())
        filters = make_filters(plain.calibration, self.noise, grid.scale, plain.reach, plain.blur, depths)
        side = 2 * max(1, round(RESTORE.beside_edge * grid.spacing / surface.spacing)) + 1
        around = np.ones((side, side), np.uint8)
        kinds = np.empty(sizes.shape, np.uint16)
        ends = cv2.erode(sizes, around), cv2.dilate(sizes, around)
        edge, per_size = np.float32(RESTORE.edge * grid.pitch), np.float32(filters.per_ratio / grid.pitch)
        _choose(sizes, *ends, edge, per_size, filters.count, kinds)
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
