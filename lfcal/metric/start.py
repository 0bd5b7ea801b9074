"""A first camera and first poses, from scene coordinates and patch sizes of the corners of all
boards.

Focal lengths on a grid: with each, the two poses that a plane may have (IPPE, Collins and Bartoli
2014) are parted by the measured depths, as `D / s` is linear in `1 / Z`. The focal length that
explains corners and depths best is the start of the bundle adjustment. No start has to be given,
and no pose can end mirrored.
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


def planar_poses(
    scene: Array, board: Array, focal: float, principal: Array
) -> list[tuple[Array, Array]]:
    """The poses, two at most, of a flat board (k, 3) [mm] seen at scene coordinates (k, 2) [px] by
    a pinhole.
    """
    matrix = np.array([[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1.0]])
    points = np.ascontiguousarray(board), np.ascontiguousarray(scene)
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(*points, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        return []
    found = [
        (cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)
    ]
    return [
        (turn, shift)
        for turn, shift in found
        if np.isfinite(turn).all() and ((board @ turn.T + shift)[:, 2] > 0).all()
    ]


def first_camera(
    boards: Sequence[DetectedBoard], points: Array, image_size: tuple[int, int]
) -> tuple[Array, Poses] | None:
    """Camera (14,) and poses to start from, or None where no focal length explains the corners.

    `points` (k, 3) [mm] are those of the board about its middle.
    """
    # Fields of view of 100 to 1.4 degrees, in steps of 19 %; the adjustment converges from twice
    # that.
    grid = np.geomspace(0.4, 40.0, 28) * image_size[0]
    found = [
        one for focal in grid if (one := _with_focal(boards, points, image_size, focal)) is not None
    ]
    return min(found, key=lambda one: one[0])[1:] if found else None


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
    # Of each board and pose: inverse depths of the corners, and the cost of their places, detected
    # to half a pixel.
    inverse = []
    cost = []
    for board, own in zip(boards, options, strict=True):
        places = [points[board.corner] @ turn.T + shift for turn, shift in own]
        off = [board.scene - principal - focal * place[:, :2] / place[:, 2:] for place in places]
        inverse.append([1 / place[:, 2] for place in places])
        cost.append([float((one**2).sum()) / 0.5**2 for one in off])
    # `s / D` is right to 0.02 about the same everywhere; of single corners the error of `D / s` is
    # not known better.
    error = [0.02 * float(np.median(board.inverse_ratio)) ** 2 for board in boards]
    weight = np.concatenate(
        [np.full(len(b.corner), 1 / e) for b, e in zip(boards, error, strict=True)]
    )
    chosen = [0] * len(boards)
    total = np.inf
    for _ in range(4):
        over = np.concatenate([depths[k] for depths, k in zip(inverse, chosen, strict=True)])
        measured = np.concatenate([board.inverse_ratio for board in boards])
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
    turns, shifts = (
        np.array([poses[k][n] for poses, k in zip(options, chosen, strict=True)]) for n in (0, 1)
    )
    camera = np.zeros(len(INTERNAL))
    camera[:5] = focal, *line, *principal
    return total, camera, Poses(turns, shifts)
