"""The frames of a sequence: image files, folders of them, pages of a TIFF, videos."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import FlatError, count_pages, read_flat
from lfcal.runtime.image_formats import IMAGE_SUFFIXES, TIFF_SUFFIXES

__all__ = ["Frame", "Frames", "convert_pixels", "is_video", "open_frames"]

# Raw streams have no header that names their codec.
_VIDEOS = {
    ".mp4": None, ".mkv": None, ".mov": None, ".avi": None, ".webm": None, ".y4m": None, ".m4v": None,
    ".vvc": "vvc", ".266": "vvc", ".hevc": "hevc", ".265": "hevc", ".h264": "h264", ".264": "h264",
}  # fmt: skip
# Without rounding and with colours only at every second pixel, as FFmpeg has it else, 8-bit videos would come out 1.3
# grey levels too dark.
_EXACT = "BICUBIC", "ACCURATE_RND", "FULL_CHR_H_INT", "FULL_CHR_H_INP"
# Videos whose pixels have more than 8 bits a colour are read with 16.
_DEEP = re.compile(r"1[0-6](le|be)?$")


@dataclass(frozen=True)
class Frame:
    """One frame of a sequence.

    Parameters
    ----------
    name : str
        Of its picture, without a suffix.
    read : callable
        Gives the flat (h, w) or (h, w, 3); raises FlatError where it cannot be read.
    source : Path or None
        Its image file, whose colour profile and EXIF data its picture keeps; None for frames of videos.
    """

    name: str
    read: Callable[[], NDArray[Any]]
    source: Path | None = None


@dataclass(frozen=True)
class _Part:
    """An input: a file, the names of its frames, None where only decoding tells how many there are."""

    path: Path
    names: tuple[str, ...] | None


@dataclass(frozen=True)
class Frames:
    """A sequence of frames; iterating gives them one by one, from the first one on each time."""

    parts: tuple[_Part, ...]

    @property
    def count(self) -> int | None:
        """Number of frames, None where a video does not say."""
        counts = [_video_length(part.path) if part.names is None else len(part.names) for part in self.parts]
        return None if None in counts else sum(c for c in counts if c is not None)

    @property
    def rate(self) -> Fraction | None:
        """Frames a second of the first video that says, None where there is none."""
        return next(filter(None, (_video_rate(part.path) for part in self.parts if part.names is None)), None)

    @property
    def files(self) -> list[Path]:
        """The files that the frames are read from."""
        return [part.path for part in self.parts]

    def __iter__(self) -> Iterator[Frame]:
        for part in self.parts:
            if part.names is None:
                yield from _video_frames(part.path)
                continue
            for page, name in enumerate(part.names):
                yield Frame(name, partial(read_flat, part.path, page if len(part.names) > 1 else None), part.path)


def open_frames(inputs: Iterable[str | os.PathLike[str]]) -> Frames:
    """Find the frames in files and folders; nothing is decoded yet.

    Parameters
    ----------
    inputs : path-likes
        Image files, TIFF files of several pages, videos (these need the package `av`: `pip install 'lfrender[video]'`),
        and folders, whose image files are taken in the order of the numbers in their names.

    Raises
    ------
    FlatError
        If there is no frame, an input is of no known kind, or two frames would have the same name.
    """
    parts = [part for path in inputs for part in _parts(Path(path).absolute())]
    if not parts:
        raise FlatError("no frames: give image files, a folder of them, a TIFF of several pages or a video")
    names = [name for part in parts for name in (part.names or (part.path.stem,))]
    twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if twice:
        raise FlatError(f"{len(twice)} frames would have the same name, such as '{twice[0]}'; give them one by one")
    return Frames(tuple(parts))


def is_video(path: Path) -> bool:
    """Whether a name ends as those of videos do."""
    return path.suffix.lower() in _VIDEOS and not path.is_dir()


def _parts(path: Path) -> list[_Part]:
    if path.is_dir():
        files = [
            file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
        ]
        if not files:
            raise FlatError(f"{path}: no image files are in this folder")
        return [part for file in sorted(files, key=_natural) for part in _parts(file)]
    if not path.exists():
        raise FlatError(f"{path}: no such file or folder")
    if path.suffix.lower() in _VIDEOS:
        _import_av(path)
        return [_Part(path, None)]
    if path.suffix.lower() not in TIFF_SUFFIXES:
        return [_Part(path, (path.stem,))]
    try:
        pages = count_pages(path)
    except FlatError:
        # Reading it says what is wrong when its turn comes.
        pages = 1
    return [_Part(path, _numbered(path.stem, pages))]


def _natural(path: Path) -> Any:
    """Sorts frame_2 before frame_10."""
    return [(not piece.isdigit(), int(piece) if piece.isdigit() else piece) for piece in re.split(r"(\d+)", path.name)]


def _numbered(stem: str, pages: int) -> tuple[str, ...]:
    return (stem,) if pages == 1 else tuple(f"{stem}_{page:05d}" for page in range(pages))


def _import_av(path: Path) -> Any:
    try:
        import av
    except ImportError as error:
        raise FlatError(f"{path}: videos need the package 'av'; pip install 'lfrender[video]'") from error
    return av


def _video_length(path: Path) -> int | None:
    """Number of frames that a video says it has; None where it does not say."""
    av = _import_av(path)
    try:
        with _opened_video(path) as container:
            return int(container.streams.video[0].frames) or None
    except (av.error.FFmpegError, FlatError, OSError):
        return None


def _video_rate(path: Path) -> Fraction | None:
    """Frames a second that a video says it has."""
    av = _import_av(path)
    try:
        with _opened_video(path) as container:
            rate = container.streams.video[0].average_rate
            return Fraction(rate) if rate and rate > 0 else None
    except (av.error.FFmpegError, FlatError, OSError):
        return None


def _opened_video(path: Path) -> Any:
    """A video that has pictures, in a `with` statement."""
    container = _import_av(path).open(str(path), format=_VIDEOS[path.suffix.lower()])
    if not container.streams.video:
        container.close()
        raise FlatError(f"{path}: there is no video in it")
    return container


def _video_frames(path: Path) -> Iterator[Frame]:
    """Frames of a video in RGB; one that is damaged, or a video that is, becomes a frame that cannot be read."""
    number = 0
    try:
        with _opened_video(path) as container:
            count = _said_count(container)
            for picture in _decoded(container):
                yield Frame(_video_name(path, number), _video_pixels(path, number, picture))
                number += 1
        if number == 0:
            raise FlatError(f"{path}: holds no frames")
        if number < count:
            raise FlatError(f"{path}: ends after {number} of {count} frames")
    except FlatError as error:
        yield Frame(_video_name(path, number), partial(_refuse, str(error)))
    # FFmpeg tells damage by errors of many kinds.
    except Exception as error:
        message = f"{path}: cannot be read as a video from frame {number} on ({_said(error)})"
        yield Frame(_video_name(path, number), partial(_refuse, message))


def _said_count(container: Any) -> int:
    """Number of frames that there must be at least by what a video says, 0 where it does not say."""
    stream = container.streams.video[0]
    if stream.frames:
        return int(stream.frames)
    steady = stream.average_rate and stream.average_rate == stream.base_rate and len(container.streams) == 1
    if not steady or not container.duration:
        return 0
    # Durations [us] are rounded, and some end where the last frame begins.
    return int(Fraction(container.duration, 1_000_000) * stream.average_rate - Fraction(1, 2))


def _decoded(container: Any) -> Iterator[Any]:
    """The pictures of a video, and an error in the place of those that cannot be decoded."""
    stream = container.streams.video[0]
    # This decoder tells of wrong checksums in nothing but its log, which is to be about one frame.
    logged = stream.codec_context.name == "ffv1"
    stream.thread_type = "SLICE" if logged else "AUTO"
    for packet in container.demux(stream):
        try:
            if not logged:
                yield from packet.decode()
                continue
            pictures, wrong = _overheard(packet)
            yield from [FlatError(wrong) for _ in pictures] if wrong else pictures
        except Exception as error:
            yield error


def _overheard(packet: Any) -> tuple[list[Any], str]:
    """The pictures of a packet, and the first error that their decoder has logged."""
    from av import logging

    before = logging.get_level()
    logging.set_level(logging.ERROR)
    try:
        with logging.Capture(local=False) as log:
            pictures = packet.decode()
    finally:
        logging.set_level(before)
    return pictures, next((text.strip() for level, name, text in log if name == "ffv1" and level <= logging.ERROR), "")


def _video_pixels(path: Path, number: int, picture: Any) -> Callable[[], NDArray[Any]]:
    """What reads the pixels of a decoded picture, or says why there are none."""
    if isinstance(picture, Exception):
        return partial(_refuse, f"{path}: frame {number}: {_said(picture)}")
    # Decoders fill what is missing with something; a flat that is half made up would still be rendered.
    if picture.is_corrupt:
        return partial(_refuse, f"{path}: frame {number} is damaged")
    deep = _DEEP.search(picture.format.name) is not None
    try:
        pixels = _deep_pixels(picture) if deep else convert_pixels(picture, "rgb24").to_ndarray()
    except Exception as error:
        return partial(_refuse, f"{path}: frame {number}: {_said(error)}")
    return partial(np.ascontiguousarray, pixels)


def _deep_pixels(picture: Any) -> NDArray[np.uint16]:
    """(h, w, 3) of a frame of PyAV, without the copies that it makes of so many bytes."""
    plane = picture.reformat(format="rgb48le").planes[0]
    rows = np.frombuffer(plane, "<u2").reshape(plane.height, plane.line_size // 2)
    return rows[:, : 3 * plane.width].reshape(plane.height, plane.width, 3).astype(np.uint16, copy=False)


def convert_pixels(picture: Any, name: str, **options: Any) -> Any:
    """A frame of PyAV in another pixel format, rounded to the nearest value."""
    from av.video.reformatter import Interpolation

    way = sum(int(Interpolation[flag]) for flag in _EXACT)
    return picture.reformat(format=name, interpolation=way, **options)


def _said(error: BaseException) -> str:
    """The message of an error in one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _refuse(message: str) -> NDArray[Any]:
    raise FlatError(message)


def _video_name(path: Path, number: int) -> str:
    return f"{path.stem}_{number:05d}"
