"""Colour profile and camera data (EXIF) of a flat's file, read from it and put into the files of its pictures."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["EmbeddedMetadata", "embed_in_png", "read_metadata"]

_EXIF_HEADER = b"Exif\0\0"


@dataclass(frozen=True)
class EmbeddedMetadata:
    """ICC profile, and EXIF data without thumbnail and sizes; empty where there is none."""

    icc: bytes = b""
    exif: bytes = b""


def read_metadata(path: str | os.PathLike[str]) -> EmbeddedMetadata:
    """Colour profile and EXIF data of an image file.

    PNG, JPEG and WebP may hold both, of TIFF the profile is read. What cannot be read is left out: the pixels matter
    more.
    """
    source = Path(path)
    try:
        with source.open("rb") as stream:
            start = stream.read(4)
        return _read_tiff(source) if start[:2] in (b"II", b"MM") else _read_image(source)
    # Readers raise errors of any kind on damaged data.
    except Exception:
        return EmbeddedMetadata()


def _read_tiff(source: Path) -> EmbeddedMetadata:
    import tifffile

    with tifffile.TiffFile(source) as tiff:
        page: Any = tiff.pages[0]
        tag = page.tags.get("InterColorProfile")
        return EmbeddedMetadata(b"" if tag is None else bytes(tag.value))


def _read_image(source: Path) -> EmbeddedMetadata:
    from PIL import JpegImagePlugin, PngImagePlugin, WebPImagePlugin

    # The format's own class is used, not Image.open: that one refuses sensors above 179 megapixels.
    jpeg = JpegImagePlugin.JpegImageFile
    readers: dict[str, Any] = {".png": PngImagePlugin.PngImageFile, ".jpg": jpeg, ".jpeg": jpeg}
    readers[".webp"] = WebPImagePlugin.WebPImageFile
    with readers[source.suffix.lower()](str(source)) as image:
        exif = image.getexif()
        camera_data = exif.get_ifd(0x8769)
        # Width and height of the flat, which are not those of the picture.
        for tag in (0x0100, 0x0101, 0xA002, 0xA003):
            exif.pop(tag, None)
            camera_data.pop(tag, None)
        return EmbeddedMetadata(image.info.get("icc_profile") or b"", exif.tobytes() if len(exif) else b"")


def embed_in_png(data: bytes, text: str, embedded: EmbeddedMetadata) -> bytes:
    """A PNG file with a description, the profile and EXIF data put in after its header."""
    after_header = 8 + 12 + 13
    chunks = _chunk(b"tEXt", b"Description\0" + text.encode("ascii"))
    if embedded.icc:
        chunks = _chunk(b"iCCP", b"ICC profile\0\0" + zlib.compress(embedded.icc)) + chunks
    if embedded.exif:
        chunks += _chunk(b"eXIf", embedded.exif.removeprefix(_EXIF_HEADER))
    return data[:after_header] + chunks + data[after_header:]


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
