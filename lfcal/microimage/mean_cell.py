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


@kernel(share=lambda picture, centres, sides, room, inverse, stride, bins, chunks, *_: chunks)
def _fold(begin, end, picture, centres, sides, room, inverse, stride, bins, chunks, sums):
    """Sum pixels, their squares and their number in the bins of the cell, for chunks of lenses."""
    lenses = centres.shape[0]
    one = np.float32(1)
    for chunk in range(begin, end):
        cells = sums[chunk]
        place = np.empty(room, np.uint32)
        values = np.empty(room, np.float32)
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx = centres[lens, 0]
            cy = centres[lens, 1]
            number = gather_pixels(
                picture, cx, cy, lens, sides, inverse, stride, bins, place, values
            )
            for k in range(number):
                value = values[k]
                n = np.uint64(place[k])
                # Four values read and written together are one vector instruction.
                a = cells[n, 0]
                b = cells[n, 1]
                c = cells[n, 2]
                d = cells[n, 3]
                a = a + value
                b = b + value * value
                c = c + one
                d = d + one
                cells[n, 0], cells[n, 1], cells[n, 2], cells[n, 3] = a, b, c, d


def average_cells(
    picture: Singles, lattice: Lattice, centres: Floats, cell: Cell, bins: int, stride: int = 1
) -> Singles:
    """Mean microimage (bins * bins, 4) over some of the lenses at `centres` (n, 2) [px].

    Level, inverse variance of a pixel, slopes of the level in x and y [1/px]. The centre of the
    lens is bin 0; columns run along `a1`, rows along `a2`, periodic. It is made symmetric by adding
    the same turned by half a turn.
    """
    grid = CellGrid.of(lattice, cell, stride, bins)
    few = np.ascontiguousarray(centres[:: max(1, len(centres) // 1500)])
    sums = np.zeros((CHUNKS, bins * bins, 4), np.float32)
    _fold(picture, few, *grid, CHUNKS, sums)
    planes = sums.sum(0, dtype=np.float64).T[:3].reshape(3, bins, bins)
    blur = 0.5 * bins / lattice.pitch
    total, square, count = (
        _blur(plane + np.roll(plane[::-1, ::-1], (1, 1), axis=(0, 1)), blur) for plane in planes
    )
    count = np.maximum(count, 1e-9)
    level = total / count
    variance = np.maximum(square / count - level**2, 1e-4 * float(np.var(level)) + 1e-12)
    along = [(np.roll(level, -1, axis) - np.roll(level, 1, axis)) * (bins / 2) for axis in (1, 0)]
    slope = np.stack(along, axis=-1) @ grid.inverse.T
    return np.dstack([level, 1 / variance, slope]).astype(np.float32).reshape(bins * bins, -1)


def _blur(values: Floats, width: float) -> Floats:
    """A periodic square picture blurred by a Gaussian of standard deviation `width` [samples]."""
    count = len(values)
    passed = np.exp(-2 * (np.pi * width * np.fft.fftfreq(count)) ** 2)
    place = np.arange(count)
    # A product with so small a matrix takes a tenth of the time of Fourier transforms.
    blur = np.fft.ifft(passed).real[place[:, None] - place]
    return np.asarray(blur @ values @ blur.T)
