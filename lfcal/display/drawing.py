"""Anti-aliased drawing on RGB pictures at sub-pixel positions, with OpenCV."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .settings import Colour

__all__ = ["Canvas"]

# Fractional bits of the positions that OpenCV takes as integers.
_BITS = 4


def _fixed(value: float) -> int:
    return round(value * (1 << _BITS))


def _point(position: ArrayLike) -> tuple[int, int]:
    x, y = np.asarray(position)
    return _fixed(x), _fixed(y)


class Canvas:
    """A picture (h, w, 3) uint8 with functions that draw on it; positions are `x, y` [px]."""

    def __init__(self, picture: NDArray[np.uint8]) -> None:
        import cv2

        self.picture = picture
        self._cv2, self._how = cv2, (cv2.LINE_AA, _BITS)

    def circle(self, centre: ArrayLike, radius: float, colour: Colour, thickness: int) -> None:
        """A circle, filled where `thickness` is -1."""
        self._cv2.circle(self.picture, _point(centre), _fixed(radius), colour, thickness, *self._how)

    def line(self, start: ArrayLike, end: ArrayLike, colour: Colour, thickness: int) -> None:
        """A line between two positions."""
        self._cv2.line(self.picture, _point(start), _point(end), colour, thickness, *self._how)

    def arrow(self, start: ArrayLike, end: ArrayLike, colour: Colour, thickness: int, tip: float) -> None:
        """An arrow whose tip is a share `tip` of its length."""
        self._cv2.arrowedLine(self.picture, _point(start), _point(end), colour, thickness, *self._how, tip)

    def rectangle(self, corner: ArrayLike, opposite: ArrayLike, colour: Colour) -> None:
        """The outline of a rectangle."""
        self._cv2.rectangle(self.picture, _point(corner), _point(opposite), colour, 1, *self._how)

    def curve(self, positions: list[Any], colour: Colour) -> None:
        """Lines from each position to the next."""
        points: Any = np.array([_point(position) for position in positions], np.int32)
        self._cv2.polylines(self.picture, [points], False, colour, 2, *self._how)

    def text(self, words: str, place: tuple[int, int], colour: Colour, size: float) -> None:
        """Text from its left lower corner."""
        font = self._cv2.FONT_HERSHEY_SIMPLEX
        self._cv2.putText(self.picture, words, place, font, size, colour, 1, self._cv2.LINE_AA)
