"""Which lenses of a frame show something else than in an earlier frame."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration

from .fastmath import FAST
from .radiance import trusted_radius, white_level

__all__ = ["changed_lenses"]

# Side [px] of the blocks whose sums tell a small motion from noise, which they average out.
_BLOCK = 4
# Lenses are grouped by brightness, because noise grows with it.
_LEVELS = 8
# The quietest lenses of a group show its noise: in one frame the smoothest tenth, between two frames a larger part,
# since most of a scene stands still.
_SMOOTH, _STILL = 10, 25
# Energy beyond which a difference is no noise: single pixels, of which there are hundreds in a lens, and blocks, of
# which there are some dozens; so many standard deviations of a sum of that many squares.
_DEVIATIONS = 6.0
# Rounding alone leaves this variance [levels^2] in a difference of two equal scenes.
_ROUNDING = 1 / 6


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _differences(first, second, centres, radius, out):
    """Per lens: mean, roughness^2, difference^2 of a pixel, difference^2 of a block, pixels and blocks."""
    height, width, channels = first.shape
    side = int(2 * radius) + 2
    inverse = np.float32(1.0 / channels)
    for lens in prange(len(centres)):
        cx, cy = centres[lens, 0], centres[lens, 1]
        here = np.zeros((side, side), np.float32)
        apart = np.zeros((side, side), np.float32)
        left, top = max(0, int(np.ceil(cx - radius))), max(0, int(np.ceil(cy - radius)))
        columns = min(width - 1, int(np.floor(cx + radius))) - left + 1
        rows = min(height - 1, int(np.floor(cy + radius))) - top + 1
        total = energy = np.float32(0.0)
        for y in range(rows):
            for x in range(columns):
                a = b = np.float32(0.0)
                for k in range(channels):
                    a += np.float32(first[top + y, left + x, k])
                    b += np.float32(second[top + y, left + x, k])
                here[y, x] = a * inverse
                apart[y, x] = (b - a) * inverse
                total += a * inverse
                energy += ((b - a) * inverse) ** 2
        rough = np.float32(0.0)
        for y in range(1, rows - 1):
            for x in range(1, columns - 1):
                bend = (
                    here[y - 1, x - 1] + here[y - 1, x + 1] + here[y + 1, x - 1] + here[y + 1, x + 1]
                    - 2 * (here[y - 1, x] + here[y + 1, x] + here[y, x - 1] + here[y, x + 1]) + 4 * here[y, x]
                )  # fmt: skip
                rough += bend * bend
        blocks = np.float32(0.0)
        count = 0
        for v in range(rows // _BLOCK):
            for u in range(columns // _BLOCK):
                sum_ = np.float32(0.0)
                for y in range(v * _BLOCK, v * _BLOCK + _BLOCK):
                    for x in range(u * _BLOCK, u * _BLOCK + _BLOCK):
                        sum_ += apart[y, x]
                blocks += sum_ * sum_
                count += 1
        pixels = max(rows * columns, 1)
        out[0, lens] = total / pixels
        out[1, lens] = rough / max((rows - 2) * (columns - 2), 1) / np.float32(36.0)
        out[2, lens] = energy / pixels
        out[3, lens] = blocks / (max(count, 1) * _BLOCK * _BLOCK)
        out[4, lens] = pixels
        out[5, lens] = max(count, 1)


def changed_lenses(before: NDArray, now: NDArray, calibration: Calibration) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose pixels differ from those of an earlier frame by more than noise.

    The noise of a difference is taken from the quietest lenses of like brightness: from how rough they are in one
    frame, or from how much they differ between the frames, whichever is less. Where all that moves is
    smaller than the noise of a pixel, sums over blocks of 4 x 4 still show it.

    Parameters
    ----------
    before, now : (H, W, C) array
        Two flats of one camera and exposure.
    calibration : Calibration
    """
    centres = calibration.lattice.centres().astype(np.float32)
    out = np.empty((6, len(centres)), np.float32)
    _differences(before, now, centres, np.float32(0.75 * trusted_radius(calibration)), out)
    mean, rough, pixel, block, pixels, blocks = out
    rounding = _ROUNDING if before.dtype.kind in "ui" else (white_level(before) / 2**16) ** 2
    edges = np.quantile(mean, np.arange(1, _LEVELS) / _LEVELS)
    level = np.searchsorted(edges, mean)
    noise = np.empty(_LEVELS)
    for k in range(_LEVELS):
        group = level == k
        noise[k] = rounding / before.shape[2]
        if group.any():
            quiet = min(np.percentile(2 * rough[group], _SMOOTH), np.percentile(pixel[group], _STILL))
            noise[k] = max(noise[k], quiet)
    # Noise may change much within a group, as where pixels are cut off at black.
    padded = np.pad(noise, 1, mode="edge")
    allowed = np.maximum(np.maximum(padded[:-2], padded[2:]), noise)[level]
    return (pixel > allowed * _limit(pixels)) | (block > allowed * _limit(blocks))


def _limit(count: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of so many squares of unit noise that noise hardly ever exceeds."""
    return np.asarray(1 + _DEVIATIONS * np.sqrt(2 / count), np.float32)
