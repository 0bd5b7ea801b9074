"""Which parameters the data ask for: forward selection by score tests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .board_shape import SHAPE
from .bundle_adjustment import Adjusted, adjust, normal_equations, unknowns
from .camera_model import INTERNAL
from .observations import Observations
from .settings import ADJUSTMENT, AdjustmentSettings

__all__ = ["BASE", "select_order"]

Array = NDArray[Any]

#: Always fitted.
BASE = INTERNAL[:6]
# Groups that are fitted together, and what has to be fitted before.
_GROUPS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("k2",), ()),
    (("k3",), ("k2",)),
    (("p1", "p2"), ()),
    (("tilt_x", "tilt_y"), ()),
    (("curvature",), ()),
    (("pupil",), ()),
    (SHAPE[:3], ()),
    (SHAPE[3:], ()),
)


def select_order(
    start: Adjusted,
    pixel: float,
    board: Array,
    observations: Observations,
    *,
    settings: AdjustmentSettings = ADJUSTMENT,
) -> Adjusted:
    """Add groups of parameters to an adjusted camera as long as the likelihood gains more than noise would.

    Each group's gain is that of one Gauss-Newton step on the normal equations of all parameters (Rao's score test); the
    best one joins if it passes the Bayesian information criterion, with one independent observation for each corner.
    """
    found = start
    corners = len(np.unique(observations.pose * 100_000 + observations.corner))
    price = settings.bayes_factor * math.log(2 * corners)
    while True:
        gains = {
            group: _gain(found, pixel, observations, group) / len(group)
            for group, before in _GROUPS
            if group[0] not in found.free and set(before) <= set(found.free)
        }
        best = max(gains, key=lambda group: gains[group], default=None)
        if best is None or gains[best] <= price:
            return found
        free = (*found.free, *best)
        tried = adjust(
            found.camera, pixel, found.poses, board, observations, free, shape=found.shape, settings=settings
        )
        if not tried.noise < found.noise:
            return found
        found = tried


def _gain(found: Adjusted, pixel: float, observations: Observations, group: tuple[str, ...]) -> float:
    """Expected fall of -2 log likelihood if `group` is fitted too."""
    normals = normal_equations(found.camera, pixel, found.poses, found.board, observations, found.weight)
    count = len(found.poses.rotation)
    fitted = unknowns(found.free, count)
    new = np.setdiff1d(unknowns(group, count), unknowns((), count))
    matrix, gradient = normals.matrix, normals.gradient
    both = np.linalg.solve(matrix[np.ix_(fitted, fitted)], matrix[np.ix_(fitted, new)])
    left = matrix[np.ix_(new, new)] - matrix[np.ix_(new, fitted)] @ both
    right = gradient[new] - both.T @ gradient[fitted]
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix)[new], 1e-300))
    left = left * np.outer(scale, scale)
    if np.linalg.eigvalsh(left)[0] < 1e-9:
        return 0.0
    right = right * scale
    return float(right @ np.linalg.solve(left, right)) / (found.noise**2 * found.cluster)
