"""A single frame of a compressed video as a flat; `lfrender.sequence` decodes whole ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ...runtime.errors import FlatError
from ...runtime.image_formats import VIDEO_FORMATS
from ...runtime.video.frame_pixels import import_av, rgb_pixels
from ..decoders import check_size

__all__ = ["read_video_frame"]


def read_video_frame(path: Path, page: int | None) -> NDArray[Any]:
    """(h, w, 3) frame `page`, or the only frame, decoded from the first one on: uint16 above 8 bits, else uint8."""
    if page is not None and page < 0:
        raise FlatError(f"has no frame {page}")
    av, found = import_av(path.name), None
    try:
        with av.open(str(path), format=VIDEO_FORMATS[path.suffix.lower()]) as container:
            if not container.streams.video:
                raise FlatError("there is no video in it")
            container.streams.video[0].thread_type = "AUTO"
            for number, picture in enumerate(container.decode(video=0)):
                check_size(picture.width, picture.height)
                if page is None and number:
                    raise FlatError("the video holds several frames; give the number of one, or use 'lfrender batch'")
                # Decoders fill in what is missing; such a flat must not be calibrated or rendered.
                if number == (page or 0):
                    if picture.is_corrupt:
                        raise FlatError(f"frame {number} is damaged")
                    found = rgb_pixels(picture)
                if number == page:
                    break
    except av.error.FFmpegError as error:
        raise FlatError(f"cannot be read as a video ({error.strerror})") from error
    if found is None:
        raise FlatError(f"the video has no frame {page or 0}")
    return found
