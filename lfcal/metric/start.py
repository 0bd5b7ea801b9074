"""A first camera and first poses, from scene coordinates and patch sizes of the corners of boards.

A grid of focal lengths is tried. With each, a plane may have two poses (IPPE, Collins and Bartoli
2014); the measured depths decide between them, as `D / s` is linear in `1 / Z`. The focal length
that explains corners and depths best starts the bundle adjustment. So the user need not give a
start, and no pose ends mirrored.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ..boards.detection import DetectedBoard
from ..runtime.arrays import Array
from .bundle_adjustment import Poses
from .camera_model import INTERNAL

__all__ = ["first_camera", "planar_poses"]

# Focal lengths [widths of the flat]: fields of view of 100 to 1.4 degrees, in steps of 19 %; the
# adjustment converges from a focal length that is wrong by a factor of two.
_FOCAL_LENGTHS = np.geomspace(0.4, 40.0, 28)
# Errors of detected corners [px], and of the `s / D` of their plane.
_PLACE_ERROR = 0.5
_RATIO_ERROR = 0.02


def planar_poses(
    scene: Array, board: Array, focal: float, principal: Array
) -> list[tuple[Array, Array]]:
    """Up to two poses of a board (k, 3) [mm] that a pinhole sees at (k, 2) [px] of the scene."""
    matrix = np.array([[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1.0]])
    points = np.ascontiguousarray(board), np.ascontiguousarray(scene)
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(*points, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        return []
    found = []
    for turn, shift in zip(turns, shifts, strict=True):
        pose = cv2.Rodrigues(turn)[0], shift.ravel()
        # A NaN fails the comparison.
        if ((board @ pose[0].T + pose[1])[:, 2] > 0).all():
            found.append(pose)
    return found


def first_camera(
    boards: Sequence[DetectedBoard], points: Array, image_size: tuple[int, int]
) -> tuple[Array, Poses] | None:
    """Camera (14,) and poses to start from, or None if no focal length explains the corners.

    `points` (k, 3) [mm] are the points of the board about its middle.
    """
    tried = [_with_focal(boards, points, image_size, f * image_size[0]) for f in _FOCAL_LENGTHS]
    found = min(filter(None, tried), key=lambda one: one[0], default=None)
    return found and found[1:]


def _with_focal(
    boards: Sequence[DetectedBoard], points: Array, image_size: tuple[int, int], focal: float
) -> tuple[float, Array, Poses] | None:
    """Cost, camera and poses with a focal length [px]."""
    principal = (np.array(image_size) - 1) / 2
    options = [
        planar_poses(board.scene, points[board.corner], focal, principal) for board in boards
    ]
    if not all(options):
        return None
    # Inverse depths of the corners and cost of their places, for each board and pose.
    inverse = []
    cost = []
    for board, own in zip(boards, options, strict=True):
        places = [points[board.corner] @ turn.T + shift for turn, shift in own]
        off = [board.scene - principal - focal * place[:, :2] / place[:, 2:] for place in places]
        inverse.append([1 / place[:, 2] for place in places])
        cost.append([float((one**2).sum()) / _PLACE_ERROR**2 for one in off])
    # The error of `s / D` is about the same everywhere.
    error = [_RATIO_ERROR * float(np.median(board.inverse_ratio)) ** 2 for board in boards]
    weight = np.repeat(1 / np.array(error), [len(board.corner) for board in boards])
    measured = np.concatenate([board.inverse_ratio for board in boards])
    chosen = [0] * len(boards)
    for _ in range(4):
        over = np.concatenate([depths[k] for depths, k in zip(inverse, chosen, strict=True)])
        line = np.polynomial.Polynomial.fit(over, measured, 1, w=weight).convert().coef
        costs = [
            [
                placed
                + float(((board.inverse_ratio - line[0] - line[1] * depth) ** 2).sum()) / e**2
                for depth, placed in zip(depths, own, strict=True)
            ]
            for board, depths, own, e in zip(boards, inverse, cost, error, strict=True)
        ]
        chosen = [int(np.argmin(one)) for one in costs]
        total = sum(min(one) for one in costs)
    if line[1] >= 0:
        return None
    best = [poses[k] for poses, k in zip(options, chosen, strict=True)]
    turns, shifts = map(np.array, zip(*best, strict=True))
    camera = np.zeros(len(INTERNAL))
    camera[:5] = focal, *line, *principal
    return total, camera, Poses(turns, shifts)
