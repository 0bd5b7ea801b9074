"""Find the interleaved lens types of a microlens array from one flat.

Lenses of another focal length image the same scene sharper or softer, and their rim, the image of the main aperture,
with another blur. Each lens is compared with its neighbours, and the differences are searched for patterns that repeat
every two or three lenses. The power that such a pattern reaches by chance is measured on other repeating patterns of
the same lenses: wave vectors that no mosaic of types has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..camera.lens_types import LensTypes
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from .coarse_disparity import estimate_coarse_disparity
from .focus_order import MIN_SPREAD, find_focus_order
from .lens_sample import LensFeatures, LensSample, measure_lens_features, outlier_limit, sample_lenses

# [px] smaller microimages hold too few pixels to tell sharp from soft.
MIN_RADIUS = 5.0
# With all neighbours on the flat.
_FEWEST_LENSES = 100

__all__ = ["MIN_RADIUS", "find_lens_types", "is_in_step"]

# Period n and steps p, q of mosaics in which lens (i, j) is of type (p * i + q * j) mod n.
_MOSAICS: tuple[tuple[int, ...], ...] = ((3, 1, -1), (3, 1, 1), (3, 1, 0), (3, 0, 1), (2, 1, 1), (2, 1, 0), (2, 0, 1))
_VECTORS = np.array([(p / period, q / period) for period, p, q in _MOSAICS])


def find_lens_types(
    picture: NDArray[np.float32] | StackedCrops,
    lattice: Lattice,
    white: bool,
) -> LensTypes | None:
    """Classify the lenses of an array by type, where there are several.

    Mosaics with a period of three lenses (three types, as in hexagonal multi-focus arrays) and of two lenses (two or
    four types) are known, on any lattice.

    Parameters
    ----------
    picture : (h, w) float32, or crops of a white image
        As made by `images.preprocessing.sqrt_luminance`.
    lattice : Lattice [px]
        With the usable radius of the microimages.
    white : bool
        The flat is a white image, so that brightness is a property of the lens too.

    Returns
    -------
    LensTypes or None
        None where the flat shows no difference between lenses: one type, or too little to see.
    """
    if lattice.radius < MIN_RADIUS:
        return None
    crops = StackedCrops.of(picture)
    sample = sample_lenses(lattice, crops)
    features = measure_lens_features(crops.picture, sample)
    sharpness = sample.subtract_neighbours(features.sharpness)
    if np.isfinite(sharpness).sum() < _FEWEST_LENSES:
        return None
    disparity = np.full(len(sharpness), np.nan)
    if not white:
        disparity = estimate_coarse_disparity(crops.picture, sample)
    if len(_other_patterns(lattice)) < 24:
        return None
    spectrum = _PatternSpectrum.measure(sample, features, disparity, white)
    strength = np.array([spectrum.strength(k) for k in range(len(_MOSAICS))])
    if not strength.any():
        return None
    strongest = int(strength.argmax())
    period = _MOSAICS[strongest][0]
    found = [m[1:] for m, power in zip(_MOSAICS, strength, strict=True) if power > 0 and m[0] == period]
    cell = _cell(period, found if period == 2 else [_MOSAICS[strongest][1:]])
    beats = _beats(_VECTORS[[strongest]], lattice)[0]
    inner_loss = sample.subtract_neighbours(features.inner_loss)
    outer_light = inner_loss if beats else sample.subtract_neighbours(features.outer_light)
    order = find_focus_order(sample, cell, sharpness, disparity, outer_light, inner_loss, features.rim_ratio)
    types = np.argsort(order.sequence)[cell]
    return LensTypes(types.astype(np.int8), order.known, order.focus[order.sequence], 1 - 1 / float(strength.max()))


@dataclass(frozen=True)
class _PatternSpectrum:
    """Power of patterns in several features of the lenses of a sample."""

    values: NDArray[np.float64]  # (f, n) each feature less that of the neighbours, 0 where it is not known
    waves: NDArray[np.complex128]  # (n, v) the patterns: first the mosaics, then others
    power: NDArray[np.float64]  # (f, v) 1 on average for noise
    least: NDArray[np.float64]  # (f, mosaics) difference between types below which a feature does not count
    usable: NDArray[np.bool_]  # (f, mosaics) features that can show a mosaic
    # (mosaics,) power in the gradients, which do not depend on types: the scene repeats
    scene_power: NDArray[np.float64]
    white: bool  # the flat is a white image

    @classmethod
    def measure(
        cls,
        sample: LensSample,
        features: LensFeatures,
        disparity: NDArray[np.float64],
        white: bool,
    ) -> _PatternSpectrum:
        lattice = sample.lattice
        vectors = np.vstack([_VECTORS, _other_patterns(lattice)])
        waves = _waves(sample.inner, vectors) / _gain(vectors, lattice)
        beats = _beats(_VECTORS, lattice)
        # Two colours of a mosaic, or pixels that fall on edges in two ways, look like two types.
        regular = np.any([_beats(_VECTORS, lattice, step, 2.0) for step in (1.0, 0.5)], axis=0)
        sound = ~(regular & [period == 2 for period, _, _ in _MOSAICS])

        def differences(feature: NDArray[np.float64]) -> NDArray[np.float64]:
            return _clip_outliers(sample.subtract_neighbours(feature))

        def threshold(usual: float, beating: float) -> NDArray[np.float64]:
            return np.where(beats, beating, usual)

        # Where lattice and pixels beat, the pixel grid cuts edges differently: only their inner side can be used; on
        # white images it can in any case, where it shows radii that differ, and no scene.
        found = [
            (differences(features.outer_light), threshold(0.012, 0.07), sound),
            (differences(features.inner_loss), np.full(len(beats), 0.015), (beats | white) & sound),
        ]
        if white:
            found.append((differences(features.level), np.full(len(beats), 0.004), sound))
        else:
            sharpness, least = differences(features.sharpness), threshold(0.04, 0.07)
            found.append((sharpness, least, sound))
            spread = np.nanstd(disparity) if np.isfinite(disparity).sum() >= _FEWEST_LENSES else 0.0
            if spread > MIN_SPREAD:
                # Which type is sharper changes with depth, and may cancel over a whole flat.
                depth = np.clip(np.nan_to_num((disparity - np.nanmean(disparity)) / spread), -2, 2)
                found.append((sharpness * depth, least, sound))
        values, least, usable = (np.array(one) for one in zip(*found, strict=True))
        gradient = np.array([differences(one) for one in features.gradient])
        count = len(_MOSAICS)
        scene_power = np.zeros(count) if white else _power(gradient, waves[:, :count]).max(0)
        return cls(values, waves, _power(values, waves), least, usable, scene_power, white)

    def strength(self, mosaic: int) -> float:
        """Power of a mosaic over that of the strongest other pattern, 0 where it is not significant."""
        sound = [int(k) for k in np.flatnonzero(self.usable[:, mosaic]) if self._repeats(int(k), mosaic)]
        found = []
        # Each feature by itself, and all together: on a small flat one alone may be too weak.
        for chosen in [[k] for k in sound] + ([sound] if len(sound) > 1 else []):
            power = self.power[chosen].sum(0)
            here, elsewhere = float(power[mosaic]), float(power[len(_MOSAICS) :].max())
            # Noise reaches twelve times its mean power by exp(-12); detail of scenes is no noise.
            if here > max(12, 3 * elsewhere) and self.scene_power[mosaic] < 0.3 * here:
                found.append(here / elsewhere)
        # Detail of a scene makes pairs more easily than threes: they must show in two features.
        needed = 2 if _MOSAICS[mosaic][0] == 2 and not self.white else 1
        return max(found) if len(found) >= needed else 0.0

    def _repeats(self, feature: int, mosaic: int) -> bool:
        """Whether a mosaic is strong enough in a feature to matter, and the same in two halves of the sample."""
        values, wave = self.values[feature], self.waves[:, mosaic]
        half = np.arange(len(values)) * 16 // len(values) % 2 == 0
        first, second = complex(values[half] @ wave[half]), complex(values[~half] @ wave[~half])
        # Twice the amplitude of a wave is about the spread of the types.
        if 2 * abs(first + second) < self.least[feature, mosaic] * int((values != 0).sum()):
            return False
        return (first * second.conjugate()).real > 0.7 * abs(first) * abs(second)


def _clip_outliers(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values within `outlier_limit`, and 0 for NaN."""
    limit = outlier_limit(values[np.isfinite(values)])
    return np.clip(np.nan_to_num(values), -limit, limit)


