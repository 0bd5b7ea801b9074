"""Normal equations of lenses from single pixels, for models that fit their light with the lattice."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..lattice.robust_fit import TUKEY_CUTOFF, biweight, robust_sigma
from ..microimage.fit import Sums
from ..runtime.arrays import Floats, Integers
from ..runtime.kernels import FAST, kernel

__all__ = ["Comparison"]


class Comparison(NamedTuple):
    """Pixels (m,) against a model, those of a lens side by side."""

    lens: Integers  # (m,)
    residual: Floats  # (m,) over the gain of the lens
    # (m, 3 + s) derivatives with the centre [1/px], the shared parameters of the light, the gain
    table: Floats

    def sums(self, lenses: int, soft: bool = False) -> Sums:
        """Normal equations of so many lenses, with robust weights of the pixels.

        They are Tukey's, or `soft` ones that are never zero (smooth L1 loss).
        """
        noise = robust_sigma(self.residual) + 1e-9
        share = (self.residual / (TUKEY_CUTOFF * noise)) ** 2
        weight = (1 / np.sqrt(1 + share) if soft else biweight(share)) / noise**2
        first = np.searchsorted(self.lens, np.arange(lenses + 1))
        size = self.table.shape[1]
        normal = np.zeros((lenses, size, size))
        right = np.zeros((lenses, size))
        _add_lenses(first, self.residual, self.table, weight, normal, right)
        return Sums(normal, right, np.zeros((0, 0, 6)))


@kernel(share=lambda first, *_: len(first) - 1, fastmath=FAST)
def _add_lenses(begin, end, first, residual, table, weight, normal, right):
    """Add up the pixels of each lens."""
    size = table.shape[1]
    for lens in range(begin, end):
        for k in range(first[lens], first[lens + 1]):
            for a in range(size):
                pulled = weight[k] * table[k, a]
                right[lens, a] += pulled * residual[k]
                for b in range(a, size):
                    normal[lens, a, b] += pulled * table[k, b]
