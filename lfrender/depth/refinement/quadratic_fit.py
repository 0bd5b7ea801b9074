"""Lenses before bent surfaces, measured where their centres see them.

A pair of lenses tells the mean of what both show, some `R / |s|` pitches of the scene to all sides: on a sphere, or at
the edge of a box, that is not what the middle of a microimage shows. Here a lens is compared with all its neighbours at
once, under a patch size that may bend inside the microimage: a surface of second degree, as the affine windows of
Lucas and Kanade (An iterative image registration technique, 1981) are of first.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST

from ...flat.gray_flat import GrayFlat
from ...runtime.normal_equations import solve_cholesky, substitute_factor
from ...runtime.scheduling import plan_chunks
from .lens_plane import LensFits
from .pair_fit import usable_radius
from .pair_pixels import SPLINE_MARGIN, bspline_weights, cut_smoothed, first_pixel, pixel_raster

__all__ = ["fit_quadratic"]

_ITERATIONS = 4
# A step that moves no coefficient by more than this [px] was the last.
_LAST_STEP = np.float32(0.01)
# Toward the rim slants [px per px] and bends [share of the pitch] change patch sizes by about so much.
_SLANTED, _BENT = 0.08, 0.02
# Fits that leave the first value by more than this share of the pitch, or rest on fewer pixels, are given up.
_LEFT, _FEWEST = 0.06, 60.0
# The cubic B-spline leaves a quarter of the energy of white noise: so many pixels tell what one independent one would.
_CORRELATED = 4.0
# What misleads all pixels of a lens together does not show in what they leave unexplained: factor of a standard error,
# measured on ray-traced clutter.
_UNSEEN = np.float32(1.6)
# Fits that move a lens by less than this share of their standard error are not needed: it knows itself better without.
_MOVED = 0.5
_TERMS = 6


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _look(pixels, width, count, x, y, sizes, ux, uy, cx, cy, last_x, last_y, r2, other, share):
    """What a lens centred at (cx, cy) shows of the places (x, y) of another, moved along (ux, uy) by their patch sizes;
    `share` is 0 where that is nothing."""
    one, down = np.float32(1.0), np.uint32(width)
    for k in range(np.uint64(count)):
        dx, dy = x[k] + sizes[k] * ux, y[k] + sizes[k] * uy
        px, py = dx + cx, dy + cy
        inside = (dx * dx + dy * dy <= r2) & (px >= one) & (px <= last_x) & (py >= one) & (py <= last_y)
        share[k] = one if inside else np.float32(0.0)
        px, py = min(max(px, one), last_x), min(max(py, one), last_y)
        left, top = np.int32(px), np.int32(py)
        a0, a1, a2, a3 = bspline_weights(px - np.float32(left))
        b0, b1, b2, b3 = bspline_weights(py - np.float32(top))
        at = np.uint32((top - 1) * np.int32(width) + left - 1)
        first = (a0 * pixels[at] + a1 * pixels[at + np.uint32(1)]) + (
            a2 * pixels[at + np.uint32(2)] + a3 * pixels[at + np.uint32(3)]
        )
        at += down
        second = (a0 * pixels[at] + a1 * pixels[at + np.uint32(1)]) + (
            a2 * pixels[at + np.uint32(2)] + a3 * pixels[at + np.uint32(3)]
        )
        at += down
        third = (a0 * pixels[at] + a1 * pixels[at + np.uint32(1)]) + (
            a2 * pixels[at + np.uint32(2)] + a3 * pixels[at + np.uint32(3)]
        )
        at += down
        fourth = (a0 * pixels[at] + a1 * pixels[at + np.uint32(1)]) + (
            a2 * pixels[at + np.uint32(2)] + a3 * pixels[at + np.uint32(3)]
        )
        other[k] = (b0 * first + b1 * second) + (b2 * third + b3 * fourth)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _weigh(count, own, other, share, offset, scale2, slope_x, slope_y, ux, uy, weights, slopes, rests):
    """Weights after Geman and McClure, slopes along (ux, uy) and residuals of all pixels; the sums of the weights, and
    of the residuals and their squares so weighted."""
    total = rest = square = np.float32(0.0)
    for k in range(np.uint64(count)):
        r = own[k] - other[k] - offset
        w = scale2 / (scale2 + r * r)
        w = w * w * share[k]
        slopes[k] = ux * slope_x[k] + uy * slope_y[k]
        weights[k], rests[k] = w, r
        total += w
        rest += w * r
        square += w * r * r
    return total, rest, square


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _moments(count, x, y, weights, slopes, rests, told):
    """Add up what changes of s by 1, x, y, x^2, xy and y^2 do to the pixels: in `told` weighted sums of slopes times
    these (6), with residuals (6), and of squared slopes times all monomials up to the fourth degree (15)."""
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
    told[0], told[1], told[2], told[3], told[4], told[5] = f0, f1, f2, f3, f4, f5
    told[6], told[7], told[8], told[9], told[10], told[11] = b0, b1, b2, b3, b4, b5
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
    told[12], told[13], told[14], told[15], told[16] = m0, m1, m2, m3, m4
    told[17], told[18], told[19], told[20], told[21] = m5, m6, m7, m8, m9
    told[22], told[23], told[24], told[25], told[26] = m10, m11, m12, m13, m14


@njit(cache=True, nogil=True, error_model="numpy")
def _add_pair(told, total, rest, places, left, right):
    """Add a pair's part to the normal equations, whatever the difference in brightness between its lenses."""
    for i in range(_TERMS):
        right[i] += told[6 + i] - told[i] * rest / total
        for j in range(i + 1):
            left[i, j] += told[12 + places[i, j]] - told[i] * told[j] / total


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _step(left, right, noise, known, c, change):
    """Move the coefficients, which are `known` to be about zero, to where the normal equations have them. By how much
    at most; `left` becomes its factor."""
    for i in range(_TERMS):
        left[i, i] += noise * known[i]
        right[i] -= noise * known[i] * c[i]
    solve_cholesky(left, right, change)
    moved = np.float32(0.0)
    for i in range(_TERMS):
        step = np.float32(min(max(change[i], -1.0), 1.0))
        c[i] += step
        moved = max(moved, abs(step))
    return moved


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _inside(columns, lines, side, wide, left, top, ax, ay, radius, smoothed, along_x, along_y, about, own, slopes):
    """Gather the pixels of a microimage in a circle: places in pixels and in radii, brightness and slopes. Their
    number."""
    count = 0
    for k in range(side * wide):
        dx, dy = columns[k] + np.float32(left) - ax, lines[k] + np.float32(top) - ay
        if columns[k] < side and dx * dx + dy * dy <= radius * radius:
            about[0, count], about[1, count] = dx, dy
            about[2, count], about[3, count] = dx / radius, dy / radius
            own[count], slopes[0, count], slopes[1, count] = smoothed[k], along_x[k], along_y[k]
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bend(count, c, about, bent):
    """Patch sizes of all pixels by their coefficients."""
    for k in range(count):
        u, v = about[2, k], about[3, k]
        bent[k] = c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _standard_errors(factor, right, noise, radius, column):
    """Standard errors of the patch size at the centre and of the slant, from the factor of the normal equations."""
    height, slope = 0.0, 0.0
    for i in range(3):
        right[:] = 0.0
        right[i] = 1.0
        substitute_factor(factor, right, column)
        if i == 0:
            height = column[0]
        else:
            slope += 0.5 * column[i]
    return _UNSEEN * np.float32(np.sqrt(noise * height)), _UNSEEN * np.float32(np.sqrt(noise * slope)) / radius


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _fit_bent(
    image, centres, radius, pitch, neighbours, sizes, slants, scale2, wanted, known, places, out, errors, out_slants,
    slant_errors,
):  # fmt: skip
    side, wide, size, columns, lines = pixel_raster(radius)
    height, width = image.shape
    pixels = image.reshape(-1)
    last_x, last_y = np.float32(width) - np.float32(3.001), np.float32(height) - np.float32(3.001)
    parts, each, stride = plan_chunks(len(centres))
    for part in prange(parts):
        room, about, slopes = (
            np.zeros((11, size), np.float32),
            np.zeros((4, size), np.float32),
            np.zeros((2, size), np.float32),
        )
        box, smooth, smoothed, along_x, along_y, own = room[0], room[1], room[2], room[3], room[4], room[5]
        bent, other, share, weights, along = room[6], room[7], room[8], room[9], room[10]
        rests, none, told = np.zeros(size, np.float32), np.zeros(0, np.float32), np.empty(27, np.float32)
        offsets, c = np.empty(neighbours.shape[1], np.float32), np.empty(_TERMS, np.float32)
        left, right, change = np.empty((_TERMS, _TERMS)), np.empty(_TERMS), np.empty(_TERMS)
        begin = part * stride % parts * each
        for lens in range(begin, min(begin + each, len(centres))):
            errors[lens] = np.inf
            if not wanted[lens]:
                continue
            ax, ay = centres[lens, 0], centres[lens, 1]
            first, top = first_pixel(ax, radius, side, width), first_pixel(ay, radius, side, height)
            cut_smoothed(pixels, height, width, first, top, side, wide, box, smooth, smoothed, along_x, along_y, none)
            count = _inside(
                columns, lines, side, wide, first, top, ax, ay, radius, smoothed, along_x, along_y, about, own, slopes
            )
            c[0], c[1], c[2] = sizes[lens], slants[lens, 0] * radius, slants[lens, 1] * radius
            c[3:], offsets[:], noise, seen = 0.0, 0.0, 0.0, np.float32(0.0)
            for _ in range(_ITERATIONS):
                _bend(count, c, about, bent)
                left[:], right[:], seen, squares = 0.0, 0.0, np.float32(0.0), np.float32(0.0)
                for d in range(neighbours.shape[1]):
                    near = neighbours[lens, d]
                    if near < 0:
                        continue
                    bx, by = centres[near, 0], centres[near, 1]
                    ux, uy = (bx - ax) / pitch, (by - ay) / pitch
                    _look(
                        pixels, width, count, about[0], about[1], bent, ux, uy, bx, by, last_x, last_y, radius * radius,
                        other, share,
                    )  # fmt: skip
                    total, rest, square = _weigh(
                        count, own, other, share, offsets[d], scale2[lens], slopes[0], slopes[1], ux, uy, weights,
                        along, rests,
                    )  # fmt: skip
                    if total < 4:
                        continue
                    _moments(count, about[2], about[3], weights, along, rests, told)
                    _add_pair(told, total, rest, places, left, right)
                    offsets[d] += rest / total
                    seen += total
                    squares += square - rest * rest / total
                if seen < _FEWEST:
                    break
                noise = float(_CORRELATED * squares / seen) + 1e-9
                if _step(left, right, noise, known, c, change) < _LAST_STEP:
                    break
            if seen < _FEWEST or not abs(c[0] - sizes[lens]) < _LEFT * pitch:
                continue
            out[lens] = c[0]
            out_slants[lens, 0], out_slants[lens, 1] = c[1] / radius, c[2] / radius
            errors[lens], slant_errors[lens] = _standard_errors(left, right, noise, radius, change)


