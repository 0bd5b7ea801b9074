"""Microimage vignetting: how much light a microlens delivers at each place of its own image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .lattice import Lattice

__all__ = ["Vignetting", "measure_vignetting"]


@dataclass(frozen=True)
class Vignetting:
    """Relative illumination over the microimage radius, 1 at its brightest.

    Parameters
    ----------
    profile : (k,) float64
        Relative illumination at radii `0, step, 2*step, ...`, each in 0..1.
    step : float [px]
        Distance between samples of `profile`.
    """

    profile: NDArray[np.float64]
    step: float

    def __post_init__(self) -> None:
        profile = np.array(self.profile, dtype=np.float64)
        if profile.ndim != 1 or len(profile) < 2 or not np.isfinite(profile).all():
            raise ValueError("profile must be a finite 1D array with at least two samples")
        if not (np.isfinite(self.step) and self.step > 0):
            raise ValueError(f"step must be a positive number of px, got {self.step!r}")
        profile.flags.writeable = False
        object.__setattr__(self, "profile", profile)
        object.__setattr__(self, "step", float(self.step))

    def at(self, radius: ArrayLike) -> NDArray[np.float64]:
        """Relative illumination at distances `radius` [px] from the microimage centre."""
        return np.interp(np.asarray(radius, dtype=np.float64), np.arange(len(self.profile)) * self.step, self.profile)


def measure_vignetting(picture: NDArray[np.float32], lattice: Lattice) -> tuple[Vignetting, float]:
    """Relative illumination of the average microimage and the radius to which it is usable.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance (`features.tone`), so that all lenses count alike.
    lattice : Lattice [px]

    Returns
    -------
    vignetting : Vignetting
    radius : float [px]
        Where the illumination falls below half, at most half the distance to the nearest microimage.
    """
    import cv2

    from .fit import radial_profile

    light = picture * picture
    window = (max(3, int(2 * lattice.pitch) | 1),) * 2
    local: Any = cv2.blur(light, window)
    local += np.float32(1e-3)
    light /= local
    np.minimum(light, 3, out=light)
    profile = radial_profile(light, lattice)
    limit = float(np.hypot(*(lattice.steps @ lattice.basis).T).min() / 2)
    radii = np.arange(len(profile.mean)) * profile.step
    inner = profile.mean[radii <= max(0.6 * limit, 2 * profile.step)]
    level = float(np.median(inner))
    relative = np.clip(profile.mean / max(level, 1e-9), 0, 1)
    dark = np.flatnonzero((relative < 0.5) & (radii > 0.3 * limit))
    radius = limit
    if len(dark):
        k = int(dark[0])
        before, after = relative[k - 1], relative[k]
        radius = min(limit, float(radii[k - 1] + (before - 0.5) / max(before - after, 1e-9) * profile.step))
    return Vignetting(relative[radii <= limit + profile.step], profile.step), radius
