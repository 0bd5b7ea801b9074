"""Boards on flats: an all-in-focus picture by a plane sweep, and the points of a board on it by
OpenCV's detectors.

Every candidate of `s / D` draws the scene with the formula of docs/geometry.md, `p = c - (X - c) s
/ D`, from all lenses that see a point. Where the candidate is right they agree: the variance among
them, averaged over a window, chooses the candidate of every point (plane sweep; Collins 1996).
`lfrender` has the accurate form of this, but stands above `lfcal`: boards need a picture that a
detector finds them on, corners are then measured in the microimages.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..lattice.lattice import Lattice
from ..runtime.arrays import Array, Floats, Integers, Singles
from .board import Board

__all__ = ["DetectedBoard", "FocusSweep", "FocusedPicture", "detect", "other_size"]


class FocusedPicture(NamedTuple):
    """An all-in-focus picture with the patch size it was drawn with."""

    image: Array  # (h, w) float32 in the unit of the flat
    ratio: Array  # (h, w) float32 `s / D` of every pixel
    step: float  # [px] scene coordinates `X = step * (u, v)` of the pixel in column `u` and row `v`


class FocusSweep:
    """Draws all-in-focus pictures of the flats of a camera with this `lattice`."""

    def __init__(self, lattice: Lattice) -> None:
        # Candidates are compared at points a fifth of a pitch apart.
        self._coarse, self._fine = (
            _Views(lattice, share * lattice.pitch) for share in (0.2, 0.075)
        )

    def draw(self, flat: Array) -> FocusedPicture:
        """Draw a grey flat (h, w), divided by its gain, with the patch size that makes the lenses
        agree best.
        """
        # Nearer to 0, or beyond 0.75, neighbours share too little of the scene; steps are half a
        # pixel at D = 23 px.
        half = np.arange(0.05, 0.75, 0.025)
        best = np.full(self._coarse.shape, np.inf, np.float32)
        ratio = np.full(self._coarse.shape, -half[-1], np.float32)
        for candidate in np.concatenate([-half[::-1], half]):
            _, variance, count = self._coarse.draw(flat, float(candidate))
            known = (count >= 2).astype(np.float32)
            # 1.5 pitches: a lens and half of its neighbours.
            share = cv2.blur(known, (7, 7))
            cost = cv2.blur(variance * known, (7, 7)) / np.maximum(share, 1e-3)
            better = (cost < best) & (share >= 0.3)
            best[better], ratio[better] = cost[better], candidate
        ratio = cv2.resize(
            cv2.medianBlur(ratio, 5), self._fine.shape[::-1], interpolation=cv2.INTER_LINEAR
        )
        return FocusedPicture(self._fine.draw(flat, ratio)[0], ratio, self._fine.step)


class _Views:
    """The nearest lenses of every point of a grid of scene coordinates: the nearest one and a ring
    about it.
    """

    def __init__(self, lattice: Lattice, step: float) -> None:
        width, height = lattice.image_size
        rows, columns = np.mgrid[0 : height / step : 1, 0 : width / step : 1]
        self.shape, self.step, self.radius = rows.shape, step, lattice.radius
        points = np.stack([columns, rows], axis=2).astype(np.float32) * np.float32(step)
        centres = lattice.centres()
        far, nearest = cKDTree(centres).query(points.reshape(-1, 2), k=min(7, len(centres)))
        self.centres = np.moveaxis(
            centres.astype(np.float32)[nearest.reshape(*self.shape, -1)], 2, 0
        )
        self.offsets = self.centres - points
        self.distances = np.moveaxis(far.astype(np.float32).reshape(*self.shape, -1), 2, 0)

    def draw(self, flat: Array, ratio: float | Array) -> tuple[Array, Array, Array]:
        """Mean, unbiased variance and number of the lenses that see each point, whose patch size is
        `ratio` D.
        """
        total, square, count = (np.zeros(self.shape, np.float32) for _ in range(3))
        no_map: Any = None  # positions are in one map
        over = np.asarray(ratio, np.float32)
        for centre, offset, distance in zip(
            self.centres, self.offsets, self.distances, strict=True
        ):
            place = centre + offset * over[..., None]
            value = cv2.remap(
                flat, place, no_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            seen = distance * np.abs(over) < self.radius
            value *= seen
            total += value
            square += value * value
            count += seen
        mean: Array = total / np.maximum(count, 1)
        variance: Array = np.maximum(square - count * mean * mean, 0) / np.maximum(count - 1, 1)
        return mean, variance, count


class DetectedBoard(NamedTuple):
    """Points of a board as an all-in-focus picture shows them."""

    corner: Integers  # (k,) which points of the board
    scene: Floats  # (k, 2) [px] scene coordinates
    inverse_ratio: Floats  # (k,) `D / s` of a plane through all of them


def detect(picture: FocusedPicture, board: Board) -> DetectedBoard | None:
    """Find the points of a board, or None where it is not found whole (ChArUco: not enough of it)."""
    best: DetectedBoard | None = None
    low, high = (
        np.percentile(picture.image[picture.image > 0], (1, 99))
        if (picture.image > 0).any()
        else (0, 1)
    )
    grey = np.clip((picture.image - low) * (255 / max(high - low, 1e-6)), 0, 255).astype(np.uint8)
    # Detectors need squares of 8 px.
    for zoom in (1, 2):
        large: Any = (
            cv2.resize(grey, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
            if zoom > 1
            else grey
        )
        corner, pixels = _FINDERS[board.pattern](large, board)
        if len(corner) < 6:
            continue
        pixels = (pixels.reshape(-1, 2).astype(np.float64) + 0.5) / zoom - 0.5
        if _is_mirrored(board.points[corner, :2], pixels):
            continue
        if board.pattern == "checkerboard":
            pixels = _ordered(picture.image, board, pixels)
        if best is None or len(corner) > len(best.corner):
            best = DetectedBoard(corner, pixels * picture.step, _plane(picture, pixels))
        if len(best.corner) == len(board.points):
            break
    return best


def other_size(image: Singles, board: Board, larger: bool) -> str:
    """The number of corners of another checkerboard, where there is one; or only of a `larger` one."""
    if board.pattern != "checkerboard":
        return ""
    grey = np.clip(image * (255 / max(float(np.percentile(image, 99)), 1e-6)), 0, 255).astype(
        np.uint8
    )
    # Of three corners each way a board is found in noise.
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, (4, 4), flags)
    own = sorted((board.columns, board.rows))
    seen = sorted(meta.shape) if found else []
    if not found or own == seen or (larger and (seen[0] < own[0] or seen[1] < own[1])):
        return ""
    return f"{seen[1]} x {seen[0]}" if board.columns >= board.rows else f"{seen[0]} x {seen[1]}"


_Points = tuple[Array, Array]
_NONE: _Points = np.zeros(0, np.int64), np.zeros((0, 2))


def _checkerboard(image: NDArray[np.uint8], board: Board) -> _Points:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, pixels = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    return (np.arange(board.columns * board.rows), pixels) if found else _NONE


def _charuco(image: NDArray[np.uint8], board: Board) -> _Points:
    pixels, corner, _, _ = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(image)
    return _NONE if pixels is None else (corner.ravel().astype(np.int64), pixels)


def _circles(image: NDArray[np.uint8], board: Board) -> _Points:
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    for inverted in (image, 255 - image):
        found, pixels = cv2.findCirclesGrid(inverted, (board.columns, board.rows), flags=flags)
        if found:
            return np.arange(board.columns * board.rows), pixels
    return _NONE


_FINDERS = {"checkerboard": _checkerboard, "charuco": _charuco, "circles": _circles}


def _is_mirrored(points: Floats, pixels: Floats) -> bool:
    """Whether the picture shows the points in the other sense of rotation: another board, or a
    wrong detection.
    """
    affine = np.linalg.lstsq(np.column_stack([points, np.ones(len(points))]), pixels, rcond=None)[0]
    return bool(np.linalg.det(affine[:2]) <= 0)


def _ordered(image: Singles, board: Board, pixels: Floats) -> Floats:
    """Corners of a checkerboard, the first one at the end where the square up-left of it is dark.

    Boards that look the same turned by 180 degrees begin at the end that is farther up and left.
    """
    if (board.columns + board.rows) % 2 == 0:
        return pixels if pixels[0].sum() <= pixels[-1].sum() else pixels[::-1]
    grid = pixels.reshape(board.rows, board.columns, 2)
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    x, y = np.rint(middles).astype(int).transpose(2, 0, 1)
    light = image[np.clip(y, 0, image.shape[0] - 1), np.clip(x, 0, image.shape[1] - 1)]
    even = np.indices(light.shape).sum(0) % 2 == 0
    # The square between corners (0, 0) and (1, 1) has the colour of the one up-left of (0, 0).
    return pixels if light[even].mean() < light[~even].mean() else pixels[::-1]


def _plane(picture: FocusedPicture, pixels: Floats) -> Floats:
    """`D / s` at the pixels, of the plane that fits their patch sizes: `1 / s` of a plane is linear
    in `X`.
    """
    x, y = np.rint(pixels).astype(int).T
    height, width = picture.ratio.shape
    ratio = picture.ratio[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(np.float64)
    inverse = 1 / np.where(np.abs(ratio) < 1e-3, np.nan, ratio)
    kept = np.isfinite(inverse) & (np.sign(inverse) == np.sign(np.nanmedian(inverse)))
    design = np.column_stack([np.ones(len(x)), pixels - pixels.mean(0)])
    plane = np.array([np.median(inverse[kept]), 0, 0])
    for _ in range(4):
        # Huber's weights.
        off = np.abs(inverse - design @ plane)
        weight = kept / np.sqrt(np.maximum(off / (0.05 * abs(plane[0])), 1))
        plane = np.linalg.lstsq(
            design * weight[:, None], np.where(kept, inverse, 0) * weight, rcond=None
        )[0]
    return np.asarray(design @ plane)
