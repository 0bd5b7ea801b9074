"""Patch size and slant of each lens: a robust plane through what the pairs with its neighbours
measure.

The patch size over a plane of the scene is linear in microimage coordinates, like any inverse
depth.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel

from ...flat.gray_flat import GrayFlat
from ...flat.neighbours import Neighbours
from ..presets import Preset
from ..same_surface import TOLERANCE, same_surface
from .least_squares import Plane, add_point, geman_mcclure, no_points, solve_plane
from .pair_fit import PairFits, fit_pairs

__all__ = ["LensFits", "fit_lens_planes", "fit_lenses"]


@dataclass(frozen=True)
class LensFits:
    """Patch size and slant of each lens."""

    patch_size: NDArray[
        np.float32
    ]  # (n,) [px] at the centre of the lens; NaN where nothing was measured
    standard_error: NDArray[np.float32]  # (n,) [px] of it; inf where unknown
    slant: NDArray[
        np.float32
    ]  # (n, 2) change of it per px in the microimage, order `x, y`: constant over a plane
    slant_error: NDArray[
        np.float32
    ]  # (n,) standard error of either component of `slant`; inf where unknown

    def better_of(self, other: LensFits) -> LensFits:
        """For each lens the fit with the smaller error, the first of equals."""
        better = other.standard_error < self.standard_error
        size, error, slant, slant_error = (
            np.where(better if a.ndim == 1 else better[:, None], b, a)
            for a, b in zip(vars(self).values(), vars(other).values(), strict=True)
        )
        return LensFits(size, error, slant, slant_error)


# Results of `_fit_planes`: heights (n,), slants (n, 2), and in `spreads` (n, 4) the variances of
# both, chi square and its degrees of freedom.
_Planes = namedtuple("_Planes", "sizes slants spreads")


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _gather(lens, centres, pitch, neighbours, pairs, s, v, x, y):
    """Fill `s, v, x, y` with the patch sizes, variances and places of the pairs of a lens; returns
    their number.
    """
    half = neighbours.shape[1] // 2
    count = 0
    for k in range(2 * half):
        other = neighbours[lens, k]
        if other < 0:
            continue
        row = np.int64(lens) if k < half else np.int64(other)
        d, side = (k, 0) if k < half else (k - half, 1)
        size = pairs.patch_size[row, d, side]
        if np.isnan(size):
            continue
        # From the middle between both microimages to this one: half a patch, away from the
        # neighbour.
        step = np.float32(0.5) * size / pitch
        s[count] = size
        v[count] = pairs.variance[row, d, side]
        x[count] = pairs.place[row, d, side, 0] - step * (centres[other, 0] - centres[lens, 0])
        y[count] = pairs.place[row, d, side, 1] - step * (centres[other, 1] - centres[lens, 1])
        count += 1
    return count


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _fit_plane(count, s, v, x, y, z, gx, gy, known, rounds):
    """Plane through the pairs by IRLS with the weights of Geman and McClure, with a prior slant
    (gx, gy).

    `known` is the inverse variance of that slant, which the last two `rounds` know. Returns the
    plane, chi square, and the sum of the weights.
    """
    # Three standard deviations; what is twice as far off is another surface.
    outlier2 = 9.0
    plane = Plane(z, gx, gy, 0.0, 0.0, 0.0)
    chi2 = weights = 0.0
    for turn in range(rounds):
        sums = no_points(0.0)
        chi2 = weights = 0.0
        for k in range(count):
            residual = s[k] - plane.height - plane.slope_x * x[k] - plane.slope_y * y[k]
            limit = outlier2 * v[k]
            if turn < rounds - 2:
                limit += (x[k] * x[k] + y[k] * y[k]) / known
            weight = geman_mcclure(residual * residual, limit)
            chi2 += weight * residual * residual / v[k]
            weights += weight
            sums = add_point(sums, weight / v[k], x[k], y[k], s[k] - gx * x[k] - gy * y[k])
        change = solve_plane(sums, known)
        plane = Plane(
            change.height,
            gx + change.slope_x,
            gy + change.slope_y,
            change.height_variance,
            change.slope_x_variance,
            change.slope_y_variance,
        )
    return plane, chi2, weights


@kernel(fastmath=FAST, error_model="numpy", share=lambda centres, *_: len(centres))
def _fit_planes(
    begin, end, centres, pitch, neighbours, pairs: PairFits, start, prior, rounds, out: _Planes
):
    """Fit a plane to the pairs of each lens, from `start` (n,) and with the `prior` (n, 3): slant,
    inverse variance.
    """
    most = neighbours.shape[1]
    sizes = out.sizes
    slants = out.slants
    spreads = out.spreads
    s = np.empty(most)
    v = np.empty(most)
    x = np.empty(most)
    y = np.empty(most)
    for lens in range(begin, end):
        count = (
            _gather(lens, centres, pitch, neighbours, pairs, s, v, x, y)
            if np.isfinite(start[lens])
            else 0
        )
        if count == 0:
            sizes[lens] = np.nan
            slants[lens, 0] = slants[lens, 1] = 0.0
            spreads[lens, 0] = spreads[lens, 1] = np.inf
            spreads[lens, 2] = spreads[lens, 3] = 0.0
            continue
        # Single precision would move a patch size by up to 0.1 px where pairs nearly lie on a line.
        slant_x = np.float64(prior[lens, 0])
        slant_y = np.float64(prior[lens, 1])
        known = np.float64(prior[lens, 2])
        plane, chi2, weights = _fit_plane(
            count, s, v, x, y, np.float64(start[lens]), slant_x, slant_y, known, rounds
        )
        slope_variance = 0.5 * (plane.slope_x_variance + plane.slope_y_variance)
        sizes[lens] = plane.height
        slants[lens, 0] = plane.slope_x
        slants[lens, 1] = plane.slope_y
        spreads[lens, 0] = plane.height_variance
        spreads[lens, 1] = slope_variance
        spreads[lens, 2] = chi2
        # Each parameter takes a degree of freedom as far as the pairs, and not the prior, determine
        # it.
        own = 1 - min(1.0, slope_variance * known)
        spreads[lens, 3] = max(weights - 1 - 2 * own, 0.0)


def _predict_slants(
    planes: _Planes, alike: NDArray[np.bool_], neighbours: NDArray[np.int32], prior: NDArray
) -> None:
    """Fill `prior` with the mean slant of each lens and its neighbours on one surface, and its
    inverse variance, where there are two or more.
    """
    slants = planes.slants
    weight = 1 / planes.spreads[:, 1:2]
    terms = weight * np.column_stack([np.ones_like(weight), slants, np.square(slants).sum(1)])
    count = 1 + alike.sum(1)
    some = count >= 3
    count = count[some]
    sums = terms[some] + np.einsum("nk,nkt->nt", alike[some], terms[neighbours[some]])
    total = sums[:, 0]
    mean = sums[:, 1:3] / total[:, None]
    # Scatter about the mean beyond the errors of the slants is curvature of the surface.
    scatter = 0.5 * (sums[:, 3] / total - np.square(mean).sum(1)) * count / (count - 1)
    curvature = np.maximum(scatter - count / total, 0)
    prior[some, :2] = mean
    prior[some, 2] = 1 / (curvature + 1 / total)


def _standard_errors(
    planes: _Planes, alike: NDArray[np.bool_], neighbours: NDArray[np.int32], pitch: float
) -> NDArray[np.float32]:
    """(n, 2) errors of patch sizes and slants, scaled by the scatter of the pairs of a lens and of
    its neighbours on one surface, and for what all pairs of a lens share by one and |s| over the
    pitch.
    """
    spreads = planes.spreads
    scatter = spreads[:, 2:] + 0.5 * np.einsum("nk,nkt->nt", alike, spreads[neighbours, 2:])
    chi2, freedom = scatter.T
    factor = (1 + np.abs(planes.sizes) / pitch) * np.sqrt((chi2 + 1) / (freedom + 1))
    errors = factor[:, None] * np.sqrt(spreads[:, :2])
    return np.where(np.isnan(errors), np.inf, errors).astype(np.float32)


def fit_lens_planes(
    gray: GrayFlat,
    neighbours: Neighbours,
    pairs: PairFits,
    start: NDArray[np.float32],
    steepest: float = 0.04,
) -> LensFits:
    """Patch size at the centre of each lens by a robust fit of a plane to what its pairs have
    measured.

    A first fit yields the slants, a second has the mean slant of the neighbours on one surface as
    its prior. The scatter of the pairs about the plane gives the standard error. `start` (n,) [px]
    is NaN for lenses to leave out; slants are rarely steeper than `steepest` [px per px].
    """
    n = len(start)
    pitch = np.float32(gray.pitch)
    float32 = np.float32
    planes = _Planes(np.empty(n, float32), np.empty((n, 2), float32), np.empty((n, 4), float32))
    prior = np.zeros((n, 3), float32)
    prior[:, 2] = 1 / steepest**2
    measured = (gray.centres, pitch, neighbours.all, pairs)
    _fit_planes(*measured, start.astype(float32), prior, 4, planes)
    _predict_slants(planes, _find_alike(gray, neighbours, planes), neighbours.all, prior)
    _fit_planes(*measured, planes.sizes.copy(), prior, 2, planes)
    alike = _find_alike(gray, neighbours, planes)
    errors, slant_errors = _standard_errors(planes, alike, neighbours.all, gray.pitch).T.copy()
    return LensFits(planes.sizes, errors, planes.slants, slant_errors)


def _find_alike(gray: GrayFlat, neighbours: Neighbours, planes: _Planes) -> NDArray[np.bool_]:
    """(n, k) bool: neighbours on the surface of each lens."""
    rows = neighbours.all
    gap = TOLERANCE * gray.pitch
    return (rows >= 0) & same_surface(planes.sizes[rows], planes.sizes[:, None], gap)


def fit_lenses(
    gray: GrayFlat,
    neighbours: Neighbours,
    start: NDArray[np.float32],
    contrast: NDArray[np.float32],
    noise: float,
    preset: Preset,
    hidden: NDArray[np.bool_] | None = None,
) -> LensFits:
    """Patch size of each lens by fits of its pairs and a plane through them.

    `contrast` (n,) is that of the microimages, `noise` that of a pixel; other arguments are those
    of `fit_pairs`. Where pixels are `hidden`, the rest is taken for narrow: planes hardly slant.
    """
    # Beyond this difference of brightness two pixels hardly show the same point.
    scale = np.maximum(3 * noise, 0.5 * contrast).astype(np.float32)
    pairs = fit_pairs(
        gray,
        neighbours.forward,
        start,
        scale,
        noise,
        preset.iterations,
        preset.last_step,
        hidden,
    )
    if hidden is None:
        return fit_lens_planes(gray, neighbours, pairs, start)
    # What is narrow shows no slant, and lies off the centre.
    return fit_lens_planes(gray, neighbours, pairs, start, steepest=0.005)
