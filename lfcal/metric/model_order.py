"""Which parameters the data ask for: forward selection by score tests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bundle_adjustment import Adjusted, Observations, adjust, eliminate, gather, unknowns
from .camera_model import INTERNAL, SHAPE

__all__ = ["BASE", "select_order"]

#: Always fitted.
BASE = INTERNAL[:6]
# Groups that are fitted together, and what has to be fitted before.
_GROUPS: dict[tuple[str, ...], tuple[str, ...]] = {
    ("k2",): (), ("k3",): ("k2",), ("p1", "p2"): (), ("tilt_x", "tilt_y"): (), ("curvature",): (), ("pupil",): (),
    SHAPE[:3]: (), SHAPE[3:]: (),
}  # fmt: skip


def select_order(start: Adjusted, pixel: float, board: NDArray[Any], observations: Observations) -> Adjusted:
    """Add groups of parameters to an adjusted camera as long as the likelihood gains more than noise would.

    Each group's gain is that of one Gauss-Newton step on the normal equations of all parameters (Rao's score test).
    Those that pass the Bayesian information criterion, with one independent observation for each corner, may join. The
    two best ones are fitted, as one step can mistake a tilt for a tangential distortion; the better fit stays.
    """
    found = start
    corners = len(np.unique(np.stack([observations.pose, observations.corner]), axis=1).T)
    while True:
        gains = {
            group: _gain(found, group) / len(group)
            for group, before in _GROUPS.items()
            if group[0] not in found.free and set(before) <= set(found.free)
        }
        passed = [group for group in gains if gains[group] > math.log(2 * corners)]
        tried = [
            adjust(found.camera, pixel, found.poses, board, observations, (*found.free, *group), found.shape)
            for group in sorted(passed, key=lambda group: -gains[group])[:2]
        ]
        best = min(tried, key=lambda one: one.noise, default=found)
        if not best.noise < found.noise:
            return found
        found = best


def _gain(found: Adjusted, group: tuple[str, ...]) -> float:
    """Expected fall of -2 log likelihood if `group` is fitted too."""
    normal, right = gather(found.normal, found.right)
    count = len(found.normal)
    new = np.setdiff1d(unknowns(group, count), unknowns((), count))
    # What the fitted parameters cannot take up.
    left, pull = eliminate(normal, right, new, unknowns(found.free, count))
    scale = 1 / np.sqrt(np.maximum(np.diag(normal)[new], 1e-300))
    left, pull = left * np.outer(scale, scale), pull * scale
    if np.linalg.eigvalsh(left)[0] < 1e-9:
        return 0.0
    return float(pull @ np.linalg.solve(left, pull)) / (found.noise**2 * found.cluster)
