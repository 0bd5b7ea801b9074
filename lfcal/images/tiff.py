"""TIFF files: which page is the flat, whether its pixels are complete, and the pixels as grey or colours."""

from __future__ import annotations

import logging
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from .decoders import check_size, decode_with_opencv

__all__ = ["convert_tiff_pixels", "count_tiff_pages", "open_tiff", "read_tiff", "select_tiff_page"]


def open_tiff(source: Path) -> Any:
    """A `tifffile.TiffFile`, whose remarks on damaged files are not printed."""
    import tifffile

    # Without a handler Python prints them.
    log = logging.getLogger("tifffile")
    if not log.hasHandlers():
        log.addHandler(logging.NullHandler())
    return tifffile.TiffFile(source)


def count_tiff_pages(tiff: Any) -> int:
    """Number of full pictures; a list of pages that is cut off counts as one more."""
    return len(_full_pages(tiff)) + _is_cut_off(tiff)


def _full_pages(tiff: Any) -> list[Any]:
    """Pages that are no thumbnails."""
    return [page for page in _pages(tiff) if not page.is_reduced]


def _pages(tiff: Any) -> list[Any]:
    """All pages up to the first that cannot be read."""
    pages: list[Any] = []
    try:
        pages.extend(tiff.pages)
    except Exception:
        if not pages:
            raise
    return pages


def _is_cut_off(tiff: Any) -> bool:
    """Whether the list of pages ends with the offset of a page that is not there."""
    kind, file = tiff.tiff, tiff.filehandle
    offsets = [page.offset for page in _pages(tiff)]
    file.seek(offsets[-1])
    (tags,) = struct.unpack(kind.tagnoformat, file.read(kind.tagnosize))
    file.seek(offsets[-1] + kind.tagnosize + tags * kind.tagsize)
    following = file.read(kind.offsetsize)
    if len(following) < kind.offsetsize:
        return True
    (offset,) = struct.unpack(kind.offsetformat, following)
    return offset != 0 and offset not in offsets


def select_tiff_page(tiff: Any, number: int | None) -> Any:
    """The page of a TIFF that is the flat; FlatError if its pixels are incomplete or of an unknown kind."""
    pages = _full_pages(tiff)
    if number in (None, len(pages)) and _is_cut_off(tiff):
        raise FlatError(f"truncated TIFF: its list of pages is cut off after {len(pages)}")
    if number is None and len(pages) != 1:
        raise FlatError(f"the TIFF holds {len(pages)} pictures; save the one that is the flat on its own")
    if not 0 <= (number or 0) < len(pages):
        raise FlatError(f"the TIFF holds {len(pages)} pictures and no page {number}")
    page: Any = pages[number or 0]
    size = tiff.filehandle.size
    parts = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    if not parts or any(count == 0 or start + count > size for start, count in parts):
        raise FlatError("truncated TIFF: pixel data are missing")
    if len(parts) < np.prod(page.chunked):
        raise FlatError("damaged TIFF: strips or tiles are missing from its table")
    kind = page.photometric.name
    if kind not in ("MINISBLACK", "MINISWHITE", "RGB", "PALETTE", "CFA", "YCBCR", "LINEAR_RAW"):
        raise FlatError(f"TIFF pixels of kind {kind} are not read; save as grey or RGB")
    return page


def read_tiff(source: Path, number: int | None) -> NDArray[Any]:
    """Pixels of the page `number` of a TIFF, or of its only full picture."""
    with open_tiff(source) as tiff:
        page = select_tiff_page(tiff, number)
        check_size(page.imagewidth, page.imagelength)
        try:
            pixels = page.asarray()
        except (KeyError, ValueError) as error:
            if "imagecodecs" not in str(error):
                raise
            if number:
                raise FlatError("compressed in a way that is read for the first page only; save without it") from error
            # OpenCV reads the common compressions that tifffile leaves to an optional package.
            grey = page.samplesperpixel < 3 and page.photometric.name != "PALETTE"
            return decode_with_opencv(source.read_bytes(), grey=grey)
        return convert_tiff_pixels(pixels, page)


def convert_tiff_pixels(pixels: NDArray[Any], page: Any) -> NDArray[Any]:
    """Decoded pixels of a page, or of a part of it, as grey or with colours along the last axis."""
    if page.axes == "SYX":
        pixels = np.moveaxis(pixels, 0, -1)
    elif page.axes not in ("YX", "YXS"):
        raise FlatError(f"the TIFF holds axes {page.axes}; a flat is one grey or RGB picture")
    kind = page.photometric.name
    if kind == "PALETTE":
        # Colour maps are 16 bit by definition, the colours in them almost always 8 bit times 257.
        pixels = (page.colormap >> 8).astype(np.uint8).T[pixels]
    elif kind == "MINISWHITE" and pixels.dtype.kind == "u":
        pixels = np.iinfo(pixels.dtype).max - pixels
    return pixels
