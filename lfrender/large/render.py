"""Pictures of flats too large for memory, drawn tile by tile with the bits of the whole picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lfcal import Calibration, FlatSource
from lfcal.runtime.arrays import Array, Booleans, Floats, Frozen
from lfcal.runtime.light.tone import is_encoded
from lfcal.runtime.output_file import claim
from lfcal.runtime.progress import Progress, show_progress

from ..data.depth_map import DepthMap
from ..data.rendering import Part, finish_picture
from ..flat.validation import match_exposure
from ..output.formats import (
    FORMATS,
    check_format,
    check_format_package,
    read_metadata,
)
from ..output.picture import describe, with_alpha, write_picture
from ..output.resume import Checkpoint
from ..output.tiled_picture import TileWriter, move_into_place
from ..rendering.render import make_renderer
from ..rendering.renderer import Renderer
from ..runtime.choices import Detail
from ..runtime.types import AnyPath, Size
from ..sequence.workers import Workers, ahead
from .tiles import TileReader

__all__ = ["LargeOptions", "LargePicture", "check_large_picture", "render_large"]

# Tiles of a picture for each thread of a cluster, so that few threads are idle at the end.
_TILES_PER_THREAD = 4
# Memory for a tile while it is drawn [bytes], and its least side [px]: smaller ones are mostly
# halo, the more so if a cluster draws many tiles at once.
_TILE_MEMORY = 2**30
_LEAST_SIDE = 64
_LEAST_SIDE_ON_CLUSTER = 512


@dataclass(frozen=True, eq=False)
class LargePicture(Frozen):
    """A picture drawn into a file, from `render_large`, which has an example.

    Examples
    --------
    >>> LargePicture(Path("picture.tif"), (620, 470), np.eye(2, 3), 6.0, 1.0, tiles=4, kept=3).tiles
    4
    """

    path: Path
    size: Size  # columns and rows [px]
    affine: Floats  # (2, 3), as `Rendering.affine`
    scale: float  # output pixels per pitch
    valid: float  # share of the pixels that at least one lens has seen
    tiles: int  # number of tiles ...
    kept: int  # ... and how many of them an earlier run had finished


@dataclass(frozen=True)
class LargeOptions:
    """Options of `render_large`, which also takes each of them as a keyword.

    Parameters
    ----------
    patch_size, scale, blend, detail
        As in `render`.
    tile : int or None [px]
        Side of the tiles of the picture. None chooses it by the size of the flat.
    alpha, compress, quality, settings
        As in `write_picture`.

    Examples
    --------
    >>> from lfrender.large.render import LargeOptions
    >>> LargeOptions(patch_size=6.5, tile=512).alpha
    False
    """

    patch_size: float | None = None
    scale: float | None = None
    blend: bool | None = None
    detail: Detail | None = None
    tile: int | None = None
    alpha: bool = False
    compress: bool = False
    quality: int | None = None
    settings: Mapping[str, Any] | None = None


def render_large(
    source: FlatSource,
    path: AnyPath,
    calibration: Calibration,
    depth: DepthMap | None = None,
    options: LargeOptions | None = None,
    *,
    progress: Progress = None,
    client: Any = None,
    threads: int | None = None,
    **given: Any,
) -> LargePicture:
    """Draw a large flat into a file tile by tile; the pixels are those of `render`.

    Finished tiles are kept in a hidden folder beside `path`, from which a killed run is continued.
    The picture appears when it is complete. Errors are those of `render` and `write_picture`. TIFF
    and Zarr pictures need memory for one tile; other formats are held in memory to be encoded.

    Parameters
    ----------
    source : FlatSource
        From `lfcal.open_flat`.
    path : path-like
        `.tif`, `.zarr` (needs the package `zarr`), or any suffix of `write_picture`.
    calibration, depth
        As in `render`, but the depth is not analysed here: `analyze_large` makes it.
    options : LargeOptions, optional
        What is drawn, and how it is written.
    progress, client, threads
        As in `analyze_large`. Workers of a cluster draw tiles, this process writes them.
    **given
        Single fields of `LargeOptions`, such as `scale=6`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal, lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/flat.tif", flat)
    ...     picture = f"{folder}/picture.tif"
    ...     with lfcal.open_flat(f"{folder}/flat.tif") as source:
    ...         made = lfrender.render_large(source, picture, camera, depth, scale=6)
    >>> made.scale
    6.0
    """
    output = Path(path)
    chosen = replace(options or LargeOptions(), **given)
    reader = TileReader(source, calibration)
    check_large_picture(output, source.dtype, alpha=chosen.alpha, quality=chosen.quality)
    workers = Workers(client, threads)
    least = 1
    if client is not None:
        least = _TILES_PER_THREAD * workers.count
    with claim(output):
        return _draw(source, output, reader, depth, chosen, workers, least, progress)


def _draw(
    source: FlatSource,
    output: Path,
    reader: TileReader,
    depth: DepthMap | None,
    chosen: LargeOptions,
    workers: Workers,
    least: int,
    progress: Progress,
) -> LargePicture:
    """Draw the picture into an output that is claimed, in at least so many tiles."""
    alpha = chosen.alpha
    calibration = reader.calibration
    exposed = match_exposure(reader.sample_exposure(), calibration)
    drawn_as = (chosen.patch_size, chosen.scale, chosen.blend, chosen.detail)
    renderer = make_renderer(reader.read, exposed, depth, *drawn_as)
    grid = renderer.grid
    side = _tile_size(renderer, reader, chosen.tile, least)
    encoded = is_encoded(source.dtype, calibration.encoded)
    about = {**(chosen.settings or {}), "tone": "srgb" if encoded else "linear"}
    text = describe(grid.affine(), about)
    # Tiles of an earlier run are used if all that the picture depends on is the same.
    known = {"tile": side, "scale": grid.scale, "blend": renderer.blend, "settings": text}
    checkpoint = Checkpoint(
        output,
        "picture",
        source.path,
        source.dark,
        [source.page, str(source.dtype), renderer.noise, output.suffix.lower()],
        calibration.to_dict(),
        vars(replace(chosen, settings=None)) | known,
        *([] if depth is None else [depth.patch_size, depth.surface.patch_size]),
    )
    direct = FORMATS[output.suffix.lower()].tiles
    channels = reader.channels + alpha
    writer = TileWriter(
        output if direct else output.with_suffix(".tif"),
        checkpoint.open(),
        (*grid.size[::-1], channels)[: 3 if channels > 1 else 2],
        source.dtype,
        side,
        text,
        read_metadata(source.path)._replace(encoded=encoded),
        compress=chosen.compress and direct,
    )
    # Number of valid pixels of each finished tile. A killed run may have left it without the tiles.
    done: dict[str, int] = checkpoint.found or {}
    if not writer.open(fresh=not done):
        done = {}
        checkpoint.keep(done)
    kept = len(done)
    parts = dict(enumerate(grid.tiles(side)))
    missing = {number: part for number, part in parts.items() if str(number) not in done}
    # A copy, without the tables that are cached in it: workers compute their own.
    drawing = _Drawing(replace(renderer), reader)
    drawn = workers.map(_draw_tile, drawing, missing.values(), _read_part)

    def store(tile: tuple[int, tuple[Array, Booleans]]) -> None:
        number, (pixels, valid) = tile
        if reader.channels == 1:
            pixels = pixels[:, :, 0]
        if alpha:
            pixels = with_alpha(pixels, valid)
        writer.write(parts[number], pixels)
        done[str(number)] = int(np.count_nonzero(valid))
        checkpoint.keep(done)

    # Each tile is stored while the next one is drawn.
    with show_progress(progress, "tiles") as step:
        for count, _ in enumerate(ahead(store, zip(missing, drawn, strict=True), 1), kept + 1):
            step(count, len(parts))
    if direct:
        writer.finish(output)
    else:
        drawn_with = (calibration, renderer, chosen, source)
        _encode(writer, checkpoint.folder, output, *drawn_with)
    checkpoint.remove()
    columns, rows = grid.size
    share = sum(done.values()) / (rows * columns)
    return LargePicture(output, grid.size, grid.affine(), grid.scale, share, len(parts), kept)


class _Drawing(NamedTuple):
    """What workers need to draw a tile."""

    renderer: Renderer
    reader: TileReader


def _read_part(drawing: _Drawing, tile: Part) -> Array:
    return drawing.reader.read_raw(drawing.renderer.required_part(tile))


def _draw_tile(drawing: _Drawing, tile: Part, raw: Array) -> tuple[Array, Booleans]:
    part = drawing.renderer.required_part(tile)
    return drawing.renderer.draw(
        drawing.reader.read(part, raw), part[:2], tile, drawing.reader.dtype
    )


def check_large_picture(output: Path, dtype: Any, **needed: Any) -> None:
    """Raise the errors of `check_format`, but allow that a Zarr array is replaced."""
    if output.suffix.lower() != ".zarr" or not output.is_dir():
        check_format(output, "picture", dtype=dtype, **needed)
        return
    check_format_package(output, FORMATS[".zarr"])


def _tile_size(renderer: Renderer, reader: TileReader, tile: int | None, least: int) -> Size:
    """Columns and rows of the tiles: as given, or nearly square, and at least `least` tiles."""
    columns, rows = renderer.grid.size
    if tile is not None:
        if tile < 1:
            raise ValueError(f"tile must be a positive number of pixels, got {tile}")
        return min(tile, columns), min(tile, rows)
    item = reader.dtype.itemsize * reader.channels
    spacing = renderer.grid.spacing
    # Memory of a pixel of the flat: as read (this tile and the next one), without vignetting,
    # prepared for interpolation, and its occlusion depth. Memory of a pixel of the picture: as
    # computed, and as stored twice.
    bytes_each = spacing**2 * (4 * item + 6) + 4 * reader.channels + 4 + 2 * item
    one = renderer.required_part((columns // 2, rows // 2, columns // 2 + 1, rows // 2 + 1))
    halo = (one[2] - one[0]) / spacing
    side = max(int((_TILE_MEMORY / bytes_each) ** 0.5 - halo), _LEAST_SIDE)
    if least > 1:
        side = min(side, max(int(np.sqrt(columns * rows / least)), _LEAST_SIDE_ON_CLUSTER))
    across = -(-columns // side)
    down = -(-rows // side)
    return -(-columns // across), -(-rows // down)


def _encode(
    writer: TileWriter,
    folder: Path,
    output: Path,
    calibration: Calibration,
    renderer: Renderer,
    options: LargeOptions,
    source: FlatSource,
) -> None:
    """Write the finished tiles as a picture of another format."""
    import tifffile

    whole = folder / "whole.tif"
    encoded = folder / f"encoded{output.suffix}"
    writer.finish(whole)
    pixels = tifffile.imread(whole)
    valid = np.ones(renderer.grid.size[::-1], bool)
    if options.alpha:
        valid = pixels[..., -1] > 0
        pixels = pixels[..., :3] if pixels.shape[2] > 2 else pixels[..., 0]
    affine = renderer.grid.affine()
    picture = finish_picture(pixels, valid, affine, renderer.scale, pixels, calibration)
    # Encoded into the hidden folder: if the process is killed, the next run removes the file.
    embedded = read_metadata(source.path)
    stored = {name: getattr(options, name) for name in ("alpha", "quality", "settings")}
    write_picture(encoded, picture, embedded=embedded, **stored)
    move_into_place(encoded, output)
