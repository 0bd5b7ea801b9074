"""TIFF files (tifffile): the page that is the flat, and its pixels as a whole or in parts."""

from __future__ import annotations

import logging
import math
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..runtime.arrays import Array
from ..runtime.errors import FlatError
from ..runtime.types import Page
from .pixels import apply_palette, check_page, check_size, check_unpacked

__all__ = ["count_tiff_pages", "open_tiff", "part_reader", "read_tiff", "select_tiff_page"]

# Values of the tags SampleFormat and Compression.
_UNSIGNED = 1
_FLOAT = 3
_UNCOMPRESSED = 1
_FAX = (2, 3, 4)
_JPEG = (6, 7)
# Values of the tags PlanarConfiguration, and Predictor for differences of floats.
_PLANAR = (1, 2)
_OF_FLOATS = (3, 34894, 34895)
# Strips and tiles are filled up to whole words of so many bytes by some programs.
_WORD = 4
# Bytes of the header of a file.
_HEADER = 8
_TABLES = ("StripOffsets", "TileOffsets")
# Numbers of samples of a pixel by the kind of its colours: with and without alpha.
_SAMPLES = {
    "MINISBLACK": (1, 2),
    "MINISWHITE": (1, 2),
    "PALETTE": (1,),
    "CFA": (1,),
    "LINEAR_RAW": (1, 3),
    "RGB": (3, 4),
    "YCBCR": (3,),
}
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
    # Raw photos keep the picture of the sensor below the page of their thumbnail.
    parts = (part for page in pages for part in (page, *(page.pages or ())))
    return [part for part in parts if not part.is_reduced], is_cut_off


def select_tiff_page(tiff: Any, number: Page) -> Any:
    """The page of a TIFF that is the flat; FlatError if its pixels are incomplete or unknown."""
    pages, is_cut_off = _full_pages(tiff)
    if number in (None, len(pages)) and is_cut_off:
        raise FlatError(f"truncated TIFF: its list of pages is cut off after {len(pages)}")
    page: Any = pages[check_page(number, len(pages), "TIFF", "pictures", "page")]
    check_size(page.imagewidth, page.imagelength)
    _check_kind(page)
    _check_segments(page, tiff.filehandle)
    return page


def _check_kind(page: Any) -> None:
    """Raise FlatError unless the tags describe a grey or RGB picture."""
    kind = page.photometric.name
    samples = page.samplesperpixel
    if samples not in _SAMPLES.get(kind, ()):
        raise FlatError(
            f"TIFF pixels of kind {kind} with {samples} samples are not read; save as grey or RGB"
        )
    if page.axes not in ("YX", "YXS", "SYX"):
        raise FlatError(f"the TIFF holds axes {page.axes}; a flat is one grey or RGB picture")
    # The decoder of JPEG returns RGB. Others return luminance and differences of colours.
    if kind == "YCBCR" and page.compression not in _JPEG:
        raise FlatError("TIFF pixels of kind YCBCR are read in JPEG only; save as RGB")
    if page.planarconfig not in _PLANAR:
        raise FlatError("damaged TIFF: the order of its colours is not known")
    if page.predictor in _OF_FLOATS and page.sampleformat != _FLOAT:
        raise FlatError("damaged TIFF: its predictor is one of floats, its pixels are integers")
    if kind == "MINISWHITE" and page.sampleformat != _UNSIGNED:
        raise FlatError("TIFF pixels of kind MINISWHITE are read as unsigned integers only")


def _check_segments(page: Any, file: Any) -> None:
    """Raise FlatError unless the strips or tiles of a page are just all of its pixels."""
    counts = page.databytecounts
    parts = list(zip(page.dataoffsets, counts, strict=True))
    if not parts or any(count == 0 or start + count > file.size for start, count in parts):
        raise FlatError("truncated TIFF: pixel data are missing")
    (table,) = (page.tags[name] for name in _TABLES if name in page.tags)
    if table.count != np.prod(page.chunked):
        raise FlatError("damaged TIFF: its table of strips or tiles does not fit its size")
    # Equal tiles may be stored once.
    tags = (page.offset, 1 + page.parent.tiff.tagsize * len(page.tags))
    used = sorted({(0, _HEADER), tags, *parts})
    ends = np.cumsum(used, axis=1)[:, 1]
    if any(start < end for (start, _), end in zip(used[1:], ends[:-1], strict=True)):
        raise FlatError("damaged TIFF: its strips or tiles overlap each other or the tags")
    check_unpacked(math.prod(page.shaped) * page.bitspersample / 8, file.size)
    # Those that lie at the end of the picture may be smaller.
    for number in {0, len(parts) - 1}:
        file.seek(page.dataoffsets[number])
        if not _fits(page, number, file.read(counts[number])):
            raise FlatError(
                "damaged TIFF: its strips or tiles hold pixels of another size or type than its "
                "tags describe"
            )


