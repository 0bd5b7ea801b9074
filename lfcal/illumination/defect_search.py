"""Find defective pixels of a white image.

They differ from the gain map, and from the same place in other lenses.

Residuals from the gain map are tested pixel by pixel, and as means over small and large squares,
which show dust too faint for single pixels. What the map lacks, such as rims, tone curves or
compression, looks alike in all lenses: a defect also differs from the residuals at the same place
of the nearest lenses by more than these scatter.
"""

from __future__ import annotations

import sys
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from ..gain.gain_map import Defects
from ..gain.rows import RegionGain
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import MAD_TO_SIGMA, SIGNIFICANT
from ..runtime.arrays import ENOUGH_PIXELS, NINE_TENTHS, Booleans, Integers, Singles, evenly
from ..runtime.kernels import kernel
from .lens_light import LensLights

__all__ = ["are_rims", "find_defects"]

# Standard deviation of normal values over the absolute deviation that a tenth of them exceed.
_TENTH_TO_SIGMA = 1 / NormalDist().inv_cdf(NINE_TENTHS[2])
# Levels of light, at each of which the noise is measured.
_LEVELS = 32
# [standard deviations] larger residuals are clipped for means over squares.
_MOST = np.float32(3)
# [px] Sides of the squares over which residuals are averaged.
_SQUARES = (3, 7)
# [px] Errors of the place of rims within a pixel, which lenses share out among pixels by chance.
# With 0.2 to 0.3 px no rim of 22 simulated white images is a defect and no hot pixel is lost, with
# 0.1 px up to 35 are, with 0.4 px 3 % of the hot pixels are lost at 8 bits.
_PLACE = 0.25
# [px] Width of the rings in which defects are counted, and how many of them hold a rim.
_RING = 0.5
_RIM_RINGS = 3
# Pixels that the shares of the rings are measured on.
_SAMPLED = 100_000
_AROUND = np.ones((3, 3), np.uint8)
# Places that are compared at once, so that memory does not grow with the flat.
_PART = 20_000
# Residuals of half a per cent of the light harm no picture; lenses differ by three times as much.
_HARMLESS = 0.005
# Lenses that a place is compared in, every third one each way, as dust may cover neighbours.
_COMPARED = 36
_APART = 3


def find_defects(picture: Singles, lattice: Lattice, lights: LensLights) -> tuple[Defects, float]:
    """Find the defects of a white image.

    Also returns the share of the pixels of lit lenses that differ from the gain map of `lights`.

    `picture` (h, w) is the square root of the luminance.
    """
    import cv2

    residual, clipped, isolated = _compute_residuals(picture, lattice, lights)
    # Beyond the border there is nothing: pixels that count twice would look significant.
    small, large = (
        np.float32(side)
        * np.asarray(cv2.blur(clipped, (side, side), borderType=cv2.BORDER_CONSTANT), np.float32)
        for side in _SQUARES
    )
    bad = np.zeros(picture.shape, np.bool_)
    # Large squares, which are left out, show errors of the map that harm no centre.
    outside = (np.abs(residual) > SIGNIFICANT) | (np.abs(small) > SIGNIFICANT)
    for values in (residual, small, large):
        # Dust takes light away; light patches are glare.
        differs = values < -SIGNIFICANT
        if values is residual:
            differs = np.abs(isolated) > SIGNIFICANT
        if values is large:
            # A large square that reaches over the rim of a speck does not make its middle part of
            # it.
            differs &= small < -3
        places = _places(differs & ~bad)
        for start in range(0, len(places), _PART):
            part = places[start : start + _PART]
            x, y = part[_differs_from_lenses(values, part, lattice)].T
            bad[y, x] = True
        if values is residual:
            bad[bad] = ~are_rims(bad, np.isfinite(residual), lattice)
    pixels = _places(bad).astype(np.int32)
    unlit = lattice.indices()[lights.unlit].astype(np.int32)
    return Defects(pixels, unlit), float(outside.sum() / max(np.isfinite(residual).sum(), 1))


