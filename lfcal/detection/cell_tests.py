"""Tests whether an average cell can be a microimage: what repeats in two directions need not be an array of lenses.

A lens shows the aperture of the main lens, cut by its own border: its light is a function of the distance from the
centre and of that from the border, and falls towards the border. Bricks, windows and cloth depend on more, gratings and
waves on less; on a checkerboard dark places have the shape of light ones. Where figures compare two halves of the
lenses, noise cancels.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from ..images.preprocessing import interpolate_linear
from ..lattice.cell import bin_offsets, cell_distances, nearest_offsets
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_lenses
from ..runtime.errors import RAW_FLAT_ADVICE, CalibrationError
from .folding import HIGHEST_HARMONIC, TileFolds
from .settings import DETECTION

__all__ = ["AverageCell", "check_cell", "check_edges", "find_shape_doubt", "measure_average_cell"]


def check_cell(
    cells: list[NDArray[np.float64]],
    light: NDArray[np.float64],
    basis: NDArray[np.float64],
    centre: NDArray[np.float64],
    repeatability: float,
) -> CalibrationError | None:
    """CalibrationError where the average cell cannot be a microimage; returned, not raised, where a scene may be why.

    Parameters
    ----------
    cells : list of (bins, bins) float64
        Average cell of each feature; bin `k` covers `[k, k + 1) / bins`.
    light : (bins, bins) float64
        Average cell of the luminance.
    basis : (2, 2) float64 [px]
    centre : (2,) float64
        Microimage centre in fractional lattice coordinates.
    repeatability : float
        Correlation of the average cells of two halves of the flat.
    """
    off_line = _off_line_energy(np.mean([_power(cell) for cell in cells], axis=0))
    if off_line < DETECTION.off_line_energy:
        raise CalibrationError(f"stripes repeat on the image, in one direction only; {RAW_FLAT_ADVICE}")
    # Where light hardly varies, only edges are left.
    if light.std() > 0.05 * light.mean():
        # Correlation of two halves limits what any model can explain of their mean.
        possible = 2 * repeatability / (1 + repeatability)
        distances = cell_distances(basis, bin_offsets(basis, len(light), centre).reshape(-1, 2))
        explained = float(np.mean([_explained_share(_smooth(cell), distances) for cell in cells]))
        least = DETECTION.radial_share if off_line > 0.1 else DETECTION.radial_share_rows
        if explained < least * possible:
            pitch = float(np.sqrt(abs(np.linalg.det(basis))))
            error = CalibrationError(
                f"a pattern repeats every {pitch:.1f} px that has no microimages; {RAW_FLAT_ADVICE}"
            )
            if explained < DETECTION.radial_share_scene * possible:
                raise error
            return error
    return None


def check_edges(tone: TileFolds) -> None:
    """CalibrationError where the average cell has no edge as light behind a lens has.

    Parameters
    ----------
    tone : TileFolds
        Root of the luminance on the reduced lattice, with bins far smaller than a pixel.
    """
    pitch = float(np.sqrt(abs(np.linalg.det(tone.basis))))
    # Below 10 px, the own blur of a sensor can leave less; harmonics finer than 2.2 px are aliases of coarser ones.
    if pitch > 10 and _energy_beyond_first(tone, 2.2) < DETECTION.edge_energy:
        raise CalibrationError(
            f"crossed waves without any edge repeat every {pitch:.1f} px, not microimages; {RAW_FLAT_ADVICE}"
        )


def _smooth(cell: NDArray[np.float64]) -> NDArray[np.float64]:
    """A cell (bins, bins) averaged over neighbours: the edge of a hard disc is narrower than what its centre is off."""
    for axis in (0, 1):
        cell = (np.roll(cell, 1, axis) + 2 * cell + np.roll(cell, -1, axis)) / 4
    return cell


def _power(cell: NDArray[np.float64]) -> NDArray[np.float64]:
    """(bins, bins) shares of the variance by harmonic `[k, h]`."""
    energy = np.abs(np.fft.fft2(cell - cell.mean())) ** 2
    shares: NDArray[np.float64] = energy / max(float(energy.sum()), 1e-30)
    return shares


def _orders(bins: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Harmonics `h, k` of the bins of a transform."""
    order = np.rint(np.fft.fftfreq(bins) * bins).astype(int)
    k, h = np.meshgrid(order, order, indexing="ij")
    return h, k


