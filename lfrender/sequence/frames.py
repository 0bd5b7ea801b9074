"""The frames of a sequence, found in image files, folders, multi-page TIFFs and videos."""

from __future__ import annotations

import re
import sys
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache, partial
from math import ceil
from pathlib import Path
from typing import Any

from lfcal import FlatError, count_pages, read_flat, subtract_dark
from lfcal.runtime.arrays import Array
from lfcal.runtime.errors import check_type
from lfcal.runtime.image_formats import IMAGE_SUFFIXES, RAW_SUFFIX, TIFF_SUFFIXES, VIDEO_FORMATS
from lfcal.runtime.video import import_av, rgb_pixels

from ..runtime.messages import one_line
from ..runtime.types import AnyPath, Size

__all__ = ["Frame", "Frames", "is_video", "open_frames", "read_dark", "read_lit"]


@dataclass(frozen=True)
class Frame:
    """One frame of a sequence; `read` returns its flat (h, w) or (h, w, 3), or raises FlatError."""

    name: str  # of its picture, without suffix
    read: Callable[[], Array]
    source: Path | None = (
        None  # image file whose metadata its picture gets; None for frames of videos
    )

    @property
    def place(self) -> str:
        """The file, and its page if it has several, for messages; the name of frames of videos."""
        if self.source is None or self.source.stem == self.name:
            return str(self.source or self.name)
        return f"{self.source}, frame {self.name}"


def read_lit(frame: Frame) -> Array:
    """The flat of a frame; FlatError if all its pixels are equal, as behind a lens cap."""
    pixels = frame.read()
    if pixels.min() == pixels.max():
        raise FlatError("all pixels of this flat are equal; it is dark or saturated")
    return pixels


@dataclass(frozen=True)
class _Part:
    """A file and the names of its frames, None for videos; how raw video is read."""

    path: Path
    pages: tuple[str, ...] | None
    layout: tuple[tuple[str, Any], ...] = ()  # `size` and `pixel_format` of `read_flat`

    def frames(self, chosen: range) -> Iterator[Frame]:
        if self.pages is None:
            yield from _video_frames(self.path, chosen)
            return
        source = None if self.path.suffix.lower() == RAW_SUFFIX else self.path
        for page, name in enumerate(self.pages):
            if page in chosen:
                number = page if len(self.pages) > 1 else None
                yield Frame(
                    name, partial(read_flat, self.path, number, **dict(self.layout)), source
                )

    @cached_property
    def header(self) -> tuple[int, Fraction | None]:
        """Number of frames, and frames a second if the file has them.

        The number is 0 for videos that cannot be read.
        """
        if self.pages is not None:
            return len(self.pages), None
        av = import_av(self.path)
        with (
            suppress(av.error.FFmpegError, FlatError, OSError),
            _open_video(self.path) as container,
        ):
            stream = container.streams.video[0]
            count = stream.frames
            if not count:
                # Streams without a header and Matroska are read through: fast without decoding.
                packets = sum(packet.size > 0 for packet in container.demux(stream))
                count = max(_least_length(container), packets)
            return count, stream.average_rate
        return 0, None

    @property
    def names(self) -> Sequence[str]:
        return self.pages or [_frame_name(self.path, number) for number in range(self.header[0])]


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
    chosen: range | None = None  # numbers of the frames that are taken; None for all

    @property
    def count(self) -> int:
        """Number of frames; less than there are where a video is damaged."""
        if self.chosen is not None:
            return len(self.chosen)
        return sum(part.header[0] for part in self.parts)

    @property
    def rate(self) -> Fraction | None:
        """Frames a second of the first video that has them, None if there is none.

        If frames are left out, the rate is lower.
        """
        rates = [part.header[1] for part in self.parts]
        for rate in filter(None, rates):
            return Fraction(rate) / (self.chosen or range(1)).step
        return None

    @property
    def files(self) -> list[Path]:
        """The files that the frames come from."""
        return [part.path for part in self.parts]

    @property
    def names(self) -> list[str]:
        """Names of the pictures of the frames, without suffix."""
        names = [name for part in self.parts for name in part.names]
        if self.chosen is not None:
            names = [names[number] for number in self.chosen]
        return names

    @property
    def encoded(self) -> bool:
        """Whether frames are encoded for display whatever their bits, as frames of videos are."""
        return bool(self.parts) and all(is_video(part.path) for part in self.parts)

    def __iter__(self) -> Iterator[Frame]:
        first = 0
        for part in self.parts:
            own = range(sys.maxsize)
            if self.chosen is not None:
                end = first + part.header[0]
                taken = self.chosen[bisect_left(self.chosen, first) : bisect_left(self.chosen, end)]
                own = range(taken.start - first, taken.stop - first, taken.step)
                first = end
            for frame in part.frames(own) if own else ():
                if self.dark is not None:
                    frame = replace(frame, read=partial(_read_less_dark, frame.read, self.dark))
                yield frame


