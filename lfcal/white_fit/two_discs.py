"""Two discs whose overlap is lit: a lens and the disc that cuts it.

The second disc is displaced from the lens in proportion to the position in the field. Each disc has
a radius, a blur of its edge and a shading about its centre. Where their edges run alike they may be
blurred together or one by one (`disc_light`). Neighbours add their light, and each lens has a gain
of its own. The model is the same with the two discs interchanged: `choose_lens` decides which of
them is the lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..lattice.lattice import Lattice
from ..microimage.fit import Step, Sums
from ..runtime.arrays import Floats, Integers
from .disc_light import BLUR, CORRELATION, COUNT, CUT, RADIUS, SHADING, TAIL, evaluate
from .lenses import Lenses
from .pixel_sums import Comparison

__all__ = ["LEAST_BLUR", "CutMicroimages", "choose_lens", "displace", "interchange"]

_STEPS = np.array([(i, j) for j in (-1, 0, 1) for i in (-1, 0, 1) if (i, j) != (0, 0)])
# Share of the pixels away from the edges that is used.
_BESIDE_EDGES = 0.1
# Logarithm of the blur of one disc over the other, beyond which more counts no further.
_DIFFERENT = 0.1
# Largest step of a parameter, over its standard deviation.
_LARGEST_STEP = 0.3
#: [px] Pixels of finite size blur every edge by this at least.
LEAST_BLUR = 0.2
# Least and largest radii, over the radius of whole microimages.
_RADII = (0.3, 2)
# Tails: uniform discs and squares have 0.05, normal blur 0, longer tails less.
_TAILS = (-0.03, 0.06)
_MOST_CORRELATION = 0.98
# [standard errors] by which radii or shadings differ for sure.
_SURE = 2.5
# Errors of the model of the edges: of the radii over the blur, of the shadings over its square.
_RADIUS_FAULT = 0.05
_SHADING_FAULT = 0.5


@dataclass(frozen=True)
class CutMicroimages(Lenses):
    """Microimages that are the overlap of two discs: the lens (first) and the disc that cuts it."""

    used: Integers  # (m,) pixels that are used, by their place in `light`
    steps: Floats  # (8, 2) [px] to neighbours
    scale: float  # [px] about the radius of both
    expected: Floats  # (12,) of `shape`
    spread: Floats  # (12,) standard deviations of the shape from that
    shape: Floats  # (12,) parameters of `disc_light`
    soft: bool = False  # outliers keep some weight, as at the start of a fit

    def at(self, lattice: Lattice) -> CutMicroimages:
        """The same with the centres of a lattice, and of neighbours."""
        return replace(super().at(lattice), steps=_STEPS @ lattice.basis)

    @property
    def radius(self) -> Floats:
        """(2,) radii [px]."""
        return self.shape[RADIUS]

    @property
    def blur(self) -> Floats:
        """(2,) standard deviation of the edges [px]."""
        return np.exp(np.cumsum(self.shape[BLUR]))

    @property
    def cut(self) -> Floats:
        """(5,) the second disc, relative to the first, as `GainMap.cut`."""
        return np.array([*self.shape[CUT], self.radius[1], self.blur[1]])

    @property
    def depth(self) -> float:
        """How far the second disc reaches into the first one in the corners of the field [px]."""
        return float(self.radius[0] + abs(self.cut[2]) - self.radius[1])

    @property
    def parameters(self) -> Floats:
        """As `LightModel.parameters`."""
        return self.shape

    @property
    def prior(self) -> tuple[Floats, Floats]:
        """As `LightModel.prior`."""
        spread = self.spread.copy()
        if self.soft:
            spread[[TAIL, CORRELATION]] = 1e-3
        # Blurs are alike, or else they differ.
        spread[BLUR][1] *= 1 + (self.shape[BLUR][1] / _DIFFERENT) ** 2
        known = spread**-2
        return known, known * (self.expected - self.shape)

    def compare(self) -> Comparison:
        """The used pixels against the model."""
        lens, y, x = np.unravel_index(self.used, self.light.shape)
        place = np.column_stack([x, y]) + (self.corners - self.centres)[lens]
        tilt = 1 + (self.slope[lens] * place).sum(1)
        light = self.light.ravel()[self.used] / (self.gain[lens] * tilt)
        table = np.empty((len(lens), 3 + COUNT))
        evaluate(place, lens, self.field, self.steps, self.shape, self.scale, self.reach, table)
        return Comparison(lens, light - table[:, -1], table)

    def residuals(self) -> Floats:
        """(m,) differences of the used pixels from the model."""
        return self.compare().residual

    def sums(self) -> Sums:
        """Normal equations about this model."""
        return self.compare().sums(len(self.centres), self.soft)

    def learn(self, sums: Sums, step: Step, lattice: Lattice) -> CutMicroimages:
        """The microimages on a lattice, with gains and a shape that fit the pixels better."""
        limit = _LARGEST_STEP * self.spread
        limit[BLUR] = _LARGEST_STEP
        shape = self.bounded(self.shape + np.clip(step.of_light, -limit, limit))
        return replace(self.learn_levels(step.gains(sums), lattice), shape=shape)

    def bounded(self, shape: Floats) -> Floats:
        """The shape (12,) within its bounds."""
        shape = shape.copy()
        shape[RADIUS] = np.clip(shape[RADIUS] / self.scale, *_RADII) * self.scale
        shape[BLUR][0] = max(shape[BLUR][0], math.log(LEAST_BLUR))
        shape[TAIL] = np.clip(shape[TAIL], *_TAILS)
        shape[CORRELATION] = np.clip(shape[CORRELATION], 0, _MOST_CORRELATION)
        return shape

    def draw(self, number: float, near_edges: bool = False) -> CutMicroimages:
        """The microimages with about `number` unclipped pixels in their cells, drawn at random.

        With `near_edges`, most of the pixels are near the edges of the discs.
        """
        rng = np.random.default_rng(0)
        chance = (self.in_cells() & (self.light < self.saturation)).astype(np.float32)
        if near_edges:
            x, y = self.places()
            depth = np.full(self.light.shape, np.inf)
            for disc, radius in enumerate(self.radius):
                cut = disc * (self.shape[CUT][:2] + self.shape[CUT][2] * self.field)
                far = np.hypot(x - cut[:, 0, None, None], y - cut[:, 1, None, None])
                depth = np.minimum(depth, np.abs(far - radius))
            chance[depth > 3 * self.blur.max()] *= _BESIDE_EDGES
        chance *= number / chance.sum()
        used = np.flatnonzero(rng.random(self.light.shape, np.float32) < chance)
        return replace(self, used=used)


def displace(lattice: Lattice, displacement: Floats) -> Lattice:
    """The lattice displaced like a second disc (3,): x, y in the middle, growth to the corners [px]."""
    middle = (np.array(lattice.image_size) - 1) / 2
    grown = 1 + displacement[2] / lattice.reach
    origin = middle + (lattice.origin - middle) * grown + displacement[:2]
    return replace(lattice, origin=origin, basis=lattice.basis * grown)


def interchange(lattice: Lattice, lenses: CutMicroimages) -> tuple[Lattice, CutMicroimages]:
    """The lattice and the lenses with the other disc as the lens."""
    other = displace(lattice, lenses.shape[CUT])
    order = np.arange(COUNT)
    for pair in (RADIUS, SHADING):
        order[pair] = order[pair][::-1]
    shape = lenses.shape[order]
    shape[CUT] *= -1
    shape[BLUR] = shape[BLUR].sum(), -shape[BLUR][1]
    return other, replace(
        lenses, shape=shape, expected=lenses.expected[order], spread=lenses.spread[order]
    ).at(other)


def choose_lens(discs: CutMicroimages, covariance: Floats) -> tuple[bool, str | None]:
    """Whether the first disc is the lens, and the doubt about it.

    `covariance` (12, 12) is that of the shape.

    The lens is whole in the middle of the field, where the other disc must not show: it is the
    smaller one. Shading is centred on the lens. Radii are compared if they differ beyond `_SURE`
    standard errors, else shadings; what is left of an error of the model of the edges grows with
    their blur.
    """
    blur = float(discs.blur.mean())
    faults = (_RADIUS_FAULT * blur, _SHADING_FAULT * (blur / discs.scale) ** 2)
    smaller, shaded = (
        np.diff(discs.shape[pair])[0]
        / math.hypot(fault, math.sqrt([-1, 1] @ covariance[pair, pair] @ [-1, 1]))
        for pair, fault in zip((RADIUS, SHADING), faults, strict=True)
    )
    sign = smaller if abs(smaller) > _SURE else smaller - shaded
    clash = min(abs(smaller), abs(shaded)) > _SURE and smaller * shaded > 0
    if abs(sign) > _SURE and not clash:
        return sign >= 0, None
    lens, other = np.roll(discs.radius, sign < 0)
    why = "they are alike"
    if clash:
        why = "the smaller one is not the one that its shading is centred on"
    return (
        sign >= 0,
        f"microimages are the overlap of two discs of {lens:.2f} and {other:.2f} px radius, and "
        f"{why}: the first is taken for the lens; if the other is, centres lie up to "
        f"{abs(discs.cut[2]):.2f} px off in the corners (a scale of the lattice, and a constant in "
        "the disparity); close the aperture of the main lens for a white image without vignetting",
    )
