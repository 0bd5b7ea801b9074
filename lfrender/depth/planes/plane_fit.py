"""A plane of the scene, fitted to the patch sizes of lenses: `1 / s` is linear in the scene coordinates.

A robust linear least-squares fit (IRLS with weights after Geman and McClure), accepted only if a smooth surface through
the residuals does not leave the plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.kernels.jit import njit

from ...flat.lens_graph import count_connected
from ...runtime.normal_equations import solve_cholesky
from ...runtime.order_statistics import median_of
from ...runtime.quantiles import median
from .settings import PLANE, PlaneSettings

__all__ = ["Plane", "fit_plane", "has_outlier_cluster", "is_nearly_planar"]

# Degree of the smooth surface through the residuals.
_DEGREE = 3
# A term of it is left out if so little of it is independent of the others, as for lenses in one line.
_DEPENDENT = 1e-6


@dataclass(frozen=True)
class Plane:
    """A plane of the scene, over which 1 / s is linear in the scene coordinates, like any inverse depth."""

    # (float, float, float) `1 / s` [1/px] at `X = (0, 0)`, and its change per px of `X`, order `x, y`
    inverse: NDArray[np.float64]
    scatter: float  # [px] of the patch sizes of single lenses about it
    covariance: NDArray[np.float64]  # (3, 3) of `inverse`
    pitch: float  # [px]
    systematic_error: float = 0.0  # [px] of each lens, from texture that its matches do not explain
    # Variance that a slant would explain of what a plane that faces the camera leaves, over that of an independent
    # measurement.
    slant_ratio: float = 0.0

    @property
    def slanted(self) -> bool:
        """It does not face the camera."""
        return bool(self.inverse[1:].any())

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) patch size [px] at scene points (n, 2)."""
        return 1 / (self.inverse[0] + points[:, 0] * self.inverse[1] + points[:, 1] * self.inverse[2])

    def over_grid(self, shape: tuple[int, int], first: tuple[float, float], spacing: float) -> NDArray[np.float32]:
        """(h, w) float32 [px] at a regular grid of scene points from `first` on."""
        out = np.empty(shape, np.float32)
        _over_grid(np.asarray(self.inverse, np.float64), *first, spacing, out)
        return out

    def standard_error(self, points: NDArray[np.float64], settings: PlaneSettings = PLANE) -> NDArray[np.float64]:
        """(n,) standard error [px] of `at`."""
        x, y = points.T
        c = self.covariance
        variance = c[0, 0] + x * (2 * c[0, 1] + c[1, 1] * x + 2 * c[1, 2] * y) + y * (2 * c[0, 2] + c[2, 2] * y)
        size2 = self.at(points) ** 2
        growth = settings.shared_error_growth * size2 * np.sqrt(size2) / self.pitch**2
        shared = np.hypot(np.hypot(settings.shared_error, growth), settings.shared_part * self.systematic_error)
        return np.hypot(shared, size2 * np.sqrt(np.maximum(variance, 0)))


@njit(cache=True, nogil=True, error_model="numpy", share=lambda *given: len(given[4]))
def _over_grid(begin, end, inverse, left, top, spacing, out):
    for v in range(begin, end):
        row = out[v]
        start = inverse[0] + inverse[1] * left + inverse[2] * (top + spacing * v)
        for u in range(len(row)):
            row[u] = 1 / (start + inverse[1] * spacing * u)


