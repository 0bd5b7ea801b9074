"""Flats read part by part, so that they need not fit into memory; pixels are those of `read_flat`.

TIFFs without compression are read row by row in the file; of others only the strips or tiles that overlap a part are
decoded, and of a Zarr array the chunks. Formats that cannot be read in parts, such as PNG, are read as a whole, once.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.image_formats import TIFF_SUFFIXES
from .dark_frame import subtract_dark
from .read import MAX_PIXELS, checked_pixels, file_errors, read_flat
from .tiff import convert_tiff_pixels, open_tiff, select_tiff_page
from .zarr_flat import is_zarr, open_zarr

__all__ = ["FlatSource", "open_flat"]

# [bytes] files with larger strips or tiles, which every part would decode again, are read as a whole.
_LARGEST_SEGMENT = 1 << 27


#: Reads the pixels of some rows and columns.
_Read = Callable[[slice, slice], NDArray[Any]]


class FlatSource:
    """A flat in a file; close it after use, or use it in a `with` statement.

    Parameters
    ----------
    path : Path
    shape : (int, int) or (int, int, 3) [px]
        Height, width and colours.
    dtype : dtype
        uint8, uint16 or float32.
    in_parts : bool
        Whether parts are read from the file; else the flat is in memory.
    page : int or None
        As given to `open_flat`.
    dark : Path or None
        Dark frame that is subtracted.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal, numpy, tifffile
    >>> with TemporaryDirectory() as folder:
    ...     tifffile.imwrite(f"{folder}/big.tif", numpy.arange(600, dtype=numpy.uint16).reshape(20, 30))
    ...     with lfcal.open_flat(f"{folder}/big.tif") as source:
    ...         source.shape, source.read(5, 5, 15, 10).shape
    ((20, 30), (5, 10))
    """

    def __init__(self, path: Path, read: _Read, shape: tuple[int, ...], file: Any = None, in_parts: bool = True):
        self.path, self._read, self._file, self.in_parts = path, read, file, in_parts
        self.page: int | None = None
        self.dark: Path | None = None
        self._size = shape[0], shape[1]
        with file_errors(path):
            corner = checked_pixels(read(slice(0, 1), slice(0, 1)))
        self.shape: tuple[int, ...] = (*self._size, *corner.shape[2:])
        self.dtype = corner.dtype

    @property
    def nbytes(self) -> int:
        """Bytes of all pixels."""
        return int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize

    def read(self, left: int, top: int, right: int, bottom: int) -> NDArray[Any]:
        """Pixels of the columns from `left` to before `right` and rows from `top` to before `bottom`.

        Raises
        ------
        FlatError
            If that part is damaged, or holds NaN or infinity.
        ValueError
            If it is empty, or not on the flat.
        """
        height, width = self._size
        if not (0 <= left < right <= width and 0 <= top < bottom <= height):
            raise ValueError(f"part {left, top, right, bottom} is not on a flat of {width} x {height} px")
        with file_errors(self.path):
            return checked_pixels(self._read(slice(top, bottom), slice(left, right)))

    def close(self) -> None:
        """Close the file; no part can be read any more."""
        if self._file is not None:
            self._file.close()

    def __enter__(self) -> FlatSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_flat(
    path: str | os.PathLike[str], page: int | None = None, dark: str | os.PathLike[str] | None = None
) -> FlatSource:
    """Open a raw plenoptic picture to read it part by part.

    Parameters
    ----------
    path : path-like
        The image file, or the folder of a Zarr array (needs the package `zarr`: `pip install 'lfrender[zarr]'`).
    page : int or None
        As in `read_flat`.
    dark : path-like or None
        File of a dark frame, which is subtracted from every part (`subtract_dark`).

    Returns
    -------
    FlatSource

    Raises
    ------
    FlatError
        As `read_flat`; damaged pixels are found when they are read.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal, numpy, tifffile
    >>> with TemporaryDirectory() as folder:
    ...     tifffile.imwrite(f"{folder}/big.tif", numpy.arange(600, dtype=numpy.uint16).reshape(20, 30))
    ...     with lfcal.open_flat(f"{folder}/big.tif") as source:
    ...         source.shape, source.read(5, 5, 15, 10).shape
    ((20, 30), (5, 10))
    """
    source = _open(Path(path), page)
    source.page = page
    return source if dark is None else _subtract(source, Path(dark))


def _subtract(source: FlatSource, path: Path) -> FlatSource:
    """A flat less the dark frame in a file."""
    with ExitStack() as opened:
        opened.callback(source.close)
        dark = opened.enter_context(_open(path, None))
        if dark.shape[:2] != source.shape[:2]:
            sizes = " and ".join(f"{shape[1]} x {shape[0]}" for shape in (dark.shape, source.shape))
            raise FlatError(f"{path}: dark frame and flat must be of one size, they have {sizes} px")

        def read(rows: slice, columns: slice) -> NDArray[Any]:
            part = columns.start, rows.start, columns.stop, rows.stop
            pixels, black = source.read(*part), dark.read(*part)
            with file_errors(path):
                return subtract_dark(pixels, black)

        read(slice(0, 1), slice(0, 1))
        less = FlatSource(source.path, read, source.shape, opened.pop_all(), source.in_parts)
    less.page, less.dark = source.page, path
    return less


def _open(source: Path, page: int | None) -> FlatSource:
    if source.is_dir() and is_zarr(source):
        with file_errors(source):
            array = open_zarr(source, MAX_PIXELS)
        return FlatSource(source, array.read, array.shape)
    if source.suffix.lower() in TIFF_SUFFIXES and source.is_file():
        tiff = _open_tiff(source, page)
        if tiff is not None:
            return tiff
    pixels = read_flat(source, page)
    return FlatSource(source, lambda rows, columns: pixels[rows, columns], pixels.shape, in_parts=False)


def _open_tiff(source: Path, number: int | None) -> FlatSource | None:
    """A TIFF to be read in parts, None where it cannot."""
    with file_errors(source):
        tiff = open_tiff(source)
        try:
            page = select_tiff_page(tiff, number)
            shape = page.imagelength, page.imagewidth
            # Rows that lie one after the other in the file, without compression, are mapped into memory.
            if page.is_memmappable and page.is_contiguous and page.fillorder == 1 and page.axes in ("YX", "YXS"):
                kind = np.dtype(page.parent.byteorder + page.dtype.char)
                rows = np.memmap(source, kind, "r", int(page.dataoffsets[0]), page.shape)
                return FlatSource(source, lambda y, x: convert_tiff_pixels(np.array(rows[y, x]), page), shape, tiff)
            reader = _Segments(tiff, page)
            if reader.segment_bytes <= _LARGEST_SEGMENT:
                return FlatSource(source, reader.read, shape, tiff)
        # Reading it as a whole finds another way, or reports the error.
        except Exception:
            pass
        tiff.close()
    return None


class _Segments:
    """Strips or tiles of a TIFF, decoded as they are needed."""

    def __init__(self, tiff: Any, page: Any) -> None:
        self._tiff, self._page, self._lock = tiff, page, Lock()
        self._planes = page.axes == "SYX"
        rows, columns = page.chunks[1:3] if self._planes and len(page.chunks) == 3 else page.chunks[:2]
        self._side = int(rows), int(columns)
        across, down = -(-page.imagewidth // self._side[1]), -(-page.imagelength // self._side[0])
        self._grid = down, across
        self.segment_bytes = rows * columns * page.samplesperpixel * page.dtype.itemsize

    def read(self, rows: slice, columns: slice) -> NDArray[Any]:
        from concurrent.futures import ThreadPoolExecutor

        page = self._page
        channels = (page.samplesperpixel,) if page.samplesperpixel > 1 else ()
        size = rows.stop - rows.start, columns.stop - columns.start
        out = np.zeros((*channels, *size) if self._planes else (*size, *channels), page.dtype)
        down, across = self._grid
        wanted = [
            (plane * down + v) * across + u
            for plane in range(page.samplesperpixel if self._planes else 1)
            for v in range(rows.start // self._side[0], -(-rows.stop // self._side[0]))
            for u in range(columns.start // self._side[1], -(-columns.stop // self._side[1]))
        ]
        with ThreadPoolExecutor(min(len(wanted), os.cpu_count() or 1)) as pool:
            for _ in pool.map(lambda number: self._decode(number, rows, columns, out), wanted):
                pass
        return convert_tiff_pixels(out, page)

    def _decode(self, number: int, rows: slice, columns: slice, out: NDArray[Any]) -> None:
        """Decode one strip or tile, and copy the pixels of these rows and columns."""
        page = self._page
        with self._lock:
            file = self._tiff.filehandle
            file.seek(page.dataoffsets[number])
            data = file.read(page.databytecounts[number])
        decoded, (plane, _, top, left, _), _ = page.decode(data, number, jpegtables=page.jpegtables)
        if decoded is None:
            return
        pixels = decoded[0]
        bottom, right = min(top + pixels.shape[0], rows.stop), min(left + pixels.shape[1], columns.stop)
        first, start = max(top, rows.start), max(left, columns.start)
        some = pixels[first - top : bottom - top, start - left : right - left]
        into = out[plane] if self._planes else out
        place = into[first - rows.start : bottom - rows.start, start - columns.start : right - columns.start]
        place[...] = some.reshape(place.shape)
