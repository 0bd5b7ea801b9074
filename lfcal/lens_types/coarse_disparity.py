"""Coarse disparity of single lenses: good enough to sort them by depth, far from good enough to draw a picture.

Adjacent microimages are correlated over a grid of signed patch sizes, the correlations of a few neighbours pooled.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..runtime.fastmath import FAST
from .lens_sample import LensSample

__all__ = ["estimate_coarse_disparity"]

# Signed patch sizes over the pitch that are tried: beyond these neighbours share too little.
_RATIOS = np.linspace(-0.6, 0.6, 25)
# Share of the usable radius that is compared, and spacing of its samples over that radius.
_DISC, _SAMPLES = 0.88, 0.25
# Correlation a place must reach, and how far it must surpass the next best that is no neighbour on the grid.
_LEAST, _CLEAR = 0.5, 0.04
# Variance of a tone that shows nothing.
_BLANK = 1e-5


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _sums(pixels, width, height, cx, cy, first, second, number):
    """How many of `number` places of one lens and another are on the picture, and sums over what they show there.

    Half a pixel is in the centre (cx, cy), so that cutting off the fraction rounds.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    last_x, last_y = np.float32(width), np.float32(height)
    count = sum_a = sum_b = sum_aa = sum_bb = sum_ab = zero
    for n in range(np.uint64(number)):
        xa, ya, xb, yb = cx + first[0, n], cy + first[1, n], cx + second[0, n], cy + second[1, n]
        inside = (min(min(xa, ya), min(xb, yb)) >= zero) & (max(xa, xb) < last_x) & (max(ya, yb) < last_y)
        own, other = np.int32(ya) * np.int32(width) + np.int32(xa), np.int32(yb) * np.int32(width) + np.int32(xb)
        # The mean of the picture is 1.
        a, b = pixels[own if inside else np.int32(0)] - one, pixels[other if inside else np.int32(0)] - one
        a, b = a if inside else zero, b if inside else zero
        count += one if inside else zero
        sum_a += a
        sum_b += b
        sum_aa += a * a
        sum_bb += b * b
        sum_ab += a * b
    return count, sum_a, sum_b, sum_aa, sum_bb, sum_ab


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _correlate(picture, centres, steps, ratios, radius, spacing, common, total):
    height, width = picture.shape
    pixels = picture.reshape(-1)
    reach = int(radius / spacing)
    pairs, most = len(ratios) * len(steps), (2 * reach + 1) ** 2
    # Where the pixels compared lie beside the centre of a lens: the same for all lenses.
    first, second = np.empty((pairs, 2, most), np.float32), np.empty((pairs, 2, most), np.float32)
    size = np.zeros(pairs, np.int64)
    for pair in range(pairs):
        k, step = pair // len(steps), pair % len(steps)
        ux, uy = ratios[k] * steps[step, 0] / 2, ratios[k] * steps[step, 1] / 2
        for row in range(-reach, reach + 1):
            y = row * spacing
            for column in range(-reach, reach + 1):
                x = column * spacing
                if max((x - ux) ** 2 + (y - uy) ** 2, (x + ux) ** 2 + (y + uy) ** 2) > radius * radius:
                    continue
                n = size[pair]
                first[pair, 0, n], first[pair, 1, n] = x - ux, y - uy
                second[pair, 0, n], second[pair, 1, n] = steps[step, 0] + x + ux, steps[step, 1] + y + uy
                size[pair] += 1
    for lens in prange(len(centres)):
        cx, cy = np.float32(centres[lens, 0] + 0.5), np.float32(centres[lens, 1] + 0.5)
        for pair in range(pairs):
            number, a, b, aa, bb, ab = _sums(pixels, width, height, cx, cy, first[pair], second[pair], size[pair])
            if number > 4:
                k = pair // len(steps)
                common[lens, k] += (ab - a * b / number) / number
                total[lens, k] += 0.5 * (aa + bb - (a * a + b * b) / number) / number


def estimate_coarse_disparity(picture: NDArray[np.float32], sample: LensSample) -> NDArray[np.float64]:
    """Signed patch size over the pitch of the inner lenses of a sample.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance with mean 1 (`features.tone`).
    sample : LensSample

    Returns
    -------
    (n,) float64
        In the order of `sample.inner`, in steps of 0.05; NaN where the place is not clear.
    """
    lattice = sample.lattice
    radius = _DISC * lattice.radius
    steps = (lattice.steps @ lattice.basis)[: len(lattice.steps) // 2]
    # Every other lens is enough, as each takes part in what is pooled around its neighbours.
    chosen = np.flatnonzero((sample.whole & (sample.index.sum(-1) % 2 == 0)).ravel())
    sums = np.zeros((2, len(chosen), len(_RATIOS)))
    centres = sample.centre.reshape(-1, 2)[chosen]
    _correlate(picture, centres, steps, _RATIOS, radius, max(1.0, _SAMPLES * radius), *sums)
    full = np.zeros((2, sample.whole.size, len(_RATIOS)))
    full[:, chosen] = sums
    common, total = full.reshape(2, *sample.whole.shape, len(_RATIOS))
    score = _pooled(common) / (_pooled(total) + _BLANK)
    best = score.argmax(-1)
    highest = score.max(-1)
    apart = np.abs(np.arange(len(_RATIOS)) - best[..., None]) > 2
    rival = np.where(apart, score, -1.0).max(-1)
    # Where the range of the search ends, the best place may lie beyond it.
    ends = (best == 0) | (best == len(_RATIOS) - 1)
    known = (highest > _LEAST) & (highest - rival > _CLEAR) & ~ends
    return np.where(known, _RATIOS[best], np.nan)[:, 1:-1, 1:-1].ravel()


def _pooled(values: NDArray[Any]) -> NDArray[Any]:
    """Sums over 3 x 3 lenses of (m, a, b, k), what lies beyond a block left out."""
    for axis in (1, 2):
        ahead: list[Any] = [slice(None)] * 4
        behind = ahead.copy()
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        total = values.copy()
        total[tuple(behind)] += values[tuple(ahead)]
        total[tuple(ahead)] += values[tuple(behind)]
        values = total
    return values