def open_frames(
    inputs: Iterable[AnyPath],
    *,
    size: Size | None = None,
    pixel_format: str | None = None,
    dark: AnyPath | None = None,
    frames: int | slice | str | None = None,
    start: float | None = None,
    end: float | None = None,
) -> Frames:
    """Find the frames in files and folders without decoding them.

    FlatError if there is no frame, none that is asked for, an input is of no known kind, or two
    frames would have the same name.

    Parameters
    ----------
    inputs : path-likes
        Image files, TIFF files of several pages, videos, raw or not (these need the package `av`),
        and folders, whose image files are taken in the order of the numbers in their names.
    size, pixel_format
        Of raw video (`.yuv`), as for `lfcal.read_flat`.
    dark : path-like or None
        File of a dark frame, which is subtracted from every frame (`lfcal.subtract_dark`).
    frames : int, slice or str, optional
        Take only these, counted from 0 through all inputs: `slice(10, 60, 2)` or `"10:60:2"`, as
        Python slices do, or one number.
    start, end : float, optional [s]
        Take only the frames from `start` to before `end`, of videos of one frame rate.

    Examples
    --------
    >>> import tempfile, lfrender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("f10", "f9"):
    ...         lfrender.write_picture(f"{folder}/{name}.png", lfrender.data.example()[0])
    ...     later = lfrender.open_frames([folder], frames="1:")
    ...     [frame.name for frame in lfrender.open_frames([folder])], later.names
    (['f9', 'f10'], ['f10'])
    """
    check_type(inputs, Iterable, "inputs", "give a list of files and folders")
    if dark is not None:
        dark = Path(dark).absolute()
        # Errors of this file are raised at once, not for every frame.
        read_dark(dark)
    layout = {"size": size, "pixel_format": pixel_format}
    parts = [part for path in inputs for part in _parts(Path(path).absolute(), layout)]
    if not parts:
        raise FlatError(
            "no frames: give image files, a folder of them, a TIFF of several pages or a video"
        )
    names = Counter(name for part in parts for name in (part.pages or (part.path.stem,)))
    twice = sorted(name for name, count in names.items() if count > 1)
    if twice:
        such = f"{len(twice)} frames would have the same name, such as '{twice[0]}'"
        raise FlatError(f"{such}; give them one by one")
    if start is not None or end is not None:
        if frames is not None:
            raise ValueError("give either frames, or start and end")
        frames = _slice_of_seconds(parts, start, end)
    found = Frames(tuple(parts), dark)
    if frames is None:
        return found
    return replace(found, chosen=_choose(found.count, frames))


def _slice_of_seconds(parts: list[_Part], start: float | None, end: float | None) -> slice:
    rates = {part.header[1] for part in parts}
    if len(rates) > 1 or None in rates:
        raise FlatError(
            "seconds are for videos of one frame rate; choose frames by their numbers, such as "
            "10:60"
        )
    if (start or 0) < 0 or (end is not None and not (start or 0) < end):
        raise ValueError(
            f"start must be 0 or more seconds, and less than end, got {start} and {end}"
        )
    # Frames begin at multiples of a period, but for rounding.
    rate = float(rates.pop())  # type: ignore[arg-type]
    return slice(*(None if at is None else ceil(at * rate - 1e-6) for at in (start, end)))


def _choose(count: int, frames: int | slice | str) -> range:
    """The numbers of the frames, out of `count`, that are asked for."""
    text = frames
    if isinstance(frames, str):
        try:
            numbers = [int(number) if number.strip() else None for number in frames.split(":")]
            frames = slice(*numbers) if ":" in frames else int(frames)
        except (ValueError, TypeError) as error:
            raise ValueError(
                f"frames must be START:STOP:STEP such as 10:60:2, or one number, got {frames!r}"
            ) from error
    if not isinstance(frames, slice):
        frames = slice(frames, frames + 1 or None)
    if frames.step is not None and frames.step < 1:
        raise ValueError(f"frames must have a step of at least 1, got {frames.step}")
    chosen = range(*frames.indices(count))
    if not chosen:
        raise FlatError(
            f"no frames are left: there are {count}, numbered from 0, and {text} has none of them"
        )
    return chosen


@lru_cache(1)
def read_dark(path: Path) -> Array:
    """The pixels of a dark frame, which are kept."""
    return read_flat(path)


