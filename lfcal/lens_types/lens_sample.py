"""Blocks of neighbouring lenses spread over a flat, and what single lenses show: fine contrast, rim, brightness.

A question about the array as a whole needs a few thousand lenses, not all of them, but each with its neighbours: those
see nearly the same piece of the scene, so that the difference from them is a property of the lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops

__all__ = ["LensFeatures", "LensSample", "measure_lens_features", "sample_lenses"]

# Lenses along a block without its border; whole periods of 2, 3 and 4 lenses.
_SIDE = 12
# Blocks of 144 lenses: contrasts of a tenth of the scatter between lenses then stand out by six standard errors.
_BLOCKS = 48
# Blocks with fewer of their lenses on the flat are left out where others are to be had.
_FULL = 0.25
# Shares of the usable radius: where fine contrast is measured, the core, the light before a rim and just beyond it.
_INSIDE, _CORE, _BEFORE, _BEYOND = 0.7, (0.0, 0.5), (0.75, 0.95), (1.03, 1.12)
# The same for a rim whose far side cannot be used.
_MIDDLE, _EDGE = (0.5, 0.75), (0.8, 0.97)
_RINGS = 40
# Distance of compared pixels, and of rows looked at, over the radius: the finest detail a microlens still draws.
_LAG, _ROWS = 1 / 14, 1 / 14
# Lenses darker than this share of the median show noise.
_DARK = 0.03
# Quantum of an 8-bit picture of mean tone 1: contrasts below it are none.
_QUANTUM = 1 / 256


@dataclass(frozen=True)
class LensSample:
    """Blocks of lenses with a border of one lens on each side.

    Parameters
    ----------
    lattice : Lattice
    index : (m, side + 2, side + 2, 2) int64
        Lattice indices.
    centre : (m, side + 2, side + 2, 2) float64 [px]
    whole : (m, side + 2, side + 2) bool
        The microimage lies on the flat as a whole.
    place : (m, side + 2, side + 2, 2) float64 [px]
        Of the centre in the picture to be read.
    """

    lattice: Lattice
    index: NDArray[np.int64]
    centre: NDArray[np.float64]
    whole: NDArray[np.bool_]
    place: NDArray[np.float64]

    @cached_property
    def inner(self) -> NDArray[np.int64]:
        """(m * side**2, 2) lattice indices of the lenses that are no border."""
        return self.index[:, 1:-1, 1:-1].reshape(-1, 2)

    def subtract_neighbours(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m * side**2,) of `values` (m, side + 2, side + 2): value of a lens minus the mean of its neighbours.

        NaN where one of them is NaN.
        """
        stop = values.shape[1] - 1
        near = [values[:, 1 + i : stop + i, 1 + j : stop + j] for i, j in self.lattice.steps]
        return (values[:, 1:-1, 1:-1] - np.mean(near, axis=0)).ravel()


@dataclass(frozen=True)
class LensFeatures:
    """What the lenses of a sample show, each array (m, side + 2, side + 2) float64, NaN off the flat.

    Parameters
    ----------
    sharpness : logarithm of the mean squared difference of near pixels
    spill : light just beyond the rim over that just before it, less what is common to all lenses
        Larger where the edge of the microimage is softer.
    droop : loss of light just before the rim over that further in, less what is common to all lenses
        The same from the inner side of the edge, where it depends less on how pixels and lenses happen to meet.
    level : logarithm of the mean tone of the core
    tilt : (2, m, side + 2, side + 2), mean difference of near pixels to the right and down
        It has a sign, so that over lenses that see different things its mean is zero whatever their focus.
    falls : float
        Light just beyond the rim over that just before it, of all lenses together.
    """

    sharpness: NDArray[np.float64]
    spill: NDArray[np.float64]
    droop: NDArray[np.float64]
    level: NDArray[np.float64]
    tilt: NDArray[np.float64]
    falls: float


def sample_lenses(lattice: Lattice, parts: StackedCrops | None = None) -> LensSample:
    """Blocks of 12 x 12 lenses, evenly spread over the flat or its parts; all lenses of a small flat."""
    if parts is not None and len(parts) > 1:
        return _sample_of_parts(lattice, parts)
    blocks, count = _blocks(lattice.indices())
    if len(blocks) > _BLOCKS:
        full = count >= _FULL * _SIDE**2
        blocks = blocks[full] if full.sum() >= _BLOCKS else blocks
        blocks = blocks[np.unique(np.linspace(0, len(blocks) - 1, _BLOCKS).round().astype(int))]
    steps = np.arange(-1, _SIDE + 1)
    within = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    index = _SIDE * blocks[:, None, None, :] + within
    centre = lattice.points(index.reshape(-1, 2)).reshape(index.shape)
    reach = _BEYOND[1] * lattice.radius
    whole = ((centre >= reach) & (centre <= np.array(lattice.image_size) - 1 - reach)).all(-1)
    return LensSample(lattice, index, centre, np.asarray(whole), centre)


