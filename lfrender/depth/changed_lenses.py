"""Which lenses of a frame show something else than in an earlier frame.

Squared differences of pixels, and of sums over small blocks, are compared with the noise of lenses of like brightness.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.kernels import FAST, kernel, square

from ..flat.gray_flat import trusted_radius, white_level
from ..runtime.quantiles import quantile
from .settings import CHANGE, ChangeSettings

__all__ = ["find_changed_lenses"]

# [levels^2] variance of the difference of two rounded values.
_ROUNDING = 1 / 6
# Groups of lenses of like brightness, because noise grows with it, and the groups beside each.
_LEVELS = 8
_BELOW, _ABOVE = np.maximum(np.arange(_LEVELS) - 1, 0), np.minimum(np.arange(_LEVELS) + 1, _LEVELS - 1)
# Roughness is measured in every so many rows of blocks.
_ROUGH_ROWS = 2
# Sum of the squared weights of the Laplacian mask of `_compare_blocks`, which makes roughness the variance of noise.
_ROUGH = np.float32(1 / 36)


# The error model of NumPy, because Python's checks every division, which prevents vector loops. Sums of short integers
# have 64 bits until they are stored, for which there is no vector conversion to float32: stored ones are converted.
@njit(fastmath=FAST, error_model="numpy")
def _over_channels(row, channels, out):
    """Sum over the channels of each pixel of a row."""
    # Loops with a constant step are vectorised.
    if channels == 3:
        for x in range(len(out)):
            out[x] = row[3 * x] + row[3 * x + 1] + row[3 * x + 2]
    else:
        for x in range(len(out)):
            out[x] = row[channels * x]
            for k in range(channels * x + 1, channels * (x + 1)):
                out[x] += row[k]


@njit(fastmath=FAST, error_model="numpy")
def _over_blocks(row, side, out):
    """Sum over each `side` pixels of a row."""
    if side == 4:
        for u in range(len(out)):
            out[u] = (row[4 * u] + row[4 * u + 1]) + (row[4 * u + 2] + row[4 * u + 3])
    else:
        for u in range(len(out)):
            out[u] = row[2 * u] + row[2 * u + 1]


@kernel(fastmath=FAST, error_model="numpy", share=lambda *given: given[5].shape[1])
def _compare_blocks(begin, end, first, second, channels, side, like, out):
    """Fill `out` (4, h, w): per block of `side` x `side` pixels, 2 or 4, the sum of the differences, that of their
    squares, the brightness, and, in every other row, the squared response of the first flat to a Laplacian mask
    (Immerkaer, Fast Noise Variance Estimation, 1996); all of sums over the channels.

    Rows are of the type of `like`: short integers, of which vectors hold many.
    """
    columns = out.shape[2]
    width = columns * side
    for v in range(begin, end):
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
        rough_row = v % _ROUGH_ROWS == 0
        for r in range(0 if rough_row else 1, 3 if rough_row else 2):
            a = first[min(v * side + r, len(first) - 1)]
            for k in range(width * channels):
                channel_by_channel[k] = a[k]
            _over_channels(channel_by_channel, channels, gray[r])
        above, here, below = gray[0], gray[1], gray[2]
        for x in range(width - 2 if rough_row else 0):
            apart[x] = (
                above[x] + above[x + 2] + below[x] + below[x + 2]
                - 2 * (above[x + 1] + below[x + 1] + here[x] + here[x + 2]) + 4 * here[x + 1]
            )  # fmt: skip
        for x in range(width - 2 if rough_row else 0):
            bend = np.float32(apart[x])
            rough[x + 1] = _ROUGH * bend * bend
        for x in range(width):
            bright[x] = np.float32(here[x])
        _over_blocks(sums, side, out[0, v])
        _over_blocks(squares, side, out[1, v])
        _over_blocks(bright, side, out[2, v])
        if rough_row:
            _over_blocks(rough, side, out[3, v])


@kernel(error_model="numpy", fastmath=FAST, share=lambda blocks, centres, *_: len(centres))
def _pool(begin, end, blocks, centres, side, radius, per_pixel, out):
    """Per lens: mean, variance of blocks, roughness^2, difference^2 of a pixel and of a block, and number of blocks."""
    _, rows, columns = blocks.shape
    # Middle of block 0.
    middle = np.float32(0.5 * (side - 1))
    area = np.float32(side * side)
    for lens in range(begin, end):
        cx, cy = (centres[lens, 0] - middle) / side, (centres[lens, 1] - middle) / side
        reach = radius / side
        total = squares = rough = energy = sums = np.float32(0.0)
        count = rough_count = 0
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
                    rough_count += 1
                energy += blocks[1, v, u]
                sums += blocks[0, v, u] * blocks[0, v, u]
                count += 1
        one = np.float32(1.0) / max(count, 1)
        out[0, lens] = total * one
        out[1, lens] = max(squares * one - total * one * total * one, np.float32(0.0))
        out[2, lens] = rough / max(rough_count, 1) * per_pixel * per_pixel
        out[3, lens] = energy * one / area * per_pixel * per_pixel
        out[4, lens] = sums * one / area * per_pixel * per_pixel
        out[5, lens] = max(count, 1)


def find_changed_lenses(
    before: NDArray, now: NDArray, calibration: Calibration, settings: ChangeSettings = CHANGE
) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose pixels differ visibly, and by more than noise, from those of an earlier frame.

    Both flats (H, W, C) are of one camera, exposure and type. The noise of a difference is estimated on the smoothest
    lenses of like brightness in one frame, or on those that differ least between the frames, whichever is less. Motion
    below the noise of a pixel shows in sums over blocks.
    """
    height, width, channels = before.shape
    radius = trusted_radius(calibration)
    side = settings.block if radius >= 1.5 * settings.block else settings.block // 2
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
    noise, level = _measure_noise(mean, np.minimum(2 * rough, pixel), rounding / channels, settings)
    # Noise may vary much within a group, as where pixels are clipped at black.
    allowed = np.maximum(np.maximum(noise[_BELOW], noise[_ABOVE]), noise)[level]
    # A sum over a block is as many times the mean, and its energy is stated per pixel.
    invisible = np.float32((settings.unseen_pixel * white) ** 2)
    unseen, area = settings.unseen_share * contrast, side * side
    most = np.maximum(allowed * _limit(count * area, settings), np.maximum(invisible, unseen))
    most_block = np.maximum(allowed * _limit(count, settings), np.maximum(invisible, area * unseen))
    return np.asarray((pixel > most) | (block > most_block))


def _measure_noise(
    mean: NDArray[np.float32], noise: NDArray[np.float32], least: float, settings: ChangeSettings
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Variance of a difference by noise in each group of brightness, and the group (n,) of each lens."""
    edges = np.quantile(mean, np.arange(1, _LEVELS) / _LEVELS)
    level = np.searchsorted(edges, mean)
    groups = [noise[level == k] for k in range(_LEVELS)]
    return np.array([max(quantile(some, settings.quiet), least) if len(some) else least for some in groups]), level


def _limit(count: NDArray[np.float32], settings: ChangeSettings) -> NDArray[np.float32]:
    """Mean of so many squares of unit noise that noise hardly ever exceeds."""
    return np.asarray(1 + settings.deviations * np.sqrt(2 / count), np.float32)