def _read_less_dark(read: Callable[[], Array], dark: Path) -> Array:
    pixels = read()
    try:
        return subtract_dark(pixels, read_dark(dark))
    except FlatError as error:
        raise FlatError(f"{dark}: {error}") from error


def is_video(path: Path) -> bool:
    """Whether a path has the suffix of a video, raw or not."""
    return path.suffix.lower() in {*VIDEO_FORMATS, RAW_SUFFIX} and not path.is_dir()


def _parts(path: Path, layout: dict[str, Any]) -> list[_Part]:
    if path.is_dir():
        known = {*IMAGE_SUFFIXES, RAW_SUFFIX}
        files = [
            f for f in path.iterdir() if f.suffix.lower() in known and not f.name.startswith(".")
        ]
        if not files:
            raise FlatError(f"{path}: no image files are in this folder")
        return [part for file in sorted(files, key=_numeric_order) for part in _parts(file, layout)]
    if not path.exists():
        raise FlatError(f"{path}: no such file or folder")
    suffix = path.suffix.lower()
    pages = 1
    given: tuple[tuple[str, Any], ...] = ()
    if is_video(path):
        import_av(path)
        if suffix in VIDEO_FORMATS:
            return [_Part(path, None)]
        given = tuple(layout.items())
        pages = count_pages(path, **layout)
    elif suffix in TIFF_SUFFIXES:
        # Reading the frame will report what is wrong.
        with suppress(FlatError):
            pages = count_pages(path)
    names = [path.stem]
    if pages > 1:
        names = [_frame_name(path, page) for page in range(pages)]
    return [_Part(path, tuple(names), given)]


def _numeric_order(path: Path) -> Any:
    """Sort key that puts frame_2 before frame_10."""
    pieces = re.split(r"(\d+)", path.name)
    # Every other piece is a number.
    return [int(piece) if place % 2 else piece for place, piece in enumerate(pieces)]


def _open_video(path: Path) -> Any:
    container = import_av(path).open(str(path), format=VIDEO_FORMATS[path.suffix.lower()])
    if not container.streams.video:
        container.close()
        raise FlatError(f"{path}: there is no video in it")
    return container


def _frame_name(path: Path, number: int) -> str:
    return f"{path.stem}_{number:05d}"


def _video_frames(path: Path, chosen: range) -> Iterator[Frame]:
    """Chosen frames of a video in RGB.

    A damaged frame, and the end of a damaged video, become a frame that cannot be read.
    """
    number = 0
    try:
        with _open_video(path) as container:
            count = _least_length(container)
            for picture in _decode(container):
                if number in chosen:
                    read = partial(_give, _pixels_or_message(f"{path}: frame {number}", picture))
                    yield Frame(_frame_name(path, number), read)
                number += 1
                if number >= chosen.stop:
                    return
        if number < max(count, 1):
            raise FlatError(f"{path}: ends after {number} of {max(count, 1)} frames")
    # FFmpeg raises errors of many kinds on damaged videos.
    except Exception as error:
        message = str(error)
        if not isinstance(error, FlatError):
            reason = one_line(error)
            message = f"{path}: cannot be read as a video from frame {number} on ({reason})"
        yield Frame(_frame_name(path, number), partial(_give, message))


def _least_length(container: Any) -> int:
    """Least number of frames by the header of a video, 0 if it has none."""
    stream = container.streams.video[0]
    rate = stream.average_rate
    steady = rate and rate == stream.base_rate and len(container.streams) == 1
    if stream.frames or not (steady and container.duration):
        return int(stream.frames)
    # Durations [us] are rounded, and some reach only to the start of the last frame.
    return int(Fraction(container.duration, 1_000_000) * rate - Fraction(1, 2))


def _decode(container: Any) -> Iterator[Any]:
    """The pictures of a video, and an error in place of each that cannot be decoded."""
    from av import logging

    stream = container.streams.video[0]
    # This decoder reports wrong checksums only in its log; with slice threads, the log is about one
    # frame.
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
        wrong = [text for level, name, text in log if name == "ffv1" and level <= logging.ERROR]
        if wrong:
            pictures = [FlatError(wrong[0].strip())] * len(pictures)
        yield from pictures


def _pixels_or_message(name: str, picture: Any) -> Array | str:
    if isinstance(picture, Exception):
        return f"{name}: {one_line(picture)}"
    # Decoders fill in what is missing; such a flat must not be rendered.
    if picture.is_corrupt:
        return f"{name} is damaged"
    try:
        return rgb_pixels(picture)
    except Exception as error:
        return f"{name}: {one_line(error)}"


def _give(found: Array | str) -> Array:
    if isinstance(found, str):
        raise FlatError(found)
    return found
