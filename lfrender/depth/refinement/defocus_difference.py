"""How much more one lens type blurs than another, from pairs of lenses of a multi-focus plenoptic camera.

The sharper of two pictures of one place differs from the other by half the difference of the variances of both blurs
times its Laplacian. Blur grows with the distance from the depth in focus, so that the difference of variances is linear
in the patch size s. Lenses add up light, but most files store a curve of it (gamma): then the squared slope over the
brightness adds to the Laplacian. Differences and curve are estimated together by least squares over all pairs.
"""

from __future__ import annotations

from collections import namedtuple
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import njit

from .pair_pixels import (
    cut_smoothed,
    first_pixel,
    flat_pixels,
    new_buffers,
    new_cutout,
    pixel_raster,
    resample_shifted,
)
from .settings import DefocusSettings

__all__ = ["NO_DIFFERENCE", "DefocusDifference", "add_tone_curve", "estimate_defocus_difference", "sample_start_values"]

_DEFAULT = DefocusSettings()


class DefocusDifference(NamedTuple):
    """What the lenses of one type blur more than those of another.

    Parameters
    ----------
    kinds : (n,) int8
        Types of the lenses; empty if they make no difference.
    blurs, growths : (types, types) float32 [px^2, px]
        Factor of the Laplacian by which a lens of the first type differs from one of the second, and its growth per s.
    curve : float32
        How much of the squared slope over brightness is added to the Laplacian.
    dark : float32
        Brightness below which slopes count as at this one.
    """

    kinds: NDArray[np.int8]
    blurs: NDArray[np.float32]
    growths: NDArray[np.float32]
    curve: np.float32
    dark: np.float32 = np.float32(_DEFAULT.dark)


#: For lenses that all blur alike.
NO_DIFFERENCE = DefocusDifference(
    np.empty(0, np.int8), np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32), np.float32(0.0)
)


