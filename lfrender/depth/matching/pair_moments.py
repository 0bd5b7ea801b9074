"""Sums over the pixels that two microimages share at a shift, from which their correlation follows.

Which pixels count is looked up for most shifts; small overlaps, and lenses at the border of the flat, are tested pixel
by pixel.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST

from ...flat.microimages import overlap_range

__all__ = ["fill_mask", "match_cost", "strip_moments"]


@njit(error_model="numpy", inline="always")
def match_cost(count, sa, sb, squares, srr, difference, pixels, floor, half_weight, doubt):
    """Cost of a pair, one less its weighted correlation, from sums over the `count` pixels that it shares.

    Those of both, of the squares of both, and of the squares of their difference; `difference` is added to that of the
    means, `floor` is the variance of noise and shading, `doubt` the share taken off the weight of that many `pixels`.
    """
    one = np.float32(1.0)
    inverse = one / count
    ma, mb = sa * inverse, sb * inverse
    variance = squares * inverse - ma * ma - mb * mb
    residual = srr * inverse - (ma - mb) * (ma - mb)
    # Means count by half: gains differ a little, but on a smooth slope only means show depth.
    offset = np.float32(0.5) * (ma - mb + difference) * (ma - mb + difference)
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
def _mask_discs(columns, lines, start, count, discs, box, radius2, out):
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
def fill_mask(dx, dy, middle, other, discs, radius2, columns, lines, layout, size, out):
    """Fill `out` with a mask of the pixels of a strip that have a partner in another, `dx, dy` pixels away.

    Returns their number, the first position and the number of those to read, and how many values later in a strip
    follow the partner and the pixel below it.
    """
    half, width, rows, step, bunch = layout
    none, count = np.int32(0), np.float32(0.0)
    first, number = overlap_range(dx, dy, half, width, step, bunch)
    if number > 0:
        # Interpolation reads one pixel beyond, and both microimages end at the border of the flat.
        (x, y), (far_x, far_y), (height, across) = middle, other, size
        box = (
            np.float32(max(-half - dx, -x, -far_x - dx)), np.float32(max(-half - dy, -y, -far_y - dy)),
            np.float32(min(across - 1 - x, across - 2 - far_x - dx)),
            np.float32(min(height - 1 - y, height - 2 - far_y - dy)),
        )  # fmt: skip
        count = _mask_discs(columns, lines, first, number, discs, box, radius2, out)
    upper = ((dy % step) * rows + dy // step) * width + dx
    lower = (((dy + 1) % step) * rows + (dy + 1) // step) * width + dx
    return count, np.int32(first), np.int32(max(number, none)), np.int32(upper), np.int32(lower)
