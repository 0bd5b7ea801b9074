"""Pixels of video, converted by FFmpeg (PyAV), and names of raw pixel formats.

PyAV is the extra `video`. Values are rounded to the nearest one.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from .arrays import Array
from .errors import FlatError
from .packages import import_package
from .types import AnyPath

__all__ = ["convert_frame", "import_av", "parse_pixel_format", "rgb_pixels"]


def import_av(path: AnyPath) -> Any:
    """The package `av`; FlatError with the name of the file if it is not installed."""
    return import_package("av", f"{path}: videos need", FlatError)


def convert_frame(frame: Any, name: str, **options: Any) -> Any:
    """A frame of PyAV in another pixel format, rounded to the nearest value.

    FFmpeg's defaults, which cut off and read colours at every second pixel, make 8-bit videos 1.3
    grey levels too dark.
    """
    from av.video.reformatter import Interpolation as Flags

    flags = (Flags.BICUBIC, Flags.ACCURATE_RND, Flags.FULL_CHR_H_INT, Flags.FULL_CHR_H_INP)
    return frame.reformat(format=name, interpolation=sum(map(int, flags)), **options)


def rgb_pixels(frame: Any) -> Array:
    """Pixels (h, w, 3) of a frame of PyAV.

    They are uint16 if the frame has more than 8 bits a colour, else uint8.
    """
    if max(component.bits for component in frame.format.components) <= 8:
        frame = convert_frame(frame, "rgb24")
    else:
        frame = frame.reformat(format="rgb48le")
    return np.ascontiguousarray(frame.to_ndarray())


def parse_pixel_format(text: str) -> tuple[str, str, int]:
    """FFmpeg's name, subsampling and bits of a pixel format such as `"yuv420p10"`.

    ValueError if the format is not known.
    """
    found = re.fullmatch(
        r"(?:yuv)?(420|422|444)p?(8|10|12)?(?:le)?|(?:gray|400p?)(8|10|12)?(?:le)?", text.lower()
    )
    if not found:
        raise ValueError(
            "a pixel format is yuv420p, yuv422p, yuv444p or gray, with 10 or 12 for bits, "
            f"got {text!r}"
        )
    subsampling = found[1] or "400"
    bits = int(found[2] or found[3] or 8)
    name = f"yuv{subsampling}p"
    if subsampling == "400":
        name = "gray"
    return name if bits == 8 else f"{name}{bits}le", subsampling, bits
