"""Whole microimages, compared with one profile over the distance from the centre."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..lattice.lattice import Lattice
from ..microimage.average import average_profile, estimate_variance
from ..microimage.fit import Step, Sums
from ..runtime.arrays import ENOUGH_PIXELS, Booleans, Floats
from ..runtime.errors import CalibrationError
from .kernel import Rings, Windows, add_lenses
from .lenses import Lenses, core_reach

__all__ = ["Microimages", "compare_pixels"]

# [px] between rings of the profile: edges of discs are about 1 px wide.
_RING_STEP = 0.125
# Parts of the lenses that are summed in parallel: a fixed number, so that sums do not depend on
# that of the threads.
_CHUNKS = 64
# Stiffness of the profile over the median weight of a ring. It decides only where all lenses lie
# alike to the pixels.
_STIFFNESS = 0.3
# Share of the median weight that a ring needs to have a harmonic.
_FEW = 0.01


@dataclass(frozen=True)
class Microimages(Lenses):
    """Lenses and their common profile of `r` rings."""

    profile: Floats  # (r,) light at radii `0, step, 2*step...`
    harmonic: Floats  # (r,) amplitude of `cos(4 * direction)`
    ring_weight: Floats  # (r,) inverse variance of a pixel

    @classmethod
    def of(cls, lenses: Lenses, known: Microimages | None = None) -> Microimages:
        """Lenses with the profile and the weights of `known` ones, or else with their mean profile."""
        rings = int(lenses.cell.circumradius / _RING_STEP) + 3
        if known is None:
            profile = _mean_profile(lenses, rings)
            weight = np.full(rings, 1 / max(float(np.var(profile)), 1e-12))
            found = cls(**lenses.given, profile=profile, harmonic=0 * profile, ring_weight=weight)
            return found.learn_profile(found.sums())
        profile, harmonic, ring_weight = (
            np.pad(values, (0, max(rings - len(values), 0)), mode="edge")[:rings]
            for values in (known.profile, known.harmonic, known.ring_weight)
        )
        near = np.arange(-core_reach(lenses.cell), core_reach(lenses.cell) + 1)
        far = np.hypot(near, near[:, None])
        of_core = np.interp(far, np.arange(rings) * _RING_STEP, profile).mean()
        lenses = replace(lenses, gain=lenses.gain / of_core)
        return cls(**lenses.given, profile=profile, harmonic=harmonic, ring_weight=ring_weight)

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

    def learn(self, sums: Sums, step: Step, lattice: Lattice) -> Microimages:
        """The microimages with gains, profile, weights and slopes that fit the pixels better."""
        return self.learn_profile(sums).learn_levels(step.gains(sums), lattice)

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


def _mean_profile(lenses: Lenses, rings: int) -> Floats:
    """(r,) mean radial profile of the lenses."""
    some = lenses.thin(ENOUGH_PIXELS)
    x, y = some.places()
    inside = some.in_cells()
    ring = np.rint(np.hypot(x, y)[inside] / _RING_STEP).astype(int)
    light = some.even()[inside]
    total, number = (np.bincount(ring, of, rings) for of in (light, None))
    return average_profile(total, number)


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
    shade_x, shade_y = lenses.shade.T[..., None, None]
    model = level + own * (shade_x * x + shade_y * y) + harmonic * (1 - 8 * (x * y / far**2) ** 2)
    return (
        lenses.even() - model,
        (lenses.light < saturation) & lenses.in_cells(),
        np.stack([slope, weight]),
    )
