"""Blocks of neighbouring lenses, and features of single lenses.

The features are fine contrast, rim and brightness.

Neighbours see nearly the same piece of the scene, so that the difference from them is a property of
the lens; a few thousand lenses are enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.robust_fit import robust_sigma
from ..microimage.lit import UNLIT, is_lit
from ..runtime.arrays import Booleans, Floats, Integers, Singles
from ..runtime.kernels import kernel

__all__ = ["LensFeatures", "LensSample", "measure_lens_features", "outlier_limit", "sample_lenses"]

# Lenses along a block without its border; whole periods of 2, 3 and 4 lenses.
_SIDE = 12
# [radius] to which light is summed, over the distance to the centre.
_REACH = 1.12
# Blocks of lenses.
_BLOCKS = 48
# Rings of light up to that.
_RINGS = 40
# [radius] Disc in which sharpness is measured, and zones just beyond and before the rim, in which
# the light of soft and hard rims differs.
_INNER = 0.7
_BEYOND = (1.03, _REACH)
_BEFORE = (0.75, 0.95)
_RIM = (0.8, 0.97)
_CORE = (0.5, 0.75)
# Finest details of a microlens over its diameter.
_DETAILS = 28
# Smallest squared contrast of a picture of 8 bits and mean 1.
_NOISE = 1 / 65536


@dataclass(frozen=True)
class LensSample:
    """Blocks of lenses with a border of one lens on each side."""

    lattice: Lattice
    index: Integers  # (m, side + 2, side + 2, 2) lattice indices
    centre: Floats  # (m, side + 2, side + 2, 2) [px]
    whole: Booleans  # (m, side + 2, side + 2) the microimage lies on the flat as a whole
    # (m, side + 2, side + 2, 2) [px] centre in the picture that is read, the flat or crops of it
    place: Floats

    @property
    def inner(self) -> Integers:
        """(m * side**2, 2) lattice indices of the lenses without the borders."""
        return self.index[:, 1:-1, 1:-1].reshape(-1, 2)

    def subtract_neighbours(self, values: Floats) -> Floats:
        """Values (m, side + 2, side + 2) of lenses less the mean of their neighbours.

        The result has (m * side**2,) values, NaN if a neighbour is NaN.
        """
        stop = values.shape[1] - 1
        near = [values[:, 1 + i : stop + i, 1 + j : stop + j] for i, j in self.lattice.steps]
        return (values[:, 1:-1, 1:-1] - np.mean(near, axis=0)).ravel()


@dataclass(frozen=True)
class LensFeatures:
    """Features of the lenses of a sample, arrays (m, side + 2, side + 2), NaN off the flat."""

    sharpness: Floats  # logarithm of the mean squared difference of near pixels
    # light just beyond the rim over that just before it, less the mean profile: larger at softer
    # edges
    outer_light: Floats
    # the same of light missing just before the rim, which depends less on how pixels fall on the
    # edge
    inner_loss: Floats
    level: Floats  # logarithm of the mean tone of the core
    # (2, ...) mean difference of near pixels to the right and down; it averages to zero whatever
    # the focus
    gradient: Floats
    rim_ratio: float  # light just beyond the rim over that just before it, of all lenses together


def outlier_limit(values: Floats) -> float:
    """Three standard deviations of values (n,), 0 if there are none.

    The deviation is estimated from the median of the absolute values.
    """
    if len(values):
        return 3.0 * robust_sigma(values)
    return 0.0


def sample_lenses(lattice: Lattice, crops: StackedCrops | None = None) -> LensSample:
    """Choose blocks of 12 x 12 lenses, evenly spread over the flat or its crops.

    All lenses of a small flat are taken.
    """
    reach = _REACH * lattice.radius
    if crops is None:
        crops = StackedCrops(
            np.zeros((0, 0), np.float32), np.zeros((1, 2), np.int64), lattice.image_size
        )
    indices, _, crop = crops.lenses(lattice, 0)
    each = -(-_BLOCKS // len(crops))
    blocks = []
    home = []
    for number in np.unique(crop):
        found, count = np.unique(indices[crop == number] // _SIDE, axis=0, return_counts=True)
        full = 4 * count >= _SIDE**2
        if full.sum() >= each:
            found = found[full]
        chosen = np.unique(
            np.linspace(0, len(found) - 1, min(each, len(found))).round().astype(int)
        )
        blocks.append(found[chosen])
        home += [number] * len(chosen)
    steps = np.arange(-1, _SIDE + 1)
    within = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    index = _SIDE * np.concatenate(blocks)[:, None, None, :] + within
    centre = lattice.points(index.reshape(-1, 2)).reshape(index.shape)
    corner = centre - crops.corners[home][:, None, None]
    whole = np.asarray(((corner >= reach) & (corner <= np.array(crops.size) - 1 - reach)).all(-1))
    return LensSample(lattice, index, centre, whole, centre - crops.offsets[home][:, None, None])


@kernel(error_model="numpy", share=lambda picture, centres, *_: len(centres))
def _accumulate(begin, end, picture, centres, radius, inside, lag, energy, gradient, light, count):
    """Sum squared differences and gradients within `inside`, and light by distance.

    The sums are those of each lens; the distance is that to its centre.
    """
    height, width = picture.shape
    rings = light.shape[1]
    per_ring = rings / radius
    within = inside * inside
    for lens in range(begin, end):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        pairs = 0
        square = 0.0
        across = 0.0
        down = 0.0
        for y in range(
            max(0, math.ceil(cy - radius)), min(height - 1, math.floor(cy + radius)) + 1, lag
        ):
            dy = y - cy
            half = math.sqrt(max(radius * radius - dy * dy, 0.0))
            for x in range(max(0, math.ceil(cx - half)), min(width - 1, math.floor(cx + half)) + 1):
                dx = x - cx
                value = picture[y, x]
                far = dx * dx + dy * dy
                ring = min(int(math.sqrt(far) * per_ring), rings - 1)
                light[lens, ring] += value * value
                count[lens, ring] += 1
                # The pixel and both that it is compared with lie within the circle.
                if far > within or max(dx, dx + lag) ** 2 + max(dy, dy + lag) ** 2 > within:
                    continue
                right = picture[y, x + lag] - value
                below = picture[y + lag, x] - value
                square += right * right + below * below
                across += right
                down += below
                pairs += 1
        energy[lens] = square / max(2 * pairs, 1)
        gradient[0, lens], gradient[1, lens] = across / max(pairs, 1), down / max(pairs, 1)


def measure_lens_features(picture: Singles, sample: LensSample) -> LensFeatures:
    """Measure the features of the lenses of a sample.

    `picture` (h, w) is made by `images.preprocessing.sqrt_luminance`.
    """
    radius = sample.lattice.radius
    chosen = np.flatnonzero(sample.whole.ravel())
    centres = sample.place.reshape(-1, 2)[chosen]
    energy = np.zeros(len(chosen))
    gradient = np.zeros((2, len(chosen)))
    light, count = np.zeros((2, len(chosen), _RINGS))
    lag = max(1, round(2 * radius / _DETAILS))
    _accumulate(
        picture, centres, _REACH * radius, _INNER * radius, lag, energy, gradient, light, count
    )

    def zone(low: float, high: float) -> slice:
        return slice(round(low / _REACH * _RINGS), round(high / _REACH * _RINGS))

    def mean(own: slice) -> Floats:
        return light[:, own].sum(1) / np.maximum(count[:, own].sum(1), 1) + _NOISE

    def ratio(own: slice, other: slice) -> tuple[Floats, float]:
        """Light in a zone over that in another zone, less the ratio of the mean profile.

        Also returns the mean over all lenses.
        """
        relative = light[:, own] / mean(other)[:, None]
        pixels = count[:, own]
        # Which pixels fall on a ring differs from lens to lens; the mean profile allows for that.
        expected = pixels * (relative.sum(0) / np.maximum(pixels.sum(0), 1))
        share = float(expected.sum() / max(pixels.sum(), 1))
        return (relative - expected).sum(1) / np.maximum(pixels.sum(1), 1), share

    level = mean(zone(0, 0.5))
    # Sharpness of dark lenses shows noise.
    lit = is_lit(level, UNLIT)
    chosen = chosen[lit]
    level = level[lit]
    energy = energy[lit]
    gradient = gradient[:, lit]
    light = light[lit]
    count = count[lit]
    outer, rim_ratio = ratio(zone(*_BEYOND), zone(*_BEFORE))
    inner, _ = ratio(zone(*_RIM), zone(*_CORE))

    def spread(values: Floats) -> Floats:
        full = np.full((*values.shape[:-1], sample.whole.size), np.nan)
        full[..., chosen] = values
        return full.reshape(values.shape[:-1] + sample.whole.shape)

    return LensFeatures(
        sharpness=spread(np.log(energy + _NOISE)),
        outer_light=spread(outer),
        inner_loss=spread(-inner),
        level=spread(np.log(level) / 2),
        gradient=spread(gradient / np.sqrt(level)),
        rim_ratio=rim_ratio,
    )
