"""Dark frames: what a sensor shows without light, subtracted from its flats."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import FlatError

__all__ = ["subtract_dark"]


def subtract_dark(flat: NDArray[Any], dark: NDArray[Any]) -> NDArray[Any]:
    """A flat less a dark frame, in its own type; integers are clipped at 0.

    Parameters
    ----------
    flat : (h, w) or (h, w, c) array
    dark : (h, w) or (h, w, c) array
        A frame, or the mean of some, with the exposure of the flat and without light.

    Raises
    ------
    FlatError
        If both are not of one size and kind.

    Examples
    --------
    >>> import numpy as np
    >>> subtract_dark(np.array([[5, 90]], np.uint8), np.array([[7, 7]], np.uint8))
    array([[ 0, 83]], dtype=uint8)
    """
    flat, dark = np.asarray(flat), np.asarray(dark)
    if dark.ndim == 2 and flat.ndim == 3:
        dark = dark[:, :, None]
    if dark.shape[:2] != flat.shape[:2] or (dark.ndim == 3 and dark.shape[2] not in (1, flat.shape[-1])):
        raise FlatError(f"dark frame has shape {dark.shape}, the flat {flat.shape}; give one of the same sensor")
    if (dark.dtype.kind == "u") != (flat.dtype.kind == "u") or (
        flat.dtype.kind == "u" and dark.dtype.itemsize > flat.dtype.itemsize
    ):
        raise FlatError(f"dark frame is {dark.dtype}, the flat {flat.dtype}; give both as the sensor stores them")
    if flat.dtype.kind != "u":
        return np.asarray(flat - dark, flat.dtype)
    low = np.minimum(dark.astype(flat.dtype, copy=False), flat)
    return np.asarray(flat - low, flat.dtype)
