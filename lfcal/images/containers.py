"""Formats with a library each: HDF5 (h5py), OpenEXR, raw photos (LibRaw), and Zarr in parts."""

from __future__ import annotations

import math
import struct
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..runtime.arrays import Array, Singles
from ..runtime.errors import FlatError
from ..runtime.image_formats import identify_format
from ..runtime.types import Page
from .pixels import MAX_PIXELS, check_only_page, check_size, check_unpacked, import_reader
from .tiff import open_tiff

__all__ = [
    "ZarrFlat",
    "check_zarr",
    "is_zarr",
    "open_zarr",
    "read_hdf5",
    "read_openexr",
    "read_raw_photo",
]

# Names of datasets with captures (plenoptomos, HCI Heidelberg, common ones), and with white and
# dark images.
_CAPTURES = ("data/image", "LF", "lightfield", "light_field", "flat", "image", "raw", "data")
_FURTHER = ("data/white", "data/dark", "white", "dark")
# Codecs of Zarr 2 that decode numbers. Others rebuild Python objects; one of them, `pickle`,
# executes code from the file, which Zarr before 3.1 allows.
_NUMERIC_CODECS = {
    "adler32",
    "astype",
    "bitround",
    "blosc",
    "bz2",
    "crc32",
    "crc32c",
    "delta",
    "fixedscaleoffset",
    "fletcher32",
    "gzip",
    "jenkins_lookup3",
    "lz4",
    "lzma",
    "packbits",
    "quantize",
    "shuffle",
    "zlib",
    "zstd",
}
# Value of missing chunks of a Zarr array. Where pixels have it, they are read again: one that few
# pixels have saves time.
_FILL = 113
_MISSING = (
    "is missing or incomplete; copy the array anew, or write empty chunks too (in Zarr: "
    "write_empty_chunks=True)"
)
# Header of a Blosc block: bytes of its pixels, and of the block.
_BLOSC_HEADER = struct.Struct("<4xI4xI")
_MOST_CHANNELS = 4


def read_hdf5(path: Path, page: Page) -> Array:
    """The capture in an HDF5 file, or with `page` 1 and more its white and dark images.

    Raw pictures (plenoptomos `.vox`), flats, and light fields of views `(v, u, y, x)` are read. A
    light field becomes a flat with a microimage of `v x u` pixels about every `(y, x)`.
    """
    h5py = import_reader("h5py")
    with h5py.File(path, "r") as file:
        names = _FURTHER if page else _CAPTURES
        found = [name for name in names if _is_dataset(file, name)]
        if page and not 0 < page <= len(found):
            raise FlatError(f"holds {1 + len(found)} pictures and no page {page}")
        if not found:
            # Without a known name, a single dataset that can be a picture is the flat.
            file.visititems(
                lambda name, item: found.append(name) if _may_be_picture(item) else None
            )
            if len(found) != 1:
                known = ", ".join(_CAPTURES[:3])
                raise FlatError(
                    f"holds {len(found) or 'no'} pictures; name the dataset of the flat one of "
                    f"{known}"
                )
        name = found[page - 1 if page else 0]
        return _read_dataset(name, file[name])


def _is_dataset(file: Any, name: str) -> bool:
    """Whether an HDF5 file holds a dataset of this name; FlatError if it lies in another file.

    Links to other files would let a file name anything that this machine can read, and a device or
    pipe would block.
    """
    import h5py

    item = file
    for part in name.split("/"):
        link = isinstance(item, h5py.Group) and item.get(part, getlink=True)
        if not link:
            return False
        if not isinstance(link, h5py.HardLink):
            raise FlatError(f"'{part}' is a link; copy the data into the file (h5repack)")
        item = item[part]
    return isinstance(item, h5py.Dataset)


def _may_be_picture(item: Any) -> bool:
    """Whether an item of an HDF5 file is an array of numbers with rows and columns."""
    shape = getattr(item, "shape", ())
    return len(shape) >= 2 and min(shape[:2]) > 1 and item.dtype.kind in "uif"


def _is_picture(shape: tuple[int, ...]) -> bool:
    """Whether an array has the shape of a grey or colour picture, channels last."""
    return len(shape) in (2, 3) and 0 not in shape and max(shape[2:], default=1) <= _MOST_CHANNELS


def _read_dataset(name: str, data: Any) -> Array:
    shape = tuple(int(n) for n in data.shape)
    if data.dtype.kind not in "uif" or data.dtype.hasobject:
        raise FlatError(f"dataset '{name}' holds {data.dtype}; save it as 8 bit, 16 bit or float")
    views, picture = (shape[:2], shape[2:]) if len(shape) > 3 else ((1, 1), shape)
    if not _is_picture(picture) or not 0 < min(views) <= max(views) <= 64:
        raise FlatError(
            f"dataset '{name}' of shape {shape} is no picture and no light field (v, u, y, x)"
        )
    height = picture[0] * views[0]
    width = picture[1] * views[1]
    check_size(width, height)
    _check_stored(name, data)
    pixels: Array = data[()]
    if pixels.ndim < 4:
        return pixels
    return np.moveaxis(pixels, (2, 0, 3, 1), (0, 1, 2, 3)).reshape(height, width, *picture[2:])


