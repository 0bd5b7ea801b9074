"""Sub-pixel patch size of every pair of neighbours: robust least squares on the pixels that both show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST, square

from ...flat.gray_flat import GrayFlat
from ...runtime.cache import cached
from ...runtime.scheduling import plan_chunks
from .defocus_difference import (
    NO_DIFFERENCE,
    DefocusDifference,
    add_tone_curve,
    estimate_defocus_difference,
    sample_start_values,
)
from .pair_pixels import NO_STEP, SPLINE_MARGIN, cut_smoothed, first_pixel, pixel_raster, resample_shifted

__all__ = ["LAST_STEP", "PairFits", "fit_pairs", "usable_radius"]

# Of white noise, the smoothed picture has this much of the energy in slopes of one direction; the difference between
# two pictures has the second.
_SLOPE_NOISE, _LEFT_NOISE = np.float32(17 / 144), np.float32(0.5)
# So much of the energy in slopes counts as texture in any case: noise itself is not known better.
_LEAST_TEXTURE = np.float32(0.25)
# Shading that correction leaves at the rim, as a share of the light: a calibration from one scene is off by so much.
_SHADED = np.float32(0.02)
# Each step may move this far [px]: the starting value is the best of a finer grid.
_MAX_STEP = np.float32(1.0)
#: Steps shrink, the faster the less of the texture is doubted: after this one [px] the next hardly shows.
LAST_STEP = 0.02
# A fit that has left its start by more than this [px] has gone over to another optimum.
_LEFT = np.float32(2.5)
# The cubic B-spline leaves a quarter of the energy of white noise, and all of it at low frequencies, where texture is.
# Of the frequencies at which noise has its own slopes it leaves less: the integral over all of them.
_CORRELATED, _CORRELATED_NOISE = np.float32(4.0), np.float32(1.62)
# Smoothing and slopes each read a pixel beyond [px]; small microimages give up the share of the pitch, and no less than
# the third number [px].
_RIM, _RIM_SHARE, _LEAST_RIM = 1.0, 0.03, 0.3
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


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _sums(own, slope_x, slope_y, other, columns, rows, placed, offset, scale2):
    """Sums over the pixels of a microimage that the other shows too, weighted after Geman and McClure.

    Those of weights, residuals, slopes, their products, the moments of place, and the sums and products of brightness
    that grows along the step from lens to lens.
    """
    start, count, ux, uy, ax, ay, qx, qy, mx, my, r2, low_x, high_x, low_y, high_y = placed
    zero = np.float32(0.0)
    sw = sr = srr = sp = spp = spr = sx = sy = sq = sqq = spq = sqr = zero
    first = np.uint64(start)
    for k in range(np.uint64(count)):
        at = first + k
        x, y = columns[at], rows[at]
        own_2 = (x - ax) * (x - ax) + (y - ay) * (y - ay)
        other_2 = (x - qx) * (x - qx) + (y - qy) * (y - qy)
        both = (max(own_2, other_2) <= r2) & (x >= low_x) & (x <= high_x) & (y >= low_y) & (y <= high_y)
        p = ux * slope_x[at] + uy * slope_y[at]
        r = own[at] - other[at] - offset
        q = (ux * (x - mx) + uy * (y - my)) * own[at]
        w = scale2 / (scale2 + r * r)
        w = w * w if both else zero
        wp, wq, wr = w * p, w * q, w * r
        wpp = wp * p
        sw += w
        sr += wr
        srr += wr * r
        sp += wp
        spr += wp * r
        spp += wpp
        sx += wpp * (x - mx)
        sy += wpp * (y - my)
        sq += wq
        sqq += wq * q
        spq += wq * p
        sqr += wq * r
    return sw, sr, srr, sp, spp, spr, sx, sy, sq, sqq, spq, sqr


@njit(cache=True, nogil=True, fastmath=FAST, forceinline=True)
def _fit(
    pixels, height, width, ax, ay, bx, by, radius, start, pitch, scale2, noise2, iterations, last_step, left, top, side,
    wide, columns, rows, own, slope_x, slope_y, bend, blur, growth, at, there, lines, between,
):  # fmt: skip
    """Patch size of one pair from `start`, its variance and its place; NaN where it cannot be told.

    The first microimage differs from the second by `blur`, and its `growth` per s, times `bend`, where there is any.
    """
    s = start
    slope_noise = _SLOPE_NOISE * (square(bx - ax) + square(by - ay)) / (pitch * pitch)
    offset = np.float32(0.0)
    variance = np.float32(np.inf)
    x = y = np.float32(0.0)
    two, tiny = np.float32(2.0), np.float32(1e-12)
    for _ in range(iterations):
        placed = resample_shifted(
            pixels, height, width, ax, ay, bx, by, radius, s, pitch, left, top, side, wide, at, there, lines, between
        )
        if len(bend) > 0:
            share, first = blur + growth * s, np.uint64(placed[0])
            for k in range(np.uint64(placed[1])):
                between[first + k] += share * bend[first + k]
        sw, sr, srr, sp, spp, spr, sx, sy, sq, sqq, spq, sqr = _sums(
            own, slope_x, slope_y, between, columns, rows, placed, offset, scale2
        )
        if sw < 4:
            return np.float32(np.nan), variance, x, y
        inverse = np.float32(1.0) / sw
        # Shading of r^2 changes by a ramp of this steepness from one lens to the other, as likely as noise beside it.
        ramp = two * _SHADED * s / (radius * radius)
        ridge = max(sqq - sq * sq * inverse + noise2 / max(ramp * ramp, tiny), tiny)
        shared, shade = spq - sp * sq * inverse, sqr - sq * sr * inverse
        hessian = spp - sp * sp * inverse - shared * shared / ridge
        if hessian <= 1e-9:
            return np.float32(np.nan), variance, x, y
        gradient = spr - sp * sr * inverse - shared * shade / ridge
        offset += sr * inverse
        rest = srr - sr * sr * inverse - shade * shade / ridge
        rest = max(rest - gradient * gradient / hessian, np.float32(0.0)) * inverse
        # Slopes of noise steepen the sum of squares, but do not move with the scene.
        texture = max(hessian - slope_noise * min(noise2, rest / _LEFT_NOISE) * sw, _LEAST_TEXTURE * hessian)
        step = gradient / texture
        variance = rest * (_CORRELATED * texture + _CORRELATED_NOISE * (hessian - texture)) / (texture * texture)
        x, y = sx / spp, sy / spp
        s += min(max(step, -_MAX_STEP), _MAX_STEP)
        if abs(step) < last_step:
            break
    if abs(s - start) > _LEFT:
        return np.float32(np.nan), variance, x, y
    return s, variance, x, y


@njit(cache=True, nogil=True, inline="always")
def _starts(first, second, near):
    """First values of the fits of a pair: one in the middle where both agree, or NaN where there is none."""
    first, second = second if np.isnan(first) else first, first if np.isnan(second) else second
    together = abs(first - second) < near
    middle = np.float32(0.5) * (first + second)
    return middle if together else first, middle if together else second, together


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _fit_pairs(
    image, centres, radius, pitch, rows, start, scale2, noise2, iterations, last_step, kinds, blurs, growths, curve,
    sizes, variances, places,
):  # fmt: skip  # fmt: skip
    side, wide, size, column, line = pixel_raster(radius)
    height, width = image.shape
    pixels = image.reshape(-1)
    parts, each, stride = plan_chunks(len(centres))
    for part in prange(parts):
        # All that sums run over is some number, also where it has not been set.
        own, slope_x, slope_y = np.zeros(size, np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)
        there, lines, between = np.zeros(size, np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)
        bend, at = np.zeros(size if len(kinds) else 0, np.float32), np.empty(2, np.int64)
        begin = part * stride % parts * each
        for lens in range(begin, min(begin + each, len(centres))):
            ax, ay = centres[lens, 0], centres[lens, 1]
            left, top = first_pixel(ax, radius, side, width), first_pixel(ay, radius, side, height)
            ready = False
            for d in range(rows.shape[1]):
                other = rows[lens, d]
                for k in range(2):
                    sizes[lens, d, k] = np.nan
                    variances[lens, d, k] = np.inf
                    places[lens, d, k, 0] = places[lens, d, k, 1] = 0.0
                if other < 0 or (np.isnan(start[lens]) and np.isnan(start[other])):
                    continue
                if not ready:
                    cut_smoothed(
                        pixels, height, width, left, top, side, wide, there, lines, own, slope_x, slope_y, bend
                    )
                    if len(bend) > 0:
                        add_tone_curve(own, slope_x, slope_y, curve, bend)
                    ready = True
                blur = growth = np.float32(0.0)
                if len(bend) > 0:
                    blur, growth = blurs[kinds[lens], kinds[other]], growths[kinds[lens], kinds[other]]
                first, second, together = _starts(start[lens], start[other], _COMMON_START * pitch)
                for k in range(2):
                    if k == 1 and together:
                        sizes[lens, d, 1] = sizes[lens, d, 0]
                        variances[lens, d, 1] = variances[lens, d, 0]
                        places[lens, d, 1, 0], places[lens, d, 1, 1] = places[lens, d, 0, 0], places[lens, d, 0, 1]
                        break
                    at[0] = at[1] = NO_STEP
                    s, variance, x, y = _fit(
                        pixels, height, width, ax, ay, centres[other, 0], centres[other, 1], radius,
                        first if k == 0 else second, pitch, max(scale2[lens], scale2[other]), noise2, iterations,
                        last_step, left, top, side, wide, column, line, own, slope_x, slope_y, bend, blur, growth, at,
                        there, lines, between,
                    )  # fmt: skip
                    sizes[lens, d, k] = s
                    variances[lens, d, k] = variance
                    places[lens, d, k, 0], places[lens, d, k, 1] = x, y


def usable_radius(gray: GrayFlat) -> float:
    """Radius [px] within which the pixels of a microimage, smoothed and with their slopes, are its own."""
    return gray.radius - min(_RIM, max(_RIM_SHARE * gray.pitch, _LEAST_RIM))


def fit_pairs(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    start: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    iterations: int,
    last_step: float = LAST_STEP,
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
        At most.
    last_step : float [px of `gray`]
        A step shorter than this is the last.
    """
    radius = usable_radius(gray)
    image = gray.image
    # Microimages are cut out with what lies about them.
    missing = [max(0, int(2 * radius) + 2 * SPLINE_MARGIN - n) for n in image.shape]
    if any(missing):
        image = np.pad(image, [(0, n) for n in missing], "edge")
    image, start = np.ascontiguousarray(image), start.astype(np.float32)
    shape = (*rows.shape, 2)

    def fit(start: NDArray[np.float32], blur: DefocusDifference) -> PairFits:
        fits = PairFits(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty((*shape, 2), np.float32))
        _fit_pairs(
            image, gray.centres, np.float32(radius), np.float32(gray.pitch), rows, start,
            (scale * scale).astype(np.float32), np.float32(noise * noise), iterations, np.float32(last_step),
            blur.kinds, blur.blurs, blur.growths, blur.curve, fits.patch_size, fits.variance, fits.place,
        )  # fmt: skip
        return fits

    def found_blur(kinds: NDArray[np.int8]) -> DefocusDifference:
        some = sample_start_values(start)
        sizes = fit(some, NO_DIFFERENCE).patch_size[:, :, 0]
        return estimate_defocus_difference(image, gray.centres, radius, gray.pitch, rows, sizes, scale, noise, kinds)

    kinds = gray.lens_type
    return fit(start, NO_DIFFERENCE if kinds is None else cached(gray, "blur", lambda: found_blur(kinds)))
