"""Raw photos (`.dng` and those of camera makers), read by LibRaw: the pixels of the colour mosaic as stored."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...runtime.errors import FlatError
from ...runtime.image_formats import identify_format
from ..decoders import check_size
from ..tiff import open_tiff

__all__ = ["read_raw_photo"]


def read_raw_photo(path: Path, page: int | None) -> NDArray[Any]:
    """(h, w) uint16 the visible part of the sensor; linear DNG (h, w, 3)."""
    try:
        import rawpy
    except ImportError as error:
        raise FlatError("raw photos need the package 'rawpy'; pip install 'lfrender[dng]'") from error
    if page not in (None, 0):
        raise FlatError(f"has one picture and no page {page}")
    _check_complete(path)
    with rawpy.imread(str(path)) as photo:
        sizes = photo.sizes
        check_size(sizes.raw_width, sizes.raw_height)
        pixels = np.array(photo.raw_image_visible)
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[..., :3]
    return pixels.astype(np.uint16, copy=False)


def _check_complete(path: Path) -> None:
    """FlatError if pixels are missing at the end of a file built as a TIFF, which LibRaw leaves black."""
    with path.open("rb") as stream:
        if identify_format(stream.read(16)) != "TIFF":
            return
    size = path.stat().st_size
    with open_tiff(path) as tiff:
        for page in tiff.pages:
            for part in (page, *(page.pages or ())):
                ends = (start + count for start, count in zip(part.dataoffsets, part.databytecounts, strict=True))
                if max(ends, default=0) > size:
                    raise FlatError("truncated raw photo: pixel data are missing")
