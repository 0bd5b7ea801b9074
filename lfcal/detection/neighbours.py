"""Parallax: neighbouring microimages show the same content, shifted, which no print, tiles or
meshes do.

A lens is compared with its neighbours along the steps between them. Disparity is the same share of
the step in all directions: either one shift is chosen for all lenses, or that of a lens in one
direction is chosen in the others, so that nothing matches by chance. In an unfocused camera
neighbours show the same without a shift. Behind a mesh one picture goes on from cell to cell: their
facing sides show the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..images.preprocessing import interpolate_linear
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import sample_lenses
from ..microimage.lit import STRAY, is_lit
from ..runtime.arrays import Floats, Singles
from ..runtime.kernels import kernel

__all__ = ["Likeness", "compare_neighbours", "measure_likeness"]

#: Lenses compared, evenly spread over the flat.
_LENSES = 180
#: Samples along a line through a lens, and disparities tried, in steps between lenses.
_SAMPLES = 33
_RATIOS = np.linspace(-0.7, 0.7, 29)
#: Shifts next to the farthest ones, which are no minimum of the differences.
_ENDS = 2
#: Difference that is noise: less than this tells nothing.
_FLOOR = 1e-4
#: Samples at the end of such a line that are the side of a lens.
_SIDE = 6


class Likeness(NamedTuple):
    """Natural logarithms of how much less neighbours differ than they usually do.

    Differences are taken over the contrast of what is compared: all are 0 for independent or blank
    cells.
    """

    parallax: float  # at the right shift, against any shift
    still: float  # without a shift, against any shift
    continued: float  # facing sides, against the same sides


def measure_likeness(picture: Singles, lattice: Lattice) -> Likeness | None:
    """How well neighbouring lenses match, on a picture (h, w), the square root of the luminance.

    Returns None if fewer than 24 lit lenses have neighbours on all sides.
    """
    steps = lattice.steps @ lattice.basis
    lengths = np.hypot(*steps.T)
    nearest = float(lengths.min())
    _, centres = sample_lenses(lattice, 1.5 * float(lengths.max()) + 1, _LENSES)
    centres = _select_lit(picture, centres, 0.3 * nearest)
    if len(centres) < 24:
        return None
    radius = 0.8 * min(lattice.radius, nearest / 2)
    along = np.linspace(-radius, radius, _SAMPLES)
    spacing = float(along[1] - along[0])
    differences = []
    contrasts = []
    same_sides = []
    facing_sides = []
    for step in _nearest_steps(lattice):
        own, other = _sample_lines(picture, centres, step, along)
        difference, contrast = _compare_lines(own, other, _RATIOS * np.hypot(*step) / spacing)
        differences.append(difference)
        contrasts.append(contrast)
        first, last = (slice(None, _SIDE), slice(-_SIDE, None))
        same_sides += [_differ(own[:, side], other[:, side]) for side in (first, last)]
        facing_sides.append(_differ(own[:, last], other[:, first]))
    parallax, still = _log_gains(np.array(differences), np.array(contrasts))
    continued = np.log((np.mean(same_sides) + _FLOOR) / (np.mean(facing_sides) + _FLOOR))
    return Likeness(parallax, still, float(continued))


def compare_neighbours(
    picture: Singles, lattice: Lattice, centres: Floats, radius: float, ratios: Floats
) -> Floats:
    """Differences of lenses from their neighbours, and contrasts (2, s, n), at disparities (s,).

    They are sums over the nearest neighbours of lenses at `centres` (n, 2) [px], each once;
    neighbours within `radius` [px] of the border of the picture, or beyond, do not count.
    """
    total = np.zeros((2, len(ratios), len(centres)))
    size = np.array(picture.shape[::-1]) - 1
    for step in _nearest_steps(lattice):
        place = centres + step
        rows = np.flatnonzero(((place >= radius) & (place <= size - radius)).all(1))
        # Samples as far apart as the disparities, so that shifts are whole numbers of them.
        spacing = (ratios[1] - ratios[0]) * np.hypot(*step)
        along = spacing * np.arange(-(radius // spacing), radius // spacing + 1)
        lines = _sample_lines(picture, centres[rows], step, along)
        total[:, :, rows] += _compare_lines(*lines, ratios * np.hypot(*step) / spacing)
    return total


def _nearest_steps(lattice: Lattice) -> Floats:
    """(k, 2) [px] to half of the nearest neighbours, of which the others lie opposite."""
    steps = (lattice.steps @ lattice.basis)[: len(lattice.steps) // 2]
    lengths = np.hypot(*steps.T)
    return np.asarray(steps[lengths < 1.2 * lengths.min()])


def _compare_lines(own: Floats, other: Floats, shifts: Floats) -> Floats:
    """`_compare` at the nearest whole shifts: differences and contrasts (2, s, n)."""
    compared = np.empty((2, len(shifts), len(own)))
    most = own.shape[1] - 1
    _compare(own, other, np.rint(shifts).astype(int).clip(-most, most), *compared)
    return compared


def _differ(first: Floats, second: Floats) -> float:
    """Mean difference of the tones of two sides (n, m, 3) of lenses."""
    return float(np.abs(first.mean(1) - second.mean(1)).mean())


def _select_lit(picture: Singles, centres: Floats, radius: float) -> Floats:
    """The centres (n, 2) of lit lenses."""
    around = radius * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
    if len(centres) == 0:
        return centres
    tones = interpolate_linear(picture, centres[:, None] + around).mean(1)
    return centres[is_lit(tones**2, STRAY)]


def _sample_lines(
    picture: Singles, centres: Floats, step: Floats, along: Floats
) -> tuple[Floats, Floats]:
    """Samples (n, m, 3) on three lines along `step` (2,) through lenses, and through the neighbours
    there.

    What all lenses have in common, such as vignetting, is divided out.
    """
    ahead = step / np.hypot(*step)
    aside = np.array([-ahead[1], ahead[0]])
    lines = along[-1] * np.array([-0.25, 0, 0.25])
    offset = along[:, None, None] * ahead + lines[:, None] * aside
    own = interpolate_linear(picture, centres[:, None, None] + offset)
    other = interpolate_linear(picture, (centres + step)[:, None, None] + offset)
    common = np.median(own, axis=0)
    common = np.maximum(common / max(float(common.mean()), 1e-6), 0.05)
    return own / common, other / common


@kernel(error_model="numpy")
def _compare(own, other, shifts, difference, contrast):
    """Mean difference (s, n) of lines (n, m, 3) of lenses and those of their neighbours, each shift
    (s,) samples further; and contrast (s, n).

    The contrast is the mean distance from the mean, of both together.
    """
    lenses, samples, lines = own.shape
    for k in range(len(shifts)):
        begin = max(-shifts[k], 0)
        ahead = max(shifts[k], 0)
        count = samples - begin - ahead
        share = 1.0 / (count * lines)
        for lens in range(lenses):
            first = own[lens, begin : begin + count]
            second = other[lens, ahead : ahead + count]
            total = 0.0
            mean = 0.0
            other_mean = 0.0
            for i in range(count):
                for line in range(lines):
                    total += abs(first[i, line] - second[i, line])
                    mean += first[i, line]
                    other_mean += second[i, line]
            mean *= share
            other_mean *= share
            away = 0.0
            for i in range(count):
                for line in range(lines):
                    away += abs(first[i, line] - mean) + abs(second[i, line] - other_mean)
            difference[k, lens] = total * share
            contrast[k, lens] = away * share


def _log_gains(differences: Floats, contrasts: Floats) -> tuple[float, float]:
    """Logarithm of the gain of the right shifts over all, and of no shift; arguments are
    (directions, shifts, lenses).

    The right shift is the best one of all lenses and directions, or, of a scene with several
    depths, that of each lens in the other directions. The former proves less where it is zero, as
    that of rims and dirt is. Nothing is gained if all differ least next to the farthest shifts:
    there they may go on to fall.
    """
    contrasts = contrasts + 0.02 * float(contrasts.mean()) + 1e-6
    curve = differences.sum((0, 2)) / contrasts.sum((0, 2))
    usual = float(differences.sum() / contrasts.sum()) + 1e-3
    middle = len(curve) // 2
    still = float(np.log(usual / (curve[middle] + 1e-3)))
    best = int(curve.argmin())
    if not _ENDS <= best < len(curve) - _ENDS:
        return 0.0, still
    least = float(curve[best])
    if len(differences) > 1:
        ratios = differences / contrasts
        others = (ratios.sum(0) - ratios).argmin(1)
        chosen = np.arange(len(ratios))[:, None], others, np.arange(ratios.shape[2])
        own = float(differences[chosen].sum() / contrasts[chosen].sum())
        least = own if best == middle else min(own, least)
    return float(np.log(usual / (least + 1e-3))), still
