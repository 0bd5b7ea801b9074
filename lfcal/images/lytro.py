"""Lytro files (`.lfp`, `.lfr`, calibration archives): JSON, and data with SHA-1 names.

Pixels of the colour mosaic are packed: two of 12 bits in three bytes (F01), or four of 10 bits in
five bytes, of which the last one holds the lowest bits of all four (Illum).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.input_file import LARGEST_TEXT
from ..runtime.types import Entries, Page
from .pixels import check_only_page, check_page, check_size

__all__ = ["read_lytro", "unpack_pixels"]

_HEAD = struct.Struct(">4s4sII")
_SHA1_BYTES = 80  # "sha1-", 40 digits, zeros
# Width, height and bits of sensors by the bytes of their packed pixels, for archives without
# descriptions.
_SENSORS = {
    width * height * bits // 8: (width, height, bits)
    for width, height, bits in ((3280, 3280, 12), (7728, 5368, 10))
}

_REMEDY = (
    "these are made from the raw one, which lies beside it in the library of Lytro Desktop and on "
    "the camera: raw.lfp or IMG_1234.lfp without -stk (first camera), IMG_1234.LFR (Illum)"
)


def read_lytro(path: Path, page: Page) -> NDArray[np.uint16]:
    """(h, w) raw pixels of the picture in a Lytro file, or of white image `page` in an archive."""
    data = memoryview(path.read_bytes())
    sections = dict(_sections(data))
    tables = [_parse(part) for name, part in sections.items() if not name.startswith("sha1-")]
    for frame in (found for table in tables for found in _find(table, "imageRef")):
        if frame["imageRef"] in sections and frame.get("metadataRef") in sections:
            check_only_page(page)
            return unpack_pixels(
                sections[frame["imageRef"]], *_layout(sections[frame["metadataRef"]])
            )
    entries = (
        entry
        for table in tables
        for entry in _find(table, "dataRef")
        if entry["dataRef"] in sections
    )
    files = {str(entry.get("name", "")).upper(): sections[entry["dataRef"]] for entry in entries}
    raw = sorted(name for name in files if name.endswith(".RAW"))
    if not raw:
        count = sum(bytes(data[:3]) == b"\xff\xd8\xff" for data in sections.values())
        raise FlatError(f"holds no raw picture, only {count} finished pictures (JPEG); {_REMEDY}")
    name = raw[check_page(page, len(raw), "archive", "white images", "page")]
    about = files.get(name[:-4] + ".TXT")
    layout = _layout(about) if about is not None else _SENSORS.get(len(files[name]))
    if layout is None:
        raise FlatError(f"the size of the white image {name} is not known")
    return unpack_pixels(files[name], *layout)


def _sections(data: memoryview) -> Iterator[tuple[str, memoryview]]:
    """Name and bytes of each section; the name is its SHA-1, for tables of contents its place."""
    at = 0
    while at + _HEAD.size <= len(data):
        kind, magic, _, length = _HEAD.unpack_from(data, at)
        if magic != b"\r\n\x1a\n" or kind not in (b"\x89LFP", b"\x89LFM", b"\x89LFC"):
            raise FlatError(f"damaged Lytro file: no section at byte {at}")
        start = at + _HEAD.size
        if length:
            name = bytes(data[start : start + _SHA1_BYTES]).rstrip(b"\0").decode("ascii")
            start += _SHA1_BYTES
            if start + length > len(data):
                raise FlatError(
                    f"truncated Lytro file: {start + length - len(data)} bytes are missing"
                )
            yield f"table {at}" if kind == b"\x89LFM" else name, data[start : start + length]
        at = start + -(-length // 16) * 16


def _parse(data: memoryview) -> Any:
    if len(data) > LARGEST_TEXT:
        raise FlatError("damaged Lytro file: a description of more than 64 MB")
    try:
        return json.loads(bytes(data).rstrip(b"\0"))
    except (ValueError, RecursionError) as error:
        raise FlatError(f"damaged Lytro file: a description is no JSON ({error})") from error


def _find(value: Any, key: str) -> Iterator[Entries]:
    if isinstance(value, dict) and key in value:
        yield value
    inner = value
    if isinstance(value, dict):
        inner = list(value.values())
    if isinstance(inner, list):
        for one in inner:
            yield from _find(one, key)


def _layout(about: memoryview) -> tuple[int, int, int]:
    described = _parse(about)
    try:
        sized = next(found for found in _find(described, "width") if "height" in found)
        bits = next(_find(described, "bitsPerPixel"))["bitsPerPixel"]
        return int(sized["width"]), int(sized["height"]), int(bits)
    except (StopIteration, TypeError, ValueError) as error:
        raise FlatError(
            "damaged Lytro file: width, height or bitsPerPixel of its picture are missing"
        ) from error


def unpack_pixels(data: memoryview, width: int, height: int, bits: int) -> NDArray[np.uint16]:
    """(height, width) the pixels of packed data."""
    import imagecodecs

    check_size(width, height)
    # Four pixels of 10 bits, or two of 12, fill whole bytes.
    if bits not in (10, 12) or width * height % 4:
        raise FlatError(f"Lytro pixels of {bits} bits, {width} x {height} px, are not read")
    size = width * height * bits // 8
    if len(data) < size:
        raise FlatError(f"truncated Lytro file: {size - len(data)} bytes of pixels are missing")
    if bits == 12:
        packed = bytes(data[:size])
        return imagecodecs.packints_decode(packed, np.uint16, bits).reshape(height, width)
    fives = np.frombuffer(data, np.uint8, size).reshape(-1, 5).astype(np.uint16)
    lowest = fives[:, 4:] >> np.arange(0, 8, 2, dtype=np.uint16) & 3
    pixels = fives[:, :4] << 2 | lowest
    return pixels.astype(np.uint16, copy=False).reshape(height, width)
