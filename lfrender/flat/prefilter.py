"""Prefilter for bilinear interpolation: sharpen a flat by as much as interpolation will blur it on
average.

Bilinear interpolation at a random place averages the flat with a triangle whose variance is 0 px^2
at whole pixels and 1/6 px^2 on average. Half of that, times the negative second difference, gives
it back. Where a picture is the mean of many lenses and places, it has the sharpness of the flat
itself then.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import kernel

__all__ = ["pack_flat", "prefilter_flat"]


def prefilter_flat(pixels: NDArray) -> NDArray:
    """The flat (H, W, C) sharpened by `p - (sum of the four neighbours - 4 p) / 12`; integers are
    rounded and clipped.
    """
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1)
    out = np.empty(rows.shape, np.float32)
    _filter_floats(rows, pixels.shape[2], np.float32(1 / 12), out)
    if pixels.dtype.kind in "ui":
        out = np.clip(out + np.float32(0.5), 0, np.iinfo(pixels.dtype).max)
    return out.astype(pixels.dtype, copy=False).reshape(pixels.shape)


# Without fastmath: a part of a flat gets the same bits as the whole, whatever pixels a vector loop
# handles together.
@njit(error_model="numpy")
def _filter_row(flat, y, channels, into):
    """Sixteen times the pixels of a row less their four neighbours: twelve times what is wanted, in
    the type of `into`.

    Whole numbers of 16 bits in bytes, and of single precision in others, are exact.
    """
    kind = into.dtype.type
    height, width = flat.shape
    above = flat[max(y - 1, 0)]
    here = flat[y]
    below = flat[min(y + 1, height - 1)]
    n = max(width - 2 * channels, 0)
    before = here[:n]
    own = here[channels:]
    after = here[2 * channels :]
    up = above[channels:]
    down = below[channels:]
    middle = into[channels:]
    for k in range(n):
        middle[k] = (
            kind(own[k]) * kind(16)
            - (kind(before[k]) + kind(after[k]))
            - (kind(up[k]) + kind(down[k]))
        )
    for end in range(min(2 * channels, width)):
        k = end if end < channels else width - 2 * channels + end
        left = here[k - channels if k >= channels else k]
        right = here[k + channels if k < width - channels else k]
        into[k] = (
            kind(here[k]) * kind(16)
            - (kind(left) + kind(right))
            - (kind(above[k]) + kind(below[k]))
        )


@kernel(error_model="numpy", share=lambda flat, *_: len(flat))
def _filter_floats(begin, end, flat, channels, twelfth, out):
    for y in range(begin, end):
        _filter_row(flat, y, channels, out[y])
        for k in range(flat.shape[1]):
            out[y, k] *= twelfth


@njit
def _pack_row(row, channels, into):
    """Put the channels of each pixel of a row into one number, the first lowest."""
    kind = into.dtype.type
    bits = 8 * row.itemsize
    if channels == 3:
        # The compiler uses vector instructions for strides it knows.
        for x in range(len(into)):
            at = np.uint64(3) * np.uint64(x)
            pixel = kind(row[at]) | (kind(row[at + np.uint64(1)]) << kind(bits))
            into[x] = pixel | (kind(row[at + np.uint64(2)]) << kind(2 * bits))
    else:
        for x in range(len(into)):
            pixel = kind(0)
            for c in range(channels):
                pixel |= kind(row[x * channels + c]) << kind(bits * c)
            into[x] = pixel


@kernel(share=lambda flat, *_: len(flat))
def _pack(begin, end, flat, channels, out):
    for y in range(begin, end):
        _pack_row(flat[y], channels, out[y])


@kernel(share=lambda flat, *_: len(flat))
def _pack_bytes(begin, end, flat, channels, out):
    line = np.empty(flat.shape[1], np.int16)
    row = np.empty(flat.shape[1], np.uint8)
    for y in range(begin, end):
        _filter_row(flat, y, channels, line)
        for k in range(len(row)):
            # 5462 / 65536 is a twelfth, rounded up by less than counts below 4096.
            value = min(max(np.int16(line[k] + np.int16(6)), np.int16(0)), np.int16(12 * 255 + 11))
            row[k] = np.uint8((np.uint32(value) * np.uint32(5462)) >> np.uint32(16))
        _pack_row(row, channels, out[y])


@kernel(share=lambda flat, *_: len(flat))
def _pack_shorts(begin, end, flat, channels, out):
    line = np.empty(flat.shape[1], np.float32)
    row = np.empty(flat.shape[1], np.uint16)
    # The constant 1/12 is rounded up, so that truncating the product is integer division.
    six = np.float32(6)
    twelfth = np.float32(1 / 12)
    highest = np.float32(65535)
    for y in range(begin, end):
        _filter_row(flat, y, channels, line)
        for k in range(len(row)):
            row[k] = np.int32(min(max(line[k] + six, np.float32(0)) * twelfth, highest))
        _pack_row(row, channels, out[y])


def pack_flat(
    pixels: NDArray[np.uint8 | np.uint16], sharpened: bool
) -> NDArray[np.uint32 | np.uint64]:
    """The flat, `sharpened` as by `prefilter_flat`, with the channels of each pixel, at most four,
    in one number (H, W), the first lowest.
    """
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1)
    of_bytes = pixels.dtype == np.uint8
    out = np.empty(pixels.shape[:2], np.uint32 if of_bytes else np.uint64)
    if not sharpened:
        pack = _pack
    elif of_bytes:
        pack = _pack_bytes
    else:
        pack = _pack_shorts
    pack(rows, pixels.shape[2], out)
    return out
