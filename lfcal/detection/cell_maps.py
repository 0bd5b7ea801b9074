"""Average cell of a lattice on a flat: what all lenses have in common at each place of a cell.

All maps have `BINS` x `BINS` places, by the fractional coordinates of the lattice through (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..lattice.cell import bin_offsets, cell_distances, cell_side
from ..runtime.arrays import Booleans, Floats
from .features import FlatFeatures
from .folding import BINS, CELL_TILES, TileFolds, fold_lit_tiles, fold_tiles, measure_repeatability

__all__ = ["CellMaps", "CellParts", "estimate_explained", "measure_classes", "tile_side"]


@dataclass(frozen=True)
class CellParts:
    """Parts of a cell about a centre."""

    distance: Floats  # (bins, bins) from the centre over half the distance to the nearest lens
    to_border: Floats  # (bins, bins) distance from the border, over the same
    middle: Booleans  # (bins, bins) within 0.6 of that
    border: Booleans  # (bins, bins) next to the border of the cell

    @classmethod
    def about(cls, centre: Floats, basis: Floats) -> CellParts:
        """Parts about `centre` (2,), in fractional coordinates of the `basis` (2, 2) [px]."""
        offsets = bin_offsets(basis, BINS, centre).reshape(-1, 2)
        far, to_border = cell_distances(basis, offsets)
        inradius = float(to_border.max())
        border = to_border < max(1.5 * inradius / BINS, 0.5)
        shape = (BINS, BINS)
        distance = (far / inradius).reshape(shape)
        return cls(
            distance, (to_border / inradius).reshape(shape), distance < 0.6, border.reshape(shape)
        )


@dataclass(frozen=True)
class CellMaps:
    """Maps (bins, bins) of the average cell, and the tiles of the flat that they average."""

    basis: Floats  # (2, 2) [px]
    brightness: Floats  # mean of the normalised brightness
    variance: Floats  # variance of that from lens to lens
    edges: Floats  # mean of the normalised edges
    steps: Floats  # mean of the steps
    light: Floats  # mean luminance
    tiles: list[TileFolds]  # of brightness and edges, in lit tiles

    @classmethod
    def measure(cls, features: FlatFeatures, basis: Floats) -> CellMaps:
        """Maps of the lattice with this basis on a flat."""
        pitch = cell_side(basis)
        side = tile_side(features, pitch)
        brightness, edges = features.levelled(pitch)
        tiles = fold_lit_tiles(features.picture, [brightness, edges], basis, side)
        first, second = fold_tiles([brightness**2, features.steps], basis, side, BINS, CELL_TILES)
        light = fold_tiles([features.picture], basis, side, BINS, CELL_TILES)[0]
        mean, edge_mean = (tile.mean() for tile in tiles)
        variance = np.maximum(first.mean() - mean**2, 0)
        return cls(basis, mean, variance, edge_mean, second.mean(), light.mean() ** 2, tiles)

    @cached_property
    def repeats(self) -> float:
        """Least correlation of the average cells of opposite thirds of the flat, -1..1."""
        return measure_repeatability(self.tiles)

    def explained(self) -> float:
        """Gain in log likelihood [nats per pixel] if each place of a cell has a mean and a variance
        of its own.

        It is greatest where gaps lie over gaps in all of the flat, while what they part differs.
        """
        return _explained(self.brightness, self.variance)


def estimate_explained(features: FlatFeatures, basis: Floats) -> float:
    """`CellMaps.explained` of a lattice, by a sample of the tiles, dark ones too: to rank bases."""
    pitch = cell_side(basis)
    brightness = features.levelled(pitch)[0]
    pictures = [brightness, brightness**2]
    side = tile_side(features, pitch)
    mean, square = (fold.mean() for fold in fold_tiles(pictures, basis, side, BINS, CELL_TILES))
    return _explained(mean, np.maximum(square - mean**2, 0))


def _explained(mean: Floats, variance: Floats) -> float:
    whole = float(variance.mean() + mean.var())
    # Places of no variance at all, as in saturated gaps, must not count without limit.
    return float(0.5 * (np.log(whole) - np.log(variance + 0.001 * whole).mean()))


class CellClasses(NamedTuple):
    """The two or three classes of rows or diagonals of cells that differ most."""

    share: float  # of the variance of the average cell that lies between the classes, 0..1
    basis: Floats  # (2, 2) [px] of the cells of one class


def measure_classes(features: FlatFeatures, basis: Floats) -> CellClasses:
    """How much the average cells of two or three classes of rows or diagonals differ.

    Half or a third of the cell of an array shows lenses and gaps in turn. The share of the variance
    of the average cell that lies between the classes is measured on two halves of the flat; lens
    types differ in the sharpness of their rims, so that only the mean and the first harmonics of
    a cell count.
    """
    pitch = cell_side(basis)
    brightness = features.levelled(pitch)[0]
    a, b = basis
    found = []
    for count in (2, 3):
        side = tile_side(features, count * pitch)
        fold = fold_tiles([brightness], count * basis, side, BINS, CELL_TILES)[0]
        bins = BINS // count
        halves = [half.reshape(count, bins, count, bins) for half in fold.half_means()]
        cells = [np.fft.fft2(half.swapaxes(1, 2)) for half in halves]
        down, along = np.indices((count, count))
        rows = ((down, a, b), (along, b, a), (down + along, a - b, a), (down - along, a + b, a))
        for row, within, across in rows:
            classes = [
                np.array([cell[row % count == kind].mean(0) for kind in range(count)])
                for cell in cells
            ]
            for one in classes:
                one[:, 0, 0] -= one[:, 0, 0].mean()
            whole = np.mean([_shared_power(one, one) for one in classes])
            low = np.ix_(range(count), (-1, 0, 1), (-1, 0, 1))
            differ = _shared_power(*((one - one.mean(0))[low] for one in classes))
            share = differ / max(float(whole), 1e-30)
            found.append(CellClasses(share, np.array([within, count * across])))
    return max(found, key=lambda one: one.share)


def _shared_power(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> float:
    return float((first * second.conj()).real.sum())


def tile_side(features: FlatFeatures, pitch: float) -> int:
    """Side [px] of tiles that hold enough lenses for an average, and are small against a wandering
    period.
    """
    return int(max(2.5 * pitch, min(8 * pitch, min(features.picture.shape) / 5)))
