"""Pixels of decoded video frames, converted by FFmpeg (PyAV) to the nearest value, and back."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FlatError

__all__ = ["convert_frame", "frame_of_planes", "import_av", "plane_bytes", "rgb_pixels"]


def import_av(path: str | os.PathLike[str]) -> Any:
    """The package `av`; FlatError with the name of the file that needs it if it is not installed."""
    try:
        import av
    except ImportError as error:
        raise FlatError(f"{path}: videos need the package 'av'; pip install 'lfrender[video]'") from error
    return av


def convert_frame(frame: Any, name: str, **options: Any) -> Any:
    """A frame of PyAV in another pixel format, rounded to the nearest value.

    FFmpeg's defaults, which cut off and read colours at every second pixel, make 8-bit videos 1.3 grey levels too dark.
    """
    from av.video.reformatter import Interpolation as Flags

    flags = (Flags.BICUBIC, Flags.ACCURATE_RND, Flags.FULL_CHR_H_INT, Flags.FULL_CHR_H_INP)
    return frame.reformat(format=name, interpolation=sum(map(int, flags)), **options)


def rgb_pixels(frame: Any) -> NDArray[Any]:
    """(h, w, 3) pixels of a frame of PyAV: uint16 where it has more than 8 bits a colour, else uint8."""
    deep = re.search(r"1[0-6](le|be)?$", frame.format.name)
    if not deep:
        return np.ascontiguousarray(convert_frame(frame, "rgb24").to_ndarray())
    # Without the copies that `to_ndarray` makes.
    plane = frame.reformat(format="rgb48le").planes[0]
    rows = np.frombuffer(plane, "<u2").reshape(plane.height, plane.line_size // 2)
    return np.ascontiguousarray(
        rows[:, : 3 * plane.width].reshape(plane.height, plane.width, 3).astype(np.uint16, copy=False)
    )


def plane_bytes(frame: Any) -> bytes:
    """The planes of a frame of PyAV, row by row without gaps."""
    depth = 2 if re.search(r"1[0-6](le|be)?$", frame.format.name) else 1
    rows = (np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size) for plane in frame.planes)
    return b"".join(row[:, : depth * plane.width].tobytes() for row, plane in zip(rows, frame.planes, strict=True))


def frame_of_planes(data: bytes | memoryview, width: int, height: int, name: str) -> Any:
    """A frame of PyAV in the pixel format `name` from the bytes of its planes, row by row without gaps."""
    from av import VideoFrame

    frame, start = VideoFrame(width, height, name), 0
    depth = 2 if re.search(r"1[0-6](le|be)?$", name) else 1
    for plane in frame.planes:
        row = plane.width * depth
        size = row * plane.height
        pixels = np.frombuffer(data, np.uint8, size, start).reshape(plane.height, row)
        padded = np.zeros((plane.height, plane.line_size), np.uint8)
        padded[:, :row] = pixels
        plane.update(padded.tobytes())
        start += size
    return frame
