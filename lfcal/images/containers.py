"""Formats with a library each: HDF5 (h5py), OpenEXR, raw photos (LibRaw), and Zarr in parts."""

from __future__ import annotations

import math
import os
import struct
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from ..runtime.image_formats import identify_format
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
# Entry of the index of a Zarr shard, and its checksum [bytes]. The length of a missing chunk is the
# largest number.
_SHARD_ENTRY = np.dtype([("start", "<u8"), ("length", "<u8")])
_CHECKSUM = 4
# Header of a Blosc block: bytes of its pixels, and of the block.
_BLOSC_HEADER = struct.Struct("<4xI4xI")
_MOST_CHANNELS = 4


def read_hdf5(path: Path, page: int | None) -> NDArray[Any]:
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
    path = ""
    for part in name.split("/"):
        path = f"{path}/{part}"
        # `part in item` would follow the link.
        if not isinstance(item, h5py.Group) or not item.id.links.exists(part.encode()):
            return False
        if item.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
            raise FlatError(f"'{path}' is a link; copy the data into the file (h5repack)")
        item = item[part]
    return isinstance(item, h5py.Dataset)


def _may_be_picture(item: Any) -> bool:
    """Whether an item of an HDF5 file is an array of numbers with rows and columns."""
    shape = getattr(item, "shape", ())
    return len(shape) >= 2 and min(shape[:2]) > 1 and item.dtype.kind in "uif"


def _is_picture(shape: tuple[int, ...]) -> bool:
    """Whether an array has the shape of a grey or colour picture, channels last."""
    return len(shape) in (2, 3) and 0 not in shape and max(shape[2:], default=1) <= _MOST_CHANNELS


def _read_dataset(name: str, data: Any) -> NDArray[Any]:
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
    pixels: NDArray[Any] = data[()]
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


def read_openexr(path: Path, page: int | None) -> NDArray[np.float32]:
    """(h, w) or (h, w, 3) the only picture of an OpenEXR file: channels R, G, B, or brightness."""
    exr = import_reader("OpenEXR")
    check_only_page(page)
    with exr.File(str(path), header_only=True) as file:
        # The library leaves out parts that it cannot read.
        height = 0
        if file.parts:
            left, top, right, bottom = np.ravel(file.header()["dataWindow"]).tolist()
            height = bottom - top + 1
            check_size(right - left + 1, height)
    # Every block of at most 256 rows has an entry of 8 bytes in a table.
    if not 0 < height <= 32 * path.stat().st_size:
        raise FlatError("damaged or truncated OpenEXR")
    with exr.File(str(path), separate_channels=True) as file:
        if not file.parts:
            raise FlatError("damaged or truncated OpenEXR")
        if len(file.parts) != 1:
            raise FlatError(
                f"the OpenEXR file holds {len(file.parts)} pictures; save the one that is the flat "
                "alone"
            )
        channels: dict[str, Any] = {
            name: channel.pixels for name, channel in file.channels().items()
        }
    if {"R", "G", "B"} <= set(channels):
        return np.stack([channels[name] for name in "RGB"], -1).astype(np.float32)
    names = ("Y", "L", "luminance") if len(channels) > 1 else channels
    named = [name for name in names if name in channels]
    if not named:
        raise FlatError(
            f"holds the channels {', '.join(sorted(channels))}; save R, G, B or one channel"
        )
    return np.asarray(channels[named[0]], np.float32)


def read_raw_photo(path: Path, page: int | None) -> NDArray[Any]:
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

    def read(self, rows: slice, columns: slice) -> NDArray[Any]:
        """Pixels as stored, channels last; FlatError if a chunk is missing."""
        channels = [slice(0, self.shape[2])] if len(self.shape) == 3 else []
        parts = [*channels, rows, columns] if self.channels_first else [rows, columns, *channels]
        self._check_chunks(parts)
        pixels = np.asarray(self.array[(*(0,) * self.leading, *parts)])
        if self.channels_first:
            return np.moveaxis(pixels, 0, -1)
        return pixels

    def _check_chunks(self, parts: list[slice]) -> None:
        metadata = self.array.metadata
        parts = [slice(0, 1)] * self.leading + parts
        sides = metadata.chunk_grid.chunk_shape
        blosc = _is_blosc(metadata)
        folder = Path(self.array.store.root) / self.array.path
        numbers = (
            range(p.start // side, -(-p.stop // side)) for p, side in zip(parts, sides, strict=True)
        )
        for chunk in product(*numbers):
            name = metadata.encode_chunk_key(chunk)
            is_missing = not (folder / name).is_file()
            if not is_missing and self.array.shards is not None:
                is_missing = _has_gaps(folder / name, self.array, chunk, parts)
            if is_missing:
                advice = (
                    "copy the array anew, or write empty chunks too (in Zarr: "
                    "write_empty_chunks=True)"
                )
                raise FlatError(f"the chunk '{name}' is missing or incomplete; {advice}")
            if blosc and not _is_whole_blosc(
                folder / name, math.prod(sides) * self.array.dtype.itemsize
            ):
                raise FlatError(f"the chunk '{name}' is truncated or damaged; copy the array anew")


def _has_gaps(path: Path, array: Any, shard: tuple[int, ...], parts: list[slice]) -> bool:
    """Whether chunks that overlap some parts are missing in the file of a shard.

    The decoder fills them in. Source: Zarr 3 specification, codec `sharding_indexed`.
    """
    counts = [side // inner for side, inner in zip(array.shards, array.chunks, strict=True)]
    size = _SHARD_ENTRY.itemsize * math.prod(counts)
    settings = array.metadata.to_dict()["codecs"][0]["configuration"]
    names = [codec["name"] for codec in settings["index_codecs"]]
    if names != ["bytes", "crc32c"]:
        raise FlatError(f"shards with an index of the codecs {names} are not read")
    with path.open("rb") as file:
        stored = file.seek(0, os.SEEK_END)
        if stored < size + _CHECKSUM:
            return True
        file.seek(0 if settings["index_location"] == "start" else stored - size - _CHECKSUM)
        entries = np.frombuffer(file.read(size), _SHARD_ENTRY).reshape(counts)
    wanted = []
    for part, number, side, inner in zip(parts, shard, array.shards, array.chunks, strict=True):
        first = number * side
        low = max(part.start - first, 0) // inner
        high = -(-min(part.stop - first, side) // inner)
        wanted.append(slice(low, high))
    overlapping = entries[tuple(wanted)]
    ends = overlapping["start"] + overlapping["length"]
    is_gap = (overlapping["length"] > stored) | (ends > stored)
    return bool(is_gap.any())


def _is_blosc(metadata: Any) -> bool:
    """Whether each chunk is one block of Blosc, the usual compressor of version 2."""
    old = getattr(getattr(metadata, "compressor", None), "codec_id", None)
    kinds = [type(codec).__name__ for codec in getattr(metadata, "codecs", None) or ()]
    return old == "blosc" or ("BloscCodec" in kinds and "ShardingCodec" not in kinds)


def _is_whole_blosc(path: Path, size: int) -> bool:
    """Whether a block has all bytes of its header; the decoder reads beyond the end of others."""
    with path.open("rb") as file:
        unpacked, packed = _BLOSC_HEADER.unpack(
            file.read(_BLOSC_HEADER.size).ljust(_BLOSC_HEADER.size, b"\0")
        )
    return bool(unpacked == size and packed <= path.stat().st_size)


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