def _off_line_energy(power: NDArray[np.float64]) -> float:
    """Share of the energy that is not on the strongest line of harmonics through zero."""
    h, k = _orders(len(power))
    lines = [(a, b) for a in range(4) for b in range(-3, 4) if gcd(a, b) == 1]
    return 1 - max(float(power[h * b == k * a].sum()) for a, b in lines)


def _energy_beyond_first(tone: TileFolds, shortest_harmonic: float) -> float:
    """Share of the energy of the light in harmonics that are not first ones in both directions."""
    total, count = (v.sum(0, dtype=np.float64) for v in (tone.total, tone.count))
    light = total**2 / np.maximum(count, 1)
    # Deviations weighted by their pixels: where the pitch is a whole number of pixels most bins are empty.
    power = np.abs(np.fft.fft2(light - light.sum() / count.sum() * count)) ** 2
    h, k = _orders(tone.bins)
    highest = np.clip(np.hypot(*tone.basis.T) / shortest_harmonic, 1, HIGHEST_HARMONIC)
    power *= (abs(h) <= highest[0]) & (abs(k) <= highest[1])
    return float(power[np.maximum(abs(h), abs(k)) > 1].sum() / max(power.sum(), 1e-30))


def _explained_share(cell: NDArray[np.float64], distances: tuple[NDArray[np.float64], NDArray[np.float64]]) -> float:
    """Share of the variance of a cell that a sum of a function of each distance explains, 0..1."""
    values = cell.ravel() - cell.mean()
    left = values - _fit_distances(values, distances)
    return 1 - float(left @ left) / max(float(values @ values), 1e-30)


