"""Microimages of some lenses of a white image, and the model that they are compared with.

A pixel sees the exit pupil of the main lens through its microlens. Light falls off with the angle
of its rays, that is about the point below the microlens, which lies the farther from the centre of
the microimage the farther out in the field it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..gain.gain_map import fit_light_slope
from ..images.stack import clipping_level
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_mask
from ..lattice.robust_fit import SIGNIFICANT
from ..microimage.average import average_profile, estimate_variance
from ..microimage.lit import UNLIT, find_lit_lenses, is_lit
from ..runtime.arrays import ENOUGH_PIXELS, Booleans, Floats, Integers, Singles, evenly
from ..runtime.errors import CalibrationError
from .kernel import Rings, Sums, Windows, add_lenses

__all__ = [
    "Microimages",
    "cut_out",
    "measure_centroid_offset",
    "measure_narrowing",
]

_FEWEST_LENSES = 12
# [px] between rings of the profile: edges of discs are about 1 px wide.
_RING_STEP = 0.125
# Parts of the lenses that are summed in parallel: a fixed number, so that sums do not depend on
# that of the threads.
_CHUNKS = 64
# Stiffness of the profile over the median weight of a ring. It decides only where all lenses lie
# alike to the pixels.
_STIFFNESS = 0.3
# [inradius] Disc in which the slope of the light is measured: edges are far, and cuts are rare.
_INNER = 0.6
# Side of the square in the middle that the light is measured in, over the diameter.
_CORE = 0.4
# Share of the median weight that a ring needs to have a harmonic.
_FEW = 0.01
# Pixels that a slope is measured on.
_SLOPE_PIXELS = 2e5
# Lenses that centroids are measured on.
_CENTROID_LENSES = 300
# Least slope of the profile, over the steepest one, of pixels that locate an edge.
_STEEP = 0.1


@dataclass(frozen=True)
class Microimages:
    """Windows of the flat around `n` lenses, and their model: a profile of `r` rings."""

    indices: Integers  # (n, 2) of the lattice
    light: Singles  # (n, k, k) squares of the flat around the lenses
    corners: Integers  # (n, 2) [px] flat coordinates of the first pixel of each
    centres: Floats  # (n, 2) [px]
    field: Floats  # (n, 2) places of the centres in the field
    reach: float  # [px] unit of `field`
    gain: Floats  # (n,) light of each lens over that of the profile
    slope: Floats  # (n, 2) [1/px] relative change of the gain within the microimage
    shade: Floats  # (n, 2) [1/px] slope of the gain without the light of the neighbours
    cell: Cell
    profile: Floats  # (r,) light at radii `0, step, 2*step...`
    harmonic: Floats  # (r,) amplitude of `cos(4 * direction)`
    ring_weight: Floats  # (r,) inverse variance of a pixel
    saturation: float  # least light of clipped pixels

    @property
    def pixels(self) -> float:
        """Pixels in the cells of all lenses, about."""
        return len(self.centres) * np.pi * self.cell.inradius * self.cell.circumradius

    @property
    def windows(self) -> Windows:
        """What kernels read of each lens."""
        return Windows(self.light, self.corners, self.centres, self.gain, self.slope, self.shade)

    @property
    def core(self) -> float:
        """Light in the middle of a microimage."""
        return float(np.median(self.profile[: max(2, len(self.profile) // 2)]))

    @property
    def radius(self) -> float:
        """Distance from the centre [px] at which the profile falls half-way to the gap.

        Half-way is the mean of the light in the middle and in the gap.
        """
        half = 0.5 * (self.core + max(float(self.profile[-3:].min()), 0.0))
        return max(int(np.argmax(self.profile < half)), 1) * _RING_STEP

    @property
    def rings(self) -> Rings:
        """What all lenses share, for kernels."""
        # Half of the light at the border of the cell is that of a neighbour. Between the middle of
        # a side of the cell, where nothing is left of the slope, and its corners, where something
        # is.
        border = self.cell.inradius + (self.cell.circumradius - self.cell.inradius) / 6
        border = float(np.interp(border / _RING_STEP, np.arange(len(self.profile)), self.profile))
        own = self.core * np.clip(
            (self.profile - border) / max(self.core - border, 1e-9 * self.core), 0, None
        )
        slope = np.gradient(self.profile, _RING_STEP)
        table = np.column_stack([self.profile, slope, self.ring_weight, own, self.harmonic])
        return Rings(_RING_STEP, table, self.saturation)

    def at(self, lattice: Lattice) -> Microimages:
        """The same with the centres of a lattice."""
        centres = lattice.points(self.indices)
        return replace(self, centres=centres, field=lattice.field_place(centres))

    def thin(self, pixels: float) -> Microimages:
        """An even part of the lenses, with at most so many pixels in their windows."""
        return self.select(slice(None, None, max(1, int(self.light.size / pixels) + 1)))

    def select(self, rows: slice | Integers) -> Microimages:
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

    def residuals(self) -> Floats:
        """(m,) differences of the unclipped pixels in the cells from the model, over the gains."""
        residual, inside, _ = compare_pixels(self)
        return residual[inside]

    def sums(self) -> Sums:
        """Normal equations about this model.

        CalibrationError if the model is not finite or explains nothing.
        """
        values = (self.centres, self.gain, self.slope, self.shade, self.profile, self.ring_weight)
        if not all(np.isfinite(value).all() for value in values):
            raise CalibrationError(
                "the microimages show no edges; give a sharper flat or a white image"
            )
        count = len(self.centres)
        band = np.zeros((_CHUNKS, len(self.profile), 6))
        sums = Sums(np.zeros((count, 3, 3)), np.zeros((count, 3)), band)
        add_lenses(self.windows, self.cell, self.rings, sums)
        if not (sums.normal[:, 0, 0] > 0).any():
            raise CalibrationError(
                "the microimages show no edges; give a sharper flat or a white image"
            )
        return sums

    def learn(self, sums: Sums, moved: Floats, lattice: Lattice) -> Microimages:
        """Gains, profile, weights and slopes that fit the pixels better.

        `sums` are those about this model, `moved` (n, 2) [px] is the step of the centres to those
        of `lattice`.
        """
        explained = (sums.normal[:, :2, 2] * moved).sum(1)
        gain = (sums.right[:, 2] - explained) / np.maximum(sums.normal[:, 2, 2], 1e-30)
        lenses = replace(self, gain=self.gain * (1 + np.clip(gain, -0.5, 1))).learn_profile(sums)
        lenses = lenses.at(lattice)
        slope = fit_light_slope(lenses.gain, lenses.field, lenses.reach)
        lenses = replace(lenses, slope=slope)
        return replace(lenses, shade=lenses.measure_shade(lattice))

    def learn_profile(self, sums: Sums) -> Microimages:
        """The microimages with profile, harmonic and ring weights that fit the pixels better."""
        weight, force, turned, own, squares, number = sums.band.sum(0).T
        # Rings that hardly a pixel fell into follow their neighbours. Where all lenses lie alike to
        # the pixels, only the smoothness of the profile determines where between two pixels an edge
        # is.
        bend = np.diff(np.eye(len(weight)), 2, axis=0)
        stiff = _STIFFNESS * float(np.median(weight[weight > 0])) * bend.T @ bend
        settled = np.diag(weight + 1e-9 * weight.max())
        profile = self.profile + np.linalg.solve(settled + stiff, force - stiff @ self.profile)
        # Gains and profile share one scale.
        profile *= np.linalg.norm(self.profile) / np.linalg.norm(profile)
        variance = estimate_variance(squares, number)
        floor = 1e-6 * float(np.var(profile)) + 1e-12
        return replace(
            self,
            profile=profile,
            harmonic=self.harmonic + turned / (own + _FEW * np.median(weight) + 1e-30),
            ring_weight=1 / np.maximum(variance, floor),
        )

    def measure_shade(self, lattice: Lattice) -> Floats:
        """Slope (n, 2) [1/px] of the light of each microimage without that of its neighbours.

        It is measured in the middles of some of the microimages, those that are not clipped.
        """
        some = self.thin(_SLOPE_PIXELS)
        x, y = some.places()
        inside = np.hypot(x, y) < _INNER * self.cell.inradius
        clipped = inside & (some.light >= some.saturation)
        inside = inside & ~clipped.any((1, 2), keepdims=True)
        model = (
            np.interp(np.hypot(x, y), np.arange(len(self.profile)) * _RING_STEP, self.profile)
            * inside
        )
        tilt = 1 + some.slope[:, 0, None, None] * x + some.slope[:, 1, None, None] * y
        miss = (some.light / some.gain[:, None, None] - model * tilt) * model
        square = 0.5 * (model**2 * (x**2 + y**2)).sum((1, 2))
        slopes = (
            np.column_stack([(miss * x).sum((1, 2)), (miss * y).sum((1, 2))])
            / np.maximum(square, 1e-30)[:, None]
        )
        field = _fit_shade(slopes, square, some.centres, lattice)
        return field[0] + self.centres @ field[1:]


def cut_out(
    tones: StackedCrops,
    lattice: Lattice,
    pixels: float,
    fewest: int,
    known: Microimages | None = None,
) -> Microimages:
    """Cut evenly spread lit lenses out of a flat.

    They have about this number of `pixels`, but there are at least `fewest` lenses.

    Profile and weights are those of `known` lenses, or the mean profile.
    """
    cell = Cell.of(lattice)
    margin = cell.circumradius + 2
    indices, centres, crop = tones.lenses(lattice, margin)
    lit = find_lit_lenses(
        tones.picture, lattice, indices, centres - tones.offsets[crop], UNLIT**0.5
    )
    share = max(pixels / abs(np.linalg.det(lattice.basis)), fewest) / max(int(lit.sum()), 1)
    chosen = np.flatnonzero(lit)[sample_mask(int(lit.sum()), share)]
    indices = indices[chosen]
    centres = centres[chosen]
    offset = tones.offsets[crop[chosen]]
    half = int(np.ceil(margin)) + 1
    place = np.rint(centres - offset).astype(np.int64)
    windows = sliding_window_view(np.pad(tones.picture, half, "edge"), (2 * half + 1, 2 * half + 1))
    light = windows[place[:, 1], place[:, 0]] ** 2
    corners = place - half
    middle = light.shape[1] // 2
    core = max(1, int(_CORE * cell.inradius))
    gain = (
        light[:, middle - core : middle + core + 1, middle - core : middle + core + 1]
        .mean((1, 2))
        .astype(float)
    )
    bright = is_lit(gain, UNLIT)
    if bright.sum() < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {bright.sum()} whole microimages of {lattice.pitch:.1f} px pitch are lit on the "
            f"flat, at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    indices = indices[bright]
    centres = centres[bright]
    gain = gain[bright]
    light = light[bright]
    corners = (corners + offset)[bright]
    field = lattice.field_place(centres)
    slope = fit_light_slope(gain, field, lattice.reach)
    rings = int(cell.circumradius / _RING_STEP) + 3
    saturation = clipping_level(light) if known is None else known.saturation
    lenses = Microimages(
        indices,
        light,
        corners,
        centres,
        field,
        lattice.reach,
        gain,
        slope,
        np.zeros_like(slope),
        cell,
        np.zeros(rings),
        np.zeros(rings),
        np.ones(rings),
        saturation,
    )
    if known is None:
        profile = _mean_profile(lenses)
        weight = np.full(rings, 1 / max(float(np.var(profile)), 1e-12))
        lenses = replace(lenses, profile=profile, ring_weight=weight)
        return lenses.learn_profile(lenses.sums())
    profile, harmonic, ring_weight = (
        np.pad(values, (0, max(rings - len(values), 0)), mode="edge")[:rings]
        for values in (known.profile, known.harmonic, known.ring_weight)
    )
    near = np.arange(-core, core + 1)
    of_core = np.interp(
        np.hypot(*np.meshgrid(near, near)), np.arange(rings) * _RING_STEP, profile
    ).mean()
    lenses = replace(
        lenses, profile=profile, harmonic=harmonic, ring_weight=ring_weight, gain=gain / of_core
    )
    return replace(lenses, shade=lenses.measure_shade(lattice))


def _mean_profile(lenses: Microimages) -> Floats:
    """(r,) mean radial profile of the lenses."""
    some = lenses.thin(ENOUGH_PIXELS)
    x, y = some.places()
    inside = some.in_cells()
    ring = np.rint(np.hypot(x, y)[inside] / _RING_STEP).astype(int)
    light = (some.light / some.gain[:, None, None])[inside]
    total, number = (np.bincount(ring, of, len(lenses.profile)) for of in (light, None))
    return average_profile(total, number)


def _fit_shade(slopes: Floats, weight: Floats, centres: Floats, lattice: Lattice) -> Floats:
    """Slope (3, 2) of the light of lenses without that of their neighbours, over the field.

    It is linear in the position [px]; zeros if it is not significant.

    `slopes` (n, 2) [1/px] are those of the light within single microimages beyond that of the
    gains. The slope grows linearly with the distance from an axis, which may lie beside the middle;
    zeros where that is not significant.
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


