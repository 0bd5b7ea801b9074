"""Average cell of a lattice on a flat: what all lenses have in common at each place of a cell.

All maps have `BINS` x `BINS` places, by the fractional coordinates of the lattice through (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lattice.cell import bin_offsets, cell_distances
from ..runtime.arrays import Booleans, Floats
from .features import FlatFeatures
from .folding import BINS, CELL_TILES, TileFolds, fold_lit_tiles, fold_tiles

__all__ = ["CellMaps", "CellParts", "tile_side"]


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
    """Maps (bins, bins) of the average cell, and the tiles of the flat that they are averages of."""

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
        pitch = float(np.sqrt(abs(np.linalg.det(basis))))
        side = tile_side(features, pitch)
        brightness, edges = features.levelled(pitch)
        tiles = fold_lit_tiles(features.picture, [brightness, edges], basis, side)
        first, second = fold_tiles([brightness**2, features.steps], basis, side, BINS, CELL_TILES)
        light = fold_tiles([features.picture], basis, side, BINS, CELL_TILES)[0]
        mean, edge_mean = (tile.mean() for tile in tiles)
        variance = np.maximum(first.mean() - mean**2, 0)
        return cls(basis, mean, variance, edge_mean, second.mean(), light.mean() ** 2, tiles)

    def explained(self) -> float:
        """Gain in log likelihood [nats per pixel] if each place of a cell has a mean and a variance
        of its own.

        It is greatest where gaps lie over gaps in all of the flat, while what they part differs.
        """
        whole = float(self.variance.mean() + self.brightness.var())
        # Places of no variance at all, as in saturated gaps, must not count without limit.
        return float(0.5 * (np.log(whole) - np.log(self.variance + 0.001 * whole).mean()))


def tile_side(features: FlatFeatures, pitch: float) -> int:
    """Side [px] of tiles that hold enough lenses for an average, and are small against a wandering
    period.
    """
    return int(max(2.5 * pitch, min(8 * pitch, min(features.picture.shape) / 5)))
