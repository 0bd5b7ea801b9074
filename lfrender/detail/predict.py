"""The flat that a picture predicts: each pixel shows a place of it, blurred by the lens at the depth there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfcal.runtime.kernels.jit import kernel

from .defocus import Defocus
from .settings import RESTORE, SolveSettings

if TYPE_CHECKING:
    from ..rendering.plan import Part, RenderPlan

__all__ = ["FlatModel", "convolve", "point_spread"]

# Rows of the flat whose places are found at a time, and sides of the squares that are blurred at a time [px].
_BAND = 256
_TILE = 64
# `remap` takes no longer lines.
_LINE = 4096


@dataclass(frozen=True)
class FlatModel:
    """How the pixels of a part of a flat see a part of a picture.

    Parameters
    ----------
    columns, rows : (h, w) float32 [px of the picture]
        Where the place lies that each pixel shows.
    kinds : (h, w) int8
        Type of the pixel's lens.
    levels, shares : (rows, columns) int64, float32
        Of each pixel of the picture, the depth up to which it is blurred, and how near it is to the next.
    kernels : tuple of dicts
        By type, then by level.
    """

    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    kinds: NDArray[np.int8]
    levels: NDArray[np.int64]
    shares: NDArray[np.float32]
    kernels: tuple[dict[int, NDArray[np.float32]], ...]

    @classmethod
    def make(
        cls,
        plan: RenderPlan,
        defocus: Defocus,
        sizes: NDArray[np.float32],
        part: Part,
        corner: tuple[int, int],
        shape: tuple[int, ...],
        settings: SolveSettings,
    ) -> FlatModel:
        """Of pixels of this shape from `corner` on, and a part of the picture whose patch sizes are `sizes`."""
        columns, rows, kinds = _seen_places(plan, sizes, part, corner, shape)
        levels, shares, kernels = _blurs(plan, defocus, sizes, settings)
        return cls(columns, rows, kinds, levels, shares, kernels)

    def predict(self, picture: NDArray[np.float32], encoded: bool, dtype: DTypeLike) -> NDArray[Any]:
        """(h, w, C) pixels of the flat that shows a picture (rows, columns, C)."""
        light = np.maximum(picture, 0) ** 2 if encoded else picture
        out = np.zeros((*self.kinds.shape, picture.shape[2]), dtype)
        for kind, kernels in enumerate(self.kernels):
            own = slice(None) if len(self.kernels) == 1 else self.kinds == kind
            shown = _sample(self._blur(light, kernels), self.columns[own].ravel(), self.rows[own].ravel())
            if encoded:
                np.sqrt(np.maximum(shown, 0, out=shown), out=shown)
            if out.dtype.kind in "ui":
                np.clip(np.rint(shown, out=shown), 0, np.iinfo(out.dtype).max, out=shown)
            out[own] = shown.reshape(out[own].shape)
        return out

    def _blur(self, picture: NDArray[np.float32], kernels: dict[int, NDArray[np.float32]]) -> NDArray[np.float32]:
        """A picture as lenses of one type and the pixels of the flat see it, at the depth of each place."""
        margin = max(len(kernel) for kernel in kernels.values()) // 2
        wide = np.pad(picture, ((margin, margin), (margin, margin), (0, 0)), "edge")
        out = np.empty_like(picture)
        for top in range(0, len(picture), _TILE):
            for left in range(0, picture.shape[1], _TILE):
                tile = slice(top, top + _TILE), slice(left, left + _TILE)
                around = wide[top : top + _TILE + 2 * margin, left : left + _TILE + 2 * margin]
                levels, share, into = self.levels[tile], self.shares[tile][..., None], out[tile]
                blurred: dict[int, NDArray[np.float32]] = {}
                for n in np.unique(levels).tolist():
                    for k in {n, n + 1} - blurred.keys():
                        spare = margin - len(kernels[k]) // 2
                        inner = slice(spare, len(around) - spare), slice(spare, around.shape[1] - spare)
                        blurred[k] = convolve(around[inner], kernels[k])
                    mixed = (1 - share) * blurred[n] + share * blurred[n + 1]
                    np.copyto(into, mixed, where=(levels == n)[..., None])
        return out


def _sample(
    picture: NDArray[np.float32], columns: NDArray[np.float32], rows: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(n, C) values of a picture (rows, columns, C) between its pixels."""
    import cv2

    lines = -(-len(columns) // _LINE)
    u, v = (np.resize(at, (lines, _LINE)) for at in (columns, rows))
    shown = cv2.remap(picture, u, v, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(shown.reshape(lines * _LINE, -1)[: len(columns)], np.float32)


def _blurs(
    plan: RenderPlan, defocus: Defocus, sizes: NDArray[np.float32], settings: SolveSettings
) -> tuple[NDArray[np.int64], NDArray[np.float32], tuple[dict[int, NDArray[np.float32]], ...]]:
    """Levels, shares and kernels of a `FlatModel`. Levels are those of the whole, for any part."""
    pitch = plan.calibration.lattice.pitch
    ratios = np.geomspace(RESTORE.least_ratio, RESTORE.largest_ratio, settings.levels)
    step = np.log(ratios[1] / ratios[0])
    at = np.log(np.clip(np.abs(sizes) / pitch, ratios[0], ratios[-1]) / ratios[0]) / step
    low = np.minimum(at.astype(np.int64), len(ratios) - 2)
    shares = (at - low).astype(np.float32)
    levels = np.where(sizes < 0, low, low + len(ratios))
    kernels: tuple[dict[int, NDArray[np.float32]], ...] = tuple({} for _ in defocus.discs)
    needed = np.unique(levels)
    for level in np.union1d(needed, needed + 1).tolist():
        sign, ratio = (-1 if level < len(ratios) else 1), float(ratios[level % len(ratios)])
        grown = plan.scale / (ratio * pitch)
        # A pixel of the picture is a mean over its own square.
        side = float(np.sqrt(max(grown**2 - 1, 0.0)))
        for own, disc in zip(kernels, defocus.diameters(sign * ratio), strict=True):
            own[level] = point_spread(float(disc) * grown, side)
    return levels, shares, kernels


def point_spread(disc: float, pixel: float) -> NDArray[np.float32]:
    """Kernel of a disc of this diameter, averaged over a square of this side [px]."""
    finer, half = 9, int(np.ceil((disc + pixel) / 2))
    wide = (2 * half + 1) * finer
    at = (np.arange(wide) - (wide - 1) / 2) / finer
    kernel = (np.hypot(at[:, None], at) <= max(disc / 2, 0.6 / finer)).astype(np.float64)
    box = np.ones(max(1, round(pixel * finer)))
    for _ in range(2):
        kernel = np.stack([np.convolve(row, box, "same") for row in kernel]).T
    kernel = kernel.reshape(2 * half + 1, finer, 2 * half + 1, finer).sum((1, 3))
    return np.asarray(kernel / kernel.sum(), np.float32)


def convolve(image: NDArray[np.float32], kernel: NDArray[np.float32]) -> NDArray[np.float32]:
    """A picture (h, w, C) convolved with a symmetric kernel of odd sides, which is that much smaller."""
    margin, (height, width, channels) = len(kernel) - 1, image.shape
    out = np.empty((height - margin, (width - margin) * channels), np.float32)
    _convolve(np.ascontiguousarray(image).reshape(height, -1), np.ascontiguousarray(kernel), channels, out)
    return out.reshape(height - margin, width - margin, channels)


# Without fastmath: a part of a picture gets the same bits as the whole, whatever pixels a vector loop takes together.
@kernel(share=lambda image, kernel, channels, out: len(out))
def _convolve(begin, end, image, kernel, channels, out):
    """Sum of the rows of `image`, moved by as much and times as much as the kernel tells."""
    for y in range(begin, end):
        into = out[y]
        into[:] = 0
        for j in range(kernel.shape[0]):
            row = image[y + j]
            for i in range(kernel.shape[1]):
                weight, moved = kernel[j, i], row[i * channels :]
                if weight != 0:
                    for k in range(len(into)):
                        into[k] += weight * moved[k]


def _seen_places(
    plan: RenderPlan, sizes: NDArray[np.float32], part: Part, corner: tuple[int, int], shape: tuple[int, ...]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int8]]:
    """Columns, rows and types of a `FlatModel`."""
    lattice, types = plan.calibration.lattice, plan.calibration.lens_types
    height, width = shape[:2]
    u, v = np.empty((2, height, width), np.float32)
    kinds = np.zeros((height, width), np.int8)
    numbers = np.array([lattice.pitch, *plan.affine[:, 2], plan.spacing, *part[:2]], float)
    across = np.arange(corner[0], corner[0] + width, dtype=float)
    for top in range(0, height, _BAND):
        band = slice(top, min(top + _BAND, height))
        down = np.arange(band.start, band.stop, dtype=float) + corner[1]
        pixels = np.stack(np.meshgrid(across, down), -1)
        index = lattice.to_index(pixels.reshape(-1, 2)).reshape(pixels.shape)
        first = np.floor(index.min((0, 1))).astype(np.int64)
        counts = np.floor(index.max((0, 1))).astype(np.int64) + 2 - first
        lenses = first + np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1)
        centres = lattice.points(lenses.reshape(-1, 2))
        starts = plan.surface.at(centres).reshape(counts)
        own = np.zeros(counts, np.int8) if types is None else types.of(lenses.reshape(-1, 2)).reshape(counts)
        places = pixels, index - first, centres.reshape(*counts, 2), starts, own
        _find_places(*places, sizes, numbers, u[band], v[band], kinds[band])
    return u, v, kinds


