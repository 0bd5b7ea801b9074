"""Picture files that are written part by part and appear whole: TIFF, BigTIFF and Zarr."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfcal import OutputError
from lfcal.runtime.output_file import atomic_write

from .picture import PictureError, tiff_tags

__all__ = ["PartWriter", "move_into_place", "new_writer", "written_in_parts"]

_TILE = 256


def written_in_parts(path: Path) -> bool:
    """Whether pictures with such an ending can be written part by part."""
    return path.suffix.lower() in (".tif", ".tiff", ".zarr")


def move_into_place(made: Path, output: Path) -> None:
    """Move what is whole to where it belongs, which is on the same disk."""
    try:
        os.replace(made, output)
    except OSError as error:
        raise OutputError(f"{output}: cannot be written ({error.strerror or error})") from error


class PartWriter(Protocol):
    """Writes the parts of one picture, any in any order, into a folder of unfinished work."""

    def open(self, fresh: bool) -> bool:
        """Begin anew, or go on with what is in the folder; whether there was something to go on with."""

    def write(self, part: tuple[int, int, int, int], pixels: NDArray[Any]) -> None:
        """Write the pixels of `left, top, right, bottom`."""

    def sync(self) -> None:
        """Have the disk hold what was written."""

    def finish(self, output: Path) -> None:
        """Move the picture to where it belongs, over an earlier one."""


def new_writer(
    path: Path,
    folder: Path,
    shape: tuple[int, ...],
    dtype: Any,
    side: tuple[int, int],
    description: str,
    **options: Any,
) -> PartWriter:
    """The writer for the ending of `path`.

    Parameters
    ----------
    path, folder : Path
        The output, and the folder to work in, beside it.
    shape : (int, int) or (int, int, int)
        Rows, columns and channels of the picture.
    dtype : dtype
    side : (int, int) [px]
        Columns and rows of a part.
    description : str
        JSON text to store.
    options : icc : bytes, compress : bool
    """
    if path.suffix.lower() == ".zarr":
        return _ZarrWriter(folder / "picture.zarr", shape, dtype, side, description)
    return _TiffWriter(folder / "picture.tif", shape, dtype, description, **options)


class _TiffWriter:
    """Rows of a TIFF without compression, at their places; deflated tiles are made of them at the end."""

    def __init__(
        self, path: Path, shape: tuple[int, ...], dtype: Any, description: str, icc: bytes = b"", compress: bool = False
    ) -> None:
        self._path, self._shape, self._dtype, self._compress = path, shape, np.dtype(dtype), compress
        self._tags = tiff_tags(shape, description, icc)
        self._file: Any = None
        self._start = 0

    def open(self, fresh: bool) -> bool:
        import tifffile

        found = not fresh and self._path.exists()
        if not found:
            tifffile.imwrite(self._path, shape=self._shape, dtype=self._dtype, **self._tags)
        with tifffile.TiffFile(self._path) as tiff:
            self._start = tiff.pages[0].dataoffsets[0]
        self._file = open(self._path, "r+b", buffering=0)  # noqa: SIM115 (closed at the end)
        return found

    def write(self, part: tuple[int, int, int, int], pixels: NDArray[Any]) -> None:
        left, top, right, _ = part
        pixel = self._dtype.itemsize * int(np.prod(self._shape[2:]))
        row = self._shape[1] * pixel
        pixels = np.ascontiguousarray(pixels)
        whole = right - left == self._shape[1]
        for number, some in enumerate([pixels] if whole else pixels):
            self._file.seek(self._start + (top + number) * row + left * pixel)
            view = some.reshape(-1).view(np.uint8).data
            while len(view):
                view = view[self._file.write(view) :]

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def finish(self, output: Path) -> None:
        self._file.close()
        if not self._compress:
            move_into_place(self._path, output)
            return
        import tifffile

        options: dict[str, Any] = {"tile": (_TILE, _TILE), "compression": "zlib", "compressionargs": {"level": 3}}
        # In the folder of unfinished work it is found again, and removed, by the next run if this one is killed.
        packed = self._path.with_name("packed.tif")
        with atomic_write(packed) as temporary:
            tifffile.imwrite(
                temporary, self._tiles(), shape=self._shape, dtype=self._dtype, predictor=self._dtype.kind != "f",
                **options, **self._tags,
            )  # fmt: skip
        move_into_place(packed, output)

    def _tiles(self) -> Any:
        """The tiles of the finished picture, row by row."""
        for top in range(0, self._shape[0], _TILE):
            rows = min(_TILE, self._shape[0] - top)
            offset = self._start + top * self._dtype.itemsize * int(np.prod(self._shape[1:]))
            band = np.fromfile(self._path, self._dtype, rows * int(np.prod(self._shape[1:])), offset=offset)
            band = band.reshape(rows, *self._shape[1:])
            for left in range(0, self._shape[1], _TILE):
                yield band[:, left : left + _TILE]


class _ZarrWriter:
    """Chunks of a Zarr array, one for each part."""

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: Any, side: tuple[int, int], description: str) -> None:
        self._path, self._shape, self._dtype, self._description = path, shape, dtype, description
        self._chunks = (min(side[1], shape[0]), min(side[0], shape[1]), *shape[2:])
        self._array: Any = None

    def open(self, fresh: bool) -> bool:
        try:
            import zarr
        except ImportError as error:
            raise PictureError("Zarr needs the package 'zarr'; pip install 'lfrender[zarr]'") from error
        if fresh:
            shutil.rmtree(self._path, ignore_errors=True)
        found = self._path.exists()
        # A chunk that is not there is then one that was lost.
        with zarr.config.set({"array.write_empty_chunks": True}):
            if not found:
                self._array = zarr.create_array(
                    str(self._path), shape=self._shape, dtype=self._dtype, chunks=self._chunks,
                    attributes={"description": self._description},
                )  # fmt: skip
            else:
                self._array = zarr.open_array(str(self._path), mode="r+")
        return found

    def write(self, part: tuple[int, int, int, int], pixels: NDArray[Any]) -> None:
        left, top, right, bottom = part
        self._array[top:bottom, left:right] = pixels

    def sync(self) -> None:
        # Files of whole chunks are left to the system: those of a killed run are there.
        return

    def finish(self, output: Path) -> None:
        if output.exists() and not any((output / name).exists() for name in ("zarr.json", ".zarray", ".zgroup")):
            raise OutputError(f"{output}: is there already and no Zarr array; give another output")
        earlier = self._path.with_name("earlier.zarr")
        # Out of the way in one step: a folder half removed would be taken for a picture.
        if output.exists():
            shutil.rmtree(earlier, ignore_errors=True)
            move_into_place(output, earlier)
        move_into_place(self._path, output)
