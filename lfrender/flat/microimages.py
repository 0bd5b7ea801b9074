"""Microimages cut out of a flat into strips of memory, and masks of the pixels that two shifted
microimages share.

A row of a microimage is too short for the vector instructions of a processor. Cut out with a common
width, the rows of all lenses follow each other, so that a shift of one microimage against another
is one offset along the strip, and one long loop compares them. Which pixels two microimages share
depends on the whole pixels of the shift only: a mask marks them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel

if TYPE_CHECKING:
    from .gray_flat import GrayFlat

__all__ = [
    "VECTOR_LENGTH",
    "OverlapMasks",
    "Strips",
    "allocate_strips",
    "bilinear_weights",
    "copy_box",
    "extract_strips",
    "make_shift_masks",
    "row_of_disc",
]

#: Number of values that a vector loop handles at a time; a mask excludes values that do not count.
VECTOR_LENGTH = 64
# Mean error of centres rounded to pixels, over both directions [px].
_ROUNDING = 0.25


class Strips(NamedTuple):
    """Microimages as strips of equal length.

    Row `r` of a microimage is row `r // step` of part `r % step` of its strip, so that the rows
    that are read together follow each other.
    """

    means: NDArray[np.float32]  # (n,) of the lenses
    # One strip after the other, minus the mean of its lens. Values off the flat are arbitrary,
    # values after the last strip are 0.
    values: NDArray[np.float32]
    middle: NDArray[np.int32]  # (n, 2) pixel `x, y` in the middle of each microimage
    whole: NDArray[np.bool_]  # (n,) microimages that lie within the flat
    extracted: NDArray[np.bool_]  # (n,) microimages that have been cut out
    half: int  # [px] from the middle to the sides
    width: int  # [px] of a row
    rows: int  # number of rows of a part
    step: int  # number of parts
    flat_size: tuple[int, int]  # [px] height and width of the flat


class OverlapMasks(NamedTuple):
    """Masks of the pixels that two microimages share, one mask for each shift by whole pixels."""

    # (2 k + 1, 2 k + 1) number of the mask of the shift `x, y` at `[y + k, x + k]`; -1 if none.
    slots: NDArray[np.int32]
    # (slots, rows * width + spare) 1 or 0 for the pixels of the first part of a strip.
    masks: NDArray[np.float32]
    # (slots, 4) position of the first 1; number of values from there on that hold all ones, a
    # multiple of `VECTOR_LENGTH`; distance in a strip to the pixel at this shift, and to the pixel
    # below that one.
    ends: NDArray[np.int32]
    counts: NDArray[np.int32]  # (slots,) number of ones


@njit(inline="always")
def bilinear_weights(fx, fy):
    """Weights of a pixel, of that right of it, below, and right below, at a fraction of a pixel.

    In single precision, which a whole number would not keep.
    """
    one = np.float32(1)
    return (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def copy_box(pixels, stride, left, top, rows, wide, out, begin=0, step=1):
    """Copy every `step`-th row of a box from (left, top) on, one after the other, to `out` from
    `begin` on.

    `pixels` are those of the flat in one line, `stride` its width. Places off the flat get the
    value of the nearest pixel.
    """
    height = len(pixels) // stride
    for row in range(rows):
        at = min(max(top + row * step, 0), height - 1) * stride
        into = np.uint64(begin + row * wide)
        if left < 0 or left + wide > stride:
            for k in range(wide):
                out[into + np.uint64(k)] = pixels[at + min(max(left + k, 0), stride - 1)]
        else:
            for k in range(np.uint64(wide)):
                out[into + k] = pixels[np.uint64(at + left) + k]


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def row_of_disc(y, x, radius, low, high):
    """First column of a disc about column `x` in row `y` [px from the centre], and number of its
    columns from `low` to `high`.
    """
    half = radius * radius - y * y
    if half < 0:
        return low, 0
    half = np.sqrt(half)
    first = max(low, int(np.ceil(x - half)))
    return first, max(min(high, int(np.floor(x + half))) + 1 - first, 0)


@kernel(fastmath=FAST, error_model="numpy", share=lambda image, strips, _: len(strips.middle))
def _extract(begin, end, image, strips, wanted):
    pixels = image.reshape(-1)
    across = image.shape[1]
    half = strips.half
    width = strips.width
    rows = strips.rows
    step = strips.step
    size = rows * step * width
    for lens in range(begin, end):
        if strips.extracted[lens] or not wanted[lens]:
            continue
        strips.extracted[lens] = True
        strip = strips.values[lens * size : (lens + 1) * size]
        left = strips.middle[lens, 0] - half
        top = strips.middle[lens, 1] - half
        for part in range(step):
            copy_box(
                pixels, across, left, top + part, rows, width, strip, part * rows * width, step
            )
        mean = strips.means[lens]
        for k in range(np.uint64(size)):
            strip[k] -= mean


def extract_strips(strips: Strips, gray: GrayFlat, wanted: NDArray[np.bool_]) -> None:
    """Cut out the `wanted` microimages (n,) of a flat that have not been cut out yet."""
    _extract(gray.image, strips, wanted)


def allocate_strips(gray: GrayFlat, means: NDArray[np.float32], step: int) -> Strips:
    """Memory for the microimages of a flat, minus the `means` (n,) of each, of which every
    `step`-th row is read.
    """
    # Interpolation between the outermost pixels reads one pixel beyond them, to all sides.
    half = max(1, int(gray.radius - _ROUNDING)) + 2
    width = 2 * half + 1
    rows = -(-width // step)
    middle = np.rint(gray.centres).astype(np.int32)
    height, across = gray.image.shape
    inside = (middle >= half) & (middle + half < np.array([across, height]))
    # Vector loops read beyond the end of a strip, where values must be numbers. The memory of
    # strips that are not cut out is not touched.
    values = np.zeros(len(middle) * rows * step * width + VECTOR_LENGTH + width, np.float32)
    return Strips(
        means,
        values,
        middle,
        inside[:, 0] & inside[:, 1],
        np.zeros(len(middle), bool),
        half,
        width,
        rows,
        step,
        (height, across),
    )


def make_shift_masks(strips: Strips, radius: float, wanted: NDArray[np.int64]) -> OverlapMasks:
    """Masks of the pixels that two microimages of this `radius` [px] share at each of the shifts
    `wanted` (m, 2), and up to a pixel farther. They are cached and must not be changed.
    """
    return _masks_of(strips.half, strips.width, strips.rows, strips.step, radius, wanted.tobytes())


@lru_cache(maxsize=8)
def _masks_of(
    half: int, width: int, rows: int, step: int, radius: float, shifts: bytes
) -> OverlapMasks:
    wanted = np.frombuffer(shifts, np.int64).reshape(-1, 2)
    reach = max(1, int(np.abs(wanted).max(initial=0)))
    side = 2 * reach + 1
    used = np.zeros((side, side), bool)
    used[wanted[:, 1] + reach, wanted[:, 0] + reach] = True
    slots = np.where(used, np.cumsum(used.ravel()).reshape(side, side) - 1, -1).astype(np.int32)
    dy, dx = np.argwhere(used).T - reach
    radius2 = max(radius - _ROUNDING, 1.0) ** 2
    line, column = np.divmod(np.arange(rows * width), width)
    x = column - half
    y = line * step - half
    # The other microimage is interpolated between four pixels; their middle must lie within it.
    from_x = np.square(x + dx[:, None] + 0.5)
    from_y = np.square(y + dy[:, None] + 0.5)
    inside = (x * x + y * y <= radius2) & (from_x + from_y <= radius2)
    masks = np.zeros((len(dx), rows * width + VECTOR_LENGTH), np.float32)
    masks[:, : rows * width] = inside
    some = inside.any(1)
    start = np.where(some, inside.argmax(1), rows * width)
    stop = np.where(some, rows * width - inside[:, ::-1].argmax(1), start)
    whole = -(-(stop - start) // VECTOR_LENGTH) * VECTOR_LENGTH
    there = [((move % step) * rows + move // step) * width + dx for move in (dy, dy + 1)]
    ends = np.stack([start, whole, *there], 1).astype(np.int32)
    return OverlapMasks(slots, masks, ends, inside.sum(1, dtype=np.int32))
