"""The gain of parts of a flat, for cameras whose flats are too large to be held as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ..lattice.lattice import Lattice
    from .gain_map import GainMap

__all__ = ["PartGain"]

# Rows flattened at a time, so that memory does not grow with the part.
_BAND = 512


class PartGain:
    """A gain map with its tables for one lattice, made once for all parts of a flat.

    Parameters
    ----------
    gain_map : GainMap
    lattice : Lattice
    """

    def __init__(self, gain_map: GainMap, lattice: Lattice) -> None:
        self._fill = gain_map.filler(lattice)

    def at(self, left: int, top: int, width: int, height: int) -> NDArray[np.float32]:
        """(height, width) gain of the part of the flat that begins at the pixel `left, top`, as `Calibration.gain`."""
        out = np.empty((height, width), np.float32)
        self._fill(out, top, left)
        return out

    def flatten(self, pixels: NDArray[Any], left: int = 0, top: int = 0) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Divide a part of a flat by its gain.

        Parameters
        ----------
        pixels : (h, w) or (h, w, c) unsigned integers or floats
        left, top : int [px]
            Flat coordinates of the first pixel.

        Returns
        -------
        even : array of the shape and type of `pixels`
            As `Calibration.flatten` has it there.
        unknown : (h, w) bool
            Pixels whose gain is not known, which are left as they are.
        """
        from .kernel import divide

        deep = pixels.reshape(*pixels.shape[:2], -1)
        out, unknown = np.empty_like(deep), np.empty(deep.shape[:2], np.bool_)
        highest = float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else 0.0
        band = np.empty((min(_BAND, len(deep)), deep.shape[1]), np.float32)
        for first in range(0, len(deep), _BAND):
            rows = slice(first, first + _BAND)
            gain = band[: len(deep[rows])]
            self._fill(gain, top + first, left)
            divide(deep[rows], gain, out[rows], highest)
            np.isnan(gain, out=unknown[rows])
        return out.reshape(pixels.shape), unknown
