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
    """The flat (H, W, C) sharpened by `p - (sum of the four neighbours - 4 p) / 12`; integers, of
    at most four channels, are rounded and clipped.
    """
    if pixels.dtype.kind in "ui":
        packed = pack_flat(pixels, True)
        return packed.view(pixels.dtype).reshape(*packed.shape, 4)[:, :, : pixels.shape[2]]
    rows = _rows_of(pixels)
    out = np.empty(rows.shape, np.float32)
    _sharpen(rows, pixels.shape[2], out)
    return out.reshape(pixels.shape)


def pack_flat(
    pixels: NDArray[np.uint8 | np.uint16], sharpened: bool
) -> NDArray[np.uint32 | np.uint64]:
    """The flat, `sharpened` as by `prefilter_flat`, with the channels of each pixel, at most four,
    in one number (H, W), the first lowest.
    """
    out = np.empty(pixels.shape[:2], np.uint32 if pixels.dtype == np.uint8 else np.uint64)
    highest = np.float32(np.iinfo(pixels.dtype).max)
    _pack(_rows_of(pixels), pixels.shape[2], sharpened, highest, out)
    return out


def _rows_of(pixels: NDArray) -> NDArray:
    """(H, W C) the rows of a flat (H, W, C)."""
    return np.ascontiguousarray(pixels).reshape(len(pixels), -1)


# Without fastmath: a part of a flat gets the same bits as the whole, whatever pixels a vector loop
# handles together.
@njit(error_model="numpy")
def _sharpen_row(flat, y, channels, into):
    """Sixteen times the pixels of a row less their four neighbours: twelve times what is wanted,
    exact for whole numbers of 16 bits.
    """
    single = np.float32
    height, width = flat.shape
    above = flat[max(y - 1, 0)]
    here = flat[y]
    below = flat[min(y + 1, height - 1)]
    own = here[channels:]
    after = here[2 * channels :]
    up = above[channels:]
    down = below[channels:]
    inner = into[channels:]
    for k in range(max(width - 2 * channels, 0)):
        across = single(here[k]) + single(after[k])
        inner[k] = single(own[k]) * single(16) - across - (single(up[k]) + single(down[k]))
    for end in range(min(2 * channels, width)):
        k = end if end < channels else width - 2 * channels + end
        across = single(here[max(k - channels, k % channels)])
        across += single(here[min(k + channels, width - channels + k % channels)])
        into[k] = single(here[k]) * single(16) - across - (single(above[k]) + single(below[k]))


@kernel(error_model="numpy", share=lambda *given: len(given[-1]))
def _sharpen(begin, end, flat, channels, out):
    for y in range(begin, end):
        _sharpen_row(flat, y, channels, out[y])
        for k in range(flat.shape[1]):
            out[y, k] *= np.float32(1 / 12)


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


@kernel(error_model="numpy", share=lambda *given: len(given[-1]))
def _pack(begin, end, flat, channels, sharpened, highest, out):
    """Pack the rows of a flat; values up to `highest` are sharpened."""
    row = np.empty(out.shape[1] * channels, flat.dtype)
    line = np.empty(len(row), np.float32)
    # The constant 1/12 is rounded up, so that truncating the product is integer division.
    six = np.float32(6)
    twelfth = np.float32(1 / 12)
    for y in range(begin, end):
        if not sharpened:
            _pack_row(flat[y], channels, out[y])
            continue
        _sharpen_row(flat, y, channels, line)
        for k in range(len(row)):
            row[k] = np.int32(min(max(line[k] + six, np.float32(0)) * twelfth, highest))
        _pack_row(row, channels, out[y])
