"""Patch size and slant of each lens from the pairs that it forms with its neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST, square

from ...flat.gray_flat import GrayFlat
from .pair_fit import PairFits

__all__ = ["LensFits", "fit_lens_planes"]

_ROUNDS = 4
# Systematic error of one pair [px]: interpolation, sampling and lattice errors do not average out over its pixels.
_FLOOR = np.float32(0.006)
# Slants are rarely steeper than this: px of patch size per px in the microimage.
_SLANT = np.float32(0.05)
# Pairs are doubted from so many standard deviations on.
_DOUBT = np.float32(3.0)
# What pairs of one lens get wrong together does not show in their scatter. They share less of the lens, and reach
# farther beyond it, the larger the patch: factor at s = 0 and its growth per |s| / D, measured on ray-traced scenes.
_UNSEEN, _UNSEEN_GROWTH = np.float32(0.9), np.float32(1.3)
# Pairs that scatter by more than their noise are misled by their texture; in opposite directions it is the same, and so
# many of them count as one.
_ALIKE = np.float32(2.0)
# Neighbours that differ by less, in shares of the pitch, lie on one surface.
_ONE_SURFACE = 0.04
# Slants of neighbours on one surface differ at least by this much: no surface is perfectly even.
_LEAST_BEND = np.float32(1e-4)
# First, before the slant is known, from so many px on.
_FIRST_DOUBT = np.float32(0.5)


@dataclass(frozen=True)
class LensFits:
    """What each lens measures together with its neighbours.

    Parameters
    ----------
    patch_size : (n,) float32 [px]
        At the centre of the lens; NaN where no pair tells.
    standard_error : (n,) float32 [px]
        Of `patch_size`; inf where unknown.
    slant : (n, 2) float32
        Change of the patch size per px in the microimage, order `x, y`: constant over a plane.
    slant_error : (n,) float32
        Standard error of either component of `slant`; inf where unknown.
    """

    patch_size: NDArray[np.float32]
    standard_error: NDArray[np.float32]
    slant: NDArray[np.float32]
    slant_error: NDArray[np.float32]

    def larger(self, factor: int) -> LensFits:
        """As they are in pixels so many times as small."""
        size, error = (factor * values for values in (self.patch_size, self.standard_error))
        return LensFits(size, error, self.slant, self.slant_error)


@njit(cache=True, nogil=True, fastmath=FAST, forceinline=True)
def _gather(lens, centres, pitch, forward, backward, sizes, variances, places, s, v, x, y):
    """Fill `s, v, x, y` with the sizes, variances and places of the pairs of a lens; how many there are."""
    half = forward.shape[1]
    count = 0
    for k in range(2 * half):
        other = forward[lens, k] if k < half else backward[lens, k - half]
        if other < 0:
            continue
        row = np.int64(lens) if k < half else np.int64(other)
        d, side = (k, 0) if k < half else (k - half, 1)
        size = sizes[row, d, side]
        if np.isnan(size):
            continue
        # From the middle between both microimages to this one: half a patch, away from the neighbour.
        step = np.float32(0.5) * size / pitch
        s[count] = size
        v[count] = variances[row, d, side] + _FLOOR * _FLOOR
        x[count] = places[row, d, side, 0] - step * (centres[other, 0] - centres[lens, 0])
        y[count] = places[row, d, side, 1] - step * (centres[other, 1] - centres[lens, 1])
        count += 1
    return count


@njit(cache=True, nogil=True, fastmath=FAST, forceinline=True)
def _fit_plane(count, s, v, x, y, z, gx, gy, known, rounds, early):
    """Robust plane through the pairs, weighted after Geman and McClure, with a slant near (gx, gy).

    `known` is the inverse variance of that slant. Returns the plane, the variances of its height and
    its slant, and the scatter of the pairs with its degrees of freedom.
    """
    px, py = gx, gy
    zero = np.float32(0.0)
    height = slope = chi2 = weights = zero
    for turn in range(rounds):
        a = b = c = d = e = f = p = q = r = chi2 = weights = zero
        for k in range(count):
            residual = s[k] - z - gx * x[k] - gy * y[k]
            limit = _DOUBT * _DOUBT * v[k]
            if turn < early:
                limit += _FIRST_DOUBT * _FIRST_DOUBT + (x[k] * x[k] + y[k] * y[k]) / known
            w = limit / (limit + residual * residual)
            w *= w
            chi2 += w * residual * residual / v[k]
            weights += w
            w /= v[k]
            size = s[k] - px * x[k] - py * y[k]
            a += w
            b += w * x[k]
            c += w * y[k]
            d += w * x[k] * x[k]
            e += w * x[k] * y[k]
            f += w * y[k] * y[k]
            p += w * size
            q += w * size * x[k]
            r += w * size * y[k]
        d += known
        f += known
        i00, i01, i02 = d * f - e * e, c * e - b * f, b * e - c * d
        i11, i12, i22 = a * f - c * c, b * c - a * e, a * d - b * b
        inverse = np.float32(1.0) / (a * i00 + b * i01 + c * i02)
        z = (i00 * p + i01 * q + i02 * r) * inverse
        gx = px + (i01 * p + i11 * q + i12 * r) * inverse
        gy = py + (i02 * p + i12 * q + i22 * r) * inverse
        height, slope = i00 * inverse, np.float32(0.5) * (i11 + i22) * inverse
    return z, gx, gy, height, slope, chi2, weights


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _fit_lenses(
    centres, pitch, forward, backward, sizes, variances, places, start, prior, rounds, early, out, slants, spreads
):
    most = 2 * forward.shape[1]
    for lens in prange(len(centres)):
        s, v = np.empty(most, np.float32), np.empty(most, np.float32)
        x, y = np.empty(most, np.float32), np.empty(most, np.float32)
        count = 0
        if np.isfinite(start[lens]):
            count = _gather(lens, centres, pitch, forward, backward, sizes, variances, places, s, v, x, y)
        if count == 0:
            out[lens] = np.nan
            slants[lens, 0] = slants[lens, 1] = 0.0
            spreads[lens, 0] = spreads[lens, 1] = np.inf
            spreads[lens, 2] = spreads[lens, 3] = 0.0
            continue
        z, gx, gy, height, slope, chi2, weights = _fit_plane(
            count, s, v, x, y, start[lens], prior[lens, 0], prior[lens, 1], prior[lens, 2], rounds, early
        )
        out[lens] = z
        slants[lens, 0], slants[lens, 1] = gx, gy
        # Each parameter takes a degree of freedom as far as the pairs, and not the prior, determine it.
        own = 1 - min(np.float32(1.0), slope * prior[lens, 2])
        spreads[lens, 0], spreads[lens, 1], spreads[lens, 2] = height, slope, chi2
        spreads[lens, 3] = max(weights - 1 - 2 * own, np.float32(0.0))


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _expect_slants(forward, backward, sizes, gap, slants, spreads, prior):
    """The slant that the lenses on the same surface around each lens have in common, and how far it is common."""
    half = forward.shape[1]
    for lens in prange(len(sizes)):
        if not np.isfinite(spreads[lens, 0]):
            continue
        weight = np.float32(1.0) / spreads[lens, 1]
        total = weight
        x, y = weight * slants[lens, 0], weight * slants[lens, 1]
        squares = weight * (square(slants[lens, 0]) + square(slants[lens, 1]))
        count = np.float32(1.0)
        for k in range(2 * half):
            other = forward[lens, k] if k < half else backward[lens, k - half]
            if other < 0 or not abs(sizes[other] - sizes[lens]) < gap:
                continue
            weight = np.float32(1.0) / spreads[other, 1]
            total += weight
            x += weight * slants[other, 0]
            y += weight * slants[other, 1]
            squares += weight * (square(slants[other, 0]) + square(slants[other, 1]))
            count += 1
        if count < 3:
            continue
        x /= total
        y /= total
        # Scatter about the mean beyond what the errors of the slants explain is a bend of the surface.
        scatter = np.float32(0.5) * (squares / total - x * x - y * y) * count / (count - 1)
        bend = max(scatter - count / total, np.float32(0.0))
        prior[lens, 0], prior[lens, 1] = x, y
        prior[lens, 2] = np.float32(1.0) / (bend + 1 / total + square(_LEAST_BEND))


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _standard_errors(forward, backward, sizes, pitch, gap, spreads, out, slant_errors):
    """Scale the error of each lens by the scatter of its pairs and of its neighbours' on the same surface."""
    half = forward.shape[1]
    for lens in prange(len(sizes)):
        out[lens] = slant_errors[lens] = np.inf
        if not np.isfinite(spreads[lens, 0]):
            continue
        chi2, freedom = spreads[lens, 2], spreads[lens, 3]
        for k in range(2 * half):
            other = forward[lens, k] if k < half else backward[lens, k - half]
            if other >= 0 and abs(sizes[other] - sizes[lens]) < gap:
                chi2 += np.float32(0.5) * spreads[other, 2]
                freedom += np.float32(0.5) * spreads[other, 3]
        unseen = _UNSEEN + _UNSEEN_GROWTH * abs(sizes[lens]) / pitch
        scatter = (chi2 + 1) / (freedom + 1)
        if scatter > 1:
            scatter += (_ALIKE - 1) * (scatter - 1)
        out[lens] = unseen * np.sqrt(spreads[lens, 0] * scatter)
        slant_errors[lens] = unseen * np.sqrt(spreads[lens, 1] * scatter)