def fit_plane(
    points: NDArray[np.float64],
    sizes: NDArray[np.float64],
    pitch: float,
    facing: bool = False,
    settings: PlaneSettings = PLANE,
) -> Plane | None:
    """Fit a plane to patch sizes: one that faces the camera, else a slanted one; None where lenses do not lie on it.

    `points` (m, 2) [px] are scene points, spread over the flat, `sizes` (m,) [px] the patch sizes measured there. With
    `facing` only a plane that faces the camera, or nearly so, is accepted.
    """
    # Without a common origin and scale the sums of large coordinates would lose digits.
    middle, reach = points.mean(0), float(np.abs(points - points.mean(0)).max()) + 1e-9
    places = (points - middle) / reach
    terms = np.stack([np.ones(len(sizes)), *places.T], 1)
    every = len(sizes) // settings.test_lenses
    some = slice(None, None, max(1, every))
    level: Plane | None = None
    for count in (1,) if facing else (1, 3):
        if every > 1 and _is_hopeless(places[some], terms[some, :count], sizes[some], settings):
            continue
        inverse = _fit_inverse(terms[:, :count], sizes, settings, settings.rounds)
        predicted = 1 / (terms[:, :count] @ inverse)
        size = np.abs(predicted)
        within = (settings.min_ratio * pitch < size).all() and (size < settings.max_ratio * pitch).all()
        if not within or np.ptp(np.sign(predicted)) > 0:
            continue
        residual = sizes - predicted
        scatter = _measure_scatter(places, residual, settings, settings.uncertain)
        if scatter is None:
            continue
        # In terms of the coordinates themselves.
        change = np.zeros((3, 3))
        change[0, 0] = 1
        change[0, 1:] = -middle / reach
        change[[1, 2], [1, 2]] = 1 / reach
        change = change[:, :count]
        weight = np.einsum("ni,nj,n->ij", terms[:, :count], terms[:, :count], predicted**4)
        covariance = scatter**2 * np.linalg.inv(weight)
        plane = Plane(change @ inverse, scatter, change @ covariance @ change.T, pitch)
        if count > 1 or facing:
            return plane
        level = replace(plane, slant_ratio=_slant_ratio(places, residual, scatter, settings))
        if level.slant_ratio < settings.slanted_from:
            return level
    return level


def is_nearly_planar(
    places: NDArray[np.float64], sizes: NDArray[np.float64], pitch: float, settings: PlaneSettings = PLANE
) -> bool:
    """Whether most lenses at `places` (m, 2) may lie on one plane, from patch sizes searched to whole pixels (m,)."""
    terms = np.column_stack([np.ones(len(sizes)), (places - places.mean(0)) / (np.ptp(places) + 1e-9)])
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.abs(sizes - 1 / (terms @ _fit_inverse(terms, sizes, settings, settings.rounds, near_median=True)))
    return bool((away <= settings.nearly * pitch).mean() >= settings.nearly_share)


