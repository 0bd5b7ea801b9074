"""Flats in Zarr arrays (versions 2 and 3), read part by part; missing and damaged chunks are refused."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError
from .pixels import MAX_PIXELS, import_reader

__all__ = ["ZarrFlat", "check_zarr", "is_zarr", "open_zarr"]

# Codecs of version 2 that give numbers. Others rebuild Python objects, and `pickle` among them executes code from the
# file, which Zarr before 3.1 allows.
_NUMERIC_CODECS = {
    "adler32", "astype", "bitround", "blosc", "bz2", "crc32", "crc32c", "delta", "fixedscaleoffset", "fletcher32",
    "gzip", "jenkins_lookup3", "lz4", "lzma", "packbits", "quantize", "shuffle", "zlib", "zstd",
}  # fmt: skip
# Header of a Blosc block: bytes of its pixels, and of the block.
_BLOSC_HEADER = struct.Struct("<4xI4xI")


@dataclass(frozen=True)
class ZarrFlat:
    """A grey or colour picture in a `zarr.Array` (h, w), (h, w, c), or (c, h, w) with `channels_first`."""

    array: Any
    channels_first: bool
    leading: int = 0  # axes of length 1 before these, as OME-Zarr has them for time and planes

    @property
    def shape(self) -> tuple[int, ...]:
        """Height, width and, where there are any, number of channels."""
        shape = tuple(int(n) for n in self.array.shape[self.leading :])
        return (*shape[1:], shape[0]) if self.channels_first else shape

    def read(self, rows: slice, columns: slice) -> NDArray[Any]:
        """Pixels as stored, channels last; FlatError if a chunk is missing, which Zarr itself reads as black."""
        channels = [slice(0, self.shape[2])] if len(self.shape) == 3 else []
        parts = [*channels, rows, columns] if self.channels_first else [rows, columns, *channels]
        self._check_chunks(parts)
        pixels = np.asarray(self.array[(*(0,) * self.leading, *parts)])
        return np.moveaxis(pixels, 0, -1) if self.channels_first else pixels

    def _check_chunks(self, parts: list[slice]) -> None:
        """FlatError where a chunk with these pixels is missing or truncated."""
        metadata = self.array.metadata
        sides = metadata.chunk_grid.chunk_shape[self.leading :]
        blosc = _is_blosc(metadata)
        folder = Path(self.array.store.root) / self.array.path
        numbers = (range(p.start // side, -(-p.stop // side)) for p, side in zip(parts, sides, strict=True))
        for chunk in product(*numbers):
            name = metadata.encode_chunk_key((0,) * self.leading + chunk)
            if not (folder / name).is_file():
                raise FlatError(
                    f"the chunk '{name}' is missing; copy the array anew, or write empty chunks too "
                    "(in Zarr: write_empty_chunks=True)"
                )
            if blosc and not _is_whole_blosc(folder / name, math.prod(sides) * self.array.dtype.itemsize):
                raise FlatError(f"the chunk '{name}' is truncated or damaged; copy the array anew")


def _is_blosc(metadata: Any) -> bool:
    """Whether each chunk is one block of Blosc, the usual compressor of version 2."""
    old = getattr(getattr(metadata, "compressor", None), "codec_id", None)
    kinds = [type(codec).__name__ for codec in getattr(metadata, "codecs", None) or ()]
    return old == "blosc" or ("BloscCodec" in kinds and "ShardingCodec" not in kinds)


def _is_whole_blosc(path: Path, size: int) -> bool:
    """Whether a block has as many bytes as its header states; its decoder reads beyond the end of shorter ones."""
    with path.open("rb") as file:
        header = file.read(_BLOSC_HEADER.size)
    if len(header) < _BLOSC_HEADER.size:
        return False
    unpacked, packed = _BLOSC_HEADER.unpack(header)
    return bool(unpacked == size and packed <= path.stat().st_size)


def is_zarr(path: Path) -> bool:
    """Whether a folder holds a Zarr array or group."""
    return any((path / name).is_file() for name in (".zarray", ".zgroup", "zarr.json"))


def open_zarr(path: Path) -> ZarrFlat:
    """The picture in a Zarr folder; of a group the array with all pixels (OME-Zarr), the only one, or `0`."""
    array: Any = import_reader("zarr", "zarr").open(str(path), mode="r")
    if not hasattr(array, "shape"):
        names = sorted(array.array_keys())
        attributes = dict(array.attrs)
        try:
            finest = [str(attributes.get("ome", attributes)["multiscales"][0]["datasets"][0]["path"])]
        except (KeyError, IndexError, TypeError, AttributeError):
            finest = []
        name = next((name for name in (*finest, *(names if len(names) == 1 else ()), "0") if name in names), None)
        if name is None:
            raise FlatError(f"the Zarr group holds {len(names)} arrays; give the folder of the one that is the flat")
        array = array[name]
    return check_zarr(array)


def check_zarr(array: Any) -> ZarrFlat:
    """The array as a flat, or a FlatError if its metadata describe none; nothing is decoded."""
    whole, kind = tuple(int(n) for n in array.shape), np.dtype(array.dtype)
    # Time, channel and plane of OME-Zarr come first; no flat has one row.
    leading = next((k for k, n in enumerate(whole[:-2]) if n != 1), max(len(whole) - 2, 0))
    shape = whole[leading:]
    first = len(shape) == 3 and shape[2] > 4 >= shape[0]
    height, width, *channels = (*shape[1:], shape[0]) if first else (*shape, 0, 0)[: max(len(shape), 2)]
    if len(shape) not in (2, 3) or 0 in shape or height * width > MAX_PIXELS or any(n > 4 for n in channels):
        raise FlatError(f"a flat is one grey or RGB picture of {MAX_PIXELS} px at most, this array has shape {shape}")
    if kind.kind not in "buif":
        raise FlatError(f"pixels of type {kind} are not read; save them as 8 bit, 16 bit or float")
    metadata = array.metadata
    chunk = getattr(metadata.chunk_grid, "chunk_shape", None)
    if chunk is None or len(chunk) != len(whole) or math.prod(max(n, 1) for n in chunk) > 4 * MAX_PIXELS:
        raise FlatError(f"chunks of shape {chunk} are not read; store the array in regular chunks of some megapixels")
    codecs = [*(getattr(metadata, "filters", None) or ()), getattr(metadata, "compressor", None)]
    unknown = {getattr(one, "codec_id", str(one)) for one in codecs if one is not None} - _NUMERIC_CODECS
    if unknown:
        raise FlatError(f"the codec '{min(unknown)}' is not one of numbers; store the array without it")
    if getattr(array.store, "root", None) is None:
        raise FlatError("is no Zarr array in a folder")
    return ZarrFlat(array, first, leading)
