"""Radial distortion of a microlens lattice: how far centres lie from the straight lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Distortion"]

# Inverting is done by iteration; each turn gains two digits at the distortions lenses have.
_TURNS = 12


@dataclass(frozen=True)
class Distortion:
    """Displacement `(s - centre) * (k1 * (rho**2 - 1/2) + k2 * (rho**4 - 1/4))` of straight lattice points `s`.

    `rho` is the distance to the centre over half the diagonal of the flat. What a straight lattice can follow is left
    to the basis by the subtracted constants, so that the lattice without its distortion is about the best straight one.

    Parameters
    ----------
    centre : (2,) float64 [px]
        Where it vanishes, order x, y.
    k1, k2 : float
        Strength of third and fifth order.
    reach : float [px]
        Half the diagonal of the flat.
    """

    centre: NDArray[np.float64]
    k1: float
    k2: float
    reach: float

    def __post_init__(self) -> None:
        centre = np.array(self.centre, dtype=np.float64)
        if centre.shape != (2,) or not np.isfinite(centre).all():
            raise ValueError(f"distortion centre must be two finite numbers, got {self.centre!r}")
        if not (np.isfinite([self.k1, self.k2, self.reach]).all() and self.reach > 0):
            raise ValueError(f"distortion must be finite with reach > 0, got {self.k1!r}, {self.k2!r}, {self.reach!r}")
        # Much beyond what any lens has; neighbouring lenses would change places.
        if abs(self.k1) + abs(self.k2) > 0.3:
            raise ValueError(f"distortion must stay below 0.3 in the corners, got {self.k1!r} and {self.k2!r}")
        centre.flags.writeable = False
        object.__setattr__(self, "centre", centre)
        for name in ("k1", "k2", "reach"):
            object.__setattr__(self, name, float(getattr(self, name)))

    def apply(self, points: ArrayLike) -> NDArray[np.float64]:
        """(n, 2) where straight lattice points (n, 2) [px] really lie."""
        offset = np.asarray(points, dtype=np.float64) - self.centre
        return self.centre + offset * (1 + self._stretch(offset))

    def remove(self, points: ArrayLike) -> NDArray[np.float64]:
        """(n, 2) straight positions of `points` (n, 2) on the flat [px]."""
        offset = np.asarray(points, dtype=np.float64) - self.centre
        straight = offset
        for _ in range(_TURNS):
            straight = offset / (1 + self._stretch(straight))
        return self.centre + straight

    def _stretch(self, offset: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 1) relative displacement of points at `offset` (n, 2) [px] from the centre."""
        square = (offset**2).sum(-1, keepdims=True) / self.reach**2
        return self.k1 * (square - 0.5) + self.k2 * (square**2 - 0.25)
