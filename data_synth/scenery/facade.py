"""The paper's house as a texture: sky, roof, brick wall, windows with something behind them, a door
and a sign.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .textures import bricks, dead_leaves, fractal_noise, linear, text_page, tint

__all__ = ["facade"]


def facade(shape: tuple[int, int], unit: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """(h, w, 3) linear radiance of the house front.

    Parameters
    ----------
    shape : (int, int)
        Height and width in texels.
    unit : float [texel]
        Size of the detail: one brick course is one unit high.
    """
    height, width = shape
    wall = bricks(shape, rng, course=unit)
    sky_end = round(0.16 * height)
    roof_end = round(0.29 * height)
    wall[sky_end:roof_end] = _roof((roof_end - sky_end, width), unit, rng)
    wall[:sky_end] = linear(np.array((176, 204, 232), np.uint8))
    _gables(wall, sky_end, roof_end, rng)
    columns = max(2, round(width / (13 * unit)))
    storey = (height - roof_end) // 2
    pane_w = round(0.58 * width / columns)
    pane_h = round(0.66 * storey)
    for row in range(2):
        for column in range(columns):
            left = round((column + 0.5) * width / columns - pane_w / 2)
            top = roof_end + row * storey + round(0.14 * storey)
            is_door = row == 1 and column == columns // 2
            size = (height - top if is_door else pane_h, pane_w)
            view = (
                _door(size, unit, rng)
                if is_door
                else _window(size, unit, rng, row * columns + column)
            )
            wall[top : top + size[0], left : left + pane_w] = view
    _sign(wall, roof_end + storey - round(1.4 * unit), round(2.2 * unit), rng)
    return wall


def _roof(shape: tuple[int, int], unit: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Slates: rows of rounded tiles in greys and reds."""
    height, width = shape
    tile = np.empty((height, width, 3), np.uint8)
    tile[:] = (52, 46, 52)
    step = max(4.0, 0.9 * unit)
    # From the ridge down each row covers the foot of the one above; drawn from below that order is
    # reversed.
    for row in range(int(height / (0.6 * step)) + 2, -2, -1):
        for column in range(-1, int(width / step) + 2):
            at = (round(16 * (column + 0.5 * (row % 2)) * step), round(16 * row * 0.6 * step))
            grey = int(rng.integers(60, 135))
            colour = (grey + int(rng.integers(0, 45)), grey, grey + int(rng.integers(0, 20)))
            cv2.circle(tile, at, round(16 * 0.62 * step), (30, 26, 30), -1, cv2.LINE_AA, 4)
            cv2.circle(tile, at, round(16 * 0.54 * step), colour, -1, cv2.LINE_AA, 4)
    return tint(linear(tile), fractal_noise(shape, rng, coarsest=32), 0.25)


def _gables(
    wall: NDArray[np.float32], sky_end: int, roof_end: int, rng: np.random.Generator
) -> None:
    """Chimneys against the plain sky."""
    width = wall.shape[1]
    for place in (0.22, 0.71):
        left = round((place - 0.035) * width)
        right = round((place + 0.035) * width)
        top = round(0.45 * sky_end)
        wall[top : sky_end + 4, left:right] = bricks(
            (sky_end + 4 - top, right - left), rng, course=10.0
        )


def _window(
    shape: tuple[int, int], unit: float, rng: np.random.Generator, number: int
) -> NDArray[np.float32]:
    """A white frame with glazing bars before a room: pictures, books, or curtains."""
    height, width = shape
    kind = number % 3
    if kind == 0:
        room = dead_leaves(shape, rng, smallest=0.25 * unit, largest=4 * unit)
    elif kind == 1:
        room = text_page(
            shape, rng, ink=(228, 224, 200), paper=(38, 44, 66), size=max(0.4, unit / 26)
        )
    else:
        folds = np.sin(
            np.arange(width) * (2 * np.pi / (0.8 * unit)) + 2 * fractal_noise((height, width), rng)
        )
        cloth = linear(np.array((196, 150, 70), np.uint8)) * (0.6 + 0.35 * folds[..., None])
        room = tint(
            cloth.astype(np.float32), fractal_noise(shape, rng, coarsest=16, persistence=0.8), 0.3
        )
    frame = linear(np.array((240, 238, 230), np.uint8))
    edge = max(2, round(0.35 * unit))
    bar = max(1, round(0.18 * unit))
    room[:edge] = room[-edge:] = frame
    room[:, :edge] = room[:, -edge:] = frame
    room[:, width // 2 - bar : width // 2 + bar] = frame
    for part in (0.34, 0.67):
        at = round(part * height)
        room[at - bar : at + bar] = frame
    return tint(room, fractal_noise(shape, rng, coarsest=8), 0.06)


def _door(shape: tuple[int, int], unit: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """A green panelled door with wood grain."""
    height, width = shape
    door = np.empty((height, width, 3), np.uint8)
    door[:] = (44, 96, 66)
    for row in range(3):
        for column in range(2):
            left = round((0.1 + 0.45 * column) * width)
            top = round((0.06 + 0.31 * row) * height)
            right = left + round(0.35 * width)
            bottom = top + round(0.26 * height)
            cv2.rectangle(
                door, (left, top), (right, bottom), (24, 58, 38), max(2, round(0.2 * unit))
            )
            cv2.rectangle(
                door,
                (left + 3, top + 3),
                (right - 3, bottom - 3),
                (62, 122, 84),
                max(1, round(0.1 * unit)),
            )
    grain = fractal_noise((height // 6 + 2, width), rng, coarsest=16, persistence=0.8)
    return tint(linear(door), np.asarray(cv2.resize(grain, (width, height)), np.float32), 0.35)


def _sign(wall: NDArray[np.float32], top: int, height: int, rng: np.random.Generator) -> None:
    """A dark board with light letters across the middle of the house."""
    width = wall.shape[1]
    left = round(0.2 * width)
    right = round(0.8 * width)
    board = np.empty((height, right - left, 3), np.uint8)
    board[:] = (26, 30, 62)
    text = "FOCUSED PLENOPTIC HOUSE No 2.0"
    font = cv2.FONT_HERSHEY_DUPLEX
    letters, _ = cv2.getTextSize(text, font, 1.0, 2)
    scale = min(0.9 * board.shape[1] / letters[0], 0.6 * height / letters[1])
    start = (
        round((board.shape[1] - scale * letters[0]) / 2),
        round((height + scale * letters[1]) / 2),
    )
    cv2.putText(
        board, text, start, font, scale, (236, 224, 150), max(1, round(2 * scale)), cv2.LINE_AA
    )
    wall[top : top + height, left:right] = tint(
        linear(board), fractal_noise(board.shape[:2], rng, coarsest=16), 0.12
    )
