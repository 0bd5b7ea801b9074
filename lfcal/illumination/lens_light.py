"""Light of every lens of a white image: a smooth polynomial of the field, and outliers.

Outliers are unlit lenses and lenses whose light differs from the polynomial.

The light of a lens is the mean ratio of its pixels to the shape of its microimage. A robust
polynomial (IRLS with Tukey's biweight) is fitted to the logarithms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..camera.lens_types import LensTypes
from ..gain.gain_map import GainMap, fit_light
from ..gain.kernel import relative_light
from ..lattice.cell import Cell, is_outside_cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import ReadCrop, neighbour_rows
from ..lattice.robust_fit import robust_sigma
from ..microimage.lit import UNLIT, bright_light
from ..runtime.arrays import Booleans, Floats, Integers, Singles, evenly
from ..runtime.kernels import kernel

__all__ = [
    "LensLights",
    "LensMeasurements",
    "find_unlit_in_scene",
    "fit_lens_lights",
    "measure_lenses",
]

# Least relative light of the pixels that the light of a lens is measured on: darker ones, at the
# rim, depend more on the place of the lens.
_FLAT_TOP = 0.8
# Pixels of each lens that are measured.
_PIXELS = 48
# Rows that are read at once of a flat that is not in memory.
_BAND = 128
# Lenses that percentiles and medians are taken of.
_SAMPLE = 20_000
# Contrast of the shape of a microimage from which on pixels show how much of the light has it.
_CONTRAST = 0.2
# Least share of the light of a lens that has that shape. It is 0.57 at most beside the lit lenses of
# nine white images, and 0.67 at least in these.
_SHAPED = 0.6
# Share of the usual number of pixels that a lens must have for the fit of the polynomial.
_WHOLE = 0.3
# Scatter of lenses that may come from errors of the model.
_MODEL_ERROR = 0.003
# Brightest pixel of an unlit lens of a scene over the mean of its darkest neighbour.
_UNLIT = 0.05
# [standard errors] Differences from the polynomial that are not shrunk, if they are larger than
# those that harm no picture; the latter is also the least light of a lit lens.
_OUTLIER = 5
_FAINTEST = 0.01


@dataclass(frozen=True)
class LensLights:
    """Gain map of a white image with the light of all lenses."""

    gain: GainMap
    brightest: float  # luminance where the map is 1
    # (m,) rows of `lattice.centres()`: lenses without light, or places without a microimage
    unlit: Integers


class LensMeasurements(NamedTuple):
    """Measurements of every lens (n,).

    These are the light, the number of its pixels and their standard deviation, and the light that
    has the shape of microimages: stray light is even.
    """

    light: Singles
    number: Singles
    scatter: Singles
    shaped: Singles


@kernel(error_model="numpy", share=lambda picture, top, chosen, *_: len(chosen))
def _measure_lenses(
    begin, end, picture, top, chosen, centres, lenses, cell, stride, shape, profile, out
):
    """Write `LensMeasurements` of the `chosen` lenses into `out` (4, n).

    `picture` begins at row `top` of the flat.
    """
    height, width = picture.shape
    lens = np.empty(lenses.shape[1])
    step = shape.step
    cut = shape.cut
    reach = cell.circumradius
    for k in range(begin, end):
        n = chosen[k]
        lens[:] = lenses[n]
        cx = centres[n, 0]
        cy = centres[n, 1] - top
        total = squares = inside = every = light = shapes = shapes2 = product = 0.0
        for y in range(
            max(0, math.ceil(cy - reach)), min(height - 1, math.floor(cy + reach)) + 1, stride
        ):
            dy = y - cy
            half = math.sqrt(max(reach * reach - dy * dy, 0.0))
            for x in range(
                max(0, math.ceil(cx - half)), min(width - 1, math.floor(cx + half)) + 1, stride
            ):
                dx = x - cx
                if dx * dx + dy * dy > cell.inradius * cell.inradius and is_outside_cell(
                    dx, dy, cell.normals
                ):
                    continue
                v = picture[y, x] * picture[y, x]
                every += 1
                light += v
                s = relative_light(dx, dy, lens, profile, step, cut)[0]
                shapes += s
                shapes2 += s * s
                product += s * v
                if s > _FLAT_TOP:
                    inside += 1
                    total += v / s
                    squares += (v / s) * (v / s)
        if shapes > 0:
            out[3, n] = light / shapes
            spread = every * shapes2 - shapes * shapes
            if spread > (_CONTRAST * shapes) ** 2:
                out[3, n] = (every * product - shapes * light) / spread
        if inside > 0:
            mean = total / inside
            out[0, n], out[1, n], out[2, n] = (
                mean,
                inside,
                math.sqrt(max(squares / inside - mean * mean, 0.0)),
            )


def measure_lenses(
    picture: Singles | ReadCrop, lattice: Lattice, gain: GainMap, lenses: Floats
) -> LensMeasurements:
    """Measure some pixels of all lenses, which `gain` has described.

    `picture` (h, w), or a function that reads crops of it, is the square root of the luminance.
    """
    centres = lattice.centres()
    cell = Cell.of(lattice)
    out = np.zeros((len(LensMeasurements._fields), len(centres)), np.float32)
    stride = max(1, round(math.sqrt(abs(np.linalg.det(lattice.basis)) / _PIXELS)))
    kinds = np.zeros(len(centres), np.int8)
    if gain.type_cell.size:
        kinds = LensTypes(gain.type_cell).of(lattice.indices())

    def measure(part: Singles, top: int, chosen: Integers) -> None:
        for kind, profile in enumerate(gain.profiles):
            own = chosen
            if len(gain.profiles) > 1:
                own = chosen[kinds[chosen] == kind]
            _measure_lenses(part, top, own, centres, lenses, cell, stride, gain.shape, profile, out)

    if not callable(picture):
        measure(picture, 0, np.arange(len(centres)))
        return LensMeasurements(*out)
    # Bands of rows, as the flat is not in memory.
    width, height = lattice.image_size
    reach = cell.circumradius
    band = np.clip(centres[:, 1] // _BAND, 0, (height - 1) // _BAND).astype(np.int64)
    order = np.argsort(band, kind="stable")
    ends = np.cumsum(np.bincount(band)).tolist()
    for number, (start, stop) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
        top = max(0, math.floor(number * _BAND - reach) - 1)
        bottom = min(height, math.ceil((number + 1) * _BAND + reach) + 1)
        measure(picture(0, top, width, bottom - top), top, order[start:stop])
    return LensMeasurements(*out)


def fit_lens_lights(found: LensMeasurements, lattice: Lattice, gain: GainMap) -> LensLights:
    """Light of all lenses of a white image, given the shape of its microimages."""
    centres = lattice.centres()
    seen = found.number > 0
    light = found.light
    few = evenly(len(centres), _SAMPLE)
    lit = seen & (light > UNLIT * bright_light(light[seen])) & (found.shaped > _SHAPED * light)
    if not lit[few].any():
        return LensLights(gain, 1.0, np.zeros(0, np.int64))
    whole = found.number > _WHOLE * np.median(found.number[few][seen[few]])
    used = np.flatnonzero(lit & whole)
    field = lattice.field_place(centres)
    level = fit_light(light[used], field[used])
    smooth = replace(gain, level=level).light(field).astype(np.float32)
    # Far from all light a polynomial can be close to 0; squares of the ratio stay finite.
    np.maximum(smooth, np.float32(1e-9) * np.max(light), out=smooth)
    ratio = light / smooth
    # Photon noise grows with the root of the light.
    noise = found.scatter / np.maximum(light, np.float32(1e-30)) * np.sqrt(smooth)
    usual = np.median(noise[few][lit[few]])
    # Dust darkens parts of a lens: the lens itself has the light of the polynomial, but where the
    # lit part of the flat ends that of its bright side.
    uneven = lit & (noise > 2 * usual)
    ratio[uneven] = 1
    end = _connected(seen & ~lit, uneven, lattice)
    ratio[end] = np.minimum((light + found.scatter) / smooth, 1)[end]
    # Few pixels scatter little by chance.
    error = np.maximum(noise, usual) / np.sqrt(smooth * np.maximum(found.number, 1))
    own = _shrink_lens_gain(ratio, error, lit, few)
    # 1 at the brightest part of the field that has lenses.
    brightest = float(np.percentile((smooth[few] * own[few])[lit[few]], 99.5))
    level[0] -= math.log(brightest)
    if np.all(own == 1):
        own = np.zeros(0, np.float32)
    return LensLights(
        replace(gain, level=level, lens_gain=own), brightest, np.flatnonzero(seen & ~lit)
    )


def _connected(start: Booleans, way: Booleans, lattice: Lattice) -> Booleans:
    """Which lenses (n,) of the `way` a chain of them connects with lenses of the `start`.

    The start has at least two lenses side by side.
    """
    if not start.any():
        return start
    rows = neighbour_rows(lattice.indices(), lattice.steps)

    def beside(lenses: Booleans) -> Booleans:
        return np.asarray((lenses[rows] & (rows >= 0)).any(0))

    reached = start & beside(start)
    while True:
        more = reached | (way & beside(reached))
        if (more == reached).all():
            return reached & way
        reached = more


def _shrink_lens_gain(
    ratio: NDArray[np.floating], error: NDArray[np.floating], lit: Booleans, few: slice
) -> Singles:
    """Light of lenses over the polynomial: 1 if not significantly different, 0 if unlit.

    If the lenses scatter by more than their errors, differences are shrunk by their errors (James
    and Stein 1961).
    """
    miss = ratio - 1
    spread = robust_sigma(miss[few][lit[few]])
    noise = float(np.median(error[few][lit[few]]))
    true = max(spread**2 - noise**2, 0.0)
    variance = np.float32(true) + error * error
    kept = np.zeros_like(miss)
    if true > max(_MODEL_ERROR, 0.5 * noise) ** 2:
        kept = np.float32(true) / variance
    kept[miss * miss > np.maximum(_OUTLIER**2 * variance, np.float32(_FAINTEST**2))] = 1
    light = np.where(lit, np.maximum(1 + kept * miss, np.float32(_FAINTEST)), 0)
    return light.astype(np.float32)


def find_unlit_in_scene(picture: Singles, lattice: Lattice) -> Integers:
    """Rows (m,) of the lenses of a scene that are dark while all their neighbours are lit.

    `picture` (h, w) is the square root of the luminance.
    """
    import cv2

    # The square inside the circle inside a cell.
    side = int(math.sqrt(2) * Cell.of(lattice).inradius)
    light = picture * picture
    x, y = np.rint(lattice.centres()).astype(np.int64).clip(0, np.array(lattice.image_size) - 1).T
    mean = np.asarray(cv2.blur(light, (side, side)))[y, x]
    largest = np.asarray(cv2.dilate(light, np.ones((side, side), np.uint8)))[y, x]
    rows = neighbour_rows(lattice.indices(), lattice.steps)
    beside = np.where(rows >= 0, mean[rows], np.inf).min(0)
    return np.flatnonzero(largest < _UNLIT * beside)
