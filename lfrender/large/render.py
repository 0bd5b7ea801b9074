"""Pictures of flats too large for memory: drawn tile by tile into a file, with the same bits as drawn as a whole."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatSource

from ..data.depth_map import DepthMap
from ..data.rendering import Part, Rendering
from ..detail.draw import DetailRenderer
from ..flat.validation import match_exposure
from ..output.formats import FORMATS, PictureError, check_package
from ..output.metadata import read_metadata
from ..output.picture import check_picture, describe, with_alpha, write_picture
from ..output.resume import Checkpoint, file_identity, fingerprint
from ..output.tiled_picture import TileWriter, move_into_place, new_writer
from ..rendering.render import Detail, make_renderer
from ..rendering.renderer import Renderer
from .settings import DEFAULT, LargeSettings
from .tiles import TileReader
from .workers import Workers, choose_workers

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["LargePicture", "check_large_picture", "render_large"]


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

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/flat.tif", flat)
    ...     with lfcal.open_flat(f"{folder}/flat.tif") as source:
    ...         made = lfrender.render_large(source, f"{folder}/picture.tif", camera, patch_size=-7.0, scale=6)
    >>> made.scale
    6.0
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
    detail: Detail | None = None,
    tile: int | None = None,
    alpha: bool = False,
    compress: bool = False,
    settings: Mapping[str, Any] | None = None,
    progress: Callable[[int, int], None] | None = None,
    client: Client | None = None,
    threads: int | None = None,
    tuning: LargeSettings = DEFAULT,
) -> LargePicture:
    """Draw a large flat into a file, tile by tile: the pixels are those of `render`, whatever the tiles.

    Finished tiles are kept in a hidden folder beside `path`, with which a run that was killed can be continued. The
    picture appears whole. TIFF and Zarr pictures need memory for one tile, others are held as a whole to be encoded.

    Parameters
    ----------
    source : FlatSource
        From `lfcal.open_flat`.
    path : path-like
        `.tif`, `.zarr` (needs the package `zarr`), or any suffix of `write_picture`.
    calibration, depth, patch_size, scale, blend, detail
        As in `render`, except that the depth is not analysed here: `analyze_large` makes it.
    tile : int or None [px]
        Side of the tiles of the picture; None chooses it by the size of the flat.
    alpha, compress, settings
        As in `write_picture`.
    progress : callable or None
        Called with the number of finished tiles and of all.
    client, threads
        As in `analyze_large`: tiles are drawn by the workers of a cluster, and written here.
    tuning : LargeSettings

    Raises
    ------
    FlatError, CalibrationError, ValueError, OutputError, PictureError
        As `render` and `write_picture`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/flat.tif", flat)
    ...     with lfcal.open_flat(f"{folder}/flat.tif") as source:
    ...         made = lfrender.render_large(source, f"{folder}/picture.tif", camera, depth, scale=6)
    >>> made.scale
    6.0
    """
    output = Path(path)
    reader = TileReader(source, calibration)
    if depth is None and patch_size is None:
        raise ValueError("give depth (analyze_large makes it) or patch_size")
    check_large_picture(output, source.dtype, alpha)
    exposed = match_exposure(reader.sample_exposure(), calibration)
    drawing = make_renderer(reader.read, exposed, depth, patch_size, scale, blend, detail)
    workers = choose_workers(reader, client, threads, tuning)
    side = _tile_size(drawing, reader, tile, 1 if client is None else tuning.tiles_per_thread * workers.count, tuning)
    text = describe(Rendering(np.empty(0), drawing.grid.affine(), np.empty(0, bool), drawing.grid.scale), settings)
    channels = reader.channels + alpha
    shape = (*drawing.grid.size[::-1], channels) if channels > 1 else drawing.grid.size[::-1]
    depth_key = [patch_size] if depth is None else [fingerprint(depth.patch_size, depth.surface.patch_size)]
    # Tiles of an earlier run are used if all that the picture depends on is the same.
    key = fingerprint(
        file_identity(source.path), [source.page], file_identity(source.dark), calibration.to_dict(), depth_key,
        drawing.grid.scale, patch_size is None if blend is None else blend,
        [drawing.noise if isinstance(drawing, DetailRenderer) else None], side,
        text, [alpha, compress, output.suffix.lower(), str(source.dtype)],
    )  # fmt: skip
    checkpoint = Checkpoint(output)
    direct = FORMATS[output.suffix.lower()].tiles
    writer = new_writer(
        output if direct else output.with_suffix(".tif"), checkpoint.open(), shape, source.dtype, side,
        json.dumps(text), icc=read_metadata(source.path).icc, compress=compress and direct,
    )  # fmt: skip
    run = _Run(drawing, reader, workers, writer, checkpoint, key, alpha, tuning.sync_seconds)
    tiles = list(drawing.grid.tiles(side))
    kept, seen = run.draw_missing(tiles, progress)
    if direct:
        writer.finish(output)
    else:
        _encode(writer, checkpoint, output, drawing, settings, source)
    checkpoint.remove()
    valid = seen / (shape[0] * shape[1])
    return LargePicture(output, drawing.grid.size, drawing.grid.affine(), drawing.grid.scale, valid, len(tiles), kept)


def check_large_picture(output: Path, dtype: Any, alpha: bool, inputs: Any = ()) -> None:
    """Raise an error if a picture could not be written; as `check_picture`, but Zarr arrays are accepted too."""
    if output.suffix.lower() != ".zarr":
        check_picture(output, dtype, alpha, inputs)
        return
    check_package(output, FORMATS[".zarr"])
    if not output.absolute().parent.is_dir():
        raise PictureError(f"{output}: the folder '{output.parent}' does not exist")
    if any(name is not None and Path(name).absolute() == output.absolute() for name in inputs):
        raise PictureError(f"{output}: is an input of this command; give another output")


def _tile_size(
    drawing: Renderer | DetailRenderer, reader: TileReader, tile: int | None, least: int, tuning: LargeSettings
) -> tuple[int, int]:
    """Columns and rows of the tiles: as given, or nearly square ones that fit the memory, at least `least` of them."""
    columns, rows = drawing.grid.size
    if tile is not None:
        if tile < 1:
            raise ValueError(f"tile must be a positive number of pixels, got {tile}")
        return min(tile, columns), min(tile, rows)
    item = reader.source.dtype.itemsize * reader.channels
    # A pixel of the flat is in memory as read, for this tile and the next one, without vignetting, and prepared for
    # interpolation, and has an occlusion depth. A pixel of the picture is there as computed, and as stored twice.
    flat_bytes = 4 * item + 6
    picture_bytes = 4 * reader.channels + 4 + 2 * item
    one = drawing.required_part((columns // 2, rows // 2, columns // 2 + 1, rows // 2 + 1))
    halo, spacing = max(one[2] - one[0], one[3] - one[1]), drawing.grid.spacing
    side = 64
    while (side * 1.1 * spacing + halo) ** 2 * flat_bytes + (side * 1.1) ** 2 * picture_bytes < tuning.picture_memory:
        side = int(side * 1.1) + 1
    if least > 1:
        side = min(side, max(int(np.sqrt(columns * rows / least)), tuning.least_tile))
    across, down = -(-columns // side), -(-rows // side)
    return -(-columns // across), -(-rows // down)


@dataclass(frozen=True)
class _Run:
    """Draws tiles, writes them, and notes in the checkpoint which ones are finished."""

    drawing: Renderer | DetailRenderer
    reader: TileReader
    workers: Workers
    writer: TileWriter
    checkpoint: Checkpoint
    key: str
    alpha: bool
    sync_seconds: float

    def draw_missing(self, tiles: list[Part], progress: Callable[[int, int], None] | None) -> tuple[int, int]:
        """Draw the missing tiles; returns how many were there already, and how many pixels are valid in all."""
        found = self.checkpoint.find("picture", self.key)
        # A run that was killed while it removed its files may have left the list of finished tiles alone.
        if not self.writer.open(fresh=found is None):
            found = None
        done: dict[str, int] = dict(found) if found else {}
        if found is None:
            self.checkpoint.keep("picture", self.key, {})
        kept = len(done)
        numbers = [number for number in range(len(tiles)) if str(number) not in done]
        missing = [tiles[number] for number in numbers]
        # A copy is shared, without the tables that this drawing has cached: workers compute their own.
        drawn = self.workers.map(_draw_tile, replace(self.drawing), missing, map(self.drawing.required_part, missing))
        last = monotonic()
        waiting: Future[None] | None = None
        # A tile is written while the next one is drawn.
        with ThreadPoolExecutor(1) as pool:
            for number, (image, valid) in zip(numbers, drawn, strict=True):
                if waiting is not None:
                    waiting.result()
                waiting = pool.submit(self._store, tiles[number], image, valid)
                done[str(number)] = int(np.count_nonzero(valid))
                if progress is not None:
                    progress(len(done), len(tiles))
                if monotonic() - last > self.sync_seconds:
                    waiting.result()
                    self.writer.sync()
                    self.checkpoint.keep("picture", self.key, done)
                    last = monotonic()
            if waiting is not None:
                waiting.result()
        return kept, sum(done.values())

    def _store(self, tile: Part, image: NDArray[Any], valid: NDArray[np.bool_]) -> None:
        pixels = image if self.reader.channels > 1 else image[:, :, 0]
        self.writer.write(tile, with_alpha(pixels, valid) if self.alpha else pixels)


def _draw_tile(
    drawing: Renderer | DetailRenderer, tile: Part, pixels: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """A tile of the picture from the part of the flat that it needs."""
    return drawing.draw(pixels, drawing.required_part(tile)[:2], tile, pixels.dtype)


def _encode(
    writer: TileWriter,
    checkpoint: Checkpoint,
    output: Path,
    drawing: Renderer | DetailRenderer,
    settings: Mapping[str, Any] | None,
    source: FlatSource,
) -> None:
    """Write the finished tiles as a picture of another format."""
    import tifffile

    whole = checkpoint.folder / "whole.tif"
    writer.finish(whole)
    pixels = tifffile.memmap(whole)
    alpha = pixels.ndim == 3 and pixels.shape[2] in (2, 4)
    colours = pixels[..., 0] if alpha and pixels.shape[2] == 2 else pixels[..., :3] if alpha else pixels
    valid = pixels[..., -1] > 0 if alpha else np.ones(pixels.shape[:2], bool)
    picture = Rendering(np.asarray(colours), drawing.grid.affine(), valid, drawing.grid.scale)
    # Encoded into the hidden folder: if the process is killed, the next run removes the file.
    encoded = checkpoint.folder / f"encoded{output.suffix}"
    write_picture(encoded, picture, alpha=alpha, settings=settings, embedded=read_metadata(source.path))
    move_into_place(encoded, output)
