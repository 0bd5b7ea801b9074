"""Anti-aliased drawing on RGB pictures (h, w, 3) uint8 at sub-pixel positions, with OpenCV."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .settings import Colour

__all__ = ["draw_arrow", "draw_circle", "draw_curve", "draw_line", "draw_rectangle", "draw_text"]

# Fractional bits of the positions that OpenCV takes as whole numbers.
_BITS = 4

Picture = NDArray[np.uint8]


def _fixed(value: float) -> int:
    return round(value * (1 << _BITS))


def _point(position: NDArray[np.float64]) -> tuple[int, int]:
    return _fixed(position[0]), _fixed(position[1])


def draw_circle(picture: Picture, centre: NDArray[np.float64], radius: float, colour: Colour, thickness: int) -> None:
    """A circle; filled where `thickness` is -1."""
    import cv2

    cv2.circle(picture, _point(centre), _fixed(radius), colour, thickness, cv2.LINE_AA, _BITS)


def draw_line(picture: Picture, start: ArrayLike, end: ArrayLike, colour: Colour, thickness: int) -> None:
    """A line between two positions."""
    import cv2

    ends = _point(np.asarray(start)), _point(np.asarray(end))
    cv2.line(picture, *ends, colour, thickness, cv2.LINE_AA, _BITS)


def draw_arrow(
    picture: Picture, start: NDArray[np.float64], step: NDArray[np.float64], colour: Colour, thickness: int, tip: float
) -> None:
    """An arrow whose tip is a share `tip` of its length."""
    import cv2

    cv2.arrowedLine(picture, _point(start), _point(start + step), colour, thickness, cv2.LINE_AA, _BITS, tip)


def draw_rectangle(picture: Picture, corner: NDArray[np.float64], size: NDArray[np.float64], colour: Colour) -> None:
    """The outline of a rectangle."""
    import cv2

    cv2.rectangle(picture, _point(corner), _point(corner + size), colour, 1, cv2.LINE_AA, _BITS)


def draw_curve(picture: Picture, positions: list[NDArray[np.float64]], colour: Colour) -> None:
    """Lines from each position to the next."""
    import cv2

    curve: Any = np.array([_point(position) for position in positions], np.int32)
    cv2.polylines(picture, [curve], False, colour, 2, cv2.LINE_AA, _BITS)


def draw_text(picture: Picture, words: str, place: tuple[int, int], colour: Colour, size: float) -> None:
    """Text from a left lower corner."""
    import cv2

    cv2.putText(picture, words, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
