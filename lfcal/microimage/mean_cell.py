"""Mean microimage of a flat.

The mean microimage is a picture of one cell of the lattice: rims and gaps follow the outline of the
cell, whatever its shape. It is made symmetric under a half turn about its centre, which cancels what
a wrong centre would add to it.
"""

from __future__ import annotations

import numpy as np

from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..runtime.arrays import Floats, Singles
from ..runtime.kernels import kernel
from .cell_bins import CHUNKS, CellGrid, gather_pixels

__all__ = ["average_cells"]


# Sums of a bin: those of 1, of the value and of its square, each times 1 and the distances from the
# centre of the bin along `a1` and `a2`.
_SUMS = 9


@kernel(share=lambda picture, centres, sides, room, inverse, bins, chunks, *_: chunks)
def _fold(begin, end, picture, centres, sides, room, inverse, bins, chunks, sums):
    """Sum pixels in the bins of the cell, for chunks of lenses."""
    lenses = centres.shape[0]
    one = np.float32(1)
    for chunk in range(begin, end):
        cells = sums[chunk]
        place = np.empty(room, np.uint32)
        values = np.empty(room, np.float32)
        along = np.empty(room, np.float32)
        across = np.empty(room, np.float32)
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx = centres[lens, 0]
            cy = centres[lens, 1]
            number = gather_pixels(
                picture, cx, cy, sides, inverse, bins, place, values, along, across
            )
            for k in range(number):
                value = values[k]
                square = value * value
                u = along[k]
                v = across[k]
                cell = cells[np.uint64(place[k])]
                cell[0] += one
                cell[1] += value
                cell[2] += square
                cell[3] += u
                cell[4] += value * u
                cell[5] += square * u
                cell[6] += v
                cell[7] += value * v
                cell[8] += square * v


def average_cells(
    picture: Singles, lattice: Lattice, centres: Floats, cell: Cell, bins: int
) -> Singles:
    """Mean microimage (bins * bins, 4) over some of the lenses at `centres` (n, 2) [px].

    Level, inverse variance of a pixel, slopes of the level in x and y [1/px]. The centre of the
    lens is bin 0; columns run along `a1`, rows along `a2`, periodic. It is made symmetric by adding
    the same turned by half a turn. Pixels count where they lie, not at the centre of their bin, so
    that the mean changes smoothly with the lattice.
    """
    grid = CellGrid.of(lattice, cell, bins)
    few = np.ascontiguousarray(centres[:: max(1, len(centres) // 1500)])
    sums = np.zeros((CHUNKS, bins * bins, _SUMS), np.float32)
    _fold(picture, few, *grid, CHUNKS, sums)
    moments = sums.sum(0, dtype=np.float64).T.reshape(3, 3, bins, bins)
    blur, slope_of_blur = _blurs(bins, 0.5 * bins / lattice.pitch)
    # To first order in the distances from the centres of bins.
    count, total, square = (
        blur @ at @ blur.T - blur @ beside @ slope_of_blur.T - slope_of_blur @ below @ blur.T
        for at, beside, below in moments.transpose(1, 0, 2, 3)
    )
    count, total, square = (
        plane + np.roll(plane[::-1, ::-1], (1, 1), axis=(0, 1)) for plane in (count, total, square)
    )
    count = np.maximum(count, 1e-9)
    level = total / count
    variance = np.maximum(square / count - level**2, 1e-4 * float(np.var(level)) + 1e-12)
    along = [(np.roll(level, -1, axis) - np.roll(level, 1, axis)) * (bins / 2) for axis in (1, 0)]
    slope = np.stack(along, axis=-1) @ grid.inverse.T
    return np.dstack([level, 1 / variance, slope]).astype(np.float32).reshape(bins * bins, -1)


def _blurs(count: int, width: float) -> tuple[Floats, Floats]:
    """Matrices (count, count) that blur periodic samples by a Gaussian of standard deviation `width`
    [samples], and that give the slopes of the result.
    """
    frequency = 2 * np.pi * np.fft.fftfreq(count)
    passed = np.exp(-((width * frequency) ** 2) / 2)
    place = np.arange(count)
    # A product with so small a matrix takes a tenth of the time of Fourier transforms.
    shift = place[:, None] - place
    return np.fft.ifft(passed).real[shift], np.fft.ifft(1j * frequency * passed).real[shift]
