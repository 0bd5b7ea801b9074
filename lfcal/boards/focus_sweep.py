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
from scipy.spatial import cKDTree

from ..lattice.lattice import Lattice

__all__ = ["FocusSweep", "FocusedPicture"]

Picture = NDArray[Any]


class FocusedPicture(NamedTuple):
    """An all-in-focus picture with the patch size it was drawn with."""

    image: Picture  # (h, w) float32 in the unit of the flat
    ratio: Picture  # (h, w) float32 `s / D` of every pixel
    step: float  # [px] scene coordinates `X = step * (u, v)` of the pixel in column `u` and row `v`


class FocusSweep:
    """Draws all-in-focus pictures of the flats of a camera with this `lattice`."""

    def __init__(self, lattice: Lattice) -> None:
        # Candidates are compared at points a fifth of a pitch apart.
        self._coarse, self._fine = (_Views(lattice, share * lattice.pitch) for share in (0.2, 0.075))

    def draw(self, flat: Picture) -> FocusedPicture:
        """Draw a grey flat (h, w), divided by its gain, with the patch size that makes the lenses agree best."""
        # Nearer to 0, or beyond 0.75, neighbours share too little of the scene; steps are half a pixel at D = 23 px.
        half = np.arange(0.05, 0.75, 0.025)
        best = np.full(self._coarse.shape, np.inf, np.float32)
        ratio = np.full(self._coarse.shape, -half[-1], np.float32)
        for candidate in np.concatenate([-half[::-1], half]):
            _, variance, count = self._coarse.draw(flat, float(candidate))
            known = (count >= 2).astype(np.float32)
            # 1.5 pitches: a lens and half of its neighbours.
            share = cv2.blur(known, (7, 7))
            cost = cv2.blur(variance * known, (7, 7)) / np.maximum(share, 1e-3)
            better = (cost < best) & (share >= 0.3)
            best[better], ratio[better] = cost[better], candidate
        ratio = cv2.resize(cv2.medianBlur(ratio, 5), self._fine.shape[::-1], interpolation=cv2.INTER_LINEAR)
        return FocusedPicture(self._fine.draw(flat, ratio)[0], ratio, self._fine.step)


class _Views:
    """The nearest lenses of every point of a grid of scene coordinates: the nearest one and a ring about it."""

    def __init__(self, lattice: Lattice, step: float) -> None:
        width, height = lattice.image_size
        rows, columns = np.mgrid[0 : height / step : 1, 0 : width / step : 1]
        self.shape, self.step, self.radius = rows.shape, step, lattice.radius
        points = np.stack([columns, rows], axis=2).astype(np.float32) * np.float32(step)
        centres = lattice.centres()
        far, nearest = cKDTree(centres).query(points.reshape(-1, 2), k=min(7, len(centres)))
        self.centres = np.moveaxis(centres.astype(np.float32)[nearest.reshape(*self.shape, -1)], 2, 0)
        self.offsets = self.centres - points
        self.distances = np.moveaxis(far.astype(np.float32).reshape(*self.shape, -1), 2, 0)

    def draw(self, flat: Picture, ratio: float | Picture) -> tuple[Picture, Picture, Picture]:
        """Mean, unbiased variance and number of the lenses that see each point, whose patch size is `ratio` D."""
        total, square, count = (np.zeros(self.shape, np.float32) for _ in range(3))
        no_map: Any = None  # positions are in one map
        over = np.asarray(ratio, np.float32)
        for centre, offset, distance in zip(self.centres, self.offsets, self.distances, strict=True):
            place = centre + offset * over[..., None]
            value = cv2.remap(flat, place, no_map, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            seen = distance * np.abs(over) < self.radius
            value *= seen
            total += value
            square += value * value
            count += seen
        mean: Picture = total / np.maximum(count, 1)
        variance: Picture = np.maximum(square - count * mean * mean, 0) / np.maximum(count - 1, 1)
        return mean, variance, count
