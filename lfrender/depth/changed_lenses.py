"""Lenses whose pixels differ between two frames by more than noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel

from ..flat.gray_flat import GrayFlat
from ..flat.texture import LensStatistics

__all__ = ["find_changed_lenses"]

# Groups of lenses of like brightness, and share of the quietest of each that tells its noise.
_GROUPS = 8
_QUIETEST = 0.1
# Change of a pixel that nobody sees, as by video coding [white].
_INVISIBLE = 2 / 255
# Share of the variance of a lens that motion by a quarter of a pixel exceeds.
_UNSEEN = 0.007


@kernel(fastmath=FAST, error_model="numpy", share=lambda before, now, centres, *_: len(centres))
def _compare(begin, end, before, now, centres, radius, side, out):
    """Per lens: mean square of the differences of pixels, and of sums over blocks of `side` x
    `side` pixels over the root of their number; number of blocks.
    """
    height, width = now.shape
    for lens in range(begin, end):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        energy = np.float32(0.0)
        sums = np.float32(0.0)
        count = 0
        for top in range(
            max(0, int(cy - radius)), min(height - side, int(cy + radius) + 1 - side) + 1, side
        ):
            y = np.float32(top + 0.5 * (side - 1)) - cy
            half = np.sqrt(max(radius * radius - y * y, np.float32(0.0)))
            for left in range(
                max(0, int(cx - half)), min(width - side, int(cx + half) + 1 - side) + 1, side
            ):
                total = np.float32(0.0)
                for row in range(top, top + side):
                    for column in range(left, left + side):
                        d = now[row, column] - before[row, column]
                        energy += d * d
                        total += d
                sums += total * total
                count += 1
        pixels = np.float32(max(count, 1) * side * side)
        out[0, lens], out[1, lens], out[2, lens] = energy / pixels, sums / pixels, max(count, 1)


def find_changed_lenses(
    before: GrayFlat, statistics: LensStatistics, now: GrayFlat
) -> NDArray[np.bool_]:
    """(n,) bool: lenses whose pixels differ visibly, and by more than noise, from those of a frame
    `before`.

    The noise of a difference is estimated on its smoothest lenses of like brightness, or on those
    that differ least between the frames, whichever is less. Motion below the noise of a pixel shows
    in sums over blocks.
    """
    side = 4 if now.radius >= 6 else 2
    out = np.empty((3, len(now.centres)), np.float32)
    _compare(before.image, now.image, now.centres, np.float32(now.radius), side, out)
    pixel, block, count = out
    # Noise grows with brightness: that of the tenth of lenses with the least, in eight groups, and
    # in those beside.
    noise = np.minimum(2 * statistics.roughness**2, pixel)
    edges = np.quantile(statistics.mean, np.arange(1, _GROUPS) / _GROUPS)
    group = np.searchsorted(edges, statistics.mean)
    least = 2 * now.rounding**2
    level = np.full(_GROUPS, least, noise.dtype)
    for k in np.unique(group):
        level[k] = np.quantile(noise[group == k], _QUIETEST)
    level = np.maximum(np.pad(level, 1, "edge"), least)
    allowed = np.maximum(np.maximum(level[:-2], level[2:]), level[1:-1])[group]
    unseen = _UNSEEN * statistics.contrast**2
    area = side * side
    most = np.maximum(allowed * _limit(count * area), np.maximum(_INVISIBLE**2, unseen))
    most_block = np.maximum(allowed * _limit(count), np.maximum(_INVISIBLE**2, area * unseen))
    return np.asarray((pixel > most) | (block > most_block))


def _limit(count: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of so many squares of unit noise that noise hardly ever exceeds."""
    return np.asarray(1 + 6 * np.sqrt(2 / count), np.float32)
