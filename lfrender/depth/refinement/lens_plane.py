"""Patch size and slant of each lens: a robust plane through what the pairs with its neighbours
measure.

The patch size over a plane of the scene is linear in microimage coordinates, like any inverse
depth.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from typing import NamedTuple

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


class _LensPairs(NamedTuple):
    """What the pairs of each lens have measured, in float64: single precision would move a patch
    size by up to 0.1 px where pairs nearly lie on a line.
    """

    patch_size: NDArray[np.float64]  # (n, k) [px], NaN where nothing was measured
    variance: NDArray[np.float64]  # (n, k) [px^2]
    place: NDArray[np.float64]  # (n, k, 2) [px] from the centre of the lens, order `x, y`


def _gather_pairs(gray: GrayFlat, neighbours: Neighbours, pairs: PairFits) -> _LensPairs:
    """The fits of each lens with all its neighbours: of the two fits of a pair, the one that began
    at the start value of the lens.
    """

    def of_lenses(values: NDArray[np.float32]) -> NDArray[np.float64]:
        ahead = list(values[:, :, 0].swapaxes(0, 1))
        for own, rows in zip(values.swapaxes(0, 1), neighbours.backward.T, strict=True):
            ahead.append(own[:, 1].take(rows, 0))
        return np.stack(ahead, 1, dtype=np.float64)

    sizes = of_lenses(pairs.patch_size)
    sizes[neighbours.all < 0] = np.nan
    # From the middle between both microimages to this one: half a patch, away from the neighbour.
    apart = gray.centres.take(neighbours.all, 0) - gray.centres[:, None]
    place = of_lenses(pairs.place) - (0.5 / gray.pitch) * sizes[:, :, None] * apart
    return _LensPairs(sizes, of_lenses(pairs.variance), place)


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _fit_plane(sizes, variances, places, start, prior, rounds):
    """Plane through the pairs of a lens by IRLS with the weights of Geman and McClure, from a
    patch size and with a `prior` (3,): slant, and its inverse variance.

    The last two `rounds` know that slant. Returns the plane, with slopes relative to the prior, chi
    square, and the sum of the weights.
    """
    # Three standard deviations; what is twice as far off is another surface.
    outlier2 = 9.0
    slant_x, slant_y, known = prior
    plane = Plane(start, 0.0, 0.0, 0.0, 0.0, 0.0)
    chi2 = weights = 0.0
    for turn in range(rounds):
        sums = no_points(0.0)
        chi2 = weights = 0.0
        for k in range(len(sizes)):
            if np.isnan(sizes[k]):
                continue
            x = places[k, 0]
            y = places[k, 1]
            variance = variances[k]
            value = sizes[k] - slant_x * x - slant_y * y
            residual = value - plane.height - plane.slope_x * x - plane.slope_y * y
            limit = outlier2 * variance
            if turn < rounds - 2:
                limit += (x * x + y * y) / known
            weight = geman_mcclure(residual * residual, limit)
            chi2 += weight * residual * residual / variance
            weights += weight
            sums = add_point(sums, weight / variance, x, y, value)
        plane = solve_plane(sums, known)
    return plane, chi2, weights


@kernel(fastmath=FAST, error_model="numpy", share=lambda pairs, start, *_: len(start))
def _fit_planes(begin, end, pairs: _LensPairs, start, prior, rounds, out: _Planes):
    """Fit a plane to the pairs of each lens, from `start` (n,) and with the `prior` (n, 3): slant,
    inverse variance.
    """
    patch_sizes, variances, places = pairs
    sizes, slants, spreads = out
    for lens in range(begin, end):
        sizes[lens] = np.nan
        slants[lens] = 0.0
        spreads[lens, :2] = np.inf
        spreads[lens, 2:] = 0.0
        if not np.isfinite(start[lens]) or np.isnan(patch_sizes[lens]).all():
            continue
        slant_x = np.float64(prior[lens, 0])
        slant_y = np.float64(prior[lens, 1])
        known = np.float64(prior[lens, 2])
        plane, chi2, weights = _fit_plane(
            patch_sizes[lens],
            variances[lens],
            places[lens],
            np.float64(start[lens]),
            (slant_x, slant_y, known),
            rounds,
        )
        # Pairs that agree to the last digit, as without noise, may leave no weight at all.
        if np.isnan(plane.height):
            continue
        slope_variance = 0.5 * (plane.slope_x_variance + plane.slope_y_variance)
        sizes[lens] = plane.height
        slants[lens, 0] = slant_x + plane.slope_x
        slants[lens, 1] = slant_y + plane.slope_y
        spreads[lens, 0] = plane.height_variance
        spreads[lens, 1] = slope_variance
        spreads[lens, 2] = chi2
        # Each parameter takes a degree of freedom as far as the pairs, and not the prior, determine
        # it.
        own = 1 - min(1.0, slope_variance * known)
        spreads[lens, 3] = max(weights - 1 - 2 * own, 0.0)


class _Surfaces(NamedTuple):
    """Neighbours of each lens, and which of them are on its surface."""

    rows: NDArray[np.int32]  # (k, n)
    alike: NDArray[np.bool_]  # (k, n)

    def sum(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, m) sum of `values` (n, m) over the neighbours on the surface of each lens."""
        return np.asarray((self.alike[:, :, None] * values.take(self.rows, 0)).sum(0))


