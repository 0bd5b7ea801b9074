"""Some lenses of a white image: their pixels, and the levels and slopes of their light.

A pixel sees the exit pupil of the main lens through its microlens. Light falls off with the angle
of its rays, that is about the point below the microlens, which lies the farther from the centre of
the microimage the farther out in the field it is.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..gain.gain_map import fit_light_slope
from ..images.stack import clipping_level
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_mask
from ..lattice.robust_fit import SIGNIFICANT
from ..microimage.lit import UNLIT, find_lit_lenses, is_lit
from ..runtime.arrays import Booleans, Floats, Integers, Singles, evenly
from ..runtime.errors import CalibrationError

__all__ = ["Lenses", "core_reach", "cut_out", "measure_centroid_offset"]

_FEWEST_LENSES = 12
# [inradius] Disc in which the slope of the light is measured: edges are far, and cuts are rare.
_INNER = 0.6
# Side of the square in the middle that the light is measured in, over the diameter.
_CORE = 0.4
# Pixels that a slope is measured on.
_SLOPE_PIXELS = 2e5
# Lenses that centroids are measured on.
_CENTROID_LENSES = 300


@dataclass(frozen=True)
class Lenses:
    """Windows of the flat around `n` lenses, and what they show of each lens by itself."""

    indices: Integers  # (n, 2) of the lattice
    light: Singles  # (n, k, k) squares of the flat around the lenses
    corners: Integers  # (n, 2) [px] flat coordinates of the first pixel of each
    centres: Floats  # (n, 2) [px]
    field: Floats  # (n, 2) places of the centres in the field
    reach: float  # [px] unit of `field`
    gain: Floats  # (n,) light of each lens over that of the model
    slope: Floats  # (n, 2) [1/px] relative change of the gain within the microimage
    shade: Floats  # (n, 2) [1/px] slope of the gain without the light of the neighbours
    cell: Cell
    saturation: float  # least light of clipped pixels

    @property
    def given(self) -> dict[str, Any]:
        """Arguments of any class of lenses that has these."""
        return {one.name: getattr(self, one.name) for one in fields(Lenses)}

    @property
    def parameters(self) -> Floats:
        """As `LightModel.parameters`: there are none."""
        return np.zeros(0)

    @property
    def prior(self) -> tuple[Floats, Floats]:
        """As `LightModel.prior`, of no parameters."""
        return np.zeros(0), np.zeros(0)

    @property
    def pixels(self) -> float:
        """Pixels in the cells of all lenses, about."""
        return len(self.centres) * np.pi * self.cell.inradius * self.cell.circumradius

    def at(self, lattice: Lattice) -> Self:
        """The same with the centres of a lattice."""
        centres = lattice.points(self.indices)
        return replace(self, centres=centres, field=lattice.field_place(centres))

    def thin(self, pixels: float) -> Self:
        """An even part of the lenses, with at most so many pixels in their windows."""
        return self.select(slice(None, None, max(1, int(self.light.size / pixels) + 1)))

    def select(self, rows: slice | Integers) -> Self:
        """Some of the lenses."""
        of_lenses = ("indices", "light", "corners", "centres", "field", "gain", "slope", "shade")
        return replace(self, **{name: getattr(self, name)[rows] for name in of_lenses})

    def places(self) -> tuple[Floats, Floats]:
        """(n, 1, k) `x` and (n, k, 1) `y` of the pixels relative to the centres [px]."""
        offset = (self.corners - self.centres)[:, :, None] + np.arange(self.light.shape[1])
        return offset[:, 0, None, :], offset[:, 1, :, None]

    def in_cells(self) -> Booleans:
        """(n, k, k) which pixels of the windows lie in the cells."""
        x, y = self.places()
        inside = np.ones(self.light.shape, dtype=bool)
        for across, down in self.cell.normals:
            inside &= across * x + down * y <= 0.5
        return inside

    def even(self, shaded: bool = False) -> Floats:
        """(n, k, k) light of the pixels over the gain of their lens, without the slope.

        With `shaded`, the slope of the light of a lens by itself is divided out, too.
        """
        x, y = self.places()
        slope = self.slope + self.shade if shaded else self.slope
        tilt = 1 + slope[:, 0, None, None] * x + slope[:, 1, None, None] * y
        return np.asarray(self.light / (self.gain[:, None, None] * tilt))

    def learn_levels(self, gains: Floats, lattice: Lattice) -> Self:
        """The lenses on a lattice, with gains changed by these shares (n,), and slopes as these."""
        lenses = replace(self, gain=self.gain * (1 + gains)).at(lattice)
        slope = fit_light_slope(lenses.gain, lenses.field, lenses.reach)
        return replace(lenses, slope=slope).learn_shade(lattice)

    def learn_shade(self, lattice: Lattice) -> Self:
        """The lenses with the slope of their light without that of their neighbours.

        It is measured in the middles of some of the microimages, those that are not clipped.
        """
        some = self.thin(_SLOPE_PIXELS)
        x, y = some.places()
        inside = np.hypot(x, y) < _INNER * self.cell.inradius
        clipped = inside & (some.light >= some.saturation)
        inside = inside & ~clipped.any((1, 2), keepdims=True)
        miss = (some.even() - 1) * inside
        square = 0.5 * (inside * (x**2 + y**2)).sum((1, 2))
        slopes = (
            np.column_stack([(miss * x).sum((1, 2)), (miss * y).sum((1, 2))])
            / np.maximum(square, 1e-30)[:, None]
        )
        field = _fit_shade(slopes, square, some.centres, lattice)
        return replace(self, shade=field[0] + self.centres @ field[1:])


def cut_out(tones: StackedCrops, lattice: Lattice, pixels: float, fewest: int) -> Lenses:
    """Cut evenly spread lit lenses out of a flat.

    They have about this number of `pixels`, but there are at least `fewest` lenses. Gains are the
    light in their middles.
    """
    cell = Cell.of(lattice)
    margin = cell.circumradius + 2
    indices, centres, crop = tones.lenses(lattice, margin)
    lit = find_lit_lenses(
        tones.picture, lattice, indices, centres - tones.offsets[crop], UNLIT**0.5
    )
    share = max(pixels / abs(np.linalg.det(lattice.basis)), fewest) / max(int(lit.sum()), 1)
    chosen = np.flatnonzero(lit)[sample_mask(int(lit.sum()), share)]
    offset = tones.offsets[crop[chosen]]
    half = int(np.ceil(margin)) + 1
    place = np.rint(centres[chosen] - offset).astype(np.int64)
    windows = sliding_window_view(np.pad(tones.picture, half, "edge"), (2 * half + 1, 2 * half + 1))
    light = windows[place[:, 1], place[:, 0]] ** 2
    core = slice(half - core_reach(cell), half + core_reach(cell) + 1)
    gain = light[:, core, core].mean((1, 2)).astype(float)
    bright = is_lit(gain, UNLIT)
    if bright.sum() < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {bright.sum()} whole microimages of {lattice.pitch:.1f} px pitch are lit on the "
            f"flat, at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    centres = centres[chosen][bright]
    field = lattice.field_place(centres)
    slope = fit_light_slope(gain[bright], field, lattice.reach)
    lenses = Lenses(
        indices[chosen][bright],
        light[bright],
        (place - half + offset)[bright],
        centres,
        field,
        lattice.reach,
        gain[bright],
        slope,
        np.zeros_like(slope),
        cell,
        clipping_level(light),
    )
    return lenses.learn_shade(lattice)


def core_reach(cell: Cell) -> int:
    """[px] half the side of the square in the middle of a cell that the light is measured in."""
    return max(1, int(_CORE * cell.inradius))


def _fit_shade(slopes: Floats, weight: Floats, centres: Floats, lattice: Lattice) -> Floats:
    """Slope (3, 2) of the light of lenses without that of their neighbours, over the field.

    It is linear in the position [px], and 0 on an axis that may lie beside the middle of the flat;
    zeros if it is not significant.

    `slopes` (n, 2) [1/px] are those of the light within single microimages beyond that of the
    gains.
    """
    far = centres - (np.array(lattice.image_size) - 1) / 2
    root = np.sqrt(weight)[:, None]
    table = np.zeros((len(far), 2, 3))
    table[:, 0, 0] = table[:, 1, 1] = 1
    table[:, :, 2] = far
    keep = np.repeat(weight[:, None] > 0, 2, axis=1)
    for _ in range(3):
        if keep.sum() < 12:
            return np.zeros((3, 2))
        used = table * (root * keep)[..., None]
        normal = np.einsum("nap,naq->pq", used, used)
        found = np.linalg.pinv(normal) @ np.einsum("nap,na->p", used, slopes * root)
        miss = np.abs(slopes - table @ found) * root
        keep = (weight[:, None] > 0) & (miss < 4 * np.median(miss[weight > 0]) + 1e-12)
    variance = float((miss[keep] ** 2).mean())
    if found @ normal @ found < SIGNIFICANT**2 * variance:
        return np.zeros((3, 2))
    middle = (np.array(lattice.image_size) - 1) / 2
    return np.vstack([found[:2] - found[2] * middle, found[2] * np.eye(2)])


def measure_centroid_offset(lenses: Lenses) -> float:
    """Distance [px] of plain centroids from the centres in the middle of the field.

    It is 0 if there are too few microimages.

    What grows with the field is left out: a disc that cuts microimages moves their centroids.
    """
    near = np.flatnonzero(np.hypot(*lenses.field.T) < 0.25)
    near = near[evenly(len(near), _CENTROID_LENSES)]
    if len(near) < 12:
        return 0.0
    x, y = lenses.places()
    x = x[near]
    y = y[near]
    light = lenses.light[near]
    field = lenses.field[near]
    window = np.clip(lenses.cell.inradius + 0.5 - np.hypot(x, y), 0, 1)
    light = window * np.clip(light - np.quantile(light, 0.05, axis=(1, 2))[:, None, None], 0, None)
    total = np.maximum(light.sum((1, 2)), 1e-30)
    offset = np.column_stack([(light * way).sum((1, 2)) / total for way in (x, y)])
    field = field - field.mean(0)
    growth = ((offset - np.median(offset, axis=0)) * field).sum() / max(
        float((field**2).sum()), 1e-30
    )
    return float(np.hypot(*np.median(offset - growth * field, axis=0)))
