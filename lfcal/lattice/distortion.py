"""Smooth distortion of a microlens lattice: how far centres lie from the straight lattice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..runtime.frozen import Frozen

__all__ = ["Distortion"]

# Inverting is done by iteration; each turn gains two digits at the distortions lenses have.
_TURNS = 12
# Powers of x and y of the general part.
_POWERS = ((2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
# The strongest distortion [share of the distance from the middle] that leaves neighbouring lenses in their order.
_STRONGEST = 0.3
# The centre of the distortion moves by at most this share of half the diagonal in one step.
_FURTHEST = 0.1


@dataclass(frozen=True)
class Distortion(Frozen):
    """Displacement of straight lattice points `s`: a radial part about a centre, and a general one about the middle.

    Radial: `(s - centre) * (k1 * (rho**2 - 1/2) + k2 * (rho**4 - 1/4))`, with `rho` the distance to the centre over
    half the diagonal of the flat. What a straight lattice can follow is left to the basis by the subtracted
    constants, so that the lattice without its distortion is about the best straight one.
    General, for film and scanners: `sum of general[:, k] * x**p * y**q` over the powers `p, q` = 20, 11, 02, 30, 21,
    12, 03 of the place `x, y` relative to `middle`, in units of half the diagonal.

    Parameters
    ----------
    centre : (2,) float64 [px]
        Where the radial part vanishes, order x, y.
    k1, k2 : float
        Strength of third and fifth order.
    reach : float [px]
        Half the diagonal of the flat.
    general : (2, 7) float64 [px] or None
        Displacement in x and in y; None where there is none.
    middle : (2,) float64 [px] or None
        Where the general part vanishes; needed where there is one.
    """

    centre: NDArray[np.float64]
    k1: float
    k2: float
    reach: float
    general: NDArray[np.float64] | None = None
    middle: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        centre = np.array(self.centre, dtype=np.float64)
        if centre.shape != (2,) or not np.isfinite(centre).all():
            raise ValueError(f"distortion centre must be two finite numbers, got {self.centre!r}")
        if not (np.isfinite([self.k1, self.k2, self.reach]).all() and self.reach > 0):
            raise ValueError(f"distortion must be finite with reach > 0, got {self.k1!r}, {self.k2!r}, {self.reach!r}")
        if abs(self.k1) + abs(self.k2) > _STRONGEST:
            raise ValueError(f"distortion must stay below 0.3 in the corners, got {self.k1!r} and {self.k2!r}")
        centre.flags.writeable = False
        object.__setattr__(self, "centre", centre)
        for name in ("k1", "k2", "reach"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if self.general is None:
            object.__setattr__(self, "middle", None)
            return
        general = np.array(self.general, dtype=np.float64)
        if general.shape != (2, len(_POWERS)) or not np.isfinite(general).all():
            raise ValueError(f"general distortion must be (2, {len(_POWERS)}) finite numbers, got {self.general!r}")
        if np.abs(general).sum(1).max() > _STRONGEST * self.reach:
            raise ValueError("general distortion must stay below 0.3 of half the diagonal")
        middle = np.array(self.middle, dtype=np.float64)
        if middle.shape != (2,) or not np.isfinite(middle).all():
            raise ValueError(f"middle of a general distortion must be two finite numbers, got {self.middle!r}")
        for name, values in (("general", general), ("middle", middle)):
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    def apply(self, points: ArrayLike) -> NDArray[np.float64]:
        """(n, 2) where straight lattice points (n, 2) [px] really lie."""
        straight = np.asarray(points, dtype=np.float64)
        return straight + self._displacement(straight)

    def remove(self, points: ArrayLike) -> NDArray[np.float64]:
        """(n, 2) straight positions of `points` (n, 2) on the flat [px]."""
        bent = np.asarray(points, dtype=np.float64)
        straight = bent
        for _ in range(_TURNS):
            # Dividing by the stretch of the radial part converges sooner than subtracting it.
            offset = straight - self.centre
            straight = self.centre + (bent - self._general(straight) - self.centre) / (1 + self._stretch(offset))
        return straight

    def downscaled(self, factor: int) -> Distortion:
        """The same distortion of a flat of which `factor` x `factor` pixels each have become one."""
        return Distortion(
            (self.centre + 0.5) / factor - 0.5,
            self.k1,
            self.k2,
            self.reach / factor,
            None if self.general is None else self.general / factor,
            None if self.middle is None else (self.middle + 0.5) / factor - 0.5,
        )

    def derivatives(self, straight: NDArray[np.float64]) -> list[tuple[str, NDArray[np.float64]]]:
        """Names of the parameters and change (n, 2) of the displacement of points (n, 2) with each of them.

        `"centre"` comes twice, for x and y; `"general"` fourteen times, all of x first.
        """
        offset = straight - self.centre
        square = (offset**2).sum(1, keepdims=True) / self.reach**2
        unit = np.eye(2)
        found = [("k1", offset * (square - 0.5)), ("k2", offset * (square**2 - 0.25))]
        for axis in range(2):
            along = 2 * offset[:, [axis]] / self.reach**2 * offset * (self.k1 + 2 * self.k2 * square)
            found.append(("centre", -(self._stretch(offset) * unit[axis] + along)))
        if self.general is not None:
            powers = self._powers(straight)
            found += [("general", powers[:, [k]] * unit[axis]) for axis in range(2) for k in range(len(_POWERS))]
        return found

    def updated(self, change: Mapping[str, NDArray[np.float64]]) -> Distortion:
        """The distortion after steps of the parameters named in `derivatives`."""
        most = _FURTHEST * self.reach
        general = self.general
        if general is not None and "general" in change:
            general = general + np.reshape(change["general"], general.shape)
        return Distortion(
            self.centre + np.clip(change.get("centre", np.zeros(2)), -most, most),
            self.k1 + float(change.get("k1", np.zeros(1))[0]),
            self.k2 + float(change.get("k2", np.zeros(1))[0]),
            self.reach,
            general,
            self.middle,
        )

    def _displacement(self, straight: NDArray[np.float64]) -> NDArray[np.float64]:
        offset = straight - self.centre
        return offset * self._stretch(offset) + self._general(straight)

    def _general(self, straight: NDArray[np.float64]) -> NDArray[np.float64] | float:
        return 0.0 if self.general is None else self._powers(straight) @ self.general.T

    def _powers(self, straight: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 7) powers of the place in the field."""
        assert self.middle is not None
        x, y = np.moveaxis((straight - self.middle) / self.reach, -1, 0)
        return np.stack([x**p * y**q for p, q in _POWERS], axis=-1)

    def _stretch(self, offset: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 1) relative displacement of points at `offset` (n, 2) [px] from the centre."""
        square = (offset**2).sum(-1, keepdims=True) / self.reach**2
        return self.k1 * (square - 0.5) + self.k2 * (square**2 - 0.25)
