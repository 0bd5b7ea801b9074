"""Which parameters the data ask for: forward selection by score tests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .board_shape import SHAPE
from .bundle_adjustment import Adjusted, adjust, unknowns
from .camera_model import INTERNAL
from .observations import Observations

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


def select_order(start: Adjusted, pixel: float, board: Array, observations: Observations) -> Adjusted:
    """Add groups of parameters to an adjusted camera as long as the likelihood gains more than noise would.

    Each group's gain is that of one Gauss-Newton step on the normal equations of all parameters (Rao's score test); the
    best one joins if it passes the Bayesian information criterion, with one independent observation for each corner.
    """
    found = start
    corners = len(np.unique(np.stack([observations.pose, observations.corner]), axis=1).T)
    while True:
        rows = found.linearise(pixel, observations)
        rows = rows.reshape(-1, rows.shape[2])
        residual = (found.residual / observations.error[:, None]).ravel()
        gains = {
            group: _gain(found, rows, residual, group) / len(group)
            for group, before in _GROUPS
            if group[0] not in found.free and set(before) <= set(found.free)
        }
        best = max(gains, key=lambda group: gains[group], default=None)
        if best is None or gains[best] <= math.log(2 * corners):
            return found
        tried = adjust(found.camera, pixel, found.poses, board, observations, (*found.free, *best), shape=found.shape)
        if not tried.noise < found.noise:
            return found
        found = tried


def _gain(found: Adjusted, rows: Array, residual: Array, group: tuple[str, ...]) -> float:
    """Expected fall of -2 log likelihood if `group` is fitted too."""
    count = len(found.poses.rotation)
    fitted = unknowns(found.free, count)
    own = rows[:, fitted] / np.maximum(np.linalg.norm(rows[:, fitted], axis=0), 1e-150)
    new = rows[:, np.setdiff1d(unknowns(group, count), unknowns((), count))]
    new = new / np.maximum(np.linalg.norm(new, axis=0), 1e-150)
    # What the fitted parameters cannot take up.
    new = new - own @ np.linalg.lstsq(own, new, rcond=None)[0]
    left = new.T @ new
    if np.linalg.eigvalsh(left)[0] < 1e-9:
        return 0.0
    right = new.T @ residual
    return float(right @ np.linalg.solve(left, right)) / (found.noise**2 * found.cluster)
