"""Films: H.264 in MP4, which plays everywhere, FFV1 in Matroska, which is lossless, raw video; and animations."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatError, OutputError, read_flat
from lfcal.runtime.arrays import to_eight_bits
from lfcal.runtime.output_file import atomic_write
from lfcal.runtime.video import convert_frame

from ..data.rendering import Rendering
from ..output.formats import FORMATS, PictureError, check_format
from ..output.raw_video import yuv_frame
from ..output.resume import Checkpoint, file_identity, fingerprint
from ..output.tiled_picture import move_into_place
from ..output.views import write_animation
from .batch import render_frames
from .frames import Frames
from .job import FrameResult, load_camera

__all__ = ["FilmFile", "render_film", "to_film_pixels", "write_moving"]

# What PyAV calls arrays of so many dimensions and bytes, and how FFV1 stores them.
_LAYOUTS = {
    (2, 1): ("gray", "gray"), (3, 1): ("rgb24", "bgr0"), (2, 2): ("gray16le", "gray16le"),
    (3, 2): ("rgb48le", "gbrp16le"),
}  # fmt: skip


def render_film(
    frames: Frames,
    path: str | os.PathLike[str],
    calibration: Calibration | None = None,
    *,
    preset: str = "balanced",
    scale: float | None = None,
    rate: float | Fraction | None = None,
    overwrite: bool = False,
    client: Any = None,
    threads: int | None = None,
) -> Iterator[FrameResult]:
    """Render the frames of a sequence into a film, which is complete once the last result has been taken.

    Pictures are those of `render_frames`. Until the film is complete they are kept in a hidden folder beside it, from
    which a run that was killed is continued. In place of a frame that fails the picture before it is repeated. Errors
    say that the film cannot be written (OutputError, PictureError), is there already, or has no picture (FlatError).

    The suffix of `path` chooses the film: `.mp4` is H.264 with 8 bits up to the white of the camera, nearly lossless,
    `.mkv` FFV1, lossless, also with 16 bits, `.yuv` raw planes, 4:2:0 of 10 bits; all need the package `av`. It has
    `rate` pictures a second, with None those of the first video, else 25. `overwrite` replaces an existing film, and
    renders all pictures again; the rest is as for `render_frames`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/0.png", flat)
    ...     done = list(render_film(lfrender.open_frames([folder]), f"{folder}/film.mp4", camera, preset="fast"))
    >>> [frame.outcome for frame in done]
    ['rendered']
    """
    output = Path(path).absolute()
    check_format(output, "film", inputs=frames.files)
    if output.exists() and not overwrite:
        raise OutputError(f"{path}: is there already; give another output, or render it again (--overwrite)")
    checkpoint = Checkpoint(output)
    camera = None if calibration is None else calibration.to_dict()
    key = fingerprint([file_identity(file) for file in (*frames.files, frames.dark)], camera, preset, scale)
    if overwrite or checkpoint.find("film", key) is None:
        checkpoint.remove()
        checkpoint.keep("film", key)
    # Rates of television have denominators up to 1001; further digits of a decimal number are rounding.
    speed = Fraction(rate or frames.rate or 25).limit_denominator(1001)
    pictures = render_frames(
        frames, checkpoint.folder, calibration, preset=preset, scale=scale, client=client, threads=threads
    )
    partial = checkpoint.folder / f"film{output.suffix.lower()}"
    about = {"software": "lfrender", "rendering": "all in focus", "preset": preset}
    shown: Path | None = None
    times = 0
    # Closed in this order: threads must end before the film that they write into, and not in the garbage collector.
    with closing(pictures), FilmFile(partial, speed, json.dumps(about)) as film:
        for result in pictures:
            shown = shown if result.outcome == "failed" else result.path
            times += 1
            if shown is not None:
                white = load_camera(checkpoint.folder).white_level
                pixels = to_film_pixels(read_flat(shown), film.eight_bits, white)
                for _ in range(times):
                    film.add(pixels)
                times = 0
            yield replace(result, path=output)
        if not film.count:
            raise FlatError(f"{path}: is not written, because none of the frames could be rendered")
    move_into_place(partial, output)
    checkpoint.remove()


def write_moving(path: Path, pictures: Iterable[Rendering]) -> None:
    """Write pictures as an animation or a film by the suffix, as fast as `write_animation`; whole or not at all."""
    if not FORMATS[path.suffix.lower()].film:
        write_animation(path, pictures)
        return
    comment = json.dumps({"software": "lfrender"})
    with atomic_write(path) as temporary, FilmFile(temporary, Fraction(25, 2), comment) as film:
        for picture in pictures:
            film.add(to_film_pixels(picture.image, film.eight_bits, picture.white))


def to_film_pixels(pixels: NDArray[Any], only_eight_bits: bool = False, white: float | None = None) -> NDArray[Any]:
    """A picture in a pixel type that films hold: 8 bits if that is all, else its own type, and 16 bits for floats."""
    if only_eight_bits:
        return to_eight_bits(pixels, white)
    if pixels.dtype.kind != "f":
        return pixels
    return np.rint(np.clip(pixels, 0, 1) * 65535).astype(np.uint16)


class FilmFile:
    """A film being written, complete once it is closed; use it in a `with` statement.

    It has `rate` pictures a second, and holds the text `comment`.
    """

    def __init__(self, path: Path, rate: Fraction, comment: str) -> None:
        import av

        #: Number of pictures.
        self.count = 0
        self._path, self._rate, self._kind = path, rate, path.suffix.lower()
        self._stream: Any = None
        # With the index before the pictures, a browser can play the film before it has all of it.
        options = {"movflags": "+faststart"} if self._kind == ".mp4" else {}
        with self._output_errors():
            form = "rawvideo" if self._kind == ".yuv" else None
            self._file = av.open(str(path), "w", format=form, options=options)
            self._file.metadata["comment"] = comment

    @property
    def eight_bits(self) -> bool:
        """Whether the film holds no more than 8 bits."""
        return self._kind == ".mp4"

    def add(self, pixels: NDArray[Any]) -> None:
        """Add a picture (h, w) or (h, w, 3), uint8 or uint16, of the size and type of the first one.

        PictureError if it is of another, OutputError if the film cannot be written.
        """
        if self._stream is None:
            self._first = pixels.shape, pixels.dtype
        if (pixels.shape, pixels.dtype) != self._first:
            told = " and ".join(
                f"{shape[1]} x {shape[0]} px of {kind}" for shape, kind in (self._first, (pixels.shape, pixels.dtype))
            )
            raise PictureError(f"{self._path}: the pictures of a film are of one kind, these are {told}")
        with self._output_errors():
            frame = self._frame(pixels)
            if self._stream is None:
                self._begin(frame)
            frame.pts, frame.time_base = self.count, 1 / self._rate
            self._file.mux(self._stream.encode(frame))
        self.count += 1

    def close(self) -> None:
        """Write what the encoder still holds, and close the file."""
        with self._output_errors():
            if self._stream is not None:
                self._file.mux(self._stream.encode())
            self._file.close()

    def __enter__(self) -> FilmFile:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
            return
        # The error is raised already, and the file is incomplete.
        with suppress(OutputError), self._output_errors():
            self._file.close()

    def _begin(self, frame: Any) -> None:
        film = FORMATS[self._kind].film
        assert film is not None
        self._stream = self._file.add_stream(film[0], rate=self._rate, options=dict(film[1]))
        context = self._stream.codec_context
        # A fixed number, so that the film is the same on every machine.
        context.thread_count = 4
        context.width, context.height, context.pix_fmt = frame.width, frame.height, frame.format.name
        if self._kind == ".mp4":
            # Codes of ITU-T H.273 for the colours of HD television (BT.709) and their limited range.
            context.colorspace = context.color_primaries = context.color_trc = context.color_range = 1

    def _frame(self, pixels: NDArray[Any]) -> Any:
        """The picture as it is encoded."""
        import av

        if self._kind == ".yuv":
            return yuv_frame(pixels, "yuv420p10")
        given, stored = _LAYOUTS[pixels.ndim, pixels.dtype.itemsize]
        if self._kind == ".mkv":
            return av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=given).reformat(format=stored)
        # Colours are stored for 2 x 2 pixels each: odd sizes get one more row or column.
        odd = [(0, n % 2) for n in pixels.shape[:2]]
        pixels = np.pad(pixels, [*odd, (0, 0)][: pixels.ndim], mode="edge")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=given)
        return convert_frame(frame, "yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")

    @contextmanager
    def _output_errors(self) -> Iterator[None]:
        """Turn errors of the encoder into an OutputError."""
        import av

        try:
            yield
        except (av.error.FFmpegError, OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise OutputError(f"{self._path}: cannot be written ({reason})") from error
