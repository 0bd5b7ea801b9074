"""Patch size at the centre of lenses that see curved surfaces: a quadratic patch size over the microimage.

A pair of lenses measures the mean over what both show, some `R / |s|` pitches of the scene to all sides: on a sphere,
or at the edge of a box, that is not the value at the middle of a microimage. Here a lens is compared with all its
neighbours at once, under a patch size that is a polynomial of second degree in microimage coordinates (the affine
windows of Lucas and Kanade, An iterative image registration technique, 1981, are of first degree).
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import njit

from ...flat.gray_flat import GrayFlat
from ...runtime.normal_equations import solve_cholesky, substitute_factor
from .lens_plane import LensFits
from .pair_fit import usable_radius
from .pair_pixels import (
    SPLINE_MARGIN,
    Cutout,
    bspline_weights,
    cut_smoothed,
    first_pixel,
    flat_pixels,
    new_buffers,
    pixel_raster,
)
from .settings import QuadraticFitSettings

__all__ = ["fit_quadratic"]

_DEFAULT = QuadraticFitSettings()
# Coefficients of 1, x, y, x^2, xy, y^2.
_TERMS = 6

# Values of `QuadraticFitSettings` for kernels; `prior` (6,) are inverse variances of the coefficients, and `products`
# (6, 6) which monomial is the product of two terms.
_Constants = namedtuple(
    "_Constants",
    "iterations last_step largest_drift fewest_pixels correlated common_error prior products",
)  # fmt: skip

# Pixels of a microimage inside a circle (size,): places in px and in radii, brightness, slopes, patch sizes.
_Pixels = namedtuple("_Pixels", "x y u v light slope_x slope_y sizes")

# The same pixels in one neighbour (size,): brightness, visibility, weights, slopes along the step between the lenses,
# and residuals; and sums over all of these (27,), see `_moments`.
_Compared = namedtuple("_Compared", "light visible weights slopes residuals sums")

# Normal equations, their solution, the coefficients, and offsets of brightness of the neighbours.
_Equations = namedtuple("_Equations", "left right change coefficients offsets")


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _four(pixels, at, c0, c1, c2, c3):
    return (c0 * pixels[at] + c1 * pixels[at + np.uint32(1)]) + (
        c2 * pixels[at + np.uint32(2)] + c3 * pixels[at + np.uint32(3)]
    )


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _interpolate(flat, count, own, ux, uy, cx, cy, r2, other, visible):
    """Fill `other` with the neighbour centred at (cx, cy) at the pixels of a lens, moved along (ux, uy) by their patch
    sizes; `visible` is 0 where it does not show them."""
    x, y, sizes, pixels = own.x, own.y, own.sizes, flat.pixels
    one, down = np.float32(1.0), np.uint32(flat.width)
    last_x, last_y = np.float32(flat.width) - np.float32(3.001), np.float32(flat.height) - np.float32(3.001)
    for k in range(np.uint64(count)):
        dx, dy = x[k] + sizes[k] * ux, y[k] + sizes[k] * uy
        px, py = dx + cx, dy + cy
        inside = (dx * dx + dy * dy <= r2) & (px >= one) & (px <= last_x) & (py >= one) & (py <= last_y)
        visible[k] = one if inside else np.float32(0.0)
        px, py = min(max(px, one), last_x), min(max(py, one), last_y)
        left, top = np.int32(px), np.int32(py)
        a0, a1, a2, a3 = bspline_weights(px - np.float32(left))
        b0, b1, b2, b3 = bspline_weights(py - np.float32(top))
        at = np.uint32((top - 1) * np.int32(flat.width) + left - 1)
        first = _four(pixels, at, a0, a1, a2, a3)
        at += down
        second = _four(pixels, at, a0, a1, a2, a3)
        at += down
        third = _four(pixels, at, a0, a1, a2, a3)
        at += down
        fourth = _four(pixels, at, a0, a1, a2, a3)
        other[k] = (b0 * first + b1 * second) + (b2 * third + b3 * fourth)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _weigh(count, own, offset, scale2, ux, uy, compared):
    """Fill in weights after Geman and McClure, slopes along (ux, uy) and residuals of all pixels; returns the sum of
    the weights, and weighted sums of the residuals and their squares."""
    light, slope_x, slope_y, other, visible = own.light, own.slope_x, own.slope_y, compared.light, compared.visible
    weights, slopes, rests = compared.weights, compared.slopes, compared.residuals
    total = rest = square = np.float32(0.0)
    for k in range(np.uint64(count)):
        r = light[k] - other[k] - offset
        w = scale2 / (scale2 + r * r)
        w = w * w * visible[k]
        slopes[k] = ux * slope_x[k] + uy * slope_y[k]
        weights[k], rests[k] = w, r
        total += w
        rest += w * r
        square += w * r * r
    return total, rest, square


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _moments(count, x, y, compared):
    """Fill `compared.sums` with weighted sums of slopes times 1, x, y, x^2, xy and y^2 (6), of these with residuals
    (6), and of squared slopes times all monomials up to the fourth degree (15)."""
    weights, slopes, rests, sums = compared.weights, compared.slopes, compared.residuals, compared.sums
    zero = np.float32(0.0)
    f0 = f1 = f2 = f3 = f4 = f5 = b0 = b1 = b2 = b3 = b4 = b5 = zero
    for k in range(np.uint64(count)):
        xk, yk, wp = x[k], y[k], weights[k] * slopes[k]
        wpr, xx, xy, yy = wp * rests[k], xk * xk, xk * yk, yk * yk
        f0 += wp
        f1 += wp * xk
        f2 += wp * yk
        f3 += wp * xx
        f4 += wp * xy
        f5 += wp * yy
        b0 += wpr
        b1 += wpr * xk
        b2 += wpr * yk
        b3 += wpr * xx
        b4 += wpr * xy
        b5 += wpr * yy
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = f0, f1, f2, f3, f4, f5
    sums[6], sums[7], sums[8], sums[9], sums[10], sums[11] = b0, b1, b2, b3, b4, b5
    m0 = m1 = m2 = m3 = m4 = m5 = m6 = m7 = m8 = m9 = m10 = m11 = m12 = m13 = m14 = zero
    for k in range(np.uint64(count)):
        xk, yk, w = x[k], y[k], weights[k] * slopes[k] * slopes[k]
        xx, xy, yy = w * xk * xk, w * xk * yk, w * yk * yk
        m0 += w
        m1 += w * xk
        m2 += w * yk
        m3 += xx
        m4 += xy
        m5 += yy
        m6 += xx * xk
        m7 += xx * yk
        m8 += yy * xk
        m9 += yy * yk
        m10 += xx * xk * xk
        m11 += xx * xk * yk
        m12 += xx * yk * yk
        m13 += yy * xk * yk
        m14 += yy * yk * yk
    sums[12], sums[13], sums[14], sums[15], sums[16] = m0, m1, m2, m3, m4
    sums[17], sums[18], sums[19], sums[20], sums[21] = m5, m6, m7, m8, m9
    sums[22], sums[23], sums[24], sums[25], sums[26] = m10, m11, m12, m13, m14


@njit(cache=True, nogil=True, error_model="numpy")
def _add_pair(sums, total, rest, products, left, right):
    """Add a pair to the normal equations, with the difference in brightness of its lenses eliminated."""
    for i in range(_TERMS):
        right[i] += sums[6 + i] - sums[i] * rest / total
        for j in range(i + 1):
            left[i, j] += sums[12 + products[i, j]] - sums[i] * sums[j] / total


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _step(equations, noise, prior):
    """Move the coefficients to the solution of the normal equations, by at most 1 px each, with a `prior` about zero.
    Returns the largest change; `equations.left` becomes its Cholesky factor."""
    left, right, change, c = equations.left, equations.right, equations.change, equations.coefficients
    for i in range(_TERMS):
        left[i, i] += noise * prior[i]
        right[i] -= noise * prior[i] * c[i]
    solve_cholesky(left, right, change)
    moved = np.float32(0.0)
    for i in range(_TERMS):
        step = np.float32(min(max(change[i], -1.0), 1.0))
        c[i] += step
        moved = max(moved, abs(step))
    return moved


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _gather_pixels(raster, left, top, ax, ay, radius, cutout, out):
    """Gather the pixels of a microimage in a circle; returns their number."""
    count = 0
    for k in range(raster.side * raster.stride):
        dx, dy = raster.columns[k] + np.float32(left) - ax, raster.rows[k] + np.float32(top) - ay
        if raster.columns[k] < raster.side and dx * dx + dy * dy <= radius * radius:
            out.x[count], out.y[count] = dx, dy
            out.u[count], out.v[count] = dx / radius, dy / radius
            out.light[count], out.slope_x[count], out.slope_y[count] = (
                cutout.light[k], cutout.slope_x[k], cutout.slope_y[k],
            )  # fmt: skip
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _evaluate(count, c, own):
    """Fill in the patch sizes of all pixels from the coefficients."""
    for k in range(count):
        u, v = own.u[k], own.v[k]
        own.sizes[k] = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _standard_errors(equations, noise, radius, common_error):
    """Standard errors of the patch size at the centre and of the slant, from the factor of the normal equations."""
    factor, right, column = equations.left, equations.right, equations.change
    height, slope = 0.0, 0.0
    for i in range(3):
        right[:] = 0.0
        right[i] = 1.0
        substitute_factor(factor, right, column)
        if i == 0:
            height = column[0]
        else:
            slope += 0.5 * column[i]
    height, slope = np.sqrt(noise * height), np.sqrt(noise * slope)
    return common_error * np.float32(height), common_error * np.float32(slope) / radius


@njit(cache=True, nogil=True, error_model="numpy")
def _add_neighbours(flat, centres, radius, pitch, lens, neighbours, scale2, count, own, compared, products, equations):
    """Set up the normal equations from all neighbours of a lens; returns the sum of the weights, and the weighted sum
    of squared residuals."""
    left, right, offsets = equations.left, equations.right, equations.offsets
    left[:], right[:], seen, squares = 0.0, 0.0, np.float32(0.0), np.float32(0.0)
    for d in range(neighbours.shape[1]):
        near = neighbours[lens, d]
        if near < 0:
            continue
        bx, by = centres[near, 0], centres[near, 1]
        ux, uy = (bx - centres[lens, 0]) / pitch, (by - centres[lens, 1]) / pitch
        _interpolate(flat, count, own, ux, uy, bx, by, radius * radius, compared.light, compared.visible)
        total, rest, square = _weigh(count, own, offsets[d], scale2, ux, uy, compared)
        if total < 4:
            continue
        _moments(count, own.u, own.v, compared)
        _add_pair(compared.sums, total, rest, products, left, right)
        offsets[d] += rest / total
        seen += total
        squares += square - rest * rest / total
    return seen, squares


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_lens(lens, flat, raster, centres, radius, pitch, neighbours, start, scale2, k, memory, out):
    """Fit one lens from its `start` fit, and write it to `out`."""
    buffers, cutout, own, compared, equations = memory
    sizes, _, slants, _ = start
    out_sizes, errors, out_slants, slant_errors = out
    ax, ay = centres[lens, 0], centres[lens, 1]
    left, top = first_pixel(ax, radius, raster.side, flat.width), first_pixel(ay, radius, raster.side, flat.height)
    cut_smoothed(flat, raster, left, top, buffers, cutout)
    count = _gather_pixels(raster, left, top, ax, ay, radius, cutout, own)
    c = equations.coefficients
    c[0], c[1], c[2] = sizes[lens], slants[lens, 0] * radius, slants[lens, 1] * radius
    c[3:], equations.offsets[:], noise, seen = 0.0, 0.0, 0.0, np.float32(0.0)
    for _ in range(k.iterations):
        _evaluate(count, c, own)
        seen, squares = _add_neighbours(
            flat, centres, radius, pitch, lens, neighbours, scale2[lens], count, own, compared, k.products, equations
        )
        if seen < k.fewest_pixels:
            break
        noise = float(k.correlated * squares / seen) + 1e-9
        if _step(equations, noise, k.prior) < k.last_step:
            break
    if seen < k.fewest_pixels or not abs(c[0] - sizes[lens]) < k.largest_drift * pitch:
        return
    out_sizes[lens] = c[0]
    out_slants[lens, 0], out_slants[lens, 1] = c[1] / radius, c[2] / radius
    errors[lens], slant_errors[lens] = _standard_errors(equations, noise, radius, k.common_error)


@njit(cache=True, nogil=True, error_model="numpy")
def _new_memory(size, neighbours):
    m = np.zeros((16, size), np.float32)
    return (
        new_buffers(size),
        Cutout(m[0], m[1], m[2], np.zeros(0, np.float32)),
        _Pixels(m[3], m[4], m[5], m[6], m[7], m[8], m[9], m[10]),
        _Compared(m[11], m[12], m[13], m[14], m[15], np.empty(27, np.float32)),
        _Equations(
            np.empty((_TERMS, _TERMS)), np.empty(_TERMS), np.empty(_TERMS), np.empty(_TERMS, np.float32),
            np.empty(neighbours, np.float32),
        ),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", share=lambda image, centres, *_: len(centres))
def _fit_quadratic(
    begin, end, image, centres, radius, pitch, neighbours, start, scale2, wanted, constants: _Constants, out
):
    """Fit all `wanted` lenses from the `start` fits and write to `out`, both (patch_size, standard_error, slant,
    slant_error)."""
    raster, flat = pixel_raster(radius), flat_pixels(image)
    memory = _new_memory(raster.size, neighbours.shape[1])
    for lens in range(begin, end):
        if wanted[lens]:
            _fit_lens(lens, flat, raster, centres, radius, pitch, neighbours, start, scale2, constants, memory, out)


def _products_of_terms() -> NDArray[np.int64]:
    """(6, 6) which of the monomials, in the order of `_moments`, is the product of two terms."""
    terms = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    monomials = [*terms, (3, 0), (2, 1), (1, 2), (0, 3), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4)]
    return np.array([[monomials.index((a + c, b + d)) for c, d in terms] for a, b in terms])


def fit_quadratic(
    gray: GrayFlat,
    neighbours: NDArray[np.int32],
    fits: LensFits,
    wanted: NDArray[np.float32],
    scale: NDArray[np.float32],
    settings: QuadraticFitSettings = _DEFAULT,
) -> tuple[LensFits, NDArray[np.float32]]:
    """The fits mixed with those of a quadratic patch size, and the share (n,) float32 of the latter.

    Parameters
    ----------
    gray : GrayFlat
    neighbours : (n, k) int32
        Neighbour rows in all directions, -1 where there is none.
    fits : LensFits
        Start values.
    wanted : (n,) float32
        Largest share of the quadratic fit: 0 not at all, 1 altogether.
    scale : (n,) float32
        Difference of brightness beyond which two pixels hardly show the same point.
    settings : QuadraticFitSettings
    """
    radius = usable_radius(gray)
    if not wanted.any() or min(gray.image.shape) < 2 * radius + 2 * SPLINE_MARGIN:
        return fits, np.zeros(len(wanted), np.float32)
    slant, curvature = 1 / (settings.likely_slant * radius) ** 2, 1 / (settings.likely_curvature * gray.pitch) ** 2
    constants = _Constants(
        settings.iterations, np.float32(settings.last_step), settings.largest_drift, settings.fewest_pixels,
        settings.correlated, np.float32(settings.common_error), np.array([0.0, *[slant] * 2, *[curvature] * 3]),
        _products_of_terms(),
    )  # fmt: skip
    unknown = np.full_like(fits.patch_size, np.inf)
    out = fits.patch_size.copy(), unknown, fits.slant.copy(), fits.slant_error.copy()
    _fit_quadratic(
        np.ascontiguousarray(gray.image), gray.centres, np.float32(radius), np.float32(gray.pitch), neighbours,
        (fits.patch_size, fits.standard_error, fits.slant, fits.slant_error), (scale * scale).astype(np.float32),
        wanted > 0, constants, out,
    )  # fmt: skip
    sizes, errors, slants, slant_errors = out
    # The share is continuous, so that noise does not flip lenses across a threshold.
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = 1 - (settings.least_move * errors / (sizes - fits.patch_size)) ** 2
    share = np.where(np.isfinite(errors), wanted * np.clip(moved, 0, 1), 0).astype(np.float32)
    return LensFits(
        _mix(share, fits.patch_size, sizes),
        _mix(share, fits.standard_error, np.where(share > 0, errors, 0)),
        _mix(share[:, None], fits.slant, slants),
        _mix(share, fits.slant_error, slant_errors),
    ), share


def _mix(share: NDArray[np.float32], one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weighted mean with a `share` of the other; the one itself, even beside NaN, where that is 0."""
    with np.errstate(invalid="ignore"):
        return np.where(share > 0, one + share * (other - one), one).astype(np.float32)
