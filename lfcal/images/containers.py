"""Files that a library of their own reads: HDF5 (h5py), OpenEXR, and raw photos (LibRaw)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.image_formats import identify_format
from .pixels import MAX_PIXELS, check_only_page, check_size, import_reader
from .tiff import open_tiff

__all__ = ["read_hdf5", "read_openexr", "read_raw_photo"]

# Datasets by what they are called, the capture first: plenoptomos, HCI (Heidelberg), and other common names.
_CAPTURES = ("data/image", "LF", "lightfield", "light_field", "flat", "image", "raw", "data")
_FURTHER = ("data/white", "data/dark", "white", "dark")


def read_hdf5(path: Path, page: int | None) -> NDArray[Any]:
    """The capture in an HDF5 file, or with `page` 1 and more its white and dark images.

    Raw pictures (plenoptomos `.vox`), flats, and light fields of views `(v, u, y, x)`, of which a flat is made with a
    microimage of `v x u` pixels about every `(y, x)`.
    """
    h5py = import_reader("h5py", "hdf5")
    with h5py.File(path, "r") as file:
        found = [name for name in (_FURTHER if page else _CAPTURES) if isinstance(file.get(name), h5py.Dataset)]
        if page and not 0 < page <= len(found):
            raise FlatError(f"holds {1 + len(found)} pictures and no page {page}")
        if not found:
            # Where none has a known name, the only one that can be a picture.
            file.visititems(lambda name, item: found.append(name) if _may_be_picture(item) else None)
            if len(found) != 1:
                known = ", ".join(_CAPTURES[:3])
                raise FlatError(f"holds {len(found) or 'no'} pictures; name the dataset of the flat one of {known}")
        name = found[page - 1 if page else 0]
        return _read_dataset(name, file[name])


def _may_be_picture(item: Any) -> bool:
    shape, dtype = getattr(item, "shape", ()), getattr(item, "dtype", None)
    return len(shape) >= 2 and min(shape[:2]) > 1 and dtype is not None and dtype.kind in "uf"


def _read_dataset(name: str, data: Any) -> NDArray[Any]:
    shape = tuple(int(n) for n in data.shape)
    if data.dtype.kind not in "uf" or data.dtype.hasobject:
        raise FlatError(f"dataset '{name}' holds {data.dtype}; save it as 8 bit, 16 bit or float")
    views, picture = (shape[:2], shape[2:]) if len(shape) > 3 else ((1, 1), shape)
    if len(picture) not in (2, 3) or 0 in shape or any(n > 4 for n in picture[2:]) or max(views) > 64:
        raise FlatError(f"dataset '{name}' of shape {shape} is no picture and no light field (v, u, y, x)")
    height, width = picture[0] * views[0], picture[1] * views[1]
    check_size(width, height)
    _check_stored(name, data)
    pixels: NDArray[Any] = data[()]
    if pixels.dtype.kind == "u" and pixels.dtype.itemsize > 2:
        if pixels.max(initial=0) > 0xFFFF:
            raise FlatError(f"dataset '{name}' holds values above 65535; save it as 16 bit")
        pixels = pixels.astype(np.uint16)
    if pixels.ndim < 4:
        return pixels
    return np.moveaxis(pixels, (2, 0, 3, 1), (0, 1, 2, 3)).reshape(height, width, *picture[2:])


def _check_stored(name: str, data: Any) -> None:
    """FlatError where values are missing, which HDF5 fills in, or packed so that they would fill the memory."""
    if data.nbytes > 32 * MAX_PIXELS:
        raise FlatError(f"dataset '{name}' has {data.nbytes} bytes, more than this toolkit reads")
    stored, least, chunks = int(data.id.get_storage_size()), data.nbytes, 0
    if data.chunks is not None:
        # Shuffled and deflated pictures are a tenth of their size, blank ones a thousandth.
        least /= 1100
        chunks = int(np.prod([-(-n // c) for n, c in zip(data.shape, data.chunks, strict=True)]))
    if stored < least or (chunks and data.id.get_num_chunks() < chunks):
        raise FlatError(f"dataset '{name}' is incomplete: values or chunks are missing; copy the file anew")


def read_openexr(path: Path, page: int | None) -> NDArray[np.float32]:
    """(h, w) or (h, w, 3) the only picture of an OpenEXR file: its channels R, G, B, or one of brightness."""
    exr = import_reader("OpenEXR", "exr")
    check_only_page(page)
    with exr.File(str(path), header_only=True) as file:
        # The library leaves out what it cannot read.
        if not file.parts:
            raise FlatError("damaged or truncated OpenEXR")
        low, high = file.header()["dataWindow"]
    (left, top), (right, bottom) = (map(int, corner) for corner in (low, high))
    check_size(right - left + 1, bottom - top + 1)
    # Every block of at most 256 rows has an entry of 8 bytes in a table.
    if path.stat().st_size < (bottom - top + 1) / 32:
        raise FlatError("damaged or truncated OpenEXR")
    with exr.File(str(path), separate_channels=True) as file:
        if not file.parts:
            raise FlatError("damaged or truncated OpenEXR")
        if len(file.parts) != 1:
            raise FlatError(f"the OpenEXR file holds {len(file.parts)} pictures; save the one that is the flat alone")
        channels: dict[str, Any] = {name: channel.pixels for name, channel in file.channels().items()}
    if {"R", "G", "B"} <= set(channels):
        return np.stack([channels[name] for name in "RGB"], -1).astype(np.float32)
    named = [name for name in ("Y", "L", "luminance") if name in channels] or list(channels)[: len(channels) == 1]
    if not named:
        raise FlatError(f"holds the channels {', '.join(sorted(channels))}; save R, G, B or one channel")
    return np.asarray(channels[named[0]], np.float32)


def read_raw_photo(path: Path, page: int | None) -> NDArray[Any]:
    """(h, w) uint16 the colour mosaic of the visible part of the sensor as stored; linear DNG (h, w, 3)."""
    rawpy = import_reader("rawpy", "dng")
    check_only_page(page)
    with path.open("rb") as stream:
        is_tiff = identify_format(stream.read(16)) == "TIFF"
    if is_tiff:
        # LibRaw leaves black what is missing at the end.
        with open_tiff(path) as tiff:
            for part in (part for page_ in tiff.pages for part in (page_, *(page_.pages or ()))):
                ends = (start + count for start, count in zip(part.dataoffsets, part.databytecounts, strict=True))
                if max(ends, default=0) > path.stat().st_size:
                    raise FlatError("truncated raw photo: pixel data are missing")
    with rawpy.imread(str(path)) as photo:
        check_size(photo.sizes.raw_width, photo.sizes.raw_height)
        pixels = np.array(photo.raw_image_visible)
    return pixels.astype(np.uint16, copy=False)
