"""Patch sizes smoothed over the lenses of one surface: robust local planes, weighted by errors.

Each lens is combined with what a weighted plane through its neighbours predicts. The scatter of the
neighbours about the plane beyond their errors is taken for unevenness of the surface (DerSimonian
and Laird, Meta-analysis in clinical trials, 1986).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import kernel

from ...flat.gray_flat import GrayFlat
from ...flat.neighbours import Neighbours
from .least_squares import add_point, geman_mcclure, no_points, solve_plane
from .lens_plane import LensFits

__all__ = ["smooth_fits"]


# Exact sums: with fast math they would have other bits where Numba compiles than where it loads
# them. Divisions are in loops without sums: these become vector loops, except with Python's error
# model, which checks them.
@njit(error_model="numpy")
def _predict(count, near, slant_known):
    """What `count` neighbours predict of a lens by a weighted plane: difference from its size, and
    of its slant with the opposite sign; variance of their unevenness; mean variance of them.

    Rows of `near` are as `_smooth` fills them.
    """
    away = near[0]
    variance = near[1]
    share = near[2]
    along_x = near[3]
    along_y = near[4]
    weights = near[5]
    uneven = 0.0
    turn = 0
    while True:
        for k in range(np.uint64(count)):
            weights[k] = share[k] / (variance[k] + uneven)
        sums = no_points(0.0)
        squares = 0.0
        for k in range(np.uint64(count)):
            squares += weights[k] * weights[k]
            sums = add_point(sums, weights[k], along_x[k], along_y[k], away[k])
        plane = solve_plane(sums, slant_known)
        turn += 1
        if turn == 4:
            return plane, uneven, count / sums.weight
        scatter = number = 0.0
        for k in range(np.uint64(count)):
            expected = plane.height + plane.slope_x * along_x[k] + plane.slope_y * along_y[k]
            rest = away[k] - expected
            scatter += weights[k] * rest * rest
            number += share[k]
        own_x = 1 - plane.slope_x_variance * slant_known
        own_y = 1 - plane.slope_y_variance * slant_known
        freedom = number - 1 - own_x - own_y
        spread = sums.weight - squares / sums.weight
        uneven += max(scatter - freedom + 1, 0.0) / max(spread, 1e-9)


@kernel(error_model="numpy", share=lambda centres, *_: len(centres))
def _smooth(begin, end, centres, pitch, rows, fits, wanted, trust, out):
    """Combine the `wanted` lenses in `out` (n, 6), which holds the `fits` of all: sizes, errors,
    slants x and y, their errors, and shares of inliers.
    """
    sizes, errors, slants, slant_errors = fits
    # Three standard deviations are an outlier. No surface is even, and no slant better known, than
    # to 0.002 px per px.
    near = np.empty((6, rows.shape[1]))
    outlier2 = 9.0
    least = 0.002**2
    per_pitch = 1 / np.float64(pitch)
    for lens in range(begin, end):
        own = np.float64(sizes[lens])
        own_variance = np.float64(errors[lens]) ** 2
        if not (wanted[lens] and np.isfinite(own_variance)):
            continue
        # An integer that is not known to be 0, which would be another type.
        count = np.int64(0)
        weight = np.float64(0)
        slant_variance = np.float64(slant_errors[lens]) ** 2 + least
        for k in range(rows.shape[1]):
            other = rows[lens, k]
            if other < 0:
                continue
            noise = np.float64(errors[other]) ** 2
            if not np.isfinite(noise):
                continue
            size = np.float64(sizes[other])
            x = (np.float64(centres[other, 0]) - centres[lens, 0]) * per_pitch
            y = (np.float64(centres[other, 1]) - centres[lens, 1]) * per_pitch
            # Over a plane 1 / s is linear in X, with the slant -D * grad(s) / s.
            rest = size * (1 + slants[lens, 0] * x + slants[lens, 1] * y) - own
            apart = (
                rest
                * rest
                / (own_variance + noise + slant_variance * size * size * (x * x + y * y))
            )
            # Lenses twice as far off belong to another surface.
            counts = geman_mcclure(apart, outlier2) * max(1 - apart / (4 * outlier2), 0.0)
            counts *= trust[lens] * trust[other]
            near[0, count] = rest
            near[1, count] = noise
            near[2, count] = counts
            near[3, count] = size * x
            near[4, count] = size * y
            weight += counts
            count += 1
        out[lens, 5] = weight / max(np.float64(count), 1.0)
        if weight <= 0:
            continue
        plane, uneven, shared = _predict(count, near, 1 / slant_variance)
        predicted = plane.height
        spread = plane.height_variance + uneven
        if predicted * predicted > outlier2 * (spread + own_variance):
            continue
        out[lens, 0] = own + own_variance / (own_variance + spread) * predicted
        # Where a neighbour expects a larger size than it has, the lens slants less.
        out[lens, 2] -= plane.slope_x
        out[lens, 3] -= plane.slope_y
        out[lens, 4] = np.sqrt(0.5 * (plane.slope_x_variance + plane.slope_y_variance))
        joint = own_variance * spread / (own_variance + spread)
        # Neighbours share pixels and pairs, and all lenses of a surface err by 0.0022 px together
        # (ray-traced scenes).
        out[lens, 1] = np.sqrt(joint + 0.03 * min(shared, own_variance) + 0.0022**2)


def smooth_fits(
    gray: GrayFlat, neighbours: Neighbours, fits: LensFits, wanted: NDArray[np.bool_]
) -> LensFits:
    """Patch sizes, slants and their errors of lenses combined with others, near and far, so that
    planes become planes.

    First with the lenses in two rings around each, then with those three and six times as far. Far
    off, lenses count less if few of their own neighbours are inliers: beside depth edges all err
    towards the other side. Lenses that are not `wanted` (n,) keep their fits.
    """
    trust = np.ones(len(wanted), np.float32)
    fits, inliers = _smoothed(gray, neighbours.two_rings, fits, wanted, trust)
    # Errors alone leave a mean weight of 0.83 to the neighbours on a plane.
    trust = np.minimum(inliers / np.float32(0.83), 1) ** 6
    for _ in range(2):
        fits, _ = _smoothed(gray, neighbours.distant_rings, fits, wanted, trust)
    return fits


def _smoothed(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    fits: LensFits,
    wanted: NDArray[np.bool_],
    trust: NDArray[np.float32],
) -> tuple[LensFits, NDArray[np.float32]]:
    """Fits combined with the lenses `rows` (n, m) of each, weighted by `trust` (n,), and the mean
    weight (n,) of these.
    """
    # Whole arrays: for views, the kernel would be compiled anew.
    before = tuple(np.ascontiguousarray(values, np.float32) for values in vars(fits).values())
    out = np.column_stack([*before, np.ones_like(trust)])
    _smooth(gray.centres, gray.pitch, rows, before, wanted, trust, out)
    size, error, slant_error, inliers = (out[:, k].copy() for k in (0, 1, 4, 5))
    return LensFits(size, error, out[:, 2:4].copy(), slant_error), inliers
