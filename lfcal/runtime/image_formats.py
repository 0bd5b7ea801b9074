"""The image formats that flats are read from, with their suffixes and first bytes; the colour mosaics they may hold."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

__all__ = [
    "IMAGE_FORMATS", "IMAGE_SUFFIXES", "MOSAICS", "TIFF_SUFFIXES", "ImageFormat", "Mosaic", "identify_format"
]  # fmt: skip

#: Colour filters of the top left 2 x 2 pixels, row by row.
Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
MOSAICS = get_args(Mosaic)


@dataclass(frozen=True)
class ImageFormat:
    """Suffixes of an image format, and a regular expression for the first 16 bytes of its files."""

    suffixes: tuple[str, ...]
    signature: bytes


#: Every readable format by its name; `lfcal.images.read` has the decoder of each.
IMAGE_FORMATS = {
    "PNG": ImageFormat((".png",), rb"\x89PNG\r\n\x1a\n"),
    "TIFF": ImageFormat((".tif", ".tiff"), rb"II[*+]\x00|MM\x00[*+]"),
    "WebP": ImageFormat((".webp",), rb"RIFF....WEBP"),
    "JPEG": ImageFormat((".jpg", ".jpeg"), rb"\xff\xd8\xff"),
    "BMP": ImageFormat((".bmp",), rb"BM"),
    "PGM": ImageFormat((".pgm",), rb"P[25][\s#]"),
    "PPM": ImageFormat((".ppm",), rb"P[36][\s#]"),
}
IMAGE_SUFFIXES = frozenset(suffix for form in IMAGE_FORMATS.values() for suffix in form.suffixes)
TIFF_SUFFIXES = IMAGE_FORMATS["TIFF"].suffixes


def identify_format(head: bytes) -> str | None:
    """Name of the format of a file that begins with these bytes, None where it is not readable."""
    matches = (name for name, form in IMAGE_FORMATS.items() if re.match(form.signature, head, re.DOTALL))
    return next(matches, None)
