"""Offset of the microimages of a flat from a lattice: a shift and a linear map."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..lattice.cell import nearest_offsets
from ..lattice.lattice import Lattice
from ..runtime.arrays import Floats

__all__ = ["MOST_SHIFT", "MOST_STRETCH", "Misfit"]

# Largest shift of a right camera over the whole flat [pitch]: 0.05 on 60 simulated flats. Beyond
# it, errors are visible in pictures.
MOST_SHIFT = 0.06
# Largest shift of a corner by scale or rotation [pitch]: 0.028 with right cameras on 11 captures,
# 0.039 with a wrong one.
MOST_STRETCH = 0.033
# Largest difference of two bases of one lattice, relative to the first.
_SAME_CELL = 0.1
# Largest relative difference of the basis of a right camera: 0.0011 on 60 simulated flats.
_SAME_BASIS = 0.0025
# Largest shift of a corner of a right camera [pitch]: 0.08 on the same flats.
_CORNER = 0.2


class Misfit(NamedTuple):
    """Offset of the microimages from a lattice: `shift + (p - middle) @ linear` [px] at `p`."""

    shift: Floats  # (2,) [px] in the middle of the flat, to the nearest centre
    linear: Floats  # (2, 2)
    image_size: tuple[int, int]
    pitch: float
    error: float = 0.0  # [pitch] that a fit may have in a corner

    @classmethod
    def between(cls, given: Lattice, found: Lattice) -> Misfit | None:
        """The offset, or None if the lattices have different cells."""
        whole = np.rint(found.basis @ np.linalg.inv(given.basis))
        if round(abs(np.linalg.det(whole))) != 1:
            return None
        linear = np.linalg.inv(given.basis) @ np.linalg.solve(whole, found.basis) - np.eye(2)
        if np.linalg.norm(linear, 2) > _SAME_CELL:
            return None
        index = found.to_index(given.points(given.middle[None]))
        shift = -nearest_offsets(index, found.basis)[0]
        return cls(shift, linear, given.image_size, given.pitch)

    def at(self, positions: Floats) -> Floats:
        """Offsets (..., 2) [px] at positions (..., 2) of the flat."""
        middle = (np.array(self.image_size) - 1) / 2
        return self.shift + (positions - middle) @ self.linear

    def applied(self, lattice: Lattice) -> Lattice:
        """The lattice moved onto the microimages, with its distortion."""
        basis = lattice.basis @ (np.eye(2) + self.linear)
        return replace(lattice, origin=lattice.origin + self.at(lattice.origin), basis=basis)

    def differs(self, other: Misfit) -> bool:
        """Whether another measurement of the same offset is so different that one has run away."""
        return float(np.linalg.norm(self.shift - other.shift)) > MOST_SHIFT * self.pitch

    def upscaled(self, lattice: Lattice) -> Misfit:
        """The same in the pixels of the given lattice, before downscaling."""
        shift = self.shift * (lattice.pitch / self.pitch)
        return self._replace(shift=shift, image_size=lattice.image_size, pitch=lattice.pitch)

    @property
    def stretch(self) -> float:
        """Largest offset of a corner against the middle [pitch]."""
        half = np.array(self.image_size) / 2
        return (
            float(np.linalg.norm(half * [[1, 1], [1, -1]] @ self.linear, axis=1).max()) / self.pitch
        )

    @property
    def distance(self) -> float:
        """Offset in the middle [pitch]."""
        return float(np.linalg.norm(self.shift)) / self.pitch

    @property
    def is_straight(self) -> bool:
        """Whether scale and angle are the same, or so near that no corner of a small flat shows the
        difference.
        """
        return float(np.linalg.norm(self.linear, 2)) < _SAME_BASIS or not self.is_stretched

    @property
    def is_stretched(self) -> bool:
        """Whether a corner is off by more than right cameras and the error of the fit explain."""
        return self.stretch > max(MOST_STRETCH, self.error)

    @property
    def is_negligible(self) -> bool:
        """Whether the offset is at most half of those that `check_camera` warns of."""
        return self.distance < MOST_SHIFT / 2 and self.stretch < MOST_STRETCH / 2

    @property
    def is_small(self) -> bool:
        """Whether the offset may be that of a right camera."""
        near = self.distance + self.stretch < _CORNER
        return bool(self.is_straight and near and self.distance < MOST_SHIFT)
