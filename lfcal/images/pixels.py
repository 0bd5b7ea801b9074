"""What all readers of flats share: the largest size, the types of pixels, and errors with the name of the file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError

__all__ = ["MAX_PIXELS", "check_only_page", "check_size", "checked_pixels", "file_errors", "import_reader"]

#: Largest flat that is read [px]: twice a 25,000 x 22,000 sensor, and what OpenCV accepts out of the box.
MAX_PIXELS = 1 << 30


def check_size(width: int, height: int) -> None:
    """FlatError unless an image of this size may be read."""
    if width < 1 or height < 1:
        raise FlatError(f"image size {width} x {height} is not valid")
    if width * height > MAX_PIXELS:
        raise FlatError(f"{width} x {height} px is more than the {MAX_PIXELS} px this toolkit reads")


def check_only_page(page: int | None) -> None:
    """FlatError where another page is wanted than the only picture of a file."""
    if page not in (None, 0):
        raise FlatError(f"has one picture and no page {page}")


def import_reader(name: str, extra: str) -> Any:
    """The package that reads a format; FlatError with the extra that installs it, where it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        raise FlatError(f"needs the package '{name}'; pip install 'lfrender[{extra}]'") from error


@contextmanager
def file_errors(source: Path) -> Iterator[None]:
    """Turn any error of reading a file into a FlatError with its name."""
    try:
        yield
    except FlatError as error:
        raise FlatError(f"{source}: {error}") from error
    except OSError as error:
        raise FlatError(f"{source}: cannot be read ({error.strerror or _one_line(error)})") from error
    except MemoryError as error:
        raise FlatError(f"{source}: the image does not fit into memory") from error
    # Damaged bytes make decoders raise anything: IndexError, struct.error, zlib.error, cv2.error, ...
    except Exception as error:
        raise FlatError(f"{source}: damaged image file ({_one_line(error)})") from error


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


def checked_pixels(pixels: NDArray[Any]) -> NDArray[Any]:
    """Decoded pixels as a flat: uint8, uint16 or float32, (h, w) or (h, w, 3), finite and contiguous."""
    native = pixels.dtype.newbyteorder("=")
    if native == np.bool_:
        pixels = pixels.astype(np.uint8) * np.uint8(255)
    elif native in (np.float16, np.float64):
        with np.errstate(over="ignore"):
            pixels = pixels.astype(np.float32)
    elif native not in (np.uint8, np.uint16, np.float32):
        raise FlatError(f"pixels of type {pixels.dtype} are not read; save them as 8 bit, 16 bit or float")
    if pixels.ndim == 3:
        pixels = pixels[..., 0] if pixels.shape[2] <= 2 else pixels[..., :3]
    if pixels.ndim not in (2, 3):
        raise FlatError(f"a flat is one grey or RGB picture, this has shape {pixels.shape}")
    if pixels.dtype.kind == "f":
        bad = pixels.size - int(np.count_nonzero(np.isfinite(pixels)))
        if bad:
            raise FlatError(f"{bad} values are NaN or infinite; replace them by the mean of their neighbours")
    return np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("="))
