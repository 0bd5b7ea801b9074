"""A first camera and first poses, from scene coordinates and patch sizes of the corners of all boards.

Focal lengths on a grid: with each, the two poses that a plane may have (IPPE, Collins and Bartoli 2014) are parted by
the measured depths, as `D / s` is linear in `1 / Z`. The focal length that explains corners and depths best is the
start of the bundle adjustment. No start has to be given, and no pose can end mirrored.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..boards.detection import DetectedBoard
from .bundle_adjustment import Poses
from .camera_model import INTERNAL

__all__ = ["first_camera", "planar_poses"]

Array = NDArray[Any]


def planar_poses(scene: Array, board: Array, focal: float, principal: Array) -> list[tuple[Array, Array]]:
    """The poses, two at most, of a flat board (k, 3) [mm] seen at scene coordinates (k, 2) [px] by a pinhole."""
    matrix = np.array([[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1.0]])
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            np.ascontiguousarray(board), np.ascontiguousarray(scene), matrix, None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return []
    found = [(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)]
    return [
        (turn, shift) for turn, shift in found if np.isfinite(turn).all() and ((board @ turn.T + shift)[:, 2] > 0).all()
    ]


def first_camera(boards: list[DetectedBoard], points: Array, image_size: tuple[int, int]) -> tuple[Array, Poses] | None:
    """Camera (14,) and poses to start from, or None where no focal length explains the corners.

    `points` (k, 3) [mm] are those of the board about its middle.
    """
    # Fields of view of 100 to 1.4 degrees, in steps of 19 %; the adjustment converges from twice that.
    grid = np.geomspace(0.4, 40.0, 28) * image_size[0]
    found = [one for focal in grid if (one := _with_focal(boards, points, image_size, focal)) is not None]
    return min(found, key=lambda one: one[0])[1:] if found else None


def _with_focal(
    boards: list[DetectedBoard], points: Array, image_size: tuple[int, int], focal: float
) -> tuple[float, Array, Poses] | None:
    """Cost, camera and poses with a focal length [px]."""
    principal = (np.array(image_size) - 1) / 2
    options = [planar_poses(board.scene, points[board.corner], focal, principal) for board in boards]
    if not all(options):
        return None

    def inverse_depth(m: int, option: int) -> Array:
        turn, shift = options[m][option]
        return 1 / (points[boards[m].corner] @ turn.T + shift)[:, 2]

    measured = np.concatenate([board.inverse_ratio for board in boards])
    # `s / D` is right to 0.02 about the same everywhere; of single corners the error of `D / s` is not known better.
    error = np.concatenate([np.full(len(b.corner), 0.02 * np.median(b.inverse_ratio) ** 2) for b in boards])
    chosen = [0] * len(boards)
    for _ in range(4):
        line = _line(np.concatenate([inverse_depth(m, k) for m, k in enumerate(chosen)]), measured, error)
        chosen = [
            min(
                range(len(options[m])),
                key=lambda k: float(((board.inverse_ratio - line[0] - line[1] * inverse_depth(m, k)) ** 2).sum()),
            )
            for m, board in enumerate(boards)
        ]
    if line[1] >= 0:
        return None
    over = np.concatenate([inverse_depth(m, k) for m, k in enumerate(chosen)])
    cost = float((((measured - line[0] - line[1] * over) / error) ** 2).sum())
    for m, board in enumerate(boards):
        turn, shift = options[m][chosen[m]]
        place = points[board.corner] @ turn.T + shift
        # Detected to half a pixel.
        cost += float((((board.scene - principal - focal * place[:, :2] / place[:, 2:]) / 0.5) ** 2).sum())
    turns, shifts = zip(*(options[m][k] for m, k in enumerate(chosen)), strict=True)
    camera = np.zeros(len(INTERNAL))
    camera[:5] = focal, *line, *principal
    return cost, camera, Poses(np.array(turns), np.array(shifts))


def _line(x: Array, y: Array, error: Array) -> Array:
    """Offset and slope of `y` over `x` of least absolute residuals."""
    from scipy.optimize import least_squares

    design = np.column_stack([np.ones_like(x), x])
    start = np.linalg.lstsq(design / error[:, None], y / error, rcond=None)[0]
    scale = float(np.median(np.abs(y - design @ start) / error)) + 1e-12
    found = least_squares(
        lambda line: (y - design @ line) / error, start, lambda _line: -design / error[:, None],
        x_scale="jac", loss="soft_l1", f_scale=scale,
    )  # fmt: skip
    return np.asarray(found.x)
