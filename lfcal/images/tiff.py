"""TIFF files (tifffile): the page that is the flat, and its pixels as a whole or in parts."""

from __future__ import annotations

import logging
import os
import struct
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from .pixels import check_page, check_size, decode_with_opencv

__all__ = ["count_tiff_pages", "open_tiff", "part_reader", "read_tiff", "select_tiff_page"]

# Most bytes of a strip or tile: every part would decode a larger one again.
_MOST_SEGMENT = 1 << 27


def open_tiff(source: Path) -> Any:
    """A `tifffile.TiffFile` that prints no remarks on damaged files."""
    import tifffile

    # Without a handler Python prints the remarks.
    log = logging.getLogger("tifffile")
    if not log.hasHandlers():
        log.addHandler(logging.NullHandler())
    return tifffile.TiffFile(source)


def count_tiff_pages(source: Path) -> int:
    """Number of full pictures; a truncated list of pages counts as one more."""
    with open_tiff(source) as tiff:
        pages, is_cut_off = _full_pages(tiff)
    return len(pages) + is_cut_off


def _full_pages(tiff: Any) -> tuple[list[Any], bool]:
    """Pages up to the first unreadable one, without thumbnails; whether the list is truncated."""
    pages: list[Any] = []
    try:
        pages.extend(tiff.pages)
    except Exception:
        if not pages:
            raise
    # The last page must not point to another one.
    kind = tiff.tiff
    file = tiff.filehandle
    file.seek(pages[-1].offset)
    (tags,) = struct.unpack(kind.tagnoformat, file.read(kind.tagnosize))
    file.seek(pages[-1].offset + kind.tagnosize + tags * kind.tagsize)
    following = file.read(kind.offsetsize)
    known = {0, *(page.offset for page in pages)}
    is_cut_off = (
        len(following) < kind.offsetsize
        or struct.unpack(kind.offsetformat, following)[0] not in known
    )
    return [page for page in pages if not page.is_reduced], is_cut_off


def select_tiff_page(tiff: Any, number: int | None) -> Any:
    """The page of a TIFF that is the flat; FlatError if its pixels are incomplete or unknown."""
    pages, is_cut_off = _full_pages(tiff)
    if number in (None, len(pages)) and is_cut_off:
        raise FlatError(f"truncated TIFF: its list of pages is cut off after {len(pages)}")
    page: Any = pages[check_page(number, len(pages), "TIFF", "pictures", "page")]
    parts = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    end = tiff.filehandle.size
    if not parts or any(count == 0 or start + count > end for start, count in parts):
        raise FlatError("truncated TIFF: pixel data are missing")
    if len(parts) < np.prod(page.chunked):
        raise FlatError("damaged TIFF: strips or tiles are missing from its table")
    kind = page.photometric.name
    if kind not in ("MINISBLACK", "MINISWHITE", "RGB", "PALETTE", "CFA", "YCBCR", "LINEAR_RAW"):
        raise FlatError(f"TIFF pixels of kind {kind} are not read; save as grey or RGB")
    if page.axes not in ("YX", "YXS", "SYX"):
        raise FlatError(f"the TIFF holds axes {page.axes}; a flat is one grey or RGB picture")
    return page


def read_tiff(source: Path, number: int | None) -> NDArray[Any]:
    """Pixels of the page `number` of a TIFF, or of its only full picture."""
    with open_tiff(source) as tiff:
        page = select_tiff_page(tiff, number)
        check_size(page.imagewidth, page.imagelength)
        try:
            return _convert(page.asarray(), page)
        except (KeyError, ValueError) as error:
            if "imagecodecs" not in str(error):
                raise
            if number:
                raise FlatError(
                    "compressed in a way that is read for the first page only; save without it"
                ) from error
            # OpenCV reads the common compressions for which tifffile needs an optional package.
            grey = page.samplesperpixel < 3 and page.photometric.name != "PALETTE"
            return decode_with_opencv(source.read_bytes(), grey=grey)


def _convert(pixels: NDArray[Any], page: Any) -> NDArray[Any]:
    if page.axes == "SYX":
        pixels = np.moveaxis(pixels, 0, -1)
    if page.photometric.name == "PALETTE":
        # Colour maps have 16 bits; their values are almost always 8 bits times 257.
        return (page.colormap >> 8).astype(np.uint8).T[pixels]
    if page.photometric.name == "MINISWHITE" and pixels.dtype.kind == "u":
        return np.iinfo(pixels.dtype).max - pixels
    return pixels


def part_reader(
    source: Path, tiff: Any, number: int | None
) -> tuple[Callable[[slice, slice], NDArray[Any]], Any]:
    """A function that reads some rows and columns of a TIFF, and height and width [px].

    Pixels without compression are mapped into memory; of others the strips or tiles that overlap a
    part are decoded. Raises any error if the file cannot be read in parts.
    """
    import tifffile

    page = select_tiff_page(tiff, number)
    shape = page.imagelength, page.imagewidth
    if page.is_memmappable and page.axes != "SYX":
        pixels = tifffile.memmap(source, page=page.index, mode="r")
        return lambda rows, columns: _convert(np.array(pixels[rows, columns]), page), shape
    side = page.chunks[1:3] if page.axes == "SYX" and len(page.chunks) == 3 else page.chunks[:2]
    if side[0] * side[1] * page.samplesperpixel * page.dtype.itemsize > _MOST_SEGMENT:
        raise NotImplementedError("strips or tiles are too large to be read in parts")
    lock = Lock()
    return lambda rows, columns: _convert(
        _read_segments(tiff, page, side, lock, rows, columns), page
    ), shape


def _read_segments(
    tiff: Any, page: Any, side: tuple[int, int], lock: Lock, rows: slice, columns: slice
) -> NDArray[Any]:
    """The pixels of some rows and columns, from strips or tiles of (height, width) `side`."""
    from concurrent.futures import ThreadPoolExecutor

    down = -(-page.imagelength // side[0])
    across = -(-page.imagewidth // side[1])
    size = rows.stop - rows.start, columns.stop - columns.start
    channels = (page.samplesperpixel,) if page.samplesperpixel > 1 else ()
    planes = page.axes == "SYX"
    out = np.zeros((*channels, *size) if planes else (*size, *channels), page.dtype)

    def decode(number: int) -> None:
        with lock:
            tiff.filehandle.seek(page.dataoffsets[number])
            data = tiff.filehandle.read(page.databytecounts[number])
        decoded, (plane, _, top, left, _), _ = page.decode(data, number, jpegtables=page.jpegtables)
        if decoded is None:
            return
        # The part of the segment that is wanted, and its place in the output.
        pixels = decoded[0][max(rows.start - top, 0) :, max(columns.start - left, 0) :]
        into = out
        if planes:
            into = out[plane]
        place = into[max(top - rows.start, 0) :, max(left - columns.start, 0) :]
        place = place[: pixels.shape[0], : pixels.shape[1]]
        place[...] = pixels[: place.shape[0], : place.shape[1]].reshape(place.shape)

    wanted = [
        (plane * down + v) * across + u
        for plane in range(page.samplesperpixel if planes else 1)
        for v in range(rows.start // side[0], -(-rows.stop // side[0]))
        for u in range(columns.start // side[1], -(-columns.stop // side[1]))
    ]
    with ThreadPoolExecutor(min(len(wanted), os.cpu_count() or 1)) as pool:
        list(pool.map(decode, wanted))
    return out
