"""The formats that flats are read from, with their suffixes and first bytes; the colour mosaics they may hold."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

__all__ = [
    "CONVERTERS", "IMAGE_FORMATS", "IMAGE_SUFFIXES", "MOSAICS", "RAW_PHOTO_SUFFIXES", "TIFF_SUFFIXES",
    "VIDEO_FORMATS", "ImageFormat", "Mosaic", "identify_format",
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
    "OpenEXR": ImageFormat((".exr",), rb"\x76\x2f\x31\x01"),
    "HDF5": ImageFormat((".h5", ".hdf5", ".vox"), rb"\x89HDF\r\n\x1a\n"),
    "Lytro": ImageFormat((".lfp", ".lfr"), rb"\x89LFP\r\n\x1a\n"),
}
#: Raw photos, many of which begin as a TIFF does: known by their suffix alone.
RAW_PHOTO_SUFFIXES = frozenset({".dng", ".arw", ".cr2", ".cr3", ".nef", ".orf", ".pef", ".raf", ".rw2", ".srw"})
#: Suffixes of videos, and FFmpeg's name of the format of raw streams, which have no header that names it.
VIDEO_FORMATS = {
    ".mp4": None, ".mkv": None, ".mov": None, ".avi": None, ".webm": None, ".y4m": None, ".m4v": None,
    ".vvc": "vvc", ".266": "vvc", ".hevc": "hevc", ".265": "hevc", ".h264": "h264", ".264": "h264",
}  # fmt: skip
#: What is not read, by its suffix, and what can convert it.
CONVERTERS = {
    ".czi": "save it as OME-TIFF with Fiji or bfconvert (Bio-Formats)",
    ".heic": "convert it to PNG with ImageMagick",
    ".lif": "save it as OME-TIFF with Fiji or bfconvert (Bio-Formats)",
    ".mat": "save the picture as TIFF or HDF5 (h5write)",
    ".nd2": "save it as OME-TIFF with Fiji or bfconvert (Bio-Formats)",
    ".oib": "save it as OME-TIFF with Fiji or bfconvert (Bio-Formats)",
    ".oif": "save it as OME-TIFF with Fiji or bfconvert (Bio-Formats)",
    ".ray": "export the raw image as PNG or TIFF with RxLive",
    ".rays": "export the raw images as PNG or TIFF with RxLive",
    ".raw": "it has no header: name it NAME_WxH_400p8.yuv, or 400p10, 400p12 for 16-bit samples of so many bits",
    ".jp2": "convert it to TIFF with ImageMagick or opj_decompress",
}
IMAGE_SUFFIXES = RAW_PHOTO_SUFFIXES.union(suffix for form in IMAGE_FORMATS.values() for suffix in form.suffixes)
TIFF_SUFFIXES = IMAGE_FORMATS["TIFF"].suffixes


def identify_format(head: bytes) -> str | None:
    """Name of the format of a file that begins with these bytes, None where it is not readable."""
    matches = (name for name, form in IMAGE_FORMATS.items() if re.match(form.signature, head, re.DOTALL))
    return next(matches, None)
