"""Decoders of single-picture image formats: pixels exactly as stored, truncated or damaged files refused.

Most libraries return a half-empty picture for a truncated file, which would still calibrate and render: every format
is checked for completeness before it is decoded.
"""

from __future__ import annotations

import io
import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError

__all__ = [
    "MAX_PIXELS", "check_size", "decode_bmp", "decode_jpeg", "decode_png", "decode_pnm", "decode_webp",
    "decode_with_opencv",
]  # fmt: skip

#: Largest flat that is read [px]: twice a 25,000 x 22,000 sensor, and what OpenCV accepts out of the box.
MAX_PIXELS = 1 << 30


def check_size(width: int, height: int) -> None:
    """FlatError unless an image of this size may be read."""
    if width < 1 or height < 1:
        raise FlatError(f"image size {width} x {height} is not valid")
    if width * height > MAX_PIXELS:
        raise FlatError(f"{width} x {height} px is more than the {MAX_PIXELS} px this toolkit reads")


def decode_png(data: bytes) -> NDArray[Any]:
    """Pixels of a PNG file, 16 bits where it has them; alpha is kept."""
    from PIL import PngImagePlugin

    image, depth, colour = PngImagePlugin.PngImageFile(io.BytesIO(data)), data[24], data[25]
    check_size(*image.size)
    try:
        # Checksums of all chunks, up to the last one, which decoders do not miss.
        image.verify()
    except (OSError, SyntaxError) as error:
        raise FlatError(f"damaged or truncated PNG: {error}") from error
    if depth <= 8:
        return _from_pillow(PngImagePlugin.PngImageFile(io.BytesIO(data)))
    # Pillow cuts 16-bit colours down to 8 bits.
    return decode_with_opencv(data, grey=colour in (0, 4))


def decode_webp(data: bytes) -> NDArray[Any]:
    """Pixels of a WebP file of one picture."""
    if len(data) < struct.unpack_from("<I", data, 4)[0] + 8:
        raise FlatError("truncated WebP")
    if data[12:16] == b"VP8X" and data[20] & 2:
        raise FlatError("is an animation; a flat is one picture")
    return decode_with_opencv(data)


def decode_jpeg(data: bytes) -> NDArray[Any]:
    """8-bit grey or RGB pixels of a JPEG file."""
    from PIL import JpegImagePlugin

    return _from_pillow(JpegImagePlugin.JpegImageFile(io.BytesIO(data)))


def decode_bmp(data: bytes) -> NDArray[Any]:
    """8-bit grey or RGB pixels of a BMP file."""
    from PIL import BmpImagePlugin

    return _from_pillow(BmpImagePlugin.BmpImageFile(io.BytesIO(data)))


def decode_pnm(data: bytes) -> NDArray[Any]:
    """Pixels of a PGM or PPM file, text or binary, whatever the maximum in its header."""
    header = re.match(rb"P([2356])" + rb"(?:\s|#[^\n]*\n)+(\d{1,10})" * 3 + rb"\s", data)
    if header is None:
        raise FlatError("damaged PGM or PPM header")
    kind, width, height, maximum = (int(v) for v in header.groups())
    check_size(width, height)
    if not 1 <= maximum <= 65535:
        raise FlatError(f"damaged PGM or PPM header: maximum value {maximum}")
    channels = 3 if kind in (3, 6) else 1
    count = width * height * channels
    dtype = np.dtype(np.uint8 if maximum < 256 else ">u2")
    body = memoryview(data)[header.end() :]
    if kind >= 5:
        if len(body) < count * dtype.itemsize:
            raise FlatError(f"truncated PGM or PPM: {count * dtype.itemsize - len(body)} bytes are missing")
        values = np.frombuffer(body, dtype, count)
    else:
        words = bytes(body).split(maxsplit=count)[:count]
        if len(words) < count:
            raise FlatError("truncated PGM or PPM: values are missing")
        values = np.array(words).astype(np.int64)
        if values.min() < 0 or values.max() > maximum:
            raise FlatError(f"damaged PGM or PPM: values beyond the maximum {maximum}")
        values = values.astype(dtype)
    return values.reshape((height, width, 3) if channels == 3 else (height, width))


def decode_with_opencv(data: bytes, grey: bool = False) -> NDArray[Any]:
    """Pixels of any file that OpenCV reads, RGB without alpha; a `grey` file may have alpha."""
    import cv2

    log = cv2.utils.logging
    level = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    finally:
        log.setLogLevel(level)
    if pixels is None:
        raise FlatError("damaged image file: its pixels cannot be decoded")
    check_size(pixels.shape[1], pixels.shape[0])
    if pixels.ndim == 3 and not grey:
        # Dropping alpha with the reordering; COLOR_BGRA2RGB does not touch the colours under it.
        code = cv2.COLOR_BGR2RGB if pixels.shape[2] == 3 else cv2.COLOR_BGRA2RGB
        return cv2.cvtColor(pixels, code)
    return pixels


def _from_pillow(image: Any) -> NDArray[Any]:
    """8-bit grey or RGB pixels of a Pillow image that is not loaded yet."""
    # The format's own class is used, not Image.open: that one refuses sensors above 179 megapixels.
    check_size(*image.size)
    if image.mode in ("P", "PA"):
        image.info.pop("transparency", None)
        image = image.convert("RGB")
    elif image.mode == "1":
        image = image.convert("L")
    if image.mode not in ("L", "LA", "RGB", "RGBA", "RGBX"):
        raise FlatError(f"pixels of kind {image.mode} are not read; save as grey or RGB")
    image.load()
    width, height = image.size
    bands = len(image.getbands())
    pixels = np.empty((height, width) if bands < 3 else (height, width, 3), np.uint8)
    # In strips, as Pillow's conversion to NumPy makes two more copies of what it converts.
    rows = 512
    for top in range(0, height, rows):
        strip = np.asarray(image.crop((0, top, width, min(height, top + rows))))
        pixels[top : top + rows] = strip if bands in (1, 3) else strip[..., 0 if bands == 2 else slice(3)]
    return pixels
