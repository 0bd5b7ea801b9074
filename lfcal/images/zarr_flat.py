"""Flats in Zarr arrays, of version 2 and 3, read part by part."""

from __future__ import annotations

import math
import os
import struct
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError

__all__ = ["ZarrFlat", "is_zarr", "open_zarr"]

_MARKS = (".zarray", ".zgroup", "zarr.json")
# Codecs of version 2 that turn numbers into numbers. Others make objects of the bytes in a file, and one of them runs
# what these say; Zarr before 3.1 lets it.
_CODECS = {
    "adler32", "astype", "bitround", "blosc", "bz2", "crc32", "crc32c", "delta", "fixedscaleoffset", "fletcher32",
    "gzip", "jenkins_lookup3", "lz4", "lzma", "packbits", "quantize", "shuffle", "zlib", "zstd",
}  # fmt: skip
# The header of a block of Blosc: bytes of its pixels, and of the block.
_BLOSC = struct.Struct("<4xI4xI")


@dataclass(frozen=True)
class ZarrFlat:
    """A grey or colour picture in a Zarr array.

    Parameters
    ----------
    array : zarr.Array
        Of shape (h, w), (h, w, c) or (c, h, w).
    first : bool
        The channels lie along the first axis.
    folder : Path
        Where its chunks are.
    """

    array: Any
    first: bool
    folder: Path

    @property
    def shape(self) -> tuple[int, ...]:
        """Height, width and number of channels, where there are such."""
        shape = tuple(int(n) for n in self.array.shape)
        return (*shape[1:], shape[0]) if self.first else shape

    def read(self, rows: slice, columns: slice) -> NDArray[Any]:
        """Pixels as stored, channels along the last axis.

        Raises
        ------
        FlatError
            If a chunk is missing, which Zarr itself would take for black.
        """
        self._check_chunks(rows, columns)
        if self.first:
            return np.moveaxis(np.asarray(self.array[:, rows, columns]), 0, -1)
        return np.asarray(self.array[rows, columns])

    def whole(self) -> NDArray[Any]:
        """All pixels."""
        return self.read(slice(0, self.shape[0]), slice(0, self.shape[1]))

    def _check_chunks(self, rows: slice, columns: slice) -> None:
        """A FlatError where a chunk that holds these pixels is not there."""
        channels = slice(0, self.shape[2]) if len(self.shape) == 3 else None
        places = [channels, rows, columns] if self.first else [rows, columns, channels]
        sides = self.array.metadata.chunk_grid.chunk_shape
        chunks = (
            range(part.start // side, -(-part.stop // side))
            for part, side in zip([p for p in places if p is not None], sides, strict=True)
        )
        blosc = _is_blosc(self.array.metadata)
        bytes_each = math.prod(sides) * self.array.dtype.itemsize
        for chunk in product(*chunks):
            name = self.array.metadata.encode_chunk_key(chunk)
            if not (self.folder / name).is_file():
                raise FlatError(
                    f"the chunk '{name}' is missing; copy the array anew, or write empty chunks too "
                    "(in Zarr: write_empty_chunks=True)"
                )
            if blosc and not _is_whole_blosc(self.folder / name, bytes_each):
                raise FlatError(f"the chunk '{name}' is truncated or damaged; copy the array anew")


def _is_blosc(metadata: Any) -> bool:
    """Whether each chunk is one block of Blosc, the usual compressor of version 2."""
    if getattr(getattr(metadata, "compressor", None), "codec_id", None) == "blosc":
        return True
    kinds = [type(codec).__name__ for codec in getattr(metadata, "codecs", None) or ()]
    return "BloscCodec" in kinds and "ShardingCodec" not in kinds


def _is_whole_blosc(path: Path, size: int) -> bool:
    """Whether a block has as many bytes as its header says; its decoder would read what lies beyond."""
    with path.open("rb") as file:
        header = file.read(_BLOSC.size)
        length = os.fstat(file.fileno()).st_size
    if len(header) < _BLOSC.size:
        return False
    unpacked, packed = _BLOSC.unpack(header)
    return bool(unpacked == size and packed <= length)


def is_zarr(path: Path) -> bool:
    """Whether a folder holds a Zarr array or group."""
    return any((path / name).is_file() for name in _MARKS)


def open_zarr(path: Path, most: int) -> ZarrFlat:
    """The one picture in a Zarr folder, of a group the array of that name or `0` (as OME-Zarr calls the largest).

    Its height times width is `most` pixels or less.

    Raises
    ------
    FlatError
        If the package `zarr` is not installed, or there is no such picture.
    """
    try:
        import zarr
    except ImportError as error:
        raise FlatError("Zarr needs the package 'zarr'; pip install 'lfrender[zarr]'") from error
    found: Any = zarr.open(str(path), mode="r")
    if not hasattr(found, "shape"):
        names = sorted(found.array_keys())
        if len(names) != 1 and "0" not in names:
            raise FlatError(f"the Zarr group holds {len(names)} arrays; give the folder of the one that is the flat")
        found = found[names[0] if len(names) == 1 else "0"]
    return _checked(found, most)


def _checked(array: Any, most: int) -> ZarrFlat:
    """The array if it may be a flat: its description alone is believed, of which nothing is decoded yet."""
    shape, kind = tuple(int(n) for n in array.shape), np.dtype(array.dtype)
    if len(shape) not in (2, 3) or 0 in shape:
        raise FlatError(f"a flat is one grey or RGB picture, this Zarr array has shape {shape}")
    if kind.kind not in "buif":
        raise FlatError(f"pixels of type {kind} are not read; save them as 8 bit, 16 bit or float")
    first = len(shape) == 3 and shape[2] > 4 >= shape[0]
    height, width = shape[1:] if first else shape[:2]
    if height * width > most or (len(shape) == 3 and shape[0 if first else 2] > 4):
        raise FlatError(f"a flat is one grey or RGB picture of {most} px at most, this array has shape {shape}")
    chunk = getattr(array.metadata.chunk_grid, "chunk_shape", None)
    if chunk is None or len(chunk) != len(shape) or math.prod(max(n, 1) for n in chunk) > 4 * most:
        raise FlatError(f"chunks of shape {chunk} are not read; store the array in regular chunks of some megapixels")
    codecs = [*(getattr(array.metadata, "filters", None) or ()), getattr(array.metadata, "compressor", None)]
    unknown = {getattr(one, "codec_id", str(one)) for one in codecs if one is not None} - _CODECS
    if unknown:
        raise FlatError(f"the codec '{min(unknown)}' is not one of numbers; store the array without it")
    root = getattr(array.store, "root", None)
    if root is None:
        raise FlatError("is no Zarr array in a folder")
    return ZarrFlat(array, first, Path(root) / array.path)
