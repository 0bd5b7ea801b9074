"""Blocks of neighbouring lenses spread over a flat, and features of single lenses: fine contrast, rim, brightness.

Neighbours see nearly the same piece of the scene, so that the difference from them is a property of the lens; a few
thousand lenses are enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..runtime.kernels import kernel

__all__ = ["LensFeatures", "LensSample", "measure_lens_features", "outlier_limit", "sample_lenses"]

# Lenses along a block without its border; whole periods of 2, 3 and 4 lenses.
_SIDE = 12
# Steps of the distance to the centre in which light is summed.
_RINGS = 40
# Blocks of 144 lenses: patterns of a tenth of the scatter stand out by six standard errors.
_BLOCKS = 48
# Zones, as shares of the usable radius. The last two are for a rim whose outer side cannot be used.
_CORE, _BEFORE_RIM, _BEYOND_RIM, _MIDDLE, _EDGE = (0.0, 0.5), (0.75, 0.95), (1.03, 1.12), (0.5, 0.75), (0.8, 0.97)
# Smallest squared contrast of an 8-bit picture of mean 1.
_NOISE = (1 / 256) ** 2


@dataclass(frozen=True)
class LensSample:
    """Blocks of lenses with a border of one lens on each side."""

    lattice: Lattice
    index: NDArray[np.int64]  # (m, side + 2, side + 2, 2) lattice indices
    centre: NDArray[np.float64]  # (m, side + 2, side + 2, 2) [px]
    whole: NDArray[np.bool_]  # (m, side + 2, side + 2) the microimage lies on the flat as a whole
    # (m, side + 2, side + 2, 2) [px] centre in the picture that is read, the flat or crops of it
    place: NDArray[np.float64]

    @cached_property
    def inner(self) -> NDArray[np.int64]:
        """(m * side**2, 2) lattice indices of the lenses without the borders."""
        return self.index[:, 1:-1, 1:-1].reshape(-1, 2)

    def subtract_neighbours(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m * side**2,) values (m, side + 2, side + 2) of lenses less the mean of their neighbours; NaN if one is."""
        stop = values.shape[1] - 1
        near = [values[:, 1 + i : stop + i, 1 + j : stop + j] for i, j in self.lattice.steps]
        return (values[:, 1:-1, 1:-1] - np.mean(near, axis=0)).ravel()


@dataclass(frozen=True)
class LensFeatures:
    """Features of the lenses of a sample, arrays (m, side + 2, side + 2), NaN off the flat."""

    sharpness: NDArray[np.float64]  # logarithm of the mean squared difference of near pixels
    # light just beyond the rim over that just before it, less the mean profile: larger at softer edges
    outer_light: NDArray[np.float64]
    # the same of light missing just before the rim, which depends less on how pixels fall on the edge
    inner_loss: NDArray[np.float64]
    level: NDArray[np.float64]  # logarithm of the mean tone of the core
    # (2, ...) mean difference of near pixels to the right and down; it averages to zero whatever the focus
    gradient: NDArray[np.float64]
    rim_ratio: float  # light just beyond the rim over that just before it, of all lenses together


def outlier_limit(values: NDArray[np.float64]) -> float:
    """Three standard deviations of values (n,), from the median of their sizes; 0 where there are none."""
    return 3.0 * 1.4826 * float(np.median(np.abs(values))) if len(values) else 0.0


def sample_lenses(lattice: Lattice, crops: StackedCrops | None = None) -> LensSample:
    """Blocks of 12 x 12 lenses, evenly spread over the flat or its crops; all lenses of a small flat."""
    if crops is not None and len(crops) > 1:
        return _sample_crops(lattice, crops)
    blocks, count = _blocks(lattice.indices())
    if len(blocks) > _BLOCKS:
        full = 4 * count >= _SIDE**2
        blocks = blocks[full] if full.sum() >= _BLOCKS else blocks
        blocks = blocks[np.unique(np.linspace(0, len(blocks) - 1, _BLOCKS).round().astype(int))]
    index, centre = _block_lenses(lattice, blocks)
    return LensSample(lattice, index, centre, _lie_inside(centre, lattice.image_size, lattice), centre)


