"""Raw planar video (`.yuv`) of pictures: their frames, and a file for each view of a grid.

Files are named and numbered as the converters for lenslet video (TLCT) do: `v000-1920x1080.yuv` is
the view at the top left, the others follow row by row.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.runtime.arrays import Array
from lfcal.runtime.output_file import atomic_write, make_folder, refuse_leftovers
from lfcal.runtime.video import convert_frame, parse_pixel_format

from ..runtime.types import AnyPath
from .finish import FILM_WHITE, Finish
from .formats import FORMATS, PictureError, check_format_package

__all__ = ["check_raw_format", "frame_bytes", "view_name", "write_view_videos", "yuv_frame"]


def check_raw_format(folder: AnyPath, pixel_format: str, quality: int | None = None) -> str:
    """The full name of a pixel format; PictureError if it cannot be written.

    `"yuv"` stands for 4:2:0 with 10 bits. It has no `quality`.
    """
    check_format_package(Path(folder) / "v000.yuv", FORMATS[".yuv"], quality)
    if pixel_format == "yuv":
        return "yuv420p10"
    try:
        parse_pixel_format(pixel_format)
    except ValueError as error:
        raise PictureError(f"{folder}: {error}") from error
    return pixel_format


def view_name(number: int, width: int, height: int) -> str:
    """Name of the file of a view."""
    return f"v{number:03d}-{width}x{height}.yuv"


def yuv_frame(pixels: Array, pixel_format: str, **colours: Any) -> Any:
    """A frame of PyAV, by default BT.601 of limited range, as FFmpeg reads raw video.

    `colours` are further arguments of `convert_frame`.

    `pixels` are (h, w) or (h, w, 3), uint8, uint16 or float, as `Finish` makes them. A last column
    or row without a partner is left out where the format shares colours.
    """
    from av import VideoFrame

    name, subsampling, _ = parse_pixel_format(pixel_format)
    height, width = pixels.shape[:2]
    if subsampling == "420" and height > 1:
        height -= height % 2
    if subsampling in ("420", "422") and width > 1:
        width -= width % 2
    pixels = pixels[:height, :width]
    if pixels.dtype.kind == "f":
        share = np.clip(np.nan_to_num(pixels), 0, 1)
        pixels = np.rint(share * FILM_WHITE).astype(np.uint16)
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, 2)
    frame = VideoFrame.from_ndarray(
        np.ascontiguousarray(pixels), format="rgb24" if pixels.dtype == np.uint8 else "rgb48le"
    )
    return convert_frame(frame, name, **colours)


def frame_bytes(frame: Any) -> bytes:
    """The planes of a frame of PyAV, row by row without gaps."""
    from av import CodecContext

    encoder = CodecContext.create("rawvideo", "w")
    encoder.width, encoder.height, encoder.pix_fmt = frame.width, frame.height, frame.format.name
    encoder.time_base = Fraction(1, 25)
    return b"".join(map(bytes, encoder.encode(frame)))


def write_view_videos(
    folder: AnyPath,
    pictures: Iterable[Any],
    pixel_format: str = "yuv420p10",
    finish: Finish | None = None,
) -> list[Path]:
    """Write each view, row by row, as raw video of one frame, `v000-1920x1080.yuv` and so on.

    `finish` is what is done to all of them, by default as `write_picture` does.

    OutputError or PictureError if the folder or a file cannot be written, or holds views of an
    earlier run that these do not replace.
    """
    name = check_raw_format(folder, pixel_format)
    make_folder(folder)
    paths = []
    finish = finish or Finish("view.yuv")
    for number, picture in enumerate(finish.apply_to_all(pictures)):
        frame = yuv_frame(picture.image, name)
        paths.append(Path(folder) / view_name(number, frame.width, frame.height))
        with atomic_write(paths[-1]) as temporary:
            temporary.write_bytes(frame_bytes(frame))
    refuse_leftovers(Path(folder), r"v\d{3,}-\d+x\d+\.yuv", [path.name for path in paths])
    return paths
