"""Offsets of the microimages in regions of a flat from a given lattice, and the trend that they have in common."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..detection.cell_centre import choose_lens_centre, find_round_centres
from ..detection.folding import TileFolds, fold_tiles
from ..detection.radial_profile import fit_lattice
from ..images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import fit_affine
from ..runtime.errors import CalibrationError
from .settings import FIT_CHECK

__all__ = ["Region", "Trend", "measure_offsets"]


@dataclass(frozen=True)
class Trend:
    """Offset `shift + (p - middle) @ slope` [px] of the true centre near a given one at `p`."""

    middle: NDArray[np.float64]
    slope: NDArray[np.float64]
    shift: NDArray[np.float64]

    def at(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Offsets (..., 2) at `positions` (..., 2) [px]."""
        return self.shift + (positions - self.middle) @ self.slope

    @classmethod
    def fit(
        cls, positions: NDArray[np.float64], offset: NDArray[np.float64], scatter: NDArray[np.float64], before: Trend
    ) -> Trend:
        """IRLS with Tukey's biweight to the known rows of `offset` (9, 2) [px]; `before` where they are too few."""
        known = np.isfinite(scatter)
        if known.sum() < FIT_CHECK.least_regions:
            return before
        middle = positions.mean(0)
        reach = float(np.ptp(positions, axis=0).max())
        design = np.column_stack([np.ones(known.sum()), (positions[known] - middle) / reach])
        # Two halves may agree by chance: the median scatter limits the weight of a region.
        error = scatter[known] + np.median(scatter[known]) + 1e-6
        steps, cutoff = FIT_CHECK.trend_steps, FIT_CHECK.biweight
        change, _ = fit_affine(design, offset[known], error**-2, steps, cutoff)
        return cls(middle, change[1:] / reach, change[0])


@dataclass(frozen=True)
class Region:
    """A rectangle of the flat: its square-root luminance and normalised edges (h, w), and the given lattice there."""

    picture: NDArray[np.float32]
    rims: NDArray[np.float32]
    lattice: Lattice

    @classmethod
    def cut(cls, pixels: NDArray[Any], whole: Lattice, x: int, y: int) -> Region:
        """The region whose `pixels` (h, w) or (h, w, 3) begin at `x, y` of the flat."""
        down, across = pixels.shape[:2]
        middle = np.array([x + (across - 1) / 2, y + (down - 1) / 2])
        index, right, low = whole.to_index(middle + np.array([[0, 0], [1, 0], [0, 1]]))
        basis = np.linalg.inv(np.array([right - index, low - index]))
        origin = middle + (np.rint(index) - index) @ basis - [x, y]
        picture = sqrt_luminance(pixels)
        rims = normalise_locally(edge_strength(picture), FIT_CHECK.edge_window * whole.pitch)
        return cls(picture, rims, Lattice(origin, basis, (across, down), whole.radius))

    @cached_property
    def folds(self) -> list[TileFolds]:
        """Average microimages of both pictures, by tiles."""
        side = max(8, max(self.picture.shape) // FIT_CHECK.tiles)
        return fold_tiles([self.picture, self.rims], self.lattice.basis, side, FIT_CHECK.bins)

    @cached_property
    def has_lattice(self) -> bool:
        """Whether the average rims of two halves of the region correlate."""
        fold = self.folds[1]
        rows, columns = np.divmod(np.arange(len(fold.centre)), fold.grid[1])
        a, b = (fold.mean((rows + columns) % 2 == colour).ravel() for colour in (0, 1))
        spread = float(a.std() * b.std())
        return spread > 0 and float(np.mean((a - a.mean()) * (b - b.mean()))) > FIT_CHECK.least_correlation * spread

    def measure_offset(self, trend: Trend, position: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """From a given centre in the middle to the measured one (2,) [px], and its scatter [px]; NaN where unknown.

        The fit starts from the given centres moved by `trend`; the middle of the region is at `position` (2,) [px].
        """
        given = self.lattice
        middle = (np.array(given.image_size) - 1) / 2
        origin = given.origin + trend.at(given.origin - middle + position)
        start = Lattice(origin, given.basis + given.basis @ trend.slope, given.image_size, given.radius)
        unknown = np.full(2, np.nan), float("nan")
        if not self.has_lattice:
            return unknown
        try:
            fit = fit_lattice(self.rims, start, passes=FIT_CHECK.passes)
        except (CalibrationError, np.linalg.LinAlgError):
            return unknown
        if not fit.half_difference < FIT_CHECK.largest_scatter * given.pitch:
            return unknown
        index = (middle - given.origin) @ np.linalg.inv(given.basis)
        return fit.origin + index @ fit.basis - middle, fit.half_difference


def measure_offsets(
    regions: list[Region], positions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], Trend]:
    """Offsets (9, 2) of nine regions with middles at `positions` (9, 2), their scatter (9,) [px] and trend."""
    lattice = regions[4].lattice
    trend = Trend(np.zeros(2), np.zeros((2, 2)), _find_shift(regions) @ lattice.basis)
    for _ in range(FIT_CHECK.rounds):
        measured = [region.measure_offset(trend, at) for region, at in zip(regions, positions, strict=True)]
        offset, scatter = np.array([v for v, _ in measured]), np.array([v for _, v in measured])
        before, trend = trend, Trend.fit(positions, offset, scatter, trend)
        if np.abs(trend.at(positions) - before.at(positions)).max() < FIT_CHECK.converged * lattice.pitch:
            break
    return offset, scatter, trend


def _find_shift(regions: list[Region]) -> NDArray[np.float64]:
    """From the given centres to those of the average microimage of all regions (2,) [cells], 0 where that is small."""
    bins = FIT_CHECK.bins
    cells = [np.zeros((bins, bins)) for _ in range(2)]
    for region in regions:
        shift = np.rint(region.lattice.to_index(np.zeros((1, 2)))[0] * bins).astype(int)
        for cell, fold in zip(cells, region.folds, strict=True):
            cell += np.roll(fold.mean(), (shift[1], shift[0]), axis=(0, 1))
    basis = regions[0].lattice.basis
    if not all(cell.std() > 0 for cell in cells):
        return np.zeros(2)
    guess = choose_lens_centre(find_round_centres(cells, basis), cells[0] ** 2, basis)
    index = guess.position - np.rint(guess.position)
    steps = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    vectors = (index - steps) @ basis
    nearest = np.linalg.norm(vectors, axis=1).argmin()
    least = FIT_CHECK.least_shift * float(np.sqrt(abs(np.linalg.det(basis))))
    return index - steps[nearest] if float(np.linalg.norm(vectors[nearest])) > least else np.zeros(2)
