"""What neighbouring microimages show: the same places, shifted. Tiles, print and what is seen through a mesh do not.

A microimage shows more of the scene than the step from its lens to the next one is wide: its own content differs from
place to place by more than two neighbours differ as a whole, and it comes back in the neighbours, moved along the step
between them by one share of it in all directions (the disparity). In a pattern of tiles each place belongs to one tile.
A picture behind a mesh goes on from one opening to the next and comes back in none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import sample_lenses
from ..runtime.errors import CalibrationError
from ..runtime.interpolation import interpolate_linear

__all__ = ["NeighbourComparison", "check_parallax", "compare_neighbours", "shows_scene"]

# So many lenses, evenly spread, tell; fewer than the least do not.
_LENSES, _FEWEST = 450, 24
# Radius of the middle of a microimage, as a share of half the distance to the nearest one and of its usable radius,
# and places across it.
_CORE, _WELL_INSIDE, _ACROSS = 0.6, 0.7, 9
# Lenses with less of the tone of a bright one may lie beside the array, where up to a sixth of its light strays.
_DARK = 0.45
# Arrays of several lens types repeat after two or three lenses: classes by which these are told apart, by their number.
_CLASSES = ((6, 360), (3, 0))
# Part of a microimage in which neighbours are compared, as a share of its usable radius, and places along it.
_PART, _PLACES = 0.8, 33
_LINES = (-0.25, 0.0, 0.25)
# Disparities, as shares of the step to the neighbour: beyond, too little of a microimage is left to compare.
_SHARES = np.linspace(-0.7, 0.7, 29)
# Neighbours further than this many times the nearest share too little.
_NEAR = 1.2
# Squared normal deviate that half of all lie below, and mean distance of two normal values over their deviation.
_MEDIAN_SQUARE, _MEAN_DISTANCE = 0.4549, 1.128
# Whole neighbours that differ by less than this are lenses made unlike; more than what one of them shows by this
# factor is beyond what lenses with a common view can: scenes reach 0.8.
_UNLIKE, _MORE = 0.03, 1.3
# Gaps get no light. Cameras that flatten their pictures make those of scenes up to a sixth brighter than lenses.
_BRIGHT_WHITE, _BRIGHT_SCENE = 1.1, 1.25
# What microimages show is seen where it is so much of the tone, in a flat taken for a white image or for a scene, and
# so many times the noise. The lenses with least detail tell the noise; for a white image to be none, half of them.
_SHOWS_WHITE, _SHOWS_SCENE, _OVER_NOISE = 0.03, 0.012, 2.0
_PLAIN = 0.1, 0.5
# Neighbours moved by the disparity are alike this many times better than if not moved: scenes reach 1.7 and more,
# patterns 1.2, noise 1. From the second factor on that is seen whatever the noise.
_ALIKE, _SURELY = 1.3, 1.6
_RAW = "give a raw flat from the sensor, of a camera with a microlens array"


@dataclass(frozen=True)
class NeighbourComparison:
    """How neighbouring microimages are alike.

    Parameters
    ----------
    apart : float
        Standard deviation of the tones of whole microimages from their neighbours, over the mean.
    inside : float
        Standard deviation inside a microimage, what all have in common left out, over the mean.
    border : float
        Tone half way between neighbours over the mean inside.
    noise, rough : float
        Mean difference of neighbouring pixels in lenses with least detail, and in half of the lenses.
    moved : float
        Mean difference of neighbours moved by the disparity that their other neighbours ask for.
    same : float
        Mean difference of neighbours that are not moved.
    across : float
        Mean difference inside a microimage of places as far apart as two microimages are.
    """

    apart: float
    inside: float
    border: float
    noise: float
    rough: float
    moved: float
    same: float
    across: float


def check_parallax(picture: NDArray[np.float32], lattice: Lattice, white: bool, single: bool = True) -> bool:
    """Whether neighbours are seen to show the same, shifted, as nothing but microimages does.

    Where lenses show next to nothing, or noise hides it, that is not seen.

    Parameters
    ----------
    picture : (h, w) float32
        As made by `features.tone`.
    lattice : Lattice [px]
        Its radius is that of the usable part of the microimages.
    white : bool
        Whether the flat is a white image.
    single : bool
        False for the mean of several scenes: what they show has more than one disparity in one place.

    Raises
    ------
    CalibrationError
        If what repeats on the flat cannot be microimages.
    """
    shown = _SHOWS_WHITE if white else _SHOWS_SCENE
    found = compare_neighbours(picture, lattice, shown)
    if found is None:
        return False
    every = f"every {lattice.pitch:.1f} px"
    if found.border > (_BRIGHT_WHITE if white else _BRIGHT_SCENE):
        raise CalibrationError(f"a pattern with bright lines or dark dots repeats {every}, not microimages; {_RAW}")
    if found.apart > max(_UNLIKE, _MORE * found.inside):
        raise CalibrationError(f"tiles of single tones repeat {every}, not microimages; {_RAW}")
    if not (_shows(found, white) and single):
        return False
    if not _alike(found):
        raise CalibrationError(
            f"a pattern repeats {every}, but neighbours do not show the same, shifted, as microimages do; {_RAW}"
        )
    return True


def shows_scene(picture: NDArray[np.float32], lattice: Lattice) -> bool:
    """Whether a flat taken for a white image is one of a scene: neighbours are seen to show the same, shifted.

    `picture` and `lattice` are those of `check_parallax`.
    """
    found = compare_neighbours(picture, lattice, _SHOWS_WHITE)
    if found is None or not found.inside > _SHOWS_WHITE:
        return False
    # Fine texture passes for noise, but noise is not alike in neighbours.
    return _alike(found, _ALIKE if _shows(found, True) else _SURELY)


def _shows(found: NeighbourComparison, white: bool) -> bool:
    """Whether microimages show more than noise."""
    shown, noise = (_SHOWS_WHITE, found.rough) if white else (_SHOWS_SCENE, found.noise)
    return found.inside > max(shown, _OVER_NOISE * noise / _MEAN_DISTANCE)


def _alike(found: NeighbourComparison, factor: float = _ALIKE) -> bool:
    """Whether neighbours moved by the disparity are so many times better alike than any others."""
    # Noise is not alike in any microimages.
    moved = max(found.moved**2 - found.noise**2, 0)
    other = max(min(found.same, found.across) ** 2 - found.noise**2, 0)
    return other >= factor**2 * moved


def compare_neighbours(
    picture: NDArray[np.float32], lattice: Lattice, shown: float = 0.0
) -> NeighbourComparison | None:
    """Compare lenses of a `tone` picture (h, w) with their neighbours; None where there are too few.

    The lattice's radius is that of the usable part of the microimages. What these show is compared only where they vary
    by more than `shown` inside, else its figures are NaN.
    """
    steps = lattice.steps @ lattice.basis
    nearest, reach = float(np.hypot(*steps.T).min()), float(np.hypot(*steps.T).max())
    indices, centres = sample_lenses(lattice, 1.5 * reach + 1, _LENSES)
    if len(centres) < _FEWEST:
        return None
    grid = np.linspace(-1, 1, _ACROSS)
    core = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    core = core[np.hypot(*core.T) < 1 + 1e-9] * min(_CORE * nearest / 2, _WELL_INSIDE * lattice.radius)
    values = interpolate_linear(picture, centres[:, None] + core)
    tones = values.mean(1)
    lit = tones > _DARK * np.quantile(tones, 0.95)
    indices, centres, values, tones = indices[lit], centres[lit], values[lit], tones[lit]
    if len(centres) < _FEWEST:
        return None
    shape = values / tones[:, None]
    inside = float(np.sqrt(np.median(((shape - np.median(shape, axis=0)) ** 2).mean(1))))
    border = float(np.median([np.median(interpolate_linear(picture, centres + step / 2) / tones) for step in steps]))
    forward = [k for k, (i, j) in enumerate(lattice.steps.tolist()) if (i, j) > (0, 0)]
    kinds = _kinds(indices)
    apart = []
    for k in forward:
        both = (interpolate_linear(picture, (centres + side * steps[k])[:, None] + core).mean(1) for side in (-1, 1))
        apart.append(_spread(sum(np.log(np.maximum(tone, 1e-6) / tones) for tone in both), kinds))
    near = [steps[k] for k in forward if np.hypot(*steps[k]) < _NEAR * nearest]
    shifted = (float("nan"),) * 5
    if inside > shown:
        shifted = _shifted(picture, centres, near, _PART * min(lattice.radius, nearest / 2))
    return NeighbourComparison(float(np.median(apart)), inside, border, *shifted)


def _kinds(indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) class of each lens within the period that lens types may have."""
    period = next(n for n, least in _CLASSES if len(indices) >= least)
    kind: NDArray[np.int64] = indices[:, 0] % period * period + indices[:, 1] % period
    return kind


