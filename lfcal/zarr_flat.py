"""Flats in Zarr arrays, of version 2 and 3, read part by part."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import FlatError

__all__ = ["ZarrFlat", "is_zarr", "open_zarr"]

_MARKS = (".zarray", ".zgroup", "zarr.json")


@dataclass(frozen=True)
class ZarrFlat:
    """A grey or colour picture in a Zarr array.

    Parameters
    ----------
    array : zarr.Array
        Of shape (h, w), (h, w, c) or (c, h, w).
    first : bool
        The channels lie along the first axis.
    """

    array: Any
    first: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """Height, width and number of channels, where there are such."""
        shape = tuple(int(n) for n in self.array.shape)
        return (*shape[1:], shape[0]) if self.first else shape

    def read(self, rows: slice, columns: slice) -> NDArray[Any]:
        """Pixels as stored, channels along the last axis."""
        if self.first:
            return np.moveaxis(np.asarray(self.array[:, rows, columns]), 0, -1)
        return np.asarray(self.array[rows, columns])

    def whole(self) -> NDArray[Any]:
        """All pixels."""
        return self.read(slice(None), slice(None))


def is_zarr(path: Path) -> bool:
    """Whether a folder holds a Zarr array or group."""
    return any((path / name).is_file() for name in _MARKS)


def open_zarr(path: Path) -> ZarrFlat:
    """The one picture in a Zarr folder, of a group the array of that name or `0` (as OME-Zarr calls the largest).

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
    shape = found.shape
    if len(shape) not in (2, 3) or 0 in shape:
        raise FlatError(f"a flat is one grey or RGB picture, this Zarr array has shape {shape}")
    return ZarrFlat(found, len(shape) == 3 and shape[2] > 4 >= shape[0])
