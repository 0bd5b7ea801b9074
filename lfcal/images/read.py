"""Reading flats: the raw pixels of an image file, exactly as stored, or a clear refusal.

Most decoders hand back a half-empty picture for a truncated file. A flat with a grey lower half would still
calibrate and render, so every format is checked for completeness here before its pixels are believed.
"""

from __future__ import annotations

import io
import logging
import os
import re
import stat
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from .zarr_flat import is_zarr, open_zarr

__all__ = [
    "MAX_PIXELS",
    "checked_pixels",
    "convert_tiff_pixels",
    "count_pages",
    "file_errors",
    "one_line_message",
    "open_tiff",
    "read_flat",
    "select_tiff_page",
]  # fmt: skip

#: Largest flat that is read [px]. Twice a 25,000 x 22,000 sensor, and what OpenCV accepts out of the box.
MAX_PIXELS = 1 << 30

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_READABLE = "PNG, TIFF, WebP, JPEG, BMP, PGM or PPM"
_STRIP_ROWS = 512


def read_flat(path: str | os.PathLike[str], page: int | None = None) -> NDArray[Any]:
    """Read a raw plenoptic picture with its pixel values as stored.

    PNG (1 to 16 bit grey, RGB, palette), TIFF (8 and 16 bit, float), WebP, JPEG, BMP, PGM, PPM and Zarr are read. An
    alpha channel is dropped and the colours below it are kept as stored. An orientation tag is not obeyed: a
    calibration belongs to the sensor, not to how the camera was held. In a TIFF, thumbnails are passed over.

    Parameters
    ----------
    path : path-like
        The image file.
    page : int or None
        Which of the full pictures in a TIFF, from 0; with None a file with several of them is refused.

    Returns
    -------
    (h, w) or (h, w, 3) uint8, uint16 or float32
        C-contiguous, colours in the order red, green, blue.

    Raises
    ------
    FlatError
        If the file is missing, damaged, truncated, larger than `MAX_PIXELS`, no image, or holds NaN or infinity, or
        has no such page.
    """
    source = Path(path)
    with file_errors(source):
        return checked_pixels(_decode(source, page))


@contextmanager
def file_errors(source: Path) -> Iterator[None]:
    """Whatever goes wrong with a file as a FlatError that names it."""
    try:
        yield
    except FlatError as error:
        raise FlatError(f"{source}: {error}") from error
    except OSError as error:
        raise FlatError(f"{source}: cannot be read ({error.strerror or one_line_message(error)})") from error
    except MemoryError as error:
        raise FlatError(f"{source}: the image does not fit into memory") from error
    # Decoders raise whatever damaged bytes drive them to: IndexError, struct.error, zlib.error, cv2.error, ...
    except Exception as error:
        raise FlatError(f"{source}: damaged image file ({one_line_message(error)})") from error


def count_pages(path: str | os.PathLike[str]) -> int:
    """Number of full pictures in an image file: 1, but for a TIFF of several pages.

    A list of pages that is cut off counts as one picture more, which cannot be read.

    Raises
    ------
    FlatError
        If the file cannot be read.
    """
    try:
        with open(path, "rb") as stream:
            if stream.read(4) not in _TIFF:
                return 1
        with open_tiff(Path(path)) as tiff:
            return len(_full_pages(tiff)) + _is_cut_off(tiff)
    except OSError as error:
        raise FlatError(f"{path}: cannot be read ({error.strerror or one_line_message(error)})") from error
    # As in `read_flat`.
    except Exception as error:
        raise FlatError(f"{path}: damaged image file ({one_line_message(error)})") from error


def _decode(source: Path, page: int | None) -> NDArray[Any]:
    mode = source.stat().st_mode
    if stat.S_ISDIR(mode):
        if is_zarr(source):
            return open_zarr(source, MAX_PIXELS).whole()
        raise FlatError("is a folder; give the image file")
    if not stat.S_ISREG(mode):
        raise FlatError("is not a regular file")
    with source.open("rb") as stream:
        head = stream.read(16)
    if not head:
        raise FlatError("is empty")
    if head[:4] in _TIFF:
        return _read_tiff(source, page)
    if page not in (None, 0):
        raise FlatError(f"has one picture and no page {page}")
    if head.startswith(_PNG):
        return _read_png(source.read_bytes())
    if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
        return _read_webp(source.read_bytes())
    if head[:3] == b"\xff\xd8\xff":
        return _read_jpeg(source.read_bytes())
    if head[:2] == b"BM":
        return _read_bmp(source.read_bytes())
    if re.match(rb"P[2356][\s#]", head):
        return _read_pnm(source.read_bytes())
    raise FlatError(f"is no image this toolkit reads; give a {_READABLE} file")


