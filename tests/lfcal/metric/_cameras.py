"""Corners of boards as a given camera shows them, and random cameras."""

from __future__ import annotations

import cv2
import numpy as np

from lfcal.boards.detection import DetectedBoard
from lfcal.metric.bundle_adjustment import Observations, Poses
from lfcal.metric.camera_model import INTERNAL, project, to_internal

PIXEL = 0.0055
BOARD = np.array([[k % 9 - 4, k // 9 - 2.5, 0] for k in range(54)]) * 7.0


def camera(lengths=(28.0, 27.8, 0.42), principal=(790.0, 605.0), **others):
    values = np.zeros(len(INTERNAL))
    values[:3] = to_internal(np.array(lengths), PIXEL)[0]
    values[3:5] = principal
    for name, value in others.items():
        values[INTERNAL.index(name)] = value
    return values


def poses(rng, count=8, near=350.0, far=1200.0, tilt=0.45):
    """Boards turned by up to `tilt` [rad], over the field of a camera of 1600 x 1200 px."""
    turns = []
    shifts = []
    for z in np.geomspace(near, far, count):
        turns.append(cv2.Rodrigues(rng.uniform(-tilt, tilt, 3))[0])
        reach = np.maximum(z * np.array([0.13, 0.09]) - [30, 20], 0)
        shifts.append([*rng.uniform(-reach, reach), z])
    return Poses(np.array(turns), np.array(shifts))


def observe(values, where, rng, noise, pitch=28.3, radius=11.5, size=(1600, 1200), board=BOARD):
    """Observations of a board in a hexagonal array, with normal errors [px]."""
    i, j = np.mgrid[-10 : size[0] / pitch + 10, -2 : size[1] / pitch * 1.2 + 2].reshape(2, -1)
    centres = np.column_stack([(i - 5 + (j % 2) / 2) * pitch, j * pitch * 0.75**0.5])
    centres = centres[(centres >= 0).all(1) & (centres < size).all(1)]
    rows = []
    for m in range(len(where.rotation)):
        for k, point in enumerate(board @ where.rotation[m].T + where.translation[m]):
            seen = project(values, PIXEL, np.repeat(point[None], len(centres), 0), centres)
            kept = np.hypot(*(seen - centres).T) < radius
            rows += [(m, k, *c, *p) for c, p in zip(centres[kept], seen[kept], strict=True)]
    table = np.array(rows)
    position = table[:, 4:] + rng.normal(0, noise, (len(table), 2))
    pose, corner = table[:, :2].T.astype(np.int64)
    return Observations(pose, corner, table[:, 2:4], position, np.ones(len(table)))


def detect(values, where, rng, error=0.02):
    """Boards as detected in all-in-focus pictures: to half a pixel, `s / D` to an `error`."""
    found = []
    for turn, shift in zip(where.rotation, where.translation, strict=True):
        points = BOARD @ turn.T + shift
        scene = (
            values[3:5]
            + values[0] * points[:, :2] / points[:, 2:]
            + rng.normal(0, 0.5, (len(points), 2))
        )
        ratio = 1 / (values[1] + values[2] / points[:, 2]) + rng.normal(0, error)
        found.append(DetectedBoard(np.arange(len(points)), scene, 1 / ratio))
    return found
