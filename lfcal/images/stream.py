"""Flats read in parts, so that they need not fit into memory; pixels are those of `read_flat`.

TIFFs without compression are mapped into memory. Of other TIFFs only the strips or tiles that
overlap a part are decoded, of a Zarr array the chunks. Other formats, such as PNG, are read once as
a whole.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

from ..runtime.arrays import Array
from ..runtime.errors import FlatError, check_path
from ..runtime.image_formats import TIFF_SUFFIXES
from ..runtime.types import AnyPath, Page
from .containers import is_zarr, open_zarr
from .pixels import convert_pixels, file_errors
from .read import read_flat
from .tiff import open_tiff, part_reader

__all__ = ["FlatSource", "open_flat", "subtract_dark"]

# Reads the pixels of some rows and columns.
_Read = Callable[[slice, slice], Array]


class FlatSource(ExitStack):
    """A flat in a file; close it after use, or use it in a `with` statement.

    Parameters
    ----------
    path : Path
    shape : (int, int) or (int, int, 3) [px]
        Height, width and colours.
    dtype : dtype
        uint8, uint16 or float32.
    in_parts : bool
        True if parts are read from the file, False if the flat is in memory.
    page : int or None
        As given to `open_flat`.
    dark : Path or None
        Dark frame that is subtracted.

    Examples
    --------
    >>> import lfcal, numpy, tempfile, tifffile
    >>> path = f"{tempfile.mkdtemp()}/flat.tif"
    >>> tifffile.imwrite(path, numpy.zeros((20, 30), numpy.uint16))
    >>> with lfcal.open_flat(path) as source:
    ...     source.shape, source.nbytes
    ((20, 30), 1200)
    """

    def __init__(self, path: Path, read: _Read, shape: tuple[int, ...], in_parts: bool = True):
        super().__init__()
        self.path = path
        self._read = read
        self.in_parts = in_parts
        self.page: Page = None
        self.dark: Path | None = None
        with file_errors(path):
            corner = convert_pixels(read(slice(0, 1), slice(0, 1)))
        self.shape: tuple[int, ...] = (*shape[:2], *corner.shape[2:])
        self.dtype = corner.dtype

    def _subtract(self, dark: FlatSource) -> None:
        """Subtract a dark frame from every part."""
        with file_errors(dark.path):
            _check_dark(self, dark)
        plain = self._read

        def read(rows: slice, columns: slice) -> Array:
            black = dark.read(columns.start, rows.start, columns.stop, rows.stop)
            pixels = convert_pixels(plain(rows, columns))
            return subtract_dark(pixels, black)

        self._read = read
        self.dark = dark.path

    @property
    def nbytes(self) -> int:
        """Bytes of all pixels."""
        return int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize

    def read(self, left: int, top: int, right: int, bottom: int) -> Array:
        """Pixels of columns `left` to `right - 1` and rows `top` to `bottom - 1`.

        FlatError if the part is damaged or contains NaN or infinity; ValueError if it is empty or
        not on the flat.
        """
        height, width = self.shape[:2]
        if not (0 <= left < right <= width and 0 <= top < bottom <= height):
            raise ValueError(
                f"part {left, top, right, bottom} is not on a flat of {width} x {height} px"
            )
        with file_errors(self.path):
            return convert_pixels(self._read(slice(top, bottom), slice(left, right)))


def open_flat(
    path: AnyPath,
    page: Page = None,
    dark: AnyPath | None = None,
) -> FlatSource:
    """Open a raw plenoptic picture to read it in parts.

    Parameters
    ----------
    path : path-like
        The image file, or the folder of a Zarr array.
    page : int or None
        As in `read_flat`, which also describes the errors. Damaged pixels raise an error when they
        are read.
    dark : path-like or None
        File of a dark frame, which is subtracted from every part (`subtract_dark`).

    Examples
    --------
    >>> import lfcal, numpy, tempfile, tifffile
    >>> path = f"{tempfile.mkdtemp()}/flat.tif"
    >>> tifffile.imwrite(path, numpy.zeros((20, 30), numpy.uint16))
    >>> with lfcal.open_flat(path) as source:
    ...     source.read(5, 5, 15, 10).shape
    (5, 10)
    """
    source = _open(check_path(path), page)
    source.page = page
    if dark is not None:
        with ExitStack() as opened:
            opened.callback(source.close)
            source._subtract(opened.enter_context(_open(check_path(dark, "dark"), None)))
            source.push(opened.pop_all())
    return source


def _open(source: Path, page: Page) -> FlatSource:
    if source.is_dir() and is_zarr(source):
        with file_errors(source):
            array = open_zarr(source)
        return FlatSource(source, array.read, array.shape)
    if source.suffix.lower() in TIFF_SUFFIXES and source.is_file():
        # If this fails, the whole file is read, which succeeds or reports the error.
        with suppress(Exception), ExitStack() as opened:
            tiff = opened.enter_context(open_tiff(source))
            flat = FlatSource(source, *part_reader(source, tiff, page))
            flat.push(opened.pop_all())
            return flat
    pixels = read_flat(source, page)
    return FlatSource(
        source, lambda rows, columns: pixels[rows, columns], pixels.shape, in_parts=False
    )


def subtract_dark(flat: Array, dark: Array) -> Array:
    """A flat minus a dark frame (a picture without light), in its own type, integers clipped at 0.

    `flat` and `dark` are (h, w) or (h, w, c). The dark frame, or the mean of several, has the
    exposure of the flat. FlatError if they differ in size or in the kind of their type.

    Examples
    --------
    >>> import numpy as np
    >>> subtract_dark(np.array([[5, 90]], np.uint8), np.array([[7, 7]], np.uint8))
    array([[ 0, 83]], dtype=uint8)
    """
    flat = np.asarray(flat)
    dark = np.asarray(dark)
    if dark.ndim == 2 and flat.ndim == 3:
        dark = dark[:, :, None]
    _check_dark(flat, dark)
    if flat.dtype.kind == "u":
        dark = np.minimum(dark, flat)
    return np.asarray(flat - dark, flat.dtype)


def _check_dark(flat: Array | FlatSource, dark: Array | FlatSource) -> None:
    """Raise FlatError unless a dark frame has the size, colours and kind of type of a flat."""
    if dark.shape[:2] != flat.shape[:2] or dark.shape[2:] not in ((), (1,), flat.shape[2:]):
        raise FlatError(
            f"dark frame has shape {dark.shape}, the flat {flat.shape}; give one of the same sensor"
        )
    whole = flat.dtype.kind == "u"
    if (dark.dtype.kind == "u") != whole or (whole and dark.dtype.itemsize > flat.dtype.itemsize):
        raise FlatError(
            f"dark frame is {dark.dtype}, the flat {flat.dtype}; give both as the sensor "
            "stores them"
        )
