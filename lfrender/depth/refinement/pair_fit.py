"""Sub-pixel patch size of every pair of neighbours: robust least squares on the pixels that both
show.

Gauss-Newton steps on the shift along the line between both lenses (Lucas and Kanade, An iterative
image registration technique, 1981), weighted after Geman and McClure. Nuisance parameters between
both microimages are a constant and a ramp of brightness. Lenses of two types differ in blur: by
half the difference of its variances times the Laplacian, and where light is stored by a tone curve
by the squared slope over the brightness too; both are nuisance parameters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel, square

from ...flat.gray_flat import GrayFlat
from ..same_surface import TOLERANCE, same_surface
from .pair_pixels import (
    NO_STEP,
    SPLINE_MARGIN,
    cut_smoothed,
    first_pixel,
    pixel_raster,
    resample_shifted,
)

__all__ = ["PairFits", "fit_pairs"]


class PairFits(NamedTuple):
    """Patch size measured between each lens and its neighbour in each of `d` directions.

    The third axis of all arrays tells from whose start value the fit began: 0 the lens itself, 1
    the neighbour. Both fits are the same where the two start values agree.
    """

    patch_size: NDArray[np.float32]  # (n, d, 2) [px]; NaN where nothing was measured
    variance: NDArray[
        np.float32
    ]  # (n, d, 2) [px^2] from the residuals as if they were independent noise
    # (n, d, 2, 2) [px] where it was measured, order `x, y`: the mean, weighted by texture, of the
    # position between `delta` in the lens and `delta` in the neighbour
    place: NDArray[np.float32]


# [px] farther from its start a fit has gone over to another optimum.
_LARGEST_DRIFT = np.float32(2.5)


# Python's error model checks every division for zero, which prevents vector loops.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _sums(light, slope_x, slope_y, laplacian, other, columns, rows, overlap, offset, scale2):
    """Sums over the pixels of a microimage that the other shows too, weighted after Geman and
    McClure.

    Of weights, residuals, slopes, their products, the moments of place, brightness that grows along
    the step from lens to lens, and unless it is None the Laplacian, and the squared slope over the
    brightness.
    """
    start, count, ux, uy, ax, ay, qx, qy, mx, my, r2, low_x, high_x, low_y, high_y = overlap
    zero = np.float32(0.0)
    sw = sr = srr = sp = spp = spr = sx = sy = sq = sqq = spq = sqr = sl = sll = spl = sql = slr = (
        zero
    )
    st = stt = spt = sqt = slt = srt = zero
    first = np.uint64(start)
    for k in range(np.uint64(count)):
        at = first + k
        x = columns[at]
        y = rows[at]
        own_2 = (x - ax) * (x - ax) + (y - ay) * (y - ay)
        other_2 = (x - qx) * (x - qx) + (y - qy) * (y - qy)
        both = (
            (max(own_2, other_2) <= r2)
            & (x >= low_x)
            & (x <= high_x)
            & (y >= low_y)
            & (y <= high_y)
        )
        p = ux * slope_x[at] + uy * slope_y[at]
        r = light[at] - other[at] - offset
        q = (ux * (x - mx) + uy * (y - my)) * light[at]
        w = scale2 / (scale2 + r * r)
        w = w * w if both else zero
        wp = w * p
        wq = w * q
        wr = w * r
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
        if laplacian is not None:
            wl = w * laplacian[at]
            sl += wl
            sll += wl * laplacian[at]
            spl += wl * p
            sql += wl * q
            slr += wl * r
            # Below a brightness of 0.04 tone curves are linear, as that of sRGB.
            t = (slope_x[at] * slope_x[at] + slope_y[at] * slope_y[at]) / max(
                light[at], np.float32(0.04)
            )
            wt = w * t
            st += wt
            stt += wt * t
            spt += wt * p
            sqt += wt * q
            slt += wt * laplacian[at]
            srt += wt * r
    return (
        sw,
        sr,
        srr,
        sp,
        spp,
        spr,
        sx,
        sy,
        sq,
        sqq,
        spq,
        sqr,
        (sl, sll, spl, sql, slr),
        (st, stt, spt, sqt, slt, srt),
    )


# Arrays are passed one by one, although there are many: taken out of tuples here, their references
# would be counted for every pair, which costs a third of the time.
@njit(fastmath=FAST, forceinline=True)
def _fit_pair(
    pixels,
    size,
    shape,
    columns,
    rows,
    corner,
    centres,
    radius,
    pitch,
    start,
    scale2,
    light,
    slope_x,
    slope_y,
    laplacian,
    box,
    lines,
    shifted,
    whole,
    noise2,
    iterations,
    last_step,
):
    """Patch size of one pair from `start`, its variance and its place; NaN where it cannot be
    determined.
    """
    s = start
    ax, ay, bx, by = centres
    # Energy of smoothed white noise in slopes, 17 / 144 per direction.
    slope_noise = np.float32(17 / 144) * (square(bx - ax) + square(by - ay)) / (pitch * pitch)
    offset = x = y = np.float32(0.0)
    variance = np.float32(np.inf)
    failed = np.float32(np.nan)
    tiny = np.float32(1e-12)
    # Half differences of blur variances are 0.002 pitch^2 in the mean.
    blur_prior = noise2 / square(np.float32(2e-3) * pitch * pitch)
    for _ in range(iterations):
        overlap = resample_shifted(
            pixels, size, shape, corner, centres, radius, s, pitch, box, lines, shifted, whole
        )
        sw, sr, srr, sp, spp, spr, sx, sy, sq, sqq, spq, sqr, of_l, of_t = _sums(
            light, slope_x, slope_y, laplacian, shifted, columns, rows, overlap, offset, scale2
        )
        if sw < 4:
            return failed, variance, x, y
        inverse = np.float32(1.0) / sw
        # A calibration from one scene leaves shading of 2 % at the rim. A change by r^2 is a ramp
        # of this steepness between both lenses; its prior is as wide.
        ramp = np.float32(0.04) * s / (radius * radius)
        ridge = max(sqq - sq * sq * inverse + noise2 / max(ramp * ramp, tiny), tiny)
        shared = spq - sp * sq * inverse
        shade = sqr - sq * sr * inverse
        hessian = spp - sp * sp * inverse - shared * shared / ridge
        gradient = spr - sp * sr * inverse - shared * shade / ridge
        rest = srr - sr * sr * inverse - shade * shade / ridge
        if laplacian is not None:
            (sl, sll, spl, sql, slr), (st, stt, spt, sqt, slt, srt) = of_l, of_t
            ql = sql - sq * sl * inverse
            qt = sqt - sq * st * inverse
            ll = max(sll - sl * sl * inverse - ql * ql / ridge + blur_prior, tiny)
            lp = spl - sl * sp * inverse - ql * shared / ridge
            lr = slr - sl * sr * inverse - ql * shade / ridge
            lt = slt - sl * st * inverse - ql * qt / ridge
            tt = max(stt - st * st * inverse - qt * qt / ridge - lt * lt / ll + blur_prior, tiny)
            tp = spt - st * sp * inverse - qt * shared / ridge - lt * lp / ll
            tr = srt - st * sr * inverse - qt * shade / ridge - lt * lr / ll
            hessian -= lp * lp / ll + tp * tp / tt
            gradient -= lp * lr / ll + tp * tr / tt
            rest -= lr * lr / ll + tr * tr / tt
        if hessian <= 1e-9:
            return failed, variance, x, y
        offset += sr * inverse
        rest = max(rest - gradient * gradient / hessian, np.float32(0.0)) * inverse
        # Slopes of noise steepen the sum of squares, but do not move with the scene.
        noise = slope_noise * min(noise2, np.float32(2) * rest) * sw
        texture = hessian * hessian / (hessian + noise)
        step = gradient / texture
        # Pixels per independent one after the B-spline, at low frequencies and at those where the
        # slopes are noise.
        variance = (
            rest
            * (np.float32(4) * texture + np.float32(1.62) * (hessian - texture))
            / square(texture)
        )
        x = sx / spp
        y = sy / spp
        s += min(max(step, -_LARGEST_DRIFT), _LARGEST_DRIFT)
        if abs(step) < last_step:
            break
    if abs(s - start) > _LARGEST_DRIFT:
        return failed, variance, x, y
    return s, variance, x, y


@kernel(error_model="numpy", share=lambda image, centres, *_: len(centres))
def _fit_pairs(
    begin,
    end,
    image,
    centres,
    radius,
    pitch,
    rows,
    start,
    scale2,
    limits,
    kinds,
    sizes,
    variances,
    places,
):
    """Fit the pairs of each lens with its neighbours in `rows`; lenses blur alike if `kinds` is
    None; last come `PairFits`.
    """
    side, stride, size, columns, raster_rows = pixel_raster(radius)
    pixels, (height, width), (noise2, iterations, last_step) = (
        image.reshape(-1),
        image.shape,
        limits,
    )
    # Vector loops read values that have not been set: these must be numbers.
    light = np.zeros(size, np.float32)
    slope_x = np.zeros(size, np.float32)
    slope_y = np.zeros(size, np.float32)
    box = np.zeros(size, np.float32)
    lines = np.zeros(size, np.float32)
    shifted = np.zeros(size, np.float32)
    laplacian = None if kinds is None else np.zeros(size, np.float32)
    whole = np.full(2, NO_STEP)
    for lens in range(begin, end):
        ax = centres[lens, 0]
        ay = centres[lens, 1]
        left = first_pixel(ax, radius, side, width)
        top = first_pixel(ay, radius, side, height)
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
                    pixels,
                    height,
                    width,
                    side,
                    stride,
                    left,
                    top,
                    box,
                    lines,
                    light,
                    slope_x,
                    slope_y,
                    laplacian,
                )
                ready, whole[:] = True, NO_STEP
            # Start values of two fits, or the mean of what is one surface.
            first = start[lens]
            second = start[other]
            first, second = (
                second if np.isnan(first) else first,
                first if np.isnan(second) else second,
            )
            together = same_surface(first, second, np.float32(TOLERANCE) * pitch)
            if together:
                first = np.float32(0.5) * (first + second)
            for k in range(1 if together else 2):
                s, variance, x, y = _fit_pair(
                    pixels,
                    (height, width),
                    (side, stride),
                    columns,
                    raster_rows,
                    (left, top),
                    (ax, ay, centres[other, 0], centres[other, 1]),
                    radius,
                    pitch,
                    first if k == 0 else second,
                    max(scale2[lens], scale2[other]),
                    light,
                    slope_x,
                    slope_y,
                    laplacian,
                    box,
                    lines,
                    shifted,
                    whole,
                    noise2,
                    iterations,
                    last_step,
                )
                sizes[lens, d, k], variances[lens, d, k] = s, variance
                places[lens, d, k, 0], places[lens, d, k, 1] = x, y
            if together:
                sizes[lens, d, 1], variances[lens, d, 1] = sizes[lens, d, 0], variances[lens, d, 0]
                places[lens, d, 1, 0], places[lens, d, 1, 1] = (
                    places[lens, d, 0, 0],
                    places[lens, d, 0, 1],
                )


def fit_pairs(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    start: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    iterations: int,
    last_step: float = 0.02,
) -> PairFits:
    """Patch size of each pair of neighbours, `rows` (n, d), by Gauss-Newton steps, `iterations` at
    most.

    Pairs of two lenses without a `start` value (n,) [px], NaN, are left out. Beyond a difference of
    brightness of `scale` (n,) two pixels hardly show the same point. `noise` is the standard
    deviation of a pixel, at most. A step below `last_step` [px] ends the fit.
    """
    # Detail finer than a 25th of a pitch would show the difference of focus of two lenses instead
    # of the depth.
    factor = max(1, round(gray.pitch / 25)) if gray.lens_type is not None else 1
    gray = gray.downsampled(factor)
    start = (start / factor).astype(np.float32)
    noise = noise / factor
    # At the rim smoothing and slopes read beyond the microimage.
    radius = gray.radius - max(0.03 * gray.pitch, 0.3)
    image = gray.image
    # Microimages are cut out with the pixels beside them.
    missing = [max(0, int(2 * radius) + 2 * SPLINE_MARGIN - n) for n in image.shape]
    if any(missing):
        image = np.pad(image, [(0, n) for n in missing], "edge")
    limits = np.float32(noise**2), iterations, np.float32(last_step)
    shape = (*rows.shape, 2)
    fits = PairFits(
        np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty((*shape, 2), np.float32)
    )
    _fit_pairs(
        np.ascontiguousarray(image),
        gray.centres,
        np.float32(radius),
        np.float32(gray.pitch),
        rows,
        start,
        (scale * scale).astype(np.float32),
        limits,
        gray.lens_type,
        *fits,
    )
    return (
        PairFits(fits.patch_size * factor, fits.variance * factor**2, fits.place * factor)
        if factor > 1
        else fits
    )
