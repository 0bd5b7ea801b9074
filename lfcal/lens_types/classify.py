"""Find the interleaved lens types of a microlens array from one flat.

Lenses of another focal length image the same scene sharper or softer, and their rim, the image of
the main aperture, with another blur. Each lens is compared with its neighbours, and the differences
are searched for patterns that repeat every two or three lenses. The power that such a pattern
reaches by chance is measured on other repeating patterns of the same lenses: wave vectors that no
mosaic of types has.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..camera.lens_types import LensTypes
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..runtime.arrays import Booleans, Floats, Integers, Singles
from .coarse_disparity import estimate_coarse_disparity
from .focus_order import MIN_SPREAD, find_focus_order
from .lens_sample import (
    LensFeatures,
    LensSample,
    measure_lens_features,
    outlier_limit,
    sample_lenses,
)

# [px] smaller microimages hold too few pixels to distinguish sharp from soft.
MIN_RADIUS = 5.0
# With all neighbours on the flat.
_FEWEST_LENSES = 100
# Other patterns that noise is measured on, and how many there must be.
_OTHERS = 64
_FEWEST_OTHERS = 24
# Noise reaches twelve times its mean power by exp(-12); the strongest other pattern is detail.
_NOISE = 12
_DETAIL = 3
# If the power of the gradients over that of a mosaic is larger, the scene itself repeats.
_REPEATING = 0.3
# Least differences between types: of the light beyond rims, before them and in the middle, and of
# the logarithm of sharpness; where lattice and pixels beat, of both that beats change.
_OUTER_LIGHT = 0.012
_INNER_LOSS = 0.015
_LEVEL = 0.004
_SHARPNESS = 0.04
_WITH_BEATS = 0.07
# [periods per lens] Distance of other patterns from those of mosaics; distance of beats at most.
_AWAY = 0.05
_BEAT = 0.08
# Periods by which pattern and pixels get out of step over the flat.
_CYCLES = 1.2
# One over the plastic number and its square: their multiples are evenly spread over the square.
_SPREAD = (0.7548776662466927, 0.5698402909980532)

__all__ = ["MIN_RADIUS", "find_lens_types", "is_in_step"]

# Period n and steps p, q of mosaics in which lens (i, j) is of type (p * i + q * j) mod n, but for
# their signs.
_MOSAICS = [
    (3, 1, 2),
    *((n, p, q) for n in (3, 2) for p, q in product(range(2), repeat=2) if p + q > 0),
]
_VECTORS = np.array([(p / period, q / period) for period, p, q in _MOSAICS])


def find_lens_types(
    picture: Singles | StackedCrops, lattice: Lattice, white: bool
) -> LensTypes | None:
    """Classify the lenses of an array by type.

    None if the flat shows no difference: the array has one type, or there is too little to see.

    Mosaics with a period of three lenses (three types, as in hexagonal multi-focus arrays) and of
    two lenses (two or four types) are known, on any lattice. `picture` (h, w), or crops of a white
    image, is as made by `images.preprocessing.sqrt_luminance`; on a `white` image brightness is a
    property of the lens too.
    """
    others = _other_patterns(lattice)
    if lattice.radius < MIN_RADIUS or len(others) < _FEWEST_OTHERS:
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
    strength = _strengths(sample, features, disparity, white, others)
    twos = np.array([period == 2 for period, *_ in _MOSAICS])
    # Two patterns of pairs at once are four types.
    four = np.count_nonzero(strength[twos]) > 1
    if not white:
        strength[_rows_of_equals(lattice) & ~(twos & four)] = 0
    if not strength.any():
        return None
    strongest = int(strength.argmax())
    period, p, q = _MOSAICS[strongest]
    i, j = np.mgrid[0:period, 0:period]
    pairs = period == 2 and four
    cell = i * period + j if pairs else (p * i + q * j) % period
    inner_loss = sample.subtract_neighbours(features.inner_loss)
    beats = _beats(_VECTORS[[strongest]], lattice)[0]
    outer_light = inner_loss
    if not beats:
        outer_light = sample.subtract_neighbours(features.outer_light)
    order = find_focus_order(
        sample, cell, sharpness, disparity, outer_light, inner_loss, features.rim_ratio
    )
    types = np.argsort(order.sequence)[cell]
    return LensTypes(
        types.astype(np.int8),
        order.known,
        order.focus[order.sequence],
        1 - 1 / float(strength.max()),
    )


class _Feature(NamedTuple):
    """A feature that patterns are searched in."""

    values: Floats  # (n,) less that of the neighbours, 0 where it is not known
    least: Floats  # (mosaics,) difference between types below which it does not count


def _strengths(
    sample: LensSample,
    features: LensFeatures,
    disparity: Floats,
    white: bool,
    others: Floats,
) -> Floats:
    """Power (mosaics,) of each mosaic over that of the strongest other pattern.

    It is 0 for mosaics that are not significant.
    """
    vectors = np.vstack([_VECTORS, others])
    waves = _waves(sample.inner, vectors) / _gain(vectors, sample.lattice)
    found = _list_features(sample, features, disparity, white)
    count = len(_MOSAICS)
    # (f, v) 1 on average for noise.
    power = _power(np.array([feature.values for feature in found]), waves)
    gradient = np.array([_differences(sample, one) for one in features.gradient])
    # Gradients do not depend on types: where they have power, the scene repeats.
    scene = np.zeros(count) if white else _power(gradient, waves[:, :count]).max(0)
    strength = np.zeros(count)
    for mosaic in range(count):
        # Twice the amplitude of a wave is about the spread of the types.
        sound = [
            k
            for k, (values, least) in enumerate(found)
            if 2 * abs(values @ waves[:, mosaic]) >= least[mosaic] * (values != 0).sum()
        ]
        ratios = []
        # Each feature by itself, and all together: on a small flat one alone may be too weak.
        for chosen in [[k] for k in sound] + ([sound] if len(sound) > 1 else []):
            total = power[chosen].sum(0)
            here = float(total[mosaic])
            elsewhere = float(total[count:].max())
            strong = here > max(_NOISE, _DETAIL * elsewhere)
            if strong and scene[mosaic] < _REPEATING * here:
                ratios.append(here / elsewhere)
        # Detail of a scene makes pairs more easily than threes: they must show in two features.
        if len(ratios) >= (2 if _MOSAICS[mosaic][0] == 2 and not white else 1):
            strength[mosaic] = max(ratios)
    return strength


def _list_features(
    sample: LensSample, features: LensFeatures, disparity: Floats, white: bool
) -> list[_Feature]:
    # Where lattice and pixels beat, the pixel grid cuts edges differently: only their inner side
    # can be used. On white images it can in any case, where no scene changes it.
    beats = _beats(_VECTORS, sample.lattice)
    outer_light = _differences(sample, features.outer_light)
    inner_loss = _differences(sample, features.inner_loss)
    found = [
        _Feature(outer_light, np.where(beats, _WITH_BEATS, _OUTER_LIGHT)),
        _Feature(inner_loss, np.where(beats | white, _INNER_LOSS, np.inf)),
    ]
    if white:
        level = _differences(sample, features.level)
        return [*found, _Feature(level, np.full(len(beats), _LEVEL))]
    sharpness = _differences(sample, features.sharpness)
    least = np.where(beats, _WITH_BEATS, _SHARPNESS)
    found.append(_Feature(sharpness, least))
    spread = np.nanstd(disparity) if np.isfinite(disparity).sum() >= _FEWEST_LENSES else 0.0
    if spread > MIN_SPREAD:
        # Which type is sharper changes with depth, and may cancel over a whole flat: TempleBoat.
        depth = np.clip(np.nan_to_num((disparity - np.nanmean(disparity)) / spread), -2, 2)
        found.append(_Feature(sharpness * depth, least))
    return found


def _differences(sample: LensSample, feature: Floats) -> Floats:
    """Differences (n,) of a feature of lenses from that of their neighbours.

    They are clipped at `outlier_limit`, and 0 where the feature is not known.
    """
    values = sample.subtract_neighbours(feature)
    limit = outlier_limit(values[np.isfinite(values)])
    return np.clip(np.nan_to_num(values), -limit, limit)


def _rows_of_equals(lattice: Lattice) -> Booleans:
    """(mosaics,) whether neighbours are of one type: no array is made so, lines of text look so."""
    return np.array([((lattice.steps @ (p, q)) % n == 0).any() for n, p, q in _MOSAICS])


def _power(values: Floats, waves: NDArray[np.complex128]) -> Floats:
    """(f, v) power of patterns in values (f, n) over that of noise of the same size."""
    return np.abs(values @ waves) ** 2 / (np.square(values).sum(1, keepdims=True) + 1e-12)


def _waves(indices: Integers, vectors: Floats) -> NDArray[np.complex128]:
    """Complex waves `exp(-2 pi i * index @ vector)` (n, v).

    They are products from one table per axis, which has far fewer indices than there are lenses.
    """
    waves: NDArray[np.complex128] = np.ones((len(indices), len(vectors)), np.complex128)
    for axis in range(2):
        own, where = np.unique(indices[:, axis], return_inverse=True)
        waves *= np.exp(-2j * np.pi * np.outer(own, vectors[:, axis])).take(where, 0)
    return waves


def _gain(vectors: Floats, lattice: Lattice) -> Floats:
    """(v,) factor by which the difference from the neighbours enlarges a pattern."""
    return 1 - np.cos(2 * np.pi * vectors @ lattice.steps.T).mean(1)


def _other_patterns(lattice: Lattice) -> Floats:
    """Wave vectors (v, 2) [periods per lens] that are no mosaics.

    They are as fine as those of mosaics, but far from them and from beats.
    """
    drawn: Floats = np.outer(np.arange(1, 8 * _OTHERS), _SPREAD) % 1
    far = _apart(drawn[:, None] - np.vstack([_VECTORS, -_VECTORS])).max(-1).min(1) > _AWAY
    fine = _gain(drawn, lattice) > 1
    return drawn[far & fine & ~_beats(drawn, lattice)][:_OTHERS]


def _beats(vectors: Floats, lattice: Lattice) -> Booleans:
    """(v,) whether a pattern (v, 2) is a beat of the lattice with the pixels."""
    m, n = np.mgrid[-2:3, -2:3].reshape(2, -1)
    grid = np.column_stack([m, n])[(m != 0) | (n != 0)]
    limit = min(_BEAT, _CYCLES / (min(lattice.image_size) / lattice.pitch))
    near = _apart(vectors[:, None] - grid @ lattice.basis.T).max(-1) < limit
    return near.any(1)


def is_in_step(cell: NDArray[np.int8], lattice: Lattice) -> bool:
    """Whether beats of the lattice with the pixels repeat like the types of a `cell` (m, m)."""
    period = len(cell)
    i, j = np.mgrid[0:period, 0:period]
    alike = [
        n == period
        and len(
            set(zip(((p * i + q * j) % n).ravel().tolist(), cell.ravel().tolist(), strict=True))
        )
        == n
        for n, p, q in _MOSAICS
    ]
    return bool(_beats(_VECTORS[alike], lattice).any())


def _apart(difference: Floats) -> Floats:
    """Distance of wave vectors along each axis, modulo whole periods."""
    return np.abs((difference + 0.5) % 1 - 0.5)