def are_rims(bad: Booleans, lit: Booleans, lattice: Lattice) -> Booleans:
    """Which defects (n,) lie at, or next to, a distance from the centre that many lenses have.

    Where values are cut off, the pixels of rims are lit or dark by chance.
    """
    ring = _rings(_places(lit, _SAMPLED), lattice)[1]
    rings = int(np.ceil(lattice.pitch / _RING))
    share = np.bincount(ring, minlength=rings) / max(len(ring), 1)
    lens, ring = _rings(_places(bad), lattice)
    seen = np.unique(np.column_stack([lens, ring]), axis=0)
    # A speck of dust covers more rings of a lens than a rim does, those in its middle too.
    number, count = np.unique(seen[:, :2], axis=0, return_inverse=True, return_counts=True)[1:]
    narrow = count[number.ravel()] <= _RIM_RINGS
    often = np.bincount(seen[narrow, 2], minlength=len(share))
    expected = len(ring) * share
    rims = often > expected + SIGNIFICANT * np.sqrt(expected + 1)
    return np.convolve(rims, np.ones(3), "same")[ring] > 0


def _places(chosen: Booleans, most: int = sys.maxsize) -> Integers:
    """(n, 2) [px] of the chosen pixels (h, w), or of so many of them, evenly spread."""
    pixels = np.flatnonzero(chosen)
    rows, columns = np.divmod(pixels[evenly(len(pixels), most)], chosen.shape[1])
    return np.column_stack([columns, rows])


def _rings(places: Integers, lattice: Lattice) -> tuple[Integers, Integers]:
    """Indices (n, 2) of the lenses of places (n, 2) [px], and which ring around their centres."""
    lens = np.rint(lattice.to_index(places)).astype(np.int64)
    distance = np.linalg.norm(places - lattice.points(lens), axis=1)
    return lens, (distance / _RING).astype(np.int64)


class _Residuals(NamedTuple):
    """Differences (h, w) of the pixels from the gain map, in standard deviations of those that
    should be as bright; NaN in unlit lenses.
    """

    single: Any
    # Clipped, with mean 0 and 0 in unlit lenses, for means over squares: one bright pixel does not
    # make a square of them a defect
    clipped: Any
    isolated: Any  # less what rims explain that lie beside those of the map


@kernel(error_model="numpy", share=lambda picture, *_: len(picture))
def _standardise(begin, end, picture, gain, lowest, highest, brightest, noise, residuals):
    """Fill the `residuals`; `lowest` and `highest` are the light of the map around each pixel,
    `noise` (4, _LEVELS) are median, deviation, mean of the clipped residual, and weight.
    """
    single, clipped, isolated = residuals
    zero = np.float32(0)
    one = np.float32(1)
    two = np.float32(2)
    least = np.float32(1e-6)
    place = np.float32(_PLACE / 2)
    width = picture.shape[1]
    # Tables are read in a loop of their own: a loop that reads tables is not vectorised.
    expected = np.empty(width, np.float32)
    middle, scale, mean, even = np.empty((4, width), np.float32)
    for y in range(begin, end):
        for x in range(width):
            root = np.sqrt(max(gain[y, x], zero))
            k = min(int(root * np.float32(_LEVELS)), _LEVELS - 1)
            expected[x] = root * brightest
            middle[x] = noise[0, k]
            scale[x] = noise[1, k]
            mean[x] = noise[2, k]
            even[x] = noise[3, k]
        for x in range(width):
            value = picture[y, x]
            low = np.sqrt(max(lowest[y, x], zero)) * brightest
            high = np.sqrt(max(highest[y, x], zero)) * brightest
            left = (value - expected[x] - middle[x]) / scale[x]
            # What lies beyond the light of the map around is not explained by a misplaced rim.
            beyond = (value - min(max(value, low), high)) / scale[x]
            tolerance = (high - low) * place / scale[x]
            # Noise is symmetric in the light of a pixel, not in its root.
            darker = min((value + expected[x]) / max(two * expected[x], least), one)
            of_rim = (left - beyond) / np.sqrt(one + tolerance * tolerance)
            isolated[y, x] = (beyond + of_rim) * darker
            single[y, x] = left
            clipped[y, x] = (min(max(left, -_MOST), _MOST) - mean[x]) * even[x]
        for x in range(width):
            if gain[y, x] == 0:
                single[y, x] = np.nan
                clipped[y, x] = 0


