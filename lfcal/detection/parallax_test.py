"""Test that neighbouring microimages show the same content, shifted, as no tiles, print or meshes do.

A microimage shows more of the scene than the step from its lens to the next is wide: its content varies by more than
whole neighbours differ, and comes back in the neighbours, shifted along the step between them by one share of it in all
directions (the disparity). In a pattern of tiles each place belongs to one tile. A picture behind a mesh continues from
one opening to the next and comes back in none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..images.preprocessing import interpolate_linear
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import sample_lenses
from ..runtime.arrays import Floats, Integers, Singles
from ..runtime.errors import RAW_FLAT_ADVICE, CalibrationError

__all__ = ["NeighbourComparison", "check_parallax", "compare_neighbours", "shows_scene"]

_BRIGHT_GAP = 1.25  # most tone of a gap over that of a lens: sheets with holes 2, flattened scenes 1.17
_TEXTURE_WHITE = 0.03  # contrast inside microimages from which on a white image is a scene
_TEXTURE_SCENE = 0.012  # and from which on a scene shows something
_GAIN = 1.3  # least factor by which the right disparity reduces differences: scenes 1.7, patterns 1.2
# Captures of light-field microscopes and quarters of them have 1.5 to 12; pictures behind meshes and tiles up to 1.3.
_UNMOVED_GAIN = 1.4  # least factor by which places across a lens differ more than neighbours alike unmoved


@dataclass(frozen=True)
class NeighbourComparison:
    """Differences of pixels inside microimages and between neighbours, of a picture of mean 1."""

    tone_spread: float  # standard deviation of the mean of a microimage from those of its neighbours, relative
    texture: float  # standard deviation inside a microimage, relative, without what all have in common
    gap_tone: float  # tone half way between neighbours over that inside
    noise: float = np.nan  # mean difference of adjacent pixels in lenses with least detail
    typical_noise: float = np.nan  # the same in half of the lenses
    matched: float = np.nan  # mean difference of neighbours, shifted by the disparity that fits the others best
    unshifted: float = np.nan  # mean difference of neighbours without a shift
    distant: float = np.nan  # mean difference of places inside a microimage as far apart as two microimages
    # difference of neighbours without a shift in the median lens, and that of places across the same microimage
    typical_unshifted: float = np.nan
    typical_across: float = np.nan

    def has_texture(self, white: bool) -> bool:
        """Whether microimages show more than noise."""
        noise = self.typical_noise if white else self.noise
        # The mean distance of two standard normal values is 1.128.
        return self.texture > max((_TEXTURE_WHITE if white else _TEXTURE_SCENE), 2 * noise / 1.128)

    def matches(self) -> bool:
        """Whether the disparity reduces differences, without those of noise, by enough."""
        matched = max(self.matched**2 - self.noise**2, 0)
        return max(min(self.unshifted, self.distant) ** 2 - self.noise**2, 0) >= _GAIN**2 * matched

    def is_alike_unmoved(self) -> bool:
        """Whether neighbours show nearly the same at the same place, as in unfocused cameras, whose `s` is near zero.

        Places across a lens then differ by more, though nearer to each other than neighbours are: a picture behind a
        mesh differs by less. What all lenses have in common, as tiles, is left out before; a few lenses at an outline,
        where neighbours do differ, are not typical.
        """
        unmoved = max(self.typical_unshifted**2 - self.noise**2, 0)
        return self.typical_across**2 - self.noise**2 >= _UNMOVED_GAIN**2 * unmoved


def check_parallax(picture: Singles, lattice: Lattice, white: bool, single: bool = True) -> bool:
    """Whether neighbours are seen to show the same, shifted, which proves them to be microimages.

    False where lenses show next to nothing, noise hides it, or neighbours show nearly the same unmoved, as those of an
    unfocused camera. Raises `CalibrationError` if what repeats on the flat cannot be microimages.

    `picture` (h, w) is as made by `images.preprocessing.sqrt_luminance`, of a `white` image or a scene; the radius of
    the lattice is that of the usable part of the microimages. A mean of several scenes, not a `single` one, has more
    than one disparity in one place.
    """
    found = compare_neighbours(picture, lattice, (_TEXTURE_WHITE if white else _TEXTURE_SCENE))
    if found is None:
        return False
    every = f"every {lattice.pitch:.1f} px"
    if found.gap_tone > _BRIGHT_GAP:
        raise CalibrationError(
            f"a pattern with bright lines or dark dots repeats {every}, not microimages; {RAW_FLAT_ADVICE}"
        )
    if found.tone_spread > max(_TEXTURE_WHITE, found.texture):
        raise CalibrationError(f"tiles of single tones repeat {every}, not microimages; {RAW_FLAT_ADVICE}")
    if not (single and found.has_texture(white)):
        return False
    if found.matches():
        return True
    if found.is_alike_unmoved():
        return False
    raise CalibrationError(
        f"a pattern repeats {every}, but neighbours do not show the same, shifted, as microimages do; {RAW_FLAT_ADVICE}"
    )


def shows_scene(picture: Singles, lattice: Lattice) -> bool:
    """Whether a flat taken for a white image shows a scene: neighbours are seen to show the same, shifted or unmoved.

    `picture` and `lattice` are those of `check_parallax`.
    """
    found = compare_neighbours(picture, lattice, _TEXTURE_WHITE)
    if found is None or not found.texture > _TEXTURE_WHITE:
        return False
    # Fine texture looks like noise, but noise does not match in neighbours.
    return found.matches() or (found.has_texture(True) and found.is_alike_unmoved())


def compare_neighbours(picture: Singles, lattice: Lattice, min_texture: float = 0.0) -> NeighbourComparison | None:
    """Compare lenses with their neighbours, as for `check_parallax`; None where there are too few.

    Shifts are tried only where microimages have more than `min_texture`, else their figures are NaN.
    """
    steps = lattice.steps @ lattice.basis
    nearest, reach = float(np.hypot(*steps.T).min()), float(np.hypot(*steps.T).max())
    indices, centres = sample_lenses(lattice, 1.5 * reach + 1, 450)
    grid = np.linspace(-1, 1, 9)
    core = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    core = core[np.hypot(*core.T) < 1 + 1e-9] * min(0.6 * nearest / 2, 0.7 * lattice.radius)
    values = interpolate_linear(picture, centres[:, None] + core)
    tones = values.mean(1)
    # Stray light beside an array has a sixth of its light.
    lit = tones > 0.45 * np.quantile(tones, 0.95) if len(tones) else np.zeros(0, np.bool_)
    indices, centres, values, tones = indices[lit], centres[lit], values[lit], tones[lit]
    if len(centres) < 24:
        return None
    shape = values / tones[:, None]
    texture = float(np.sqrt(np.median(((shape - np.median(shape, axis=0)) ** 2).mean(1))))
    gap_tone = float(np.median([np.median(interpolate_linear(picture, centres + step / 2) / tones) for step in steps]))
    # Arrays of several lens types repeat after two or three lenses.
    period = 6 if len(indices) >= 360 else 3
    types = indices[:, 0] % period * period + indices[:, 1] % period
    forward = [step for step, index in zip(steps, lattice.steps.tolist(), strict=True) if tuple(index) > (0, 0)]
    spreads = []
    for step in forward:
        both = (interpolate_linear(picture, (centres + side * step)[:, None] + core).mean(1) for side in (-1, 1))
        spreads.append(_spread(sum(np.log(np.maximum(tone, 1e-6) / tones) for tone in both), types))
    tone_spread = float(np.median(spreads))
    if not texture > min_texture:
        return NeighbourComparison(tone_spread, texture, gap_tone)
    if np.median(values, axis=0).min() < 0.05 * np.median(tones):
        # Spots smaller than what is compared show nothing.
        return NeighbourComparison(tone_spread, 0.0, gap_tone)
    near = [step for step in forward if np.hypot(*step) < 1.2 * nearest]
    radius = 0.8 * min(lattice.radius, nearest / 2)
    return NeighbourComparison(tone_spread, texture, gap_tone, *_compare_shifted(picture, centres, near, radius))


def _spread(second_difference: Floats, types: Integers) -> float:
    """Robust standard deviation of single values from their second differences (n,), lens types left out.

    A second difference does not see a slope of the light.
    """
    left = second_difference.copy()
    for kind in np.unique(types):
        left[types == kind] -= np.median(left[types == kind])
    # Half of all squares of standard normal values lie below 0.4549; a second difference has six times the variance.
    return float(np.sqrt(np.median(left**2) / 0.4549 / 6))


def _compare_shifted(picture: Singles, centres: Floats, steps: list[Floats], radius: float) -> tuple[float, ...]:
    """The last seven figures of `NeighbourComparison`, on lines along each of the `steps` to neighbours."""
    samples = 33
    along = np.linspace(-radius, radius, samples)
    spacing = float(along[1] - along[0])
    # Of disparity over step: beyond them too little is common.
    ratios = np.linspace(-0.7, 0.7, 29)
    by_step, distant, across, noise = [], [], [], []
    for step in steps:
        length = float(np.hypot(*step))
        ahead = step / length
        aside = np.array([-ahead[1], ahead[0]])
        offset = along[:, None, None] * ahead + radius * np.array([-0.25, 0, 0.25])[:, None] * aside
        own, other = (interpolate_linear(picture, (centres + far)[:, None, None] + offset) for far in (0 * step, step))
        common = np.median(own, axis=0)
        common /= common.mean()
        own, other = own / common, other / common
        apart = min(max(1, round((length - 2 * radius) / spacing)), samples // 2)
        pixel = min(max(1, round(1 / spacing)), samples // 2)
        distant.append(np.abs(own[:, apart:] - own[:, :-apart]).mean())
        wide = round(0.75 * (samples - 1))
        across.append(np.abs(own[:, wide:] - own[:, :-wide]).mean((1, 2)))
        noise.append(np.abs(own[:, pixel:] - own[:, :-pixel]).mean((1, 2)))
        by_step.append(np.array([_difference(own, other, round(ratio * length / spacing)) for ratio in ratios]))
    table = np.array(by_step)
    matched = []
    for k in range(len(table)):
        # The best disparity of the other neighbours: nothing matches by chance.
        best = np.delete(table, k, axis=0).sum(0).argmin(0)
        matched.append(table[k, best, np.arange(len(centres))].mean())
    unshifted = table[:, len(ratios) // 2].mean(0)
    # Lenses with least detail give the noise.
    plain, typical = np.quantile(np.mean(noise, axis=0), (0.1, 0.5))
    typical_across = np.median(np.mean(across, axis=0))
    figures = plain, typical, np.mean(matched), unshifted.mean(), np.mean(distant), np.median(unshifted), typical_across
    return tuple(map(float, figures))


def _difference(own: Floats, other: Floats, shift: int) -> Floats:
    """(n,) mean difference of lines of a lens and those of its neighbour, `shift` samples further."""
    samples = own.shape[1]
    shift = int(np.clip(shift, 1 - samples, samples - 1))
    if shift < 0:
        own, other, shift = other, own, -shift
    return np.abs(own[:, : samples - shift] - other[:, shift:]).mean((1, 2))
