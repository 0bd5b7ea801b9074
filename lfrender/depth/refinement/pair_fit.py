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
from .least_squares import geman_mcclure, solve_symmetric
from .pair_pixels import (
    COLUMN,
    LAPLACIAN,
    LIGHT,
    NO_STEP,
    ROW,
    SHIFTED,
    SLOPE_X,
    SLOPE_Y,
    SPLINE_MARGIN,
    Pair,
    cut_smoothed,
    first_pixel,
    pixel_raster,
    resample_shifted,
    work_memory,
)

__all__ = ["PairFits", "fit_pairs"]


class PairFits(NamedTuple):
    """Patch size measured between each lens and its neighbour in each of `d` directions.

    The third axis of all arrays tells from whose start value the fit began: 0 the lens itself, 1
    the neighbour. Both fits are the same where the two start values agree.
    """

    patch_size: NDArray[np.float32]  # (n, d, 2) [px]; NaN where nothing was measured
    # (n, d, 2) [px^2] from the residuals as if they were independent noise
    variance: NDArray[np.float32]
    # (n, d, 2, 2) [px] where it was measured, order `x, y`: the mean, weighted by texture, of the
    # position between `delta` in the lens and `delta` in the neighbour
    place: NDArray[np.float32]


class _Settings(NamedTuple):
    """What the fits of all pairs have in common."""

    radius: np.float32  # [px]
    pitch: np.float32  # [px]
    noise2: np.float32  # [white^2] variance of a pixel
    iterations: int
    last_step: np.float32  # [px] a shorter step ends a fit


class _Fit(NamedTuple):
    """Patch size of one pair [px], its variance and its place."""

    size: np.float32
    variance: np.float32
    x: np.float32
    y: np.float32


class _Flat(NamedTuple):
    """The flat that is fitted."""

    image: NDArray[np.float32]  # (H, W)
    hidden: NDArray[np.bool_]  # (H, W) pixels that do not count; (0, 0) if all do


# Brightness of pixels that do not count: so far from all others that their weight is zero. Nearer,
# products with it are subnormal numbers, with which processors take thirty times as long.
_NO_LIGHT = np.float32(1e12)
# [px] farther from its start a fit has gone over to another optimum.
_LARGEST_DRIFT = np.float32(2.5)
# A calibration from one scene leaves shading of 2 % at the rim. A change by r^2 is a ramp of this
# steepness between both lenses [per squared radius and px of patch size]; its prior is as wide.
_SHADING_RAMP = np.float32(0.04)
# Half differences of blur variances are this large in the mean [pitch^2].
_BLUR_DIFFERENCE = np.float32(2e-3)
# Below this brightness tone curves are linear, as that of sRGB.
_LINEAR_TONE = np.float32(0.04)
# Energy of smoothed white noise in slopes, per direction.
_NOISE_OF_SLOPES = np.float32(17 / 144)
# Pixels per independent one after the B-spline, at low frequencies and at those where the slopes
# are noise.
_SMOOTHED = np.float32(4)
_SMOOTHED_NOISE = np.float32(1.62)

# Terms of the linear equation of a pixel, `residual = slope * step + nuisances`: the residual, the
# slope along the step from lens to lens, the constant, the ramp, and with two types of lenses the
# Laplacian of blur and the tone curve.
_RESIDUAL, _SLOPE, _CONSTANT, _RAMP, _BLUR, _TONE = range(6)


@njit(fastmath=FAST, inline="always")
def _add_products(sums, factor, terms):
    """Add the products of a factor with the four first terms to four sums."""
    residual, slope, constant, ramp = sums
    return (
        residual + factor * terms[_RESIDUAL],
        slope + factor * terms[_SLOPE],
        constant + factor * terms[_CONSTANT],
        ramp + factor * terms[_RAMP],
    )