def _compute_residuals(picture: Singles, lattice: Lattice, lights: LensLights) -> _Residuals:
    import cv2

    gain = RegionGain(lights.gain, lattice).at(0, 0, *lattice.image_size, least_light=-np.inf)
    brightest = np.float32(np.sqrt(lights.brightest))
    lowest = np.asarray(cv2.erode(gain, _AROUND), np.float32)
    highest = np.asarray(cv2.dilate(gain, _AROUND), np.float32)
    residuals = _Residuals(*(np.empty_like(picture) for _ in range(3)))
    noise = _measure_noise(picture, gain, brightest)
    _standardise(picture, gain, lowest, highest, brightest, noise, residuals)
    return residuals


def _measure_noise(picture: Singles, gain: Singles, brightest: np.float32) -> Singles:
    """(4, _LEVELS) `noise` of `_standardise`, from a sample of the pixels."""
    sample = evenly(picture.size, ENOUGH_PIXELS)
    light = gain.ravel()[sample]
    root = np.sqrt(np.maximum(light, 0))
    difference = picture.ravel()[sample] - root * brightest
    level = np.minimum((root * _LEVELS).astype(np.uint8), _LEVELS - 1)
    level[light == 0] = _LEVELS
    middle, mean = np.zeros((2, _LEVELS), np.float32)
    scale, even = np.ones((2, _LEVELS), np.float32)
    for k in range(_LEVELS):
        own = difference[level == k]
        if len(own):
            middle[k] = np.median(own)
            # Where noise is cut off at black, more than half of the pixels may have the same value.
            noise = float(
                np.max(
                    np.quantile(np.abs(own - middle[k]), (0.5, 0.9))
                    * (MAD_TO_SIGMA, _TENTH_TO_SIGMA)
                )
            )
            # The root of dark pixels is steep.
            least = _HARMLESS * float(brightest) / np.sqrt((k + 0.5) / _LEVELS)
            scale[k] = max(noise, least)
            even[k] = scale[k] / max(noise, 3 * least)
            # Noise of dark pixels is not symmetric.
            mean[k] = np.clip((own - middle[k]) / scale[k], -_MOST, _MOST).mean()
    return np.stack([middle, scale, mean, even])


def _differs_from_lenses(values: Singles, places: Integers, lattice: Lattice) -> Booleans:
    """Which `places` (n, 2) [px] differ from the same place in the lenses around."""
    height, width = values.shape
    reach = np.arange(-6, 6 + 1)
    steps = np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2)
    order = np.argsort(np.linalg.norm(steps @ lattice.basis, axis=1), kind="stable")
    index = np.rint(lattice.to_index(places)).astype(np.int64)
    offset = places - lattice.points(index)
    compared = index[:, None] + _APART * steps[order[1 : 1 + _COMPARED]]
    # Each lens is compared with at many places: its centre is computed once.
    first = compared.min((0, 1))
    lenses = np.indices(compared.max((0, 1)) - first + 1).transpose(1, 2, 0) + first
    centres = lattice.points(lenses)[tuple((compared - first).transpose(2, 0, 1))]
    beside = centres + offset[:, None]
    x, y = np.rint(beside).astype(np.int64).transpose(2, 0, 1)
    seen = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    others = np.where(seen, values[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)], np.nan)
    # Unlit lenses are not compared; NaN is sorted to the end.
    others.sort(axis=1)
    lit = np.isfinite(others).sum(1)
    ranks = np.rint(np.maximum(lit - 1, 0)[:, None] * NINE_TENTHS).astype(np.int64)
    low, middle, high = np.take_along_axis(others, ranks, axis=1).T
    own = values[places[:, 1], places[:, 0]]
    # Their scatter to the same side: types of lenses, rims.
    spread = np.maximum(_TENTH_TO_SIGMA * np.where(own > middle, high - middle, middle - low), 1)
    beyond = np.abs(own - middle) / spread
    # The light of lenses whose centre is off the flat is not measured: they may be darker by
    # themselves.
    x, y = (places - offset).T
    off = (x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)
    beyond[off] = (own - middle)[off] / (2 * spread[off])
    return (beyond > SIGNIFICANT) & (2 * lit > seen.sum(1))