@kernel(share=lambda pixels, *_: len(pixels))
def _find_places(begin, end, pixels, index, centres, starts, types, sizes, numbers, columns, rows, kinds):
    """Place of the picture that each pixel shows through the nearest lens, at the patch size that is found there."""
    pitch, left, top, spacing, first_column, first_row = numbers
    height, width = sizes.shape
    for y in range(begin, end):
        for x in range(pixels.shape[1]):
            px, py = pixels[y, x, 0], pixels[y, x, 1]
            low_i, low_j = int(index[y, x, 0]), int(index[y, x, 1])
            near_i, near_j, least = low_i, low_j, np.inf
            for i in range(low_i, low_i + 2):
                for j in range(low_j, low_j + 2):
                    distance = (px - centres[i, j, 0]) ** 2 + (py - centres[i, j, 1]) ** 2
                    if distance < least:
                        near_i, near_j, least = i, j, distance
            cx, cy = centres[near_i, near_j, 0], centres[near_i, near_j, 1]
            size = starts[near_i, near_j]
            u = v = 0.0
            for _ in range(3):
                grow = pitch / (size if size != 0 else np.float32(1e-3))
                # In 32nds, as `remap` rounds them, before the part begins at zero: all parts get the same.
                u = np.floor((cx - (px - cx) * grow - left) / spacing * 32 + 0.5) / 32 - first_column
                v = np.floor((cy - (py - cy) * grow - top) / spacing * 32 + 0.5) / 32 - first_row
                u, v = min(max(u, -1e4), 1e5), min(max(v, -1e4), 1e5)
                column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
                size = sizes[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
            columns[y, x], rows[y, x], kinds[y, x] = u, v, types[near_i, near_j]