def fit_lens_planes(
    gray: GrayFlat,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    pairs: PairFits,
    start: NDArray[np.float32],
) -> LensFits:
    """Patch size at the centre of each lens by a robust fit of a plane to what its pairs have measured.

    A plane of the scene has a patch size that is linear in microimage coordinates, like any inverse depth. Each
    pair measures it where its texture lies, seldom at the centre. A first fit tells the slants, a second
    uses what neighbours on one surface have in common. How the pairs scatter about the plane
    gives the standard error.

    Parameters
    ----------
    gray : GrayFlat
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    pairs : PairFits
        Of the neighbours in `forward`.
    start : (n,) float32 [px]
        First values; NaN for lenses to leave alone.
    """
    n = len(start)
    sizes, errors, slants = np.empty(n, np.float32), np.empty(n, np.float32), np.empty((n, 2), np.float32)
    spreads, slant_errors = np.empty((n, 4), np.float32), np.empty(n, np.float32)
    prior = np.zeros((n, 3), np.float32)
    prior[:, 2] = 1 / _SLANT**2
    gap = np.float32(_ONE_SURFACE * gray.pitch)
    measured = (pairs.patch_size, pairs.variance, pairs.place)
    pitch = np.float32(gray.pitch)
    _fit_lenses(
        gray.centres, pitch, forward, backward, *measured, start.astype(np.float32), prior, _ROUNDS, _ROUNDS // 2,
        sizes, slants, spreads,
    )  # fmt: skip
    _expect_slants(forward, backward, sizes, gap, slants, spreads, prior)
    _fit_lenses(
        gray.centres, pitch, forward, backward, *measured, sizes.copy(), prior, _ROUNDS // 2, 0, sizes, slants, spreads
    )
    _standard_errors(forward, backward, sizes, pitch, gap, spreads, errors, slant_errors)
    return LensFits(sizes, errors, slants, slant_errors)
