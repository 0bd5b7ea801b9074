"""Parts of a flat whose lenses are analysed alone: windows spread over it, and tiles that make up all of it.

Where the preset makes the flat smaller, parts begin where a pixel of the smaller flat does: their pixels are those that
the whole would have, whatever the parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ..data.region import lattice_of
from ..depth.matching.matcher import Preset
from ..depth.surface.densify import grid_shape

__all__ = ["LensTile", "lens_tiles", "lens_windows"]

# Lenses so many pitches around a tile are analysed with it: shading is averaged over 4.2, support fades over the rest.
_HALO = 8.0
# Bytes that a tile may take, and what it takes for each pixel as it is analysed: in grey, without shading, cut out,
# and masks.
_BUDGET, _PER_PIXEL = 6e8, 20
# The pixels of the flat itself are there as read for this tile and the next one.
_READ = 2
# Windows along each axis, their side [pitches and px], and how far inside them lenses are believed [pitches].
_WINDOWS, _WINDOW, _INSIDE = 6, (16.0, 256), 3.0
# Cells of the surface's grid among which one is looked for that begins where a block of pixels does.
_CELLS = 40


@dataclass(frozen=True)
class LensTile:
    """A part of the flat to be analysed alone: its lattice, the lenses it answers for, and where both are in the whole.

    All places are in pixels of the flat as it is analysed, of which each is the mean of `factor` x `factor`.

    Parameters
    ----------
    factor : int
    corner : (2,) int64 [px]
    full : Lattice
        In the pixels that the part has as it is read.
    lattice : Lattice
        In those of the part as it is analysed.
    inside : (m,) bool
        Lenses of `lattice` to answer for.
    core : (left, top, right, bottom) [px]
        What they cover of the flat.
    """

    factor: int
    corner: NDArray[np.int64]
    full: Lattice
    lattice: Lattice
    inside: NDArray[np.bool_]
    core: tuple[float, ...]

    @classmethod
    def of(
        cls, whole: Lattice, factor: int, low: Iterable[int], high: Iterable[int], core: NDArray[np.float64]
    ) -> LensTile:
        """The part from the pixel `low` to before `high` of the flat with the lattice `whole`, which is as read."""
        corner = np.array(list(low), np.int64)
        end = np.minimum(np.array(list(high), np.int64) * factor, whole.image_size)
        full = lattice_of(whole, corner * factor, end)
        small = full if factor == 1 else full.downscaled(factor)
        centres = small.centres() + corner
        inside = ((centres >= core[0]) & (centres < core[1])).all(1)
        return cls(factor, corner, full, small, inside, tuple(core.ravel().tolist()))

    @property
    def rectangle(self) -> tuple[int, int, int, int]:
        """`left, top, right, bottom` of its pixels on the flat as read."""
        x, y = (self.corner * self.factor).tolist()
        width, height = self.full.image_size
        return x, y, x + width, y + height


def lens_windows(whole: Lattice, factor: int) -> Iterator[LensTile]:
    """Windows evenly spread from border to border."""
    size = _size(whole, factor)
    pitch = whole.pitch / factor
    side = int(max(_WINDOW[0] * pitch, _WINDOW[1]))
    starts: list[list[int]] = []
    sides: list[int] = []
    for length in size:
        count = int(np.clip(length // side, 1, _WINDOWS))
        starts.append(np.linspace(0, max(0, length - side), count).astype(int).tolist())
        sides.append(side if count > 1 else length)
    for y in starts[1]:
        for x in starts[0]:
            end = min(x + sides[0], size[0]), min(y + sides[1], size[1])
            margin = _INSIDE * pitch
            # The border of the flat is none of the window's making.
            low = np.array([at + margin if at > 0 else -np.inf for at in (x, y)])
            high = np.array([at - margin if at < n else np.inf for at, n in zip(end, size, strict=True)])
            yield LensTile.of(whole, factor, (x, y), end, np.stack([low, high]))


def lens_tiles(whole: Lattice, factor: int, setting: Preset, pixel_bytes: int = 3) -> Iterator[LensTile]:
    """The flat cut into tiles that fit the memory, each with its halo; its pixels have so many bytes."""
    size = _size(whole, factor)
    pitch = whole.pitch / factor
    # Blocks of pixels are averaged for the search, and rows of them left out: those of the whole flat.
    block = max(1, round(pitch / setting.search_pitch)) * setting.row_step
    halo = int(np.ceil(_HALO * pitch))
    each = _READ * pixel_bytes * factor**2 + _PER_PIXEL
    side = max(2 * halo, int(np.sqrt(_BUDGET / each)) - 2 * halo)
    edges = [np.linspace(0, length, -(-length // side) + 1).round().astype(int).tolist() for length in size]
    spacing = grid_shape(whole if factor == 1 else whole.downscaled(factor), setting.cells)[2]
    for top, bottom in zip(edges[1], edges[1][1:], strict=False):
        for left, right in zip(edges[0], edges[0][1:], strict=False):
            low = [_start(max(0, at - halo), spacing, block) for at in (left, top)]
            high = [min(n, at + halo) for n, at in zip(size, (right, bottom), strict=True)]
            core = np.array([(left, top), (right, bottom)]) - 0.5
            # Beyond the last whole pixel of the flat as it is analysed a lens may still have its centre.
            core[1] = np.where(np.array([right, bottom]) == size, np.inf, core[1])
            yield LensTile.of(whole, factor, low, high, core)


def _size(whole: Lattice, factor: int) -> tuple[int, int]:
    """Columns and rows of the flat as it is analysed, with what is left over at its border."""
    width, height = whole.image_size
    return -(-width // factor), -(-height // factor)


def _start(at: int, spacing: float, block: int) -> int:
    """A pixel at or somewhat before a place where a block begins and, as nearly as may be, a cell of the surface."""
    last = int(at / spacing)
    cells = np.arange(max(0, last - _CELLS), last + 1)
    starts = cells * spacing
    pixels = np.rint(starts / block).astype(int) * block
    return int(pixels[np.abs(starts - pixels).argmin()])
