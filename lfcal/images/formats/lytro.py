"""Lytro files (`.lfp`, `.lfr`, calibration archives): sections of JSON and of data, named by their SHA-1.

Pixels are packed: of 12 bits, two in three bytes (F01); of 10 bits, four in five bytes, the last of which has the
lowest bits of all (Illum). They are those of the colour mosaic, as stored.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...runtime.errors import FlatError
from ..decoders import check_size

__all__ = ["read_lytro"]

_MAGIC = b"\r\n\x1a\n"
_SHA1_BYTES = 80  # "sha1-", 40 digits, zeros
_MOST_JSON = 1 << 26
# Width, height and bits of sensors by the bytes of their packed pixels, for archives without descriptions.
_SENSORS = {3280 * 3280 * 12 // 8: (3280, 3280, 12), 7728 * 5368 * 10 // 8: (7728, 5368, 10)}


def read_lytro(path: Path, page: int | None) -> NDArray[np.uint16]:
    """The raw pixels (h, w) of a Lytro file: of its picture, or of white image number `page` of an archive."""
    with path.open("rb") as stream:
        sections = dict(_sections(stream, path.stat().st_size))
        tables = [_parse(_read(stream, place)) for name, place in sections.items() if not name.startswith("sha1-")]
        frames = [found for table in tables for found in _find(table, "imageRef") if found["imageRef"] in sections]
        frames = [frame for frame in frames if frame.get("metadataRef") in sections]
        if frames:
            if page not in (None, 0):
                raise FlatError(f"the Lytro file holds one picture and no page {page}")
            about = _parse(_read(stream, sections[frames[0]["metadataRef"]]))
            return _unpack(_read(stream, sections[frames[0]["imageRef"]]), *_layout(about))
        return _read_white(stream, sections, tables, page)


def _sections(stream: Any, size: int) -> Iterator[tuple[str, tuple[int, int]]]:
    """Name, start and length of each section: its SHA-1, or for tables of contents a number."""
    at, number = 0, 0
    while at + 16 <= size:
        stream.seek(at)
        kind, magic, _, length = struct.unpack(">4s4sII", stream.read(16))
        if magic != _MAGIC or kind not in (b"\x89LFP", b"\x89LFM", b"\x89LFC"):
            raise FlatError(f"damaged Lytro file: no section at byte {at}")
        start = at + 16
        if length:
            name = stream.read(_SHA1_BYTES).rstrip(b"\0").decode("ascii")
            start += _SHA1_BYTES
            if start + length > size:
                raise FlatError(f"truncated Lytro file: {start + length - size} bytes are missing")
            if kind == b"\x89LFM":
                name, number = f"table {number}", number + 1
            yield name, (start, length)
        at = start + -(-length // 16) * 16


def _read(stream: Any, place: tuple[int, int]) -> bytes:
    stream.seek(place[0])
    return bytes(stream.read(place[1]))


def _parse(data: bytes) -> Any:
    if len(data) > _MOST_JSON:
        raise FlatError("damaged Lytro file: a description of more than 64 MB")
    try:
        return json.loads(data.rstrip(b"\0"))
    except (ValueError, RecursionError) as error:
        raise FlatError(f"damaged Lytro file: a description is no JSON ({error})") from error


def _find(value: Any, key: str) -> Iterator[dict[str, Any]]:
    """All objects with a key in a JSON value."""
    if isinstance(value, dict):
        if key in value:
            yield value
        for inner in value.values():
            yield from _find(inner, key)
    elif isinstance(value, list):
        for inner in value:
            yield from _find(inner, key)


def _layout(about: Any) -> tuple[int, int, int]:
    """Width, height and bits by the description of a picture."""
    sized = next((found for found in _find(about, "width") if "height" in found), None)
    packing = next(_find(about, "bitsPerPixel"), None)
    try:
        if sized is None or packing is None:
            raise KeyError("width, height and bitsPerPixel")
        return int(sized["width"]), int(sized["height"]), int(packing["bitsPerPixel"])
    except (KeyError, TypeError, ValueError) as error:
        raise FlatError(f"damaged Lytro file: the size of its picture is missing ({error})") from error


def _unpack(data: bytes, width: int, height: int, bits: int) -> NDArray[np.uint16]:
    """(height, width) the pixels of packed data."""
    check_size(width, height)
    if bits not in (10, 12) or (width * height * bits) % 40:
        raise FlatError(f"Lytro pixels of {bits} bits, {width} x {height} px, are not read")
    size = width * height * bits // 8
    if len(data) < size:
        raise FlatError(f"truncated Lytro file: {size - len(data)} bytes of pixels are missing")
    packed = np.frombuffer(data, np.uint8, size).astype(np.uint16)
    pixels = np.empty(width * height, np.uint16)
    if bits == 12:
        first, middle, last = packed.reshape(-1, 3).T
        pixels[0::2], pixels[1::2] = first << 4 | middle >> 4, (middle & 15) << 8 | last
    else:
        *high, low = packed.reshape(-1, 5).T
        for k, eight in enumerate(high):
            pixels[k::4] = eight << 2 | low >> (2 * k) & 3
    return pixels.reshape(height, width)


def _read_white(
    stream: Any, sections: dict[str, tuple[int, int]], tables: list[Any], page: int | None
) -> NDArray[np.uint16]:
    """White image number `page` of a calibration archive."""
    files = {
        str(entry.get("name", "")).upper(): sections[entry["dataRef"]]
        for table in tables
        for entry in _find(table, "dataRef")
        if entry["dataRef"] in sections
    }
    raw = sorted(name for name in files if name.endswith(".RAW"))
    if not raw:
        raise FlatError("holds no raw picture; open it with Lytro Desktop and export the raw one (.lfr, .lfp)")
    if page is None and len(raw) > 1:
        raise FlatError(f"the archive holds {len(raw)} white images; give the number of one (--page)")
    if not 0 <= (page or 0) < len(raw):
        raise FlatError(f"the archive holds {len(raw)} white images and no page {page}")
    name = raw[page or 0]
    data, about = _read(stream, files[name]), files.get(name[:-4] + ".TXT")
    if about is not None:
        return _unpack(data, *_layout(_parse(_read(stream, about))))
    if len(data) not in _SENSORS:
        raise FlatError(f"the size of the white image {name} is not known")
    return _unpack(data, *_SENSORS[len(data)])