def _is_hopeless(
    places: NDArray[np.float64], terms: NDArray[np.float64], sizes: NDArray[np.float64], settings: PlaneSettings
) -> bool:
    """Whether a few lenses already leave the best plane farther than noise explains."""
    residual = sizes - 1 / (terms @ _fit_inverse(terms, sizes, settings, settings.rounds // 2))
    return _measure_scatter(places, residual, settings, settings.test_uncertain) is None


# Sums run one after the other: in vector loops or threads, which add in another order, they would have other bits.
@njit(cache=True, nogil=True, error_model="numpy")
def _fit_inverse_terms(rows, sizes, rounds, near_median, outlier, min_scatter, settled):
    """`_fit_inverse` for terms (k, n), k at most 3."""
    count, number = rows.shape
    inverse, left, right = np.zeros(count), np.empty((count, count)), np.empty(count)
    residual, work = np.empty(number), sizes.copy()
    middle = median_of(work)
    inverse[0] = 1 / middle
    for n in range(number):
        residual[n] = sizes[n] - middle
    for turn in range(rounds):
        weighed = turn > 0 or count == 1 or near_median
        limit = np.inf
        if weighed:
            for n in range(number):
                work[n] = abs(residual[n])
            limit = outlier * max(1.48 * median_of(work), min_scatter)
        left[:], right[:] = 0.0, 0.0
        for n in range(number):
            s = sizes[n]
            away = residual[n] / limit
            share = 1 / (1 + away * away)
            # An error of s is s^2 times that of 1 / s.
            w = share * share * (s * s) * (s * s)
            for i in range(count):
                right[i] += w * rows[i, n] / s
                for j in range(i + 1):
                    left[i, j] += w * rows[i, n] * rows[j, n]
        solve_cholesky(left, right, inverse)
        change = 0.0
        for n in range(number):
            value = inverse[0] * rows[0, n]
            for i in range(1, count):
                value += inverse[i] * rows[i, n]
            after = sizes[n] - 1 / value
            change = max(change, abs(after - residual[n]))
            residual[n] = after
        if change < settled:
            break
    return inverse


def _fit_inverse(
    terms: NDArray[np.float64],
    sizes: NDArray[np.float64],
    settings: PlaneSettings,
    rounds: int,
    near_median: bool = False,
) -> NDArray[np.float64]:
    """(k,) robust linear fit to 1 / s, the error of s being the same for all (IRLS, weights after Geman and McClure).

    With `near_median` the first round already gives less weight to what is far from the median.
    """
    return _fit_inverse_terms(
        np.ascontiguousarray(terms.T), np.ascontiguousarray(sizes), rounds, near_median, settings.outlier,
        settings.min_scatter, settings.settled,
    )  # fmt: skip


def _measure_scatter(
    places: NDArray[np.float64], residual: NDArray[np.float64], settings: PlaneSettings, deviations: float
) -> float | None:
    """Scatter [px] of lenses about a plane; None where too few are inliers, or a smooth surface leaves the plane."""
    scatter = 1.48 * median(np.abs(residual))
    inside = np.abs(residual) < settings.outlier * max(scatter, settings.min_scatter)
    if not inside.mean() > settings.min_inliers:
        return None
    return None if _is_bent(places[inside], residual[inside], deviations * scatter, settings.max_bend) else scatter


def _slant_ratio(
    places: NDArray[np.float64], residual: NDArray[np.float64], scatter: float, settings: PlaneSettings
) -> float:
    """Variance that a slant explains of the residuals of a level plane, over that of an independent measurement.

    0 where systematic errors explain as much.
    """
    inside = np.abs(residual) < settings.outlier * max(scatter, settings.min_scatter)
    away, left = places[inside] - places[inside].mean(0), residual[inside] - residual[inside].mean()
    square, pull = away.T @ away, away.T @ left
    explained = float(pull @ np.linalg.lstsq(square, pull, rcond=_DEPENDENT)[0])
    systematic = len(left) * settings.min_slant**2
    return explained / (settings.dependent * max(scatter, 1e-9) ** 2) if explained > systematic else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _is_bent(places, residual, deviation, max_bend):
    """Whether a smooth surface of degree `_DEGREE` through the residuals is anywhere farther from zero than `max_bend`
    and its uncertainty, that of `deviation` per lens."""
    count = (_DEGREE + 1) * (_DEGREE + 2) // 2
    terms = np.empty((count, len(places)))
    value, uncertain = np.zeros(len(places)), np.zeros(len(places))
    found = 0
    for i in range(_DEGREE + 1):
        for j in range(_DEGREE + 1 - i):
            term = terms[found]
            for n in range(len(places)):
                term[n] = places[n, 0] ** i * places[n, 1] ** j
            whole = np.sqrt((term * term).sum())
            # Gram-Schmidt, twice because of rounding.
            for _ in range(2):
                for k in range(found):
                    shared = (term * terms[k]).sum()
                    for n in range(len(places)):
                        term[n] -= shared * terms[k, n]
            own = np.sqrt((term * term).sum())
            if own <= _DEPENDENT * whole:
                continue
            term /= own
            factor = (term * residual).sum()
            for n in range(len(places)):
                value[n] += factor * term[n]
                uncertain[n] += term[n] * term[n]
            found += 1
    return bool((np.abs(value) > max_bend + deviation * np.sqrt(uncertain)).any())


def has_outlier_cluster(
    residual: NDArray[np.float64],
    errors: NDArray[np.float64],
    rows: NDArray[np.int32],
    settings: PlaneSettings = PLANE,
) -> bool:
    """Whether neighbouring lenses leave the plane to the same side: another surface; a single one would be noise.

    `residual` and `errors` (n,) [px] are the distance of each lens from the plane and its standard error, inf or NaN
    where not known; `rows` (n, k) its neighbours.
    """
    with np.errstate(invalid="ignore"):
        off = np.abs(residual) > np.maximum(settings.stray_distance, settings.stray_errors * errors)
        return any(
            (count_connected(off & (side * residual > 0), rows) >= settings.stray_neighbours).any() for side in (-1, 1)
        )