def checked_pixels(pixels: NDArray[Any]) -> NDArray[Any]:
    """Bring decoded pixels to one of the three types and two shapes a flat may have."""
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
    if pixels.ndim != 2 and not (pixels.ndim == 3 and pixels.shape[2] == 3):
        raise FlatError(f"a flat is one grey or RGB picture, this has shape {pixels.shape}")
    if pixels.dtype.kind == "f":
        bad = pixels.size - int(np.count_nonzero(np.isfinite(pixels)))
        if bad:
            raise FlatError(f"{bad} values are NaN or infinite; replace them by what the neighbours say")
    return np.ascontiguousarray(pixels, dtype=pixels.dtype.newbyteorder("="))


def _check_size(width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise FlatError(f"image size {width} x {height} is not valid")
    if width * height > MAX_PIXELS:
        raise FlatError(f"{width} x {height} px is more than the {MAX_PIXELS} px this toolkit reads")


def _read_png(data: bytes) -> NDArray[Any]:
    idat = _check_png(data)
    width, height, depth, colour, *_, interlaced = struct.unpack(">IIBBBBB", data[16:29])
    _check_size(width, height)
    if depth <= 8:
        from PIL import PngImagePlugin

        return _from_pillow(PngImagePlugin.PngImageFile(io.BytesIO(data)))
    # Pillow cuts 16-bit colours down to 8 bits. OpenCV does not, but leaves missing rows as they are, so count first.
    samples = {0: 1, 2: 3, 4: 2, 6: 4}.get(colour, 1)
    if not interlaced and _inflated_size(idat) < height * (1 + 2 * samples * width):
        raise FlatError("truncated PNG: pixel rows are missing")
    return _from_opencv(data, grey=colour in (0, 4))


def _check_png(data: bytes) -> list[memoryview]:
    """Walk over the chunks up to IEND, comparing their checksums; gives the IDAT parts."""
    view, at, idat = memoryview(data), len(_PNG), []
    while True:
        if at + 12 > len(data):
            raise FlatError("truncated PNG: the end marker is missing")
        length, kind = struct.unpack_from(">I4s", data, at)
        if (kind == b"IHDR") != (at == len(_PNG)):
            raise FlatError("damaged PNG: the header chunk is not in its place")
        if at + 12 + length > len(data):
            raise FlatError(f"truncated PNG: {at + 12 + length - len(data)} bytes are missing")
        if zlib.crc32(view[at + 4 : at + 8 + length]) != struct.unpack_from(">I", data, at + 8 + length)[0]:
            raise FlatError(f"damaged PNG: checksum mismatch at byte {at}")
        if kind == b"IDAT":
            idat.append(view[at + 8 : at + 8 + length])
        if kind == b"IEND":
            return idat
        at += 12 + length


def _inflated_size(parts: list[memoryview]) -> int:
    inflate, size, piece = zlib.decompressobj(), 0, 1 << 22
    for part in parts:
        pending: bytes | memoryview = part
        while len(pending):
            size += len(inflate.decompress(pending, piece))
            pending = inflate.unconsumed_tail
    return size + len(inflate.flush())


def _read_webp(data: bytes) -> NDArray[Any]:
    if len(data) < struct.unpack_from("<I", data, 4)[0] + 8:
        raise FlatError("truncated WebP")
    if data[12:16] == b"VP8X" and data[20] & 2:
        raise FlatError("is an animation; a flat is one picture")
    return _from_opencv(data)


def _read_jpeg(data: bytes) -> NDArray[Any]:
    from PIL import JpegImagePlugin

    return _from_pillow(JpegImagePlugin.JpegImageFile(io.BytesIO(data)))


def _read_bmp(data: bytes) -> NDArray[Any]:
    from PIL import BmpImagePlugin

    return _from_pillow(BmpImagePlugin.BmpImageFile(io.BytesIO(data)))


def _read_pnm(data: bytes) -> NDArray[Any]:
    """Netpbm grey or colour map, values as stored whatever the maximum in the header."""
    header = re.match(rb"P([2356])" + rb"(?:\s|#[^\n]*\n)+(\d{1,10})" * 3 + rb"\s", data)
    if header is None:
        raise FlatError("damaged PGM or PPM header")
    kind, width, height, maximum = (int(v) for v in header.groups())
    _check_size(width, height)
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


def open_tiff(source: Path) -> Any:
    import tifffile

    # What tifffile remarks on damaged files is in our error; without a handler Python would print it as well.
    log = logging.getLogger("tifffile")
    if not log.hasHandlers():
        log.addHandler(logging.NullHandler())
    return tifffile.TiffFile(source)


def _full_pages(tiff: Any) -> list[Any]:
    return [page for page in _pages(tiff) if not page.is_reduced]


def _pages(tiff: Any) -> list[Any]:
    """All pages, as far as the list of them can be followed."""
    found: list[Any] = []
    try:
        found.extend(tiff.pages)
    except Exception:
        if not found:
            raise
    return found


def _is_cut_off(tiff: Any) -> bool:
    """Whether the list of pages goes on to a place where no page is."""
    kind, file = tiff.tiff, tiff.filehandle
    offsets = [page.offset for page in _pages(tiff)]
    file.seek(offsets[-1])
    (tags,) = struct.unpack(kind.tagnoformat, file.read(kind.tagnosize))
    file.seek(offsets[-1] + kind.tagnosize + tags * kind.tagsize)
    following = file.read(kind.offsetsize)
    if len(following) < kind.offsetsize:
        return True
    (offset,) = struct.unpack(kind.offsetformat, following)
    return offset != 0 and offset not in offsets


def select_tiff_page(tiff: Any, number: int | None) -> Any:
    """The page of a TIFF that is the flat, its pixels all there and of a kind that is read, or a FlatError."""
    pages = _full_pages(tiff)
    if number is None and _is_cut_off(tiff):
        raise FlatError(f"truncated TIFF: its list of pages is cut off after {len(pages)}")
    if number is None and len(pages) != 1:
        raise FlatError(f"the TIFF holds {len(pages)} pictures; save the one that is the flat on its own")
    if number == len(pages) and _is_cut_off(tiff):
        raise FlatError(f"truncated TIFF: its list of pages is cut off after {len(pages)}")
    if not 0 <= (number or 0) < len(pages):
        raise FlatError(f"the TIFF holds {len(pages)} pictures and no page {number}")
    page: Any = pages[number or 0]
    size = tiff.filehandle.size
    parts = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    if not parts or any(count == 0 or start + count > size for start, count in parts):
        raise FlatError("truncated TIFF: pixel data are missing")
    if len(parts) < np.prod(page.chunked):
        raise FlatError("damaged TIFF: strips or tiles are missing from its table")
    kind = page.photometric.name
    if kind not in ("MINISBLACK", "MINISWHITE", "RGB", "PALETTE", "CFA", "YCBCR", "LINEAR_RAW"):
        raise FlatError(f"TIFF pixels of kind {kind} are not read; save as grey or RGB")
    return page


def _read_tiff(source: Path, number: int | None) -> NDArray[Any]:
    with open_tiff(source) as tiff:
        page = select_tiff_page(tiff, number)
        _check_size(page.imagewidth, page.imagelength)
        try:
            pixels = page.asarray()
        except (KeyError, ValueError) as error:
            if "imagecodecs" not in str(error):
                raise
            if number:
                raise FlatError("compressed in a way that is read for the first page only; save without it") from error
            # Compressions that tifffile leaves to an optional package; libtiff inside OpenCV knows the common ones.
            grey = page.samplesperpixel < 3 and page.photometric.name != "PALETTE"
            return _from_opencv(source.read_bytes(), grey=grey)
        return convert_tiff_pixels(pixels, page)


def convert_tiff_pixels(pixels: NDArray[Any], page: Any) -> NDArray[Any]:
    """Decoded pixels of a page, or of a part of it, as grey or colours along the last axis."""
    if page.axes == "SYX":
        pixels = np.moveaxis(pixels, 0, -1)
    elif page.axes not in ("YX", "YXS"):
        raise FlatError(f"the TIFF holds axes {page.axes}; a flat is one grey or RGB picture")
    kind = page.photometric.name
    if kind == "PALETTE":
        # Colour maps are 16 bit by definition, the colours in them almost always 8 bit times 257.
        pixels = (page.colormap >> 8).astype(np.uint8).T[pixels]
    elif kind == "MINISWHITE" and pixels.dtype.kind == "u":
        pixels = np.iinfo(pixels.dtype).max - pixels
    return pixels


def _from_opencv(data: bytes, grey: bool = False) -> NDArray[Any]:
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
    _check_size(pixels.shape[1], pixels.shape[0])
    if pixels.ndim == 3 and not grey:
        # Dropping alpha with the reordering; COLOR_BGRA2RGB does not touch the colours under it.
        code = cv2.COLOR_BGR2RGB if pixels.shape[2] == 3 else cv2.COLOR_BGRA2RGB
        return cv2.cvtColor(pixels, code)
    return pixels


def _from_pillow(image: Any) -> NDArray[Any]:
    # The format's own class is used, not Image.open: that one refuses sensors above 179 megapixels.
    _check_size(*image.size)
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
    # Strip by strip, as Pillow's way to NumPy makes two more copies of whatever it hands over.
    for top in range(0, height, _STRIP_ROWS):
        strip = np.asarray(image.crop((0, top, width, min(height, top + _STRIP_ROWS))))
        pixels[top : top + _STRIP_ROWS] = strip if bands in (1, 3) else strip[..., 0 if bands == 2 else slice(3)]
    return pixels


def one_line_message(error: BaseException) -> str:
    """The message of an error, cut to one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__
