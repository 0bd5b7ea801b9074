"""Pictures of flats too large for memory: drawn tile by tile into a file, with the same bits as
drawn as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lfcal import Calibration, FlatSource
from lfcal.runtime.arrays import Array, Booleans, Floats, Frozen

from ..data.depth_map import DepthMap
from ..data.rendering import Part, Rendering
from ..flat.validation import match_exposure
from ..output.formats import FORMATS, PictureError, check_format, check_package, read_metadata
from ..output.picture import describe, with_alpha, write_picture
from ..output.resume import Checkpoint, file_identity, fingerprint
from ..output.tiled_picture import TileWriter, move_into_place
from ..rendering.render import make_renderer
from ..rendering.renderer import Renderer
from ..runtime.choices import Detail
from ..runtime.types import AnyPath, Progress, Size
from ..sequence.workers import Workers, ahead
from .tiles import TileReader

__all__ = ["LargePicture", "check_large_picture", "render_large"]


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


def render_large(
    source: FlatSource,
    path: AnyPath,
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
    progress: Progress | None = None,
    client: Any = None,
    threads: int | None = None,
) -> LargePicture:
    """Draw a large flat into a file, tile by tile: the pixels are those of `render`, whatever the
    tiles.

    Finished tiles are kept in a hidden folder beside `path`, with which a run that was killed can
    be continued. The picture appears whole; errors are those of `render` and `write_picture`. TIFF
    and Zarr pictures need memory for one tile, others are held as a whole to be encoded.

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
    progress, client, threads
        As in `analyze_large`: tiles are drawn by the workers of a cluster, and written here.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal, lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/flat.tif", flat)
    ...     with lfcal.open_flat(f"{folder}/flat.tif") as source:
    ...         made = lfrender.render_large(source, f"{folder}/picture.tif", camera, depth, scale=6)
    >>> made.scale
    6.0
    """
    output = Path(path)
    reader = TileReader(source, calibration)
    check_large_picture(output, source.dtype, alpha)
    exposed = match_exposure(reader.sample_exposure(), calibration)
    renderer = make_renderer(reader.read, exposed, depth, patch_size, scale, blend, detail)
    grid = renderer.grid
    workers = Workers(client, threads)
    # For a cluster four tiles a thread, so that few threads are idle at the end.
    side = _tile_size(renderer, reader, tile, 1 if client is None else 4 * workers.count)
    text = describe(grid.affine(), settings)
    suffix = output.suffix.lower()
    channels = reader.channels + alpha
    shape = (*grid.size[::-1], channels) if channels > 1 else grid.size[::-1]
    # Of all that the picture depends on: tiles of an earlier run are used if it is the same.
    key = fingerprint(
        file_identity(source.path),
        file_identity(source.dark),
        [source.page, str(source.dtype)],
        calibration.to_dict(),
        [
            patch_size,
            grid.scale,
            renderer.blend,
            renderer.noise,
            *side,
            alpha,
            compress,
            suffix,
            text,
        ],
        *([] if depth is None else [depth.patch_size, depth.surface.patch_size]),
    )
    checkpoint = Checkpoint(output)
    direct = FORMATS[suffix].tiles
    writer = TileWriter(
        output if direct else output.with_suffix(".tif"),
        checkpoint.open(),
        shape,
        source.dtype,
        side,
        text,
        icc=read_metadata(source.path).icc,
        compress=compress and direct,
    )
    # Valid pixels of each finished tile. A killed run may have left the list of tiles without them.
    done: dict[str, int] = checkpoint.find("picture", key) or {}
    if not writer.open(fresh=not done):
        done = {}
        checkpoint.keep("picture", key, done)
    kept = len(done)
    parts = dict(enumerate(grid.tiles(side)))
    missing = {number: part for number, part in parts.items() if str(number) not in done}
    # A copy, without the tables that are cached in it: workers compute their own.
    drawn = workers.map(
        _draw_tile, _Drawing(replace(renderer), reader), missing.values(), _read_part
    )

    def store(tile: tuple[int, tuple[Array, Booleans]]) -> None:
        number, (pixels, valid) = tile
        pixels = pixels if reader.channels > 1 else pixels[:, :, 0]
        writer.write(parts[number], with_alpha(pixels, valid) if alpha else pixels)
        done[str(number)] = int(np.count_nonzero(valid))
        checkpoint.keep("picture", key, done)

    # Each tile is stored while the next one is drawn.
    for count, _ in enumerate(ahead(store, zip(missing, drawn, strict=True), 1), kept + 1):
        if progress is not None:
            progress(count, len(parts))
    if direct:
        writer.finish(output)
    else:
        _encode(writer, checkpoint.folder, output, renderer, settings, source, alpha)
    checkpoint.remove()
    valid_share = sum(done.values()) / (shape[0] * shape[1])
    return LargePicture(output, grid.size, grid.affine(), grid.scale, valid_share, len(parts), kept)


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


def check_large_picture(output: Path, dtype: Any, alpha: bool, inputs: Any = ()) -> None:
    """Raise an error if a picture could not be written; as `check_format`, but Zarr arrays may be
    replaced.
    """
    if output.suffix.lower() != ".zarr" or not output.is_dir():
        check_format(output, "picture", dtype=dtype, alpha=alpha, inputs=inputs)
        return
    check_package(output, FORMATS[".zarr"])
    if any(name is not None and output.samefile(name) for name in inputs):
        raise PictureError(f"{output}: is an input of this command; give another output")


def _tile_size(renderer: Renderer, reader: TileReader, tile: int | None, least: int) -> Size:
    """Columns and rows of the tiles: as given, or nearly square ones of a gigabyte, at least
    `least` of them.
    """
    columns, rows = renderer.grid.size
    if tile is not None:
        if tile < 1:
            raise ValueError(f"tile must be a positive number of pixels, got {tile}")
        return min(tile, columns), min(tile, rows)
    item = reader.dtype.itemsize * reader.channels
    spacing = renderer.grid.spacing
    # A pixel of the flat is in memory as read, for this tile and the next one, without vignetting,
    # and prepared for interpolation, and has an occlusion depth. A pixel of the picture is there as
    # computed, and as stored twice.
    bytes_each = spacing**2 * (4 * item + 6) + 4 * reader.channels + 4 + 2 * item
    one = renderer.required_part((columns // 2, rows // 2, columns // 2 + 1, rows // 2 + 1))
    side = max(int((2**30 / bytes_each) ** 0.5 - (one[2] - one[0]) / spacing), 64)
    if least > 1:
        # Smaller tiles for a cluster would be mostly halo.
        side = min(side, max(int(np.sqrt(columns * rows / least)), 512))
    across = -(-columns // side)
    down = -(-rows // side)
    return -(-columns // across), -(-rows // down)


def _encode(
    writer: TileWriter,
    folder: Path,
    output: Path,
    renderer: Renderer,
    settings: Mapping[str, Any] | None,
    source: FlatSource,
    alpha: bool,
) -> None:
    """Write the finished tiles as a picture of another format."""
    import tifffile

    whole = folder / "whole.tif"
    encoded = folder / f"encoded{output.suffix}"
    writer.finish(whole)
    pixels = tifffile.imread(whole)
    valid = np.ones(renderer.grid.size[::-1], bool)
    if alpha:
        valid = pixels[..., -1] > 0
        pixels = pixels[..., :3] if pixels.shape[2] > 2 else pixels[..., 0]
    picture = Rendering(pixels, renderer.grid.affine(), valid, renderer.scale)
    # Encoded into the hidden folder: if the process is killed, the next run removes the file.
    write_picture(
        encoded, picture, alpha=alpha, settings=settings, embedded=read_metadata(source.path)
    )
    move_into_place(encoded, output)
