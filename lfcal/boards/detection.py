"""The points of a board in an all-in-focus picture, by OpenCV's detectors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .board import Board
from .focus_sweep import FocusedPicture

__all__ = ["DetectedBoard", "detect"]


@dataclass(frozen=True)
class DetectedBoard:
    """Points of a board as an all-in-focus picture shows them.

    Parameters
    ----------
    corner : (k,) int64
        Which points of the board.
    scene : (k, 2) float64 [px]
        Scene coordinates.
    inverse_ratio : (k,) float64
        `D / s` of a plane through all of them.
    """

    corner: NDArray[np.int64]
    scene: NDArray[np.float64]
    inverse_ratio: NDArray[np.float64]


def detect(picture: FocusedPicture, board: Board) -> DetectedBoard | None:
    """Find the points of a board, or None where it is not found whole (ChArUco: not enough of it)."""
    best: DetectedBoard | None = None
    for image, zoom in _versions(picture.image):
        found = _FINDERS[board.pattern](image, board)
        if found is None:
            continue
        corner, pixels = found
        pixels = (pixels + 0.5) / zoom - 0.5
        if _mirrored(board.points[corner, :2], pixels):
            continue
        if board.half_turn or (board.pattern == "checkerboard" and not _dark_corner(picture.image, board, pixels)):
            pixels = _turned(board, pixels)
        if best is None or len(corner) > len(best.corner):
            best = DetectedBoard(corner, pixels * picture.step, _plane(picture, pixels))
        if len(best.corner) == len(board.points):
            break
    return best


def _versions(image: NDArray[np.float32]) -> Iterator[tuple[NDArray[np.uint8], float]]:
    """8-bit pictures of rising size and contrast."""
    finite = image[image > 0] if (image > 0).any() else image.ravel()
    low, high = np.percentile(finite, (1, 99))
    grey = np.clip((image - low) * (255 / max(high - low, 1e-6)), 0, 255).astype(np.uint8)
    # Detectors need squares of 8 to 80 px.
    for zoom in (1.0, 2.0, 0.5):
        size = (round(grey.shape[1] * zoom), round(grey.shape[0] * zoom))
        yield cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC if zoom > 1 else cv2.INTER_AREA), zoom


def _checkerboard(image: NDArray[np.uint8], board: Board) -> tuple[NDArray[Any], NDArray[Any]] | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, pixels = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    if not found:
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, pixels = cv2.findChessboardCorners(image, (board.columns, board.rows), flags=flags)
    if not found:
        return None
    return np.arange(board.columns * board.rows), pixels.reshape(-1, 2).astype(np.float64)


def _charuco(image: NDArray[np.uint8], board: Board) -> tuple[NDArray[Any], NDArray[Any]] | None:
    pixels, corner, _, _ = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(image)
    if pixels is None or len(pixels) < 6:
        return None
    return corner.ravel().astype(np.int64), pixels.reshape(-1, 2).astype(np.float64)


def _circles(image: NDArray[np.uint8], board: Board) -> tuple[NDArray[Any], NDArray[Any]] | None:
    for inverted in (image, 255 - image):
        for flags in (0, cv2.CALIB_CB_CLUSTERING):
            found, pixels = cv2.findCirclesGrid(
                inverted, (board.columns, board.rows), flags=cv2.CALIB_CB_ASYMMETRIC_GRID | flags
            )
            if found:
                return np.arange(board.columns * board.rows), pixels.reshape(-1, 2).astype(np.float64)
    return None


_FINDERS = {"checkerboard": _checkerboard, "charuco": _charuco, "circles": _circles}


def _mirrored(points: NDArray[np.float64], pixels: NDArray[np.float64]) -> bool:
    """Whether the picture shows the points in the other sense of rotation: another board, or a wrong detection."""
    affine = np.linalg.lstsq(np.column_stack([points, np.ones(len(points))]), pixels, rcond=None)[0]
    return bool(np.linalg.det(affine[:2]) <= 0)


def _dark_corner(image: NDArray[np.float32], board: Board, pixels: NDArray[np.float64]) -> bool:
    """Whether the squares up-left of the corners in even places are the dark ones, as at corner 0."""
    grid = pixels.reshape(board.rows, board.columns, 2)
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    x, y = np.rint(middles).astype(int).reshape(-1, 2).T
    light = image[np.clip(y, 0, image.shape[0] - 1), np.clip(x, 0, image.shape[1] - 1)]
    row, column = np.mgrid[: board.rows - 1, : board.columns - 1].reshape(2, -1)
    even = (row + column) % 2 == 0
    # The square between corners (0, 0) and (1, 1) has the colour of the one up-left of (0, 0).
    return bool(light[even].mean() < light[~even].mean())


def _turned(board: Board, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points in the other order; of boards that look the same both ways, with the first corner up and to the left."""
    if board.half_turn and pixels[0].sum() <= pixels[-1].sum():
        return pixels
    return pixels[::-1]


def _plane(picture: FocusedPicture, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """`D / s` at the pixels, of the plane that fits their patch sizes: `1 / s` of a plane is linear in `X`."""
    from scipy.optimize import least_squares

    x, y = np.rint(pixels).astype(int).T
    height, width = picture.ratio.shape
    ratio = picture.ratio[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(np.float64)
    inverse = 1 / np.where(np.abs(ratio) < 1e-3, np.nan, ratio)
    kept = np.isfinite(inverse) & (np.sign(inverse) == np.sign(np.nanmedian(inverse)))
    design = np.column_stack([np.ones(len(x)), pixels - pixels.mean(0)])
    found = least_squares(
        lambda plane: (inverse - design @ plane)[kept], [np.median(inverse[kept]), 0, 0],
        lambda _plane: -design[kept], x_scale="jac", loss="soft_l1", f_scale=0.05 * abs(np.median(inverse[kept])),
    )  # fmt: skip
    return np.asarray(design @ found.x)
