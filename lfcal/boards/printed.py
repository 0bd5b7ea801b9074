"""Boards to print, as SVG or PDF in true size, with a bar to measure the print by."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..runtime.output_file import atomic_write, check_output
from .board import Board

__all__ = ["draw_board", "write_board"]


def write_board(path: str | os.PathLike[str], board: Board) -> None:
    """Write a board in true size, `.svg` or `.pdf`; the file appears whole or not at all.

    Print it at 100 % on flat, matt material and measure the bar: if it is not 100 mm long, scale `square` by what it
    is.
    """
    check_output(path, {".svg", ".pdf"})
    with atomic_write(path) as temporary:
        draw_board(board).savefig(temporary, format=Path(path).suffix.lower()[1:])


def draw_board(board: Board) -> Any:
    """A Matplotlib figure of a page with the board; data are mm from its top left corner."""
    from matplotlib.collections import PatchCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Rectangle

    side, points = board.square, board.points[:, :2]
    # A square about the points, and a margin of another one.
    shift = 2 * side - points.min(0)
    width, height = np.ptp(points, axis=0) + 4 * side
    bar = height + 4.0
    page = max(width, 100 + 2 * side), bar + 12
    shapes: list[Any] = [Rectangle((side, bar), 100.0, 1.5)]
    if board.pattern == "circles":
        shapes += [Circle((x, y), float(board.marker or 0) / 2) for x, y in points + shift]
    else:
        # The square up-left of corner 0 is dark.
        squares = ((c, r) for r in range(board.rows + 1) for c in range(r % 2, board.columns + 1, 2))
        shapes += [Rectangle(((c - 1) * side + shift[0], (r - 1) * side + shift[1]), side, side) for c, r in squares]
    if board.pattern == "charuco":
        shapes += [Rectangle(place, module, module) for place, module in _marker_modules(board, shift - side)]
    figure = Figure((page[0] / 25.4, page[1] / 25.4))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, page[0]), ylim=(page[1], 0))
    axes.axis("off")
    axes.add_collection(PatchCollection(shapes, facecolor="black", edgecolor="none", linewidth=0))
    axes.text(side, bar + 7, f"{board}, {side:g} mm; this bar is 100 mm long", fontsize=4 / 25.4 * 72)
    return figure


def _marker_modules(board: Board, origin: np.ndarray) -> list[tuple[Any, float]]:
    """Top left corner and side [mm] of the black modules of all markers."""
    import cv2

    target = board.charuco()
    dictionary = target.getDictionary()
    side = dictionary.markerSize + 2
    module = float(board.marker or 0) / side
    found = []
    for number, corners in zip(target.getIds().ravel(), target.getObjPoints(), strict=True):
        corner = np.asarray(corners)[:, :2].min(0) + origin
        picture = cv2.aruco.generateImageMarker(dictionary, int(number), side, borderBits=1)
        found += [(corner + module * np.array(place[::-1]), module) for place in np.argwhere(picture < 128)]
    return found
