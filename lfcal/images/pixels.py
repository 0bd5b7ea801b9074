"""Checks of all readers of flats, and readers of PNG, WebP, JPEG, BMP, PGM and PPM files.

Pillow reads the size before anything is decoded, and the checksums of PNG. It decodes PNG of 8 bits
and JPEG, because OpenCV returns half-empty pictures of truncated ones. OpenCV decodes the others,
because Pillow reduces colours to 8 bits.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.opencv_log import silent_opencv

__all__ = [
    "MAX_PIXELS",
    "check_only_page",
    "check_page",
    "check_size",
    "checked_pixels",
    "decode_picture",
    "decode_with_opencv",
    "file_errors",
    "import_reader",
]

#: Largest flat that is read [px]: twice a 25,000 x 22,000 sensor, and the default limit of OpenCV.
MAX_PIXELS = 1 << 30
_PILLOW_NAMES = {
    "PNG": "Png",
    "WebP": "WebP",
    "JPEG": "Jpeg",
    "BMP": "Bmp",
    "PGM": "Ppm",
    "PPM": "Ppm",
}
# Position in a PNG file of the bits of a sample; the kind of its colours follows: 0 is grey, 4 grey
# with alpha.
_PNG_BITS = 24


def check_size(width: int, height: int) -> None:
    """Raise FlatError unless an image of this size [px] can be a flat."""
    if width < 1 or height < 1:
        raise FlatError(f"image size {width} x {height} is not valid")
    if width * height > MAX_PIXELS:
        raise FlatError(
            f"{width} x {height} px is more than the {MAX_PIXELS} px this toolkit reads"
        )


def check_page(page: int | None, count: int, file: str, pictures: str, one: str) -> int:
    """The number of a picture in a file; FlatError if the file has no such or several pictures."""
    if page is None and count != 1:
        advice = "give the number of one (--page), or use 'lfrender batch'"
        raise FlatError(f"the {file} holds {count} {pictures}; {advice}")
    if not 0 <= (page or 0) < count:
        raise FlatError(f"the {file} holds {count} {pictures} and no {one} {page}")
    return page or 0


def check_only_page(page: int | None) -> None:
    """Raise FlatError if another page than the only picture of a file is asked for."""
    if page not in (None, 0):
        raise FlatError(f"has one picture and no page {page}")


def import_reader(name: str, extra: str) -> Any:
    """The package that reads a format; FlatError with the extra to install if it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        raise FlatError(f"needs the package '{name}'; pip install 'lfrender[{extra}]'") from error


@contextmanager
def file_errors(source: Path) -> Iterator[None]:
    """Turn any error of reading a file into a FlatError with the name of the file."""
    try:
        yield
    except FlatError as error:
        raise FlatError(f"{source}: {error}") from error
    except OSError as error:
        raise FlatError(f"{source}: cannot be read ({error.strerror or error})") from error
    except MemoryError as error:
        raise FlatError(f"{source}: the image does not fit into memory") from error
    # Decoders of damaged files raise IndexError, struct.error, zlib.error, cv2.error and others.
    except Exception as error:
        reason = shorten(str(error), 255) or type(error).__name__
        raise FlatError(f"{source}: damaged image file ({reason})") from error


def checked_pixels(pixels: NDArray[Any]) -> NDArray[Any]:
    """Decoded pixels as uint8, uint16 or float32, (h, w) or (h, w, 3), finite and contiguous."""
    native = pixels.dtype.newbyteorder("=")
    if native == np.bool_:
        pixels = pixels.astype(np.uint8) * np.uint8(255)
    elif native in (np.int8, np.int16):
        # They are left after a dark frame was subtracted: less than no light is noise.
        pixels = np.maximum(pixels, 0).astype(f"u{native.itemsize}")
    elif native in (np.float16, np.float64):
        with np.errstate(over="ignore"):
            pixels = pixels.astype(np.float32)
    elif native not in (np.uint8, np.uint16, np.float32):
        raise FlatError(
            f"pixels of type {pixels.dtype} are not read; save them as 8 bit, 16 bit or float"
        )
    if pixels.ndim == 3:
        pixels = pixels[..., 0] if pixels.shape[2] <= 2 else pixels[..., :3]
    if pixels.ndim not in (2, 3):
        raise FlatError(f"a flat is one grey or RGB picture, this has shape {pixels.shape}")
    bad = 0
    if pixels.dtype.kind == "f":
        bad = pixels.size - int(np.count_nonzero(np.isfinite(pixels)))
    if bad:
        raise FlatError(
            f"{bad} values are NaN or infinite; replace them by the mean of their neighbours"
        )
    return np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("="))


def decode_picture(data: bytes, name: str) -> NDArray[Any]:
    """Pixels (h, w) or (h, w, c) of the bytes of a file in the format `name`, with all bits."""
    image = _open_with_pillow(data, name)
    check_size(*image.size)
    if getattr(image, "n_frames", 1) > 1:
        raise FlatError("is an animation; a flat is one picture")
    if name == "PNG":
        # Decoders do not notice a missing end; the checksums of all chunks do.
        image.verify()
        if data[_PNG_BITS] > 8:
            return decode_with_opencv(data, grey=data[_PNG_BITS + 1] in (0, 4))
        image = _open_with_pillow(data, name)
    elif name != "JPEG":
        # OpenCV needs a character after the last number of a text file.
        return decode_with_opencv(data + b"\n" if data[:2] in (b"P2", b"P3") else data)
    if image.mode in ("P", "PA"):
        image.info.pop("transparency", None)
        image = image.convert("RGB")
    if image.mode not in ("1", "L", "LA", "RGB", "RGBA"):
        raise FlatError(f"pixels of kind {image.mode} are not read; save as grey or RGB")
    return np.asarray(image)


def _open_with_pillow(data: bytes, name: str) -> Any:
    """A Pillow image; not by `Image.open`, which refuses pictures above 179 megapixels."""
    pillow = _PILLOW_NAMES[name]
    plugin = import_module(f"PIL.{pillow}ImagePlugin")
    return getattr(plugin, f"{pillow}ImageFile")(io.BytesIO(data))


def decode_with_opencv(data: bytes, grey: bool = False) -> NDArray[Any]:
    """Pixels of any file that OpenCV reads, RGB without alpha; a `grey` file may have alpha."""
    import cv2

    with silent_opencv():
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise FlatError("damaged image file: its pixels cannot be decoded")
    check_size(pixels.shape[1], pixels.shape[0])
    if grey or pixels.ndim == 2:
        return pixels.reshape(*pixels.shape[:2], -1)[..., 0]
    # This drops alpha and leaves the colours below it unchanged.
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB if pixels.shape[2] == 3 else cv2.COLOR_BGRA2RGB)
