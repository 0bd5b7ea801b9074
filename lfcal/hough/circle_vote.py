"""Circles of microimages by Hough vote, and the brightest places of spots.

Each edge pixel votes for the centres that it may belong to, along its gradient (Ballard 1981; Yuen
et al. 1990, as in `cv2.HoughCircles`). Content of the scene makes circles too, but only those of
the lens rims lie on a lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..images.preprocessing import normalise_locally
from ..runtime.arrays import Floats, Singles

__all__ = [
    "OVERLAPPING",
    "SEPARATE",
    "Circles",
    "find_circles",
    "find_marks",
]

#: [pitch] Radii of microimages side by side, and of those that overlap their neighbours.
SEPARATE = (0.36, 0.52)
OVERLAPPING = (0.52, 0.68)
#: [px] pitch that pictures are scaled to: with 24 px the search takes half as long again, and the
#: circles of 47 flats lie on the right lattice no more often.
_SCALED_PITCH = 20
#: [pitch] Side of the part that is searched: with 24, Letras is given a wrong lattice.
_SIDE = 30
# Places of the part that is searched, in shares of the room to the left and above: the middle, and
# around it.
_PLACES = (
    (0.5, 0.5),
    (0.2, 0.5),
    (0.8, 0.5),
    (0.5, 0.2),
    (0.5, 0.8),
    (0.0, 0.0),
    (1.0, 0.0),
    (0.0, 1.0),
    (1.0, 1.0),
)


@dataclass(frozen=True)
class Circles:
    """Circles found."""

    centres: Floats  # (n, 2) [px]
    radii: Floats  # (n,) [px]


def find_circles(picture: Singles, pitch: float, radii: tuple[float, float] = SEPARATE) -> Circles:
    """Circles with these `radii` [pitch] in the middle of a picture (h, w) with a `pitch` [px]."""
    return _ScaledPart.of(picture, pitch).find_circles(radii)


def find_marks(picture: Singles, pitch: float) -> tuple[Circles, Circles]:
    """Circles, and the brightest places of a `pitch` [px], in the middle of a picture (h, w)."""
    part = _ScaledPart.of(picture, pitch)
    return part.find_circles(SEPARATE), part.find_peaks()


@dataclass(frozen=True)
class _ScaledPart:
    """The middle of a picture, levelled, at `_SCALED_PITCH`: edges are a few pixels wide there."""

    grey: NDArray[np.uint8]
    factor: float  # pixels of the part for each of the picture
    corner: tuple[int, int]  # [px] x, y of its first pixel

    @classmethod
    def of(cls, picture: Singles, pitch: float) -> _ScaledPart:
        height, width = picture.shape
        side = min(max(int(_SIDE * pitch), 64), height, width)
        left, top = _brightest_part(picture, side)
        levelled = normalise_locally(picture[top : top + side, left : left + side], 3 * pitch)
        factor = _SCALED_PITCH / pitch
        way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
        scaled = cv2.resize(levelled, None, fx=factor, fy=factor, interpolation=way)
        dark, bright = np.quantile(scaled, (0.02, 0.98))
        stretched = (scaled - dark) * (255 / max(float(bright - dark), 1e-12))
        return cls(np.clip(stretched, 0, 255).astype(np.uint8), factor, (left, top))

    def find_circles(self, radii: tuple[float, float]) -> Circles:
        """Circles with these `radii` [pitch]."""
        found = cv2.HoughCircles(
            self.grey,
            cv2.HOUGH_GRADIENT,
            1,
            0.7 * _SCALED_PITCH,
            param1=120,
            param2=6,
            minRadius=int(radii[0] * _SCALED_PITCH),
            maxRadius=int(np.ceil(radii[1] * _SCALED_PITCH)),
        )
        if found is None:
            return Circles(np.zeros((0, 2)), np.zeros(0))
        table = np.asarray(found, dtype=np.float64).reshape(-1, np.shape(found)[-1])
        return Circles(self.to_flat(table[:, :2]), table[:, 2] / self.factor)

    def find_peaks(self) -> Circles:
        """Brightest places of a pitch about them."""
        smooth = cv2.GaussianBlur(self.grey.astype(np.float32), (0, 0), 0.15 * _SCALED_PITCH)
        side = int(0.7 * _SCALED_PITCH) | 1
        highest = cv2.dilate(smooth, np.ones((side, side), np.uint8))
        y, x = np.nonzero((smooth >= highest) & (smooth > smooth.mean()))
        return Circles(self.to_flat(np.column_stack([x, y])), np.zeros(len(x)))

    def to_flat(self, places: NDArray[Any]) -> Floats:
        """Positions (n, 2) [px] on the picture of places (n, 2) in the part."""
        return (places + 0.5) / self.factor - 0.5 + self.corner


def _brightest_part(picture: Singles, side: int) -> tuple[int, int]:
    """Left and top [px] of the square part in the middle, or of one beside it that has more than
    twice its light: an array may lie beside the middle of a sensor.
    """
    height, width = picture.shape
    places = [
        (int(across * (width - side)), int(down * (height - side))) for across, down in _PLACES
    ]
    means = [
        float(picture[top : top + side : 4, left : left + side : 4].mean()) for left, top in places
    ]
    best = int(np.argmax(means))
    return places[best] if means[best] > 2 * means[0] else places[0]
