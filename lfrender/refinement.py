"""Sub-pixel patch size of every pair of neighbours: robust least squares on the pixels that both show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .fastmath import FAST
from .radiance import GrayFlat
from .smoothing import smoothed

__all__ = ["PairFits", "fit_pairs"]

# Of white noise, the smoothed picture has this much of the energy in slopes of one direction; the difference between
# two pictures has the second.
_SLOPE_NOISE, _LEFT_NOISE = np.float32(17 / 144), np.float32(0.5)
# So much of the energy in slopes counts as texture in any case: noise itself is not known better.
_LEAST_TEXTURE = np.float32(0.25)
# Each step may move this far [px]: the starting value is the best of a finer grid.
_MAX_STEP = np.float32(1.0)
# Steps shrink with their square: after this one [px] the next would not show.
_SETTLED = 0.02
# A fit that has left its start by more than this [px] has gone over to another optimum.
_LEFT = np.float32(2.5)
# The cubic B-spline leaves a quarter of the energy of white noise, and all of it at low frequencies, where texture is.
# Of the frequencies at which noise has its own slopes it leaves less: the integral over all of them.
_CORRELATED, _CORRELATED_NOISE = np.float32(4.0), np.float32(1.62)
# Smoothing and slopes each read a pixel beyond [px]; small microimages give up no more than the share of the pitch.
_RIM, _RIM_SHARE = 1.0, 0.05
# Neighbours whose first values differ by less than this share of the pitch start from their mean.
_COMMON_START = np.float32(0.04)


@dataclass(frozen=True)
class PairFits:
    """Patch size measured between each lens and its neighbour in each of `d` directions.

    The last axis of all arrays tells which of the two lenses the fit has started from: 0 the lens
    itself, 1 the neighbour. Both are the same where the two agree about the first value.

    Parameters
    ----------
    patch_size : (n, d, 2) float32 [px]
        NaN where nothing was measured.
    variance : (n, d, 2) float32 [px^2]
        Of `patch_size`, as far as independent noise in the pixels explains it.
    place : (n, d, 2, 2) float32 [px]
        Where in the microimages it was measured: the mean, over texture, of the position between
        `delta` in the lens and `delta` in the neighbour (last axis `x, y`).
    """

    patch_size: NDArray[np.float32]
    variance: NDArray[np.float32]
    place: NDArray[np.float32]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _spline(f):
    """Weights of the four pixels at -1, 0, 1, 2 in the cubic B-spline at `f`.

    It smooths as much at any fraction as at 0, where its weights are those of `smoothed`; compared with a picture so
    smoothed it shifts a detail of w radians per pixel by less than w^5 / 1000 px. Linear interpolation shifts it
    by up to w^2 / 60 px, and so does Keys's cubic: by the same amount over the whole flat.
    """
    one, sixth, half = np.float32(1.0), np.float32(1 / 6), np.float32(0.5)
    g = one - f
    return (
        sixth * g * g * g,
        np.float32(2 / 3) - half * f * f * (one + g),
        np.float32(2 / 3) - half * g * g * (one + f),
        sixth * f * f * f,
    )


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _normal_equation(image, smooth, ax, ay, bx, by, radius, s, pitch, scale2, offset, line, steps):
    """Sums for a change of s and of the offset between two microimages, weighted after Geman and McClure.

    Returns the sums of weights, residuals, slopes, their products, and the moments of place.
    """
    height, width = image.shape
    ex, ey = bx - ax, by - ay
    ux, uy = ex / pitch, ey / pitch
    tx, ty = ex + s * ux, ey + s * uy
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    cx0, cx1, cx2, cx3 = _spline(np.float32(tx - x0))
    cy0, cy1, cy2, cy3 = _spline(np.float32(ty - y0))
    hx, hy = np.float32(0.5) * ux, np.float32(0.5) * uy
    r2 = radius * radius
    qx, qy = bx - tx, by - ty
    mx, my = np.float32(0.5) * (ax + qx), np.float32(0.5) * (ay + qy)
    zero = np.float32(0.0)
    sw = sr = srr = sp = spp = spr = sx = sy = zero
    top = max(int(np.ceil(max(ay, qy) - radius)), max(1, 1 - y0))
    bottom = min(int(np.floor(min(ay, qy) + radius)), min(height - 2, height - 3 - y0))
    for y in range(top, bottom + 1):
        ha = r2 - (y - ay) * (y - ay)
        hb = r2 - (y - qy) * (y - qy)
        if ha <= 0 or hb <= 0:
            continue
        ha, hb = np.sqrt(ha), np.sqrt(hb)
        left = max(int(np.ceil(max(ax - ha, qx - hb))), max(1, 1 - x0))
        right = min(int(np.floor(min(ax + ha, qx + hb))), min(width - 2, width - 3 - x0))
        n = right - left + 1
        if n <= 0:
            continue
        above = smooth[y - 1, left : right + 1]
        before = smooth[y, left - 1 : right]
        row = smooth[y, left : right + 1]
        behind = smooth[y, left + 1 : right + 2]
        below = smooth[y + 1, left : right + 1]
        r0 = image[y + y0 - 1, left + x0 - 1 : right + x0 + 3]
        r1 = image[y + y0, left + x0 - 1 : right + x0 + 3]
        r2_ = image[y + y0 + 1, left + x0 - 1 : right + x0 + 3]
        r3 = image[y + y0 + 2, left + x0 - 1 : right + x0 + 3]
        for k in range(n + 3):
            line[k] = cy0 * r0[k] + cy1 * r1[k] + cy2 * r2_[k] + cy3 * r3[k]
        # One view for each offset: an index like k + 1 may wrap round, which no vector loop can.
        line0, line1, line2, line3 = line[:n], line[1 : n + 1], line[2 : n + 2], line[3 : n + 3]
        dy = np.float32(y - my)
        dx = np.float32(left - mx)
        rowpp = zero
        for k in range(n):
            b = cx0 * line0[k] + cx1 * line1[k] + cx2 * line2[k] + cx3 * line3[k]
            p = hx * (behind[k] - before[k]) + hy * (below[k] - above[k])
            r = row[k] - b - offset
            w = scale2 / (scale2 + r * r)
            w = w * w
            wp = w * p
            wpp = wp * p
            sw += w
            sr += w * r
            srr += w * r * r
            sp += wp
            spr += wp * r
            rowpp += wpp
            sx += wpp * (dx + steps[k])
        spp += rowpp
        sy += rowpp * dy
    return sw, sr, srr, sp, spp, spr, sx, sy


@njit(cache=True, nogil=True, fastmath=FAST, forceinline=True)
def _fit(image, smooth, ax, ay, bx, by, radius, start, pitch, scale2, noise2, iterations, line, steps):
    """Patch size of one pair from `start`, its variance and its place; NaN where it cannot be told."""
    s = start
    slope_noise = _SLOPE_NOISE * ((bx - ax) ** 2 + (by - ay) ** 2) / (pitch * pitch)
    offset = np.float32(0.0)
    variance = np.float32(np.inf)
    x = y = np.float32(0.0)
    for _ in range(iterations):
        sw, sr, srr, sp, spp, spr, sx, sy = _normal_equation(
            image, smooth, ax, ay, bx, by, radius, s, pitch, scale2, offset, line, steps
        )
        if sw < 4:
            return np.float32(np.nan), variance, x, y
        inverse = np.float32(1.0) / sw
        hessian = spp - sp * sp * inverse
        if hessian <= 1e-9:
            return np.float32(np.nan), variance, x, y
        gradient = spr - sp * sr * inverse
        offset += sr * inverse
        left = max(srr - sr * sr * inverse - gradient * gradient / hessian, np.float32(0.0)) * inverse
        # Slopes of noise steepen the sum of squares, but do not move with the scene.
        texture = max(hessian - slope_noise * min(noise2, left / _LEFT_NOISE) * sw, _LEAST_TEXTURE * hessian)
        step = gradient / texture
        variance = left * (_CORRELATED * texture + _CORRELATED_NOISE * (hessian - texture)) / (texture * texture)
        x, y = sx / spp, sy / spp
        s += min(max(step, -_MAX_STEP), _MAX_STEP)
        if abs(step) < _SETTLED:
            break
    if abs(s - start) > _LEFT:
        return np.float32(np.nan), variance, x, y
    return s, variance, x, y


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _fit_pairs(
    image, smooth, centres, radius, pitch, rows, start, scale2, noise2, iterations, sizes, variances, places
):  # fmt: skip
    # Whole numbers are slow to convert inside a vector loop.
    steps = np.arange(2 * int(radius) + 8).astype(np.float32)
    for lens in prange(len(centres)):
        line = np.empty(len(steps), np.float32)
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            for side in range(2):
                sizes[lens, d, side] = np.nan
                variances[lens, d, side] = np.inf
                places[lens, d, side, 0] = places[lens, d, side, 1] = 0.0
            if other < 0:
                continue
            first, second = start[lens], start[other]
            if np.isnan(first):
                first = second
            if np.isnan(second):
                second = first
            if np.isnan(first):
                continue
            together = abs(first - second) < _COMMON_START * pitch
            if together:
                first = second = np.float32(0.5) * (first + second)
            for side in range(2):
                if side == 1 and together:
                    sizes[lens, d, 1] = sizes[lens, d, 0]
                    variances[lens, d, 1] = variances[lens, d, 0]
                    places[lens, d, 1, 0], places[lens, d, 1, 1] = places[lens, d, 0, 0], places[lens, d, 0, 1]
                    break
                s, variance, x, y = _fit(
                    image, smooth, centres[lens, 0], centres[lens, 1], centres[other, 0], centres[other, 1], radius,
                    first if side == 0 else second, pitch, max(scale2[lens], scale2[other]), noise2, iterations, line,
                    steps,
                )  # fmt: skip
                sizes[lens, d, side] = s
                variances[lens, d, side] = variance
                places[lens, d, side, 0], places[lens, d, side, 1] = x, y


def fit_pairs(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    start: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    iterations: int,
) -> PairFits:
    """Patch size of each pair of neighbours by Gauss-Newton steps.

    Parameters
    ----------
    gray : GrayFlat
    rows : (n, d) int32
        One neighbour of each lens in `d` directions, -1 where there is none: every pair once.
    start : (n,) float32 [px of `gray`]
        First values, NaN for lenses without one; pairs of two such lenses are left out.
    scale : (n,) float32
        Difference of brightness beyond which two pixels hardly count as the same point.
    noise : float
        Standard deviation of a pixel, at most: where pairs agree better, it is less.
    iterations : int
    """
    known = np.isfinite(start)
    smooth = smoothed(gray, known | (known[rows] & (rows >= 0)).any(1))
    radius = gray.radius - min(_RIM, _RIM_SHARE * gray.pitch)
    shape = (*rows.shape, 2)
    fits = PairFits(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty((*shape, 2), np.float32))
    _fit_pairs(
        gray.image, smooth, gray.centres, np.float32(radius), np.float32(gray.pitch), rows,
        start.astype(np.float32), (scale * scale).astype(np.float32), np.float32(noise * noise), iterations,
        fits.patch_size, fits.variance, fits.place,
    )  # fmt: skip
    return fits