def sample_start_values(start: NDArray[np.float32], settings: DefocusSettings = _DEFAULT) -> NDArray[np.float32]:
    """Start values [px] of a sample of the lenses that have any, NaN for the others."""
    rows = np.flatnonzero(np.isfinite(start))
    some = np.full_like(start, np.nan)
    chosen = rows[:: max(1, len(rows) // settings.sample)]
    some[chosen] = start[chosen]
    return some


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def add_tone_curve(cutout, curve, dark):
    """Add `curve` times the squared slope over brightness to the Laplacian of a cutout."""
    light, slope_x, slope_y, laplacian = cutout.light, cutout.slope_x, cutout.slope_y, cutout.laplacian
    for k in range(len(laplacian)):
        laplacian[k] += curve * (slope_x[k] * slope_x[k] + slope_y[k] * slope_y[k]) / max(light[k], dark)


# Exact sums: with fast math they would have other bits where Numba compiles than where it loads.
@njit(cache=True, nogil=True, error_model="numpy")
def _products(cutout, shifted, raster, overlap, scale2, dark, out):
    """Fill `out` (5, 5) with weighted sums of products of 1, the slope along the step, the Laplacian, the squared slope
    over brightness, and the difference, over what both microimages show; with the first two projected out."""
    columns, rows, light = raster.columns, raster.rows, cutout.light
    slope_x, slope_y, laplacian = cutout.slope_x, cutout.slope_y, cutout.laplacian
    ax, ay, qx, qy = overlap.ax, overlap.ay, overlap.qx, overlap.qy
    out[:] = 0.0
    one = np.empty(5, np.float32)
    for at in range(overlap.start, overlap.start + overlap.number):
        x, y = columns[at], rows[at]
        own_2, other_2 = (x - ax) ** 2 + (y - ay) ** 2, (x - qx) ** 2 + (y - qy) ** 2
        if max(own_2, other_2) > overlap.r2 or x < overlap.low_x or x > overlap.high_x:
            continue
        if y < overlap.low_y or y > overlap.high_y:
            continue
        r = light[at] - shifted[at]
        one[0], one[1], one[2] = np.float32(1.0), overlap.ux * slope_x[at] + overlap.uy * slope_y[at], laplacian[at]
        one[3], one[4] = (slope_x[at] ** 2 + slope_y[at] ** 2) / max(light[at], dark), r
        w = scale2 / (scale2 + r * r)
        for k in range(5):
            for m in range(k, 5):
                out[k, m] += w * w * one[k] * one[m]
    for free in range(2):
        if out[free, free] <= 0:
            # Without slopes blur has no effect.
            out[:] = 0.0
            return
        for k in range(free + 1, 5):
            share = out[free, k] / out[free, free]
            for m in range(k, 5):
                out[k, m] -= share * out[free, m]


@njit(cache=True, nogil=True, error_model="numpy", share=lambda *given: len(given[8]))
def _compare_pairs(begin, end, image, centres, radius, pitch, rows, sizes, scale2, dark, lenses, out):
    """Fill `out` (m, d, 5, 5) with the `_products` of the pairs of `lenses` (m,) with known `sizes` (n, d), 0 for the
    others."""
    for number in range(begin, end):
        lens = lenses[number]
        out[number] = 0.0
        raster, flat = pixel_raster(radius), flat_pixels(image)
        buffers, cutout = new_buffers(raster.size), new_cutout(raster.size, True)
        ax, ay = centres[lens, 0], centres[lens, 1]
        left, top = first_pixel(ax, radius, raster.side, flat.width), first_pixel(ay, radius, raster.side, flat.height)
        cut_smoothed(flat, raster, left, top, buffers, cutout)
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            if other < 0 or np.isnan(sizes[lens, d]):
                continue
            overlap = resample_shifted(
                flat.pixels, (flat.height, flat.width), (raster.side, raster.stride), (left, top),
                (ax, ay, centres[other, 0], centres[other, 1]), radius, sizes[lens, d], pitch, buffers.box,
                buffers.lines, buffers.shifted, buffers.step,
            )  # fmt: skip
            limit = max(scale2[lens], scale2[other])
            _products(cutout, buffers.shifted, raster, overlap, limit, dark, out[number, d])


def estimate_defocus_difference(
    image: NDArray[np.float32],
    centres: NDArray[np.float32],
    radius: float,
    pitch: float,
    rows: NDArray[np.int32],
    sizes: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    kinds: NDArray[np.int8],
    settings: DefocusSettings = _DEFAULT,
) -> DefocusDifference:
    """What lenses of each type blur more than those of the others.

    Parameters
    ----------
    image : (H, W) float32
    centres : (n, 2) float32 [px]
    radius, pitch : float [px]
    rows : (n, d) int32
        One neighbour of each lens in `d` directions, -1 where there is none.
    sizes : (n, d) float32 [px]
        Patch sizes of pairs; NaN for pairs to leave out.
    scale : (n,) float32
        As for `fit_pairs`.
    noise : float
        Standard deviation of a pixel.
    kinds : (n,) int8
        Types of the lenses.
    settings : DefocusSettings
    """
    lenses = np.flatnonzero(np.isfinite(sizes).any(1))
    products = np.empty((len(lenses), rows.shape[1], 5, 5), np.float32)
    _compare_pairs(
        image, centres, np.float32(radius), np.float32(pitch), rows, sizes, (scale * scale).astype(np.float32),
        np.float32(settings.dark), lenses, products,
    )  # fmt: skip
    number, d = np.nonzero(products[:, :, 0, 0] > 4)
    lens, known = lenses[number], products[number, d].astype(np.float64)
    weight = 1 / (np.maximum(known[:, 4, 4], 0) / known[:, 0, 0] + noise**2)
    types, count = np.stack([kinds[lens], kinds[rows[lens, d]]]), int(kinds.max()) + 1
    sums = _Sums(np.zeros((count, count, 3, 3)), np.zeros((count, count, 2, 2)), np.zeros((count, count), np.int64))
    _add_pairs(known, weight, sizes[lens, d].astype(np.float64), types, sums)
    likely = np.array([settings.likely_difference * pitch**2, settings.likely_growth * pitch])
    blurs, growths = np.zeros((2, count, count), np.float32)
    curve = _solve(sums, 1 / likely**2, settings.fewest_pairs, settings.rounds, settings.steepest_curve, blurs, growths)
    return DefocusDifference(kinds, blurs, growths, np.float32(curve), np.float32(settings.dark))


# Sums over the pairs of each two of t types, weighted. `squares` (t, t, 3, 3) of products of Laplacian and squared
# slope, each with 1, s and s^2, `mixed` (t, t, 2, 2) of both with the difference, each with 1 and s; `number` (t, t) of
# pairs.
_Sums = namedtuple("_Sums", "squares mixed number")


@njit(cache=True, nogil=True, error_model="numpy")
def _add_pairs(known, weight, sizes, types, sums):
    """Add pairs of lens types (2, m), with their `_products` (m, 5, 5), weights and patch sizes (m,), to the sums."""
    squares, mixed = sums.squares, sums.mixed
    for k in range(len(weight)):
        low, high = min(types[0, k], types[1, k]), max(types[0, k], types[1, k])
        power, sign = weight[k], 1.0 if types[0, k] == low else -1.0
        sums.number[low, high] += 1
        for n in range(3):
            squares[low, high, 0, n] += power * known[k, 2, 2]
            squares[low, high, 1, n] += power * known[k, 2, 3]
            squares[low, high, 2, n] += power * known[k, 3, 3]
            if n < 2:
                mixed[low, high, 0, n] += sign * power * known[k, 2, 4]
                mixed[low, high, 1, n] += sign * power * known[k, 3, 4]
            power *= sizes[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(sums, ridge, fewest, rounds, steepest, blurs, growths):
    """Fill `blurs` and `growths` (t, t), return the tone curve; `ridge` (2,) is the prior inverse variance of both."""
    curve = 0.0
    # Blur and tone curve are estimated alternately, each from the residual of the other.
    for _ in range(rounds):
        left = slopes = 0.0
        for a in range(len(sums.number)):
            for b in range(a + 1, len(sums.number)):
                if sums.number[a, b] < fewest:
                    continue
                laplacian, both, slope = sums.squares[a, b, 0], sums.squares[a, b, 1], sums.squares[a, b, 2]
                joint = laplacian + 2 * curve * both + curve * curve * slope
                first, product, second = joint[0] + ridge[0], joint[1], joint[2] + ridge[1]
                right = sums.mixed[a, b, 0] + curve * sums.mixed[a, b, 1]
                determinant = first * second - product * product
                blur = (second * right[0] - product * right[1]) / determinant
                growth = (first * right[1] - product * right[0]) / determinant
                blurs[a, b], growths[a, b], blurs[b, a], growths[b, a] = blur, growth, -blur, -growth
                left += blur * sums.mixed[a, b, 1, 0] + growth * sums.mixed[a, b, 1, 1]
                left -= blur * blur * both[0] + 2 * blur * growth * both[1] + growth * growth * both[2]
                slopes += blur * blur * slope[0] + 2 * blur * growth * slope[1] + growth * growth * slope[2]
        curve = min(max(left / slopes, 0.0), steepest) if slopes > 0 else 0.0
    return curve
