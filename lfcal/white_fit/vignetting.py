"""Mechanical vignetting: the disc that cuts microimages (cat-eye), and its signs.

A stop in front of or behind the pupil of the main lens cuts microimages off the optical axis. The
cut is a disc whose offset from the microimage grows with the position in the field.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lattice.lattice import Lattice
from ..lattice.robust_fit import SIGNIFICANT
from ..runtime.arrays import ENOUGH_PIXELS, Booleans, Floats, evenly
from .microimages import Microimages

__all__ = ["CatEye", "compare_pixels", "measure_centroid_offset", "measure_narrowing"]

# Lenses that centroids are measured on.
_LENSES = 300
# Least slope of the profile, over the steepest one, of pixels that locate an edge.
_STEEP = 0.1


@dataclass(frozen=True)
class CatEye:
    """Disc that cuts the microimages, at `shift + growth * field` from their centres.

    `field` is that of `Lattice.field_place`.
    """

    shift: Floats  # (2,) [px] offset in the middle of the flat
    growth: float  # [px] further offset in the corners, positive outwards
    radius: float  # [px]
    blur: float  # [px] standard deviation of its edge

    def displacement(self, field: Floats) -> Floats:
        """(n, 2) offset [px] of the cutting disc at positions (n, 2) in the field."""
        return self.shift + self.growth * field


def compare_pixels(lenses: Microimages) -> tuple[Floats, Booleans, Floats]:
    """Pixels of windows against the model.

    Residuals (n, k, k) over the gains; which pixels lie in cells and are not clipped; and slope of
    the profile there [1/px] and weight, (2, n, k, k).
    """
    x, y = lenses.places()
    far = np.maximum(np.hypot(x, y), 1e-6)
    step, table, saturation = lenses.rings
    level, slope, weight, own, harmonic = (
        np.interp(far / step, np.arange(len(table)), c) for c in table.T
    )
    (shade_x, shade_y), (slope_x, slope_y) = (
        lenses.shade.T[..., None, None],
        lenses.slope.T[..., None, None],
    )
    model = level + own * (shade_x * x + shade_y * y) + harmonic * (1 - 8 * (x * y / far**2) ** 2)
    inside = lenses.light < saturation
    for across, down in lenses.cell.normals:
        inside &= across * x + down * y <= 0.5
    tilt = 1 + slope_x * x + slope_y * y
    return (
        lenses.light / (lenses.gain[:, None, None] * tilt) - model,
        inside,
        np.stack([slope, weight]),
    )


def measure_narrowing(lenses: Microimages) -> tuple[float, float]:
    """By how much microimages in the corners are narrower along the field than across [px].

    Also returns the error.

    Amplitude of `cos(2 * angle)` of the radius, angles from the direction of the field, growing
    with the field: neither a lattice nor its distortion, neither blur nor the shape of pixels give
    whole discs any.
    """
    few = lenses.thin(ENOUGH_PIXELS)
    x, y = few.places()
    far = np.maximum(np.hypot(x, y), 1e-6)
    residual, inside, (slope, weight) = compare_pixels(few)
    used = inside & (far < few.cell.inradius) & (residual**2 * weight < SIGNIFICANT**2)
    used &= np.abs(slope) > _STEEP * np.abs(few.rings.table[:, 1]).max()
    field = few.field[:, :, None, None]
    reach = np.maximum(np.hypot(field[:, 0], field[:, 1]), 1e-6)
    along = (field[:, 0] * x + field[:, 1] * y) / (reach * far)
    response = slope * reach * (2 * along**2 - 1)
    information = float((used * weight * response**2).sum())
    if information <= 0:
        return 0.0, np.inf
    return float((used * weight * response * residual).sum()) / information, information**-0.5


def measure_centroid_offset(lenses: Microimages, lattice: Lattice) -> float:
    """Distance [px] of plain centroids from the lattice in the middle of the field.

    It is 0 if there are too few microimages.

    What grows with the field is left out: a disc that cuts microimages moves their centroids.
    """
    moved = lenses.at(lattice)
    near = np.flatnonzero(np.hypot(*moved.field.T) < 0.25)
    near = near[evenly(len(near), _LENSES)]
    if len(near) < 12:
        return 0.0
    x, y = moved.places()
    x = x[near]
    y = y[near]
    light = moved.light[near]
    field = moved.field[near]
    window = np.clip(moved.cell.inradius + 0.5 - np.hypot(x, y), 0, 1)
    light = window * np.clip(light - np.quantile(light, 0.05, axis=(1, 2))[:, None, None], 0, None)
    total = np.maximum(light.sum((1, 2)), 1e-30)
    offset = np.column_stack([(light * way).sum((1, 2)) / total for way in (x, y)])
    field = field - field.mean(0)
    growth = ((offset - np.median(offset, axis=0)) * field).sum() / max(
        float((field**2).sum()), 1e-30
    )
    return float(np.hypot(*np.median(offset - growth * field, axis=0)))
