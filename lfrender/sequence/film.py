"""A sequence rendered into a film: H.264 in MP4, which plays everywhere, or FFV1 in Matroska, which is lossless."""

from __future__ import annotations

import json
import os
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatError, OutputError, read_flat
from lfcal.runtime.eight_bit import to_eight_bits
from lfcal.runtime.output_file import atomic_write
from lfcal.runtime.video.frame_pixels import convert_frame, frame_of_planes

from ..output.formats import FORMATS, PictureError, check_format
from ..output.raw_video import raw_format_of, yuv_frame
from ..output.resume import Checkpoint, file_identity, fingerprint
from ..output.tiled_picture import move_into_place
from .batch import render_frames
from .frames import Frames
from .job import FrameResult, load_camera

if TYPE_CHECKING:
    from distributed import Client

    from ..data.rendering import Rendering

__all__ = ["FilmFile", "check_film", "render_film", "to_film_pixels", "write_film"]

# What PyAV calls arrays of so many channels and bytes, and how FFV1 stores them.
_LAYOUTS = {
    (1, 1): ("gray", "gray"), (3, 1): ("rgb24", "bgr0"), (1, 2): ("gray16le", "gray16le"),
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
    client: Client | None = None,
    threads: int | None = None,
) -> Iterator[FrameResult]:
    """Render the frames of a sequence into a film, which is complete once the last result has been taken.

    Pictures are those of `render_frames`. Until the film is complete they are kept in a hidden folder beside it, from
    which a run that was killed is continued. In place of a frame that fails the picture before it is repeated.

    Parameters
    ----------
    frames : Frames
        From `open_frames`.
    path : path-like
        `.mp4`: H.264 with 8 bits up to the white of the camera, nearly lossless; `.mkv`: FFV1, lossless, also with 16
        bits; `.yuv`: raw planes, 4:2:0 of 10 bits. Needs the package `av`.
    calibration, preset, scale
        As in `render_frames`.
    rate : float, Fraction or None
        Pictures a second; with None that of the first video, else 25.
    overwrite : bool
        Replace an existing film, and render all pictures again.
    client : distributed.Client or None
        Render on this cluster, as `render_frames_on`.
    threads : int or None
        As in `render_frames_on`.

    Yields
    ------
    FrameResult
        In the order of the frames.

    Raises
    ------
    OutputError, PictureError
        If the film cannot be written, or is there already.
    FlatError
        If none of the frames can be rendered.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> with TemporaryDirectory() as folder:
    ...     for number in range(2):
    ...         lfrender.write_picture(f"{folder}/{number}.png", flat)
    ...     done = list(render_film(lfrender.open_frames([folder]), f"{folder}/film.mp4", camera, preset="fast"))
    >>> [frame.outcome for frame in done]
    ['rendered', 'rendered']
    """
    output = Path(path).absolute()
    check_film(output, frames.files)
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
    options: dict[str, Any] = {"preset": preset, "scale": scale}
    if client is None:
        pictures = render_frames(frames, checkpoint.folder, calibration, **options)
    else:
        from .cluster import render_frames_on

        pictures = render_frames_on(client, frames, checkpoint.folder, calibration, threads=threads, **options)
    comment = json.dumps({"software": "lfrender", "rendering": "all in focus", "preset": preset})
    partial = checkpoint.folder / f"film{output.suffix.lower()}"
    # Closed in this order: threads must end before the film that they write into, and not in the garbage collector.
    with (
        closing(pictures),
        FilmFile(partial, speed, comment) as film,
        closing(_encode(pictures, film, checkpoint.folder)) as results,
    ):
        for result in results:
            yield replace(result, path=output)
        if not film.count:
            raise FlatError(f"{path}: is not written, because none of the frames could be rendered")
    move_into_place(partial, output)
    checkpoint.remove()


def _encode(results: Iterable[FrameResult], film: FilmFile, folder: Path) -> Generator[FrameResult, None, None]:
    """Add the pictures of a folder to a film, each in a thread of its own while the next one is rendered."""
    waiting: Future[None] | None = None
    shown: Path | None = None
    white: float | None = None
    times = 0
    with ThreadPoolExecutor(1) as encoder:
        for result in results:
            shown = shown if result.outcome == "failed" else result.path
            times += 1
            if shown is not None:
                if waiting is None:
                    white = load_camera(folder).white_level
                else:
                    waiting.result()
                waiting = encoder.submit(_add, film, shown, times, white)
                times = 0
            yield result
        if waiting is not None:
            waiting.result()


def _add(film: FilmFile, picture: Path, times: int, white: float | None) -> None:
    pixels = to_film_pixels(read_flat(picture), film.eight_bits, white)
    for _ in range(times):
        film.add(pixels)


