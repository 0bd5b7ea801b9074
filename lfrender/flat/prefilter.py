"""Prefilter for bilinear interpolation: sharpen a flat by as much as interpolation will blur it on average.

Bilinear interpolation at a random place averages the flat with a triangle whose variance is 0 px^2 at whole pixels and
1/6 px^2 on average. Half of that, times the negative second difference, gives it back. Where a picture is the mean of
many lenses and places, it has the sharpness of the flat itself then.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import kernel

from ..runtime.buffers import allocate_scratch

__all__ = ["prefilter_flat", "prefilter_packed"]


def prefilter_flat(pixels: NDArray) -> NDArray:
    """The flat sharpened by `p - (sum of the four neighbours - 4 p) / 12`.

    Parameters
    ----------
    pixels : (H, W, C) uint8, uint16 or float32

    Returns
    -------
    array of the same shape and type
        Integers are rounded, and clipped to their range.
    """
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1)
    out = np.empty_like(rows)
    if rows.dtype.kind == "f":
        _filter_floats(rows, pixels.shape[2], out)
    elif rows.dtype == np.uint8:
        _filter_bytes(rows, pixels.shape[2], out)
    else:
        _filter_shorts(rows, pixels.shape[2], np.float32(np.iinfo(rows.dtype).max), out)
    return out.reshape(pixels.shape)


# Without fastmath: a part of a flat gets the same bits as the whole, whatever pixels a vector loop handles together.
@kernel(error_model="numpy", share=lambda flat, *_: len(flat))
def _filter_floats(begin, end, flat, channels, out):
    height, width = flat.shape
    middle, side = np.float32(1 + 4 * (1 / 12)), np.float32(1 / 12)
    for y in range(begin, end):
        above, here, below = flat[max(y - 1, 0)], flat[y], flat[min(y + 1, height - 1)]
        into = out[y]
        n = width - 2 * channels
        before, own, after = here[: max(n, 0)], here[channels:], here[2 * channels :]
        up, down, target = above[channels:], below[channels:], into[channels:]
        for k in range(n):
            target[k] = middle * own[k] - side * ((before[k] + after[k]) + (up[k] + down[k]))
        for edge in range(min(2 * channels, width)):
            k = edge if edge < channels else width - 2 * channels + edge
            left, right = here[k - channels if k >= channels else k], here[k + channels if k < width - channels else k]
            into[k] = middle * here[k] - side * ((left + right) + (above[k] + below[k]))


@njit
def _filter_row_of_shorts(flat, y, channels, highest, into):
    """One row, rounded: sixteen twelfths of a pixel minus one twelfth of each neighbour, plus a half.

    Twelve times the result is a whole number that single precision holds exactly, and the constant 1/12 is rounded up
    there, so that truncating the product is integer division; a vector holds more of these than of integers.
    """
    height, width = flat.shape
    sixteen, six, zero, twelfth = np.float32(16), np.float32(6), np.float32(0), np.float32(1 / 12)
    above, here, below = flat[max(y - 1, 0)], flat[y], flat[min(y + 1, height - 1)]
    n = width - 2 * channels
    before, own, after = here[: max(n, 0)], here[channels:], here[2 * channels :]
    up, down, target = above[channels:], below[channels:], into[channels:]
    for k in range(n):
        sides = (np.float32(before[k]) + np.float32(after[k])) + (np.float32(up[k]) + np.float32(down[k]))
        target[k] = min(max(np.float32(own[k]) * sixteen - sides + six, zero) * twelfth, highest)
    for end in range(min(2 * channels, width)):
        k = end if end < channels else width - 2 * channels + end
        left, right = here[k - channels if k >= channels else k], here[k + channels if k < width - channels else k]
        sides = (np.float32(left) + np.float32(right)) + (np.float32(above[k]) + np.float32(below[k]))
        into[k] = min(max(np.float32(here[k]) * sixteen - sides + six, zero) * twelfth, highest)


@kernel(share=lambda flat, *_: len(flat))
def _filter_shorts(begin, end, flat, channels, highest, out):
    for y in range(begin, end):
        _filter_row_of_shorts(flat, y, channels, highest, out[y])


@njit
def _filter_row_of_bytes(flat, y, channels, line, into):
    """`_filter_row_of_shorts` for bytes; a line between two loops keeps them to 16 bits, of which a vector holds
    more."""
    height, width = flat.shape
    above, here, below = flat[max(y - 1, 0)], flat[y], flat[min(y + 1, height - 1)]
    n = max(width - 2 * channels, 0)
    before, own, after = here[:n], here[channels:], here[2 * channels :]
    up, down = above[channels:], below[channels:]
    middle = line[channels:]
    for k in range(n):
        middle[k] = np.int16(own[k]) * 16 + 6 - before[k] - after[k] - up[k] - down[k]
    for end in range(min(2 * channels, width)):
        k = end if end < channels else width - 2 * channels + end
        left, right = here[k - channels if k >= channels else k], here[k + channels if k < width - channels else k]
        line[k] = np.int16(here[k]) * 16 + 6 - left - right - above[k] - below[k]
    for k in range(width):
        # 5462 / 65536 is a twelfth, rounded up by less than counts below 4096.
        value = min(max(line[k], np.int16(0)), np.int16(12 * 255 + 11))
        into[k] = np.uint8((np.uint32(value) * np.uint32(5462)) >> np.uint32(16))


@kernel(share=lambda flat, *_: len(flat))
def _filter_bytes(begin, end, flat, channels, out):
    for y in range(begin, end):
        _filter_row_of_bytes(flat, y, channels, np.empty(flat.shape[1], np.int16), out[y])


@njit
def _pack_row(row, channels, into):
    """Put the channels of each pixel of a row into one number, the first lowest."""
    kind = into.dtype.type
    if channels == 3:
        for x in range(len(into)):
            at = np.uint64(3) * np.uint64(x)
            pixel = kind(row[at]) | (kind(row[at + np.uint64(1)]) << kind(8 * row.itemsize))
            into[x] = pixel | (kind(row[at + np.uint64(2)]) << kind(16 * row.itemsize))
    else:
        for x in range(len(into)):
            pixel = kind(0)
            for c in range(channels):
                pixel |= kind(row[x * channels + c]) << kind(8 * row.itemsize * c)
            into[x] = pixel


@kernel(share=lambda flat, *_: len(flat))
def _filter_and_pack_bytes(begin, end, flat, channels, out):
    for y in range(begin, end):
        row = np.empty(flat.shape[1], np.uint8)
        _filter_row_of_bytes(flat, y, channels, np.empty(flat.shape[1], np.int16), row)
        _pack_row(row, channels, out[y])


@kernel(share=lambda flat, *_: len(flat))
def _filter_and_pack_shorts(begin, end, flat, channels, highest, out):
    for y in range(begin, end):
        row = np.empty(flat.shape[1], np.uint16)
        _filter_row_of_shorts(flat, y, channels, highest, row)
        _pack_row(row, channels, out[y])


def prefilter_packed(pixels: NDArray[np.uint8 | np.uint16]) -> NDArray[np.uint32 | np.uint64]:
    """`prefilter_flat` with the channels of each pixel in one number, the first lowest: one read gets them all.

    Returns
    -------
    (H, W) uint32 for bytes, uint64 for shorts
        Scratch memory, which the next call overwrites; at most four channels.
    """
    rows, channels = np.ascontiguousarray(pixels).reshape(len(pixels), -1), pixels.shape[2]
    if pixels.dtype == np.uint8:
        out = allocate_scratch("packed", pixels.shape[:2], np.uint32)
        _filter_and_pack_bytes(rows, channels, out)
    else:
        out = allocate_scratch("packed shorts", pixels.shape[:2], np.uint64)
        _filter_and_pack_shorts(rows, channels, np.float32(np.iinfo(pixels.dtype).max), out)
    return out
