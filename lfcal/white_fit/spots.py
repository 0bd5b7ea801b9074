"""Lattice through the centroids of spots of few pixels, as small apertures make in unfocused cameras.

So few pixels have no edge that a profile could follow, and the root of their light has its centre elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import select_whole_lenses
from ..lattice.robust_fit import LatticeFit, field_rms, fit_lattice_shifts, shift_standard_error
from ..runtime.errors import CalibrationError
from .settings import FIT

__all__ = ["count_lit_pixels", "fit_spots"]


def count_lit_pixels(picture: NDArray[np.float32], lattice: Lattice) -> float:
    """Pixels of a disc of even light that has the mean and the variance of the light in a cell.

    `picture` (h, w) is the root of the light.
    """
    light = picture.astype(np.float64) ** 2
    return float(abs(np.linalg.det(lattice.basis)) * light.mean() ** 2 / np.mean(light**2))


def fit_spots(picture: NDArray[np.float32], start: Lattice, passes: int = 3) -> LatticeFit:
    """Fit a lattice to the centroids of the light of spots.

    Parameters
    ----------
    picture : (h, w) float32
        Root of the light.
    start : Lattice [px]
    passes : int
        Times that the windows, as wide as cells, are put about the fitted centres.

    Raises
    ------
    CalibrationError
        If there are too few whole lenses with light.
    """
    lattice, reach = start, int(np.hypot(*(start.steps @ start.basis).T).min() / 2)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    inside = np.hypot(x, y) <= reach
    x, y = x[inside], y[inside]
    for _ in range(passes):
        indices, centres = select_whole_lenses(lattice, reach + 1)
        corner = np.rint(centres).astype(np.int64)
        light = picture[corner[:, 1, None] + y, corner[:, 0, None] + x].astype(np.float64) ** 2
        light -= np.median(light, axis=1, keepdims=True)
        np.maximum(light, 0, out=light)
        total = light.sum(1)
        lit = total > FIT.dark_spot * np.quantile(total, 0.9)
        if lit.sum() < FIT.fewest_lenses:
            raise CalibrationError(f"only {lit.sum()} whole microimages have light; give a brighter white image")
        indices, centres, corner, light, total = (v[lit] for v in (indices, centres, corner, light, total))
        shifts = corner + np.column_stack([light @ x, light @ y]) / total[:, None] - centres
        design, normal = np.column_stack([np.ones(len(indices)), indices]), np.tile(np.eye(2), (len(indices), 1, 1))
        change, residuals, weight, variance = fit_lattice_shifts(design, normal, shifts)
        lattice = Lattice(lattice.origin + change[0], lattice.basis + change[1:], start.image_size, start.radius)
    first, second = (fit_lattice_shifts(design[k::2], normal[k::2], shifts[k::2])[0] for k in (0, 1))
    return LatticeFit(
        lattice.origin,
        lattice.basis,
        float(np.sqrt(np.average((residuals**2).sum(1), weights=weight))),
        shift_standard_error(design, normal, weight, variance),
        int((weight > 0).sum()),
        field_rms(design, first - second),
    )
