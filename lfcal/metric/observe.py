"""Where the microimages of a flat show the corners of a board: predicted by a camera, measured on the pixels."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..boards.board import Board
from ..boards.corner_fit import fit_corners
from ..boards.detection import DetectedBoard, detect
from ..boards.focus_sweep import focused_picture
from ..camera.calibration import Calibration
from ..images.mosaic import equalise_mosaic, find_mosaic
from ..images.preprocessing import luminance
from .bundle_adjustment import Poses
from .camera_model import project_positions
from .observations import Observations

__all__ = ["BoardFlat", "measure", "prepare"]

Array = NDArray[Any]


@dataclass(frozen=True)
class BoardFlat:
    """A flat of a board, with the light of its camera divided out, and the board as first detected.

    Parameters
    ----------
    name : str
    light : (h, w) float32
    detected : DetectedBoard or None
    reason : str
        Why no board was found.
    other : str
        Number of corners of the larger checkerboard that the flat shows; empty where it shows none.
    """

    name: str
    light: NDArray[np.float32]
    detected: DetectedBoard | None
    reason: str = ""
    other: str = ""


def prepare(flat: Array, name: str, calibration: Calibration, board: Board) -> BoardFlat:
    """Divide a flat by the gain of the camera and detect the board on its all-in-focus picture."""
    pixels = np.asarray(flat)
    mosaic = pixels.ndim == 2 and (calibration.mosaic or find_mosaic(pixels))
    light = equalise_mosaic(pixels) if mosaic else luminance(pixels).astype(np.float32)
    if calibration.gain_map is not None or calibration.vignetting is not None:
        light = calibration.flatten(light)
    light = np.ascontiguousarray(light, np.float32)
    picture = focused_picture(light, calibration.lattice)
    inner = picture.image[picture.image > 0]
    if inner.size < 100 or float(inner.std()) < 0.02 * float(inner.mean()):
        return BoardFlat(name, light, None, "the picture has no contrast")
    found = detect(picture, board)
    other = _other_size(picture.image, board, larger=found is not None)
    reason = f"no {board} in its all-in-focus picture{other and f', but one of {other} corners'}"
    return BoardFlat(name, light, found, "" if found is not None else reason, other)


def _other_size(image: NDArray[np.float32], board: Board, larger: bool) -> str:
    """The number of corners of another checkerboard, where there is one; or only of a `larger` one."""
    if board.pattern != "checkerboard":
        return ""
    grey = np.clip(image * (255 / max(float(np.percentile(image, 99)), 1e-6)), 0, 255).astype(np.uint8)
    # Of three corners each way a board is found in noise.
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, (4, 4), flags)
    own, seen = sorted((board.columns, board.rows)), sorted(meta.shape) if found else []
    if not found or own == seen or (larger and (seen[0] < own[0] or seen[1] < own[1])):
        return ""
    return f"{seen[1]} x {seen[0]}" if board.columns >= board.rows else f"{seen[0]} x {seen[1]}"


def measure(
    flats: list[BoardFlat],
    calibration: Calibration,
    board: Board,
    camera: Array,
    pixel: float,
    poses: Poses,
    *,
    most_lenses: int | None = None,
) -> Observations:
    """Fit the corners of boards in known poses in all microimages that show them.

    With `most_lenses` each corner is only fitted in those that show it nearest to their centre.
    """
    lattice = calibration.lattice
    centres = lattice.centres()
    tree = cKDTree(centres)

    def one(m: int) -> tuple[Array, ...]:
        flat = flats[m]
        assert flat.detected is not None
        pose = Poses(poses.rotation[m : m + 1], poses.translation[m : m + 1])
        corner, centre, predicted, shape = _predict(
            camera, pixel, pose, board, flat.detected.corner, centres, tree, lattice.radius
        )
        if most_lenses is not None:
            chosen = _most_central(corner, np.hypot(*(predicted - centre).T), most_lenses)
            corner, centre, predicted, shape = corner[chosen], centre[chosen], predicted[chosen], shape[chosen]
        fits = fit_corners(flat.light, centre, lattice.radius, predicted, shape, board)
        # Three pixels, and two blurs where these are wide: nearer to the rim the four squares are not all seen.
        inside = lattice.radius - 3 - 2 * (fits.blur - 0.5)
        kept = fits.good & (np.hypot(*(fits.position - centre).T) < inside)
        kept &= np.sign(fits.contrast) == _expected_sign(board, corner, np.where(kept, fits.contrast, 0))
        # The shape of edges is right to 0.005 px, besides the noise of the pixels.
        error = np.hypot(fits.error[kept], 0.005)
        return np.full(kept.sum(), m), corner[kept], centre[kept], fits.position[kept], error

    with ThreadPoolExecutor(max(1, min(len(flats), os.cpu_count() or 1, 8))) as pool:
        parts = list(pool.map(one, range(len(flats))))
    return Observations(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _most_central(corner: Array, distance: Array, most: int) -> Array:
    """Indices of the `most` observations of each corner with the shortest distance."""
    order = np.lexsort([distance, corner])
    first = np.searchsorted(corner[order], corner[order])
    return np.sort(order[np.arange(len(order)) - first < most])


def _expected_sign(board: Board, corner: Array, contrast: Array) -> Array:
    """Sign of the contrast of each corner: it alternates, or is that of all circles; which is which, most tell."""
    if board.pattern == "circles":
        sign = np.ones(len(corner))
    else:
        sign = np.where((corner % board.columns + corner // board.columns) % 2 == 0, -1.0, 1.0)
    return sign * (1.0 if float((sign * contrast).sum()) >= 0 else -1.0)


def _predict(
    camera: Array,
    pixel: float,
    pose: Poses,
    board: Board,
    corners: Array,
    centres: Array,
    tree: Any,
    radius: float,
) -> tuple[Array, Array, Array, Array]:
    """Corner, centre, position and shape of each corner in each microimage that a camera shows it in."""
    points = board.points - board.middle
    seen = pose.of_board(points[corners], np.zeros(len(corners), int))
    scene = camera[3:5] + camera[0] * seen[:, :2] / seen[:, 2:]
    ratio = 1 / (camera[1] + camera[2] / seen[:, 2])
    # Distortion and tilt move scene coordinates by less than a pitch or two.
    near = tree.query_ball_point(scene, radius / np.maximum(np.abs(ratio), 0.02) + 2 * radius)
    corner = np.repeat(corners, [len(k) for k in near])
    lens = np.concatenate([np.asarray(k, int) for k in near]) if len(near) else np.zeros(0, int)
    centre = centres[lens]

    def at(*shift: float) -> Array:
        moved = points[corner] + np.array([*shift, 0.0]) * board.square
        return project_positions(camera, pixel, pose.of_board(moved, np.zeros(len(corner), int)), centre)

    predicted = at(0.0, 0.0)
    kept = np.hypot(*(predicted - centre).T) < radius
    corner, centre, predicted = corner[kept], centre[kept], predicted[kept]
    return corner, centre, predicted, np.stack([(at(0.1, 0) - at(-0.1, 0)) / 0.2, (at(0, 0.1) - at(0, -0.1)) / 0.2], 2)
