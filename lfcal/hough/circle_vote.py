"""Circles of microimages by Hough vote: what lattice they propose, and how well they agree with one.

Each edge pixel votes for the centres that it may belong to, along its gradient (Ballard 1981; Yuen et al. 1990, as in
`cv2.HoughCircles`). Content of the scene makes circles too, but only those of the lens rims lie on a lattice.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..images.preprocessing import normalise_locally
from ..lattice.lattice import Lattice, reduce_basis
from .settings import DEFAULT, HoughSettings

__all__ = ["Circles", "circle_agreement", "find_circles", "find_shifted", "propose_basis"]


@dataclass(frozen=True)
class Circles:
    """Circles found."""

    centres: NDArray[np.float64]  # (n, 2) [px]
    radii: NDArray[np.float64]  # (n,) [px]

    def agreement(self, lattice: Lattice, settings: HoughSettings = DEFAULT) -> float:
        """Share of the circles that lie on the lattice, 0..1, beyond what chance puts there; NaN for too few circles.

        0 is that of circles anywhere, 1 that of circles which all lie on lattice points.
        """
        if len(self.centres) < settings.fewest:
            return float("nan")
        index = lattice.to_index(self.centres)
        near = settings.near * lattice.pitch
        share = float((np.hypot(*(lattice.points(np.rint(index)) - self.centres).T) < near).mean())
        chance = min(np.pi * near**2 / abs(float(np.linalg.det(lattice.basis))), 0.5)
        return (share - chance) / (1 - chance)


def find_circles(picture: NDArray[np.float32], pitch: float, settings: HoughSettings = DEFAULT) -> Circles:
    """Circles as large as microimages of a `pitch` [px], about, in the middle of a picture (h, w)."""
    height, width = picture.shape
    side = min(max(int(settings.pitches * pitch), 64), height, width)
    left, top = (width - side) // 2, (height - side) // 2
    part = np.ascontiguousarray(picture[top : top + side, left : left + side])
    levelled = normalise_locally(part, settings.level_window * pitch)
    factor = settings.pitch / pitch
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    scaled = cv2.resize(levelled, None, fx=factor, fy=factor, interpolation=way)
    dark, bright = np.quantile(scaled, (0.02, 0.98))
    grey = np.clip((scaled - dark) * (255 / max(float(bright - dark), 1e-12)), 0, 255).astype(np.uint8)
    found = cv2.HoughCircles(
        grey, cv2.HOUGH_GRADIENT, 1, settings.least_distance * settings.pitch, param1=settings.edge,
        param2=settings.votes, minRadius=int(settings.least_radius * settings.pitch),
        maxRadius=int(np.ceil(settings.most_radius * settings.pitch)),
    )  # fmt: skip
    if found is None:
        return Circles(np.zeros((0, 2)), np.zeros(0))
    table = np.asarray(found, dtype=np.float64).reshape(-1, np.shape(found)[-1])
    return Circles((table[:, :2] + 0.5) / factor - 0.5 + (left, top), table[:, 2] / factor)


def find_shifted(circles: Circles, lattice: Lattice, settings: HoughSettings = DEFAULT) -> float:
    """Agreement of the circles with the lattice shifted by half or by a third of a cell, the best of these."""
    shifts = [np.array(share) for share in ((0.5, 0.0), (0.0, 0.5), (0.5, 0.5), (1 / 3, 1 / 3), (2 / 3, 2 / 3))]
    return max(
        Circles(circles.centres - shift @ lattice.basis, circles.radii).agreement(lattice, settings) for shift in shifts
    )


def circle_agreement(picture: NDArray[np.float32], lattice: Lattice, settings: HoughSettings = DEFAULT) -> float:
    """How well circles on a picture (h, w) agree with a lattice: `Circles.agreement`."""
    return find_circles(picture, lattice.pitch, settings).agreement(lattice, settings)


def propose_basis(
    picture: NDArray[np.float32], pitch: float, settings: HoughSettings = DEFAULT
) -> NDArray[np.float64] | None:
    """Basis (2, 2) [px] of the two most frequent steps between circles of about this pitch; None if none stand out."""
    centres = find_circles(picture, pitch, settings).centres
    if len(centres) < settings.fewest:
        return None
    steps = (centres[:, None] - centres[None]).reshape(-1, 2)
    length = np.hypot(*steps.T)
    steps = steps[(length > settings.shortest * pitch) & (length < settings.longest * pitch)]
    # A step and its opposite are the same.
    steps = np.where((steps[:, :1] < 0) | ((steps[:, :1] == 0) & (steps[:, 1:] < 0)), -steps, steps)
    size = settings.bin * pitch
    count = int(np.ceil(settings.longest / settings.bin))
    edges = size * (np.arange(2 * count + 1) - count)
    table = cv2.GaussianBlur(np.histogram2d(steps[:, 0], steps[:, 1], bins=(edges[count:], edges))[0], (0, 0), 1.0)
    mean, found = float(table.mean()), []
    for _ in range(6):
        row, column = np.unravel_index(int(table.argmax()), table.shape)
        if table[row, column] < settings.peak * mean:
            break
        step = np.array([edges[count + row] + size / 2, edges[column] + size / 2])
        near = np.hypot(*(steps - step).T) < 2 * size
        if near.any():
            found.append(np.median(steps[near], axis=0))
        table[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4] = 0
    for first in range(len(found)):
        for second in range(first + 1, len(found)):
            a, b = found[first], found[second]
            if abs(a[0] * b[1] - a[1] * b[0]) > settings.independent * np.hypot(*a) * np.hypot(*b):
                return reduce_basis(np.array([a, b]))
    return None
