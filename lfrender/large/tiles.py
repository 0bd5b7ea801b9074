"""Parts of a large flat: lenses and pixels of tiles and windows, and their reading.

Windows are spread over the flat, tiles make up all of it. Where the preset reduces the flat, parts
begin where a pixel of the reduced flat does: their pixels are those that the whole reduced flat
would have.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lfcal import Calibration, CalibrationError, FlatError, FlatSource, Lattice, open_flat
from lfcal.runtime.arrays import Array, Booleans, Floats, Integers
from lfcal.runtime.errors import CAMERA_ADVICE, check_type

from ..depth.presets import Preset
from ..depth.region import crop_lattice
from ..depth.surface.scene_grid import grid_shape
from ..flat.demosaicing import SUPPORT, demosaic
from ..flat.validation import exposure_rows
from ..output.resume import file_identity
from ..runtime.types import Size

__all__ = ["LensTile", "Rectangle", "TileReader", "lens_tiles", "lens_windows"]

# Side of a window [pitches], and the least one [px].
_WINDOW = 16
_LEAST_WINDOW = 256
# Bytes of a pixel that is analysed: grey, without shading, cut out, masks.
_ANALYSED_BYTES = 20
# Cells of the surface among which the start of a tile is chosen.
_CELLS = 40
#: `left, top, right, bottom` [px].
Rectangle = tuple[int, int, int, int]


class TileReader:
    """Reads parts of a flat, in colour if the camera has a colour mosaic.

    Copies in other processes open the file themselves.
    """

    def __init__(self, source: FlatSource, calibration: Calibration) -> None:
        check_type(source, FlatSource, "source", "lfcal.open_flat makes one")
        check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
        self.size = source.shape[1], source.shape[0]
        if self.size != calibration.image_size:
            was, now = ("{} x {}".format(*pair) for pair in (calibration.image_size, self.size))
            raise CalibrationError(
                f"calibration is for images of {was} px, the flat has {now}; calibrate on this flat"
            )
        self._source: FlatSource | None = source
        dark = None if source.dark is None else source.dark.absolute()
        self._file = source.path.absolute(), source.page, dark
        # The size alone: copies on the disks of several machines differ in their times.
        self._bytes = file_identity(source.path)[1]
        self.calibration, self.dtype = calibration, source.dtype
        self._mosaic = calibration.mosaic is not None and len(source.shape) == 2
        self.channels = 3 if self._mosaic or len(source.shape) == 3 else 1

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_source": None}

    def read_raw(self, part: Rectangle) -> Array:
        """The pixels of a part as stored, with those around it that demosaicing needs."""
        if self._source is None:
            if file_identity(self._file[0])[1] != self._bytes:
                raise FlatError(
                    f"{self._file[0]}: is another file where the workers are, or has been changed"
                )
            self._source = open_flat(*self._file)
        return self._source.read(*self._widen(part))

    def read(self, part: Rectangle, raw: Array | None = None) -> Array:
        """Pixels (h, w, C) of a part, equal to those of `check_flat`.

        They are computed from those of `read_raw` if these are given.
        """
        if raw is None:
            raw = self.read_raw(part)
        if not self._mosaic:
            return np.atleast_3d(raw)
        left, top, _, _ = self._widen(part)
        colour = demosaic(raw, self.calibration, (left, top))
        return np.ascontiguousarray(
            colour[part[1] - top : part[3] - top, part[0] - left : part[2] - left]
        )

    def _widen(self, part: Rectangle) -> Rectangle:
        """The part, with the pixels around it that demosaicing needs.

        It begins at even places of a mosaic.
        """
        if not self._mosaic:
            return part
        left, top = (max(0, at - SUPPORT) // 2 * 2 for at in part[:2])
        right, bottom = (min(n, at + SUPPORT) for n, at in zip(self.size, part[2:], strict=True))
        return left, top, right, bottom

    def sample_exposure(self) -> Array:
        """Rows (n, W, C) of the flat from which its exposure is measured."""
        width, height = self.size
        return np.concatenate(
            [self.read((0, row, width, row + 1)) for row in exposure_rows(height).tolist()]
        )


@dataclass(frozen=True)
class LensTile:
    """A part of the flat that is analysed alone.

    Corner and core are in pixels of the flat as it is analysed.
    """

    factor: int
    corner: Integers  # (2,) first pixel x, y
    full: Lattice  # in the pixels of the part as it is read
    lattice: Lattice  # in those of the part as it is analysed
    inside: Booleans  # lenses of `lattice` whose results are used; the others are the halo
    core: tuple[float, ...]  # `left, top, right, bottom` around the centres of these lenses

    @classmethod
    def cut(
        cls,
        whole: Lattice,
        factor: int,
        low: Iterable[int],
        high: Iterable[int],
        core: Floats,
    ) -> LensTile:
        """The part from pixel `low` to before `high` of a flat.

        `whole` is the lattice of the flat in pixels as read.
        """
        corner = np.array(list(low), np.int64)
        end = np.minimum(np.array(list(high), np.int64) * factor, whole.image_size)
        full = crop_lattice(whole, corner * factor, end)
        small = full.downscaled(factor)
        centres = small.centres() + corner
        inside = ((centres >= core[0]) & (centres < core[1])).all(1)
        return cls(factor, corner, full, small, inside, tuple(core.ravel().tolist()))

    @property
    def rectangle(self) -> Rectangle:
        """Its pixels on the flat as read."""
        x, y = (self.corner * self.factor).tolist()
        width, height = self.full.image_size
        return x, y, x + width, y + height


def lens_windows(whole: Lattice, factor: int) -> Iterator[LensTile]:
    """At most 6 x 6 windows, evenly spread from border to border; lenses near borders are halo."""
    size = np.array(_reduced_size(whole, factor))
    pitch = whole.pitch / factor
    side = int(max(_WINDOW * pitch, _LEAST_WINDOW))
    counts = np.clip(size // side, 1, 6)
    spans = np.where(counts > 1, side, size)
    columns, rows = (
        np.linspace(0, max(0, n - side), k).astype(int) for n, k in zip(size, counts, strict=True)
    )
    for corner in np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2):
        end = np.minimum(corner + spans, size)
        # At the border of the flat the window cuts nothing off.
        low = np.where(corner > 0, corner + 3 * pitch, -np.inf)
        high = np.where(end < size, end - 3 * pitch, np.inf)
        yield LensTile.cut(whole, factor, corner, end, np.stack([low, high]))


def lens_tiles(
    whole: Lattice, factor: int, preset: Preset, pixel_bytes: int = 3, memory: float = 6e8
) -> Iterator[LensTile]:
    """Cut a flat into tiles that need `memory` [bytes] each, with their halos.

    The flat has `pixel_bytes` per pixel.
    """
    size = _reduced_size(whole, factor)
    pitch = whole.pitch / factor
    # Matching averages blocks of pixels and skips rows of them: tiles use the same blocks as the
    # whole flat.
    block = max(1, round(pitch / preset.search_pitch)) * preset.row_step
    # Shading is averaged over 4.2 pitches, the rest is for support.
    halo = int(np.ceil(8 * pitch))
    # Pixels as read, of this tile and of the next one; then as they are analysed.
    bytes_each = 2 * pixel_bytes * factor**2 + _ANALYSED_BYTES
    side = max(2 * halo, int(np.sqrt(memory / bytes_each)) - 2 * halo)
    edges = [
        np.linspace(0, length, -(-length // side) + 1).round().astype(int).tolist()
        for length in size
    ]
    _, _, spacing = grid_shape(whole.downscaled(factor), preset.surface_cells)
    for top, bottom in zip(edges[1], edges[1][1:], strict=False):
        for left, right in zip(edges[0], edges[0][1:], strict=False):
            low = [_align(max(0, at - halo), spacing, block) for at in (left, top)]
            high = [min(n, at + halo) for n, at in zip(size, (right, bottom), strict=True)]
            core = np.array([(left, top), (right, bottom)]) - 0.5
            # A lens may have its centre beyond the last whole pixel of the reduced flat.
            core[1] = np.where(np.array([right, bottom]) == size, np.inf, core[1])
            yield LensTile.cut(whole, factor, low, high, core)


def _reduced_size(whole: Lattice, factor: int) -> Size:
    width, height = whole.image_size
    return -(-width // factor), -(-height // factor)


def _align(at: int, spacing: float, block: int) -> int:
    """The pixel at or before `at` where a block begins and, most nearly, a cell of the surface."""
    last = int(at / spacing)
    starts = np.arange(max(0, last - _CELLS), last + 1) * spacing
    pixels = np.rint(starts / block).astype(int) * block
    return int(pixels[np.abs(starts - pixels).argmin()])