def compare_pixels(lenses: Microimages) -> tuple[Floats, Booleans, Floats]:
    """Pixels of windows against the model.

    Residuals (n, k, k) over the gains; which pixels lie in cells and are not clipped; and slope of
    the profile there [1/px] and weight, (2, n, k, k).
    """
    x, y = lenses.places()
    far = np.maximum(np.hypot(x, y), 1e-6)
    step, table, saturation = lenses.rings
    columns = [np.interp(far / step, np.arange(len(table)), column) for column in table.T]
    level, slope, weight, own, harmonic = columns
    (shade_x, shade_y), (slope_x, slope_y) = (
        lenses.shade.T[..., None, None],
        lenses.slope.T[..., None, None],
    )
    model = level + own * (shade_x * x + shade_y * y) + harmonic * (1 - 8 * (x * y / far**2) ** 2)
    tilt = 1 + slope_x * x + slope_y * y
    return (
        lenses.light / (lenses.gain[:, None, None] * tilt) - model,
        (lenses.light < saturation) & lenses.in_cells(),
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
    # Only the lenses in the corners may be cut: their pixels are no outliers.
    largest = SIGNIFICANT / np.sqrt(weight)
    residual = np.clip(residual, -largest, largest)
    used = inside & (far < few.cell.inradius)
    used &= np.abs(slope) > _STEEP * np.abs(few.rings.table[:, 1]).max()
    field = few.field[:, :, None, None]
    reach = np.maximum(np.hypot(field[:, 0], field[:, 1]), 1e-6)
    along = (field[:, 0] * x + field[:, 1] * y) / (reach * far)
    response = slope * reach * (2 * along**2 - 1)
    information = float((used * weight * response**2).sum())
    if information <= 0:
        return 0.0, np.inf
    return float((used * weight * response * residual).sum()) / information, information**-0.5


def measure_centroid_offset(lenses: Microimages) -> float:
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
