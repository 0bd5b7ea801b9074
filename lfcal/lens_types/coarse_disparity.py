"""Coarse disparity of single lenses, to sort them by depth.

Adjacent microimages are correlated over a grid of signed patch sizes; correlations are summed over 3 x 3 lenses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..runtime.fastmath import FAST
from ..runtime.kernels.jit import kernel
from .lens_sample import LensSample
from .settings import DEFAULT, DisparitySettings

__all__ = ["estimate_coarse_disparity"]


# The error model of Python checks every division, which prevents vector loops.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _sums(pixels, width, height, cx, cy, first, second, number):
    """Number of pairs of pixels of two lenses on the picture, of `number`, and sums over their values.

    The centre (cx, cy) has half a pixel added, so that truncation rounds.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    last_x, last_y = np.float32(width), np.float32(height)
    count = sum_a = sum_b = sum_aa = sum_bb = sum_ab = zero
    for n in range(np.uint64(number)):
        xa, ya, xb, yb = cx + first[0, n], cy + first[1, n], cx + second[0, n], cy + second[1, n]
        inside = (min(min(xa, ya), min(xb, yb)) >= zero) & (max(xa, xb) < last_x) & (max(ya, yb) < last_y)
        own, other = np.int32(ya) * np.int32(width) + np.int32(xa), np.int32(yb) * np.int32(width) + np.int32(xb)
        # Less the mean of the picture, 1, which keeps single precision exact enough.
        a, b = pixels[own if inside else np.int32(0)] - one, pixels[other if inside else np.int32(0)] - one
        a, b = a if inside else zero, b if inside else zero
        count += one if inside else zero
        sum_a += a
        sum_b += b
        sum_aa += a * a
        sum_bb += b * b
        sum_ab += a * b
    return count, sum_a, sum_b, sum_aa, sum_bb, sum_ab


@kernel(error_model="numpy", share=lambda picture, centres, *_: len(centres))
def _correlate(begin, end, picture, centres, steps, ratios, radius, spacing, covariance, variance):
    """Covariances and mean variances (n, ratios) of lenses and their neighbours, added up over the `steps`."""
    height, width = picture.shape
    pixels = picture.reshape(-1)
    reach = int(radius / spacing)
    pairs, most = len(ratios) * len(steps), (2 * reach + 1) ** 2
    # Offsets of the compared pixels from the centre of a lens: the same for all lenses.
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
    for lens in range(begin, end):
        cx, cy = np.float32(centres[lens, 0] + 0.5), np.float32(centres[lens, 1] + 0.5)
        for pair in range(pairs):
            number, a, b, aa, bb, ab = _sums(pixels, width, height, cx, cy, first[pair], second[pair], size[pair])
            if number > 4:
                k = pair // len(steps)
                covariance[lens, k] += (ab - a * b / number) / number
                variance[lens, k] += 0.5 * (aa + bb - (a * a + b * b) / number) / number


def estimate_coarse_disparity(
    picture: NDArray[np.float32], sample: LensSample, settings: DisparitySettings = DEFAULT.disparity
) -> NDArray[np.float64]:
    """Signed patch size over the pitch of the inner lenses of a sample.

    Parameters
    ----------
    picture : (h, w) float32
        As made by `images.preprocessing.sqrt_luminance`.
    sample : LensSample

    Returns
    -------
    (n,) float64
        In the order of `sample.inner`, in steps of 0.05; NaN where the maximum is low, ambiguous or at an end.
    """
    lattice = sample.lattice
    radius = settings.disc * lattice.radius
    ratios = np.linspace(-settings.max_ratio, settings.max_ratio, settings.ratios)
    steps = (lattice.steps @ lattice.basis)[: len(lattice.steps) // 2]
    # Every other lens is enough, as sums are over 3 x 3 lenses.
    chosen = np.flatnonzero((sample.whole & (sample.index.sum(-1) % 2 == 0)).ravel())
    sums = np.zeros((2, len(chosen), len(ratios)))
    centres = sample.centre.reshape(-1, 2)[chosen]
    _correlate(picture, centres, steps, ratios, radius, max(1.0, settings.sample_step * radius), *sums)
    full = np.zeros((2, sample.whole.size, len(ratios)))
    full[:, chosen] = sums
    covariance, variance = full.reshape(2, *sample.whole.shape, len(ratios))
    correlation = _sum_3x3(covariance) / (_sum_3x3(variance) + settings.noise_variance)
    best = correlation.argmax(-1)
    highest = correlation.max(-1)
    apart = np.abs(np.arange(len(ratios)) - best[..., None]) > 2
    second = np.where(apart, correlation, -1.0).max(-1)
    inside = (best > 0) & (best < len(ratios) - 1)
    known = (highest > settings.min_correlation) & (highest - second > settings.min_margin) & inside
    return np.where(known, ratios[best], np.nan)[:, 1:-1, 1:-1].ravel()


def _sum_3x3(values: NDArray[Any]) -> NDArray[Any]:
    """Sums over 3 x 3 lenses of (m, a, b, k), within each block."""
    for axis in (1, 2):
        ahead: list[Any] = [slice(None)] * 4
        behind = ahead.copy()
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        total = values.copy()
        total[tuple(behind)] += values[tuple(ahead)]
        total[tuple(ahead)] += values[tuple(behind)]
        values = total
    return values
