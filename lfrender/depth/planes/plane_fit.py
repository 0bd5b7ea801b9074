"""A plane of the scene, fitted to the patch sizes of lenses: `1 / s` is linear in the scene coordinates.

A robust linear least-squares fit (IRLS with weights after Geman and McClure), accepted only if a smooth surface through
the residuals does not leave the plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...flat.lens_graph import count_connected
from ...runtime.quantiles import median
from ..same_surface import TOLERANCE
from ..validity.settings import CLASSIFY
from .settings import PLANE, PlaneSettings

__all__ = ["Plane", "fit_plane", "has_outlier_cluster"]

# Powers of x and y in the smooth surface through the residuals: third degree.
_POWERS = np.add.outer(np.arange(4), np.arange(4)) <= 3
# Terms are left out if so little of them is independent of the others, as for lenses in one line.
_DEPENDENT = 1e-6
# Pairs of lenses per independent measurement: both directions, two lenses each.
_DEPENDENT_PAIRS = 4


@dataclass(frozen=True)
class Plane:
    """A plane of the scene, over which 1 / s is linear in the scene coordinates, like any inverse depth."""

    # (float, float, float) `1 / s` [1/px] at `X = (0, 0)`, and its change per px of `X`, order `x, y`
    inverse: NDArray[np.float64]
    scatter: float  # [px] of the patch sizes of single lenses about it
    covariance: NDArray[np.float64]  # (3, 3) of `inverse`
    pitch: float  # [px]
    systematic_error: float = 0.0  # [px] of each lens, from texture that its matches do not explain

    @property
    def slanted(self) -> bool:
        """It does not face the camera."""
        return bool(self.inverse[1:].any())

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) patch size [px] at scene points (n, 2)."""
        return 1 / (self.inverse[0] + points[:, 0] * self.inverse[1] + points[:, 1] * self.inverse[2])

    def over_grid(self, shape: tuple[int, int], first: tuple[float, float], spacing: float) -> NDArray[np.float32]:
        """(h, w) float32 [px] at a regular grid of scene points from `first` on."""
        across = self.inverse[1] * (first[0] + spacing * np.arange(shape[1]))
        down = self.inverse[0] + self.inverse[2] * (first[1] + spacing * np.arange(shape[0]))
        return np.stack([1 / (row + across) for row in down]).astype(np.float32)

    def standard_error(self, points: NDArray[np.float64], settings: PlaneSettings = PLANE) -> NDArray[np.float64]:
        """(n,) standard error [px] of `at`."""
        x, y = points.T
        c = self.covariance
        variance = c[0, 0] + x * (2 * c[0, 1] + c[1, 1] * x + 2 * c[1, 2] * y) + y * (2 * c[0, 2] + c[2, 2] * y)
        size2 = self.at(points) ** 2
        growth = settings.shared_error_growth * size2 * np.sqrt(size2) / self.pitch**2
        shared = np.hypot(np.hypot(settings.shared_error, growth), settings.shared_part * self.systematic_error)
        return np.hypot(shared, size2 * np.sqrt(np.maximum(variance, 0)))


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
    if len(sizes) < settings.fewest_lenses:
        return None
    every = len(sizes) // (5 * settings.sample)
    coarse = replace(settings, bend_errors=settings.significance)
    if every > 4 and fit_plane(points[::every], sizes[::every], pitch, facing, coarse) is None:
        return None
    # Without a common origin and scale the sums of large coordinates would lose digits.
    middle, reach = points.mean(0), float(np.abs(points - points.mean(0)).max()) + 1e-9
    places = (points - middle) / reach
    terms = np.stack([np.ones(len(sizes)), *places.T], 1)
    level: Plane | None = None
    for count in (1,) if facing else (1, 3):
        inverse = _fit_inverse(terms[:, :count], sizes, settings)
        predicted = 1 / (terms[:, :count] @ inverse)
        size = np.abs(predicted) / pitch
        within = (0.5 * CLASSIFY.shading_reach < size).all() and (size < CLASSIFY.resolvable).all()
        if not within or np.ptp(np.sign(predicted)) > 0:
            continue
        residual = sizes - predicted
        scatter, inside = _measure_scatter(residual, settings)
        if scatter > TOLERANCE * pitch or not inside.mean() > settings.min_inliers:
            continue
        if _is_bent(places[inside], residual[inside], scatter, settings):
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
        if count > 1 or facing or not _is_slanted(places[inside], residual[inside], scatter, settings):
            return plane
        level = plane
    return level


