"""Two discs whose overlap is lit: a lens and the disc that cuts it.

Both discs are displaced in proportion to the position in the field, and by one radial distortion.
Each has a radius, a blur of its edge and a shading about its centre. Where their edges run alike
they may be blurred together or one by one (`disc_light`). Neighbours add their light, and each lens
has a gain of its own. The model is the same with the two discs interchanged: `choose_lens` decides
which of them is the lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..gain.gain_map import fit_light_slope
from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import LatticeFit
from ..lattice.standard_errors import LatticeErrors, Residuals
from ..runtime.arrays import Floats, Integers
from .disc_light import (
    BEND,
    CORRELATION,
    COUNT,
    GROWTH,
    LOG_BLUR,
    OFFSET,
    RADIUS,
    SHADING,
    SHEAR,
    evaluate,
)
from .microimages import Microimages

__all__ = ["DiscPixels", "TwoDiscs", "choose_lens", "choose_pixels", "correct_slope"]

_STEPS = np.array([(i, j) for j in (-1, 0, 1) for i in (-1, 0, 1) if (i, j) != (0, 0)])
# Share of the pixels away from the edges that is used.
_BESIDE_EDGES = 0.1
# Least gain of a lens over that without a cut.
_LEAST_GAIN = 1e-3
# Step of numerical derivatives, in the units of the parameters.
_STEP = 1e-3
# Relative error of the blur that both edges share: no model is more exact.
_MODEL_FAULT = 0.02
# [px] Centres with a larger standard error are doubtful.
_MOST_ERROR = 0.03
# [standard errors] by which radii or shadings differ for sure.
_SURE = 2.5
# Errors of the model of the edges: of the radii over the blur, of the shadings over its square.
_RADIUS_FAULT = 0.05
_SHADING_FAULT = 0.3


@dataclass(frozen=True)
class DiscPixels:
    """Pixels of some lenses, those of a lens side by side."""

    rows: Integers  # (lenses,) of `Microimages`: those that have pixels
    place: Floats  # (n, 2) [px] relative to the centre on the lattice
    lens: Integers  # (n,) number of the lens
    light: Floats  # (n,) over the gain of the lens
    field: Floats  # (lenses, 2)
    steps: Floats  # (8, 2) [px] to neighbours
    scale: float  # [px] about the radius of the discs
    reach: float  # [px] half the diagonal of the flat

    def compare(self, p: Floats, weight: Floats) -> tuple[Floats, Floats, Floats]:
        """Residuals (n,), their negative derivatives (n, 19), and gains (lenses,).

        The gains are eliminated from the derivatives.
        """
        model = np.empty(len(self.lens))
        table = np.empty((len(self.lens), COUNT))
        evaluate(
            self.place, self.lens, self.field, self.steps, p, self.scale, self.reach, model, table
        )
        first = np.searchsorted(self.lens, np.arange(len(self.field)))
        weighted = weight * model
        square = np.add.reduceat(weighted * model, first) + 1e-12
        gain = np.add.reduceat(weighted * self.light, first) / square
        with_gain = np.add.reduceat(weighted[:, None] * table, first) / square[:, None]
        table -= model[:, None] * with_gain[self.lens]
        table *= gain[self.lens, None]
        return self.light - gain[self.lens] * model, table, gain


@dataclass(frozen=True)
class TwoDiscs:
    """A lens (first) and the disc that cuts it (second), relative to their `lattice`.

    This is the lattice that they were fitted on.
    """

    lattice: Lattice
    parameters: Floats  # (19,) of `disc_light`
    covariance: Floats  # (19, 19)
    scale: float  # [px] about the radius of both
    indices: Integers  # (n, 2) of the lenses
    offsets: Floats  # (n, 2) [px] of single lenses from the common fit
    halves: Floats  # (19,) difference between the fits of two halves of the lenses
    doubt: str | None = None  # why the second disc may be the lens

    @property
    def radius(self) -> Floats:
        """(2,) radii [px]."""
        return self.parameters[RADIUS]

    @property
    def blur(self) -> Floats:
        """(2,) standard deviation of the edges [px]."""
        return np.exp(self.parameters[LOG_BLUR])

    @property
    def cut(self) -> Floats:
        """(5,) the second disc, relative to the first, as `GainMap.cut`."""
        own, other = self.parameters[OFFSET].reshape(2, 2)
        growth = np.diff(self.parameters[GROWTH])
        return np.array([*(other - own), *growth, self.radius[1], self.blur[1]])

    @property
    def depth(self) -> float:
        """How far the second disc reaches into the first one in the corners of the field [px]."""
        return float(self.radius[0] + abs(self.cut[2]) - self.radius[1])

    def interchanged(self) -> TwoDiscs:
        """With the other disc as the lens."""
        order = np.arange(COUNT)
        order[OFFSET] = np.roll(order[OFFSET], 2)
        for pair in (GROWTH, RADIUS, LOG_BLUR, SHADING):
            order[pair] = order[pair][::-1]
        covariance = self.covariance[np.ix_(order, order)]
        return replace(
            self,
            parameters=self.parameters[order],
            covariance=covariance,
            halves=self.halves[order],
        )

    def difference(self, pair: slice, fault: float) -> float:
        """Second minus first value of a pair of parameters, in standard errors.

        `fault` is the error of the model.
        """
        one, two = range(COUNT)[pair]
        variance = (
            self.covariance[one, one] + self.covariance[two, two] - 2 * self.covariance[one, two]
        )
        return float(self.parameters[two] - self.parameters[one]) / math.hypot(
            math.sqrt(max(variance, 0.0)), fault
        )

    @cached_property
    def lens_lattice(self) -> Lattice:
        """The lattice of the first disc."""
        return _lattice_of(self.lattice, self.parameters)

    def summarise(self) -> LatticeFit:
        """The lattice of the first disc, its standard errors, and what is doubtful about it.

        No model of the blur that both edges share is exact to two per cent.
        """
        shared = self.covariance[:, CORRELATION]
        fault = _MODEL_FAULT * shared / max(float(shared[CORRELATION]), 1e-12)
        names, response = self._respond()
        covariance = response @ (self.covariance + np.outer(fault, fault)) @ response.T
        halves = response @ self.halves
        errors, differences = (
            LatticeErrors(names, table) for table in (covariance, np.outer(halves, halves))
        )
        error, half_difference = (
            float(np.sqrt((one.of_centres(self.lens_lattice) ** 2).mean()))
            for one in (errors, differences)
        )
        doubt = self.doubt
        if error > _MOST_ERROR and doubt is None:
            doubt = (
                "microimages are the overlap of two discs with soft edges "
                f"({self.blur[0]:.2f} px): their centres are known to {error:.2f} px only; close "
                "the aperture of the main lens for a white image without vignetting"
            )
        distance = np.hypot(*self.offsets.T)
        near = distance[distance < 5 * np.median(distance)]
        return LatticeFit(
            self.lens_lattice,
            float(np.sqrt((near**2).mean())),
            len(near),
            half_difference,
            errors,
            Residuals(self.indices.astype(np.int32), self.offsets.astype(np.float32)),
            self.cut,
            doubt=doubt,
        )

    def residuals(self, lenses: Microimages) -> Floats:
        """Residuals (m,) of the unclipped pixels in the cells of lenses on `lattice`.

        They are divided by the gains without a cut.
        """
        slope = lenses.slope
        for _ in range(2):
            pixels = choose_pixels(lenses, slope, self.lattice, lenses.light.size)
            residual, _, gain = pixels.compare(self.parameters, np.ones(len(pixels.light)))
            gains = lenses.gain * np.maximum(gain, _LEAST_GAIN)
            slope = fit_light_slope(gains, lenses.field, lenses.reach)
        return residual * max(float(lenses.profile[0]), 1e-9)

    def _respond(self) -> tuple[tuple[str, ...], Floats]:
        """Names of the lattice parameters, and derivative (p, 19) with those of the discs.

        They are linear in the parameters of the first disc.
        """
        names: tuple[str, ...] = ("origin", "origin", "a1", "a1", "a2", "a2")
        if self.covariance[BEND, BEND] > 0:
            names = (*names, "k1")
        here = self.lens_lattice
        moved = []
        for step in _STEP * np.eye(COUNT):
            other = _lattice_of(self.lattice, self.parameters + step)
            change = [*(other.origin - here.origin), *(other.basis - here.basis).ravel()]
            if other.distortion and here.distortion and "k1" in names:
                change.append(other.distortion.k1 - here.distortion.k1)
            moved.append(np.array(change) / _STEP)
        return names, np.array(moved).T


def _lattice_of(lattice: Lattice, p: Floats) -> Lattice:
    """The lattice of the first of two discs, displaced from a lattice by the parameters."""
    middle = (np.array(lattice.image_size) - 1) / 2
    reach = lattice.reach
    bend = lattice.distortion
    own = p[GROWTH][0]
    if p[BEND]:
        bend = bend or Distortion.zero(lattice.image_size)
        bend = replace(bend, k1=bend.k1 + p[BEND] / reach)
        # A `Distortion` leaves to the basis what a straight lattice can follow.
        own = own + 0.5 * p[BEND]
    stretched, sheared, turned = p[SHEAR]
    scale = (
        np.eye(2)
        + np.array([[own + stretched, sheared + turned], [sheared - turned, own - stretched]])
        / reach
    )
    origin = middle + (lattice.origin - middle) @ scale + p[OFFSET][:2]
    return replace(lattice, origin=origin, basis=lattice.basis @ scale, distortion=bend)


def choose_pixels(
    lenses: Microimages, slope: Floats, lattice: Lattice, number: int, known: Floats | None = None
) -> DiscPixels:
    """Choose at most `number` unclipped pixels in the cells of the lenses.

    If the discs are `known`, most of the pixels are near their edges.
    """
    rng = np.random.default_rng(0)
    # Most of those beside the edges are left out in the end.
    drawn = np.flatnonzero(
        rng.random(lenses.light.size) < (3 if known is None else 10) * number / lenses.light.size
    )
    lens, y, x = np.unravel_index(drawn, lenses.light.shape)
    place = np.column_stack([x, y]) + (lenses.corners - lenses.centres)[lens]
    light = lenses.light.ravel()[drawn].astype(np.float64)
    keep = (light < lenses.saturation) & (place @ lenses.cell.normals.T <= 0.5).all(1)
    lens = lens[keep]
    place = place[keep]
    light = light[keep]
    chance = np.ones(len(light))
    if known is not None:
        depth = [
            known[RADIUS][k]
            - np.hypot(
                *(
                    place - known[OFFSET][2 * k : 2 * k + 2] - known[GROWTH][k] * lenses.field[lens]
                ).T
            )
            for k in (0, 1)
        ]
        chance[np.min(np.abs(depth), axis=0) > 3 * math.exp(float(known[LOG_BLUR].max()))] = (
            _BESIDE_EDGES
        )
    taken = rng.random(len(light)) < chance * (number / chance.sum())
    lens = lens[taken]
    place = place[taken]
    light = light[taken]
    light /= (
        lenses.gain[lens] * (1 + (slope[lens] * place).sum(1)) * max(float(lenses.profile[0]), 1e-9)
    )
    rows, lens = np.unique(lens, return_inverse=True)
    field = lenses.field[rows]
    steps = _STEPS @ lattice.basis
    return DiscPixels(rows, place, lens, light, field, steps, lenses.radius, lenses.reach)


def correct_slope(lenses: Microimages, slope: Floats, pixels: DiscPixels, gain: Floats) -> Floats:
    """Slope (n, 2) [1/px] of the light with the gains of cut microimages.

    These had been fitted without a cut, and the slope with them.
    """
    rows = pixels.rows
    gains = lenses.gain[rows] * np.maximum(gain, _LEAST_GAIN)
    corrected = slope.copy()
    corrected[rows] = fit_light_slope(gains, lenses.field[rows], lenses.reach)
    return corrected


def choose_lens(discs: TwoDiscs) -> TwoDiscs:
    """The discs with that one first which is the lens, and the doubt about it.

    The lens is whole in the middle of the field, where the other disc must not show: it is the
    smaller one. Shading is centred on the lens. Radii are compared if they differ beyond `_SURE`
    standard errors, else shadings; what is left of an error of the model of the edges grows with
    their blur.
    """
    blur = float(discs.blur.mean())
    smaller = discs.difference(RADIUS, _RADIUS_FAULT * blur)
    shaded = -discs.difference(SHADING, _SHADING_FAULT * (blur / discs.scale) ** 2)
    sign = smaller if abs(smaller) > _SURE else smaller + shaded
    chosen = discs if sign >= 0 else discs.interchanged()
    clash = min(abs(smaller), abs(shaded)) > _SURE and smaller * shaded < 0
    if abs(sign) > _SURE and not clash:
        return chosen
    return replace(chosen, doubt=_state_doubt(chosen, clash))


def _state_doubt(discs: TwoDiscs, clash: bool) -> str:
    apart = abs(discs.cut[2])
    why = "they are alike"
    if clash:
        why = "the smaller one is not the one that its shading is centred on"
    return (
        f"microimages are the overlap of two discs of {discs.radius[0]:.2f} and "
        f"{discs.radius[1]:.2f} px radius, and {why}: the first is taken for the lens; if the "
        f"other is, centres lie up to {apart:.2f} px off in the corners (a scale of the lattice, "
        "and a constant in the disparity); close the aperture of the main lens for a white image "
        "without vignetting"
    )
