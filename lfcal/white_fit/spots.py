"""Lattice of a white image whose microimages are spots of few pixels."""

from __future__ import annotations

import numpy as np

from ..lattice.lattice import Lattice
from ..lattice.robust_fit import LatticeFit, field_rms, fit_affine
from ..lattice.standard_errors import equal_weight_errors
from ..microimage.lit import UNLIT, is_lit
from ..runtime.arrays import Singles
from ..runtime.errors import CalibrationError

__all__ = ["are_spots", "fit_spots"]

# [px] in a lens from which on its light is measured well enough to compare, and its edge can be
# fitted.
_FEWEST_PIXELS = 20.0


def are_spots(picture: Singles, lattice: Lattice) -> bool:
    """Whether a disc of even light with the mean and variance of the light in a cell is too small.

    `picture` (h, w) is the root of the light.
    """
    # Row by row, as the light of a large flat takes longer to store than to add up.
    lights = (row.astype(np.float64) ** 2 for row in picture)
    total, squares = np.sum([(light.sum(), light @ light) for light in lights], axis=0)
    pixels = abs(np.linalg.det(lattice.basis)) * total**2 / (squares * picture.size)
    return bool(pixels < _FEWEST_PIXELS)


def fit_spots(picture: Singles, start: Lattice) -> LatticeFit:
    """Fit a lattice to the centroids of the light of spots of few pixels, as unfocused cameras make
    with a small pupil.

    So few pixels have no edge that a profile could follow, and the root of their light, `picture`
    (h, w), has its centre elsewhere. In each of three passes, windows as wide as cells are put
    about the fitted centres.
    """
    lattice = start
    reach = int(np.hypot(*(start.steps @ start.basis).T).min() / 2)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    inside = np.hypot(x, y) <= reach
    x = x[inside]
    y = y[inside]
    for _ in range(3):
        indices, centres = lattice.select_whole(reach + 1)
        corner = np.rint(centres).astype(np.int64)
        light = picture[corner[:, 1, None] + y, corner[:, 0, None] + x].astype(np.float64) ** 2
        light -= np.median(light, axis=1, keepdims=True)
        np.maximum(light, 0, out=light)
        total = light.sum(1)
        lit = is_lit(total, UNLIT)
        if lit.sum() < 12:
            raise CalibrationError(
                f"only {lit.sum()} whole microimages have light; give a brighter white image"
            )
        indices = indices[lit]
        centres = centres[lit]
        corner = corner[lit]
        light = light[lit]
        total = total[lit]
        shifts = corner + np.column_stack([light @ x, light @ y]) / total[:, None] - centres
        design = np.column_stack([np.ones(len(indices)), indices])
        change, weight = fit_affine(design, shifts, np.ones(len(indices)))
        lattice = Lattice(
            lattice.origin + change[0], lattice.basis + change[1:], start.image_size, start.radius
        )
    first, second = (
        fit_affine(design[k::2], shifts[k::2], np.ones(len(shifts[k::2])))[0] for k in (0, 1)
    )
    scatter = float(np.sqrt(np.average(((shifts - design @ change) ** 2).sum(1), weights=weight)))
    used = int((weight > 0).sum())
    # Three parameters of each coordinate, from so many lenses.
    uncertainty = scatter * np.sqrt(3 / used)
    differ = field_rms(design, first - second)
    return LatticeFit(lattice, scatter, used, differ, equal_weight_errors(lattice, uncertainty))
