"""All-in-focus picture of a flat by a plane sweep: enough to find a board on, made without the depth analysis.

Every candidate of `s / D` draws the scene with the formula of docs/geometry.md, `p = c - (X - c) s / D`, from all
lenses that see a point. Where the candidate is right they agree: the variance among them, averaged over a window,
chooses the candidate of every point (plane sweep; Collins 1996). `lfrender` has the accurate form of this, but stands
above `lfcal`: boards need a picture that a detector finds them on, corners are then measured in the microimages.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from .settings import SWEEP, SweepSettings

__all__ = ["FocusedPicture", "focused_picture"]

Picture = NDArray[Any]


@dataclass(frozen=True)
class FocusedPicture:
    """An all-in-focus picture with the patch size it was drawn with.

    Parameters
    ----------
    image : (h, w) float32
        In the unit of the flat.
    ratio : (h, w) float32
        `s / D` of every pixel.
    step : float [px]
        Scene coordinates `X = step * (u, v)` of the pixel in column `u` and row `v`.
    """

    image: Picture
    ratio: Picture
    step: float


class _Views:
    """The nearest lenses of every point of a grid of scene coordinates."""

    def __init__(self, lattice: Lattice, step: float, lenses: int) -> None:
        from scipy.spatial import cKDTree

        width, height = lattice.image_size
        rows, columns = np.mgrid[0 : height / step : 1, 0 : width / step : 1]
        self.shape = rows.shape
        self.points = np.stack([columns, rows], axis=2).astype(np.float32) * np.float32(step)
        centres = lattice.centres()
        lenses = min(lenses, len(centres))
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


def focused_picture(flat: Picture, lattice: Lattice, *, settings: SweepSettings = SWEEP) -> FocusedPicture:
    """Draw a grey flat (h, w), divided by its gain, with the patch size that makes the lenses agree best."""
    half = np.arange(settings.least_ratio, settings.largest_ratio, settings.ratio_step)
    candidates = np.concatenate([-half[::-1], half]).astype(np.float32)
    coarse = _Views(lattice, settings.coarse_step * lattice.pitch, settings.lenses)
    window = round(settings.window / settings.coarse_step) | 1
    scale = float(flat.std()) ** 2 + 1e-12
    best = np.full(coarse.shape, np.inf, np.float32)
    ratio = np.full(coarse.shape, candidates[0], np.float32)
    for candidate in candidates:
        _, variance, count = coarse.draw(flat, float(candidate))
        known = (count >= 2).astype(np.float32)
        share = cv2.blur(known, (window, window))
        cost = cv2.blur(variance * known, (window, window)) / np.maximum(share, 1e-3) / scale
        cost[share < settings.least_share] = np.inf
        better = cost < best
        best[better], ratio[better] = cost[better], candidate
    ratio = cv2.medianBlur(ratio, 5)
    fine = _Views(lattice, settings.fine_step * lattice.pitch, settings.lenses)
    ratio = cv2.resize(ratio, fine.shape[::-1], interpolation=cv2.INTER_LINEAR)
    image, _, count = fine.draw(flat, ratio)
    return FocusedPicture(image, ratio, settings.fine_step * lattice.pitch)
