"""HDF5 files (h5py): raw pictures (plenoptomos `.vox`), flats, and light fields of views, made into microimages.

A light field of views `(v, u, y, x)` is a flat with a microimage of `v x u` pixels about every `(y, x)`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...runtime.errors import FlatError
from ..decoders import MAX_PIXELS, check_size

__all__ = ["read_hdf5"]

# Datasets by what they are called, the capture first: plenoptomos, HCI (Heidelberg), and other common names.
_CAPTURES = ("data/image", "LF", "lightfield", "light_field", "flat", "image", "raw", "data")
_FURTHER = ("data/white", "data/dark", "white", "dark")
_MOST_VIEWS = 64


def read_hdf5(path: Path, page: int | None) -> NDArray[Any]:
    """The capture in an HDF5 file, or with `page` 1 and more its white and dark images, as a flat."""
    try:
        import h5py
    except ImportError as error:
        raise FlatError("HDF5 needs the package 'h5py'; pip install 'lfrender[hdf5]'") from error
    with h5py.File(path, "r") as file:
        further = [name for name in _FURTHER if isinstance(file.get(name), h5py.Dataset)]
        if page:
            if page > len(further):
                raise FlatError(f"holds {1 + len(further)} pictures and no page {page}")
            return _flat(further[page - 1], file[further[page - 1]])
        named = [name for name in _CAPTURES if isinstance(file.get(name), h5py.Dataset)]
        if not named:
            named = _only_picture(h5py, file)
        return _flat(named[0], file[named[0]])


def _only_picture(h5py: Any, file: Any) -> list[str]:
    """The only dataset that can be a picture, where none has a known name."""
    found: list[str] = []

    def visit(name: str, item: Any) -> bool | None:
        if isinstance(item, h5py.Dataset) and item.ndim >= 2 and item.dtype.kind in "uf" and min(item.shape[:2]) > 1:
            found.append(name)
        return True if len(found) > 1 else None

    file.visititems(visit)
    if len(found) != 1:
        known = ", ".join(_CAPTURES[:3])
        raise FlatError(f"holds {len(found) or 'no'} pictures; name the dataset of the flat one of {known}")
    return found


def _flat(name: str, data: Any) -> NDArray[Any]:
    """A dataset as a flat."""
    shape = tuple(int(n) for n in data.shape)
    if data.dtype.kind not in "uf" or data.dtype.hasobject:
        raise FlatError(f"dataset '{name}' holds {data.dtype}; save it as 8 bit, 16 bit or float")
    if len(shape) not in (2, 3, 4, 5) or 0 in shape or (len(shape) in (3, 5) and shape[-1] > 4):
        raise FlatError(f"dataset '{name}' of shape {shape} is no picture and no light field (v, u, y, x)")
    views = shape[:2] if len(shape) > 3 else (1, 1)
    if max(views) > _MOST_VIEWS:
        raise FlatError(f"dataset '{name}' of shape {shape}: views come first, (v, u, y, x)")
    height, width = (shape[2], shape[3]) if len(shape) > 3 else shape[:2]
    check_size(width * views[1], height * views[0])
    _check_stored(name, data)
    pixels: NDArray[Any] = data[()]
    if pixels.dtype.kind == "u" and pixels.dtype.itemsize > 2:
        if pixels.max(initial=0) > 0xFFFF:
            raise FlatError(f"dataset '{name}' holds values above 65535; save it as 16 bit")
        pixels = pixels.astype(np.uint16)
    if pixels.ndim < 4:
        return pixels
    pixels = np.moveaxis(pixels, (2, 0, 3, 1), (0, 1, 2, 3))
    return np.ascontiguousarray(pixels.reshape(height * views[0], width * views[1], *shape[4:]))


def _check_stored(name: str, data: Any) -> None:
    """FlatError where values are missing, which HDF5 fills in, or packed so that they would fill the memory."""
    if data.nbytes > 32 * MAX_PIXELS:
        raise FlatError(f"dataset '{name}' has {data.nbytes} bytes, more than this toolkit reads")
    stored = int(data.id.get_storage_size())
    if data.chunks is None:
        if stored < data.nbytes:
            raise FlatError(f"dataset '{name}' has {stored} of {data.nbytes} bytes; the file is incomplete")
        return
    wanted = int(np.prod([-(-n // c) for n, c in zip(data.shape, data.chunks, strict=True)]))
    # Shuffled and deflated pictures are a tenth of their size, blank ones a thousandth.
    if data.id.get_num_chunks() < wanted or stored * 1100 < data.nbytes:
        raise FlatError(f"dataset '{name}' is incomplete: chunks are missing; copy the file anew")
