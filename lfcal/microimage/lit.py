"""Which lenses, tiles or places of a flat are lit.

Their light is compared with that of bright ones. Beside an array of microlenses there is stray
light; on the array, scenes have dark places.
"""

from __future__ import annotations

import numpy as np

from ..lattice.lattice import Lattice, reduce_basis
from ..lattice.lens_subset import neighbour_rows
from ..runtime.arrays import ENOUGH_LENSES, Array, Booleans, Floats, Integers, Singles, evenly

__all__ = ["STRAY", "UNLIT", "bright_light", "find_lit_lenses", "is_lit"]

#: Light over that of bright lenses, below which it may be stray light: that is up to 0.03 beside
#: arrays. With less, more of the dark lenses of scenes are compared, which show noise.
STRAY = 0.16
#: Light over that of bright lenses, below which a lens has none. The corners of flats with strong
#: vignetting have 0.05.
UNLIT = 0.04
# Quantile of the light of lenses that is bright, without being dust or a hot pixel.
_BRIGHT = 0.95


def bright_light(light: Array) -> float:
    """Light of bright lenses, tiles or places; 0 if there are none."""
    values = light.ravel()
    if values.size == 0:
        return 0.0
    return float(np.quantile(values[evenly(values.size, ENOUGH_LENSES)], _BRIGHT))


def is_lit(light: Array, least: float) -> Booleans:
    """Whether lenses, tiles or places have more than the share `least` of the light of bright ones."""
    return np.asarray(light > least * bright_light(light))


def find_lit_lenses(
    picture: Singles, lattice: Lattice, indices: Integers, centres: Floats, dark: float
) -> Booleans:
    """(n,) whether lenses are lit and not next to a dark one, as the border of the array cuts some.

    Stray light also reaches pixels without a lens, so lenses are found by the step to the gaps
    around them where gaps are visible, else by the brightness of their core.

    `picture` (h, w) is light or its square root; `centres` (n, 2) are at least 1.5 px inside it. A
    lens is dark below the share `dark` of the step (or brightness) of a bright lens.
    """
    if len(centres) == 0:
        return np.zeros(0, dtype=bool)

    def mean_at(offsets: Floats) -> Floats:
        total = np.zeros(len(centres))
        for offset in offsets:
            x, y = np.rint(centres + offset).astype(np.int64).T
            total += picture[y.clip(0, len(picture) - 1), x.clip(0, picture.shape[1] - 1)]
        return total / len(offsets)

    core = mean_at(np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2))
    step = core - mean_at(_cell_corners(lattice))
    has_gaps = bright_light(step) > 0.3 * bright_light(core)
    unlit = ~is_lit(step if has_gaps else core, dark)
    rows = neighbour_rows(indices, lattice.steps)
    beside = (unlit[rows] & (rows >= 0)).any(0)
    return ~(unlit | beside)


def _cell_corners(lattice: Lattice) -> Floats:
    """(6, 2) from a lens to the corners of its cell, where three or four lenses meet [px]."""
    a, b = reduce_basis(lattice.basis)
    corner = np.linalg.solve(np.array([a, b]), [a @ a / 2, b @ b / 2])
    half = np.array([corner, corner - a, corner - b])
    return np.concatenate([half, -half])