def _blocks(indices: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Blocks (m, 2) of 12 x 12 lenses that lenses (n, 2) are in, in order, and how many are in each."""
    own = indices // _SIDE
    low = own.min(0)
    columns = int(own[:, 1].max() - low[1]) + 1
    key, count = np.unique((own[:, 0] - low[0]) * columns + own[:, 1] - low[1], return_counts=True)
    return np.column_stack(np.divmod(key, columns)) + low, count


def _sample_of_parts(lattice: Lattice, parts: StackedCrops) -> LensSample:
    """The fullest blocks of each part."""
    reach = _BEYOND[1] * lattice.radius
    indices, _, part = parts.lenses(lattice, reach)
    each = -(-_BLOCKS // len(parts))
    blocks, home = [], []
    for number in np.unique(part):
        found, count = _blocks(indices[part == number])
        blocks.append(found[np.argsort(-count, kind="stable")[:each]])
        home += [number] * len(blocks[-1])
    steps = np.arange(-1, _SIDE + 1)
    within = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    index = _SIDE * np.concatenate(blocks)[:, None, None, :] + within
    centre = lattice.points(index.reshape(-1, 2)).reshape(index.shape)
    inside = centre - parts.corners[home][:, None, None]
    whole = ((inside >= reach) & (inside <= np.array(parts.size) - 1 - reach)).all(-1)
    return LensSample(lattice, index, centre, np.asarray(whole), centre - parts.offsets[home][:, None, None])


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _look(picture, centres, radius, inside, lag, rows, energy, tilt, light, count):
    height, width = picture.shape
    rings = light.shape[1]
    per_ring, within = rings / radius, inside * inside
    for lens in prange(len(centres)):
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
                # Both neighbours and the pixel itself lie within the circle in which contrast is measured.
                if far > within or max(dx, dx + lag) ** 2 + max(dy, dy + lag) ** 2 > within:
                    continue
                right = picture[y, x + lag] - value
                below = picture[y + lag, x] - value
                square += right * right + below * below
                across += right
                down += below
                pairs += 1
        energy[lens] = square / max(2 * pairs, 1)
        tilt[0, lens], tilt[1, lens] = across / max(pairs, 1), down / max(pairs, 1)


def measure_lens_features(picture: NDArray[np.float32], sample: LensSample) -> LensFeatures:
    """Measure the lenses of a sample.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance with mean 1 (`features.tone`).
    sample : LensSample
    """
    radius = sample.lattice.radius
    chosen = np.flatnonzero(sample.whole.ravel())
    centres = sample.place.reshape(-1, 2)[chosen]
    lag, rows = (max(1, round(share * radius)) for share in (_LAG, _ROWS))
    energy, tilt = np.zeros(len(chosen)), np.zeros((2, len(chosen)))
    light, count = np.zeros((2, len(chosen), _RINGS))
    _look(picture, centres, _BEYOND[1] * radius, _INSIDE * radius, lag, rows, energy, tilt, light, count)

    level = _mean(light, count, _CORE)
    lit = level > _DARK * np.median(level) if len(level) else np.zeros(0, bool)
    chosen, level, energy, tilt, light, count = (
        chosen[lit],
        level[lit],
        energy[lit],
        tilt[:, lit],
        light[lit],
        count[lit],
    )
    spill, falls = _beside(light, count, _BEYOND, _BEFORE)
    droop, _ = _beside(light, count, _EDGE, _MIDDLE)

    def spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
        full = np.full((*values.shape[:-1], sample.whole.size), np.nan)
        full[..., chosen] = values
        return full.reshape(values.shape[:-1] + sample.whole.shape)

    return LensFeatures(
        sharpness=spread(np.log(energy + _QUANTUM**2)),
        spill=spread(spill),
        droop=spread(-droop),
        level=spread(np.log(level) / 2),
        tilt=spread(tilt / np.sqrt(level)),
        falls=falls,
    )


def _rings(zone: tuple[float, float]) -> slice:
    """Rings between two shares of the usable radius."""
    return slice(*(round(share / _BEYOND[1] * _RINGS) for share in zone))


def _mean(light: NDArray[np.float64], count: NDArray[np.float64], zone: tuple[float, float]) -> NDArray[np.float64]:
    """(n,) mean light of each lens in a zone."""
    rings = _rings(zone)
    return light[:, rings].sum(1) / np.maximum(count[:, rings].sum(1), 1) + _QUANTUM**2


def _beside(
    light: NDArray[np.float64], count: NDArray[np.float64], zone: tuple[float, float], other: tuple[float, float]
) -> tuple[NDArray[np.float64], float]:
    """(n,) light in a zone over that in another, less what is common to all lenses, and that common share."""
    rings = _rings(zone)
    relative, count = light[:, rings] / _mean(light, count, other)[:, None], count[:, rings]
    # Which pixels fall on a ring differs from lens to lens; the common profile allows for that.
    expected = count * (relative.sum(0) / np.maximum(count.sum(0), 1))
    share = float(expected.sum() / max(count.sum(), 1))
    return (relative - expected).sum(1) / np.maximum(count.sum(1), 1), share
