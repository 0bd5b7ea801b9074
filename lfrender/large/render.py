"""Pictures of flats too large for memory: drawn tile by tile into a file, to the same bits as in one go."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatSource

from ..data.depth_map import DepthMap
from ..data.rendering import Rendering
from ..output.metadata import read_metadata
from ..output.picture import PictureError, check_picture, describe, with_alpha, write_picture
from ..output.resume import Checkpoint, file_identity, fingerprint
from ..output.tiled_picture import PartWriter, move_into_place, new_writer, written_in_parts
from ..rendering.plan import Drawing, Part
from ..rendering.render import drawing_of
from .flat_parts import PartReader
from .workers import ClusterWorkers, LocalWorkers, Workers

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["LargePicture", "render_large"]

# Bytes that the flat and the picture of a tile may take, all copies together.
_BUDGET = 4 << 28
# Tiles for each thread of a cluster, so that the last ones do not leave most of them idle; smaller ones [px] would be
# mostly halo.
_TILES_EACH, _LEAST_TILE = 4, 512
# What has been drawn is made safe on the disk at most so often [s].
_SYNC = 2.0


@dataclass(frozen=True)
class LargePicture:
    """A picture drawn into a file.

    Parameters
    ----------
    path : Path
    size : (int, int) [px]
        Columns and rows.
    affine : (2, 3) float64
        As `Rendering.affine`.
    scale : float
        Output pixels per pitch.
    valid : float
        Share of the pixels that at least one lens has seen.
    tiles, kept : int
        Number of tiles, and how many of them an earlier run had finished.
    """

    path: Path
    size: tuple[int, int]
    affine: NDArray[np.float64]
    scale: float
    valid: float
    tiles: int
    kept: int


def render_large(
    source: FlatSource,
    path: str | os.PathLike[str],
    calibration: Calibration,
    depth: DepthMap | None = None,
    *,
    patch_size: float | None = None,
    scale: float | None = None,
    blend: bool | None = None,
    tile: int | None = None,
    alpha: bool = False,
    compress: bool = False,
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
    client: Client | None = None,
    threads: int | None = None,
) -> LargePicture:
    """Draw a large flat into a file, tile by tile: the pixels are those of `render`, whatever the tiles.

    Finished tiles are kept in a hidden folder beside `path`; a run that was killed goes on from there. The picture
    appears whole. TIFF and Zarr pictures need memory for a tile alone, others are held as a whole to be encoded.

    Parameters
    ----------
    source : FlatSource
        From `lfcal.open_flat`.
    path : path-like
        `.tif`, `.zarr` (needs the package `zarr`), or any ending of `write_picture`.
    calibration, depth, patch_size, scale, blend
        As `render`, but that the depth must be given: `analyze_large` makes it.
    tile : int or None [px]
        Side of the tiles of the picture; None leaves it to the size of the flat.
    alpha, compress, settings
        As `write_picture`.
    progress : callable or None
        Called with the number of finished tiles and of all.
    client, threads
        As `analyze_large`: tiles are drawn by the workers of a cluster, and written here.

    Raises
    ------
    FlatError, CalibrationError, ValueError, OutputError, PictureError
        As `render` and `write_picture`.
    """
    output = Path(path)
    parts = PartReader(source, calibration)
    if depth is None and patch_size is None:
        raise ValueError("give depth (analyze_large makes it) or patch_size")
    check_large_picture(output, source.dtype, alpha)
    drawing = drawing_of(parts.read, calibration, depth, patch_size, scale, blend)
    workers = LocalWorkers(parts) if client is None else ClusterWorkers(client, source, threads)
    side = choose_tile_size(
        drawing, parts, tile, 1 if isinstance(workers, LocalWorkers) else _TILES_EACH * workers.count
    )
    text = describe(Rendering(np.empty(0), drawing.affine, np.empty(0, bool), drawing.scale), settings)
    channels = parts.channels + alpha
    shape = (*drawing.size[::-1], channels) if channels > 1 else drawing.size[::-1]
    depth_key = [patch_size] if depth is None else [fingerprint(depth.patch_size, depth.surface.patch_size)]
    key = fingerprint(
        file_identity(source.path), calibration.to_dict(), depth_key, drawing.scale, drawing.blend, drawing.blur, side,
        text, [alpha, compress, output.suffix.lower(), str(source.dtype)],
    )  # fmt: skip
    unfinished = Checkpoint(output)
    direct = written_in_parts(output)
    writer = new_writer(
        output if direct else output.with_suffix(".tif"), unfinished.open(), shape, source.dtype, side,
        json.dumps(text), icc=read_metadata(source.path).icc, compress=compress and direct,
    )  # fmt: skip
    run = _Run(drawing, parts, workers, writer, unfinished, key, alpha)
    kept, seen = run.all(list(drawing.tiles(side)), progress)
    if direct:
        writer.finish(output)
    else:
        _encode(writer, unfinished, output, drawing, settings, source)
    unfinished.remove()
    count = len(list(drawing.tiles(side)))
    valid = seen / (shape[0] * shape[1])
    return LargePicture(output, drawing.size, drawing.affine, drawing.scale, valid, count, kept)


def check_large_picture(output: Path, dtype: Any, alpha: bool, inputs: Any = ()) -> None:
    """Refuse a picture that could not be written."""
    if output.suffix.lower() != ".zarr":
        check_picture(output, dtype, alpha, inputs)
        return
    if not output.absolute().parent.is_dir():
        raise PictureError(f"{output}: the folder '{output.parent}' does not exist")
    if any(name is not None and Path(name).absolute() == output.absolute() for name in inputs):
        raise PictureError(f"{output}: is an input of this command; give another output")


def choose_tile_size(drawing: Drawing, parts: PartReader, tile: int | None, least: int = 1) -> tuple[int, int]:
    """Columns and rows of the tiles: as asked for, or nearly square ones that fit the memory, `least` or more."""
    columns, rows = drawing.size
    if tile is not None:
        if tile < 1:
            raise ValueError(f"tile must be a positive number of pixels, got {tile}")
        return min(tile, columns), min(tile, rows)
    item = parts.source.dtype.itemsize * parts.channels
    # Pixels of the flat are there as read for this tile and the next one, evened, and made ready to read; with what
    # hides them. Those of the picture are there as computed, and as stored twice.
    flat_bytes = 4 * item + 6
    picture_bytes = 4 * parts.channels + 4 + 2 * item
    halo = 2 * drawing.halo
    spacing = drawing.spacing
    side = 64
    while (side * 1.1 * spacing + halo) ** 2 * flat_bytes + (side * 1.1) ** 2 * picture_bytes < _BUDGET:
        side = int(side * 1.1) + 1
    shared = int(np.sqrt(columns * rows / least))
    side = min(side, max(shared, _LEAST_TILE)) if least > 1 else side
    across, down = -(-columns // side), -(-rows // side)
    return -(-columns // across), -(-rows // down)


class _Run:
    """Tiles being drawn, written and remembered."""

    def __init__(
        self, drawing: Drawing, parts: PartReader, workers: Workers, writer: PartWriter, unfinished: Checkpoint,
        key: str, alpha: bool,
    ) -> None:  # fmt: skip
        self.drawing, self.parts, self.workers, self.writer = drawing, parts, workers, writer
        self.unfinished, self.key, self.alpha = unfinished, key, alpha

    def all(self, tiles: list[Part], progress: Callable[[int, int], None] | None) -> tuple[int, int]:
        """Draw the tiles that are missing; how many were not, and how many pixels some lens has seen."""
        found = self.unfinished.find("picture", self.key)
        # A run that was killed as it cleaned up may have left its notes alone.
        if not self.writer.open(fresh=found is None):
            found = None
        done: dict[str, int] = dict(found) if found else {}
        if found is None:
            self.unfinished.keep("picture", self.key, {})
        kept = len(done)
        left = [number for number in range(len(tiles)) if str(number) not in done]
        last = monotonic()
        waiting: Future[None] | None = None
        with ThreadPoolExecutor(1) as pool:
            for number, image, valid in self._drawn(tiles, left):
                if waiting is not None:
                    waiting.result()
                waiting = pool.submit(self._store, tiles[number], image, valid)
                done[str(number)] = int(np.count_nonzero(valid))
                if progress is not None:
                    progress(len(done), len(tiles))
                if monotonic() - last > _SYNC:
                    waiting.result()
                    self.writer.sync()
                    self.unfinished.keep("picture", self.key, done)
                    last = monotonic()
            if waiting is not None:
                waiting.result()
        return kept, sum(done.values())

    def _drawn(self, tiles: list[Part], numbers: list[int]) -> Iterator[tuple[int, NDArray, NDArray[np.bool_]]]:
        some = [tiles[number] for number in numbers]
        found = self.workers.each(_drawn, replace(self.drawing), some, map(self.drawing.needed, some))
        for number, (image, valid) in zip(numbers, found, strict=True):
            yield number, image, valid

    def _store(self, tile: Part, image: NDArray[Any], valid: NDArray[np.bool_]) -> None:
        pixels = image if self.parts.colour else image[:, :, 0]
        self.writer.write(tile, with_alpha(pixels, valid) if self.alpha else pixels)


def _drawn(drawing: Drawing, tile: Part, pixels: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """A tile of the picture from the part of the flat that it needs."""
    return drawing.draw(pixels, drawing.needed(tile)[:2], tile, stored=True)


def _encode(
    writer: PartWriter,
    unfinished: Checkpoint,
    output: Path,
    drawing: Drawing,
    settings: Mapping[str, Any] | None,
    source: FlatSource,
) -> None:
    """Write the finished tiles as a picture of another format."""
    import tifffile

    whole = unfinished.folder / "whole.tif"
    writer.finish(whole)
    pixels = tifffile.memmap(whole)
    alpha = pixels.ndim == 3 and pixels.shape[2] in (2, 4)
    colours = pixels[..., 0] if alpha and pixels.shape[2] == 2 else pixels[..., :3] if alpha else pixels
    valid = pixels[..., -1] > 0 if alpha else np.ones(pixels.shape[:2], bool)
    picture = Rendering(np.asarray(colours), drawing.affine, valid, drawing.scale)
    # In there it is removed by the next run if this one is killed.
    encoded = unfinished.folder / f"encoded{output.suffix}"
    write_picture(encoded, picture, alpha=alpha, settings=settings, embedded=read_metadata(source.path))
    move_into_place(encoded, output)
