"""How far single microimages lie from the lattice fitted to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.frozen import Frozen
from ..runtime.text_arrays import decode_array, encode_array
from .lattice import Lattice

__all__ = ["Residuals"]

# Unit of residuals in camera files [px]: finer than what noise leaves of a single microimage.
_UNIT = 1e-3
# Residuals further than this many times the usual say something about their lens, not about the lattice.
_OUTLIER = 4.0


@dataclass(frozen=True)
class Residuals(Frozen):
    """Where the pixels of single microimages put them, against the fitted lattice.

    Parameters
    ----------
    indices : (n, 2) int32
        Lattice indices `i, j` of the microimages of the fit: those that lie whole on the flat or, where these are
        very many, an even sample of them.
    offset : (n, 2) float32 [px]
        From the centre on the lattice to the one that the pixels of this microimage alone show, order `x, y`.
    """

    indices: NDArray[np.int32]
    offset: NDArray[np.float32]

    def __post_init__(self) -> None:
        indices, offset = np.array(self.indices, dtype=np.int32), np.array(self.offset, dtype=np.float32)
        if indices.ndim != 2 or indices.shape[1] != 2 or offset.shape != indices.shape:
            raise ValueError(f"residuals need two arrays (n, 2), got {indices.shape} and {offset.shape}")
        indices.flags.writeable = offset.flags.writeable = False
        object.__setattr__(self, "indices", indices)
        object.__setattr__(self, "offset", offset)

    def mean_over_grid(
        self, lattice: Lattice, across: int, down: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Mean residuals in equal rectangles of the flat, without outliers.

        Returns
        -------
        places : (m, 2) float64 [px]
            Mean centres of the microimages in each rectangle that has at least two.
        mean : (m, 2) float64 [px]
        error : (m,) float64 [px]
            Standard error of the length of `mean`: shorter ones are noise.
        """
        centres = lattice.points(self.indices)
        share = (centres + 0.5) / np.array(lattice.image_size) * [across, down]
        column, row = np.clip(share.astype(int), 0, [across - 1, down - 1]).T
        length = np.hypot(*self.offset.T)
        usual = length <= _OUTLIER * np.median(length) if len(length) else np.zeros(0, dtype=bool)
        found = []
        for cell in range(across * down):
            inside = usual & (row * across + column == cell)
            count = int(inside.sum())
            if count > 1:
                offset = self.offset[inside].astype(np.float64)
                error = np.sqrt(offset.var(0, ddof=1).sum() / count)
                found.append((*centres[inside].mean(0), *offset.mean(0), error))
        table = np.array(found).reshape(-1, 5)
        return table[:, :2], table[:, 2:4], table[:, 4]

    def scaled(self, block: float) -> Residuals:
        """The residuals in units of pixels smaller by the factor `block`."""
        return Residuals(self.indices, self.offset * np.float32(block))

    def to_dict(self) -> dict[str, Any]:
        """Two packed blocks; offsets to a thousandth of a pixel."""
        steps = np.clip(np.rint(self.offset / _UNIT), -32767, 32767)
        return {"indices": encode_array(self.indices.T.astype("<i2")), "offset": encode_array(steps.T.astype("<i2"))}

    @classmethod
    def from_dict(cls, data: Any) -> Residuals:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        indices, steps = (decode_array(data[name], "<i2").reshape(2, -1).T for name in ("indices", "offset"))
        return cls(indices.astype(np.int32), steps.astype(np.float32) * np.float32(_UNIT))
