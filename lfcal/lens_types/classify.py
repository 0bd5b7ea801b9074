"""Find out whether a microlens array has several interleaved types, from one flat.

Lenses of another focal length draw the same scene sharper or softer, and show the main aperture, their own rim, with
another blur. Each lens is compared with its neighbours, and the differences are looked through for patterns that repeat
every two or three lenses. What such a pattern may reach by chance is read off other repeating patterns of the same
lenses: wave vectors that no mosaic of types has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..camera.lens_types import LensTypes
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from .coarse_disparity import estimate_coarse_disparity
from .focus_order import find_focus_order
from .lens_sample import LensFeatures, LensSample, measure_lens_features, sample_lenses

__all__ = ["find_lens_types"]

# A mosaic must have so many times the power of the strongest of the other patterns, and of the mean of noise.
# Noise alone reaches the second by exp(-12); the first is for scenes, whose detail is not noise.
_STANDS_OUT, _ABOVE_NOISE = 3.0, 12.0
# Differences between types below which it makes no difference which type a lens is of, or which pixels could feign,
# first in general, then where lattice and pixels beat: contrast, light beyond a rim, light before it, brightness.
_LEAST_CONTRAST, _LEAST_SPILL, _LEAST_DROOP, _LEAST_LEVEL = (0.04, 0.07), (0.012, 0.07), 0.015, 0.004
# Spread of s / D from which on a scene has depth.
_LEAST_SPREAD = 0.02
# Fewer lenses with all neighbours in view show no pattern.
_FEWEST = 100
# Share of the power of a mosaic that what lenses see may have before the scene itself is what repeats.
_SCENE_REPEATS = 0.3
# Patterns of the two halves of the sample must point the same way: cosine of the angle between them.
_AGREE = 0.7
_STRIPES = 16
# A pattern of lenses beats with the pixels if the two get out of step by no more than so many periods over the flat,
# and by no more than so many periods per lens.
_IN_STEP, _NEAR_BEAT = 1.2, 0.08
# Microimages of a smaller radius [px] hold too few pixels to tell sharp from soft.
_LEAST_RADIUS = 5.0
_PATTERNS, _FEWEST_PATTERNS = 64, 24
# Values further out than this many standard deviations count as so far.
_OUTLIER = 3.0
_FINE = 1e-12

# Period n and steps p, q of mosaics in which lens (i, j) is of type (p * i + q * j) mod n.
_MOSAICS: tuple[tuple[int, ...], ...] = ((3, 1, -1), (3, 1, 1), (3, 1, 0), (3, 0, 1), (2, 1, 1), (2, 1, 0), (2, 0, 1))
_VECTORS = np.array([(p / period, q / period) for period, p, q in _MOSAICS])


def find_lens_types(picture: NDArray[np.float32] | StackedCrops, lattice: Lattice, white: bool) -> LensTypes | None:
    """Tell whether an array is made of several lens types and which lens is of which.

    Mosaics with a period of three lenses (three types, as in hexagonal multi-focus arrays) and of two lenses (two or
    four types) are known, on any lattice.

    Parameters
    ----------
    picture : (h, w) float32, or of a white image parts of such
        Square root of the luminance with mean 1 (`features.tone`).
    lattice : Lattice [px]
        With the usable radius of the microimages.
    white : bool
        The flat shows an even surface, so that brightness is a property of the lens too.

    Returns
    -------
    LensTypes or None
        None where the flat shows no difference between lenses: one type, or too little to see.
    """
    if lattice.radius < _LEAST_RADIUS:
        return None
    parts = StackedCrops.of(picture)
    picture = parts.picture
    sample = sample_lenses(lattice, parts)
    features = measure_lens_features(picture, sample)
    sharpness = sample.subtract_neighbours(features.sharpness)
    if np.isfinite(sharpness).sum() < _FEWEST:
        return None
    disparity = np.full(len(sharpness), np.nan) if white else estimate_coarse_disparity(picture, sample)
    if len(_other_patterns(lattice)) < _FEWEST_PATTERNS:
        return None
    evidence = _Evidence.of(sample, features, disparity, white)
    strength = np.array([evidence.strength(k) for k in range(len(_MOSAICS))])
    if not strength.any():
        return None
    strongest = int(strength.argmax())
    period = _MOSAICS[strongest][0]
    found = [m[1:] for m, power in zip(_MOSAICS, strength, strict=True) if power > 0 and m[0] == period]
    cell = _cell(period, found if period == 2 else [_MOSAICS[strongest][1:]])
    beats = _beats(_VECTORS[[strongest]], lattice, 1.0, _IN_STEP)[0]
    droop = sample.subtract_neighbours(features.droop)
    spill = droop if beats else sample.subtract_neighbours(features.spill)
    order = find_focus_order(sample, cell, sharpness, disparity, spill, droop, features.falls)
    types = np.argsort(order.sequence)[cell]
    return LensTypes(types.astype(np.int8), order.known, order.focus[order.sequence], 1 - 1 / float(strength.max()))


def _waves(indices: NDArray[np.int64], vectors: NDArray[np.float64]) -> NDArray[np.complex128]:
    """(n, v) `exp(-2 pi i * index @ vector)`: of far fewer different indices than lenses along each axis."""
    waves: NDArray[np.complex128] = np.ones((len(indices), len(vectors)), np.complex128)
    for axis in range(2):
        own, where = np.unique(indices[:, axis], return_inverse=True)
        waves *= np.exp(-2j * np.pi * np.outer(own, vectors[:, axis])).take(where, 0)
    return waves


@dataclass(frozen=True)
class _Evidence:
    """Power of patterns in several measures of the lenses of a sample.

    Parameters
    ----------
    values : (f, n) float64
        Each measure against that of the neighbours, 0 where it is not known.
    waves : (n, v) complex128
        The patterns: first the mosaics, then others.
    power : (f, v) float64
        1 on average for noise.
    least : (f, mosaics) float64
        Difference between types below which a measure says nothing.
    usable : (f, mosaics) bool
        Measures that speak for a mosaic.
    seen : (mosaics,) float64
        Power of a mosaic in what the lenses see, which knows no type: the scene repeats.
    white : bool
        The flat shows an even surface.
    """

    values: NDArray[np.float64]
    waves: NDArray[np.complex128]
    power: NDArray[np.float64]
    least: NDArray[np.float64]
    usable: NDArray[np.bool_]
    seen: NDArray[np.float64]
    white: bool

    @classmethod
    def of(cls, sample: LensSample, features: LensFeatures, disparity: NDArray[np.float64], white: bool) -> _Evidence:
        lattice = sample.lattice
        vectors = np.vstack([_VECTORS, _other_patterns(lattice)])
        waves = _waves(sample.inner, vectors) / _gain(vectors, lattice)
        beats = _beats(_VECTORS, lattice, 1.0, _IN_STEP)
        # Two colours of a mosaic, or pixels that fall on edges in two ways, look like two types.
        regular = np.any([_beats(_VECTORS, lattice, step, 2.0) for step in (1.0, 0.5)], axis=0)
        feigned = regular & [period == 2 for period, _, _ in _MOSAICS]
        measures = [
            (_clipped(sample.subtract_neighbours(features.spill)), np.where(beats, *_LEAST_SPILL[::-1]), ~feigned),
            # Where lattice and pixels beat, an edge cut by the pixel grid looks like types.
            (_clipped(sample.subtract_neighbours(features.droop)), np.full(len(beats), _LEAST_DROOP), beats & ~feigned),
        ]
        if white:
            level = _clipped(sample.subtract_neighbours(features.level))
            measures.append((level, np.full(len(beats), _LEAST_LEVEL), ~feigned))
        else:
            sharpness = _clipped(sample.subtract_neighbours(features.sharpness))
            least = np.where(beats, *_LEAST_CONTRAST[::-1])
            measures.append((sharpness, least, ~feigned))
            if np.isfinite(disparity).sum() >= _FEWEST and np.nanstd(disparity) > _LEAST_SPREAD:
                # Which type is sharper changes with depth, and may cancel over a whole flat.
                depth = np.clip(np.nan_to_num((disparity - np.nanmean(disparity)) / np.nanstd(disparity)), -2, 2)
                measures.append((sharpness * depth, least, ~feigned))
        values = np.array([m[0] for m in measures])
        tilt = np.array([_clipped(sample.subtract_neighbours(one)) for one in features.tilt])
        seen = np.zeros(len(_MOSAICS)) if white else _power(tilt, waves[:, : len(_MOSAICS)]).max(0)
        usable = np.array([m[2] for m in measures])
        least = np.array([m[1] for m in measures])
        return cls(values, waves, _power(values, waves), least, usable, seen, white)

    def strength(self, mosaic: int) -> float:
        """How many times a mosaic surpasses other patterns, 0 where it is not significant."""
        sound = [int(k) for k in np.flatnonzero(self.usable[:, mosaic]) if self._repeats(int(k), mosaic)]
        found = []
        # Each measure for itself, and all that agree together: on a small flat one alone may be too weak.
        for chosen in [[k] for k in sound] + ([sound] if len(sound) > 1 else []):
            power = self.power[chosen].sum(0)
            here, elsewhere = float(power[mosaic]), float(power[len(_MOSAICS) :].max())
            if here > max(_ABOVE_NOISE, _STANDS_OUT * elsewhere) and self.seen[mosaic] < _SCENE_REPEATS * here:
                found.append(here / elsewhere)
        # Detail of a scene makes pairs more easily than threes: they must show in two measures.
        needed = 2 if _MOSAICS[mosaic][0] == 2 and not self.white else 1
        return max(found) if len(found) >= needed else 0.0

    def _repeats(self, measure: int, mosaic: int) -> bool:
        """Whether a mosaic is strong enough in a measure to matter, and the same in two halves of the sample."""
        values, wave = self.values[measure], self.waves[:, mosaic]
        half = np.arange(len(values)) * _STRIPES // len(values) % 2 == 0
        first, second = complex(values[half] @ wave[half]), complex(values[~half] @ wave[~half])
        # Twice the amplitude of a wave is about the spread of the types it stands for.
        if 2 * abs(first + second) < self.least[measure, mosaic] * int((values != 0).sum()):
            return False
        return (first * second.conjugate()).real > _AGREE * abs(first) * abs(second)


def _clipped(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values with those far out brought nearer, and 0 for NaN."""
    known = values[np.isfinite(values)]
    reach = _OUTLIER * 1.4826 * float(np.median(np.abs(known))) if len(known) else 0.0
    return np.clip(np.nan_to_num(values), -reach, reach)


