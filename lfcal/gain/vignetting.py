"""Microimage vignetting: relative illumination over the distance to the centre of the average microimage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..runtime.arrays import Floats, Frozen

__all__ = ["Vignetting"]


@dataclass(frozen=True, eq=False)
class Vignetting(Frozen):
    """Relative illumination over the microimage radius, 1 at its brightest.

    Parameters
    ----------
    profile : (k,) float64
        Relative illumination at radii `0, step, 2*step, ...`, each in 0..1.
    step : float [px]
        Distance between samples of `profile`.

    Examples
    --------
    >>> Vignetting([1.0, 0.9, 0.5], step=2.0).at([1.0, 3.0])
    array([0.95, 0.7 ])
    """

    profile: Floats
    step: float

    def __post_init__(self) -> None:
        profile = np.array(self.profile, dtype=np.float64)
        if profile.ndim != 1 or len(profile) < 2 or not np.isfinite(profile).all():
            raise ValueError("profile must be a finite 1D array with at least two samples")
        if not (np.isfinite(self.step) and self.step > 0):
            raise ValueError(f"step must be a positive number of px, got {self.step!r}")
        self._set(profile=profile, step=float(self.step))

    def at(self, radius: ArrayLike) -> Floats:
        """Relative illumination at distances `radius` [px] from the microimage centre."""
        return np.interp(np.asarray(radius, dtype=np.float64), np.arange(len(self.profile)) * self.step, self.profile)
