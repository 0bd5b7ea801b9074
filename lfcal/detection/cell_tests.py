"""Tests whether an average cell can be a microimage: what repeats in two directions need not be an array of lenses.

A lens shows the aperture of the main lens, cut by its own border: its light is a function of the distance from the
centre and of that from the border, and falls towards the border. Bricks, windows and cloth depend on more, gratings and
waves on less; on a checkerboard dark places have the shape of light ones. Where figures compare two halves of the
lenses, noise cancels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..images.preprocessing import interpolate_linear
from ..lattice.cell import bin_offsets, cell_distances, nearest_offsets
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_lenses
from ..runtime.arrays import Floats, Singles
from ..runtime.errors import RAW_FLAT_ADVICE, CalibrationError

__all__ = ["AverageCell", "check_cell", "find_shape_doubt", "measure_average_cell"]

_RADIAL_SHARE = 0.8  # least share of a cell that distances to centre and border explain
_RADIAL_SHARE_SCENE = 0.65  # the same where a scene may be left in the average of a thousand lenses
_PATTERN_REPEATABILITY = 0.99  # and where two halves are so alike: scenes reach 0.98, bricks 1
_UNEXPLAINED = 0.06  # most share that the two distances leave: white images up to 0.05, mostly 0.01
_HALF_SHIFT = -0.95  # correlation with itself half a cell further: boards -1, blurred lenses -0.92
_EDGE_ENERGY = 5e-3  # least beyond the first harmonics: waves 0, discs 0.05

_Distances = tuple[Floats, Floats]


def check_cell(
    cells: list[Floats], light: Floats, basis: Floats, centre: Floats, repeatability: float
) -> CalibrationError | None:
    """Why the average cell is no microimage, unless parallax proves one; None if it may be one.

    Raised, not returned, where no scene that is left in the average of a thousand lenses can be why: that differs from
    one half of the flat to the other.

    `cells` (bins, bins) are the average cells of each feature, `light` that of the luminance; the microimage has its
    `centre` (2,) in fractional lattice coordinates, and average cells of two halves of the flat this `repeatability`.
    """
    # Where light hardly varies, only edges are left.
    if light.std() <= 0.05 * light.mean():
        return None
    # Correlation of two halves limits what any model can explain of their mean.
    possible = 2 * repeatability / (1 + repeatability)
    distances = cell_distances(basis, bin_offsets(basis, len(light), centre).reshape(-1, 2))
    shares = []
    for cell in cells:
        # Smoothed: the edge of a hard disc is narrower than what its centre is off.
        for axis in (0, 1):
            cell = (np.roll(cell, 1, axis) + 2 * cell + np.roll(cell, -1, axis)) / 4
        values = cell.ravel() - cell.mean()
        left = values - _fit_distances(values, distances)
        shares.append(1 - float(left @ left) / max(float(values @ values), 1e-30))
    explained = float(np.mean(shares))
    if explained >= _RADIAL_SHARE * possible:
        return None
    pitch = float(np.sqrt(abs(np.linalg.det(basis))))
    error = CalibrationError(f"a pattern repeats every {pitch:.1f} px that has no microimages; {RAW_FLAT_ADVICE}")
    if explained < _RADIAL_SHARE_SCENE * possible or repeatability > _PATTERN_REPEATABILITY:
        raise error
    return error


def _fit_distances(values: Floats, distances: _Distances) -> Floats:
    """Least-squares sum of a piecewise linear function of each distance (n,), to `values` (n,) or columns (n, m)."""
    columns, nodes = [], 16
    for distance in distances:
        place = (distance - distance.min()) / max(float(np.ptp(distance)), 1e-12) * (nodes - 1)
        columns.append(np.clip(1 - np.abs(place[:, None] - np.arange(nodes)), 0, None))
    design = np.hstack(columns)
    fitted: Floats = design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return fitted


class AverageCell(NamedTuple):
    """Figures of the luminance in the average cell."""

    unexplained: float  # share of what two halves of the lenses have in common that is no function of the distances
    half_shift: float  # correlation with itself half a cell further, the least of three directions
    error: float  # standard error of both
    edges: float  # share of the energy beyond the first harmonics


def find_shape_doubt(picture: Singles | StackedCrops, lattice: Lattice, clear_gaps: bool = False) -> str | None:
    """Why the average cell may be no microimage, None where its shape proves it.

    `picture` (h, w), or crops, is as made by `images.preprocessing.sqrt_luminance`; `clear_gaps` tells that there are
    dark gaps at all borders of cells, which proves a microimage of any shape. Raises `CalibrationError` if dark places
    have the shape of light ones.
    """
    cell = measure_average_cell(picture, lattice)
    if cell is None:
        return "there are too few of them to measure their shape"
    margin = 2 * cell.error
    # Below 10 px, the blur of a sensor can leave no edges.
    waves = lattice.pitch > 10 and cell.edges < _EDGE_ENERGY
    if waves or cell.half_shift + margin < _HALF_SHIFT:
        raise CalibrationError(
            f"light and dark places of one shape repeat every {lattice.pitch:.1f} px, as on a checkerboard or in "
            f"crossed waves, not microimages; {RAW_FLAT_ADVICE}"
        )
    if cell.half_shift - margin < _HALF_SHIFT:
        return "a checkerboard or crossed waves could look like them"
    if not clear_gaps and cell.unexplained + margin > _UNEXPLAINED:
        return "the light in them does not have the shape of that behind a lens"
    return None


def measure_average_cell(picture: Singles | StackedCrops, lattice: Lattice) -> AverageCell | None:
    """Measure the average cell as for `find_shape_doubt`; None where there are too few lenses."""
    samples, lenses = 18, 200  # along a cell, an even number; evenly spread over the flat
    share = (np.arange(samples) + 0.5) / samples - 0.5
    column, row = np.meshgrid(share, share)
    offsets = nearest_offsets(np.column_stack([column.ravel(), row.ravel()]), lattice.basis)
    reach = float(np.hypot(*offsets.T).max()) + 1
    if isinstance(picture, StackedCrops):
        _, centres, crop = picture.lenses(lattice, reach)
        chosen = np.linspace(0, len(centres) - 1, min(lenses, len(centres))).astype(int)
        centres, picture = (centres - picture.offsets[crop])[chosen], picture.picture
    else:
        _, centres = sample_lenses(lattice, reach, lenses)
    if len(centres) < 4:
        return None
    cells = interpolate_linear(picture, centres[:, None] + offsets) ** 2
    level = cells.mean(1)
    # Darker ones may lie beside the array.
    lit = level > 0.2 * np.quantile(level, 0.95)
    cells = cells[lit] / level[lit, None]
    if len(cells) < 4:
        return None
    a, b = (half.mean(0) - 1 for half in (cells[::2], cells[1::2]))
    common = float(a @ b)
    correlation = common / max(float(np.sqrt((a @ a) * (b @ b))), 1e-30)
    if correlation <= 0:
        return AverageCell(1.0, -1.0, float("inf"), 1.0)
    both = np.column_stack([a, b])
    left = both - _fit_distances(both, cell_distances(lattice.basis, offsets))
    square = b.reshape(samples, samples)
    shifts = samples // 2 * np.array([(1, 0), (0, 1), (1, 1)])
    half_shift = min(float(a @ np.roll(square, tuple(shift), (0, 1)).ravel()) / common for shift in shifts)
    one, other = (np.fft.fft2(half.reshape(samples, samples)) for half in (a, b))
    energy = (one * other.conj()).real
    first = np.ix_([-1, 0, 1], [-1, 0, 1])
    # Noise is as many independent values as a cell has pixels.
    values = min(abs(np.linalg.det(lattice.basis)), samples**2)
    error = float((1 - correlation) / correlation / np.sqrt(values))
    edges = 1 - float(energy[first].sum() / energy.sum())
    return AverageCell(float(left.prod(1).sum()) / common, half_shift, error, edges)
