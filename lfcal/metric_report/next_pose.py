"""Which further pose of the board would tell most about the distances that the camera measures.

Candidates stand near, in the middle and far, in the middle and the corners of the field, tilted in four directions.
Each adds the information that its corners would bring (normal equations, the pose eliminated) to that of the
calibration; the best one leaves the smallest mean variance of distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..metric.bundle_adjustment import POSE, Observations, Poses, eliminate, linearise
from ..metric.result import MetricCalibration
from ..metric.uncertainty import internal_camera

__all__ = ["NextPose", "suggest_poses"]

Array = NDArray[Any]
_PLACES = {
    "in the middle": (0.5, 0.5), "at the top left": (0.25, 0.25), "at the top right": (0.75, 0.25),
    "at the bottom left": (0.25, 0.75), "at the bottom right": (0.75, 0.75),
}  # fmt: skip
_WAYS = {
    "left edge nearer": (0, -1), "right edge nearer": (0, 1), "top edge nearer": (1, 0), "bottom edge nearer": (-1, 0),
}  # fmt: skip


@dataclass(frozen=True)
class NextPose:
    """A pose to shoot.

    Parameters
    ----------
    distance : float [mm]
    where, how : str
        Place in the field, and tilt.
    gain : float
        Expected standard error of distances with this pose over that without, averaged over field and range.
    """

    distance: float
    where: str
    how: str
    gain: float


def suggest_poses(found: MetricCalibration, count: int = 3) -> tuple[NextPose, ...]:
    """The best further poses, each given the ones before."""
    optics = found.optics
    assert optics.covariance is not None
    camera, change = internal_camera(optics)
    fitted = np.flatnonzero(optics.standard_errors > 0)
    # In standard errors of the parameters that are fitted, whose sizes differ very much.
    covariance = (change @ optics.covariance @ change.T)[np.ix_(fitted, fitted)]
    scale = np.sqrt(np.diag(covariance))
    information = np.linalg.pinv(covariance / np.outer(scale, scale), hermitian=True)
    distances = np.array([pose.translation[2] for pose in found.poses])
    target = (_distance_derivatives(found, camera, distances) @ np.linalg.inv(change))[:, fitted] * scale

    def spread(known: Array) -> float:
        left = np.linalg.pinv(known, hermitian=True)
        return float(np.sqrt(np.einsum("ni,ij,nj->n", target, left, target).mean()))

    candidates = {}
    for distance in np.geomspace(0.9 * distances.min(), 1.1 * distances.max(), 3):
        for where, how in product(_PLACES, _WAYS):
            brought = _information(found, camera, float(distance), _PLACES[where], _WAYS[how])
            if brought is not None:
                candidates[float(distance), where, how] = brought[np.ix_(fitted, fitted)] * np.outer(scale, scale)
    chosen: list[NextPose] = []
    before = spread(information)
    while candidates and len(chosen) < count:
        spreads = {name: spread(information + share) for name, share in candidates.items()}
        best = min(spreads, key=lambda name: spreads[name])
        chosen.append(NextPose(*best, spreads[best] / before))
        information = information + candidates.pop(best)
    return tuple(chosen)


def _distance_derivatives(found: MetricCalibration, camera: Array, distances: Array) -> Array:
    """Relative change (n, 14) of measured distances with the parameters of the optics, over range and field."""
    optics, depths = found.optics, np.geomspace(distances.min(), distances.max(), 5)
    ratio = np.tile(1 / (camera[1] + camera[2] / depths), len(_PLACES))
    points = np.repeat(np.array(list(_PLACES.values())) * found.calibration.image_size, len(depths), axis=0)
    rows = np.zeros((len(ratio), len(camera)))
    for k in np.flatnonzero(optics.standard_errors):
        # Small against the value, so that sums of far larger terms along one line stay linear.
        move = 1e-3 * optics.standard_errors[k] * np.eye(len(camera))[k]
        ends = [optics.with_parameters(optics.parameters + sign * move).distance(ratio, points) for sign in (1, -1)]
        rows[:, k] = (ends[0] - ends[1]) / (2 * move[k]) / (np.tile(depths, len(_PLACES)) / 1000)
    return np.nan_to_num(rows)


def _information(
    found: MetricCalibration, camera: Array, distance: float, place: tuple[float, float], way: tuple[float, float]
) -> Array | None:
    """(14, 14) of the camera from one pose, None where the board does not lie on the flat."""
    board, lattice = found.board, found.calibration.lattice
    points = board.points - board.middle
    slope = (np.array(place) * lattice.image_size - camera[3:5]) / camera[0]
    turn = cv2.Rodrigues(np.deg2rad(30) * np.array([*way, 0.0]))[0]
    pose = Poses(turn[None], np.array([[*slope * distance, distance]]))
    seen = pose.of_board(points, np.zeros(len(points), int))
    scene = camera[3:5] + camera[0] * seen[:, :2] / seen[:, 2:]
    if (scene < 0).any() or (scene > lattice.image_size).any():
        return None
    ratio = np.abs(camera[1] + camera[2] / seen[:, 2])
    centres = lattice.centres()
    corner, lens = np.nonzero(
        np.linalg.norm(scene[:, None] - centres[None], axis=2) < 0.7 * lattice.radius * ratio[:, None]
    )
    if len(corner) < 20:
        return None
    none, noise = np.zeros((len(corner), 2)), np.full(len(corner), found.noise * np.sqrt(found.widening))
    observations = Observations(np.zeros(len(corner), int), corner, centres[lens], none, noise)
    rows = linearise(camera, found.optics.pixel, pose, points, observations).reshape(2 * len(corner), -1)
    return eliminate(rows.T @ rows, np.zeros(rows.shape[1]), np.arange(len(camera)), POSE)[0]
