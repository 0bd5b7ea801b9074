"""How much more one lens blurs than the next, where lenses of several types are focused at different depths.

The sharper of two pictures of one place differs from the other by half the difference of the variances of both blurs
times its Laplacian. Blur widens with the distance from the depth in focus, so that the difference of two variances
grows evenly with s. Lenses add up light, and most files hold another curve of it: there the squared slope, over the
brightness, comes with the Laplacian. All of it is told by the pairs themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .pair_pixels import NO_STEP, cut_smoothed, first_pixel, pixel_raster, resample_shifted

__all__ = ["NO_DIFFERENCE", "DefocusDifference", "add_tone_curve", "estimate_defocus_difference", "sample_start_values"]

# About so many lenses tell it, by no fewer than so many pairs of two types.
_SAMPLE, _FEWEST = 120, 12
# Brightness below which slopes count as at this one.
_DARK = np.float32(0.05)
# Half the differences of variances are about so large [share of the squared pitch], and so is their growth per s / D.
_LIKELY, _LIKELY_GROWTH = 1e-3, 4e-3
# Curves of light are between none and this one: of light that grows with the square of a number, the squared slope over
# brightness comes once.
_STEEPEST = 4.0
_TURNS = 4


@dataclass(frozen=True)
class DefocusDifference:
    """What the lenses of one type blur more than those of another.

    Parameters
    ----------
    kinds : (n,) int8
        Types of the lenses; none where they make no difference.
    blurs, growths : (types, types) float32 [px^2, px]
        By how much of its bend a lens of the first type differs from one of the second, and its growth per s.
    curve : float32
        How much of the squared slope over brightness belongs to the Laplacian in that bend.
    """

    kinds: NDArray[np.int8]
    blurs: NDArray[np.float32]
    growths: NDArray[np.float32]
    curve: np.float32


#: For lenses that all blur alike.
NO_DIFFERENCE = DefocusDifference(
    np.empty(0, np.int8), np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32), np.float32(0.0)
)


def sample_start_values(start: NDArray[np.float32]) -> NDArray[np.float32]:
    """First values [px] of a sample of the lenses that have any, NaN for the others."""
    rows = np.flatnonzero(np.isfinite(start))
    some = np.full_like(start, np.nan)
    chosen = rows[:: max(1, len(rows) // _SAMPLE)]
    some[chosen] = start[chosen]
    return some


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def add_tone_curve(own, slope_x, slope_y, curve, bend):
    """Add so much of the squared slope over brightness to the Laplacian `bend`."""
    for k in range(len(bend)):
        bend[k] += curve * (slope_x[k] * slope_x[k] + slope_y[k] * slope_y[k]) / max(own[k], _DARK)


# Exact sums: with fast math they would have other bits where Numba compiles than where it loads.
@njit(cache=True, nogil=True, error_model="numpy")
def _products(own, slope_x, slope_y, bend, other, columns, rows, placed, scale2, out):
    """Fill `out` (5, 5) with sums of the products of 1, the slope along the step, the Laplacian, the squared slope over
    brightness, and the difference, over what both microimages show; less what the first two explain of the others."""
    start, count, ux, uy, ax, ay, qx, qy, _mx, _my, r2, low_x, high_x, low_y, high_y = placed
    out[:] = 0.0
    one = np.empty(5, np.float32)
    for at in range(start, start + count):
        x, y = columns[at], rows[at]
        own_2, other_2 = (x - ax) ** 2 + (y - ay) ** 2, (x - qx) ** 2 + (y - qy) ** 2
        if max(own_2, other_2) > r2 or x < low_x or x > high_x or y < low_y or y > high_y:
            continue
        r = own[at] - other[at]
        one[0], one[1], one[2] = np.float32(1.0), ux * slope_x[at] + uy * slope_y[at], bend[at]
        one[3], one[4] = (slope_x[at] ** 2 + slope_y[at] ** 2) / max(own[at], _DARK), r
        w = scale2 / (scale2 + r * r)
        for k in range(5):
            for m in range(k, 5):
                out[k, m] += w * w * one[k] * one[m]
    for free in range(2):
        if out[free, free] <= 0:
            # Without a slope nothing tells blur.
            out[:] = 0.0
            return
        for k in range(free + 1, 5):
            share = out[free, k] / out[free, free]
            for m in range(k, 5):
                out[k, m] -= share * out[free, m]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _compare(image, centres, radius, pitch, rows, sizes, scale2, lenses, out):
    """Fill `out` (m, d, 5, 5) with the `_products` of the pairs of `lenses` (m,) with known `sizes` (n, d), 0 for the
    others."""
    side, wide, size, column, line = pixel_raster(radius)
    height, width = image.shape
    pixels = image.reshape(-1)
    for number in prange(len(lenses)):
        lens = lenses[number]
        out[number] = 0.0
        own, slope_x, slope_y = np.zeros(size, np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)
        there, lines, between = np.zeros(size, np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)
        bend, at = np.zeros(size, np.float32), np.empty(2, np.int64)
        ax, ay = centres[lens, 0], centres[lens, 1]
        left, top = first_pixel(ax, radius, side, width), first_pixel(ay, radius, side, height)
        cut_smoothed(pixels, height, width, left, top, side, wide, there, lines, own, slope_x, slope_y, bend)
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            if other < 0 or np.isnan(sizes[lens, d]):
                continue
            at[0] = at[1] = NO_STEP
            placed = resample_shifted(
                pixels, height, width, ax, ay, centres[other, 0], centres[other, 1], radius, sizes[lens, d], pitch,
                left, top, side, wide, at, there, lines, between,
            )  # fmt: skip
            limit = max(scale2[lens], scale2[other])
            _products(own, slope_x, slope_y, bend, between, column, line, placed, limit, out[number, d])


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
) -> DefocusDifference:
    """What lenses of each type blur more than those of the others, as pairs of them tell.

    Parameters
    ----------
    image : (H, W) float32
    centres : (n, 2) float32 [px]
    radius, pitch : float [px]
    rows : (n, d) int32
        One neighbour of each lens in `d` directions, -1 where there is none.
    sizes : (n, d) float32 [px]
        Patch sizes of pairs; NaN for those that are not asked.
    scale : (n,) float32
        As for `fit_pairs`.
    noise : float
        Standard deviation of a pixel.
    kinds : (n,) int8
        Types of the lenses.
    """
    lenses = np.flatnonzero(np.isfinite(sizes).any(1))
    products = np.empty((len(lenses), rows.shape[1], 5, 5), np.float32)
    _compare(
        image, centres, np.float32(radius), np.float32(pitch), rows, sizes, (scale * scale).astype(np.float32), lenses,
        products,
    )  # fmt: skip
    number, d = np.nonzero(products[:, :, 0, 0] > 4)
    lens, known = lenses[number], products[number, d].astype(np.float64)
    weight = 1 / (np.maximum(known[:, 4, 4], 0) / known[:, 0, 0] + noise**2)
    likely = np.array([_LIKELY * pitch**2, _LIKELY_GROWTH * pitch])
    between = np.stack([kinds[lens], kinds[rows[lens, d]]])
    return DefocusDifference(
        kinds, *_solved(known, weight, sizes[lens, d].astype(np.float64), between, likely, int(kinds.max()) + 1)
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _add_pairs(known, weight, sizes, between, squares, crossed, number):
    """Add up the pairs of each two types, and their `number` (t, t).

    `squares` (t, t, 3, 3) are sums of the products of Laplacian and squared slope, each with 1, s and s^2, `crossed`
    (t, t, 2, 2) those of both with the difference, each with 1 and s.
    """
    for k in range(len(weight)):
        low, high = min(between[0, k], between[1, k]), max(between[0, k], between[1, k])
        power, sign = weight[k], 1.0 if between[0, k] == low else -1.0
        number[low, high] += 1
        for n in range(3):
            squares[low, high, 0, n] += power * known[k, 2, 2]
            squares[low, high, 1, n] += power * known[k, 2, 3]
            squares[low, high, 2, n] += power * known[k, 3, 3]
            if n < 2:
                crossed[low, high, 0, n] += sign * power * known[k, 2, 4]
                crossed[low, high, 1, n] += sign * power * known[k, 3, 4]
            power *= sizes[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(squares, crossed, number, ridge, blurs, growths):
    """Fill `blurs` and `growths` (t, t), return the curve of light; `ridge` (2,) holds both where pairs say little."""
    curve = 0.0
    # Blur and curve of light are told by turns, each from what the other leaves.
    for _ in range(_TURNS):
        left = slopes = 0.0
        for a in range(len(number)):
            for b in range(a + 1, len(number)):
                if number[a, b] < _FEWEST:
                    continue
                laplacian, both, slope = squares[a, b, 0], squares[a, b, 1], squares[a, b, 2]
                joint = laplacian + 2 * curve * both + curve * curve * slope
                first, mixed, second = joint[0] + ridge[0], joint[1], joint[2] + ridge[1]
                right = crossed[a, b, 0] + curve * crossed[a, b, 1]
                determinant = first * second - mixed * mixed
                blur = (second * right[0] - mixed * right[1]) / determinant
                growth = (first * right[1] - mixed * right[0]) / determinant
                blurs[a, b], growths[a, b], blurs[b, a], growths[b, a] = blur, growth, -blur, -growth
                left += blur * crossed[a, b, 1, 0] + growth * crossed[a, b, 1, 1]
                left -= blur * blur * both[0] + 2 * blur * growth * both[1] + growth * growth * both[2]
                slopes += blur * blur * slope[0] + 2 * blur * growth * slope[1] + growth * growth * slope[2]
        curve = min(max(left / slopes, 0.0), _STEEPEST) if slopes > 0 else 0.0
    return curve


def _solved(
    known: NDArray[np.float64],
    weight: NDArray[np.float64],
    sizes: NDArray[np.float64],
    between: NDArray[np.int8],
    likely: NDArray[np.float64],
    count: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], np.float32]:
    """Blurs, growths and curve of `DefocusDifference` from pairs.

    Parameters
    ----------
    known : (m, 5, 5)
        As `_products`.
    weight : (m,)
        Of each pair.
    sizes : (m,) [px]
        Their patch sizes.
    between : (2, m)
        Types of both lenses.
    likely : (2,) [px^2, px]
        Size of a blur, and of its growth.
    count : int
        Number of types.
    """
    squares, crossed = np.zeros((count, count, 3, 3)), np.zeros((count, count, 2, 2))
    number = np.zeros((count, count), np.int64)
    _add_pairs(known, weight, sizes, between, squares, crossed, number)
    blurs, growths = np.zeros((2, count, count), np.float32)
    curve = _solve(squares, crossed, number, 1 / likely**2, blurs, growths)
    return blurs, growths, np.float32(curve)
