"""Circles of microimages by Hough vote: what lattice they propose, and how well they agree with one.

Each edge pixel votes for the centres that it may belong to, along its gradient (Ballard 1981; Yuen et al. 1990, as in
`cv2.HoughCircles`). Content of the scene makes circles too, but only those of the lens rims lie on a lattice.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from ..images.preprocessing import normalise_locally
from ..lattice.lattice import Lattice, reduce_basis
from ..runtime.arrays import Floats, Singles

__all__ = ["Circles", "find_circles", "find_shifted", "propose_basis"]


@dataclass(frozen=True)
class Circles:
    """Circles found."""

    centres: Floats  # (n, 2) [px]
    radii: Floats  # (n,) [px]

    def agreement(self, lattice: Lattice) -> float:
        """Share of the circles that lie on the lattice, 0..1, beyond what chance puts there; NaN for too few circles.

        0 is that of circles anywhere, 1 that of circles which all lie on lattice points.
        """
        if len(self.centres) < 20:
            return float("nan")
        index = lattice.to_index(self.centres)
        # Eight per cent lie as near by chance.
        near = 0.15 * lattice.pitch
        share = float((np.hypot(*(lattice.points(np.rint(index)) - self.centres).T) < near).mean())
        chance = min(np.pi * near**2 / abs(float(np.linalg.det(lattice.basis))), 0.5)
        return (share - chance) / (1 - chance)


def find_circles(picture: Singles, pitch: float) -> Circles:
    """Circles as large as microimages of a `pitch` [px], about, in the middle of a picture (h, w)."""
    height, width = picture.shape
    side = min(max(int(30 * pitch), 64), height, width)
    left, top = (width - side) // 2, (height - side) // 2
    part = np.ascontiguousarray(picture[top : top + side, left : left + side])
    levelled = normalise_locally(part, 3 * pitch)
    # At a pitch of 24 px edges are a few pixels wide.
    side, factor = 24, 24 / pitch
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    scaled = cv2.resize(levelled, None, fx=factor, fy=factor, interpolation=way)
    dark, bright = np.quantile(scaled, (0.02, 0.98))
    grey = np.clip((scaled - dark) * (255 / max(float(bright - dark), 1e-12)), 0, 255).astype(np.uint8)
    found = cv2.HoughCircles(
        grey, cv2.HOUGH_GRADIENT, 1, 0.7 * side, param1=120, param2=6, minRadius=int(0.36 * side),
        maxRadius=int(np.ceil(0.52 * side)),
    )  # fmt: skip
    if found is None:
        return Circles(np.zeros((0, 2)), np.zeros(0))
    table = np.asarray(found, dtype=np.float64).reshape(-1, np.shape(found)[-1])
    return Circles((table[:, :2] + 0.5) / factor - 0.5 + (left, top), table[:, 2] / factor)


def find_shifted(circles: Circles, lattice: Lattice) -> float:
    """Agreement of the circles with the lattice shifted by half or by a third of a cell, the best of these."""
    shifts = [np.array(share) for share in ((0.5, 0.0), (0.0, 0.5), (0.5, 0.5), (1 / 3, 1 / 3), (2 / 3, 2 / 3))]
    return max(Circles(circles.centres - shift @ lattice.basis, circles.radii).agreement(lattice) for shift in shifts)


def propose_basis(picture: Singles, pitch: float) -> Floats | None:
    """Basis (2, 2) [px] of the two most frequent steps between circles of about this pitch; None if none stand out."""
    centres = find_circles(picture, pitch).centres
    if len(centres) < 20:
        return None
    every = (centres[:, None] - centres[None]).reshape(-1, 2)
    every = every[np.abs(every).max(1) < 5 * pitch]
    steps = every[np.abs(np.hypot(*every.T) / pitch - 1.05) < 0.35]
    # A step and its opposite are the same.
    steps = np.where((steps[:, :1] < 0) | ((steps[:, :1] == 0) & (steps[:, 1:] < 0)), -steps, steps)
    size, count = 0.06 * pitch, 24
    edges = size * (np.arange(2 * count + 1) - count)
    table = cv2.GaussianBlur(np.histogram2d(steps[:, 0], steps[:, 1], bins=(edges[count:], edges))[0], (0, 0), 1.0)
    mean, found = float(table.mean()), []
    for _ in range(6):
        row, column = np.unravel_index(int(table.argmax()), table.shape)
        if table[row, column] < 3 * mean:
            break
        step = np.array([edges[count + row], edges[column]]) + size / 2
        near = np.hypot(*(steps - step).T) < 2 * size
        if near.any():
            found.append(np.median(steps[near], axis=0))
        table[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4] = 0
    for a, b in combinations(found, 2):
        if abs(a[0] * b[1] - a[1] * b[0]) > 0.4 * np.hypot(*a) * np.hypot(*b):
            return _refine(reduce_basis(np.array([a, b])), every)
    return None


def _refine(basis: Floats, steps: Floats) -> Floats:
    """A basis (2, 2) [px] fitted to longer and longer ones of the `steps` (n, 2) [px] between circles."""
    for reach in (1, 2, 3, 4):
        index = np.rint(steps @ np.linalg.inv(basis))
        near = np.hypot(*(steps - index @ basis).T) < 0.15 * np.hypot(*basis[0])
        near &= (np.abs(index).max(1) <= reach) & index.any(1)
        fitted, _, rank, _ = np.linalg.lstsq(index[near], steps[near], rcond=None)
        if rank < 2:
            break
        basis = fitted
    return basis
