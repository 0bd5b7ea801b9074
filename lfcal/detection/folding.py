"""Average microimage of each tile of a flat: pixels are summed by their place in the cell of a
lattice.

What all microimages have in common adds up, what the scene shows averages out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..microimage.cell_bins import VECTOR_LENGTH, compute_cell_bins
from ..microimage.lit import STRAY, is_lit
from ..runtime.arrays import Booleans, Floats, Singles
from ..runtime.kernels import kernel

__all__ = [
    "BINS",
    "CELL_TILES",
    "TileFolds",
    "fold_lit_tiles",
    "fold_tiles",
    "measure_repeatability",
]

#: Bins along an average cell: a multiple of 6, so that halves and thirds of a cell are whole bins.
BINS = 36
#: Tiles that give an average cell, evenly spread.
CELL_TILES = 60


@kernel(
    share=lambda first, second, inverse, side, columns, bins, tiles, *_: len(tiles),
    error_model="numpy",
)
def _fold(begin, end, first, second, inverse, side, columns, bins, tiles, totals, count):
    """Fill the `totals` (2, t, bins * bins) of both pictures, and the `count` (t, bins * bins) of
    pixels.
    """
    height, width = first.shape
    one = np.float32(1)
    for place in range(begin, end):
        tile = tiles[place]
        y0 = (tile // columns) * side
        x0 = (tile % columns) * side
        across = max(min(side, width - x0), 0)
        at = np.empty(across + VECTOR_LENGTH, np.uint32)
        cells = np.zeros((bins * bins, 4), np.float32)
        for y in range(y0, min(y0 + side, height)):
            u = x0 * inverse[0, 0] + y * inverse[1, 0]
            v = x0 * inverse[0, 1] + y * inverse[1, 1]
            compute_cell_bins(u, v, inverse[0, 0], inverse[0, 1], bins, 0, across, at)
            row = first[y, x0 : x0 + across]
            other = second[y, x0 : x0 + across]
            for k in range(across):
                n = np.uint64(at[k])
                # Four values read and written together take one vector instruction.
                a = cells[n, 0]
                b = cells[n, 1]
                c = cells[n, 2]
                d = cells[n, 3]
                a = a + row[k]
                b = b + other[k]
                c = c + one
                d = d + one
                cells[n, 0], cells[n, 1], cells[n, 2], cells[n, 3] = a, b, c, d
        for cell in range(len(cells)):
            totals[0, place, cell], totals[1, place, cell] = cells[cell, 0], cells[cell, 1]
            count[place, cell] = cells[cell, 2]


@dataclass(frozen=True)
class TileFolds:
    """Average cell of a lattice in each tile of a flat."""

    # (t, bins, bins) sum of pixels by fractional lattice coordinate: column along a1, row along a2,
    # from (0, 0)
    total: Singles
    count: Singles  # (t, bins, bins) number of pixels
    centre: Floats  # (t, 2) [px] middle of each tile, order x, y
    basis: Floats  # (2, 2) [px]
    grid: tuple[int, int]  # rows and columns of tiles
    side: int  # [px] of the square tiles; those at the right and lower edges may be smaller

    @property
    def bins(self) -> int:
        """Bins along each lattice vector."""
        return self.total.shape[1]

    def mask(self, chosen: Booleans) -> TileFolds:
        """The same tiles, emptied where not `chosen` (t,)."""
        share = chosen[:, None, None].astype(np.float32)
        return replace(self, total=self.total * share, count=self.count * share)

    def lattice_power(self) -> Singles:
        """(t,) squared amplitude of the strongest low harmonic of each tile."""
        near = self.harmonics[:, np.arange(-2, 3)[:, None], np.arange(3)]
        power = near.real**2 + near.imag**2
        power[:, 2, 0] = 0
        area = np.maximum(self.count.sum((1, 2)), 1)
        strongest: Singles = power.max((1, 2)) / area**2
        return strongest

    @cached_property
    def harmonics(self) -> NDArray[np.complex64]:
        """(t, bins, 7) Fourier coefficients of each tile, index `[t, k, h]` for harmonic `h*b1 +
        k*b2`, h up to 6.

        Structure finer than a sixth of the pitch tells little about the place of a microimage.
        """
        level = self.total.sum((1, 2), keepdims=True) / np.maximum(
            self.count.sum((1, 2), keepdims=True), 1
        )
        # Sums of deviations: bins without pixels must not count as dark.
        values = self.total - level * self.count
        # For so few harmonics a matrix product is several times as fast as a transform.
        phase = 2 * np.pi / self.bins * np.outer(np.arange(self.bins), np.arange(7))
        waves = np.exp(-1j * phase).astype(np.complex64).view(np.float32)
        rows = (
            (values.reshape(-1, self.bins) @ waves)
            .view(np.complex64)
            .reshape(len(values), self.bins, -1)
        )
        return np.fft.fft(rows, axis=1).astype(np.complex64)

    def half_means(self) -> list[Floats]:
        """Average cells (bins, bins) of two halves of the tiles, like the colours of a
        checkerboard.
        """
        place = np.rint((self.centre - self.centre[0]) / self.side).astype(int)
        colour = place.sum(1) % 2
        if not 0 < colour.sum() < len(colour):
            return [self.mean()] * 2
        return [self.mean(colour == side) for side in (0, 1)]

    def mean(self, chosen: Any = slice(None)) -> Floats:
        """(bins, bins) average cell over the `chosen` tiles, at the resolution of the pixels."""
        total = self.total[chosen].sum(0, dtype=np.float64)
        count = self.count[chosen].sum(0, dtype=np.float64)
        level = total.sum() / max(count.sum(), 1)
        # A pitch of a whole number of pixels leaves bins empty: average over the width of a pixel.
        across, down = (_window(self.bins, float(np.hypot(*side))) for side in self.basis)
        total, count = down @ np.array([total, count]) @ across
        return np.where(count > 0.5, total / np.maximum(count, 0.5), level)


def _window(bins: int, length: float) -> Floats:
    """(bins, bins) matrix of sums over the bins within the width of a pixel, of a cell of `length`
    [px].
    """
    half = int(np.ceil(bins / length)) // 2
    place = np.arange(bins)
    away = np.abs((place[:, None] - place + bins // 2) % bins - bins // 2)
    return (away <= half).astype(np.float64)


def fold_tiles(
    pictures: Sequence[Singles], basis: Floats, side: int, bins: int = BINS, most: int | None = None
) -> list[TileFolds]:
    """Average one or two pictures (h, w) over the cells of a lattice with its origin at (0, 0),
    tile by tile.

    `side` [px] is about that of the square tiles, `bins` the bins along each lattice vector; about
    `most` tiles are used, evenly spread, or all of them.
    """
    height, width = pictures[0].shape
    rows = max(1, round(height / side))
    columns = max(1, round(width / side))
    side = max(-(-height // rows), -(-width // columns))
    rows = -(-height // side)
    columns = -(-width // side)
    tiles = np.arange(rows * columns)
    if most is not None and len(tiles) > most:
        tiles = np.unique(np.linspace(0, len(tiles) - 1, most).astype(int))
    *totals, count = planes = np.empty((3, len(tiles), bins, bins), np.float32)
    flat = planes.reshape(3, len(tiles), -1)
    _fold(
        pictures[0],
        pictures[-1],
        np.linalg.inv(basis),
        side,
        columns,
        bins,
        tiles,
        flat[:2],
        flat[2],
    )
    y, x = np.divmod(tiles, columns)
    right = np.minimum((x + 1) * side, width)
    low = np.minimum((y + 1) * side, height)
    centre = np.column_stack([(x * side + right - 1) / 2, (y * side + low - 1) / 2])
    basis = np.array(basis, dtype=np.float64)
    return [
        TileFolds(total, count, centre, basis, (rows, columns), side)
        for total in totals[: len(pictures)]
    ]


def fold_lit_tiles(
    picture: Singles, features: list[Singles], basis: Floats, side: int
) -> list[TileFolds]:
    """Folds of the features, without tiles beside the array: dark ones in which next to nothing
    repeats.
    """
    folds = fold_tiles(features, basis, side)
    power = np.sum([fold.lattice_power() for fold in folds], axis=0)
    tone = np.ravel(cv2.resize(picture, folds[0].grid[::-1], interpolation=cv2.INTER_AREA))
    beside = ~is_lit(tone**2, STRAY) & (power < 0.1 * np.quantile(power, 0.9))
    return [fold.mask(~beside) for fold in folds] if beside.any() else folds


def measure_repeatability(folds: list[TileFolds]) -> float:
    """Least correlation of the average cells of opposite thirds of the flat, -1..1.

    Gaps between lenses are the same everywhere. Content that repeats from lens to lens, as an
    object with little parallax does, changes across the flat. Cells may be shifted against each
    other, as distortion shifts them.
    """
    found = []
    for fold in folds:
        for place in fold.centre.T:
            low, high = np.quantile(place, (1 / 3, 2 / 3))
            if low == high:
                return 0.0
            thirds = [fold.mean(place <= low), fold.mean(place >= high)]
            first, second = (np.fft.fft2(cell - cell.mean()) for cell in thirds)
            matched = float(np.fft.ifft2(first * second.conj()).real.max())
            power = float(np.sqrt((np.abs(first) ** 2).sum() * (np.abs(second) ** 2).sum()))
            found.append(matched * first.size / max(power, 1e-30))
    return min(found)
