"""Gaps between microimages: lines on which a flat is dark or never changes, while what they part is content of its own.

All pixels are sorted by their place in the cell of a lattice. The root mean square of brightness above that of the
gaps, `sqrt(variance + (mean - darkest)^2)`, is large wherever light or scene content comes through a lens, and small in
gaps, whatever the shape of the aperture: disc, square, hexagon, or a disc cut off. On a lattice too fine some borders
of the cells have no gap: they are compared one by one, on cells of two and three steps each way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..lattice.cell import bin_offsets, cell_distances
from ..lattice.lattice import reduce_basis
from ..runtime.arrays import Floats, Singles
from .folding import BINS, CELL_TILES, fold_tiles

__all__ = ["Gaps", "gap_tone", "measure_gaps", "window_likelihood"]

# Contrasts were measured on captures, white images and cameras drawn at random.
_CLEAR_GAP = 0.25  # weakest gap from which on it proves a lattice; lattices too fine have up to 0.02
_DARK_GAP = 0.58  # contrast that dark gaps have [standard deviations]: bricks 0.5, arrays 0.6 to 2.4
_CONTENT = 0.15  # least content of cells over the contrast: weaves 0.13, scenes 0.17


class Gaps(NamedTuple):
    """Gaps at the borders of the cells of a lattice."""

    basis: Floats  # (2, 2) [px] reduced
    centre: Floats  # (2,) middle of a cell, in fractional coordinates of `basis`
    contrast: float  # of the middle of cells over their borders, in standard deviations of the flat
    weakest: float  # 1 - RMS at a border over that in the cells beside it; 1 is a black gap, 0 none
    strongest: float
    content: float  # standard deviation in the middle of cells, of what differs from one to another, over `contrast`

    def lack_some(self) -> bool:
        """Whether some borders have clear gaps and others none: the cells are not those of one lens each."""
        return self.strongest > _CLEAR_GAP and self.weakest < 0.1 * self.strongest

    def prove_lattice(self) -> bool:
        """Whether gaps part all cells from each other, and these have content of their own: an array of lenses."""
        return self.weakest >= _CLEAR_GAP and self.contrast >= _DARK_GAP and self.content >= _CONTENT


def window_likelihood(brightness: Singles, basis: Floats, side: int) -> float:
    """Gain in log likelihood [nats per pixel] if each place of a cell has a mean and a variance of its own.

    The same window everywhere with content of its own inside: greatest where gaps lie over gaps in all of the flat.
    `brightness` (h, w) is locally normalised; `side` [px] is that of the tiles that are averaged.
    """
    value, square = (fold.mean() for fold in fold_tiles([brightness, brightness**2], basis, side, BINS))
    variance = np.maximum(square - value**2, 0)
    whole = float(variance.mean() + value.var())
    # Places of no variance at all, as in saturated gaps, must not count without limit.
    return float(0.5 * (np.log(whole) - np.log(variance + 0.001 * whole).mean()))


def measure_gaps(brightness: Singles, basis: Floats, side: int) -> Gaps:
    """Gaps of a lattice, of which only the `basis` (2, 2) [px] is known.

    `brightness` (h, w) is locally normalised; `side` [px] is that of the tiles that are averaged.
    """
    basis = reduce_basis(basis)
    middle, border = _cell_parts(basis)
    power = fold_tiles([brightness], basis, side, BINS, CELL_TILES)[0].lattice_power()
    # Tiles in which next to nothing repeats lie beside the array.
    lit = power >= 0.1 * np.quantile(power, 0.9)
    pictures = [brightness, brightness**2]
    weakest, strongest = np.inf, -np.inf
    # Borders are told apart on cells of up to three steps each way.
    for cells in (1, 2, 3):
        bins = BINS if cells == 1 else cells * BINS * 2 // 3
        folds = fold_tiles(pictures, cells * basis, side, bins, CELL_TILES)
        value, square = (fold.mask(lit).mean() for fold in folds)
        variance = np.maximum(square - value**2, 0)
        # Above the level of the gaps.
        rms = np.sqrt(variance + np.maximum(value - np.quantile(value, 0.01), 0) ** 2)
        if cells == 1:
            found = np.fft.ifft2(np.fft.fft2(rms) * np.conj(np.fft.fft2(middle - border))).real
            contrast = float(found.max())
            at = np.array(np.unravel_index(int(found.argmax()), found.shape), dtype=np.float64)[::-1] + 0.5
            centre = _most_symmetric(rms, at, basis)
            shift = np.floor(centre * BINS).astype(int)[::-1]
            content = float(np.sqrt((variance * np.roll(middle, shift, (0, 1))).sum())) / contrast
        contrasts = _border_contrasts(rms, cells, centre, basis)
        weakest, strongest = min(weakest, float(contrasts.min())), max(strongest, float(contrasts.max()))
    return Gaps(basis, centre, contrast, weakest, strongest, content)


def gap_tone(light: Floats, gaps: Gaps) -> float:
    """Light at the borders of the average cell (bins, bins) over that in its middle."""
    shift = np.floor(gaps.centre * BINS).astype(int)[::-1]
    inside, between = (float((light * np.roll(part, shift, (0, 1))).sum()) for part in _cell_parts(gaps.basis))
    return between / max(inside, 1e-30)


def _cell_parts(basis: Floats) -> tuple[Floats, Floats]:
    """Weights (bins, bins) of the middle and of the border of a cell about bin (0, 0), each of sum 1."""
    far, to_border = cell_distances(basis, bin_offsets(basis, BINS, np.array([0.5, 0.5]) / BINS).reshape(-1, 2))
    inradius = to_border.max()
    parts = (far < 0.6 * inradius, to_border < max(1.5 * inradius / BINS, 0.5))
    middle, border = (part.reshape(BINS, -1) / part.sum() for part in parts)
    return middle, border


def _most_symmetric(rms: Floats, near: Floats, basis: Floats) -> Floats:
    """(2,) fractional coordinates of the centre of a half turn that changes a cell (bins, bins) least, near a bin."""
    bins = len(rms)
    correlation = np.fft.ifft2(np.fft.fft2(rms - rms.mean()) ** 2).real
    steps = np.arange(-bins // 2, bins // 2 + 1) / 2
    tried = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    reach = 0.15 * np.hypot(*basis.T).min()
    tried = near + tried[np.hypot(*(tried / bins @ basis).T) < reach]
    # Bins k and m turn into each other about (k + m + 1) / 2.
    turn = np.rint(2 * tried - 1).astype(int) % bins
    centre: Floats = tried[correlation[turn[:, 1], turn[:, 0]].argmax()] / bins
    return centre


def _border_contrasts(rms: Floats, cells: int, centre: Floats, basis: Floats) -> Floats:
    """Contrast of every border between neighbours among `cells` x `cells`, as `Gaps.weakest`."""
    first, second = basis
    shorter = np.array([1, -1]) if first @ second > 0 else np.array([1, 1])
    # Such cells have six neighbours.
    oblique = abs(first @ second) > 0.08 * np.hypot(*first) * np.hypot(*second)
    steps = np.array([(1, 0), (0, 1), *([shorter] if oblique else [])])
    inverse = np.linalg.inv(basis)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 2), -1).reshape(-1, 2)
    reach = 0.3 * np.hypot(*(steps @ basis).T).min()
    inside = grid[np.hypot(*grid.T) <= 1] * reach @ inverse
    places = np.stack(np.meshgrid(*[np.arange(cells)] * 2), -1).reshape(-1, 1, 2) + centre

    def sample(offsets: Floats) -> Floats:
        """RMS over points at `offsets` (m, 2) from each centre."""
        bins = np.floor((places + offsets) / cells % 1 * len(rms)).astype(int) % len(rms)
        return np.sqrt((rms[bins[..., 1], bins[..., 0]] ** 2).mean(1))

    found = []
    for step in steps:
        ahead = step @ basis
        # A side of a hexagonal cell is 0.58 steps long.
        along = np.linspace(-0.3, 0.3, 9)[:, None] * np.array([-ahead[1], ahead[0]])
        lines = [(ahead * (0.5 + shift / 36) + along) @ inverse for shift in (-1, 0, 1)]
        border = np.min([sample(line) for line in lines], axis=0)
        found.append(1 - border / np.maximum(np.minimum(sample(inside), sample(inside + step)), 1e-9))
    return np.concatenate(found)
