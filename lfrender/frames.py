"""The frames of a sequence: image files, folders of them, pages of a TIFF, videos."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import FlatError, count_pages, read_flat

__all__ = ["Frame", "Frames", "open_frames"]

_IMAGES = {".png", ".tif", ".tiff", ".webp", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm"}
# Raw streams have no header that names their codec.
_VIDEOS = {
    ".mp4": None, ".mkv": None, ".mov": None, ".avi": None, ".webm": None, ".y4m": None, ".m4v": None,
    ".vvc": "vvc", ".266": "vvc", ".hevc": "hevc", ".265": "hevc", ".h264": "h264", ".264": "h264",
}  # fmt: skip
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


def _parts(path: Path) -> list[_Part]:
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix.lower() in _IMAGES and not file.name.startswith(".")]
        if not files:
            raise FlatError(f"{path}: no image files are in this folder")
        return [part for file in sorted(files, key=_natural) for part in _parts(file)]
    if not path.exists():
        raise FlatError(f"{path}: no such file or folder")
    if path.suffix.lower() in _VIDEOS:
        _import_av(path)
        return [_Part(path, None)]
    if path.suffix.lower() not in (".tif", ".tiff"):
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
        with av.open(str(path), format=_VIDEOS[path.suffix.lower()]) as container:
            return int(container.streams.video[0].frames) or None
    except (av.error.FFmpegError, IndexError, OSError):
        return None


def _video_frames(path: Path) -> Iterator[Frame]:
    """Frames of a video in RGB; after a damaged one, an error and then those that can be decoded."""
    av = _import_av(path)
    number = 0
    try:
        with av.open(str(path), format=_VIDEOS[path.suffix.lower()]) as container:
            if not container.streams.video:
                raise FlatError(f"{path}: there is no video in it")
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            for packet in container.demux(stream):
                try:
                    decoded = packet.decode()
                except av.error.FFmpegError as error:
                    yield Frame(_video_name(path, number), partial(_refuse, f"{path}: frame {number}: {error}"))
                    number += 1
                    continue
                for picture in decoded:
                    deep = _DEEP.search(picture.format.name) is not None
                    pixels = picture.to_ndarray(format="rgb48le" if deep else "rgb24")
                    yield Frame(_video_name(path, number), partial(np.ascontiguousarray, pixels))
                    number += 1
    except (av.error.FFmpegError, OSError) as error:
        raise FlatError(f"{path}: cannot be read as a video ({error})") from error
    if number == 0:
        raise FlatError(f"{path}: holds no frames")


def _refuse(message: str) -> NDArray[Any]:
    raise FlatError(message)


def _video_name(path: Path, number: int) -> str:
    return f"{path.stem}_{number:05d}"
