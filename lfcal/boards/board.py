"""Boards: the points that they show, and drawings to print as SVG or PDF in true size."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ..runtime.arrays import Floats
from ..runtime.errors import BoardError, check_number
from ..runtime.output_file import atomic_write, check_output

__all__ = ["PATTERNS", "Board", "BoardPattern", "draw_board", "write_board"]

BoardPattern = Literal["checkerboard", "charuco", "circles"]
PATTERNS = get_args(BoardPattern)
# Side of markers, and diameter of circles, where none is given [squares].
_MARKER = 0.75
_CIRCLE = 1.2
_INCH = 25.4  # [mm]


@dataclass(frozen=True)
class Board:
    """A flat calibration target.

    Parameters
    ----------
    columns, rows : int
        Inner corners of a checkerboard or a ChArUco board (one less than squares), circles of an
        asymmetric grid: those of a row, and the rows, each shifted by half a step (OpenCV's 4 x 11
        has 4 columns and 11 rows).
    square : float [mm]
        Side of a square; of circles, the distance between rows.
    pattern : {"checkerboard", "charuco", "circles"}
    marker : float [mm], optional
        Side of the markers of a ChArUco board, by default 0.75 of the square; diameter of circles,
        by default 1.2 of the distance between rows.
    dictionary : str
        Of the markers, as OpenCV names it without `DICT_`.

    Examples
    --------
    >>> board = Board(9, 6, 12.0)
    >>> board.points.shape, board.points[10].tolist()
    ((54, 3), [12.0, 12.0, 0.0])
    """

    columns: int
    rows: int
    square: float
    pattern: BoardPattern = "checkerboard"
    marker: float | None = None
    dictionary: str = "5X5_1000"

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise ValueError(f"pattern must be {', '.join(PATTERNS)}, got {self.pattern!r}")
        sides = [check_number(getattr(self, name), name) for name in ("columns", "rows")]
        size = f"{self.columns} x {self.rows}"
        if not 2 <= min(sides) <= max(sides) <= 200:
            raise BoardError(f"a board has 2 to 200 inner corners each way, got {size}")
        if self.pattern == "checkerboard" and min(sides) < 3:
            raise BoardError(f"a checkerboard needs 3 x 3 inner corners or more, got {size}")
        if not 0 < check_number(self.square, "square") < np.inf:
            raise BoardError(f"the square must have a positive side [mm], got {self.square!r}")
        usual = _CIRCLE
        if self.pattern == "charuco":
            usual = _MARKER
        marker = check_number(self.marker or self.square * usual, "marker")
        if not 0 < marker < np.inf or (self.pattern == "charuco" and marker >= self.square):
            raise BoardError(
                f"markers must be smaller than the square of {self.square} mm, got {marker!r} mm"
            )
        object.__setattr__(self, "marker", marker)

    @property
    def points(self) -> Floats:
        """(k, 3) corners or centres [mm], row by row; x right, y down, z away from the camera."""
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        x = 2 * column + row % 2 if self.pattern == "circles" else column
        return np.column_stack([x.ravel(), row.ravel(), np.zeros(x.size)]) * self.square

    @property
    def middle(self) -> Floats:
        """(3,) mean of the points [mm]."""
        return self.points.mean(0)

    def charuco(self) -> Any:
        """OpenCV's ChArUco board."""
        import cv2

        name = f"DICT_{self.dictionary.upper()}"
        if not hasattr(cv2.aruco, name):
            raise BoardError(
                f"OpenCV has no dictionary {self.dictionary!r} of markers; 4X4_50 or "
                "5X5_1000 are usual"
            )
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        return cv2.aruco.CharucoBoard(
            (self.columns + 1, self.rows + 1), self.square, float(self.marker or 0), markers
        )

    def __str__(self) -> str:
        points = "corners"
        if self.pattern == "circles":
            points = "circles"
        return f"{self.pattern} of {self.columns} x {self.rows} {points}"


def write_board(path: str | os.PathLike[str], board: Board) -> None:
    """Write a board in true size, `.svg` or `.pdf`; the file appears whole or not at all.

    Print it at 100 % on flat, matt material and measure the bar. If it is not 100 mm long, multiply
    `square` by its length over 100 mm.
    """
    check_output(path, {".svg", ".pdf"})
    with atomic_write(path) as temporary:
        draw_board(board).savefig(temporary, format=Path(path).suffix.lower()[1:])


def draw_board(board: Board) -> Any:
    """A Matplotlib figure of a page with the board; data are mm from its top left corner."""
    from matplotlib.collections import PatchCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Rectangle

    side = board.square
    points = board.points[:, :2]
    # One square of the pattern surrounds the points, and another one is left white.
    shift = 2 * side - points.min(0)
    width, height = np.ptp(points, axis=0) + 4 * side
    bar = height + 4.0
    page = max(width, 100 + 2 * side), bar + 12
    shapes: list[Any] = [Rectangle((side, bar), 100.0, 1.5)]
    radius = float(board.marker or 0) / 2
    if board.pattern == "circles":
        shapes += [Circle(place, radius) for place in points + shift]
    else:
        # The square up-left of corner 0 is dark.
        row, column = np.nonzero(np.indices((board.rows + 1, board.columns + 1)).sum(0) % 2 == 0)
        corners = np.column_stack([column - 1, row - 1]) * side + shift
        shapes += [Rectangle(corner, side, side) for corner in corners]
    if board.pattern == "charuco":
        shapes += [
            Rectangle(place, module, module)
            for place, module in _marker_modules(board, shift - side)
        ]
    figure = Figure((page[0] / _INCH, page[1] / _INCH))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, page[0]), ylim=(page[1], 0))
    axes.axis("off")
    axes.add_collection(PatchCollection(shapes, facecolor="black", edgecolor="none", linewidth=0))
    axes.text(side, bar + 6, f"{board}, {side:g} mm; this bar is 100 mm long", fontsize=11)
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
        found += [
            (corner + module * np.array(place[::-1]), module) for place in np.argwhere(picture == 0)
        ]
    return found