def _check_stored(name: str, data: Any) -> None:
    """Raise FlatError if values are missing, lie in other files, or would fill the memory."""
    if data.external or data.is_virtual:
        raise FlatError(
            f"the values of dataset '{name}' lie in other files; copy them into the file (h5repack)"
        )
    if data.nbytes > 32 * MAX_PIXELS:
        raise FlatError(f"dataset '{name}' has {data.nbytes} bytes, more than this toolkit reads")
    size = Path(data.file.filename).stat().st_size
    chunks = 0
    if data.chunks is None:
        is_whole = data.id.get_storage_size() >= data.nbytes
    else:
        chunks = math.prod(-(-n // c) for n, c in zip(data.shape, data.chunks, strict=True))
        check_unpacked(chunks * math.prod(data.chunks) * data.dtype.itemsize, size)
        is_whole = data.id.get_num_chunks() >= chunks
    if not is_whole:
        raise FlatError(
            f"dataset '{name}' is incomplete: values or chunks are missing; copy the file anew"
        )


def read_openexr(path: Path, page: Page) -> Singles:
    """(h, w) or (h, w, 3) the only picture of an OpenEXR file: channels R, G, B, or brightness."""
    exr = import_reader("OpenEXR")
    check_only_page(page)
    with exr.File(str(path), header_only=True) as file:
        # The library leaves out parts that it cannot read.
        if len(file.parts) != 1:
            raise FlatError(
                f"damaged or truncated OpenEXR, or one of {len(file.parts)} pictures: save the one "
                "that is the flat alone"
            )
        left, top, right, bottom = np.ravel(file.header()["dataWindow"]).tolist()
    height = bottom - top + 1
    check_size(right - left + 1, height)
    # Every block of at most 256 rows has an entry of 8 bytes in a table.
    if height > 32 * path.stat().st_size:
        raise FlatError("damaged or truncated OpenEXR")
    with exr.File(str(path), separate_channels=True) as file:
        if not file.parts:
            raise FlatError("damaged or truncated OpenEXR")
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    if {"R", "G", "B"} <= set(channels):
        return np.stack([channels[name] for name in "RGB"], -1).astype(np.float32)
    found = [name for name in ("Y", "L", "luminance") if name in channels]
    if len(channels) == 1:
        found = list(channels)
    if not found:
        raise FlatError(
            f"holds the channels {', '.join(sorted(channels))}; save R, G, B or one channel"
        )
    return np.asarray(channels[found[0]], np.float32)


def read_raw_photo(path: Path, page: Page) -> Array:
    """(h, w) uint16 colour mosaic of the visible part of the sensor; of linear DNG (h, w, 3)."""
    rawpy = import_reader("rawpy")
    check_only_page(page)
    with path.open("rb") as stream:
        head = stream.read(16)
    if identify_format(head) == "TIFF":
        # LibRaw returns black pixels for data that are missing at the end.
        with open_tiff(path) as tiff:
            for part in (part for page_ in tiff.pages for part in (page_, *(page_.pages or ()))):
                ends = map(sum, zip(part.dataoffsets, part.databytecounts, strict=True))
                if max(ends, default=0) > path.stat().st_size:
                    raise FlatError("truncated raw photo: pixel data are missing")
    with rawpy.imread(str(path)) as photo:
        check_size(photo.sizes.raw_width, photo.sizes.raw_height)
        pixels = np.array(photo.raw_image_visible)
    return pixels.astype(np.uint16, copy=False)


class ZarrFlat(NamedTuple):
    """A grey or colour picture in a `zarr.Array`.

    Its shape is (h, w) or (h, w, c), or (c, h, w) with `channels_first`.
    """

    array: Any
    channels_first: bool
    leading: int = 0  # axes of length 1 before these, as OME-Zarr has them for time and planes

    @property
    def shape(self) -> tuple[int, ...]:
        """Height, width and, where there are any, number of channels."""
        shape = tuple(int(n) for n in self.array.shape[self.leading :])
        if self.channels_first:
            return (*shape[1:], shape[0])
        return shape

    def read(self, rows: slice, columns: slice) -> Array:
        """Pixels as stored, channels last; FlatError if a chunk is missing."""
        channels = [slice(0, self.shape[2])] if len(self.shape) == 3 else []
        parts = [*channels, rows, columns] if self.channels_first else [rows, columns, *channels]
        parts = [slice(0, 1)] * self.leading + parts
        self._check_chunks(parts)
        pixels = self._filled(_FILL, parts)
        # Chunks that are missing in shards have the value that they are filled with.
        is_doubtful = self.array.shards is not None and (pixels == _FILL).any()
        if is_doubtful and not np.array_equal(pixels, self._filled(0, parts)):
            raise FlatError(f"a chunk of a shard {_MISSING}")
        pixels = pixels[(0,) * self.leading]
        if self.channels_first:
            return np.moveaxis(pixels, 0, -1)
        return pixels

    def _filled(self, value: int, parts: list[slice]) -> Array:
        """Parts of the array along its axes, with a value where chunks are missing."""
        import zarr

        fill = self.array.dtype.type(value)
        metadata = replace(self.array.metadata, fill_value=fill)
        place = self.array.store_path
        array: Any = zarr.Array(zarr.AsyncArray(metadata=metadata, store_path=place))
        return np.asarray(array[tuple(parts)])

    def _check_chunks(self, parts: list[slice]) -> None:
        """Raise FlatError if files of chunks are missing, or blocks of Blosc truncated.

        The decoder of Blosc would read beyond their end.
        """
        is_blosc = _is_blosc(self.array.metadata)
        sides = self.array.metadata.chunk_grid.chunk_shape
        size = math.prod(sides) * self.array.dtype.itemsize
        numbers = (
            range(p.start // side, -(-p.stop // side)) for p, side in zip(parts, sides, strict=True)
        )
        for chunk in product(*numbers):
            name = self.array.metadata.encode_chunk_key(chunk)
            path = Path(self.array.store.root, self.array.path, name)
            if not path.is_file():
                raise FlatError(f"the chunk '{name}' {_MISSING}")
            if not is_blosc:
                continue
            with path.open("rb") as file:
                head = file.read(_BLOSC_HEADER.size).ljust(_BLOSC_HEADER.size, b"\0")
            unpacked, packed = _BLOSC_HEADER.unpack(head)
            if unpacked != size or packed > path.stat().st_size:
                raise FlatError(f"the chunk '{name}' is truncated or damaged; copy the array anew")


def _is_blosc(metadata: Any) -> bool:
    """Whether each chunk is one block of Blosc, the usual compressor of version 2."""
    old = getattr(getattr(metadata, "compressor", None), "codec_id", None)
    kinds = [type(codec).__name__ for codec in getattr(metadata, "codecs", None) or ()]
    return old == "blosc" or ("BloscCodec" in kinds and "ShardingCodec" not in kinds)


def is_zarr(path: Path) -> bool:
    """Whether a folder holds a Zarr array or group."""
    return any((path / name).is_file() for name in (".zarray", ".zgroup", "zarr.json"))


def open_zarr(path: Path) -> ZarrFlat:
    """The picture in a Zarr folder; of a group the finest array (OME-Zarr), or the only one."""
    array: Any = import_reader("zarr").open(str(path), mode="r")
    if not hasattr(array, "shape"):
        names = sorted(array.array_keys())
        attributes = dict(array.attrs)
        wanted = ["0"]
        if len(names) == 1:
            wanted = names[:]
        with suppress(KeyError, IndexError, TypeError, AttributeError):
            scales = attributes.get("ome", attributes)["multiscales"][0]
            wanted.insert(0, str(scales["datasets"][0]["path"]))
        known = [name for name in wanted if name in names]
        if not known:
            raise FlatError(
                f"the Zarr group holds {len(names)} arrays; give the folder of the one that is the "
                "flat"
            )
        array = array[known[0]]
    return check_zarr(array)


def check_zarr(array: Any) -> ZarrFlat:
    """The array as a flat; FlatError if its metadata describe no picture. Nothing is decoded."""
    whole = tuple(int(n) for n in array.shape)
    kind = np.dtype(array.dtype)
    # Time, channel and plane of OME-Zarr come first; no flat has one row.
    leading = next((k for k, n in enumerate(whole[:-2]) if n != 1), max(len(whole) - 2, 0))
    shape = whole[leading:]
    first = len(shape) == 3 and shape[2] > _MOST_CHANNELS >= shape[0]
    picture = shape
    if first:
        picture = (*shape[1:], shape[0])
    if not _is_picture(picture) or math.prod(picture[:2]) > MAX_PIXELS:
        raise FlatError(
            f"a flat is one grey or RGB picture of {MAX_PIXELS} px at most, this array has shape "
            f"{shape}"
        )
    if kind.kind not in "buif":
        raise FlatError(f"pixels of type {kind} are not read; save them as 8 bit, 16 bit or float")
    metadata = array.metadata
    chunk = getattr(metadata.chunk_grid, "chunk_shape", None)
    if (
        chunk is None
        or len(chunk) != len(whole)
        or math.prod(max(n, 1) for n in chunk) > 4 * MAX_PIXELS
    ):
        raise FlatError(
            f"chunks of shape {chunk} are not read; store the array in regular chunks of some "
            "megapixels"
        )
    codecs = [*(getattr(metadata, "filters", None) or ()), getattr(metadata, "compressor", None)]
    unknown = {
        getattr(one, "codec_id", str(one)) for one in codecs if one is not None
    } - _NUMERIC_CODECS
    if unknown:
        raise FlatError(
            f"the codec '{min(unknown)}' is not one of numbers; store the array without it"
        )
    if getattr(array.store, "root", None) is None:
        raise FlatError("is no Zarr array in a folder")
    return ZarrFlat(array, first, leading)
