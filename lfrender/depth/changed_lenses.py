"""Which lenses of a frame show something else than in an earlier frame."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.fastmath import FAST, square

from ..flat.gray_flat import trusted_radius, white_level
from ..runtime.quantiles import quantile

__all__ = ["find_changed_lenses"]

# Side [px] of the blocks whose sums tell a small motion from noise, which they average out; the second where
# microimages of less than the third [px] have no room for several of them.
_BLOCK, _SMALL_BLOCK, _ROOMY = 4, 2, 6.0
# Lenses are grouped by brightness, because noise grows with it.
_LEVELS, _TELLING = 8, 1000
_BELOW, _ABOVE = np.maximum(np.arange(_LEVELS) - 1, 0), np.minimum(np.arange(_LEVELS) + 1, _LEVELS - 1)
# The quietest lenses of a group show its noise: in one frame the smoothest tenth, between two frames a larger part,
# since most of a scene stands still.
_SMOOTH, _STILL = 0.1, 0.25
# Energy beyond which a difference is no noise: single pixels, of which there are hundreds in a lens, and blocks, of
# which there are some dozens; so many standard deviations of a sum of that many squares.
_DEVIATIONS = 6.0
# Rounding alone leaves this variance [levels^2] in a difference of two equal scenes.
_ROUNDING = 1 / 6
# Coding of video makes differences where nothing moves, and none elsewhere. What nobody would see is no change: of
# pixels and of blocks, as shares of white, and both as shares of the contrast between blocks, of which a quarter of a
# pixel of motion makes more.
_UNSEEN_PIXEL, _UNSEEN_BLOCK = 2 / 255, 0.5 / 255
_UNSEEN_SHARE = 0.007
# Every so many rows of blocks tell how rough a frame is.
_ROUGH_ROWS = 2
# Energy of the answer to a checkerboard mask, of four times the noise, over the three rows of which it is told.
_ROUGH = np.float32(1 / 36)


# Python's error model checks every division, which no vector loop can. Sums of short whole numbers are of 64 bits until
# they are stored, and no vector instruction makes single precision of those: it is made of what has been stored.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _over_channels(row, channels, out):
    """Sum over the channels of each pixel of a row."""
    # The compiler has vector instructions for steps that it knows.
    if channels == 3:
        for x in range(len(out)):
            out[x] = row[3 * x] + row[3 * x + 1] + row[3 * x + 2]
    else:
        for x in range(len(out)):
            out[x] = row[channels * x]
            for k in range(channels * x + 1, channels * (x + 1)):
                out[x] += row[k]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _over_blocks(row, side, out):
    """Sum over each `side` pixels of a row."""
    if side == 4:
        for u in range(len(out)):
            out[u] = (row[4 * u] + row[4 * u + 1]) + (row[4 * u + 2] + row[4 * u + 3])
    else:
        for u in range(len(out)):
            out[u] = row[2 * u] + row[2 * u + 1]


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST, error_model="numpy")
def _compare_blocks(first, second, channels, side, like, out):
    """Fill `out` (4, h, w): per block of `side` x `side` pixels, 2 or 4, the sum of the differences, that of their
    squares, the brightness, and, in every other row, how rough the first is, squared; all of sums over the channels.

    Rows are held as numbers of the type of `like`: short ones, of which vectors hold many.
    """
    _, rows, columns = out.shape
    width = columns * side
    for v in prange(rows):
        channel_by_channel = np.empty(width * channels, like.dtype)
        gray, apart = np.empty((3, width), like.dtype), np.empty(width, like.dtype)
        sums, squares = np.zeros(width, np.float32), np.zeros(width, np.float32)
        bright, rough = np.empty(width, np.float32), np.zeros(width, np.float32)
        for r in range(side):
            a, b = first[v * side + r], second[v * side + r]
            for k in range(width * channels):
                channel_by_channel[k] = b[k] - a[k]
            _over_channels(channel_by_channel, channels, apart)
            for x in range(width):
                d = np.float32(apart[x])
                sums[x] += d
                squares[x] += d * d
        # Brightness is that of the middle row.
        told = v % _ROUGH_ROWS == 0
        for r in range(0 if told else 1, 3 if told else 2):
            a = first[min(v * side + r, len(first) - 1)]
            for k in range(width * channels):
                channel_by_channel[k] = a[k]
            _over_channels(channel_by_channel, channels, gray[r])
        above, here, below = gray[0], gray[1], gray[2]
        for x in range(width - 2 if told else 0):
            apart[x] = (
                above[x] + above[x + 2] + below[x] + below[x + 2]
                - 2 * (above[x + 1] + below[x + 1] + here[x] + here[x + 2]) + 4 * here[x + 1]
            )  # fmt: skip
        for x in range(width - 2 if told else 0):
            bend = np.float32(apart[x])
            rough[x + 1] = _ROUGH * bend * bend
        for x in range(width):
            bright[x] = np.float32(here[x])
        _over_blocks(sums, side, out[0, v])
        _over_blocks(squares, side, out[1, v])
        _over_blocks(bright, side, out[2, v])
        if told:
            _over_blocks(rough, side, out[3, v])


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _pool(blocks, centres, side, radius, per_pixel, out):
    """Per lens: mean, contrast^2 of blocks, roughness^2, difference^2 of a pixel and of a block, and blocks."""
    _, rows, columns = blocks.shape
    # Middle of block 0.
    middle = np.float32(0.5 * (side - 1))
    area = np.float32(side * side)
    for lens in prange(len(centres)):
        cx, cy = (centres[lens, 0] - middle) / side, (centres[lens, 1] - middle) / side
        reach = radius / side
        total = squares = rough = energy = sums = np.float32(0.0)
        count = told = 0
        top, bottom = max(0, int(np.ceil(cy - reach))), min(rows - 1, int(np.floor(cy + reach)))
        left, right = max(0, int(np.ceil(cx - reach))), min(columns - 1, int(np.floor(cx + reach)))
        for v in range(top, bottom + 1):
            for u in range(left, right + 1):
                if square(u - cx) + square(v - cy) > reach * reach:
                    continue
                bright = blocks[2, v, u] / side * per_pixel
                total += bright
                squares += bright * bright
                if v % _ROUGH_ROWS == 0:
                    rough += blocks[3, v, u] / side
                    told += 1
                energy += blocks[1, v, u]
                sums += blocks[0, v, u] * blocks[0, v, u]
                count += 1
        one = np.float32(1.0) / max(count, 1)
        out[0, lens] = total * one
        out[1, lens] = max(squares * one - total * one * total * one, np.float32(0.0))
        out[2, lens] = rough / max(told, 1) * per_pixel * per_pixel
        out[3, lens] = energy * one / area * per_pixel * per_pixel
        out[4, lens] = sums * one / area * per_pixel * per_pixel
        out[5, lens] = max(count, 1)


@njit(cache=True, nogil=True)
def _group(edges, mean, rough, pixel, level, ends, groups):
    """Group lenses by the `level` of their mean between the `edges`; fill `groups` (2, n) with `rough` and `pixel` of
    one group after the other, each of which `ends` before the place that it tells."""
    ends[:] = 0
    for lens in range(len(mean)):
        level[lens] = 0
        for k in range(len(edges)):
            level[lens] += edges[k] < mean[lens]
        ends[level[lens]] += 1
    for k in range(1, len(ends)):
        ends[k] += ends[k - 1]
    for lens in range(len(mean) - 1, -1, -1):
        ends[level[lens]] -= 1
        groups[0, ends[level[lens]]], groups[1, ends[level[lens]]] = rough[lens], pixel[lens]
    ends[:-1], ends[-1] = ends[1:], len(mean)


def find_changed_lenses(before: NDArray, now: NDArray, calibration: Calibration) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose pixels differ from those of an earlier frame by more than noise, and so that it shows.

    The noise of a difference is taken from the quietest lenses of like brightness: from how rough they are in one
    frame, or from how much they differ between the frames, whichever is less. Where all that moves is
    smaller than the noise of a pixel, sums over blocks of 4 x 4 still show it.

    Parameters
    ----------
    before, now : (H, W, C) array
        Two flats of one camera, exposure and type.
    calibration : Calibration
    """
    height, width, channels = before.shape
    radius = trusted_radius(calibration)
    side = _BLOCK if radius >= _ROOMY else _SMALL_BLOCK
    blocks = np.empty((4, max(height // side, 1), max(width // side, 1)), np.float32)
    like = np.empty(0, {"u1": np.int16, "u2": np.int32}.get(before.dtype.str[1:], np.float32))
    first, second = (np.ascontiguousarray(flat).reshape(height, -1) for flat in (before, now))
    _compare_blocks(first, second, channels, side, like, blocks)
    centres = calibration.lattice.centres().astype(np.float32)
    out = np.empty((6, len(centres)), np.float32)
    within = max(radius - 0.5 * side, 0.75 * side)
    _pool(blocks, centres, side, np.float32(within), np.float32(1 / channels), out)
    mean, contrast, rough, pixel, block, count = out
    white = white_level(before, calibration)
    rounding = _ROUNDING if before.dtype.kind in "ui" else (white / 2**16) ** 2
    level, ends, groups = (
        np.empty(len(mean), np.int64),
        np.empty(_LEVELS, np.int64),
        np.empty((2, len(mean)), np.float32),
    )
    # Some of the lenses tell where the groups end.
    ordered = np.sort(mean[:: max(1, len(mean) // _TELLING)])
    edges = ordered[np.arange(1, _LEVELS) * len(ordered) // _LEVELS]
    _group(edges, mean, 2 * rough, pixel, level, ends, groups)
    noise = np.full(_LEVELS, rounding / channels)
    for k, (smooth, still) in enumerate(zip(*(np.split(values, ends[:-1]) for values in groups), strict=True)):
        if len(smooth):
            noise[k] = max(noise[k], min(quantile(smooth, _SMOOTH), quantile(still, _STILL)))
    # Noise may change much within a group, as where pixels are cut off at black.
    allowed = np.maximum(np.maximum(noise[_BELOW], noise[_ABOVE]), noise)[level]
    unseen = _UNSEEN_SHARE * contrast
    area = side * side
    most = np.maximum(allowed * _limit(count * area), np.maximum((_UNSEEN_PIXEL * white) ** 2, unseen))
    # A sum over a block is as many times the mean, and its energy is stated per pixel.
    most_block = np.maximum(allowed * _limit(count), area * np.maximum((_UNSEEN_BLOCK * white) ** 2, unseen))
    return np.asarray((pixel > most) | (block > most_block))


def _limit(count: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of so many squares of unit noise that noise hardly ever exceeds."""
    return np.asarray(1 + _DEVIATIONS * np.sqrt(2 / count), np.float32)
