"""Checks of all readers of flats, and readers of PNG, WebP, JPEG, BMP, PGM and PPM files.

Pillow reads the size before anything is decoded, and the checksums of PNG. It decodes PNG of 8
bits, JPEG and BMP; imagecodecs decodes WebP, whose colours Pillow multiplies by alpha, and PNG of
16 bits, whose colours Pillow reduces to 8. Both scale the samples of some PGM and PPM files, which
are read here.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..runtime.arrays import Array, Singles
from ..runtime.errors import FlatError
from ..runtime.packages import import_package
from ..runtime.types import Page

__all__ = [
    "MAX_PIXELS",
    "apply_palette",
    "check_only_page",
    "check_page",
    "check_pixels",
    "check_size",
    "check_unpacked",
    "convert_pixels",
    "decode_picture",
    "file_errors",
    "import_reader",
]

#: Largest flat that is read [px]: twice a 25,000 x 22,000 sensor, and the default limit of OpenCV.
MAX_PIXELS = 1 << 30
# Largest integer and float of a flat: sums of squares of larger floats exceed single precision.
_LARGEST_INTEGER = 0xFFFF
_LARGEST_FLOAT = 1e30
# Most bytes of pixels over those of their file, and bytes that are always read: shuffled and
# deflated pictures have ten times as many, blank ones a thousand times.
_MOST_UNPACKED = 1100
_ALWAYS_UNPACKED = 1 << 26
_PILLOW_NAMES = {
    "PNG": "Png",
    "WebP": "WebP",
    "JPEG": "Jpeg",
    "BMP": "Bmp",
}
# The kind of a Netpbm file, then width, height and maximum, between spaces and comments.
_NETPBM_COMMENT = re.compile(rb"#[^\r\n]*")
_NETPBM_HEADER = re.compile(rb"P([2356])" + 3 * rb"(?:\s|#[^\r\n]*[\r\n])+(\d{1,9})" + rb"\s")
# Position in a PNG file of the bits of a sample.
_PNG_BITS = 24


def check_size(width: int, height: int) -> None:
    """Raise FlatError unless an image of this size [px] can be a flat."""
    if width < 1 or height < 1:
        raise FlatError(f"image size {width} x {height} is not valid")
    if width * height > MAX_PIXELS:
        raise FlatError(
            f"{width} x {height} px is more than the {MAX_PIXELS} px this toolkit reads"
        )


def check_page(page: Page, count: int, file: str, pictures: str, one: str) -> int:
    """The number of a picture in a file; FlatError if the file has no such or several pictures."""
    if page is None and count != 1:
        advice = "give the number of one (--page), or use 'lfrender batch'"
        raise FlatError(f"the {file} holds {count} {pictures}; {advice}")
    if not 0 <= (page or 0) < count:
        raise FlatError(f"the {file} holds {count} {pictures} and no {one} {page}")
    return page or 0


def check_only_page(page: Page) -> None:
    """Raise FlatError if another page than the only picture of a file is asked for."""
    if page not in (None, 0):
        raise FlatError(f"has one picture and no page {page}")


def import_reader(name: str) -> Any:
    """The package that reads a format; FlatError with how to install it if it is missing."""
    return import_package(name, "needs", FlatError)


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


def check_pixels(pixels: ArrayLike) -> Array:
    """The pixels of a flat in the form that all functions read, for files and for arrays.

    Alpha is dropped. Signed integers are clipped at 0: they are left where a dark frame was
    subtracted. Integers of more than 16 bits become uint16, other floats float32, booleans 0 and
    255.

    Parameters
    ----------
    pixels : (h, w) or (h, w, 1 to 4) array
        Grey, grey and alpha, red, green and blue, or these and alpha. Any real type.

    Returns
    -------
    (h, w) or (h, w, 3) uint8, uint16 or float32
        C-contiguous, in the byte order of the machine. FlatError for another shape or type, masked
        pixels, NaN, infinity, no pixel, negative values only, or integers above 65535.

    Examples
    --------
    >>> import lfcal, numpy as np
    >>> rgba = np.zeros((20, 30, 4), ">u2")
    >>> flat = lfcal.check_pixels(rgba)
    >>> flat.shape, flat.dtype
    ((20, 30, 3), dtype('uint16'))
    """
    if np.ma.is_masked(pixels):
        masked = np.ma.count_masked(np.ma.asarray(pixels))
        raise FlatError(f"{masked} values are masked; replace them by the mean of their neighbours")
    array = np.asarray(pixels)
    if array.ndim not in (2, 3) or 0 in array.shape or max(array.shape[2:], default=1) > 4:
        raise FlatError(
            f"has shape {array.shape}; a flat is one grey or RGB picture, (height, width) or "
            "(height, width, 3)"
        )
    if array.dtype.kind in "if" and array.max() < 0:
        raise FlatError("has negative values only; subtract a lower dark level")
    return convert_pixels(array)


def convert_pixels(array: Array) -> Array:
    """What `check_pixels` returns, for a part of a flat (h, w) or (h, w, 1 to 4)."""
    if array.ndim == 3:
        array = array[..., 0] if array.shape[2] <= 2 else array[..., :3]
    if array.dtype.kind == "b":
        array = array.astype(np.uint8) * np.uint8(255)
    elif array.dtype.kind in "iu":
        array = _unsigned(array)
    elif array.dtype.kind == "f":
        array = _finite(array)
    else:
        raise FlatError(
            f"pixels of type {array.dtype} are not read; save them as 8 bit, 16 bit or float"
        )
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))


def _unsigned(array: Array) -> Array:
    """Integers as uint8 or uint16; less than no light is noise."""
    size = min(array.dtype.itemsize, 2)
    if array.dtype.itemsize > 2 and array.max() > _LARGEST_INTEGER:
        raise FlatError(f"has values above {_LARGEST_INTEGER}; save it as 16 bit or float")
    if array.dtype.kind == "i":
        array = np.maximum(array, 0)
    return array.astype(f"u{size}", copy=False)


def _finite(array: Array) -> Singles:
    """Floats as float32."""
    with np.errstate(over="ignore", invalid="ignore"):
        single = array.astype(np.float32, copy=False)
        # A finite sum of single precision proves that no value is NaN or infinite.
        total = single.sum(dtype=np.float64)
    if not np.isfinite(total):
        bad = ~np.isfinite(array)
        if bad.any():
            y, x = np.argwhere(bad)[0][:2]
            raise FlatError(
                f"{bad.sum()} values are NaN or infinite, the first at x={x}, y={y}; replace them "
                "by the mean of their neighbours"
            )
    largest = max(-float(array.min()), float(array.max()))
    if largest > _LARGEST_FLOAT:
        raise FlatError(
            f"has values up to {largest:.3g}; scale them to at most {_LARGEST_FLOAT:.0e} first"
        )
    return single


def apply_palette(indices: Array, palette: NDArray[np.uint8]) -> Array:
    """(h, w, 3) colours of a picture of indices (h, w) by a palette (n, 3).

    The indices themselves are the picture where all colours of the palette are equal, as programs
    of cameras write them.
    """
    if (palette == palette[0]).all():
        return indices
    return palette[indices]


def check_unpacked(size: float, stored: int) -> None:
    """Raise FlatError if pixels of `size` bytes cannot come from a file of `stored` bytes."""
    if size > max(_MOST_UNPACKED * stored, _ALWAYS_UNPACKED):
        raise FlatError(
            f"its {stored} bytes claim to hold {size:.0f} bytes of pixels; the file is damaged or "
            "incomplete"
        )


def decode_picture(data: bytes, name: str) -> Array:
    """Pixels (h, w) or (h, w, c) of the bytes of a file in the format `name`, with all bits."""
    import imagecodecs

    if name in ("PGM", "PPM"):
        return _decode_netpbm(data)
    image = _open_with_pillow(data, name)
    check_size(*image.size)
    if getattr(image, "n_frames", 1) > 1:
        raise FlatError("is an animation; a flat is one picture")
    if name == "PNG":
        # Decoders do not notice a missing end; the checksums of all chunks do.
        image.verify()
        if data[_PNG_BITS] > 8:
            return imagecodecs.png_decode(data)
        image = _open_with_pillow(data, name)
    elif name == "WebP":
        return imagecodecs.webp_decode(data)
    if image.mode == "P":
        palette = np.array(image.getpalette("RGB"), np.uint8).reshape(-1, 3)
        return apply_palette(np.asarray(image), palette)
    if image.mode not in ("1", "L", "LA", "RGB", "RGBA"):
        raise FlatError(f"pixels of kind {image.mode} are not read; save as grey or RGB")
    return np.asarray(image)


def _decode_netpbm(data: bytes) -> Array:
    """Samples of a PGM or PPM file as stored: not scaled by the maximum in its header."""
    header = _NETPBM_HEADER.match(data)
    if header is None:
        raise FlatError("damaged image file: its header is incomplete")
    kind, *sizes = header.groups()
    width, height, maximum = map(int, sizes)
    check_size(width, height)
    shape = (height, width, 3) if kind in b"36" else (height, width)
    count = math.prod(shape)
    dtype = np.dtype(np.uint8 if maximum < 256 else ">u2")
    body = data[header.end() :]
    if kind in b"56":
        check_unpacked(count * dtype.itemsize, len(data))
        samples = np.frombuffer(body, dtype, count)
    else:
        check_unpacked(count, len(data))
        words = _NETPBM_COMMENT.sub(b"", body).split(maxsplit=count)
        samples = np.array(words[:count]).astype(np.uint16)
    if len(samples) < count or samples.max() > maximum > 0:
        raise FlatError("damaged image file: samples are missing or above their maximum")
    return samples.astype(dtype).reshape(shape)


def _open_with_pillow(data: bytes, name: str) -> Any:
    """A Pillow image; not by `Image.open`, which refuses pictures above 179 megapixels."""
    pillow = _PILLOW_NAMES[name]
    plugin = import_module(f"PIL.{pillow}ImagePlugin")
    return getattr(plugin, f"{pillow}ImageFile")(io.BytesIO(data))
