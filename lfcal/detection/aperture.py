"""Whether the light in an average cell is that behind a lens: what repeats alike in every cell is judged by its shape.

A lens shows the aperture of the main lens, cut by its own border: its light is a function of the distance from the
centre and of that from the border, and falls towards the joints. Of a checkerboard or of crossed waves the dark places
have the very shape of the light ones, in light as the sensor measures it. Bricks depend on both lengths in other ways,
and their joints are as bright as they like. Figures compare two halves of the lenses, so that noise cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_lenses
from ..runtime.errors import CalibrationError
from ..runtime.interpolation import interpolate_linear
from .cell_tests import explained_by, lengths_of

__all__ = ["AverageCell", "find_shape_doubt", "measure_average_cell"]

# So many lenses, evenly spread, tell; fewer than the least do not.
_LENSES, _FEWEST = 200, 4
# Places along a cell, an even number.
_ACROSS = 18
# Lenses with less of the light of a bright one may lie beside the array.
_DARK = 0.2
# Middle of a microimage, over the distance to the nearest other one.
_CORE = 0.25
# Share of the average cell that the two lengths leave unexplained: white images of discs, cut or whole, blurred or not,
# leave up to 0.05, most of them 0.01.
_UNEXPLAINED = 0.06
# Light at a joint over that in the middle: white images of touching lenses reach 0.86.
_BRIGHT = 0.96
# Correlation of the light with itself moved by half a cell: boards and crossed waves have -1, blurred lenses on squares
# of 6 px reach -0.92.
_OPPOSITE = -0.95
# Energy of what tells two kinds of cells apart, over that of the average cell: a quarter to a half of it for threads
# and for bricks cut in halves; lens types blur rims only.
_TWO_KINDS = 0.1
# Such a difference is in most cells (noise is in half of them, dust and hot pixels are in few) and beyond all others.
_IN_MOST, _BEYOND = 0.7, 3.0
# Figures are good to so many standard errors.
_SURE = 2.0


@dataclass(frozen=True)
class AverageCell:
    """The light in an average cell.

    Parameters
    ----------
    alike : float
        Correlation of the average cells of two halves of the lenses.
    unexplained : float
        Share of what they have in common that is no function of the two lengths.
    opposite : float
        Correlation of a cell with itself moved by half a cell, over `alike`; the least of three moves.
    joint : float
        Light half way to the neighbours over that in the middle, in the brightest direction.
    error : float
        Standard error of `unexplained` and `opposite`.
    two_kinds : float
        Energy of a difference that most cells have, one way or the other, over that of the average cell; 0 where there
        is none.
    """

    alike: float
    unexplained: float
    opposite: float
    joint: float
    error: float
    two_kinds: float


def find_shape_doubt(picture: NDArray[np.float32] | StackedCrops, lattice: Lattice) -> str | None:
    """Why it is in doubt that what repeats on a flat are microimages, judged by their shape; None where it is not.

    Parameters
    ----------
    picture : (h, w) float32, or parts of such
        As made by `features.tone`.
    lattice : Lattice [px]

    Raises
    ------
    CalibrationError
        If the dark places have the very shape of the light ones.
    """
    found = measure_average_cell(picture, lattice)
    if found is None:
        return "too few of them are there to tell their shape"
    if found.opposite + _SURE * found.error < _OPPOSITE:
        raise CalibrationError(
            f"light and dark places of one shape repeat every {lattice.pitch:.1f} px, as on a checkerboard or in "
            "crossed waves, not microimages; give a raw flat from the sensor, of a camera with a microlens array"
        )
    if found.opposite - _SURE * found.error < _OPPOSITE:
        return "a checkerboard or crossed waves could look like them"
    if found.two_kinds > _TWO_KINDS:
        return "they are of two kinds in turn, as threads or bricks are"
    if found.joint > _BRIGHT:
        return "their joints are not darker than their middles"
    if found.unexplained + _SURE * found.error > _UNEXPLAINED:
        return "the light in them is not shaped like that behind a lens"
    return None


def measure_average_cell(picture: NDArray[np.float32] | StackedCrops, lattice: Lattice) -> AverageCell | None:
    """Measure the average cell on a `tone` picture (h, w) or parts; None where there are too few lenses."""
    offsets = _offsets(lattice.basis)
    steps = lattice.steps @ lattice.basis
    reach = float(np.hypot(*np.vstack([offsets, steps]).T).max()) + 1
    if isinstance(picture, StackedCrops):
        _, centres, part = picture.lenses(lattice, reach)
        chosen = np.linspace(0, len(centres) - 1, min(_LENSES, len(centres))).astype(int)
        centres, picture = (centres - picture.offsets[part])[chosen], picture.picture
    else:
        _, centres = sample_lenses(lattice, reach, _LENSES)
    if len(centres) < _FEWEST:
        return None
    cells = interpolate_linear(picture, centres[:, None] + offsets) ** 2
    level = cells.mean(1)
    lit = level > _DARK * np.quantile(level, 0.95)
    if lit.sum() < _FEWEST:
        return None
    centres, cells, level = centres[lit], cells[lit], level[lit]
    cells /= level[:, None]
    a, b = (half.mean(0) - 1 for half in (cells[::2], cells[1::2]))
    common = float(a @ b)
    alike = common / max(float(np.sqrt((a @ a) * (b @ b))), 1e-30)
    if alike <= 0:
        return AverageCell(alike, 1.0, -1.0, 1.0, float("inf"), 0.0)
    both = np.column_stack([a, b])
    left = both - explained_by(both, lengths_of(lattice.basis, offsets))
    unexplained = float(left.prod(1).sum()) / common
    moves = _ACROSS // 2 * np.array([(1, 0), (0, 1), (1, 1)])
    square = b.reshape(_ACROSS, _ACROSS)
    opposite = min(float(a @ np.roll(square, tuple(move), (0, 1)).ravel()) / common for move in moves)
    middle = np.hypot(*offsets.T) < _CORE * np.hypot(*steps.T).min()
    core = cells[:, middle].mean()
    joint = max(float((interpolate_linear(picture, centres + step / 2) ** 2 / level).mean()) for step in steps)
    # Noise is as many independent values as a cell has pixels.
    error = (1 - alike) / alike / np.sqrt(min(abs(np.linalg.det(lattice.basis)), _ACROSS**2))
    return AverageCell(alike, unexplained, opposite, joint / core, float(error), _two_kinds(cells, centres))


def _two_kinds(cells: NDArray[np.float64], centres: NDArray[np.float64]) -> float:
    """`AverageCell.two_kinds` of cells (n, places) at `centres` (n, 2) [px], without a linear trend over the flat."""
    middle = centres - centres.mean(0)
    trend = np.column_stack([np.ones(len(cells)), middle / max(float(np.abs(middle).max()), 1e-12)])
    left = cells - trend @ np.linalg.lstsq(trend, cells, rcond=None)[0]
    values, vectors = np.linalg.eigh(left @ left.T / len(cells))
    share = vectors[:, -1] ** 2
    # The number of equal parts that would make the same sum of squares, over that of cells.
    part = 1 / (float((share**2).sum()) * len(cells))
    if part < _IN_MOST or values[-1] < _BEYOND * values[-2]:
        return 0.0
    return float(values[-1] / ((cells.mean(0) - 1) ** 2).sum())


def _offsets(basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) places in a cell [px], in rows along `a1`, each from the centre next to it."""
    share = (np.arange(_ACROSS) + 0.5) / _ACROSS - 0.5
    column, row = np.meshgrid(share, share)
    around = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    steps = (np.column_stack([column.ravel(), row.ravel()])[:, None] - around) @ basis
    nearest = np.hypot(steps[..., 0], steps[..., 1]).argmin(1)
    return steps[np.arange(len(steps)), nearest]