def _power(values: NDArray[np.float64], waves: NDArray[np.complex128]) -> NDArray[np.float64]:
    """(f, v) power of patterns in values (f, n) over that of noise of the same size."""
    sums = values @ waves
    return np.abs(sums) ** 2 / (np.square(values).sum(1, keepdims=True) + _FINE)


def _gain(vectors: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """(v,) by how much the difference from the neighbours enlarges a pattern."""
    return 1 - np.cos(2 * np.pi * vectors @ lattice.steps.T).mean(1)


def _other_patterns(lattice: Lattice) -> NDArray[np.float64]:
    """(v, 2) wave vectors, in periods per lens, as fine as those of mosaics but far from them and from the pixels'."""
    # Multiples of powers of the plastic number are evenly spread over the square.
    drawn = (np.arange(1, 500)[:, None] * [0.7548776662466927, 0.5698402909980532]) % 1
    far = _apart(drawn[:, None] - np.vstack([_VECTORS, -_VECTORS])).max(-1).min(1) > 0.05
    fine = _gain(drawn, lattice) > 1
    return drawn[far & fine & ~_beats(drawn, lattice, 1.0, _IN_STEP)][:_PATTERNS]


def _beats(vectors: NDArray[np.float64], lattice: Lattice, step: float, cycles: float) -> NDArray[np.bool_]:
    """(v,) whether a pattern (v, 2) is where lattice and pixels beat with each other.

    `step` is 1 period per pixel, or 1/2 for a 2 x 2 colour mosaic; `cycles` is how many times
    they may get out of step over the flat.
    """
    m, n = np.mgrid[-2:3, -2:3].reshape(2, -1) * step
    grid = np.column_stack([m, n])[(m != 0) | (n != 0)]
    across = min(lattice.image_size) / lattice.pitch
    near = _apart(vectors[:, None] - grid @ lattice.basis.T).max(-1) < min(_NEAR_BEAT, cycles / across)
    return near.any(1)


def _apart(difference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of wave vectors along each axis, whole periods left out."""
    return np.abs((difference + 0.5) % 1 - 0.5)


def _cell(period: int, steps: list[tuple[int, ...]]) -> NDArray[np.int64]:
    """(period, period) provisional types of the lenses of one cell."""
    i, j = np.mgrid[0:period, 0:period]
    if len(steps) > 1:
        return i * period + j
    p, q = steps[0]
    return (p * i + q * j) % period
