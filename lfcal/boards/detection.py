"""Boards on flats: OpenCV's detectors find their points on an all-in-focus picture.

A plane sweep (Collins 1996) draws the picture: every candidate of `s / D` draws the scene from all
lenses that see a point, by the formula of docs/geometry.md, `p = c - (X - c) s / D`. The lenses
agree where the candidate is right, so each point gets the candidate with the smallest variance
among its lenses, averaged over a window. The picture only serves to find the board; its corners are
measured in the microimages (`corner_fit`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..lattice.lattice import Lattice
from ..runtime.arrays import MOST, Array, Floats, Integers, Singles
from .board import Board

__all__ = ["DetectedBoard", "FocusSweep", "FocusedPicture", "detect", "other_size"]

# Candidates of the size of `s / D`. Nearer to 0 and beyond 0.75, neighbours share too little of the
# scene. A step moves patches by half a pixel at D = 23 px.
_RATIOS = np.arange(0.05, 0.75, 0.025)
# Distances of the points at which candidates are compared, and of the pixels of the picture
# [pitch].
_COARSE_STEP = 0.2
_FINE_STEP = 0.075
# Side of the windows over which variances are averaged [points]: 1.4 pitches, a lens and half of
# its neighbours.
_WINDOW = (7, 7)
# Least share of the points of a window that two lenses or more see.
_LEAST_KNOWN = 0.3
# Lenses that draw a point: the nearest one and a ring of six about it.
_LENSES = 7
# Fewest points with which a board counts as found.
_LEAST_POINTS = 6
# Errors of `D / s` up to this share of it are squared, larger ones count in proportion (Huber).
_HUBER = 0.05


class FocusedPicture(NamedTuple):
    """An all-in-focus picture with the patch size it was drawn with."""

    image: Array  # (h, w) float32 in the unit of the flat
    ratio: Array  # (h, w) float32 `s / D` of every pixel
    step: float  # [px] scene coordinates `X = step * (u, v)` of the pixel in column `u` and row `v`


class FocusSweep:
    """Draws all-in-focus pictures of the flats of a camera with this `lattice`."""

    def __init__(self, lattice: Lattice) -> None:
        self._coarse = _Views(lattice, _COARSE_STEP * lattice.pitch)
        self._fine = _Views(lattice, _FINE_STEP * lattice.pitch)

    def draw(self, flat: Array) -> FocusedPicture:
        """Draw a grey flat (h, w) over its gain, with the patch sizes at which lenses agree."""
        best = np.full(self._coarse.shape, np.inf, np.float32)
        ratio = np.full(self._coarse.shape, -_RATIOS[-1], np.float32)
        for candidate in np.concatenate([-_RATIOS[::-1], _RATIOS]):
            _, variance, count = self._coarse.draw(flat, candidate)
            known = (count >= 2).astype(np.float32)
            share = cv2.blur(known, _WINDOW)
            cost = cv2.blur(variance * known, _WINDOW) / np.maximum(share, _LEAST_KNOWN)
            better = (cost < best) & (share >= _LEAST_KNOWN)
            best[better] = cost[better]
            ratio[better] = candidate
        # The median removes single wrong points.
        ratio = cv2.resize(cv2.medianBlur(ratio, 5), self._fine.shape[::-1])
        return FocusedPicture(self._fine.draw(flat, ratio)[0], ratio, self._fine.step)


class _Views:
    """The nearest lenses of every point of a grid of scene coordinates `step` [px] apart."""

    def __init__(self, lattice: Lattice, step: float) -> None:
        width, height = lattice.image_size
        rows, columns = np.mgrid[0 : height / step : 1, 0 : width / step : 1]
        self.shape = rows.shape
        self.step = step
        self.radius = lattice.radius
        points = np.stack([columns, rows], axis=2).astype(np.float32) * np.float32(step)
        centres = lattice.centres()
        far, nearest = cKDTree(centres).query(points, np.arange(1, min(_LENSES, len(centres)) + 1))
        self.centres = np.moveaxis(centres.astype(np.float32)[nearest], 2, 0)
        self.offsets = self.centres - points
        self.distances = np.moveaxis(far.astype(np.float32), 2, 0)

    def draw(self, flat: Array, ratio: float | Array) -> tuple[Array, Array, Array]:
        """Mean, unbiased variance and number of the lenses that see each point.

        `ratio` is the patch size at the points [pitch].
        """
        total, square, count = np.zeros((3, *self.shape), np.float32)
        no_map: Any = None  # OpenCV takes both coordinates from the first map
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
    """Find all points of a board, or at least six of a ChArUco board; else None."""
    best: DetectedBoard | None = None
    lit = picture.image[picture.image > 0]
    if not lit.size:
        return None
    low, high = np.percentile(lit, MOST)
    grey = _to_grey(picture.image - low, high - low)
    # Detectors need squares of 8 px: they find smaller ones on the enlarged picture.
    for zoom in (1, 2):
        large: Any = cv2.resize(grey, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
        corner, pixels = _FINDERS[board.pattern](large, board)
        if len(corner) < _LEAST_POINTS:
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


def _to_grey(image: Singles, white: float) -> NDArray[np.uint8]:
    """An image (h, w) with 8 bits, 255 for `white` and above."""
    return np.clip(image * (255 / max(white, 1e-6)), 0, 255).astype(np.uint8)


def other_size(image: Singles, board: Board, larger: bool) -> str:
    """Numbers of corners of a checkerboard of another size on an image, such as "9 x 6".

    Empty if there is none. With `larger`, only boards with more corners count.
    """
    if board.pattern != "checkerboard":
        return ""
    grey = _to_grey(image, float(np.percentile(image, MOST[1])))
    # Noise often shows 3 x 3 corners, so that a board needs 4 x 4.
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
    found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, (4, 4), flags)
    own = sorted((board.columns, board.rows))
    seen = []
    if found:
        seen = sorted(meta.shape)
    if not found or own == seen or (larger and (seen[0] < own[0] or seen[1] < own[1])):
        return ""
    if board.columns >= board.rows:
        return f"{seen[1]} x {seen[0]}"
    return f"{seen[0]} x {seen[1]}"


_Points = tuple[Array, Array]
_NONE: _Points = np.zeros(0, np.int64), np.zeros((0, 2))


def _checkerboard(image: NDArray[np.uint8], board: Board) -> _Points:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, pixels = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    if found:
        return (np.arange(board.columns * board.rows), pixels)
    return _NONE


def _charuco(image: NDArray[np.uint8], board: Board) -> _Points:
    pixels, corner, _, _ = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(image)
    if pixels is None:
        return _NONE
    return (corner.ravel().astype(np.int64), pixels)


def _circles(image: NDArray[np.uint8], board: Board) -> _Points:
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    for inverted in (image, 255 - image):
        found, pixels = cv2.findCirclesGrid(inverted, (board.columns, board.rows), flags=flags)
        if found:
            return np.arange(board.columns * board.rows), pixels
    return _NONE


_FINDERS = {"checkerboard": _checkerboard, "charuco": _charuco, "circles": _circles}


def _is_mirrored(points: Floats, pixels: Floats) -> bool:
    """Whether the picture shows a mirrored board: another board, or a wrong detection."""
    affine = np.linalg.lstsq(np.column_stack([points, np.ones(len(points))]), pixels, rcond=None)[0]
    return bool(np.linalg.det(affine[:2]) <= 0)


def _ordered(image: Singles, board: Board, pixels: Floats) -> Floats:
    """Corners (k, 2) of a checkerboard, reversed if the square up-left of the first one is light.

    A board that looks the same if it is turned by 180 degrees starts at its upper left end.
    """
    if (board.columns + board.rows) % 2 == 0:
        if pixels[0].sum() <= pixels[-1].sum():
            return pixels
        return pixels[::-1]
    grid = pixels.reshape(board.rows, board.columns, 2)
    middles = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    x, y = np.rint(middles).astype(int).transpose(2, 0, 1)
    light = image[np.clip(y, 0, image.shape[0] - 1), np.clip(x, 0, image.shape[1] - 1)]
    even = np.indices(light.shape).sum(0) % 2 == 0
    # The square between corners (0, 0) and (1, 1) has the colour of the one up-left of (0, 0).
    if light[even].mean() < light[~even].mean():
        return pixels
    return pixels[::-1]


def _plane(picture: FocusedPicture, pixels: Floats) -> Floats:
    """(k,) `D / s` of pixels (k, 2) on the plane that fits their patch sizes best.

    `1 / s` of a plane is linear in scene coordinates.
    """
    x, y = np.rint(pixels).astype(int).T
    height, width = picture.ratio.shape
    ratio = picture.ratio[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(np.float64)
    # Smaller ratios come from interpolation between places of opposite sign.
    inverse = 1 / np.where(np.abs(ratio) < _RATIOS[0], np.nan, ratio)
    kept = np.isfinite(inverse) & (np.sign(inverse) == np.sign(np.nanmedian(inverse)))
    design = np.column_stack([np.ones(len(x)), pixels - pixels.mean(0)])
    plane = np.array([np.median(inverse[kept]), 0, 0])
    for _ in range(4):
        off = np.abs(inverse - design @ plane)
        weight = kept / np.sqrt(np.maximum(off / (_HUBER * abs(plane[0])), 1))
        values = np.where(kept, inverse, 0) * weight
        plane = np.linalg.lstsq(design * weight[:, None], values, rcond=None)[0]
    return np.asarray(design @ plane)
