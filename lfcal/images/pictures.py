"""Files of one picture: PNG, WebP, JPEG, BMP, PGM, PPM; pixels exactly as stored, truncated or damaged files refused.

Pillow reads the size before anything is decoded, the checksums of PNG, and pixels of 8 bits of PNG and JPEG, of which
OpenCV returns half-empty pictures where files are truncated. OpenCV decodes the others: Pillow cuts colours to 8 bits.
"""

from __future__ import annotations

import io
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from .pixels import check_size

__all__ = ["decode_picture", "decode_with_opencv"]

_PILLOW_NAMES = {"PNG": "Png", "WebP": "WebP", "JPEG": "Jpeg", "BMP": "Bmp", "PGM": "Ppm", "PPM": "Ppm"}


def decode_picture(data: bytes, name: str) -> NDArray[Any]:
    """Pixels (h, w) or (h, w, c) of a file of the format `name`, 16 bits where it has them."""
    image = _open_with_pillow(data, name)
    check_size(*image.size)
    if getattr(image, "n_frames", 1) > 1:
        raise FlatError("is an animation; a flat is one picture")
    if name == "PNG":
        # Checksums of all chunks, up to the last one, which decoders do not miss.
        image.verify()
        # Bits of a sample, and the kind of colours: 0 is grey, 4 grey with alpha.
        depth, colours = data[24], data[25]
        if depth > 8:
            return decode_with_opencv(data, grey=colours in (0, 4))
        image = _open_with_pillow(data, name)
    elif name != "JPEG":
        # OpenCV looks for the end of the last number of a text file.
        return decode_with_opencv(data + b"\n" if data[:2] in (b"P2", b"P3") else data)
    if image.mode in ("P", "PA"):
        image.info.pop("transparency", None)
        image = image.convert("RGB")
    if image.mode not in ("1", "L", "LA", "RGB", "RGBA"):
        raise FlatError(f"pixels of kind {image.mode} are not read; save as grey or RGB")
    return np.asarray(image)


def _open_with_pillow(data: bytes, name: str) -> Any:
    """A Pillow image by the format's own class: `Image.open` refuses sensors above 179 megapixels."""
    pillow = _PILLOW_NAMES[name]
    return getattr(import_module(f"PIL.{pillow}ImagePlugin"), f"{pillow}ImageFile")(io.BytesIO(data))


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
    if pixels.ndim == 2 or grey:
        return pixels if pixels.ndim == 2 else pixels[..., 0]
    # Dropping alpha with the reordering; COLOR_BGRA2RGB does not touch the colours under it.
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB if pixels.shape[2] == 3 else cv2.COLOR_BGRA2RGB)