# Python's error model checks every division for zero, which prevents vector loops.
@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _sum_products(work, overlap, offset, scale2, types, sums):
    """Fill the lower triangle of `sums` (m, m) with the products of the terms of the linear
    equations, summed over the pixels that both lenses show, weighted after Geman and McClure.

    The residual is the difference of brightness less an `offset`. Returns the mean place [px] from
    the middle between both microimages, weighted by squared slopes. Lenses blur alike if `types` is
    None.
    """
    zero = np.float32(0)
    one = np.float32(1)
    middle_x = np.float32(0.5) * (overlap.ax + overlap.qx)
    middle_y = np.float32(0.5) * (overlap.ay + overlap.qy)
    of_residual = of_slope = of_constant = of_ramp = of_blur = of_tone = (zero, zero, zero, zero)
    blur2 = tone2 = both2 = place_x = place_y = zero
    first = np.uint64(overlap.start)
    for k in range(np.uint64(overlap.places)):
        at = first + k
        x = work[COLUMN, at]
        y = work[ROW, at]
        own2 = (x - overlap.ax) * (x - overlap.ax) + (y - overlap.ay) * (y - overlap.ay)
        other2 = (x - overlap.qx) * (x - overlap.qx) + (y - overlap.qy) * (y - overlap.qy)
        both = (
            (max(own2, other2) <= overlap.radius2)
            & (x >= overlap.low_x)
            & (x <= overlap.high_x)
            & (y >= overlap.low_y)
            & (y <= overlap.high_y)
        )
        x -= middle_x
        y -= middle_y
        light = work[LIGHT, at]
        residual = light - work[SHIFTED, at] - offset
        ramp = (overlap.ux * x + overlap.uy * y) * light
        slope = overlap.ux * work[SLOPE_X, at] + overlap.uy * work[SLOPE_Y, at]
        weight = geman_mcclure(residual * residual, scale2)
        weight = weight if both else zero
        terms = (residual, slope, one, ramp)
        of_constant = _add_products(of_constant, weight, terms)
        of_ramp = _add_products(of_ramp, weight * ramp, terms)
        of_slope = _add_products(of_slope, weight * slope, terms)
        of_residual = _add_products(of_residual, weight * residual, terms)
        place_x += weight * slope * slope * x
        place_y += weight * slope * slope * y
        if types is not None:
            blur = work[LAPLACIAN, at]
            squares = work[SLOPE_X, at] * work[SLOPE_X, at] + work[SLOPE_Y, at] * work[SLOPE_Y, at]
            tone = squares / max(light, _LINEAR_TONE)
            of_blur = _add_products(of_blur, weight * blur, terms)
            of_tone = _add_products(of_tone, weight * tone, terms)
            blur2 += weight * blur * blur
            both2 += weight * blur * tone
            tone2 += weight * tone * tone
    # The compiler unrolls these loops, and leaves out sums that nobody reads.
    rows = (of_residual, of_slope, of_constant, of_ramp)
    for i in range(len(rows)):
        for j in range(i + 1):
            sums[i, j] = rows[i][j]
    if types is not None:
        for j in range(len(rows)):
            sums[_BLUR, j] = of_blur[j]
            sums[_TONE, j] = of_tone[j]
        sums[_BLUR, _BLUR] = blur2
        sums[_TONE, _BLUR] = both2
        sums[_TONE, _TONE] = tone2
    return place_x / of_slope[_SLOPE], place_y / of_slope[_SLOPE]


@njit(error_model="numpy", forceinline=True)
def _fit_pair(pixels, shape, raster, corner, pair, start, scale2, settings, types, memory):
    """Fit one pair from `start`; the patch size is NaN where it cannot be determined.

    `memory` is that of the pixels, the normal equations, the inverse variances of their terms, and
    the step of `resample_shifted`.
    """
    work, sums, priors, box_step = memory
    pitch = pair.pitch
    noise2 = settings.noise2
    steps2 = (square(pair.bx - pair.ax) + square(pair.by - pair.ay)) / (pitch * pitch)
    slope_noise = _NOISE_OF_SLOPES * steps2
    s = start
    offset = np.float32(0)
    x = np.float32(0)
    y = np.float32(0)
    variance = np.float32(np.inf)
    failed = np.float32(np.nan)
    for _ in range(settings.iterations):
        overlap = resample_shifted(pixels, shape, raster, corner, pair, s, work, box_step)
        at_x, at_y = _sum_products(work, overlap, offset, scale2, types, sums)
        weight = sums[_CONSTANT, _CONSTANT]
        if weight < 4:
            return _Fit(failed, variance, x, y)
        change = sums[_CONSTANT, _RESIDUAL] / weight

        ramp = _SHADING_RAMP * s / (pair.radius * pair.radius)
        priors[_RAMP] = noise2 / max(ramp * ramp, np.float32(1e-12))
        solve_symmetric(sums, priors, _CONSTANT)
        hessian = sums[_SLOPE, _SLOPE]
        gradient = sums[_SLOPE, _RESIDUAL]
        if hessian <= np.float32(1e-9):
            return _Fit(failed, variance, x, y)
        offset += change
        rest = max(sums[_RESIDUAL, _RESIDUAL] - gradient * gradient / hessian, np.float32(0))
        rest /= weight

        # Slopes of noise steepen the sum of squares, but do not move with the scene.
        noise = slope_noise * min(noise2, np.float32(2) * rest) * weight
        texture = hessian * hessian / (hessian + noise)
        step = gradient / texture
        shared = _SMOOTHED * texture + _SMOOTHED_NOISE * (hessian - texture)
        variance = rest * shared / square(texture)
        s += min(max(step, -_LARGEST_DRIFT), _LARGEST_DRIFT)
        x = at_x
        y = at_y
        if abs(step) < settings.last_step:
            break
    if abs(s - start) > _LARGEST_DRIFT:
        s = failed
    return _Fit(s, variance, x, y)


@njit(inline="always")
def _start_values(own, other, gap):
    """Start values of the two fits of a pair: that of each lens, or the mean of one surface."""
    if np.isnan(own):
        own = other
    if np.isnan(other):
        other = own
    if same_surface(own, other, gap):
        own = np.float32(0.5) * (own + other)
        other = own
    return own, other


