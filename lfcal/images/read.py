"""Reading flats: the raw pixels of an image file as stored; damaged files are refused."""

from __future__ import annotations

import stat
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from ..runtime.arrays import Array
from ..runtime.errors import FlatError, check_path
from ..runtime.image_formats import (
    IMAGE_FORMATS,
    RAW_PHOTO_SUFFIXES,
    VIDEO_FORMATS,
    identify_format,
)
from ..runtime.types import AnyPath, Page, Size
from .containers import is_zarr, open_zarr, read_hdf5, read_openexr, read_raw_photo
from .lytro import read_lytro
from .pixels import MAX_PIXELS, check_only_page, check_pixels, decode_picture, file_errors
from .tiff import count_tiff_pages, read_tiff
from .video import count_yuv_frames, is_yuv, read_video_frame, read_yuv

__all__ = ["MAX_PIXELS", "count_pages", "read_flat"]

# Formats whose files may hold several pictures; others are decoded by `decode_picture`.
_READERS: dict[str, Callable[[Path, int | None], Array]] = {
    "TIFF": read_tiff,
    "OpenEXR": read_openexr,
    "HDF5": read_hdf5,
    "Lytro": read_lytro,
}
# Advice for formats that are not read, by their suffixes.
_CONVERTERS = {
    **dict.fromkeys(
        (".czi", ".lif", ".nd2", ".oib", ".oif"),
        "save it as OME-TIFF with Fiji or bfconvert (Bio-Formats)",
    ),
    **dict.fromkeys((".ray", ".rays"), "export the raw image as PNG or TIFF with RxLive"),
    ".heic": "convert it to PNG with ImageMagick",
    ".mat": "save the picture as TIFF or HDF5 (h5write)",
    ".raw": "it has no header: name it NAME_WxH_400p8.yuv, or 400p10, 400p12 for 16-bit samples of "
    "so many bits",
    ".zip": "unpack it; give the folder of a Zarr array, or the picture in it",
    ".jp2": "convert it to TIFF with ImageMagick or opj_decompress",
}


def read_flat(
    path: AnyPath,
    page: Page = None,
    *,
    size: Size | None = None,
    pixel_format: str | None = None,
) -> Array:
    """Read a raw plenoptic picture with its pixel values as stored.

    PNG (1 to 16 bit grey, RGB, palette), TIFF (8 and 16 bit, float), WebP, JPEG, BMP, PGM, PPM and
    Zarr are read. OpenEXR, HDF5, Lytro files, raw photos and frames of videos are read too; some of
    them need a package (docs/formats.md). Alpha is dropped; the colours below it are kept as
    stored. The orientation tag is ignored, because a calibration belongs to the sensor and not to
    the way in which the camera was held. Thumbnails in a TIFF are skipped.

    Parameters
    ----------
    path : path-like
        The image file, or the folder of a Zarr array.
    page : int or None
        Number of the full picture in a TIFF or of the frame of a video, from 0. With None a file
        with several of them is refused. In an HDF5 file, 1 is the white image beside the capture;
        in a Lytro archive every page is a white image.
    size : (int, int) or None [px]
        Width and height of raw video, if neither its name nor a camera file `.cfg` beside it has
        them.
    pixel_format : str or None
        Format of raw video, such as `"yuv420p10"`. By default it follows from the name of the file;
        without such a name it is 4:2:0, and the number of bits follows from the samples.

    Returns
    -------
    (h, w) or (h, w, 3) uint8, uint16 or float32
        C-contiguous, colours in the order red, green, blue. FlatError if the file is missing,
        damaged, truncated, no image or larger than `MAX_PIXELS`, contains NaN or infinity, or has
        no such page.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal, lfrender, numpy
    >>> with TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/flat.png", numpy.zeros((20, 30, 3), numpy.uint8))
    ...     lfcal.read_flat(f"{folder}/flat.png").shape
    (20, 30, 3)
    """
    source = check_path(path)
    with file_errors(source):
        if is_yuv(source) and source.is_file():
            return check_pixels(read_yuv(source, page, size, pixel_format))
        return check_pixels(_decode(source, page))


def count_pages(
    path: AnyPath,
    *,
    size: Size | None = None,
    pixel_format: str | None = None,
) -> int:
    """Number of full pictures in a TIFF or of frames in raw video; 1 for any other image file.

    A truncated list of pages counts as one more picture, which cannot be read. FlatError if the
    file cannot be read.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfcal, numpy, tifffile
    >>> with TemporaryDirectory() as folder:
    ...     frames = numpy.zeros((5, 20, 30), numpy.uint8)
    ...     tifffile.imwrite(f"{folder}/frames.tif", frames, photometric="minisblack")
    ...     lfcal.count_pages(f"{folder}/frames.tif")
    5
    """
    source = check_path(path)
    with file_errors(source):
        if is_yuv(source):
            return count_yuv_frames(source, size, pixel_format)
        with source.open("rb") as stream:
            kind = identify_format(stream.read(16))
        if kind == "TIFF":
            return count_tiff_pages(source)
        return 1


def _decode(source: Path, page: Page) -> Array:
    suffix = source.suffix.lower()
    mode = source.stat().st_mode
    if stat.S_ISDIR(mode) and is_zarr(source):
        array = open_zarr(source)
        return array.read(*(slice(0, length) for length in array.shape[:2]))
    if stat.S_ISDIR(mode):
        raise FlatError("is a folder; give the image file, or all in it to 'lfrender batch'")
    if not stat.S_ISREG(mode):
        raise FlatError("is not a regular file")
    with source.open("rb") as stream:
        head = stream.read(16)
    if not head:
        raise FlatError("is empty")
    name = identify_format(head)
    # Without LibRaw, a plain DNG is read as a TIFF.
    if suffix in RAW_PHOTO_SUFFIXES and (name != "TIFF" or find_spec("rawpy")):
        return read_raw_photo(source, page)
    if name in _READERS:
        return _READERS[name](source, page)
    if name is None and suffix in VIDEO_FORMATS:
        return read_video_frame(source, page)
    check_only_page(page)
    if name is not None:
        return decode_picture(source.read_bytes(), name)
    if suffix in _CONVERTERS:
        raise FlatError(f"{source.suffix} files are not read; {_CONVERTERS[suffix]}")
    *names, last = IMAGE_FORMATS
    raise FlatError(f"is no image this toolkit reads; give a {', '.join(names)} or {last} file")
