"""Prefilter for bilinear interpolation: undo beforehand the blur that bilinear interpolation adds on average."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..runtime.buffers import allocate_scratch

__all__ = ["prefilter_flat", "prefilter_packed"]

# Bilinear reading at any place averages the flat with a triangle of this variance [px^2], at whole pixels with nothing;
# over all places the mean is 1/6. A second difference with half of that as its factor gives it back.
_GIVEN_BACK = 1 / 12


def prefilter_flat(pixels: NDArray) -> NDArray:
    """The flat as bilinear reading wants it: what interpolation blurs is given back before.

    Between pixels bilinear interpolation averages, at pixels it does not. Where many lenses and places share in
    a picture, their mean has the sharpness of the flat itself.

    Parameters
    ----------
    pixels : (H, W, C) uint8, uint16 or float32

    Returns
    -------
    array of the same shape and type
    """
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1)
    out = np.empty_like(rows)
    if rows.dtype.kind == "f":
        _give_back(rows, pixels.shape[2], out)
    elif rows.dtype == np.uint8:
        _give_back_bytes(rows, pixels.shape[2], out)
    else:
        _give_back_whole(rows, pixels.shape[2], np.float32(np.iinfo(rows.dtype).max), out)
    return out.reshape(pixels.shape)


# Exact rules of rounding: a part of a flat gets what the whole has there, whatever pixels a vector loop takes together.
@njit(cache=True, nogil=True, parallel=True)
def _give_back(flat, channels, out):
    height, width = flat.shape
    middle, side = np.float32(1 + 4 * _GIVEN_BACK), np.float32(_GIVEN_BACK)
    for y in prange(height):
        above, here, below = flat[max(y - 1, 0)], flat[y], flat[min(y + 1, height - 1)]
        into = out[y]
        n = width - 2 * channels
        before, own, after = here[: max(n, 0)], here[channels:], here[2 * channels :]
        up, down, target = above[channels:], below[channels:], into[channels:]
        for k in range(n):
            target[k] = middle * own[k] - side * ((before[k] + after[k]) + (up[k] + down[k]))
        for end in range(min(2 * channels, width)):
            k = end if end < channels else width - 2 * channels + end
            left, right = here[k - channels if k >= channels else k], here[k + channels if k < width - channels else k]
            into[k] = middle * here[k] - side * ((left + right) + (above[k] + below[k]))


@njit(cache=True, nogil=True)
def _whole_given_back(flat, y, channels, highest, into):
    """A row as of `_give_back`, rounded: sixteen twelfths of a pixel less one twelfth of each beside it, plus a half.

    Twelve times the answer is a whole number that single precision holds exactly, and a twelfth is rounded up there, so
    that cutting off after the product is the division of whole numbers; vectors hold more of these than of integers.
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


@njit(cache=True, nogil=True, parallel=True)
def _give_back_whole(flat, channels, highest, out):
    for y in prange(len(flat)):
        _whole_given_back(flat, y, channels, highest, out[y])


@njit(cache=True, nogil=True)
def _bytes_given_back(flat, y, channels, line, into):
    """A row as of `_whole_given_back`, for bytes: a line between two loops keeps them to 16 bits: vectors hold more."""
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


@njit(cache=True, nogil=True, parallel=True)
def _give_back_bytes(flat, channels, out):
    for y in prange(len(flat)):
        _bytes_given_back(flat, y, channels, np.empty(flat.shape[1], np.int16), out[y])


@njit(cache=True, nogil=True)
def _packed(row, channels, into):
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


@njit(cache=True, nogil=True, parallel=True)
def _give_back_packed(flat, channels, out):
    for y in prange(len(flat)):
        row = np.empty(flat.shape[1], np.uint8)
        _bytes_given_back(flat, y, channels, np.empty(flat.shape[1], np.int16), row)
        _packed(row, channels, out[y])


@njit(cache=True, nogil=True, parallel=True)
def _give_back_packed_shorts(flat, channels, highest, out):
    for y in prange(len(flat)):
        row = np.empty(flat.shape[1], np.uint16)
        _whole_given_back(flat, y, channels, highest, row)
        _packed(row, channels, out[y])


def prefilter_packed(pixels: NDArray[np.uint8 | np.uint16]) -> NDArray[np.uint32 | np.uint64]:
    """(H, W) uint32, or uint64 of shorts: `prefilter_flat` with the channels of each pixel (H, W, C) in one number, the
    first lowest; C is 4 at most. In `allocate_scratch` memory."""
    rows, channels = np.ascontiguousarray(pixels).reshape(len(pixels), -1), pixels.shape[2]
    if pixels.dtype == np.uint8:
        out = allocate_scratch("packed", pixels.shape[:2], np.uint32)
        _give_back_packed(rows, channels, out)
    else:
        out = allocate_scratch("packed shorts", pixels.shape[:2], np.uint64)
        _give_back_packed_shorts(rows, channels, np.float32(np.iinfo(pixels.dtype).max), out)
    return out
