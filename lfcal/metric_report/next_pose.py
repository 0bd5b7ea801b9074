"""Find the further poses of the board that would reduce the errors of distances most.

Candidates stand near, in the middle and far, in the middle and the corners of the field, tilted in
four directions. Each adds the information that its corners would bring (normal equations, the pose
eliminated) to that of the calibration; the best one leaves the smallest mean variance of distances.
They are ranked only: errors that all poses share, such as those of corners near the rims of
microimages, do not become smaller with more of them.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import cv2
import numpy as np

from ..metric.bundle_adjustment import POSE, Observations, Poses, eliminate, inverse, linearise
from ..metric.result import MetricCalibration
from ..metric.uncertainty import internal_camera
from ..runtime.arrays import Array

__all__ = ["suggest_poses"]

# Places of the board: side of the field, half-way from its middle.
_PLACES = {
    "in the middle": (0, 0),
    "at the top left": (-1, -1),
    "at the top right": (1, -1),
    "at the bottom left": (-1, 1),
    "at the bottom right": (1, 1),
}
_WAYS = {
    "left edge nearer": (0, -1),
    "right edge nearer": (0, 1),
    "top edge nearer": (1, 0),
    "bottom edge nearer": (-1, 0),
}

# Distances beyond those of the calibration, as factors.
_BEYOND = 1.1
# [degrees] Tilt of the boards.
_TILT = 30
# [usable radius] Corners are found so far from the centre of a lens; boards show more of them.
_SEEN = 0.7
# Number of poses that are suggested.
_POSES = 3
_FEWEST_CORNERS = 20


def suggest_poses(found: MetricCalibration) -> list[tuple[float, str, str]]:
    """The three best further poses, each given those before.

    Each is a distance [mm], a place in the field and a tilt.
    """
    optics = found.optics
    assert optics.covariance is not None
    camera, change = internal_camera(optics)
    fitted = np.ix_(*(np.flatnonzero(optics.standard_errors > 0),) * 2)
    distances = [pose.translation[2] for pose in found.poses]
    depths = np.geomspace(min(distances), max(distances), 5)
    ratio = np.tile(1 / (camera[1] + camera[2] / depths), len(_PLACES))
    places = _on_flat(np.array(list(_PLACES.values())), found)
    points = np.repeat(places, len(depths), axis=0)

    def spread(information: Array) -> float:
        covariance = np.zeros_like(change)
        covariance[fitted] = inverse(information)
        errors = replace(optics, covariance=covariance).distance_error(ratio, 0.0, points)
        return float(np.nanmean((errors / np.tile(depths, len(_PLACES))) ** 2))

    candidates = {}
    for distance in np.geomspace(min(distances) / _BEYOND, _BEYOND * max(distances), 3):
        for where, how in product(_PLACES, _WAYS):
            brought = _information(found, camera, float(distance), _PLACES[where], _WAYS[how])
            if brought is not None:
                candidates[float(distance), where, how] = (change.T @ brought @ change)[fitted]
    information: Array = inverse(optics.covariance[fitted])
    chosen: list[tuple[float, str, str]] = []
    while candidates and len(chosen) < _POSES:
        best = min(candidates, key=lambda name: spread(information + candidates[name]))
        chosen.append(best)
        information = information + candidates.pop(best)
    return chosen


def _on_flat(place: Array, found: MetricCalibration) -> Array:
    """Positions [px] of places (..., 2) of the field."""
    return np.asarray((0.5 + 0.25 * place) * found.calibration.image_size)


def _information(
    found: MetricCalibration,
    camera: Array,
    distance: float,
    place: tuple[float, float],
    way: tuple[float, float],
) -> Array | None:
    """(14, 14) of the camera from one pose, None where the board does not lie on the flat."""
    board = found.board
    lattice = found.calibration.lattice
    points = board.points - board.middle
    slope = (_on_flat(np.array(place), found) - camera[3:5]) / camera[0]
    turn = cv2.Rodrigues(np.deg2rad(_TILT) * np.array([*way, 0.0]))[0]
    pose = Poses(turn[None], np.array([[*slope * distance, distance]]))
    seen = pose.of_board(points, np.zeros(len(points), int))
    scene = camera[3:5] + camera[0] * seen[:, :2] / seen[:, 2:]
    if (scene < 0).any() or (scene > lattice.image_size).any():
        return None
    ratio = np.abs(camera[1] + camera[2] / seen[:, 2])
    centres = lattice.centres()
    away = np.linalg.norm(scene[:, None] - centres, axis=2)
    corner, lens = np.nonzero(away < _SEEN * lattice.radius * ratio[:, None])
    if len(corner) < _FEWEST_CORNERS:
        return None
    none = np.zeros((len(corner), 2))
    noise = np.full(len(corner), found.noise * np.sqrt(found.widening))
    observations = Observations(np.zeros(len(corner), int), corner, centres[lens], none, noise)
    rows = linearise(camera, found.optics.pixel, pose, points, observations).reshape(
        2 * len(corner), -1
    )
    return eliminate(rows.T @ rows, np.zeros(rows.shape[1]), np.arange(len(camera)), POSE)[0]
