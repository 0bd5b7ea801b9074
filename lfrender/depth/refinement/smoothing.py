"""Patch sizes smoothed over the lenses of one surface: robust local planes and paraboloids, weighted by errors.

Each lens is combined with what a weighted plane through its neighbours predicts. The scatter of the neighbours about
the plane beyond their errors is taken for unevenness of the surface (DerSimonian and Laird, Meta-analysis in clinical
trials, 1986). A microimage measures the mean over what it shows; on a curved surface that differs from the value at its
centre, by an amount that the curvature fitted to the neighbours predicts.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import kernel

from ...flat.gray_flat import GrayFlat
from ...flat.lens_graph import distant_rings, two_rings
from .lens_plane import LensFits
from .settings import REFINEMENT, RefinementSettings

__all__ = ["smooth_fits", "smooth_fits_far"]

# Fields of `RefinementSettings` for kernels.
_Constants = namedtuple("_Constants", "outlier least_slant significance rounds correlation common_error")

# Neighbours of one lens are gathered in the rows of an array (9, m): sizes, variances, steps to them [pitches] x and y,
# slants x and y, their variances, whether the sizes are means over microimages, and weights. Compared with the plane of
# the lens they are in the rows of another one, `near` (13, m): differences of size, their variances and weights; how
# much the differences grow with a slant in x and y, and with a curvature; steps x and y, by which slants fall with a
# curvature; differences of slant x and y, times s, and their variance. Its last two rows are work memory.
_GATHERED, _NEAR = 9, 13

# Mean robust weight of the neighbours on a plane that has errors alone.
_INLIER_SHARE = np.float32(0.83)


@njit(error_model="numpy", inline="always")
def _inverted(a, b, c, d, e, f):
    """Inverse of the symmetric matrix ((a, b, c), (b, d, e), (c, e, f)): its upper half, and a factor to it."""
    i00, i01, i02 = d * f - e * e, c * e - b * f, b * e - c * d
    return i00, i01, i02, a * f - c * c, b * c - a * e, a * d - b * b, 1 / (a * i00 + b * i01 + c * i02)


# Exact sums, here and below: with fast math they would have other bits where Numba compiles than where it loads them.
# Divisions are in loops without sums: these become vector loops, except with Python's error model, which checks them.
@njit(error_model="numpy")
def _predict(count, near, slant_known, rounds):
    """What `count` neighbours predict of a lens by a weighted plane: difference from its size, its variance, and mean
    variance; difference of slant, and the variance of that."""
    away, variance, share, along_x, along_y, weights = near[0], near[1], near[2], near[3], near[4], near[11]
    uneven = height = inverse = total = x_slant = y_slant = slanted = 0.0
    for turn in range(rounds):
        for k in range(np.uint64(count)):
            weights[k] = share[k] / (variance[k] + uneven)
        squares = a = b = c = d = e = f = p = q = r = 0.0
        for k in range(np.uint64(count)):
            w, x, y, rest = weights[k], along_x[k], along_y[k], away[k]
            wx, wy, wr = w * x, w * y, w * rest
            squares += w * w
            a += w
            b += wx
            c += wy
            d += wx * x
            e += wx * y
            f += wy * y
            p += wr
            q += wr * x
            r += wr * y
        total = a
        d += slant_known
        f += slant_known
        i00, i01, i02, i11, i12, i22, over = _inverted(a, b, c, d, e, f)
        height, inverse = (i00 * p + i01 * q + i02 * r) * over, i00 * over
        x_slant, y_slant = (i01 * p + i11 * q + i12 * r) * over, (i02 * p + i12 * q + i22 * r) * over
        slanted = 0.5 * (i11 + i22) * over
        if turn == rounds - 1:
            break
        scatter = number = 0.0
        for k in range(np.uint64(count)):
            rest = away[k] - height - x_slant * along_x[k] - y_slant * along_y[k]
            scatter += weights[k] * rest * rest
            number += share[k]
        freedom = number - 1 - (1 - i11 * over * slant_known) - (1 - i22 * over * slant_known)
        uneven += max(scatter - freedom + 1, 0.0) / max(a - squares / a, 1e-9)
    return height, inverse + uneven, count / total, -x_slant, -y_slant, slanted


@njit(error_model="numpy")
def _curvature(count, near, own, own_variance, own_curved, slant_known):
    """Curvature [px / pitch^2] of the surface about a lens, and its variance, by a weighted paraboloid.

    It is round, since one curvature and a slant in each direction are all that so few lenses determine; slants count as
    well as sizes. Scatter about it increases the variance.
    """
    away, variance, share, along_x, along_y, curved = near[0], near[1], near[2], near[3], near[4], near[5]
    ahead_x, ahead_y, turned_x, turned_y, turn_variance = near[6], near[7], near[8], near[9], near[10]
    weights, turn_weights = near[11], near[12]
    for k in range(np.uint64(count)):
        weights[k], turn_weights[k] = share[k] / variance[k], share[k] / turn_variance[k]
    # The lens itself, whose difference is 0, and the prior of its slant.
    a, g, j, d = 1 / own_variance, own_curved / own_variance, own_curved * own_curved / own_variance, slant_known
    f, b, c, e, h, i, p, q, r, s, squares, number = d, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(np.uint64(count)):
        w, x, y, z, rest = weights[k], along_x[k], along_y[k], curved[k], away[k]
        wx, wy, wz, wr = w * x, w * y, w * z, w * rest
        v, u, n = turn_weights[k], ahead_x[k], ahead_y[k]
        turn_x, turn_y, vo = turned_x[k], turned_y[k], v * own
        a += w
        b += wx
        c += wy
        d += wx * x + vo * own
        e += wx * y
        f += wy * y + vo * own
        g += wz
        h += wz * x + vo * u
        i += wz * y + vo * n
        j += wz * z + v * (u * u + n * n)
        p += wr
        q += wr * x - vo * turn_x
        r += wr * y - vo * turn_y
        s += wr * z - v * (u * turn_x + n * turn_y)
        squares += wr * rest + v * (turn_x * turn_x + turn_y * turn_y)
        number += share[k]
    i00, i01, i02, i11, i12, i22, over = _inverted(a, b, c, d, e, f)
    # A plane, and by how much it changes with the curvature.
    height, by_height = (i00 * p + i01 * q + i02 * r) * over, (i00 * g + i01 * h + i02 * i) * over
    x_slant, by_x = (i01 * p + i11 * q + i12 * r) * over, (i01 * g + i11 * h + i12 * i) * over
    y_slant, by_y = (i02 * p + i12 * q + i22 * r) * over, (i02 * g + i12 * h + i22 * i) * over
    left = s - by_height * p - by_x * q - by_y * r
    # Lenses in one place do not determine it.
    spread = 1 / max(j - by_height * g - by_x * h - by_y * i, 1e-12)
    scatter = squares - height * p - x_slant * q - y_slant * r - spread * left * left
    freedom = 3 * number - 1 - (1 - i11 * over * slant_known) - (1 - i22 * over * slant_known)
    return spread * left, spread * max((scatter + 1) / (max(freedom, 0.0) + 1), 1.0)


@njit(error_model="numpy", inline="always")
def _mean_reach(size, radius):
    """Half the mean square distance [pitches^2], on the scene, between what a lens shows and what its centre does; at
    most a pitch."""
    return min(radius * radius / (4 * size * size), 1.0)


@njit(error_model="numpy", forceinline=True)
def _compare(count, own, own_variance, slant_x, slant_y, slant_variance, radius, gathered, constants, near):
    """Fill `near` from `count` gathered neighbours; returns the sum of their robust weights."""
    sizes, variances, ahead_x, ahead_y = gathered[0], gathered[1], gathered[2], gathered[3]
    slants_x, slants_y, slant_variances = gathered[4], gathered[5], gathered[6]
    averaged, trust = gathered[7], gathered[8]
    away, variance, share, along_x, along_y, curved = near[0], near[1], near[2], near[3], near[4], near[5]
    out_x, out_y, turned_x, turned_y, turn_variance = near[6], near[7], near[8], near[9], near[10]
    outlier2 = constants.outlier * constants.outlier
    for k in range(np.uint64(count)):
        size, noise, ex, ey = sizes[k], variances[k], ahead_x[k], ahead_y[k]
        # Over a plane 1 / s is linear in X, with the slant -D * grad(s) / s.
        rest = size * (1 + slant_x * ex + slant_y * ey) - own
        away2, size2 = ex * ex + ey * ey, size * size
        apart = rest * rest / (own_variance + noise + slant_variance * size2 * away2)
        doubt = 1 / (1 + apart / outlier2)
        # Lenses twice as far off belong to another surface.
        counts = doubt * doubt * max(1 - apart / (4 * outlier2), 0.0) * trust[k]
        away[k], variance[k], share[k], along_x[k], along_y[k] = rest, noise, counts, size * ex, size * ey
        curved[k] = 0.5 * away2 + averaged[k] * _mean_reach(size, radius)
        out_x[k], out_y[k] = ex, ey
        turned_x[k], turned_y[k] = own * (slants_x[k] - slant_x), own * (slants_y[k] - slant_y)
        turn_variance[k] = own * own * slant_variances[k]
    weight = 0.0
    for k in range(np.uint64(count)):
        weight += share[k]
    return weight


@njit(error_model="numpy")
def _gather(
    lens, centres, pitch, radius, rows, sizes, errors, slants, slant_errors, centred, trust, constants, gathered, near
):  # fmt: skip
    """Fill `near` with the neighbours `rows` of a lens; returns how many they are, and the sum of their weights."""
    # An integer that is not known to be 0, which would be another type.
    count, per_pitch = np.int64(0), 1 / np.float64(pitch)
    least = constants.least_slant * constants.least_slant
    for k in range(rows.shape[1]):
        other = rows[lens, k]
        if other < 0:
            break
        if not np.isfinite(errors[other]):
            continue
        gathered[0, count], gathered[1, count] = sizes[other], np.float64(errors[other]) ** 2
        gathered[2, count] = (np.float64(centres[other, 0]) - centres[lens, 0]) * per_pitch
        gathered[3, count] = (np.float64(centres[other, 1]) - centres[lens, 1]) * per_pitch
        gathered[4, count], gathered[5, count] = slants[other, 0], slants[other, 1]
        gathered[6, count] = np.float64(slant_errors[other]) ** 2 + least
        gathered[7, count], gathered[8, count] = 1 - centred[other], trust[lens] * trust[other]
        count += 1
    weight = _compare(
        count, np.float64(sizes[lens]), np.float64(errors[lens]) ** 2, np.float64(slants[lens, 0]),
        np.float64(slants[lens, 1]), np.float64(slant_errors[lens]) ** 2 + least, np.float64(radius), gathered,
        constants, near,
    )  # fmt: skip
    return count, weight


@kernel(error_model="numpy", share=lambda centres, *_: len(centres))
def _smooth(
    begin, end, centres, pitch, radius, rows, sizes, errors, slants, slant_errors, wanted, centred, trust,
    constants: _Constants, out,
):  # fmt: skip
    """Combine the `wanted` lenses in `out` (n, 6), which holds the fits of all: sizes, errors, slants x and y, their
    errors, and shares of inliers."""
    c = constants
    gathered, near = np.empty((_GATHERED, rows.shape[1])), np.empty((_NEAR, rows.shape[1]))
    for lens in range(begin, end):
        own, own_variance = np.float64(sizes[lens]), np.float64(errors[lens]) ** 2
        if not (wanted[lens] and np.isfinite(own_variance)):
            continue
        count, weight = _gather(
            lens, centres, pitch, radius, rows, sizes, errors, slants, slant_errors, centred, trust, c, gathered, near
        )
        out[lens, 5] = weight / max(count, 1)
        if weight <= 0:
            continue
        slant_known = 1 / (np.float64(slant_errors[lens]) ** 2 + c.least_slant * c.least_slant)
        averaged = (1 - centred[lens]) * _mean_reach(own, radius)
        curvature, variance = _curvature(count, near, own, own_variance, averaged, slant_known)
        curvature *= max(1 - c.significance * variance / (curvature * curvature), 0.0)
        # What the curvature adds to all sizes, also to that of the lens itself, is taken from them.
        uncertain_part = averaged * averaged * variance if curvature != 0 else 0.0
        for k in range(count):
            near[0, k] += curvature * (averaged - near[5, k])
        own_variance += uncertain_part
        predicted, spread, shared, x_slant, y_slant, slanted = _predict(count, near, slant_known, c.rounds)
        if predicted * predicted > c.outlier * c.outlier * (spread + own_variance):
            continue
        out[lens, 0] = own - averaged * curvature + own_variance / (own_variance + spread) * predicted
        out[lens, 2] += x_slant
        out[lens, 3] += y_slant
        out[lens, 4] = np.sqrt(slanted)
        joint = own_variance * spread / (own_variance + spread) + uncertain_part
        out[lens, 1] = np.sqrt(joint + c.correlation * min(shared, own_variance) + c.common_error * c.common_error)


def smooth_fits(
    gray: GrayFlat,
    neighbours: NDArray[np.int32],
    fits: LensFits,
    wanted: NDArray[np.bool_],
    centred: NDArray[np.bool_],
    settings: RefinementSettings = REFINEMENT,
) -> tuple[LensFits, NDArray[np.float32]]:
    """Patch sizes, slants and their errors of lenses combined with the lenses in two rings around each.

    Also returns the mean weight (n,) of the neighbours of each lens, 0 to 1.

    Neighbours are weighted robustly: those that differ from the lens by several standard errors belong to another
    surface and do not count.

    Parameters
    ----------
    gray : GrayFlat
    neighbours : (n, k) int32
        Neighbour rows in all directions, -1 where there is none.
    fits : LensFits
        What each lens measures alone; those of infinite error are left out.
    wanted : (n,) bool
        The other lenses keep their fits.
    centred : (n,) bool
        Whether the fit of a lens is the value at its centre, instead of a mean over its microimage.
    settings : RefinementSettings
    """
    trust = np.ones(len(centred), np.float32)
    return _smoothed(gray, two_rings(neighbours), fits, wanted, centred, trust, settings)


def smooth_fits_far(
    gray: GrayFlat,
    neighbours: NDArray[np.int32],
    fits: LensFits,
    inlier_share: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    settings: RefinementSettings = REFINEMENT,
) -> LensFits:
    """The result of `smooth_fits` combined with lenses farther off, so that large planes become planes.

    Lenses count less if few of their own neighbours are inliers: beside depth edges they see a little of both sides,
    and all err towards the other one.
    """
    centred = np.ones(len(wanted), np.bool_)
    trust = np.minimum(inlier_share / _INLIER_SHARE, 1) ** settings.steepness
    for _ in range(settings.far_rounds):
        fits = _smoothed(gray, distant_rings(neighbours), fits, wanted, centred, trust, settings)[0]
    return fits


def _smoothed(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    fits: LensFits,
    wanted: NDArray[np.bool_],
    centred: NDArray[np.bool_],
    trust: NDArray[np.float32],
    settings: RefinementSettings,
) -> tuple[LensFits, NDArray[np.float32]]:
    """As `smooth_fits`, with the lenses `rows` (n, m) of each, weighted by their `trust` and its own (n,)."""
    sizes, errors, slants, slant_errors = (
        np.asarray(values, np.float32)
        for values in (fits.patch_size, fits.standard_error, fits.slant, fits.slant_error)
    )
    out = np.column_stack([sizes, errors, slants, slant_errors, np.ones_like(sizes)])
    constants = _Constants(*(getattr(settings, name) for name in _Constants._fields))
    _smooth(
        gray.centres, gray.pitch, gray.radius, rows, sizes, errors, slants, slant_errors, wanted, centred, trust,
        constants, out,
    )  # fmt: skip
    size, error, slant_error, inliers = (out[:, k].copy() for k in (0, 1, 4, 5))
    return LensFits(size, error, out[:, 2:4].copy(), slant_error), inliers
