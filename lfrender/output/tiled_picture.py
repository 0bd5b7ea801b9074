"""Picture files that are written tile by tile and appear whole: TIFF, BigTIFF and Zarr."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lfcal import OutputError
from lfcal.runtime.arrays import Array
from lfcal.runtime.output_file import atomic_write, output_errors

from ..runtime.types import Size
from .formats import TIFF_TILE, EmbeddedMetadata, tiff_tags, tiff_tiles

__all__ = ["TileWriter", "move_into_place"]


def move_into_place(made: Path, output: Path) -> None:
    """Move a finished file or folder to its place on the same disk."""
    with output_errors(output):
        os.replace(made, output)


class TileWriter:
    """Writes a picture of `shape` (rows, columns, channels) in a folder beside its place.

    Zarr arrays have chunks of `side` (columns, rows). A TIFF has plain rows, which `finish` packs
    into deflated tiles if it is to `compress` them. `text` is the JSON text to store.
    """

    def __init__(
        self,
        path: Path,
        folder: Path,
        shape: tuple[int, ...],
        dtype: Any,
        side: Size,
        text: str,
        embedded: EmbeddedMetadata,
        compress: bool = False,
    ) -> None:
        self._is_zarr = path.suffix.lower() == ".zarr"
        self._shape = shape
        self._dtype = dtype
        self._side = side
        self._path = folder / ("picture.zarr" if self._is_zarr else "picture.tif")
        self._text = text
        self._compress = compress
        self._tags = tiff_tags(shape, text, embedded)

    def open(self, fresh: bool) -> bool:
        """Start an empty file, or continue that in the folder; returns whether there was one."""
        if fresh and self._path.exists():
            shutil.rmtree(self._path) if self._is_zarr else self._path.unlink()
        found = self._path.exists()
        if self._is_zarr:
            import zarr

            if not found:
                chunks = (*np.minimum(self._side[::-1], self._shape[:2]).tolist(), *self._shape[2:])
                zarr.create_array(
                    str(self._path),
                    shape=self._shape,
                    dtype=self._dtype,
                    chunks=chunks,
                    attributes={"description": self._text},
                )
            return found
        if not found:
            import tifffile

            tifffile.imwrite(self._path, shape=self._shape, dtype=self._dtype, **self._tags)
        return found

    def write(self, tile: tuple[int, int, int, int], pixels: Array) -> None:
        """Write the pixels of `left, top, right, bottom` to the disk, in any order of tiles."""
        left, top, right, bottom = tile
        if self._is_zarr:
            import zarr

            # Empty chunks are written too, so that a missing chunk is one that was lost.
            with zarr.config.set({"array.write_empty_chunks": True}):
                zarr.open_array(str(self._path), mode="r+")[top:bottom, left:right] = pixels
            return
        mapped = self._map()
        mapped[top:bottom, left:right] = pixels
        mapped.flush()

    def _map(self) -> np.memmap:
        """The pixels of the TIFF, mapped for one tile: mapped pixels count as memory."""
        import tifffile

        return np.asanyarray(tifffile.memmap(self._path))

    def finish(self, output: Path) -> None:
        """Move the picture to its place, over an earlier one."""
        made = self._path
        if self._is_zarr and output.exists():
            if not any((output / name).exists() for name in ("zarr.json", ".zarray", ".zgroup")):
                raise OutputError(
                    f"{output}: is there already and no Zarr array; give another output"
                )
            # Moved away in one step: a folder that is half removed would still be read as a
            # picture.
            earlier = self._path.with_name("earlier.zarr")
            shutil.rmtree(earlier, ignore_errors=True)
            move_into_place(output, earlier)
        elif self._compress:
            import tifffile

            # If the process is killed here, the next run finds and removes this file in the folder
            # of unfinished work.
            made = self._path.with_name("packed.tif")
            options = tiff_tiles(self._dtype) | self._tags
            with atomic_write(made) as temporary:
                tiles = self._tiles()
                tifffile.imwrite(temporary, tiles, shape=self._shape, dtype=self._dtype, **options)
        move_into_place(made, output)

    def _tiles(self) -> Iterator[Array]:
        """The tiles of the finished picture, row by row."""
        for top in range(0, self._shape[0], TIFF_TILE):
            band = np.array(self._map()[top : top + TIFF_TILE])
            for left in range(0, self._shape[1], TIFF_TILE):
                yield band[:, left : left + TIFF_TILE]