def _power(values: NDArray[np.float64], waves: NDArray[np.complex128]) -> NDArray[np.float64]:
    """(f, v) power of patterns in values (f, n) over that of noise of the same size."""
    return np.abs(values @ waves) ** 2 / (np.square(values).sum(1, keepdims=True) + 1e-12)


def _waves(indices: NDArray[np.int64], vectors: NDArray[np.float64]) -> NDArray[np.complex128]:
    """(n, v) `exp(-2 pi i * index @ vector)`, from a table along each axis, which has far fewer indices than lenses."""
    waves: NDArray[np.complex128] = np.ones((len(indices), len(vectors)), np.complex128)
    for axis in range(2):
        own, where = np.unique(indices[:, axis], return_inverse=True)
        waves *= np.exp(-2j * np.pi * np.outer(own, vectors[:, axis])).take(where, 0)
    return waves


def _gain(vectors: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(v,) factor by which the difference from the neighbours enlarges a pattern."""
    return 1 - np.cos(2 * np.pi * vectors @ lattice.steps.T).mean(1)


def _other_patterns(lattice: Lattice) -> NDArray[np.float64]:
    """(v, 2) wave vectors [periods per lens], as fine as those of mosaics but far from them and from beats."""
    # Multiples of powers of the plastic number are evenly spread over the square.
    drawn = (np.arange(1, 500)[:, None] * [0.7548776662466927, 0.5698402909980532]) % 1
    far = _apart(drawn[:, None] - np.vstack([_VECTORS, -_VECTORS])).max(-1).min(1) > 0.05
    fine = _gain(drawn, lattice) > 1
    return drawn[far & fine & ~_beats(drawn, lattice)][:64]


def _beats(vectors: NDArray[np.float64], lattice: Lattice, step: float = 1.0, cycles: float = 1.2) -> NDArray[np.bool_]:
    """(v,) whether a pattern (v, 2) is a beat of the lattice with the pixels.

    `step` is 1 period per pixel, or 1/2 for a 2 x 2 colour mosaic; `cycles` is how many times
    they may get out of step over the flat.
    """
    m, n = np.mgrid[-2:3, -2:3].reshape(2, -1) * step
    grid = np.column_stack([m, n])[(m != 0) | (n != 0)]
    limit = min(0.08, cycles / (min(lattice.image_size) / lattice.pitch))
    near = _apart(vectors[:, None] - grid @ lattice.basis.T).max(-1) < limit
    return near.any(1)


def is_in_step(cell: NDArray[np.int8], lattice: Lattice) -> bool:
    """Whether beats of the lattice with the pixels repeat like the types of a `cell` (m, m)."""
    period = len(cell)
    i, j = np.mgrid[0:period, 0:period]
    alike = [
        n == period and len(set(zip(((p * i + q * j) % n).ravel().tolist(), cell.ravel().tolist(), strict=True))) == n
        for n, p, q in _MOSAICS
    ]
    return bool(_beats(_VECTORS[alike], lattice).any())


def _apart(difference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of wave vectors along each axis, modulo whole periods."""
    return np.abs((difference + 0.5) % 1 - 0.5)


def _cell(period: int, steps: list[tuple[int, ...]]) -> NDArray[np.int64]:
    """(period, period) provisional types of the lenses of one cell."""
    i, j = np.mgrid[0:period, 0:period]
    if len(steps) > 1:
        return i * period + j
    p, q = steps[0]
    return (p * i + q * j) % period