def _find_surfaces(gray: GrayFlat, neighbours: Neighbours, planes: _Planes) -> _Surfaces:
    rows = np.ascontiguousarray(neighbours.all.T)
    sizes = planes.sizes
    gap = np.float32(TOLERANCE * gray.pitch)
    return _Surfaces(rows, (rows >= 0) & same_surface(sizes.take(rows), sizes, gap))


def _predict_slants(planes: _Planes, surfaces: _Surfaces, prior: NDArray[np.float32]) -> None:
    """Fill `prior` with the mean slant of each lens and its neighbours on one surface, and its
    inverse variance, where there are two or more.
    """
    slants = planes.slants
    weight = 1 / planes.spreads[:, 1:2]
    terms = weight * np.column_stack([np.ones_like(weight), slants, np.square(slants).sum(1)])
    count = 1 + surfaces.alike.sum(0)
    some = count >= 3
    count = count[some]
    sums = (terms + surfaces.sum(terms))[some]
    total = sums[:, 0]
    mean = sums[:, 1:3] / total[:, None]
    # Scatter about the mean beyond the errors of the slants is curvature of the surface.
    scatter = 0.5 * (sums[:, 3] / total - np.square(mean).sum(1)) * count / (count - 1)
    curvature = np.maximum(scatter - count / total, 0)
    prior[some, :2] = mean
    prior[some, 2] = 1 / (curvature + 1 / total)


def _standard_errors(
    planes: _Planes, surfaces: _Surfaces, pitch: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(n,) errors of patch sizes, and of slants, scaled by the scatter of the pairs of a lens and of
    its neighbours on one surface, and for what all pairs of a lens share by one and |s| over the
    pitch.
    """
    spreads = planes.spreads
    scatter = np.ascontiguousarray(spreads[:, 2:])
    chi2, freedom = (scatter + np.float32(0.5) * surfaces.sum(scatter)).T
    factor = (1 + np.abs(planes.sizes) / np.float32(pitch)) * np.sqrt((chi2 + 1) / (freedom + 1))
    errors = np.where(np.isnan(factor), np.inf, factor) * np.sqrt(spreads[:, :2].T)
    return errors[0], errors[1]


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
    float32 = np.float32
    planes = _Planes(np.empty(n, float32), np.empty((n, 2), float32), np.empty((n, 4), float32))
    prior = np.zeros((n, 3), float32)
    prior[:, 2] = 1 / steepest**2
    measured = _gather_pairs(gray, neighbours, pairs)
    _fit_planes(measured, start.astype(float32), prior, 4, planes)
    _predict_slants(planes, _find_surfaces(gray, neighbours, planes), prior)
    _fit_planes(measured, planes.sizes.copy(), prior, 2, planes)
    errors, slant_errors = _standard_errors(
        planes, _find_surfaces(gray, neighbours, planes), gray.pitch
    )
    return LensFits(planes.sizes, errors, planes.slants, slant_errors)


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
