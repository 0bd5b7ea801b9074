"""Single frames of videos as flats: videos that FFmpeg decodes, and raw planar video (`.yuv`).

Raw video has no header. Size, subsampling and bits are given, or follow from the name of the file
(such as `Boys2_3976x2956_30fps_420p10.yuv`), from a camera file `.cfg` of the same name beside it,
and the bits from the samples.
"""

from __future__ import annotations

import re
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..runtime.arrays import Array
from ..runtime.errors import FlatError
from ..runtime.image_formats import RAW_SUFFIX, VIDEO_FORMATS
from ..runtime.types import Page, Size
from ..runtime.video import import_av, parse_pixel_format, rgb_pixels
from .pixels import check_page, check_size

__all__ = ["RawLayout", "count_yuv_frames", "find_layout", "is_yuv", "read_video_frame", "read_yuv"]

# Samples of brightness for one of each colour plane, across and down.
_SHARES = {"420": (2, 2), "422": (2, 1), "444": (1, 1)}


class RawLayout(NamedTuple):
    """Layout of a frame of raw video."""

    width: int  # [px]
    height: int
    pixel_format: str  # FFmpeg's name
    bits: int  # bits of a sample
    frame_bytes: int


def read_video_frame(path: Path, page: Page) -> Array:
    """(h, w, 3) frame `page` or the only frame of a video: uint16 above 8 bits, else uint8."""
    if page is not None and page < 0:
        raise FlatError(f"has no frame {page}")
    av = import_av(path.name)
    number = page or 0
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
            # Decoders fill missing parts in, so that the frame is no flat.
            if picture.is_corrupt:
                raise FlatError(f"frame {number} is damaged")
            pixels = rgb_pixels(picture)
            if page is None and next(frames, None) is not None:
                advice = "give the number of one (--page), or use 'lfrender batch'"
                raise FlatError(f"the video holds several frames; {advice}")
            return pixels
    except av.error.FFmpegError as error:
        raise FlatError(f"cannot be read as a video ({error.strerror})") from error


def is_yuv(path: Path) -> bool:
    """Whether a file has the suffix of raw planar video."""
    return path.suffix.lower() == RAW_SUFFIX


def count_yuv_frames(path: Path, size: Size | None, pixel_format: str | None) -> int:
    """Number of frames; a truncated one counts too, but cannot be read."""
    return -(-path.stat().st_size // find_layout(path, size, pixel_format).frame_bytes)


def read_yuv(path: Path, page: Page, size: Size | None, pixel_format: str | None) -> Array:
    """(h, w, 3) frame `page` or the only frame of raw video: uint16 above 8 bits, else uint8.

    Colours are converted as FFmpeg converts a frame without a colour space: BT.601, limited range.
    Of files without colours the samples (h, w) are returned as they are.
    """
    layout = find_layout(path, size, pixel_format)
    number = check_page(
        page, -(-path.stat().st_size // layout.frame_bytes), "video", "frames", "frame"
    )
    with path.open("rb") as stream:
        stream.seek(number * layout.frame_bytes)
        data = stream.read(layout.frame_bytes)
    width, height, kind, bits, length = layout
    if len(data) < length:
        given = f"frame {number} has {len(data)} of {length} bytes"
        raise FlatError(
            f"truncated raw video: {given}; is its size {width} x {height} px {kind} (--size)?"
        )
    if kind.startswith("gray"):
        return np.frombuffer(data, "<u2" if bits > 8 else np.uint8).reshape(height, width)
    options = {"video_size": f"{width}x{height}", "pixel_format": kind}
    with import_av(path).open(BytesIO(data), format="rawvideo", options=options) as film:
        return rgb_pixels(next(film.decode(video=0)))


def find_layout(path: Path, size: Size | None = None, pixel_format: str | None = None) -> RawLayout:
    """The layout of raw video, given or from its name, a `.cfg` file beside it and its samples.

    FlatError if the size or the pixel format is unknown, or the file is shorter than one frame.
    """
    size = size or _size_of(path)
    if size is None:
        raise FlatError(
            "raw video has no header; give its size (--size WxH), or name it like "
            "NAME_2048x2048.yuv"
        )
    width, height = size
    if pixel_format is None:
        subsampling, named = _format_in_name(path.stem)
        bits = named or _bits_of_samples(path, width * height)
        pixel_format = f"{subsampling or '420'}p{bits}"
    try:
        name, kind, bits = parse_pixel_format(pixel_format)
    except ValueError as error:
        raise FlatError(str(error)) from error
    samples = width * height
    if kind != "400":
        samples += 2 * -(-width // _SHARES[kind][0]) * -(-height // _SHARES[kind][1])
    length = samples * (2 if bits > 8 else 1)
    if path.stat().st_size < length:
        wanted = f"a frame of {width} x {height} px {name} has {length}"
        advice = "it is truncated, or --size or --pixel-format are others"
        raise FlatError(f"holds {path.stat().st_size} bytes, {wanted}; {advice}")
    check_size(width, height)
    return RawLayout(width, height, name, bits, length)


def _size_of(path: Path) -> Size | None:
    if sizes := re.findall(r"(?<!\d)(\d{2,6})[xX](\d{2,6})(?!\d)", path.stem):
        return int(sizes[-1][0]), int(sizes[-1][1])
    camera = path.with_suffix(".cfg")
    try:
        text = ""
        if camera.stat().st_size < 1 << 16:
            text = camera.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return None
    width, height = (
        re.search(rf"(?m)^\s*Lenslet{side}\s*:\s*(\d+)", text) for side in ("Width", "Height")
    )
    if width and height:
        return (int(width[1]), int(height[1]))
    return None


def _format_in_name(name: str) -> tuple[str | None, int | None]:
    """Subsampling and bits in a name such as `yuv420p10le`, `420p_10b`, `p444_12bit`, `gray8`."""
    words = re.sub(r"\d{2,6}[xX]\d{2,6}", " ", name.lower())
    words = re.sub(r"(?<![a-z])gr[ae]y(?=(?:8|10|12)(?!\d))", "400p", words)
    subsampling = re.search(r"(?<!\d)(?:yuv|p)?(400|420|422|444)(?!\d)p?(8|10|12)?(?:le)?", words)
    bits = re.search(r"(?<!\d)(8|10|12)[-_ ]?(?:bits?|bpp|b)(?![a-z0-9])", words)
    named = (subsampling and subsampling[2]) or (bits and bits[1])
    return subsampling and subsampling[1], int(named) if named else None


def _bits_of_samples(path: Path, pixels: int) -> int:
    """Bits of the samples of a file: 10 or 12 if all 16-bit numbers in it are as small, else 8."""
    if path.stat().st_size < 2 * pixels:
        return 8
    largest = int(np.fromfile(path, "<u2", pixels).max())
    return next((bits for bits in (10, 12) if largest < 1 << bits), 8)
