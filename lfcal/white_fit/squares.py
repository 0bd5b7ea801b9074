"""Microimages of square and rectangular cells with straight edges, and dark gaps between them.

The light of a pixel is the product of those between the two pairs of edges: a profile over the
distance from the centre cannot follow straight edges. Edges have the closed form of
`microimage.edge`, so that they are found between pixels also where all lenses lie alike to these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..lattice.lattice import Lattice
from ..microimage.edge import EdgeLight, blurred_edge
from ..microimage.fit import Step, Sums
from ..runtime.arrays import Floats
from .lenses import Lenses
from .pixel_sums import Comparison

__all__ = ["SquareMicroimages", "mean_residual"]

# Cosine of the angle between the sides of a cell up to which it is rectangular.
_RECTANGULAR = 0.05
# [px] Least blur: with less, hardly a pixel tells it.
_LEAST_BLUR = 0.1
# Difference of the gaps [px], blur [px] and stray light that are expected, and their standard
# deviations: they matter where all lenses lie alike to the pixels, which cannot tell a narrow gap
# from a brighter one.
_EXPECTED = np.array([0.0, 0.0, 0.3, 0.01])
_SPREADS = np.array([np.inf, 0.1, 0.3, 0.02])
# [px] The fit begins at this blur.
_START_BLUR = 1.0
# Change of half the distances of the edges with the gap and with the difference of the gaps.
_HALVES = np.array([[-0.5, -0.5], [-0.5, 0.5]])
# [px] Largest change of the gap and of the blur in a step.
_LARGEST_STEP = 0.3
# [px] Steps at which the light between edges is tabulated.
_STEP = 1 / 64
# [px] Pixels farther inside the edges tell nothing but the light of their lens.
_NEAR = 5.0


@dataclass(frozen=True)
class SquareMicroimages(Lenses):
    """Microimages whose light is a product of that between two pairs of edges."""

    sides: Floats  # (2, 2) unit vectors across the two pairs of edges
    widths: Floats  # (2,) [px] of the cell between them
    # (4,) mean gap between the cells, how much wider the first gap is than that, blur [px], and
    # stray light
    shape: Floats
    edge: Callable[..., EdgeLight] = blurred_edge

    @classmethod
    def of(cls, lenses: Lenses, lattice: Lattice) -> SquareMicroimages | None:
        """Microimages of a rectangular lattice with their mean shape; None on other lattices."""
        across = np.linalg.inv(lattice.basis).T
        widths = 1 / np.hypot(*across.T)
        sides = across * widths[:, None]
        if abs(float(sides[0] @ sides[1])) > _RECTANGULAR:
            return None
        own = lenses.at(lattice)
        # Of gaps without light, the mean light is the lit part of the cell.
        lit = float(own.even(shaded=True)[own.in_cells()].mean()) - _EXPECTED[-1]
        gap = widths.mean() * (1 - np.sqrt(np.clip(lit, 0.5, 1)))
        shape = np.array([gap, 0.0, _START_BLUR, _EXPECTED[-1]])
        return cls(**own.given, sides=sides, widths=widths, shape=shape)

    @property
    def halves(self) -> Floats:
        """(2,) half the distances of the pairs of edges [px]."""
        return self.widths / 2 + _HALVES @ self.shape[:2]

    @property
    def parameters(self) -> Floats:
        """As `LightModel.parameters`."""
        return self.shape

    @property
    def prior(self) -> tuple[Floats, Floats]:
        """As `LightModel.prior`, of the shape."""
        known = _SPREADS**-2
        return known, known * (_EXPECTED - self.shape)

    def compare(self, near: float = _NEAR) -> Comparison:
        """Compare the unclipped pixels in the cells, at most `near` [px] inside the edges."""
        x, y = self.places()
        far = np.stack([x * across + y * down for across, down in self.sides])
        inside = (np.abs(far) <= self.widths[:, None, None, None] / 2).all(0)
        inside &= self.light < self.saturation
        inside &= (np.abs(far) > self.halves[:, None, None, None] - near).any(0)
        far = far[:, inside]
        one, two = (self._between(k, np.abs(far[k])) for k in (0, 1))
        above = 1 - self.shape[-1]
        product = one[:, 0] * two[:, 0]
        model = self.shape[-1] + above * product
        # Derivatives with the distances from the middle lines, and with the shape.
        pushes = above * np.sign(far) * [one[:, 1] * two[:, 0], one[:, 0] * two[:, 1]]
        shapes = above * np.stack([one[:, 2:] * two[:, :1], two[:, 2:] * one[:, :1]], -1)
        by_gap = shapes[:, 0] @ _HALVES
        by_blur = shapes[:, 1].sum(1)
        table = np.column_stack([-pushes.T @ self.sides, by_gap, by_blur, 1 - product, model])
        return Comparison(np.nonzero(inside)[0], self.even(shaded=True)[inside] - model, table)

    def residuals(self) -> Floats:
        """(m,) differences of the pixels in the cells from the model."""
        return self.compare(np.inf).residual

    def sums(self) -> Sums:
        """Normal equations about this model; outliers keep some weight, as gaps are narrow."""
        return self.compare().sums(len(self.centres), soft=True)

    def learn(self, sums: Sums, step: Step, lattice: Lattice) -> SquareMicroimages:
        """The microimages on a lattice, with gains and a shape that fit the pixels better."""
        shape = self.shape + np.clip(step.of_light, -_LARGEST_STEP, _LARGEST_STEP)
        shape[2] = max(shape[2], _LEAST_BLUR)
        return replace(self.learn_levels(step.gains(sums), lattice), shape=shape)

    def _between(self, pair: int, far: Floats) -> Floats:
        """Light (m, 4) between a pair of edges at distances (m,) [px] from the middle line.

        After the light come its slopes with the distance, half the distance and blur [1/px].
        """
        half = self.halves[pair]
        away = _STEP * np.arange(int(self.widths[pair] / 2 / _STEP) + 3)
        # The light of the neighbours reaches into the gap.
        depth = half - np.array([away, self.widths[pair] - away])
        seen = self.edge(depth, self.shape[2], float(np.abs(self.sides[pair]).max()))
        own, other = np.array(seen[:3]).transpose(1, 0, 2)
        light, by_depth, by_blur = own + other
        table = np.column_stack([light, other[1] - own[1], by_depth, by_blur])
        place = far / _STEP
        before = place.astype(np.int64)
        return np.asarray(
            table[before] + (place - before)[:, None] * np.diff(table, axis=0)[before]
        )


def mean_residual(squares: SquareMicroimages) -> float:
    """Mean absolute difference of the pixels in the cells from the model, over the light."""
    return float(np.abs(squares.residuals()).mean())
