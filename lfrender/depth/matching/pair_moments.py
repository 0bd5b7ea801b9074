"""Sums over the pixels that two microimages share at a shift, from which their correlation follows.

Which pixels count is looked up for most shifts; small overlaps, and lenses at the border of the flat, are tested pixel
by pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST

from ...flat.gray_flat import GrayFlat
from ...flat.microimages import VECTOR_LENGTH, OverlapMasks, Strips, overlap_range
from .settings import COST

__all__ = ["PairTerms", "StripTable", "match_cost", "shared_pixels", "strip_moments", "strip_table"]


class PairTerms(NamedTuple):
    """What the cost of a pair depends on besides its pixels, as kernels take it.

    Centres (n, 2) [px], radius and pitch [px], means (n,) [white = 1], share of a match at zero that may be shading
    (n,), variance of the noise, shading [share of the mean], and overlap with half weight [px^2].
    """

    centres: NDArray[np.float32]
    radius: np.float32
    pitch: np.float32
    means: NDArray[np.float32]
    doubts: NDArray[np.float32]
    noise2: np.float32
    shading: np.float32
    half_weight: np.float32


class StripTable(NamedTuple):
    """Microimages as `Strips` and the masks of the pixels that two of them share, as kernels take them."""

    values: NDArray[np.float32]
    middle: NDArray[np.int32]
    whole: NDArray[np.bool_]
    columns: NDArray[np.float32]
    lines: NDArray[np.float32]
    slots: NDArray[np.int32]
    masks: NDArray[np.float32]
    ends: NDArray[np.int32]
    counts: NDArray[np.int32]
    # Pixels from the middle to the sides, from row to row, rows of a part, parts, and vector length; size of the flat.
    layout: tuple[int, int, int, int, int]
    height: int
    across: int


def strip_table(strips: Strips, masks: OverlapMasks, gray: GrayFlat) -> StripTable:
    """Strips and masks as kernels take them."""
    slots, pixels, ends, counts = masks
    layout = strips.half_width, strips.width, strips.rows, strips.step, VECTOR_LENGTH
    return StripTable(
        strips.values, strips.centre_pixels, strips.complete, *strips.offsets, slots, pixels, ends, counts, layout,
        *gray.image.shape,
    )  # fmt: skip


@njit(error_model="numpy", inline="always")
def match_cost(count, sa, sb, squares, srr, difference, pixels, floor, half_weight, doubt):
    """Cost of a pair, one less its weighted correlation, from sums over the `count` pixels that it shares.

    Those of both microimages, of the squares of both, and of the squares of their difference; `difference` is what is
    to be added to that of the means, `floor` the variance of noise and shading, `doubt` the share taken off the weight
    of that many `pixels`.
    """
    one = np.float32(1.0)
    inverse = one / count
    ma, mb = sa * inverse, sb * inverse
    variance = squares * inverse - ma * ma - mb * mb
    residual = srr * inverse - (ma - mb) * (ma - mb)
    offset = COST.offset_weight * (ma - mb + difference) * (ma - mb + difference)
    quality = (residual + offset + floor) / (variance + offset + floor)
    return one - pixels / (pixels + half_weight) * (one - doubt) * (one - quality)


# The error model of NumPy, because Python's checks every division, which prevents vector loops. Indices are unsigned,
# because signed ones are checked for counting from the end.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def strip_moments(strips, own, other, upper, lower, masks, mask, count, weights):
    """Sums over the masked pixels of one strip and the interpolated ones of another, `upper` and `lower` values on: of
    both, of the squares of both, and of those of their difference."""
    one = np.uint64(1)
    above, below = np.uint64(other + upper), np.uint64(other + lower)
    a, m = np.uint64(own), np.uint64(mask)
    w00, w01, w10, w11 = weights
    sa = sb = squares = srr = np.float32(0.0)
    for k in range(np.uint64(count)):
        b = w00 * strips[above + k] + w01 * strips[above + one + k]
        b += w10 * strips[below + k] + w11 * strips[below + one + k]
        b *= masks[m + k]
        c = masks[m + k] * strips[a + k]
        sa += c
        sb += b
        squares += c * c + b * b
        srr += (c - b) * (c - b)
    return sa, sb, squares, srr


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _fill_mask(columns, lines, start, count, discs, box, radius2, out):
    """Mask the pixels of a strip from `start` on that lie in both discs, at `ax, ay, bx, by` from its middle, and in a
    box; how many do."""
    ax, ay, bx, by = discs
    low_x, low_y, high_x, high_y = box
    first, number = np.uint64(start), np.float32(0.0)
    for k in range(np.uint64(count)):
        x, y = columns[first + k], lines[first + k]
        a2, b2 = (x - ax) * (x - ax) + (y - ay) * (y - ay), (x - bx) * (x - bx) + (y - by) * (y - by)
        inside = (max(a2, b2) <= radius2) & (x >= low_x) & (y >= low_y) & (x <= high_x) & (y <= high_y)
        out[k] = np.float32(1.0) if inside else np.float32(0.0)
        number += out[k]
    return number


@njit(error_model="numpy", inline="always")
def shared_pixels(
    dx, dy, whole, middle, other, discs, radius2, slots, ends, counts, columns, lines, layout, size, own_mask
):
    """Which pixels of a strip have a partner in another, `dx, dy` pixels away: their number, the row of the masks that
    tells them or -1, the first position and the number of those to read, and how many values later in a strip follow
    the partner and the pixel below it.

    If there is no such row `own_mask` is filled: for lenses that are not `whole`, and for small overlaps. `middle` and
    `other` are the pixels in the middle of both, `columns` and `lines` the offsets of others, `size` that of the flat.
    """
    half, width, rows, step, bunch = layout
    none = np.int32(0)
    reach = len(slots) // 2
    if whole and abs(dx) <= reach and abs(dy) <= reach:
        slot = slots[dy + reach, dx + reach]
        if slot >= 0 and counts[slot] * step > COST.min_overlap * radius2:
            return np.float32(counts[slot]), slot, ends[slot, 0], ends[slot, 1], ends[slot, 2], ends[slot, 3]
    first, number = overlap_range(dx, dy, half, width, step, bunch)
    if number <= 0:
        return np.float32(0.0), np.int32(-1), none, none, none, none
    # Interpolation reads one pixel beyond, and both microimages end at the border of the flat.
    (x, y), (far_x, far_y), (height, across) = middle, other, size
    box = (
        np.float32(max(-half - dx, -x, -far_x - dx)), np.float32(max(-half - dy, -y, -far_y - dy)),
        np.float32(min(across - 1 - x, across - 2 - far_x - dx)),
        np.float32(min(height - 1 - y, height - 2 - far_y - dy)),
    )  # fmt: skip
    count = _fill_mask(columns, lines, first, number, discs, box, radius2, own_mask)
    upper = ((dy % step) * rows + dy // step) * width + dx
    lower = (((dy + 1) % step) * rows + (dy + 1) // step) * width + dx
    return count, np.int32(-1), np.int32(first), np.int32(number), np.int32(upper), np.int32(lower)
