"""Picture files that are written tile by tile and appear whole: TIFF, BigTIFF and Zarr."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import OutputError
from lfcal.runtime.output_file import atomic_write

from .formats import tiff_tags, tiff_tiles

__all__ = ["TileWriter", "move_into_place", "new_writer"]


def move_into_place(made: Path, output: Path) -> None:
    """Move a finished file or folder to its place on the same disk."""
    try:
        os.replace(made, output)
    except OSError as error:
        raise OutputError(f"{output}: cannot be written ({error.strerror or error})") from error


def new_writer(
    path: Path, folder: Path, shape: tuple[int, ...], dtype: Any, side: tuple[int, int], description: str,
    **options: Any,
) -> TileWriter:  # fmt: skip
    """The writer for the suffix of `path`.

    It works in `folder`, beside the output. `shape` is rows, columns and channels of the picture, `side` columns and
    rows of a tile, `description` the JSON text to store; `icc : bytes` and `compress : bool` are options of TIFF files.
    """
    if path.suffix.lower() == ".zarr":
        return _ZarrWriter(folder / "picture.zarr", shape, dtype, side, description)
    return _TiffWriter(folder / "picture.tif", shape, dtype, description, **options)


class _TiffWriter:
    """Writes rows of pixels to their places in an uncompressed TIFF; `finish` makes deflated tiles of them."""

    def __init__(
        self, path: Path, shape: tuple[int, ...], dtype: Any, description: str, icc: bytes = b"", compress: bool = False
    ) -> None:
        self._path, self._shape, self._dtype, self._compress = path, shape, np.dtype(dtype), compress
        self._tags = tiff_tags(shape, description, icc)
        self._file: Any = None
        self._start = 0

    def open(self, fresh: bool) -> bool:
        """Start with an empty file, or continue the one in the folder; returns whether there was one to continue."""
        import tifffile

        found = not fresh and self._path.exists()
        if not found:
            tifffile.imwrite(self._path, shape=self._shape, dtype=self._dtype, **self._tags)
        with tifffile.TiffFile(self._path) as tiff:
            self._start = tiff.pages[0].dataoffsets[0]
        self._file = open(self._path, "r+b", buffering=0)  # noqa: SIM115 (closed by `finish`)
        return found

    def write(self, tile: tuple[int, int, int, int], pixels: NDArray[Any]) -> None:
        """Write the pixels of `left, top, right, bottom`, safe on the disk; tiles come in any order."""
        left, top, right, _ = tile
        pixel = self._dtype.itemsize * int(np.prod(self._shape[2:]))
        row = self._shape[1] * pixel
        whole_rows = right - left == self._shape[1]
        for number, some in enumerate([pixels] if whole_rows else pixels):
            self._file.seek(self._start + (top + number) * row + left * pixel)
            view = np.ascontiguousarray(some).reshape(-1).view(np.uint8).data
            while len(view):
                view = view[self._file.write(view) :]
        os.fsync(self._file.fileno())

    def finish(self, output: Path) -> None:
        """Move the picture to its place, over an earlier one."""
        self._file.close()
        made = self._path
        if self._compress:
            import tifffile

            # If the process is killed here, the next run finds and removes this file in the folder of unfinished work.
            made = self._path.with_name("packed.tif")
            options = tiff_tiles(self._dtype) | self._tags
            with atomic_write(made) as temporary:
                tiles = self._tiles(options["tile"][0])
                tifffile.imwrite(temporary, tiles, shape=self._shape, dtype=self._dtype, **options)
        move_into_place(made, output)

    def _tiles(self, side: int) -> Any:
        """The tiles of the finished picture, row by row."""
        row = int(np.prod(self._shape[1:]))
        for top in range(0, self._shape[0], side):
            rows = min(side, self._shape[0] - top)
            offset = self._start + top * row * self._dtype.itemsize
            band = np.fromfile(self._path, self._dtype, rows * row, offset=offset).reshape(rows, *self._shape[1:])
            for left in range(0, self._shape[1], side):
                yield band[:, left : left + side]


class _ZarrWriter:
    """Writes each tile as a chunk of a Zarr array."""

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: Any, side: tuple[int, int], description: str) -> None:
        self._path, self._shape, self._dtype, self._description = path, shape, dtype, description
        self._chunks = (min(side[1], shape[0]), min(side[0], shape[1]), *shape[2:])
        self._array: Any = None

    def open(self, fresh: bool) -> bool:
        import zarr

        if fresh:
            shutil.rmtree(self._path, ignore_errors=True)
        found = self._path.exists()
        # Empty chunks are written too, so that a missing chunk is one that was lost.
        with zarr.config.set({"array.write_empty_chunks": True}):
            if found:
                self._array = zarr.open_array(str(self._path), mode="r+")
            else:
                self._array = zarr.create_array(
                    str(self._path), shape=self._shape, dtype=self._dtype, chunks=self._chunks,
                    attributes={"description": self._description},
                )  # fmt: skip
        return found

    def write(self, tile: tuple[int, int, int, int], pixels: NDArray[Any]) -> None:
        left, top, right, bottom = tile
        self._array[top:bottom, left:right] = pixels

    def finish(self, output: Path) -> None:
        if output.exists() and not any((output / name).exists() for name in ("zarr.json", ".zarray", ".zgroup")):
            raise OutputError(f"{output}: is there already and no Zarr array; give another output")
        # The earlier array is moved away in one step: a folder that is half removed would still be read as a picture.
        if output.exists():
            earlier = self._path.with_name("earlier.zarr")
            shutil.rmtree(earlier, ignore_errors=True)
            move_into_place(output, earlier)
        move_into_place(self._path, output)


TileWriter = _TiffWriter | _ZarrWriter