def _block_lenses(lattice: Lattice, blocks: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices and centres of the lenses of blocks (m, 2), with their borders."""
    steps = np.arange(-1, _SIDE + 1)
    within = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    index = _SIDE * blocks[:, None, None, :] + within
    return index, lattice.points(index.reshape(-1, 2)).reshape(index.shape)


def _lie_inside(places: NDArray[np.float64], size: tuple[int, int], lattice: Lattice) -> NDArray[np.bool_]:
    """Whether microimages at places (..., 2) lie inside a picture of `size` (width, height) as a whole."""
    reach = _BEYOND_RIM[1] * lattice.radius
    return np.asarray(((places >= reach) & (places <= np.array(size) - 1 - reach)).all(-1))


def _blocks(indices: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Blocks (m, 2) of 12 x 12 lenses that lenses (n, 2) are in, in order, and their number in each."""
    own = indices // _SIDE
    low = own.min(0)
    columns = int(own[:, 1].max() - low[1]) + 1
    key, count = np.unique((own[:, 0] - low[0]) * columns + own[:, 1] - low[1], return_counts=True)
    return np.column_stack(np.divmod(key, columns)) + low, count


def _sample_crops(lattice: Lattice, crops: StackedCrops) -> LensSample:
    """The fullest blocks of each crop."""
    indices, _, crop = crops.lenses(lattice, _BEYOND_RIM[1] * lattice.radius)
    each = -(-_BLOCKS // len(crops))
    blocks, home = [], []
    for number in np.unique(crop):
        found, count = _blocks(indices[crop == number])
        blocks.append(found[np.argsort(-count, kind="stable")[:each]])
        home += [number] * len(blocks[-1])
    index, centre = _block_lenses(lattice, np.concatenate(blocks))
    whole = _lie_inside(centre - crops.corners[home][:, None, None], crops.size, lattice)
    return LensSample(lattice, index, centre, whole, centre - crops.offsets[home][:, None, None])


@kernel(error_model="numpy", share=lambda picture, centres, *_: len(centres))
def _accumulate(begin, end, picture, centres, radius, inside, lag, rows, energy, gradient, light, count):
    """Squared differences and gradients within `inside`, and light by distance to the centre, of each lens."""
    height, width = picture.shape
    rings = light.shape[1]
    per_ring, within = rings / radius, inside * inside
    for lens in range(begin, end):
        cx, cy = centres[lens, 0], centres[lens, 1]
        pairs, square, across, down = 0, 0.0, 0.0, 0.0
        for y in range(max(0, math.ceil(cy - radius)), min(height - 1, math.floor(cy + radius)) + 1, rows):
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


def measure_lens_features(picture: NDArray[np.float32], sample: LensSample) -> LensFeatures:
    """Measure the lenses of a sample.

    Parameters
    ----------
    picture : (h, w) float32
        As made by `images.preprocessing.sqrt_luminance`.
    sample : LensSample
    """
    radius = sample.lattice.radius
    chosen = np.flatnonzero(sample.whole.ravel())
    centres = sample.place.reshape(-1, 2)[chosen]
    # The finest detail of a microlens.
    lag = rows = max(1, round(radius / 14))
    energy, gradient = np.zeros(len(chosen)), np.zeros((2, len(chosen)))
    light, count = np.zeros((2, len(chosen), _RINGS))
    _accumulate(picture, centres, _BEYOND_RIM[1] * radius, 0.7 * radius, lag, rows, energy, gradient, light, count)
    rings = _Rings(light, count)
    level = rings.mean(_CORE)
    # Darker lenses show noise.
    lit = level > 0.03 * np.median(level) if len(level) else np.zeros(0, bool)
    rings = _Rings(light[lit], count[lit])
    chosen, level, energy, gradient = chosen[lit], level[lit], energy[lit], gradient[:, lit]
    outer, rim_ratio = rings.ratio(_BEYOND_RIM, _BEFORE_RIM)
    inner, _ = rings.ratio(_EDGE, _MIDDLE)

    def spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
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


@dataclass(frozen=True)
class _Rings:
    """Light and number of pixels (n, rings) of lenses, up to beyond their rims."""

    light: NDArray[np.float64]
    count: NDArray[np.float64]

    def _zone(self, zone: tuple[float, float]) -> slice:
        return slice(*(round(share / _BEYOND_RIM[1] * _RINGS) for share in zone))

    def mean(self, zone: tuple[float, float]) -> NDArray[np.float64]:
        """(n,) mean light of each lens in a zone."""
        rings = self._zone(zone)
        return self.light[:, rings].sum(1) / np.maximum(self.count[:, rings].sum(1), 1) + _NOISE

    def ratio(self, zone: tuple[float, float], other: tuple[float, float]) -> tuple[NDArray[np.float64], float]:
        """(n,) light in a zone over that in another, less that of the mean profile, and its mean over all lenses."""
        rings = self._zone(zone)
        relative, count = self.light[:, rings] / self.mean(other)[:, None], self.count[:, rings]
        # Which pixels fall on a ring differs from lens to lens; the mean profile allows for that.
        expected = count * (relative.sum(0) / np.maximum(count.sum(0), 1))
        share = float(expected.sum() / max(count.sum(), 1))
        return (relative - expected).sum(1) / np.maximum(count.sum(1), 1), share