def _fits(page: Any, number: int, data: bytes) -> bool:
    """Whether a strip or tile holds as many pixels and bits as the tags describe."""
    import imagecodecs
    import tifffile

    _, (_, _, top, left, _), (_, height, width, samples) = page.decode(None, number)
    heights = {page.tilelength or page.rowsperstrip, height, page.imagelength - top}
    widths = {width, page.imagewidth - left}
    compression = page.compression
    if compression in _FAX:
        return bool(page.bitspersample == 1)
    if compression in tifffile.TIFF.IMAGE_COMPRESSIONS:
        if compression in _JPEG:
            bits = page.bitspersample
            decoded = imagecodecs.jpeg_decode(data, bitspersample=bits, tables=page.jpegtables)
        else:
            decoded = tifffile.TIFF.DECOMPRESSORS[compression](data)
        rows, columns, channels = np.atleast_3d(decoded).shape
        if samples == 1:
            # Mosaics are stored as pictures of two or four channels.
            columns *= channels
        # WebP leaves out alpha that is opaque.
        is_whole = samples in (1, channels) or (samples, channels) == (4, 3)
        fits = is_whole and rows in heights and columns in widths
        return bool(fits and decoded.dtype == page.dtype)
    lengths = [
        high * -(-wide * samples * page.bitspersample // 8) for high in heights for wide in widths
    ]
    if compression != _UNCOMPRESSED:
        # Decoders leave out what is too much.
        most = max(lengths) + _WORD
        data = tifffile.TIFF.DECOMPRESSORS[compression](data, out=most)
    return any(0 <= len(data) - length < _WORD for length in lengths)


def _segment_size(page: Any) -> tuple[int, int]:
    """Height and width of the strips or tiles [px]."""
    first = 1 if page.axes == "SYX" and len(page.chunks) == 3 else 0
    height, width = page.chunks[first : first + 2]
    return height, width


def read_tiff(source: Path, number: Page) -> Array:
    """Pixels of the page `number` of a TIFF, or of its only full picture."""
    with open_tiff(source) as tiff:
        page = select_tiff_page(tiff, number)
        pixels = page.asarray()
        if page.axes == "SYX":
            pixels = np.moveaxis(pixels, 0, -1)
        return _convert(pixels, page)


def _convert(pixels: Array, page: Any) -> Array:
    """Pixels (h, w) or (h, w, c) by their kind of colours."""
    if page.samplesperpixel == 1:
        pixels = pixels.reshape(pixels.shape[:2])
    kind = page.photometric.name
    if kind == "PALETTE":
        # Colour maps have 16 bits, but some programs write values of 8 bits.
        eighth = 8 if page.colormap.max() > 0xFF else 0
        return apply_palette(pixels, (page.colormap >> eighth).astype(np.uint8).T)
    if kind == "MINISWHITE" and pixels.dtype.kind == "b":
        return ~pixels
    if kind == "MINISWHITE":
        return pixels.dtype.type((1 << page.bitspersample) - 1) - pixels
    return pixels


def part_reader(
    source: Path, tiff: Any, number: Page
) -> tuple[Callable[[slice, slice], Array], Any]:
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
    height, width = _segment_size(page)
    if height * width * page.samplesperpixel * page.dtype.itemsize > _MOST_SEGMENT:
        raise NotImplementedError("strips or tiles are too large to be read in parts")
    # Several threads may read parts.
    tiff.filehandle.set_lock(True)
    return lambda rows, columns: _convert(_read_segments(page, rows, columns), page), shape


def _read_segments(page: Any, rows: slice, columns: slice) -> Array:
    """The pixels (h, w, c) of some rows and columns, from the strips or tiles that overlap them."""
    from concurrent.futures import ThreadPoolExecutor

    height, width = _segment_size(page)
    planes = page.samplesperpixel if page.axes == "SYX" else 1
    top = rows.start // height
    left = columns.start // width
    table = np.arange(len(page.dataoffsets)).reshape(planes, -1, -(-page.imagewidth // width))
    table = table[:, top : -(-rows.stop // height), left : -(-columns.stop // width)]
    _, down, across = table.shape
    size = (planes, down * height, across * width, page.samplesperpixel // planes)
    block = np.zeros(size, page.dtype)
    wanted = table.ravel()
    offsets = np.take(page.dataoffsets, wanted).tolist()
    counts = np.take(page.databytecounts, wanted).tolist()

    def decode(stored: tuple[bytes, int]) -> Any:
        data, number = stored
        return page.decode(data, int(wanted[number]), jpegtables=page.jpegtables)

    with ThreadPoolExecutor(min(len(wanted), os.cpu_count() or 1)) as pool:
        decoded = pool.map(decode, page.parent.filehandle.read_segments(offsets, counts))
        for pixels, (plane, _, y, x, _), _ in decoded:
            if pixels is not None:
                place = block[plane, y - top * height :, x - left * width :]
                place[: pixels.shape[1], : pixels.shape[2]] = pixels[0]
    part = np.concatenate(block, axis=-1)
    return part[rows.start - top * height :, columns.start - left * width :][
        : rows.stop - rows.start, : columns.stop - columns.start
    ]
