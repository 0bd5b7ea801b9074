"""Microimages of square and rectangular cells with straight edges, and dark gaps between them.

The light of a pixel is the product of those between the two pairs of edges: a profile over the
distance from the centre cannot follow straight edges. Edges have the closed form of
`microimage.edge`, so that they are found between pixels also where all lenses lie alike to these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from ..lattice.lattice import Lattice
from ..lattice.robust_fit import TUKEY_CUTOFF, biweight
from ..microimage.average import estimate_variance
from ..microimage.edge import EdgeLight, blurred_edge
from ..runtime.arrays import Floats, Integers
from .kernel import Sums
from .microimages import Microimages

__all__ = ["SquareMicroimages", "mean_residual"]

# Pixels that are used: with them centres are right to a thousandth of a pixel.
_PIXELS = 6e5
# Cosine of the angle between the sides of a cell up to which it is rectangular.
_RECTANGULAR = 0.05
# [px] Least blur: with less, hardly a pixel tells it.
_LEAST_BLUR = 0.1
# Blurs [px] and stray light that are expected, and their standard deviations: they matter where all
# lenses lie alike to the pixels, which cannot tell a narrow gap from a brighter one.
_EXPECTED = np.array([0.0, 0.0, 0.3, 0.3, 0.01])
_SPREADS = np.array([np.inf, np.inf, 0.3, 0.3, 0.02])
# What blurs of a pixel, where the fit also begins, are beyond those.
_SOFTER = np.array([0.0, 0.0, 0.7, 0.7, 0.0])
# [px] Steps at which the light between edges is tabulated, and of distances from the border of the
# cell at which the variance of pixels is measured.
_STEP = 1 / 64
_RING_STEP = 1 / 8
# [px] Pixels farther inside the edges tell nothing but the light of their lens.
_NEAR = 5.0


class _Comparison(NamedTuple):
    """Pixels (m,) in the cells against the model."""

    lens: Integers  # (m,)
    ring: Integers  # (m,) steps from the border of the cell
    residual: Floats  # (m,) over the light of the lens
    columns: Floats  # (m, 3) derivatives with the centre [1/px] and the gain
    table: Floats  # (m, 5) with the shape


@dataclass(frozen=True)
class SquareMicroimages(Microimages):
    """Microimages whose light is a product of that between two pairs of edges."""

    sides: Floats  # (2, 2) unit vectors across the two pairs of edges
    widths: Floats  # (2,) [px] of the cell between them
    shape: Floats  # (5,) half the distances of the pairs [px], their blurs [px] and stray light
    edge: Callable[..., EdgeLight] = blurred_edge

    @classmethod
    def of(cls, lenses: Microimages, lattice: Lattice) -> SquareMicroimages | None:
        """Microimages of a rectangular lattice with their mean shape; None on other lattices."""
        across = np.linalg.inv(lattice.basis).T
        widths = 1 / np.hypot(*across.T)
        sides = across * widths[:, None]
        if abs(float(sides[0] @ sides[1])) > _RECTANGULAR:
            return None
        few = lenses.thin(_PIXELS)
        known = {field.name: getattr(few, field.name) for field in fields(few)}
        # The slope of the light in a lens is measured where its edges are far.
        known["profile"] = np.ones_like(few.profile)
        known["ring_weight"] = np.ones(int(widths.max() / 2 / _RING_STEP) + 1)
        sharp = cls(**known, sides=sides, widths=widths, shape=_EXPECTED.copy())
        # Of gaps without light, the mean light is the lit part of the cell.
        lit = float(sharp.compare().residual.mean())
        sharp.shape[:2] = widths / 2 * np.sqrt(np.clip(lit, 0.5, 1))
        soft = replace(sharp, shape=sharp.shape + _SOFTER)
        found = min(sharp, soft, key=mean_residual)
        # Wide blurs need more passes; beside the true centres these can also lead away.
        first = found.learn_shape()
        later = first.learn_shape().learn_shape().learn_shape()
        return min(first, later, key=mean_residual)

    def compare(self, near: float = _NEAR) -> _Comparison:
        """Compare the unclipped pixels in the cells, at most `near` [px] inside the edges."""
        x, y = self.places()
        far = np.stack([x * across + y * down for across, down in self.sides])
        inside = (np.abs(far) <= self.widths[:, None, None, None] / 2).all(0)
        inside &= self.light < self.saturation
        inside &= (np.abs(far) > self.shape[:2, None, None, None] - near).any(0)
        lens, row, column = np.nonzero(inside)
        far = far[:, inside]
        slope = (self.slope + self.shade)[lens]
        tilt = 1 + slope[:, 0] * x[lens, 0, column] + slope[:, 1] * y[lens, row, 0]
        relative = self.light[inside] / (self.gain[lens] * tilt)
        one, two = (self._between(k, np.abs(far[k])) for k in (0, 1))
        above = 1 - self.shape[-1]
        product = one[:, 0] * two[:, 0]
        model = self.shape[-1] + above * product
        # Derivatives with the distances from the middle lines, and with the shape.
        pushes = above * np.sign(far) * [one[:, 1] * two[:, 0], one[:, 0] * two[:, 1]]
        columns = np.column_stack([-pushes.T @ self.sides, model])
        shapes = above * np.stack([one[:, 2:] * two[:, :1], two[:, 2:] * one[:, :1]], -1)
        table = np.column_stack([shapes.reshape(-1, 4), 1 - product])
        border = (self.widths[:, None] / 2 - np.abs(far)).min(0)
        return _Comparison(
            lens, (border / _RING_STEP).astype(np.int64), relative - model, columns, table
        )

    def residuals(self) -> Floats:
        """(m,) differences of the pixels in the cells from the model."""
        return self.compare(np.inf).residual

    def sums(self) -> Sums:
        """Normal equations about this model, without a band."""
        seen, weights = self._weigh()
        count = len(self.centres)
        normal = np.zeros((count, 3, 3))
        right = np.zeros((count, 3))
        for a in range(3):
            weighted = weights * seen.columns[:, a]
            right[:, a] = np.bincount(seen.lens, weighted * seen.residual, count)
            for b in range(a, 3):
                normal[:, a, b] = np.bincount(seen.lens, weighted * seen.columns[:, b], count)
        return Sums(normal, right, np.zeros((0, 0)))

    def learn(self, sums: Sums, moved: Floats, lattice: Lattice) -> SquareMicroimages:
        """The microimages on a lattice, with gains, and then a shape, that fit the pixels better."""
        lenses = super().learn(sums, moved, lattice)
        assert isinstance(lenses, SquareMicroimages)
        return lenses.learn_shape()

    def learn_profile(self, sums: Sums) -> SquareMicroimages:
        """The same microimages: they have no profile."""
        return self

    def learn_shape(self) -> SquareMicroimages:
        """The microimages with a shape and weights that fit the pixels better."""
        seen, weights = self._weigh()
        # With a common shift: where all lenses lie alike to the pixels, centres and shape explain
        # the same.
        table = np.hstack([seen.table, seen.columns[:, :2]])
        pulled = table * weights[:, None]
        normal = pulled.T @ table
        pull = seen.residual @ pulled
        normal[:5, :5] += np.diag(_SPREADS**-2)
        pull[:5] += (_EXPECTED - self.shape) / _SPREADS**2
        shape = self.shape + np.linalg.solve(normal, pull)[:5]
        shape[2:4] = np.maximum(shape[2:4], _LEAST_BLUR)
        rings = len(self.ring_weight)
        used = weights > 0
        squares = np.bincount(seen.ring, used * seen.residual**2, rings)
        variance = estimate_variance(squares, np.bincount(seen.ring, used, rings))
        return replace(self, shape=shape, ring_weight=1 / np.maximum(variance, 1e-9))

    def _weigh(self) -> tuple[_Comparison, Floats]:
        """The pixels against the model, and their robust weights (m,)."""
        seen = self.compare()
        weights = self.ring_weight[seen.ring]
        return seen, weights * biweight(seen.residual**2 * weights / TUKEY_CUTOFF**2)

    def _between(self, pair: int, far: Floats) -> Floats:
        """Light (m, 4) between a pair of edges at distances (m,) [px] from the middle line.

        After the light come its slopes with the distance, half the distance and blur [1/px].
        """
        half, blur = self.shape[pair:4:2]
        away = _STEP * np.arange(int(self.widths[pair] / 2 / _STEP) + 3)
        # The light of the neighbours reaches into the gap.
        depth = half - np.array([away, self.widths[pair] - away])
        seen = self.edge(depth, blur, float(np.abs(self.sides[pair]).max()))
        own, other = np.array(seen[:3]).transpose(1, 0, 2)
        light, by_depth, by_blur = own + other
        table = np.column_stack([light, other[1] - own[1], by_depth, by_blur])
        place = far / _STEP
        before = place.astype(np.int64)
        return np.asarray(
            table[before] + (place - before)[:, None] * np.diff(table, axis=0)[before]
        )


def mean_residual(squares: Microimages) -> float:
    """Mean absolute difference of the pixels in the cells from the model, over the light."""
    return float(np.abs(squares.residuals()).mean())