@njit(error_model="numpy")
def _hide(hidden, raster, corner, work):
    """Take the weight of `hidden` pixels (H, W) of a microimage that is cut out."""
    left, top = corner
    for row in range(raster.side):
        for column in range(raster.side):
            if hidden[top + row, left + column]:
                work[LIGHT, row * raster.stride + column] = _NO_LIGHT


@kernel(error_model="numpy", share=lambda flat, centres, *_: len(centres))
def _fit_pairs(
    begin, end, flat: _Flat, centres, types, rows, start, scale2, settings: _Settings, fits
):
    """Fit the pairs of each lens with its neighbours in `rows`, and write them into `PairFits`;
    lenses blur alike if `types` is None.
    """
    sizes, variances, places = fits
    radius = settings.radius
    pitch = settings.pitch
    gap = np.float32(TOLERANCE) * pitch
    raster = pixel_raster(radius)
    work = work_memory(raster)
    terms = 4 if types is None else 6
    sums = np.zeros((terms, terms), np.float32)
    priors = np.zeros(terms, np.float32)
    if types is not None:
        priors[_BLUR:] = settings.noise2 / square(_BLUR_DIFFERENCE * pitch * pitch)
    box_step = np.full(2, NO_STEP)
    memory = work, sums, priors, box_step
    pixels = flat.image.reshape(-1)
    shape = flat.image.shape
    hidden = flat.hidden
    none = _Fit(np.float32(np.nan), np.float32(np.inf), np.float32(0), np.float32(0))
    for lens in range(begin, end):
        ax = centres[lens, 0]
        ay = centres[lens, 1]
        left = first_pixel(ax, radius, raster.side, shape[1])
        top = first_pixel(ay, radius, raster.side, shape[0])
        corner = left, top
        ready = False
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            if other < 0 or (np.isnan(start[lens]) and np.isnan(start[other])):
                continue
            if not ready:
                cut_smoothed(pixels, shape[1], raster, corner, types, work)
                if hidden.size > 0:
                    _hide(hidden, raster, corner, work)
                box_step[:] = NO_STEP
                ready = True
            pair = Pair(ax, ay, centres[other, 0], centres[other, 1], radius, pitch)
            scale = max(scale2[lens], scale2[other])
            starts = _start_values(start[lens], start[other], gap)
            fit = none
            for k in range(2):
                if k == 0 or starts[1] != starts[0]:
                    fit = _fit_pair(
                        pixels,
                        shape,
                        raster,
                        corner,
                        pair,
                        starts[k],
                        scale,
                        settings,
                        types,
                        memory,
                    )
                sizes[lens, d, k] = fit.size
                variances[lens, d, k] = fit.variance
                places[lens, d, k, 0] = fit.x
                places[lens, d, k, 1] = fit.y


def fit_pairs(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    start: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    iterations: int,
    last_step: float = 0.02,
    hidden: NDArray[np.bool_] | None = None,
) -> PairFits:
    """Patch size of each pair of neighbours, `rows` (n, d), by Gauss-Newton steps, `iterations` at
    most.

    Pairs of two lenses without a `start` value (n,) [px], NaN, are left out. Beyond a difference of
    brightness of `scale` (n,) two pixels hardly show the same point. `noise` is the standard
    deviation of a pixel, at most. A step below `last_step` [px] ends the fit. Pixels
    that are `hidden` (H, W) do not count in their own lens.
    """
    # Detail finer than a 25th of a pitch would show the difference of focus of two lenses instead
    # of the depth.
    factor = max(1, round(gray.pitch / 25)) if gray.lens_type is not None else 1
    gray = gray.downsampled(factor)
    start = (start / factor).astype(np.float32)
    noise = noise / factor
    hidden = np.zeros((0, 0), bool) if hidden is None else hidden[::factor, ::factor]
    # At the rim smoothing and slopes read beyond the microimage.
    radius = gray.radius - max(0.03 * gray.pitch, 0.3)
    image = gray.image
    # Microimages are cut out with the pixels beside them.
    missing = [max(0, int(2 * radius) + 2 * SPLINE_MARGIN - n) for n in image.shape]
    if any(missing):
        beyond = [(0, n) for n in missing]
        image = np.pad(image, beyond, "edge")
        hidden = np.pad(hidden, beyond) if hidden.size else hidden
    settings = _Settings(
        np.float32(radius),
        np.float32(gray.pitch),
        np.float32(noise**2),
        iterations,
        np.float32(last_step),
    )
    shape = (*rows.shape, 2)
    fits = PairFits(
        np.full(shape, np.nan, np.float32),
        np.full(shape, np.inf, np.float32),
        np.zeros((*shape, 2), np.float32),
    )
    scale2 = (scale * scale).astype(np.float32)
    flat = _Flat(np.ascontiguousarray(image), np.ascontiguousarray(hidden))
    _fit_pairs(flat, gray.centres, gray.lens_type, rows, start, scale2, settings, fits)
    if factor == 1:
        return fits
    return PairFits(fits.patch_size * factor, fits.variance * factor**2, fits.place * factor)
