"""Formats of flats with suffixes and first bytes; colour mosaics that they may hold."""

from __future__ import annotations

import re
from typing import Literal, get_args

__all__ = [
    "IMAGE_FORMATS",
    "IMAGE_SUFFIXES",
    "MOSAICS",
    "RAW_PHOTO_SUFFIXES",
    "RAW_SUFFIX",
    "TIFF_SUFFIXES",
    "VIDEO_FORMATS",
    "Mosaic",
    "identify_format",
]

#: Colour filters of the top left 2 x 2 pixels, row by row.
Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
MOSAICS = get_args(Mosaic)
#: Suffixes and a regular expression for the first bytes, by format; `lfcal.images.read` has the
#: decoder of each.
IMAGE_FORMATS = {
    "PNG": ((".png",), rb"\x89PNG\r\n\x1a\n"),
    "TIFF": ((".tif", ".tiff"), rb"II[*+]\x00|MM\x00[*+]"),
    "WebP": ((".webp",), rb"RIFF....WEBP"),
    "JPEG": ((".jpg", ".jpeg"), rb"\xff\xd8\xff"),
    "BMP": ((".bmp",), rb"BM"),
    "PGM": ((".pgm",), rb"P[25][\s#]"),
    "PPM": ((".ppm",), rb"P[36][\s#]"),
    "OpenEXR": ((".exr",), rb"\x76\x2f\x31\x01"),
    "HDF5": ((".h5", ".hdf5", ".vox"), rb"\x89HDF\r\n\x1a\n"),
    "Lytro": ((".lfp", ".lfr"), rb"\x89LFP\r\n\x1a\n"),
}
#: Raw photos, many of which begin as a TIFF does: known by their suffix alone.
RAW_PHOTO_SUFFIXES = frozenset(
    {".dng", ".arw", ".cr2", ".cr3", ".nef", ".orf", ".pef", ".raf", ".rw2", ".srw"}
)
#: Suffixes of videos, and FFmpeg's name of the format of raw streams, which have no header that
#: names it.
VIDEO_FORMATS = {
    ".mp4": None,
    ".mkv": None,
    ".mov": None,
    ".avi": None,
    ".webm": None,
    ".y4m": None,
    ".m4v": None,
    ".vvc": "vvc",
    ".266": "vvc",
    ".hevc": "hevc",
    ".265": "hevc",
    ".h264": "h264",
    ".264": "h264",
}
#: Raw planar video, which has no header at all.
RAW_SUFFIX = ".yuv"
IMAGE_SUFFIXES = RAW_PHOTO_SUFFIXES.union(*(suffixes for suffixes, _ in IMAGE_FORMATS.values()))
TIFF_SUFFIXES = IMAGE_FORMATS["TIFF"][0]


def identify_format(head: bytes) -> str | None:
    """Name of the format of a file that begins with these bytes, None where it is not readable."""
    return next(
        (name for name, (_, form) in IMAGE_FORMATS.items() if re.match(form, head, re.DOTALL)), None
    )
