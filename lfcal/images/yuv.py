"""Frames of raw planar video (`.yuv`) as flats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.video.frame_pixels import frame_of_planes, import_av, rgb_pixels
from ..runtime.video.raw_format import RAW_SUFFIX, RawFormat, find_raw_format
from .decoders import check_size

__all__ = ["count_yuv_frames", "is_yuv", "read_yuv"]


def is_yuv(path: Path) -> bool:
    """Whether a path has the suffix of raw video."""
    return path.suffix.lower() == RAW_SUFFIX


def count_yuv_frames(path: Path, size: tuple[int, int] | None, pixel_format: str | None) -> int:
    """Number of frames; one that is cut off counts too, but cannot be read."""
    return -(-path.stat().st_size // _checked_format(path, size, pixel_format).frame_bytes)


def read_yuv(path: Path, page: int | None, size: tuple[int, int] | None, pixel_format: str | None) -> NDArray[Any]:
    """Pixels (h, w, 3) of frame `page`, or of the only frame: uint8, or uint16 where samples have more bits.

    Colours are those that FFmpeg gives a decoded frame without a colour space: BT.601 of limited range. Files without
    colours give their samples (h, w) as they are.
    """
    layout = _checked_format(path, size, pixel_format)
    count = -(-path.stat().st_size // layout.frame_bytes)
    if page is None and count > 1:
        raise FlatError(f"the video holds {count} frames; give the number of one, or use 'lfrender batch'")
    if not 0 <= (page or 0) < count:
        raise FlatError(f"the video holds {count} frames and no frame {page}")
    with path.open("rb") as stream:
        stream.seek((page or 0) * layout.frame_bytes)
        data = stream.read(layout.frame_bytes)
    if len(data) < layout.frame_bytes:
        raise FlatError(
            f"truncated raw video: frame {page or 0} has {len(data)} of {layout.frame_bytes} bytes "
            f"({layout.width} x {layout.height} px {layout.pixel_format}); is that its size (--size)?"
        )
    if layout.subsampling == "400":
        return np.frombuffer(data, "<u2" if layout.bits > 8 else np.uint8).reshape(layout.height, layout.width)
    import_av(path)
    return rgb_pixels(frame_of_planes(data, layout.width, layout.height, layout.pixel_format))


def _checked_format(path: Path, size: tuple[int, int] | None, pixel_format: str | None) -> RawFormat:
    layout = find_raw_format(path, size, pixel_format)
    check_size(layout.width, layout.height)
    return layout
