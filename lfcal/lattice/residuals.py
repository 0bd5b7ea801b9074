"""How far single microimages lie from the lattice fitted to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.arrays import Frozen, decode_array, encode_array
from .lattice import Lattice

__all__ = ["Residuals"]

# Unit of residuals in camera files [px]: finer than the noise of a single microimage.
_FILE_UNIT = 1e-3


@dataclass(frozen=True, eq=False)
class Residuals(Frozen):
    """Centres measured on single microimages minus those of the fitted lattice.

    Parameters
    ----------
    indices : (n, 2) int32
        Lattice indices `i, j` of the microimages of the fit: those that lie entirely on the flat, or an even sample of
        them where they are very many.
    offset : (n, 2) float32 [px]
        From the lattice centre to the centre measured on this microimage alone, order `x, y`.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> residuals = lfcal.calibrate(sample.white, kind="white").residuals
    >>> residuals.indices.shape == residuals.offset.shape
    True
    """

    indices: NDArray[np.int32]
    offset: NDArray[np.float32]

    def __post_init__(self) -> None:
        indices, offset = np.array(self.indices, dtype=np.int32), np.array(self.offset, dtype=np.float32)
        if indices.ndim != 2 or indices.shape[1] != 2 or offset.shape != indices.shape:
            raise ValueError(f"residuals need two arrays (n, 2), got {indices.shape} and {offset.shape}")
        self._set(indices=indices, offset=offset)

    def mean_over_grid(
        self, lattice: Lattice, across: int = 12, down: int = 9
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Mean residuals in a grid of rectangles of the flat, without outliers.

        Of each rectangle with two microimages or more: their mean centre (m, 2), mean residual (m, 2) and the standard
        error of its length (m,), all in px.
        """
        centres = lattice.points(self.indices)
        share = (centres + 0.5) / np.array(lattice.image_size) * [across, down]
        column, row = np.clip(share.astype(int), 0, [across - 1, down - 1]).T
        length = np.hypot(*self.offset.T)
        inlier = length <= 4 * np.median(length) if len(length) else np.zeros(0, dtype=bool)
        rows = []
        for cell in range(across * down):
            inside = inlier & (row * across + column == cell)
            count = int(inside.sum())
            if count > 1:
                offset = self.offset[inside].astype(np.float64)
                error = np.sqrt(offset.var(0, ddof=1).sum() / count)
                rows.append((*centres[inside].mean(0), *offset.mean(0), error))
        table = np.array(rows).reshape(-1, 5)
        return table[:, :2], table[:, 2:4], table[:, 4]

    def scaled(self, block: float) -> Residuals:
        """The residuals in units of pixels smaller by the factor `block`."""
        return Residuals(self.indices, self.offset * np.float32(block))

    def to_dict(self) -> dict[str, Any]:
        """Two packed blocks; offsets to a thousandth of a pixel."""
        steps = np.clip(np.rint(self.offset / _FILE_UNIT), -32767, 32767)
        return {"indices": encode_array(self.indices.T.astype("<i2")), "offset": encode_array(steps.T.astype("<i2"))}

    @classmethod
    def from_dict(cls, data: Any) -> Residuals:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        indices, steps = (decode_array(data[name], "<i2").reshape(2, -1).T for name in ("indices", "offset"))
        return cls(indices.astype(np.int32), steps.astype(np.float32) * np.float32(_FILE_UNIT))
