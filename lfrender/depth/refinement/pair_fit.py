"""Sub-pixel patch size of every pair of neighbours: robust least squares on the pixels that both show.

Gauss-Newton steps on the shift along the line between both lenses (Lucas and Kanade, An iterative image registration
technique, 1981), weighted after Geman and McClure, with a constant and a ramp of brightness between both microimages as
nuisance parameters.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST, square
from lfcal.runtime.kernels.jit import njit

from ...flat.gray_flat import GrayFlat
from ...runtime.cache import cached
from ..same_surface import same_surface
from .defocus_difference import (
    NO_DIFFERENCE,
    DefocusDifference,
    add_tone_curve,
    estimate_defocus_difference,
    sample_start_values,
)
from .pair_pixels import (
    SPLINE_MARGIN,
    cut_smoothed,
    first_pixel,
    flat_pixels,
    new_buffers,
    new_cutout,
    pixel_raster,
    resample_shifted,
)
from .settings import PairFitSettings

__all__ = ["PairFits", "fit_pairs", "usable_radius"]

_DEFAULT = PairFitSettings()


class PairFits(NamedTuple):
    """Patch size measured between each lens and its neighbour in each of `d` directions.

    The last axis of all arrays tells from whose start value the fit began: 0 the lens itself, 1 the neighbour. Both
    fits are the same where the two start values agree.

    Parameters
    ----------
    patch_size : (n, d, 2) float32 [px]
        NaN where nothing was measured.
    variance : (n, d, 2) float32 [px^2]
        Of `patch_size`, from the residuals as if they were independent noise.
    place : (n, d, 2, 2) float32 [px]
        Where in the microimages it was measured: the mean, weighted by texture, of the position between `delta` in the
        lens and `delta` in the neighbour (last axis `x, y`).
    """

    patch_size: NDArray[np.float32]
    variance: NDArray[np.float32]
    place: NDArray[np.float32]


# Float32 values of `PairFitSettings` and of one call of `fit_pairs`.
_Constants = namedtuple(
    "_Constants",
    "slope_noise difference_noise correlated_signal correlated_noise least_texture shading_change largest_step "
    "last_step largest_drift same_surface noise2 iterations",
)  # fmt: skip


# Python's error model checks every division for zero, which prevents vector loops.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _sums(light, slope_x, slope_y, other, columns, rows, overlap, offset, scale2):
    """Sums over the pixels of a microimage that the other shows too, weighted after Geman and McClure.

    Those of weights, residuals, slopes, their products, the moments of place, and the sums and products of brightness
    that grows along the step from lens to lens.
    """
    start, count, ux, uy, ax, ay, qx, qy, mx, my, r2, low_x, high_x, low_y, high_y = overlap
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
        r = light[at] - other[at] - offset
        q = (ux * (x - mx) + uy * (y - my)) * light[at]
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


# Arrays are passed one by one, although there are many: taken out of tuples here, their references would be counted for
# every pair, which costs a third of the time.
@njit(cache=True, nogil=True, fastmath=FAST, forceinline=True)
def _fit_pair(
    pixels, size, shape, columns, rows, corner, centres, radius, pitch, start, scale2, blur, light, slope_x, slope_y,
    laplacian, box, lines, shifted, whole, constants,
):  # fmt: skip
    """Patch size of one pair from `start`, its variance and its place; NaN where it cannot be determined.

    The first microimage differs from the second by `blur` (its value at s = 0 and growth per s) times its Laplacian, if
    it has one.
    """
    s, c = start, constants
    ax, ay, bx, by = centres
    slope_noise = c.slope_noise * (square(bx - ax) + square(by - ay)) / (pitch * pitch)
    offset = np.float32(0.0)
    variance = np.float32(np.inf)
    x = y = np.float32(0.0)
    two, tiny = np.float32(2.0), np.float32(1e-12)
    for _ in range(c.iterations):
        overlap = resample_shifted(pixels, size, shape, corner, centres, radius, s, pitch, box, lines, shifted, whole)
        if len(laplacian) > 0:
            share, first = blur[0] + blur[1] * s, np.uint64(overlap.start)
            for k in range(np.uint64(overlap.number)):
                shifted[first + k] += share * laplacian[first + k]
        sw, sr, srr, sp, spp, spr, sx, sy, sq, sqq, spq, sqr = _sums(
            light, slope_x, slope_y, shifted, columns, rows, overlap, offset, scale2
        )
        if sw < 4:
            return np.float32(np.nan), variance, x, y
        inverse = np.float32(1.0) / sw
        # A change of shading by r^2 is a ramp of this steepness between both lenses; its prior is as wide.
        ramp = two * c.shading_change * s / (radius * radius)
        ridge = max(sqq - sq * sq * inverse + c.noise2 / max(ramp * ramp, tiny), tiny)
        shared, shade = spq - sp * sq * inverse, sqr - sq * sr * inverse
        hessian = spp - sp * sp * inverse - shared * shared / ridge
        if hessian <= 1e-9:
            return np.float32(np.nan), variance, x, y
        gradient = spr - sp * sr * inverse - shared * shade / ridge
        offset += sr * inverse
        rest = srr - sr * sr * inverse - shade * shade / ridge
        rest = max(rest - gradient * gradient / hessian, np.float32(0.0)) * inverse
        # Slopes of noise steepen the sum of squares, but do not move with the scene.
        noise_part = slope_noise * min(c.noise2, rest / c.difference_noise) * sw
        texture = max(hessian - noise_part, c.least_texture * hessian)
        step = gradient / texture
        variance = (
            rest * (c.correlated_signal * texture + c.correlated_noise * (hessian - texture)) / (texture * texture)
        )
        x, y = sx / spp, sy / spp
        s += min(max(step, -c.largest_step), c.largest_step)
        if abs(step) < c.last_step:
            break
    if abs(s - start) > c.largest_drift:
        return np.float32(np.nan), variance, x, y
    return s, variance, x, y


@njit(cache=True, nogil=True, inline="always")
def _start_values(first, second, tolerance):
    """Start values of the two fits of a pair, and whether both are one: the mean of what is one surface."""
    first, second = second if np.isnan(first) else first, first if np.isnan(second) else second
    together = same_surface(first, second, tolerance)
    middle = np.float32(0.5) * (first + second)
    return middle if together else first, middle if together else second, together


@njit(cache=True, nogil=True, error_model="numpy", share=lambda image, centres, *_: len(centres))
def _fit_pairs(
    begin, end, image, centres, radius, pitch, rows, start, scale2, constants, defocus, sizes, variances, places
):
    """Fit the pairs of each lens with its neighbours in `rows`; the last arguments are the arrays of `PairFits`."""
    raster, flat = pixel_raster(radius), flat_pixels(image)
    side, stride, columns, raster_rows = raster.side, raster.stride, raster.columns, raster.rows
    pixels, height, width = flat.pixels, flat.height, flat.width
    kinds, blurs, growths = defocus.kinds, defocus.blurs, defocus.growths
    buffers, cutout = new_buffers(raster.size), new_cutout(raster.size, len(kinds) > 0)
    light, slope_x, slope_y, laplacian = cutout.light, cutout.slope_x, cutout.slope_y, cutout.laplacian
    box, lines, shifted, whole = buffers.box, buffers.lines, buffers.shifted, buffers.step
    for lens in range(begin, end):
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
                cut_smoothed(flat, raster, left, top, buffers, cutout)
                if len(kinds) > 0:
                    add_tone_curve(cutout, defocus.curve, defocus.dark)
                ready = True
            blur = growth = np.float32(0.0)
            if len(kinds) > 0:
                blur, growth = blurs[kinds[lens], kinds[other]], growths[kinds[lens], kinds[other]]
            first, second, together = _start_values(start[lens], start[other], constants.same_surface * pitch)
            for k in range(1 if together else 2):
                s, variance, x, y = _fit_pair(
                    pixels, (height, width), (side, stride), columns, raster_rows, (left, top),
                    (ax, ay, centres[other, 0], centres[other, 1]), radius, pitch, first if k == 0 else second,
                    max(scale2[lens], scale2[other]), (blur, growth), light, slope_x, slope_y, laplacian, box,
                    lines, shifted, whole, constants,
                )  # fmt: skip
                sizes[lens, d, k], variances[lens, d, k] = s, variance
                places[lens, d, k, 0], places[lens, d, k, 1] = x, y
            if together:
                sizes[lens, d, 1], variances[lens, d, 1] = sizes[lens, d, 0], variances[lens, d, 0]
                places[lens, d, 1, 0], places[lens, d, 1, 1] = places[lens, d, 0, 0], places[lens, d, 0, 1]


def usable_radius(gray: GrayFlat, settings: PairFitSettings = _DEFAULT) -> float:
    """Radius [px] within which the pixels of a microimage, smoothed and with their slopes, are its own."""
    return gray.radius - min(settings.rim, max(settings.rim_share * gray.pitch, settings.least_rim))


def fit_pairs(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    start: NDArray[np.float32],
    scale: NDArray[np.float32],
    noise: float,
    iterations: int,
    last_step: float | None = None,
    settings: PairFitSettings = _DEFAULT,
) -> PairFits:
    """Patch size of each pair of neighbours by Gauss-Newton steps.

    Parameters
    ----------
    gray : GrayFlat
    rows : (n, d) int32
        One neighbour of each lens in `d` directions, -1 where there is none: every pair once.
    start : (n,) float32 [px of `gray`]
        Start values, NaN for lenses without one; pairs of two such lenses are left out.
    scale : (n,) float32
        Scale of the robust loss: difference of brightness beyond which two pixels hardly show the same point.
    noise : float
        Standard deviation of a pixel, at most: where residuals are smaller, these count.
    iterations : int
        At most.
    last_step : float [px of `gray`], optional
        A shorter step ends the iterations; that of the settings by default.
    settings : PairFitSettings
    """
    radius = usable_radius(gray, settings)
    image = gray.image
    # Microimages are cut out with the pixels beside them.
    missing = [max(0, int(2 * radius) + 2 * SPLINE_MARGIN - n) for n in image.shape]
    if any(missing):
        image = np.pad(image, [(0, n) for n in missing], "edge")
    image, start = np.ascontiguousarray(image), start.astype(np.float32)
    shape = (*rows.shape, 2)
    if last_step is not None:
        settings = replace(settings, last_step=last_step)
    named = {name: np.float32(getattr(settings, name)) for name in _Constants._fields if hasattr(settings, name)}
    constants = _Constants(**named, noise2=np.float32(noise * noise), iterations=iterations)

    def fit(start: NDArray[np.float32], blur: DefocusDifference) -> PairFits:
        fits = PairFits(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty((*shape, 2), np.float32))
        _fit_pairs(
            image, gray.centres, np.float32(radius), np.float32(gray.pitch), rows, start,
            (scale * scale).astype(np.float32), constants, blur, *fits,
        )  # fmt: skip
        return fits

    def defocus(kinds: NDArray[np.int8]) -> DefocusDifference:
        sizes = fit(sample_start_values(start), NO_DIFFERENCE).patch_size[:, :, 0]
        return estimate_defocus_difference(image, gray.centres, radius, gray.pitch, rows, sizes, scale, noise, kinds)

    kinds = gray.lens_type
    return fit(start, NO_DIFFERENCE if kinds is None else cached(gray, "blur", lambda: defocus(kinds)))