def _places_of_products() -> NDArray[np.int64]:
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
) -> tuple[LensFits, NDArray[np.float32]]:
    """The fits with those of the lenses `wanted` at their centres, and how far (n,) float32 they are of these.

    Parameters
    ----------
    gray : GrayFlat
    neighbours : (n, k) int32
        Neighbour rows in all directions, -1 where there is none.
    fits : LensFits
        First values.
    wanted : (n,) float32
        How far they are: 0 not at all, 1 altogether.
    scale : (n,) float32
        Difference of brightness beyond which two pixels hardly count as the same point.
    """
    radius = usable_radius(gray)
    if not wanted.any() or min(gray.image.shape) < 2 * radius + 2 * SPLINE_MARGIN:
        return fits, np.zeros(len(wanted), np.float32)
    sizes, slants, slant_errors = fits.patch_size.copy(), fits.slant.copy(), fits.slant_error.copy()
    errors = np.empty_like(sizes)
    known = np.array([0.0, *[1 / (_SLANTED * radius) ** 2] * 2, *[1 / (_BENT * gray.pitch) ** 2] * 3])
    _fit_bent(
        np.ascontiguousarray(gray.image), gray.centres, np.float32(radius), np.float32(gray.pitch), neighbours,
        fits.patch_size, fits.slant, (scale * scale).astype(np.float32), wanted > 0, known, _places_of_products(),
        sizes, errors, slants, slant_errors,
    )  # fmt: skip
    # Nothing comes in at once: answers depend on no threshold that noise may cross.
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = 1 - (_MOVED * errors / (sizes - fits.patch_size)) ** 2
    share = np.where(np.isfinite(errors), wanted * np.clip(moved, 0, 1), 0).astype(np.float32)
    told = share > 0
    return LensFits(
        _mixed(share, fits.patch_size, sizes),
        _mixed(share, fits.standard_error, np.where(told, errors, 0)),
        _mixed(share[:, None], fits.slant, slants),
        _mixed(share, fits.slant_error, slant_errors),
    ), share


def _mixed(share: NDArray[np.float32], one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float32]:
    """The other as far as it has a `share`, or the one itself where it has none."""
    with np.errstate(invalid="ignore"):
        return np.where(share > 0, one + share * (other - one), one).astype(np.float32)
