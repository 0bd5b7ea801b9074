"""Which further pose of the board would tell most about the distances that the camera measures.

Candidates stand near, in the middle and far, in the middle and the corners of the field, tilted in four directions.
Each adds the information that its corners would bring (normal equations, the pose eliminated) to that of the
calibration; the best one leaves the smallest mean variance of distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..metric.bundle_adjustment import Poses, linearise
from ..metric.camera_model import INTERNAL, to_internal
from ..metric.observations import Observations
from ..metric.result import MetricCalibration

__all__ = ["NextPose", "suggest_poses"]

Array = NDArray[Any]
_PLACES = {
    "in the middle": (0.5, 0.5),
    "at the top left": (0.25, 0.25),
    "at the top right": (0.75, 0.25),
    "at the bottom left": (0.25, 0.75),
    "at the bottom right": (0.75, 0.75),
}
_WAYS = {
    "left edge nearer": (0.0, -1.0),
    "right edge nearer": (0.0, 1.0),
    "top edge nearer": (1.0, 0.0),
    "bottom edge nearer": (-1.0, 0.0),
}
_TILT = 0.52  # rad: 30 degrees


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
    assert optics.covariance is not None and optics.principal_point is not None
    fitted = np.flatnonzero(np.diag(optics.covariance) > 0)
    change = np.eye(len(INTERNAL))
    change[:3, :3] = to_internal(optics.parameters[:3], optics.pixel)[1]
    camera = np.concatenate([to_internal(optics.parameters[:3], optics.pixel)[0], optics.parameters[3:]])
    covariance = (change @ optics.covariance @ change.T)[np.ix_(fitted, fitted)]
    scale = np.sqrt(np.diag(covariance))
    information = np.linalg.pinv(covariance / np.outer(scale, scale), hermitian=True)
    distances = np.array([pose.translation[2] for pose in found.poses])
    target = _distance_derivatives(found, camera, np.geomspace(distances.min(), distances.max(), 5))[:, fitted] * scale
    candidates = []
    for distance in np.geomspace(0.9 * distances.min(), 1.1 * distances.max(), 3):
        for where, place in _PLACES.items():
            for how, way in _WAYS.items():
                brought = _information(found, camera, float(distance), place, way)
                if brought is not None:
                    share = brought[np.ix_(fitted, fitted)] * np.outer(scale, scale)
                    candidates.append((float(distance), where, how, share))
    chosen: list[NextPose] = []
    before = _spread(information, target)
    for _ in range(count):
        if not candidates:
            break
        spreads = [_spread(information + share, target) for *_, share in candidates]
        best = int(np.argmin(spreads))
        distance, where, how, share = candidates.pop(best)
        chosen.append(NextPose(distance, where, how, spreads[best] / before))
        information = information + share
    return tuple(chosen)


def _spread(information: Array, target: Array) -> float:
    covariance = np.linalg.pinv(information, hermitian=True)
    return float(np.sqrt(np.einsum("ni,ij,nj->n", target, covariance, target).mean()))


def _distance_derivatives(found: MetricCalibration, camera: Array, depths: Array) -> Array:
    """Relative change (n, 14) of measured distances with the internal parameters, over range and field."""
    rows = []
    optics = found.optics
    steps = optics.standard_errors
    ratio = 1 / (camera[1] + camera[2] / depths)
    change = np.zeros((len(INTERNAL), len(INTERNAL)))
    change[:3, :3] = np.linalg.inv(to_internal(optics.parameters[:3], optics.pixel)[1])
    change[3:, 3:] = np.eye(len(INTERNAL) - 3)
    width, height = found.calibration.image_size
    for place in _PLACES.values():
        points = np.repeat([[place[0] * width, place[1] * height]], len(depths), axis=0)
        by_optics = np.zeros((len(depths), len(INTERNAL)))
        for k in np.flatnonzero(steps):
            move = np.zeros(len(INTERNAL))
            # Small against the value, so that sums of far larger terms along one line stay linear.
            move[k] = 1e-3 * steps[k]
            ends = [optics.with_parameters(optics.parameters + s * move).distance(ratio, points) for s in (1, -1)]
            by_optics[:, k] = (ends[0] - ends[1]) / (2 * move[k]) / (depths / 1000)
        rows.append(by_optics @ change)
    return np.nan_to_num(np.concatenate(rows))


def _information(
    found: MetricCalibration, camera: Array, distance: float, place: tuple[float, float], way: tuple[float, float]
) -> Array | None:
    """(14, 14) of the camera from one pose, None where the board does not lie on the flat."""
    board, lattice = found.board, found.calibration.lattice
    points = board.points - board.middle
    width, height = lattice.image_size
    slope = (np.array([place[0] * width, place[1] * height]) - camera[3:5]) / camera[0]
    turn = cv2.Rodrigues(np.array([way[0], way[1], 0.0]) * _TILT)[0]
    pose = Poses(turn[None], np.array([[*slope * distance, distance]]))
    seen = pose.of_board(points, np.zeros(len(points), int))
    scene = camera[3:5] + camera[0] * seen[:, :2] / seen[:, 2:]
    if (scene < 0).any() or (scene > [width, height]).any():
        return None
    ratio = 1 / (camera[1] + camera[2] / seen[:, 2])
    centres = lattice.centres()
    corner, lens = np.nonzero(
        np.abs(np.linalg.norm(scene[:, None] - centres[None], axis=2) * ratio[:, None]) < 0.7 * lattice.radius
    )
    if len(corner) < 20:
        return None
    none = np.zeros((len(corner), 2))
    noise = np.full(len(corner), found.noise * np.sqrt(found.widening))
    observations = Observations(np.zeros(len(corner), int), corner, centres[lens], none, noise)
    rows = linearise(camera, found.optics.pixel, pose, points, observations)
    rows, own = rows.reshape(-1, rows.shape[2]), len(INTERNAL)
    of_pose, of_camera = rows[:, own : own + 6], rows[:, :own]
    left = of_camera - of_pose @ (np.linalg.pinv(of_pose) @ of_camera)
    return np.asarray(left.T @ left)