def _spread(bend: NDArray[np.float64], kinds: NDArray[np.int64]) -> float:
    """Standard deviation of single values from their bends (n,), robust, lens types left out.

    A bend is the difference to the sum of two others, so that no slope of the light counts.
    """
    left = bend.copy()
    for kind in np.unique(kinds):
        left[kinds == kind] -= np.median(left[kinds == kind])
    return float(np.sqrt(np.median(left**2) / _MEDIAN_SQUARE / 6))


def _shifted(
    picture: NDArray[np.float32], centres: NDArray[np.float64], steps: list[NDArray[np.float64]], radius: float
) -> tuple[float, float, float, float, float]:
    """The last five figures of `NeighbourComparison`, on lines along each of the `steps` to neighbours."""
    along = np.linspace(-radius, radius, _PLACES)
    spacing = float(along[1] - along[0])
    by_step, within, noise = [], [], []
    for step in steps:
        length = float(np.hypot(*step))
        ahead = step / length
        aside = np.array([-ahead[1], ahead[0]])
        offset = along[:, None, None] * ahead + radius * np.array(_LINES)[:, None] * aside
        own, other = (interpolate_linear(picture, (centres + far)[:, None, None] + offset) for far in (0 * step, step))
        common = np.median(own, axis=0)
        common /= common.mean()
        own, other = own / common, other / common
        apart = min(max(1, round((length - 2 * radius) / spacing)), _PLACES // 2)
        pixel = min(max(1, round(1 / spacing)), _PLACES // 2)
        within.append(np.abs(own[:, apart:] - own[:, :-apart]).mean())
        noise.append(np.abs(own[:, pixel:] - own[:, :-pixel]).mean((1, 2)))
        by_step.append(np.array([_difference(own, other, round(share * length / spacing)) for share in _SHARES]))
    table = np.array(by_step)
    moved = []
    for k in range(len(table)):
        # Chosen by the other neighbours: nothing fits by chance.
        best = np.delete(table, k, axis=0).sum(0).argmin(0)
        moved.append(table[k, best, np.arange(len(centres))].mean())
    same = table[:, len(_SHARES) // 2].mean()
    plain, rough = np.quantile(np.mean(noise, axis=0), _PLAIN)
    return float(plain), float(rough), float(np.mean(moved)), float(same), float(np.mean(within))


def _difference(own: NDArray[np.float64], other: NDArray[np.float64], shift: int) -> NDArray[np.float64]:
    """(n,) mean difference of what lines of a lens show and what those of its neighbour show `shift` places on."""
    places = own.shape[1]
    shift = int(np.clip(shift, 1 - places, places - 1))
    a, b = (own[:, : places - shift], other[:, shift:]) if shift >= 0 else (own[:, -shift:], other[:, : places + shift])
    return np.abs(a - b).mean((1, 2))
