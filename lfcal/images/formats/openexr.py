"""OpenEXR pictures as flats: channels R, G, B or one of brightness, as float."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...runtime.errors import FlatError
from ..decoders import check_size

__all__ = ["read_openexr"]

_HEADER = 1 << 16


def read_openexr(path: Path, page: int | None) -> NDArray[np.float32]:
    """(h, w) or (h, w, 3) the only picture of an OpenEXR file."""
    try:
        import OpenEXR
    except ImportError as error:
        raise FlatError("OpenEXR needs the package 'OpenEXR'; pip install 'lfrender[exr]'") from error
    if page not in (None, 0):
        raise FlatError(f"has one picture and no page {page}")
    _check_header(path)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        # The library leaves out what it cannot decode.
        if not file.parts:
            raise FlatError("damaged or truncated OpenEXR")
        if len(file.parts) != 1:
            raise FlatError(f"the OpenEXR file holds {len(file.parts)} pictures; save the one that is the flat alone")
        channels: dict[str, Any] = {name: channel.pixels for name, channel in file.channels().items()}
        if {"R", "G", "B"} <= set(channels):
            return np.stack([channels[name] for name in "RGB"], -1).astype(np.float32)
        named = [name for name in ("Y", "L", "luminance") if name in channels] or list(channels)[: len(channels) == 1]
        if not named:
            raise FlatError(f"holds the channels {', '.join(sorted(channels))}; save R, G, B or one channel")
        return np.asarray(channels[named[0]], np.float32)


def _check_header(path: Path) -> None:
    """FlatError for a size that cannot be, before the library sets memory aside for it."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER)
    at = head.find(b"dataWindow\0box2i\0")
    if at < 0 or len(head) < at + 37:
        raise FlatError("damaged OpenEXR: the size is missing")
    left, top, right, bottom = struct.unpack_from("<4i", head, at + 21)
    check_size(right - left + 1, bottom - top + 1)
    # Every block of at most 256 rows has an entry of 8 bytes in a table.
    if path.stat().st_size < (bottom - top + 1) / 256 * 8:
        raise FlatError("truncated OpenEXR")