def write_film(path: str | os.PathLike[str], pictures: Iterable[Rendering], rate: Fraction = Fraction(25, 2)) -> None:
    """Write pictures, such as views around a circle, as a film; the file appears whole or not at all.

    `rate` is that of `write_animation` [pictures a second]. Errors as of `check_film`.
    """
    check_film(Path(path))
    comment = json.dumps({"software": "lfrender"})
    with atomic_write(path) as temporary, FilmFile(temporary, rate, comment) as film:
        for picture in pictures:
            film.add(to_film_pixels(picture.image, film.eight_bits, picture.white))


def check_film(path: Path, inputs: Iterable[Path | None] = ()) -> None:
    """Raise an error if a film could not be written, before its first picture is rendered; as `check_format`."""
    check_format(path, "film", inputs=inputs)
    import av

    encoder, _ = _encoder_of(path)
    if encoder not in av.codecs_available:
        raise PictureError(f"{path}: the package 'av' was built without the encoder {encoder}; use another suffix")


def _encoder_of(path: Path) -> tuple[str, dict[str, str]]:
    film = FORMATS[path.suffix.lower()].film
    assert film is not None
    return film


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
        self._shape: tuple[int, ...] = ()
        self._dtype = np.dtype(np.uint8)
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
        """Add a picture (h, w) or (h, w, 3), uint8 or uint16, converted to the type and channels of the first one.

        PictureError if it has another size than the first one, OutputError if the film cannot be written.
        """
        if self._stream is None:
            self._begin(pixels)
        if pixels.shape[:2] != self._shape[:2]:
            sizes = " and ".join(f"{shape[1]} x {shape[0]}" for shape in (self._shape, pixels.shape))
            raise PictureError(f"{self._path}: the pictures of a film have one size, these have {sizes} px")
        with self._output_errors():
            frame = self._frame(_convert_like(pixels, self._shape, self._dtype))
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
        else:
            # The error is raised already, and the file is incomplete.
            with self._output_errors(silent=True):
                self._file.close()

    def _begin(self, pixels: NDArray[Any]) -> None:
        self._shape, self._dtype = pixels.shape, pixels.dtype
        codec, options = _encoder_of(self._path)
        height, width = self._shape[:2]
        with self._output_errors():
            self._stream = self._file.add_stream(codec, rate=self._rate, options=dict(options))
            context = self._stream.codec_context
            # A fixed number, so that the film is the same on every machine.
            context.thread_count = 4
            if self._kind == ".mp4":
                context.width, context.height, context.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
                # Codes of ITU-T H.273 for the colours of HD television (BT.709) and their limited range.
                context.colorspace = context.color_primaries = context.color_trc = 1
                context.color_range = 1
            elif self._kind == ".yuv":
                layout = raw_format_of(self._shape, "yuv420p10")
                context.width, context.height, context.pix_fmt = layout.width, layout.height, layout.pixel_format
            else:
                context.width, context.height, context.pix_fmt = width, height, self._layout[1]

    @property
    def _layout(self) -> tuple[str, str]:
        return _LAYOUTS[3 if len(self._shape) == 3 else 1, self._dtype.itemsize]

    def _frame(self, pixels: NDArray[Any]) -> Any:
        import av

        if self._kind == ".mp4":
            # Colours are stored for 2 x 2 pixels each: odd sizes get one more row or column.
            odd = [(0, n % 2) for n in pixels.shape[:2]]
            pixels = np.pad(pixels, [*odd, (0, 0)][: pixels.ndim], mode="edge")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=self._layout[0])
            frame = convert_frame(frame, "yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        elif self._kind == ".yuv":
            layout = raw_format_of(self._shape, "yuv420p10")
            frame = frame_of_planes(yuv_frame(pixels, "yuv420p10"), layout.width, layout.height, layout.pixel_format)
        else:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=self._layout[0])
            frame = frame.reformat(format=self._layout[1])
        return frame

    @contextmanager
    def _output_errors(self, silent: bool = False) -> Iterator[None]:
        """Turn errors of the encoder into an OutputError."""
        import av

        try:
            yield
        except (av.error.FFmpegError, OSError, ValueError) as error:
            if silent:
                return
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise OutputError(f"{self._path}: cannot be written ({reason})") from error


def _convert_like(pixels: NDArray[Any], shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Pixels with as many channels and the type of another picture."""
    if pixels.ndim < len(shape):
        pixels = np.repeat(pixels[..., None], 3, 2)
    elif pixels.ndim > len(shape):
        pixels = np.rint(pixels.mean(2)).astype(pixels.dtype)
    if pixels.dtype.itemsize < dtype.itemsize:
        return pixels.astype(np.uint16) * np.uint16(257)
    if pixels.dtype.itemsize > dtype.itemsize:
        return ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return pixels
