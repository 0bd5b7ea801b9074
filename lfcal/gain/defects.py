"""Defects of a flat: pixels that differ from the gain map, and lenses without light."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.arrays import Frozen, decode_array, encode_array

__all__ = ["Defects"]


@dataclass(frozen=True, eq=False)
class Defects(Frozen):
    """Unreliable pixels and lenses of a flat.

    Parameters
    ----------
    pixels : (k, 2) int32
        `x, y` of pixels that are hot, dead or under dust or scratches.
    lenses : (m, 2) int32
        Lattice indices `i, j` of lenses that are missing or unlit.

    Examples
    --------
    >>> defects = Defects(pixels=[[17, 4], [80, 31]])
    >>> len(defects.pixels), len(defects.lenses)
    (2, 0)
    """

    pixels: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 2), np.int32))
    lenses: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 2), np.int32))

    def __post_init__(self) -> None:
        for name in ("pixels", "lenses"):
            values = np.array(getattr(self, name), dtype=np.int32)
            if values.ndim != 2 or values.shape[1] != 2:
                raise ValueError(f"{name} of defects must be of shape (k, 2), got {values.shape}")
            self._set(**{name: values})

    def to_dict(self) -> dict[str, Any]:
        """Two encoded arrays."""
        return {"pixels": encode_array(self.pixels.astype("<i4")), "lenses": encode_array(self.lenses.astype("<i4"))}

    @classmethod
    def from_dict(cls, data: Any) -> Defects:
        """Inverse of `to_dict`; KeyError, TypeError or ValueError if `data` is malformed."""
        pixels, lenses = (decode_array(data[name], "<i4").reshape(-1, 2) for name in ("pixels", "lenses"))
        return cls(pixels, lenses)
