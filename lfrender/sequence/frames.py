"""The frames of a sequence, found in image files, folders, multi-page TIFFs and videos, and their pixels."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import FlatError, count_pages, read_flat, subtract_dark
from lfcal.runtime.image_formats import IMAGE_SUFFIXES, RAW_SUFFIX, TIFF_SUFFIXES, VIDEO_FORMATS
from lfcal.runtime.video import import_av, rgb_pixels

__all__ = ["Frame", "Frames", "are_encoded", "dark_of", "is_video", "open_frames"]


@dataclass(frozen=True)
class Frame:
    """One frame of a sequence; `read` returns its flat (h, w) or (h, w, 3), or raises FlatError."""

    name: str  # of its picture, without suffix
    read: Callable[[], NDArray[Any]]
    source: Path | None = None  # image file whose metadata its picture gets; None for frames of videos


@dataclass(frozen=True)
class _Part:
    """A file and the names of its frames, None if their number is known only after decoding; how raw video is read."""

    path: Path
    names: tuple[str, ...] | None
    layout: tuple[tuple[str, Any], ...] = ()  # `size` and `pixel_format` of `read_flat`

    def frames(self) -> Iterator[Frame]:
        """The frames, one after the other."""
        if self.names is None:
            yield from _video_frames(self.path)
            return
        source = None if self.path.suffix.lower() == RAW_SUFFIX else self.path
        for page, name in enumerate(self.names):
            number = page if len(self.names) > 1 else None
            yield Frame(name, partial(read_flat, self.path, number, **dict(self.layout)), source)

    def header(self) -> tuple[int | None, Fraction | None]:
        """Number of frames and frames a second by the header of a video, None where it has none."""
        if self.names is not None:
            return len(self.names), None
        av = import_av(self.path)
        try:
            with _open_video(self.path) as container:
                stream = container.streams.video[0]
                return int(stream.frames) or None, stream.average_rate
        except (av.error.FFmpegError, FlatError, OSError):
            return None, None


@dataclass(frozen=True)
class Frames:
    """A sequence of frames; each iteration starts from the first one.

    Examples
    --------
    >>> import tempfile, lfrender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/0.png", lfrender.data.example()[0])
    ...     frames = lfrender.open_frames([folder])
    ...     frames.count, [path.name for path in frames.files]
    (1, ['0.png'])
    """

    parts: tuple[_Part, ...]
    dark: Path | None = None  # dark frame that is subtracted from each

    @property
    def count(self) -> int | None:
        """Number of frames, None if the header of a video does not have it."""
        counts = [part.header()[0] for part in self.parts]
        return None if None in counts else sum(counts)  # type: ignore[arg-type]

    @property
    def rate(self) -> Fraction | None:
        """Frames a second of the first video whose header has it, None if there is none."""
        return next((Fraction(rate) for _, rate in (part.header() for part in self.parts) if rate), None)

    @property
    def files(self) -> list[Path]:
        """The files that the frames are read from."""
        return [part.path for part in self.parts]

    def __iter__(self) -> Iterator[Frame]:
        for part in self.parts:
            for frame in part.frames():
                less = frame.read if self.dark is None else partial(_read_less_dark, frame.read, self.dark)
                yield replace(frame, read=less)


def open_frames(
    inputs: Iterable[str | os.PathLike[str]],
    *,
    size: tuple[int, int] | None = None,
    pixel_format: str | None = None,
    dark: str | os.PathLike[str] | None = None,
) -> Frames:
    """Find the frames in files and folders without decoding them.

    FlatError if there is no frame, an input is of no known kind, or two frames would have the same name.

    Parameters
    ----------
    inputs : path-likes
        Image files, TIFF files of several pages, videos, raw or not (these need the package `av`:
        `pip install 'lfrender[video]'`), and folders, whose image files are taken in the order of the numbers in their
        names.
    size, pixel_format
        Of raw video (`.yuv`), as for `lfcal.read_flat`.
    dark : path-like or None
        File of a dark frame, which is subtracted from every frame (`lfcal.subtract_dark`).

    Examples
    --------
    >>> import tempfile, lfrender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("f10", "f9"):
    ...         lfrender.write_picture(f"{folder}/{name}.png", lfrender.data.example()[0])
    ...     [frame.name for frame in lfrender.open_frames([folder])]
    ['f9', 'f10']
    """
    layout = {"size": size, "pixel_format": pixel_format}
    parts = [part for path in inputs for part in _parts(Path(path).absolute(), layout)]
    if not parts:
        raise FlatError("no frames: give image files, a folder of them, a TIFF of several pages or a video")
    names = [name for part in parts for name in (part.names or (part.path.stem,))]
    twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if twice:
        raise FlatError(f"{len(twice)} frames would have the same name, such as '{twice[0]}'; give them one by one")
    if dark is not None:
        # Errors of this file are raised at once, not for every frame.
        _read_dark(Path(dark).absolute())
    return Frames(tuple(parts), None if dark is None else Path(dark).absolute())


@lru_cache(1)
def _read_dark(path: Path) -> NDArray[Any]:
    return read_flat(path)


def _read_less_dark(read: Callable[[], NDArray[Any]], dark: Path) -> NDArray[Any]:
    """The pixels of a frame less the dark frame in a file."""
    pixels = read()
    try:
        return subtract_dark(pixels, _read_dark(dark))
    except FlatError as error:
        raise FlatError(f"{dark}: {error}") from error


def dark_of(frames: Iterable[Frame]) -> str | None:
    """File of the dark frame that is subtracted from the frames of a sequence, if any is."""
    dark = frames.dark if isinstance(frames, Frames) else None
    return None if dark is None else str(dark)


def are_encoded(frames: Iterable[Frame]) -> bool:
    """Whether frames are encoded for display, whatever bits they have, as those of videos are."""
    return isinstance(frames, Frames) and bool(frames.parts) and all(is_video(part.path) for part in frames.parts)


def is_video(path: Path) -> bool:
    """Whether a path has the suffix of a video, raw or not."""
    return path.suffix.lower() in {*VIDEO_FORMATS, RAW_SUFFIX} and not path.is_dir()


def _parts(path: Path, layout: dict[str, Any]) -> list[_Part]:
    if path.is_dir():
        known = {*IMAGE_SUFFIXES, RAW_SUFFIX}
        files = [f for f in path.iterdir() if f.suffix.lower() in known and not f.name.startswith(".")]
        if not files:
            raise FlatError(f"{path}: no image files are in this folder")
        return [part for file in sorted(files, key=_numeric_order) for part in _parts(file, layout)]
    if not path.exists():
        raise FlatError(f"{path}: no such file or folder")
    suffix, pages, given = path.suffix.lower(), 1, tuple(layout.items()) if is_video(path) else ()
    if given:
        import_av(path)
        if suffix in VIDEO_FORMATS:
            return [_Part(path, None)]
        pages = count_pages(path, **layout)
    elif suffix in TIFF_SUFFIXES:
        # Reading the frame will report what is wrong.
        with suppress(FlatError):
            pages = count_pages(path)
    names = (path.stem,) if pages == 1 else tuple(f"{path.stem}_{page:05d}" for page in range(pages))
    return [_Part(path, names, given)]


def _numeric_order(path: Path) -> Any:
    """Sort key that puts frame_2 before frame_10."""
    return [(not piece.isdigit(), int(piece) if piece.isdigit() else piece) for piece in re.split(r"(\d+)", path.name)]


def _open_video(path: Path) -> Any:
    """Open a video, which must have pictures, for a `with` statement."""
    container = import_av(path).open(str(path), format=VIDEO_FORMATS[path.suffix.lower()])
    if not container.streams.video:
        container.close()
        raise FlatError(f"{path}: there is no video in it")
    return container


def _video_frames(path: Path) -> Iterator[Frame]:
    """Frames of a video in RGB; a damaged one, or the end of a damaged video, is a frame that cannot be read."""
    number = 0
    try:
        with _open_video(path) as container:
            count = _least_length(container)
            for picture in _decode(container):
                yield Frame(f"{path.stem}_{number:05d}", _read_picture(path, number, picture))
                number += 1
        if number == 0:
            raise FlatError(f"{path}: holds no frames")
        if number < count:
            raise FlatError(f"{path}: ends after {number} of {count} frames")
    # FFmpeg raises errors of many kinds on damaged videos.
    except Exception as error:
        message = f"{path}: cannot be read as a video from frame {number} on ({_one_line(error)})"
        message = str(error) if isinstance(error, FlatError) else message
        yield Frame(f"{path.stem}_{number:05d}", partial(_raise, message))


def _least_length(container: Any) -> int:
    """Least number of frames by the header of a video, 0 if it has none."""
    stream = container.streams.video[0]
    steady = stream.average_rate and stream.average_rate == stream.base_rate and len(container.streams) == 1
    if stream.frames or not (steady and container.duration):
        return int(stream.frames)
    # Durations [us] are rounded, and some reach only to the start of the last frame.
    return int(Fraction(container.duration, 1_000_000) * stream.average_rate - Fraction(1, 2))


def _decode(container: Any) -> Iterator[Any]:
    """The pictures of a video, and an error in place of each that cannot be decoded."""
    from av import logging

    stream = container.streams.video[0]
    # This decoder reports wrong checksums only in its log; with slice threads, the log is about one frame.
    logged = stream.codec_context.name == "ffv1"
    stream.thread_type = "SLICE" if logged else "AUTO"
    before = logging.get_level()
    for packet in container.demux(stream):
        try:
            logging.set_level(logging.ERROR if logged else before)
            with logging.Capture(local=False) if logged else nullcontext([]) as log:
                pictures = packet.decode()
        except Exception as error:
            yield error
            continue
        finally:
            logging.set_level(before)
        wrong = [text.strip() for level, name, text in log if name == "ffv1" and level <= logging.ERROR]
        yield from [FlatError(wrong[0]) for _ in pictures] if wrong else pictures


def _read_picture(path: Path, number: int, picture: Any) -> Callable[[], NDArray[Any]]:
    """A function that returns the pixels of a decoded picture, or raises an error if it is damaged."""
    try:
        if isinstance(picture, Exception):
            raise picture
        # Decoders fill in what is missing; such a flat must not be rendered.
        if picture.is_corrupt:
            return partial(_raise, f"{path}: frame {number} is damaged")
        return partial(np.asarray, rgb_pixels(picture))
    except Exception as error:
        return partial(_raise, f"{path}: frame {number}: {_one_line(error)}")


def _one_line(error: BaseException) -> str:
    """The message of an error in one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _raise(message: str) -> NDArray[Any]:
    raise FlatError(message)
