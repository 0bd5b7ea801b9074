"""Films of pictures of one size: H.264 in MP4, which everything plays, or FFV1 in Matroska, which loses nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import OutputError
from lfcal.runtime.eight_bit import to_eight_bits
from lfcal.runtime.output_file import check_output

from ..output.picture import PictureError
from .frames import convert_pixels

__all__ = ["FILMS", "FilmFile", "check_film", "film_pixels"]

# Encoder and its options. The eye sees no difference at this rate factor, and hardly at twice that.
_H264: tuple[str, dict[str, str]] = ("libx264", {"crf": "10", "preset": "fast"})
# Every picture stands for itself, and has a checksum.
_FFV1: tuple[str, dict[str, str]] = ("ffv1", {"level": "3", "g": "1", "slicecrc": "1"})
#: Endings of films.
FILMS = {".mp4": _H264, ".mkv": _FFV1}
# A film is the same whatever machine has encoded it.
_THREADS = 4
# Codes of ITU-T H.273 for the colours of HD television, and for values that leave room at both ends.
_BT709 = _NARROW = 1
# What PyAV calls arrays of so many channels and bytes, and how FFV1 stores them.
_LAYOUTS = {(1, 1): ("gray", "gray"), (3, 1): ("rgb24", "bgr0"), (1, 2): ("gray16le", "gray16le")}
_LAYOUTS[3, 2] = ("rgb48le", "gbrp16le")


def check_film(path: Path, inputs: Iterable[Path | None] = ()) -> None:
    """Refuse a film that could not be written, before its first picture is rendered.

    Raises
    ------
    OutputError
        If the ending is not one of `FILMS`, the folder cannot be written, or `path` is one of the inputs.
    PictureError
        If the package `av` is not installed, or has no encoder for such films.
    """
    check_output(path, FILMS, inputs)
    try:
        import av
    except ImportError as error:
        raise PictureError(f"{path}: films need the package 'av'; pip install 'lfrender[video]'") from error
    encoder = FILMS[path.suffix.lower()][0]
    if encoder not in av.codecs_available:
        raise PictureError(f"{path}: the package 'av' was built without the encoder {encoder}; use another ending")


def film_pixels(pixels: NDArray[Any], only_eight_bits: bool = False, white: float | None = None) -> NDArray[Any]:
    """A picture as films hold it: with 8 bits as `to_eight_bits`, or as it is, but for floats: with 16 bits."""
    if only_eight_bits:
        return to_eight_bits(pixels, white)
    if pixels.dtype.kind != "f":
        return pixels
    return np.rint(np.clip(pixels, 0, 1) * 65535).astype(np.uint16)


class FilmFile:
    """A film that is being written; use it in a `with` statement.

    Parameters
    ----------
    path : Path
        The file to write, which is whole once it is closed.
    rate : Fraction
        Pictures a second.
    comment : str
        Text to store in the film.
    """

    def __init__(self, path: Path, rate: Fraction, comment: str) -> None:
        import av

        #: Number of pictures.
        self.count = 0
        self._path, self._rate, self._kind = path, rate, path.suffix.lower()
        self._shape: tuple[int, ...] = ()
        self._dtype = np.dtype(np.uint8)
        self._stream: Any = None
        # The index stands before the pictures, so that a browser begins to play before it has the file.
        options = {"movflags": "+faststart"} if self._kind == ".mp4" else {}
        with self._told():
            self._file = av.open(str(path), "w", options=options)
            self._file.metadata["comment"] = comment

    @property
    def eight_bits(self) -> bool:
        """Whether the film holds no more than 8 bits."""
        return self._kind == ".mp4"

    def add(self, pixels: NDArray[Any]) -> None:
        """Add a picture (h, w) or (h, w, 3), uint8 or uint16; the first one tells the kind of all others.

        Raises
        ------
        PictureError
            If it has another size than the first one.
        OutputError
            If the film cannot be written.
        """
        if self._stream is None:
            self._begin(pixels)
        if pixels.shape[:2] != self._shape[:2]:
            sizes = " and ".join(f"{shape[1]} x {shape[0]}" for shape in (self._shape, pixels.shape))
            raise PictureError(f"{self._path}: the pictures of a film have one size, these have {sizes} px")
        with self._told():
            frame = self._frame(_alike(pixels, self._shape, self._dtype))
            frame.pts, frame.time_base = self.count, 1 / self._rate
            self._file.mux(self._stream.encode(frame))
        self.count += 1

    def close(self) -> None:
        """Write what is left to be written, and close the file."""
        with self._told():
            if self._stream is not None:
                self._file.mux(self._stream.encode())
            self._file.close()

    def __enter__(self) -> FilmFile:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            # What went wrong is known already, and nobody will see this file.
            with self._told(silent=True):
                self._file.close()

    def _begin(self, pixels: NDArray[Any]) -> None:
        self._shape, self._dtype = pixels.shape, pixels.dtype
        codec, options = FILMS[self._kind]
        height, width = self._shape[:2]
        with self._told():
            self._stream = self._file.add_stream(codec, rate=self._rate, options=dict(options))
            context = self._stream.codec_context
            context.thread_count = _THREADS
            if self._kind == ".mp4":
                context.width, context.height, context.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
                context.colorspace = context.color_primaries = context.color_trc = _BT709
                context.color_range = _NARROW
            else:
                context.width, context.height, context.pix_fmt = width, height, self._layout[1]

    @property
    def _layout(self) -> tuple[str, str]:
        return _LAYOUTS[3 if len(self._shape) == 3 else 1, self._dtype.itemsize]

    def _frame(self, pixels: NDArray[Any]) -> Any:
        import av

        if self._kind == ".mp4":
            # Colours are stored for 2 x 2 pixels each.
            odd = [(0, n % 2) for n in pixels.shape[:2]]
            pixels = np.pad(pixels, [*odd, (0, 0)][: pixels.ndim], mode="edge")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=self._layout[0])
            frame = convert_pixels(frame, "yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        else:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=self._layout[0])
            frame = frame.reformat(format=self._layout[1])
        return frame

    @contextmanager
    def _told(self, silent: bool = False) -> Iterator[None]:
        """What the encoder cannot do as an OutputError."""
        import av

        try:
            yield
        except (av.error.FFmpegError, OSError, ValueError) as error:
            if silent:
                return
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise OutputError(f"{self._path}: cannot be written ({reason})") from error


def _alike(pixels: NDArray[Any], shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Pixels with the channels and the type of others."""
    if pixels.ndim < len(shape):
        pixels = np.repeat(pixels[..., None], 3, 2)
    elif pixels.ndim > len(shape):
        pixels = np.rint(pixels.mean(2)).astype(pixels.dtype)
    if pixels.dtype.itemsize < dtype.itemsize:
        return pixels.astype(np.uint16) * np.uint16(257)
    if pixels.dtype.itemsize > dtype.itemsize:
        return ((pixels.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return pixels
