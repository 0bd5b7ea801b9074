"""Depth of flats too large for memory, by tiles of lenses.

Results of single lenses depend on others in two ways. On lenses nearby: each tile is analysed with
a halo of lenses around it, whose results are taken from the tiles they belong to. And on all
lenses, by the noise and the range of depths: these are estimated first, in windows spread over the
flat.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lfcal import Calibration, FlatSource, Lattice, LensBlur
from lfcal.runtime.arrays import Array, Singles
from lfcal.runtime.progress import Progress, Step, show_progress

from ..data.depth_map import DepthMap
from ..data.flat_samples import sample_flat
from ..data.surface import Surface
from ..depth.edges.locate_edges import FINER, refine_grid
from ..depth.pipeline import estimate_part, locate_part_edges
from ..depth.presets import PRESETS, Shortcuts
from ..depth.region import Part, WholeFlat, empty_lenses, rescale_depth, rows_of
from ..depth.same_surface import TOLERANCE
from ..depth.surface.scene_grid import grid_shape
from ..flat.gray_flat import GrayFlat, make_gray_flat
from ..flat.gray_flat import has_uneven_lenses as uneven_lenses
from ..flat.lens_blur import find_lens_blur
from ..flat.texture import estimate_noise, find_texture
from ..flat.validation import match_exposure
from ..runtime.choices import Preset, Shortcut, check_choice
from ..sequence.workers import Workers
from .tiles import LensTile, TileReader, lens_tiles, lens_windows

__all__ = ["analyze_large"]

# [px] Side of the middle of a flat that the blur of the microlenses is measured on.
_BLUR_PART = 2048


def analyze_large(
    source: FlatSource,
    calibration: Calibration,
    preset: Preset = "balanced",
    *,
    skip: bool | Iterable[Shortcut] = True,
    progress: Progress = None,
    client: Any = None,
    threads: int | None = None,
    memory: float = 6e8,
) -> DepthMap:
    """Estimate the depth of a flat that need not fit into memory.

    It works as `analyze`, with nearly the same results.

    The tiles follow from size, type and pitch of the flat and from `memory` alone: the result does
    not depend on the number of workers or on the machine.

    Parameters
    ----------
    source : FlatSource
        From `lfcal.open_flat`.
    calibration, preset, skip
        As in `analyze`.
    progress : bool or callable, optional
        True shows a bar; a function is called with the numbers of finished and of all tiles.
    client : distributed.Client or None
        Have tiles analysed by the workers of this cluster, with the same results bit for bit. They
        read the flat themselves: it must lie on storage that all of them see under the same path.
    threads : int or None
        Threads of the kernels in each worker of a cluster; None leaves it to the machine.
    memory : float [bytes]
        Of a tile. Results beside the seams of other tiles differ a little.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal, lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/flat.tif", flat)
    ...     with lfcal.open_flat(f"{folder}/flat.tif") as source:
    ...         len(lfrender.analyze_large(source, camera, "fast")) == len(depth)
    True
    """
    check_choice(preset, Preset, "preset")
    shortcuts = Shortcuts.of(skip)
    reader = TileReader(source, calibration)
    calibration = reader.calibration = match_exposure(reader.sample_exposure(), calibration)
    flat = _Flat(reader, preset, shortcuts)
    workers = Workers(client, threads)
    windows = lens_windows(calibration.lattice, flat.factor)
    plain, rough, sizes = map(
        np.concatenate, zip(*workers.map(_survey_window, flat, windows, _Flat.read), strict=True)
    )
    flat = replace(flat, whole=WholeFlat(estimate_noise(rough), sizes, estimate_noise(plain)))
    tiles = lens_tiles(
        calibration.lattice,
        flat.factor,
        PRESETS[preset],
        reader.channels * source.dtype.itemsize,
        memory,
    )
    with show_progress(progress, "tiles") as step:
        depth = _analyze_tiles(flat, workers, list(tiles), step)
    samples = None
    # Those of a colour filter mosaic are not those of the flat in colour.
    if calibration.mosaic is None or len(source.shape) == 3:
        samples = sample_flat(source)
    depth = rescale_depth(depth, calibration.lattice, flat.factor, flat_samples=samples)
    return replace(depth, lens_blur=_find_lens_blur(reader, calibration, depth))


def _find_lens_blur(
    reader: TileReader, calibration: Calibration, depth: DepthMap
) -> LensBlur | None:
    """The blur that the middle of the flat shows."""
    size = np.array(calibration.image_size)
    pitch = calibration.lattice.pitch
    first = np.maximum(size - _BLUR_PART, 0) // 2
    end = np.minimum(first + _BLUR_PART, size)
    left, top = first.tolist()
    pixels = reader.read((left, top, *end.tolist()))
    # Microimages that the border of the part cuts are left out.
    low = np.where(first > 0, first + pitch, -1)
    high = np.where(end < size, end - pitch, size)
    centres = calibration.lattice.centres()
    inside = ((centres > low) & (centres < high)).all(1)

    sizes = np.where(inside, depth.patch_size, np.float32(np.nan))
    return find_lens_blur(pixels, (left, top), calibration, sizes)


@dataclass(frozen=True)
class _Flat:
    """What the analysis of each part needs to know about the whole flat."""

    reader: TileReader
    preset: str
    shortcuts: Shortcuts
    whole: WholeFlat | None = None

    @property
    def factor(self) -> int:
        return PRESETS[self.preset].factor(self.reader.calibration.lattice.pitch)

    @cached_property
    def lattice(self) -> Lattice:
        """The lattice in pixels of the flat as it is analysed."""
        return self.reader.calibration.lattice.downscaled(self.factor)

    @cached_property
    def _gain(self) -> Any:
        camera = self.reader.calibration
        if uneven_lenses(camera):
            return camera.region_gain()
        return None

    def read(self, part: LensTile) -> Array:
        return self.reader.read_raw(part.rectangle)

    def gray_tile(self, part: LensTile, raw: Array) -> GrayFlat:
        pixels = self.reader.read(part.rectangle, raw)
        height, width = pixels.shape[:2]
        light = None if self._gain is None else self._gain.at(*part.rectangle[:2], width, height)
        return make_gray_flat(
            pixels, replace(self.reader.calibration, lattice=part.full), part.factor, light
        )


def _survey_window(flat: _Flat, window: LensTile, pixels: Array) -> tuple[Singles, ...]:
    """Roughness of the lenses of a window, and the depths of those that have one.

    Roughness is measured with and without the common shading.
    """
    part = Part(flat.gray_tile(window, pixels), window.lattice, flat.preset)
    texture = find_texture(part.gray, part.lattice, part.statistics)
    depth = estimate_part(part, Shortcuts.of(False))
    inside = window.inside
    return (
        part.statistics.roughness[inside],
        texture.statistics.roughness[inside],
        depth.patch_size[inside & ~depth.filled],
    )


def _analyze_tile(flat: _Flat, tile: LensTile, pixels: Array) -> DepthMap:
    """Depth of the lenses of a tile and its halo."""
    part = Part(flat.gray_tile(tile, pixels), tile.lattice, flat.preset, flat.whole)
    depth = estimate_part(part, flat.shortcuts)
    if PRESETS[flat.preset].edges:
        depth = locate_part_edges(part, depth)
    return depth


def _analyze_tiles(
    flat: _Flat,
    workers: Workers,
    tiles: list[LensTile],
    step: Step,
) -> DepthMap:
    lattice = flat.lattice
    preset = flat.preset
    shape, first, spacing = grid_shape(lattice, PRESETS[preset].surface_cells)
    values = empty_lenses(len(lattice))
    finer = 1
    if PRESETS[preset].edges:
        finer = FINER
    surface = np.empty((shape[0] * finer, shape[1] * finer), np.float32)
    saved: dict[str, float] = {}
    found = workers.map(_analyze_tile, flat, tiles, _Flat.read)
    for number, (part, depth) in enumerate(zip(tiles, found, strict=True)):
        rows = rows_of(part.lattice, lattice)[part.inside]
        for name, whole in values.items():
            whole[rows] = getattr(depth, name)[part.inside]
        _paste(surface, depth.surface, part, spacing, finer)
        for name, share in depth.saved.items():
            saved[name] = saved.get(name, 0.0) + share * len(rows) / len(lattice)
        step(number + 1, len(tiles))
    corner = first[0] - 0.5 * (1 - 1 / finer) * spacing
    fine = Surface(surface, (corner, corner), spacing / finer)
    return DepthMap(
        **values,
        surface=fine,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        saved=saved,
    )


def _paste(target: Singles, surface: Surface, part: LensTile, spacing: float, finer: int) -> None:
    """Copy the cells of a tile from its own surface.

    They are `spacing` [px] wide, with `finer` values each way.
    """
    values = surface.patch_size
    if round(spacing / surface.spacing) < finer:
        values = refine_grid(values, finer, TOLERANCE * part.lattice.pitch)
    rows, columns = values.shape
    u, v = (np.rint(part.corner / spacing).astype(int) * finer).tolist()
    # The grid begins at the border of the first pixel, as the tiles do.
    cells = np.ceil((np.array(part.core) + 0.5) / spacing) * finer
    left, top, right, bottom = np.minimum(cells, [np.inf, np.inf, *target.shape[::-1]]).astype(int)
    at_v = np.minimum(np.arange(top, bottom) - v, rows - 1)
    at_u = np.minimum(np.arange(left, right) - u, columns - 1)
    target[top:bottom, left:right] = values[at_v[:, None], at_u]
