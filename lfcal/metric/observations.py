"""Corners of boards as single microimages show them, and their triangulation to scene coordinates and patch sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.frozen import Frozen

__all__ = ["Observations", "Triangulated", "triangulate"]


@dataclass(frozen=True, eq=False)
class Observations(Frozen):
    """Corners seen in microimages, sorted by pose.

    Parameters
    ----------
    pose : (n,) int64
        Which flat.
    corner : (n,) int64
        Which point of the board.
    centre : (n, 2) float64 [px]
        Of the microimage.
    position : (n, 2) float64 [px]
        Where on the flat the corner is seen.
    error : (n,) float64 [px]
        Standard error of `position` along each axis; 1 where only ratios are known.
    """

    pose: NDArray[np.int64]
    corner: NDArray[np.int64]
    centre: NDArray[np.float64]
    position: NDArray[np.float64]
    error: NDArray[np.float64]

    def __post_init__(self) -> None:
        order = np.argsort(self.pose, kind="stable")
        self._set(
            pose=np.asarray(self.pose, np.int64)[order],
            corner=np.asarray(self.corner, np.int64)[order],
            centre=np.asarray(self.centre, np.float64)[order],
            position=np.asarray(self.position, np.float64)[order],
            error=np.asarray(self.error, np.float64)[order],
        )

    def __len__(self) -> int:
        return len(self.pose)

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Observations:
        """Those of a mask or of indices."""
        return Observations(
            self.pose[chosen], self.corner[chosen], self.centre[chosen], self.position[chosen], self.error[chosen]
        )


@dataclass(frozen=True)
class Triangulated:
    """What the microimages that see a corner tell together, without a camera model.

    Parameters
    ----------
    pose, corner : (m,) int64
    scene : (m, 2) float64 [px]
        Scene coordinates `X` of docs/geometry.md.
    ratio : (m,) float64
        `s / D`.
    covariance : (m, 3, 3) float64
        Of `X_x, X_y, s / D`, for observations with their stated errors.
    lenses : (m,) int64
        Microimages that see it.
    """

    pose: NDArray[np.int64]
    corner: NDArray[np.int64]
    scene: NDArray[np.float64]
    ratio: NDArray[np.float64]
    covariance: NDArray[np.float64]
    lenses: NDArray[np.int64]

    def columns(self) -> tuple[NDArray[Any], ...]:
        """All arrays, in the order of the fields."""
        return self.pose, self.corner, self.scene, self.ratio, self.covariance, self.lenses

    def select(self, chosen: NDArray[np.bool_]) -> Triangulated:
        """Those of a mask."""
        return Triangulated(*(column[chosen] for column in self.columns()))


def triangulate(observations: Observations, fewest: int) -> Triangulated:
    """Fit `p = c - (X - c) s / D` to the microimages of each corner, least squares in `s / D` and `X s / D`.

    Corners that fewer than `fewest` microimages see are left out.
    """
    o = observations
    key = o.pose * (o.corner.max(initial=0) + 1) + o.corner
    keys, group = np.unique(key, return_inverse=True)
    weight = 1 / o.error**2
    count = np.bincount(group)

    def total(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(group, weight * values).astype(np.float64)

    # p - c = c q - u, with q = s / D and u = X q: the mean of c apart, so that q is the slope of p - c over c.
    norm = total(np.ones(len(o)))
    mean_c = np.stack([total(o.centre[:, k]) / norm for k in (0, 1)], axis=1)
    delta = o.position - o.centre
    mean_d = np.stack([total(delta[:, k]) / norm for k in (0, 1)], axis=1)
    c, d = o.centre - mean_c[group], delta - mean_d[group]
    spread = total((c**2).sum(1))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = total((c * d).sum(1)) / spread
        scene = mean_c - mean_d / ratio[:, None]
        # X = mean_c - mean_d / q; errors of mean_d and q are independent.
        by_ratio = np.column_stack([mean_d / ratio[:, None] ** 2, np.ones(len(ratio))])
        covariance = by_ratio[:, :, None] * by_ratio[:, None, :] / spread[:, None, None]
        covariance[:, [0, 1], [0, 1]] += (1 / (norm * ratio**2))[:, None]
    kept = (count >= fewest) & (spread > 0) & np.isfinite(scene).all(1)
    width = o.corner.max(initial=0) + 1
    return Triangulated(
        keys[kept] // width, keys[kept] % width, scene[kept], ratio[kept], covariance[kept], count[kept]
    )
