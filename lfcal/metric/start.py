"""A first camera and first poses, from the triangulated corners of all boards.

Focal lengths on a grid: with each, the two poses that a plane may have (IPPE, Collins and Bartoli 2014) are parted by
the measured depths, as `D / s` is linear in `1 / Z`. The focal length that explains corners and depths best is the
start of the bundle adjustment. No start has to be given, and no pose can end mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .bundle_adjustment import Poses
from .camera_model import INTERNAL
from .observations import Triangulated
from .settings import START, StartSettings

__all__ = ["first_camera", "planar_poses"]

Array = NDArray[Any]


@dataclass(frozen=True)
class _Candidate:
    cost: float
    camera: Array
    poses: Poses


def planar_poses(scene: Array, board: Array, focal: float, principal: Array) -> list[tuple[Array, Array]]:
    """The poses, two at most, of a flat board (k, 3) [mm] seen at scene coordinates (k, 2) [px] by a pinhole."""
    matrix = np.array([[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1.0]])
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            board.reshape(-1, 1, 3), scene.reshape(-1, 1, 2), matrix, None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return []
    found = [(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)]
    return [
        (turn, shift) for turn, shift in found if np.isfinite(turn).all() and ((board @ turn.T + shift)[:, 2] > 0).all()
    ]


def first_camera(
    seen: Triangulated, board: Array, image_size: tuple[int, int], poses: int, *, settings: StartSettings = START
) -> tuple[Array, Poses] | None:
    """Camera (14,) and poses to start from, or None where no focal length explains the corners."""
    grid = np.geomspace(settings.shortest_focal, settings.longest_focal, settings.grid) * image_size[0]
    found = [c for focal in grid if (c := _with_focal(seen, board, image_size, poses, focal)) is not None]
    if not found:
        return None
    best = min(found, key=lambda candidate: candidate.cost)
    return best.camera, best.poses


def _with_focal(
    seen: Triangulated, board: Array, image_size: tuple[int, int], poses: int, focal: float
) -> _Candidate | None:
    principal = (np.array(image_size) - 1) / 2
    options = []
    for m in range(poses):
        own = seen.pose == m
        options.append(planar_poses(seen.scene[own], board[seen.corner[own]], focal, principal))
        if not options[-1]:
            return None
    inverse = 1 / seen.ratio  # D / s
    error = np.sqrt(seen.covariance[:, 2, 2]) * inverse**2

    def inverse_depth(m: int, option: int) -> Array:
        turn, shift = options[m][option]
        return 1 / (board[seen.corner[seen.pose == m]] @ turn.T + shift)[:, 2]

    chosen = [0] * poses
    for _ in range(3):
        over = np.concatenate([inverse_depth(m, chosen[m]) for m in range(poses)])
        line = _line(over, inverse, error)
        chosen = [
            min(
                range(len(options[m])),
                key=lambda k: float((((inverse - line[0])[seen.pose == m] - line[1] * inverse_depth(m, k)) ** 2).sum()),
            )
            for m in range(poses)
        ]
    over = np.concatenate([inverse_depth(m, chosen[m]) for m in range(poses)])
    line = _line(over, inverse, error)
    if line[1] >= 0:
        return None
    cost = float((((inverse - line[0] - line[1] * over) / error) ** 2).sum())
    for m, k in enumerate(chosen):
        own = seen.pose == m
        turn, shift = options[m][k]
        points = board[seen.corner[own]] @ turn.T + shift
        off = seen.scene[own] - principal - focal * points[:, :2] / points[:, 2:]
        cost += float(((off**2).sum(1) / seen.covariance[own, 0, 0]).sum())
    camera = np.zeros(len(INTERNAL))
    camera[:5] = focal, *line, *principal
    turns, shifts = zip(*(options[m][k] for m, k in enumerate(chosen)), strict=True)
    return _Candidate(cost, camera, Poses(np.array(turns), np.array(shifts)))


def _line(x: Array, y: Array, error: Array) -> Array:
    """Offset and slope of `y` over `x`, least squares reweighted to the least absolute residuals."""
    weight = 1 / error**2
    design = np.column_stack([np.ones_like(x), x])
    line = np.zeros(2)
    for _ in range(5):
        line = np.linalg.lstsq(design * np.sqrt(weight)[:, None], y * np.sqrt(weight), rcond=None)[0]
        off = np.abs(y - design @ line) / error
        weight = 1 / error**2 / np.maximum(off, np.median(off) + 1e-12)
    return line
