"""Film files: H.264 in MP4, ProRes in QuickTime, lossless FFV1 in Matroska, and raw planes."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, contextmanager, nullcontext, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from lfcal import FlatError, OutputError, read_flat
from lfcal.runtime.arrays import Array
from lfcal.runtime.output_file import atomic_write

from ..data.rendering import Rendering
from ..output.finish import Finish
from ..output.formats import FORMATS, PictureError, describe_pixels
from ..output.raw_video import yuv_frame
from ..output.tiled_picture import move_into_place
from ..output.views import MILLISECONDS, write_animation
from .run import FrameResult

__all__ = ["FilmFile", "Results", "film_results", "write_moving"]

#: Outcomes of frames, which are computed as they are taken.
Results = Generator[FrameResult, None, None]

# What PyAV calls arrays of so many dimensions and bytes, and how FFV1 stores them.
_LOSSLESS = {
    (2, 1): ("gray", "gray"),
    (3, 1): ("rgb24", "bgr0"),
    (2, 2): ("gray16le", "gray16le"),
    (3, 2): ("rgb48le", "gbrp16le"),
}
# How the others store pictures.
_PIXELS = {".mp4": "yuv420p", ".mov": "yuv422p10", ".yuv": "yuv420p10"}


def write_moving(path: Path, pictures: Iterable[Rendering], finish: Finish) -> None:
    """Write pictures after `finish` as an animation or a film, by the suffix; whole or not at all.

    Pictures follow each other as fast as in `write_animation`.
    """
    if not FORMATS[path.suffix.lower()].film:
        write_animation(path, pictures, finish=finish)
        return
    with atomic_write(path) as temporary, FilmFile(temporary, Fraction(1000, MILLISECONDS)) as film:
        for picture in finish.apply_to_all(pictures):
            film.add(picture.image)


def film_results(
    results: Results,
    path: Path,
    folder: Path,
    rate: Fraction,
    picture: Callable[[FrameResult], Path],
    **about: str,
) -> Results:
    """Pass results on, and write their pictures into a film, which is moved into place at the end.

    A failed frame repeats the picture before it. `folder` holds the unfinished film.
    """
    partial = folder / f"film{path.suffix.lower()}"
    shown = None
    times = 0
    # Closed in this order: threads must end before the film that they write into, and not in the
    # garbage collector.
    with closing(results), FilmFile(partial, rate, **about) as film:
        for result in results:
            if result.outcome != "failed":
                shown = picture(result)
            times += 1
            if shown is not None:
                pixels = read_flat(shown)
                for _ in range(times):
                    film.add(pixels)
                times = 0
            yield result
        if not film.count:
            raise FlatError(f"{path}: is not written, because none of the frames could be rendered")
    move_into_place(partial, path)


class FilmFile:
    """A film of `rate` pictures per second, written by a `with` statement, complete at its end."""

    def __init__(self, path: Path, rate: Fraction, **about: str) -> None:
        import av

        #: Number of pictures.
        self.count = 0
        # Rates of television have denominators up to 1001; further digits of a decimal number are
        # rounding.
        self._path = path
        self._rate = rate.limit_denominator(1001)
        self._kind = path.suffix.lower()
        self._stream: Any = None
        self._first = ""  # kind of the first picture
        form = None
        options = {}
        if self._kind == ".yuv":
            form = "rawvideo"
        elif self._kind != ".mkv":
            # With the index before the pictures, a browser can play the film before it has all.
            options = {"movflags": "+faststart"}
        with self._output_errors():
            self._file = av.open(str(path), "w", format=form, options=options)
            self._file.metadata["comment"] = json.dumps({"software": "lfrender", **about})

    def add(self, pixels: Array) -> None:
        """Add a picture (h, w) or (h, w, 3), uint8, uint16 or float.

        PictureError if it is of another kind than the first one.
        """
        kind = describe_pixels(pixels)
        self._first = self._first or kind
        if kind != self._first:
            kinds = f"{self._first} and {kind}"
            raise PictureError(f"{self._path}: the pictures of a film are of one kind, not {kinds}")
        with self._output_errors():
            frame = self._frame(pixels)
            if self._stream is None:
                self._begin(frame)
            frame.pts, frame.time_base = self.count, 1 / self._rate
            self._file.mux(self._stream.encode(frame))
        self.count += 1

    def __enter__(self) -> FilmFile:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        # After an error, which is raised already, the file is incomplete.
        with nullcontext() if kind is None else suppress(OutputError), self._output_errors():
            if kind is None and self._stream is not None:
                self._file.mux(self._stream.encode())
            self._file.close()

    def _begin(self, frame: Any) -> None:
        film = FORMATS[self._kind].film
        assert film is not None
        self._stream = self._file.add_stream(film[0], rate=self._rate, options=dict(film[1]))
        context = self._stream.codec_context
        # A fixed number, so that the film is the same on every machine.
        context.thread_count = 4
        context.width = frame.width
        context.height = frame.height
        context.pix_fmt = frame.format.name
        if self._kind in (".mp4", ".mov"):
            # Codes of ITU-T H.273 for the colours of HD television (BT.709) and their limited
            # range.
            context.colorspace = context.color_primaries = context.color_trc = (
                context.color_range
            ) = 1

    def _frame(self, pixels: Array) -> Any:
        import av

        if self._kind == ".mkv":
            if pixels.dtype.kind == "f":
                pixels = np.rint(np.clip(pixels, 0, 1) * 65535).astype(np.uint16)
            given, stored = _LOSSLESS[pixels.ndim, pixels.dtype.itemsize]
            return av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=given).reformat(
                format=stored
            )
        if self._kind == ".yuv":
            return yuv_frame(pixels, _PIXELS[self._kind])
        # Colours are stored for 2 x 2 pixels each: odd sizes get one more row or column.
        odd = [(0, n % 2) for n in pixels.shape[:2]]
        pixels = np.pad(pixels, [*odd, (0, 0)][: pixels.ndim], mode="edge")
        return yuv_frame(
            pixels, _PIXELS[self._kind], dst_colorspace="ITU709", dst_color_range="MPEG"
        )

    @contextmanager
    def _output_errors(self) -> Iterator[None]:
        import av

        try:
            yield
        except (av.error.FFmpegError, OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise OutputError(f"{self._path}: cannot be written ({reason})") from error
