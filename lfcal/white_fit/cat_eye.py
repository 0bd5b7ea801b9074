"""The disc that cuts microimages to lens shapes (cat-eye, mechanical vignetting).

A stop in front of or behind the pupil of the main lens cuts microimages off the optical axis. The cut is a disc whose
offset from the microimage grows with the position in the field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice

__all__ = ["CatEye", "field_position"]


@dataclass(frozen=True)
class CatEye:
    """Disc that cuts the microimages, at `shift + growth * field` from their centres (`field_position`)."""

    shift: NDArray[np.float64]  # (2,) [px] offset in the middle of the flat
    growth: float  # [px] further offset in the corners, positive outwards
    radius: float  # [px]
    blur: float  # [px] standard deviation of its edge

    def displacement(self, field: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) offset [px] of the cutting disc at positions (n, 2) in the field."""
        return self.shift + self.growth * field


def field_position(centres: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) position in the field, of length 1 in the corners of the flat."""
    size = np.array(lattice.image_size)
    return (centres - (size - 1) / 2) / (np.hypot(*size) / 2)
