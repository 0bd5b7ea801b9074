"""The pixels of a flat that a volume is reconstructed from: place, value, share of light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.runtime.arrays import Floats, Singles

__all__ = ["FlatPixels", "choose_pixels"]

# Pixels with less light than this share of the brightest are left out: they lie at the rims of
# microimages, where diffraction and neighbours change the light.
_LEAST_LIGHT = 0.5
# Pixels nearer than this to the rim of a microimage or of its cell [px] are left out: half a pixel
# reaches beyond it.
_RIM = 0.5
# Largest sine of the angle between a ray and the axis: flatter rays would run to infinity.
_LARGEST_SINE = 0.98
# Rows of a flat whose pixels are assigned to lenses at a time: bounds the memory.
_ROWS = 256


@dataclass(frozen=True)
class FlatPixels:
    """Pixels (p,) of a flat."""

    values: Singles  # of the flat
    light: Singles  # share of light by the white image
    centres: Singles  # (p, 2) of their microlenses [px]
    angles: Singles  # (p, 2) how far a ray moves for a slope of 1: g [px]
    bins: NDArray[np.int32]  # offset from the centre, rounded and numbered row by row
    radius: float  # largest distance from the centre of a microimage [px]
    side: int  # bins in a row, and rows of bins

    @property
    def reach(self) -> float:
        """Largest offset along x or y that rays have for a slope of 1 [px]."""
        return float(np.abs(self.angles).max())


def choose_pixels(
    flat: Singles, calibration: Calibration, flat_radius: float, pupil_radius: float
) -> FlatPixels:
    """Pixels with at least half the light of the brightest, within their microimage.

    `flat` (h, w), `flat_radius` and `pupil_radius` [px] as in `Scale`.
    """
    lattice = calibration.lattice
    height, width = flat.shape
    known = calibration.gain_map is not None or calibration.vignetting is not None
    gain = calibration.gain() if known else np.ones((height, width), np.float32)
    cell = lattice.radius
    if known:
        cell = lattice.pitch / 2
    limit = min(cell - _RIM, pupil_radius, _LARGEST_SINE * flat_radius)
    parts = []
    for top in range(0, height, _ROWS):
        rows = slice(top, min(top + _ROWS, height))
        y, x = np.mgrid[rows, :width]
        points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
        centres = _nearest_centres(lattice, points)
        offset = points - centres
        light = gain[rows].ravel()
        inside = (offset**2).sum(1) <= limit**2
        used = inside & (np.nan_to_num(light) >= _LEAST_LIGHT)
        parts.append((flat[rows].ravel()[used], light[used], centres[used], offset[used]))
    values, light, centres, offset = (np.concatenate(column) for column in zip(*parts, strict=True))
    half = int(limit) + 1
    whole = np.rint(offset).astype(np.int32) + half
    side = 2 * half + 1
    cosine = np.sqrt(1 - (offset**2).sum(1) / flat_radius**2)
    return FlatPixels(
        values.astype(np.float32),
        light.astype(np.float32),
        centres.astype(np.float32),
        (offset / cosine[:, None]).astype(np.float32),
        whole[:, 1] * side + whole[:, 0],
        float(np.sqrt((offset**2).sum(1).max(initial=0.0))),
        side,
    )


def _nearest_centres(lattice: Lattice, points: Floats) -> Floats:
    """(n, 2) centre of the lens nearest to each point (n, 2) [px], in any lattice."""
    low = np.floor(lattice.to_index(points))
    nearest = lattice.points(low)
    least = ((points - nearest) ** 2).sum(1)
    for step in ((1, 0), (0, 1), (1, 1)):
        other = lattice.points(low + step)
        away = ((points - other) ** 2).sum(1)
        nearer = away < least
        nearest[nearer] = other[nearer]
        least[nearer] = away[nearer]
    return nearest
