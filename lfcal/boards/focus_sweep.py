"""All-in-focus picture of a flat by a plane sweep: enough to find a board on, made without the depth analysis.

Every candidate of `s / D` draws the scene with the formula of docs/geometry.md, `p = c - (X - c) s / D`, from all
lenses that see a point. Where the candidate is right they agree: the variance among them, averaged over a window,
chooses the candidate of every point (plane sweep; Collins 1996). `lfrender` has the accurate form of this, but stands
above `lfcal`: boards need a picture that a detector finds them on, corners are then measured in the microimages.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice

__all__ = ["FocusedPicture", "focused_picture"]

Picture = NDArray[Any]


class FocusedPicture(NamedTuple):
    """An all-in-focus picture with the patch size it was drawn with."""

    image: Picture  # (h, w) float32 in the unit of the flat
    ratio: Picture  # (h, w) float32 `s / D` of every pixel
    step: float  # [px] scene coordinates `X = step * (u, v)` of the pixel in column `u` and row `v`


class _Views:
    """The nearest lenses of every point of a grid of scene coordinates: the nearest one and a ring about it."""

    def __init__(self, lattice: Lattice, step: float) -> None:
        from scipy.spatial import cKDTree

        width, height = lattice.image_size
        rows, columns = np.mgrid[0 : height / step : 1, 0 : width / step : 1]
        self.shape = rows.shape
        self.points = np.stack([columns, rows], axis=2).astype(np.float32) * np.float32(step)
        centres = lattice.centres()
        lenses = min(7, len(centres))
        nearest = cKDTree(centres).query(self.points.reshape(-1, 2), k=lenses)[1].reshape(*self.shape, lenses)
        self.centres = [centres[nearest[..., k]].astype(np.float32) for k in range(lenses)]
        self.radius = lattice.radius

    def draw(self, flat: Picture, ratio: float | Picture) -> tuple[Picture, Picture, Picture]:
        """Mean, unbiased variance and number of the lenses that see each point, whose patch size is `ratio` D."""
        total, square, count = (np.zeros(self.shape, np.float32) for _ in range(3))
        no_map: Any = None  # positions are in one map
        over: Any = ratio if isinstance(ratio, float) else np.asarray(ratio)[..., None]
        for centre in self.centres:
            shift = (centre - self.points) * over
            seen = (shift * shift).sum(2) < self.radius**2
            place = (centre + shift).astype(np.float32)
            value = cv2.remap(flat, place, no_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            value[~seen] = 0
            total += value
            square += value * value
            count += seen
        mean: Picture = total / np.maximum(count, 1)
        variance: Picture = np.maximum(square - count * mean * mean, 0) / np.maximum(count - 1, 1)
        return mean, variance, count


def focused_picture(flat: Picture, lattice: Lattice) -> FocusedPicture:
    """Draw a grey flat (h, w), divided by its gain, with the patch size that makes the lenses agree best."""
    # Nearer to 0, or beyond 0.75, neighbours share too little of the scene; steps are half a pixel at D = 23 px.
    half = np.arange(0.05, 0.75, 0.025)
    candidates = np.concatenate([-half[::-1], half]).astype(np.float32)
    # Candidates are compared at points a fifth of a pitch apart, over 1.5 pitches: a lens and half of its neighbours.
    coarse, window = _Views(lattice, 0.2 * lattice.pitch), 7
    best = np.full(coarse.shape, np.inf, np.float32)
    ratio = np.full(coarse.shape, candidates[0], np.float32)
    for candidate in candidates:
        _, variance, count = coarse.draw(flat, float(candidate))
        known = (count >= 2).astype(np.float32)
        share = cv2.blur(known, (window, window))
        cost = cv2.blur(variance * known, (window, window)) / np.maximum(share, 1e-3)
        cost[share < 0.3] = np.inf
        better = cost < best
        best[better], ratio[better] = cost[better], candidate
    step = 0.075 * lattice.pitch
    fine = _Views(lattice, step)
    ratio = cv2.resize(cv2.medianBlur(ratio, 5), fine.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return FocusedPicture(fine.draw(flat, ratio)[0], ratio, step)