def _fit_inverse(
    terms: NDArray[np.float64], sizes: NDArray[np.float64], settings: PlaneSettings
) -> NDArray[np.float64]:
    """(k,) robust linear fit to 1 / s, the error of s being the same for all (IRLS after Geman and McClure)."""
    residual = sizes - median(sizes)
    inverse = np.zeros(terms.shape[1])
    for _ in range(settings.rounds):
        limit = settings.significance * _measure_scatter(residual, settings)[0]
        # An error of s is s^2 times that of 1 / s.
        weight = sizes * sizes * sizes / (1 + (residual / limit) ** 2) ** 2
        left = np.einsum("ni,nj->ij", terms, terms * (weight * sizes)[:, None])
        inverse = np.linalg.lstsq(left, np.einsum("ni,n->i", terms, weight), rcond=None)[0]
        before, residual = residual, sizes - 1 / (terms @ inverse)
        if np.abs(residual - before).max() < settings.settled * settings.tolerance:
            break
    return inverse


def _measure_scatter(residual: NDArray[np.float64], settings: PlaneSettings) -> tuple[float, NDArray[np.bool_]]:
    """Scatter [px] of lenses about a plane, at least that by interpolation, and which of them are inliers (m,)."""
    scatter = max(1.48 * median(np.abs(residual)), settings.tolerance / settings.significance)
    return scatter, np.abs(residual) < settings.significance * scatter


def _is_bent(
    places: NDArray[np.float64], residual: NDArray[np.float64], scatter: float, settings: PlaneSettings
) -> bool:
    """Whether a smooth surface through the residuals leaves the plane anywhere by more than tolerance and error."""
    terms = np.polynomial.polynomial.polyvander2d(places[:, 0], places[:, 1], [3, 3])[:, _POWERS.ravel()]
    basis, size, _ = np.linalg.svd(terms, full_matrices=False)
    basis = basis[:, size > _DEPENDENT * size[0]]
    error = scatter * np.sqrt((basis**2).sum(1))
    return bool((np.abs(basis @ (basis.T @ residual)) > settings.tolerance + settings.bend_errors * error).any())


def _is_slanted(
    places: NDArray[np.float64], residual: NDArray[np.float64], scatter: float, settings: PlaneSettings
) -> bool:
    """Whether a slant explains more of the residuals of a level plane than noise and systematic errors do."""
    away, left = places - places.mean(0), residual - residual.mean()
    square, pull = away.T @ away, away.T @ left
    explained = float(pull @ np.linalg.lstsq(square, pull, rcond=_DEPENDENT)[0])
    noise = _DEPENDENT_PAIRS * (settings.significance * scatter) ** 2
    return explained > max(noise, len(left) * (2 * settings.shared_error) ** 2)


def has_outlier_cluster(
    residual: NDArray[np.floating],
    errors: NDArray[np.floating],
    rows: NDArray[np.int32],
    settings: PlaneSettings = PLANE,
) -> bool:
    """Whether neighbouring lenses leave the plane to the same side: another surface; a single one would be noise.

    `residual` and `errors` (n,) [px] are the distance of each lens from the plane and its standard error, inf or NaN
    where not known; `rows` (n, k) its neighbours.
    """
    with np.errstate(invalid="ignore"):
        off = np.abs(residual) > settings.significance * np.maximum(settings.tolerance, errors)
        return any((count_connected(off & (side * residual > 0), rows) >= settings.cluster).any() for side in (-1, 1))
