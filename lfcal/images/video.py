"""Single frames of videos as flats: raw planar video (`.yuv`) and what FFmpeg decodes."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.image_formats import VIDEO_FORMATS
from ..runtime.video.frame_pixels import frame_of_planes, import_av, rgb_pixels
from ..runtime.video.raw_format import RAW_SUFFIX, RawFormat, find_raw_format
from .pixels import check_size

__all__ = ["count_yuv_frames", "is_yuv", "read_video_frame", "read_yuv"]


def is_yuv(path: Path) -> bool:
    """Whether a path has the suffix of raw video."""
    return path.suffix.lower() == RAW_SUFFIX


def count_yuv_frames(path: Path, size: tuple[int, int] | None, pixel_format: str | None) -> int:
    """Number of frames; one that is cut off counts too, but cannot be read."""
    return _layout_and_count(path, size, pixel_format)[1]


def read_yuv(path: Path, page: int | None, size: tuple[int, int] | None, pixel_format: str | None) -> NDArray[Any]:
    """Pixels (h, w, 3) of frame `page`, or of the only frame: uint8, or uint16 where samples have more bits.

    Colours are those that FFmpeg gives a decoded frame without a colour space: BT.601 of limited range. Files without
    colours give their samples (h, w) as they are.
    """
    layout, count = _layout_and_count(path, size, pixel_format)
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


def _layout_and_count(path: Path, size: tuple[int, int] | None, pixel_format: str | None) -> tuple[RawFormat, int]:
    layout = find_raw_format(path, size, pixel_format)
    check_size(layout.width, layout.height)
    return layout, -(-path.stat().st_size // layout.frame_bytes)


def read_video_frame(path: Path, page: int | None) -> NDArray[Any]:
    """(h, w, 3) frame `page`, or the only frame, decoded from the first one on: uint16 above 8 bits, else uint8."""
    if page is not None and page < 0:
        raise FlatError(f"has no frame {page}")
    av, number = import_av(path.name), page or 0
    try:
        with av.open(str(path), format=VIDEO_FORMATS[path.suffix.lower()]) as container:
            if not container.streams.video:
                raise FlatError("there is no video in it")
            container.streams.video[0].thread_type = "AUTO"
            frames = container.decode(video=0)
            picture = next(islice(frames, number, None), None)
            if picture is None:
                raise FlatError(f"the video has no frame {number}")
            check_size(picture.width, picture.height)
            # Decoders fill in what is missing; such a flat must not be calibrated or rendered.
            if picture.is_corrupt:
                raise FlatError(f"frame {number} is damaged")
            pixels = rgb_pixels(picture)
            if page is None and next(frames, None) is not None:
                raise FlatError("the video holds several frames; give the number of one, or use 'lfrender batch'")
            return pixels
    except av.error.FFmpegError as error:
        raise FlatError(f"cannot be read as a video ({error.strerror})") from error