def _fit_distances(
    values: NDArray[np.float64], distances: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Least-squares sum of a piecewise linear function of each distance (n,), to `values` (n,) or columns (n, m)."""
    columns, nodes = [], 16
    for distance in distances:
        place = (distance - distance.min()) / max(float(np.ptp(distance)), 1e-12) * (nodes - 1)
        columns.append(np.clip(1 - np.abs(place[:, None] - np.arange(nodes)), 0, None))
    design = np.hstack(columns)
    fitted: NDArray[np.float64] = design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return fitted


@dataclass(frozen=True)
class AverageCell:
    """Figures of the luminance in the average cell."""

    half_correlation: float  # of the average cells of two halves of the lenses
    unexplained: float  # share of what these have in common that is no function of the distances to centre and border
    # correlation with itself half a cell further, over `half_correlation`; the least of three directions
    half_shift: float
    gap_brightness: float  # light half way to the neighbours over that in the middle, in the brightest direction
    error: float  # standard error of `unexplained` and `half_shift`
    # energy of a difference that most cells have, with either sign, over that of the mean; 0 if there is none
    alternating: float


def find_shape_doubt(
    picture: NDArray[np.float32] | StackedCrops,
    lattice: Lattice,
    clear_gaps: bool = False,
) -> str | None:
    """Why the average cell may be no microimage, None where its shape proves it.

    Parameters
    ----------
    picture : (h, w) float32, or crops
        As made by `images.preprocessing.sqrt_luminance`.
    lattice : Lattice [px]
    clear_gaps : bool
        Whether there are dark gaps at all borders of cells, which proves a microimage of any shape.

    Raises
    ------
    CalibrationError
        If dark places have the shape of light ones.
    """
    cell = measure_average_cell(picture, lattice)
    if cell is None:
        return "there are too few of them to measure their shape"
    margin = 2 * cell.error
    if cell.half_shift + margin < DETECTION.half_shift:
        raise CalibrationError(
            f"light and dark places of one shape repeat every {lattice.pitch:.1f} px, as on a checkerboard or in "
            f"crossed waves, not microimages; {RAW_FLAT_ADVICE}"
        )
    if cell.half_shift - margin < DETECTION.half_shift:
        return "a checkerboard or crossed waves could look like them"
    if cell.alternating > DETECTION.alternating:
        return "two kinds of them alternate, as threads or bricks do"
    if cell.gap_brightness > DETECTION.gap_brightness:
        return "the gaps between them are not darker than their middles"
    if not clear_gaps and cell.unexplained + margin > DETECTION.unexplained:
        return "the light in them does not have the shape of that behind a lens"
    return None


def measure_average_cell(picture: NDArray[np.float32] | StackedCrops, lattice: Lattice) -> AverageCell | None:
    """Measure the average cell as for `find_shape_doubt`; None where there are too few lenses."""
    samples, lenses = 18, 200  # along a cell, an even number; evenly spread over the flat
    share = (np.arange(samples) + 0.5) / samples - 0.5
    column, row = np.meshgrid(share, share)
    offsets = nearest_offsets(np.column_stack([column.ravel(), row.ravel()]), lattice.basis)
    steps = lattice.steps @ lattice.basis
    reach = float(np.hypot(*np.vstack([offsets, steps]).T).max()) + 1
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
    if lit.sum() < 4:
        return None
    centres, cells, level = centres[lit], cells[lit], level[lit]
    cells /= level[:, None]
    a, b = (half.mean(0) - 1 for half in (cells[::2], cells[1::2]))
    common = float(a @ b)
    correlation = common / max(float(np.sqrt((a @ a) * (b @ b))), 1e-30)
    if correlation <= 0:
        return AverageCell(correlation, 1.0, -1.0, 1.0, float("inf"), 0.0)
    both = np.column_stack([a, b])
    left = both - _fit_distances(both, cell_distances(lattice.basis, offsets))
    square = b.reshape(samples, samples)
    shifts = samples // 2 * np.array([(1, 0), (0, 1), (1, 1)])
    half_shift = min(float(a @ np.roll(square, tuple(shift), (0, 1)).ravel()) / common for shift in shifts)
    core = cells[:, np.hypot(*offsets.T) < 0.25 * np.hypot(*steps.T).min()].mean()
    gap = max(float((interpolate_linear(picture, centres + step / 2) ** 2 / level).mean()) for step in steps)
    # Noise is as many independent values as a cell has pixels.
    values = min(abs(np.linalg.det(lattice.basis)), samples**2)
    return AverageCell(
        half_correlation=correlation,
        unexplained=float(left.prod(1).sum()) / common,
        half_shift=half_shift,
        gap_brightness=gap / core,
        error=float((1 - correlation) / correlation / np.sqrt(values)),
        alternating=_alternating_energy(cells, centres),
    )


def _alternating_energy(cells: NDArray[np.float64], centres: NDArray[np.float64]) -> float:
    """`AverageCell.alternating` of cells (n, samples) at `centres` (n, 2) [px], without a linear trend."""
    middle = centres - centres.mean(0)
    trend = np.column_stack([np.ones(len(cells)), middle / max(float(np.abs(middle).max()), 1e-12)])
    left = cells - trend @ np.linalg.lstsq(trend, cells, rcond=None)[0]
    values, vectors = np.linalg.eigh(left @ left.T / len(cells))
    # Participation ratio: the share of cells of equal amplitude that would have the same sum of fourth powers.
    share = 1 / (float(((vectors[:, -1] ** 2) ** 2).sum()) * len(cells))
    # Noise has a share of a half, dust of a few.
    if share < 0.7 or values[-1] < 3 * values[-2]:
        return 0.0
    return float(values[-1] / ((cells.mean(0) - 1) ** 2).sum())
