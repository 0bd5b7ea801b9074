"""Light of every lens of a white image: a smooth polynomial of the field, and lenses that differ from it or are unlit.

The light of a lens is the mean ratio of its pixels to the shape of its microimage, or their median if dust or hot
pixels scatter them. A robust polynomial (IRLS with Tukey's biweight) is fitted to the logarithms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..gain.gain_map import GainMap, count_terms, field_frame
from ..gain.kernel import RIM_START, evaluate_levels, evaluate_shape
from ..gain.vectorized import make_profile_tables, relative_light_at
from ..lattice.cell import cell_normals, cell_row_bounds, row_interval
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import ReadCrop
from ..runtime.fastmath import FAST
from ..runtime.kernels.jit import kernel
from .estimate import GainFit, field_monomials
from .settings import LIGHT_KERNEL, LIGHTS, LensLightSettings

__all__ = ["LensLights", "find_unlit_in_scene", "measure_lens_lights"]

# Standard deviation of normal values over their median absolute deviation, or half their interquartile range.
_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class LensLights:
    """Gain map of a white image with the light of all lenses.

    Parameters
    ----------
    gain : GainMap
    brightest : float
        Luminance where the map is 1.
    unlit : (m,) int64
        Rows of `lattice.centres()`: lenses without light, or places without a microimage.
    """

    gain: GainMap
    brightest: float
    unlit: NDArray[np.int64]


class _PixelGrid(NamedTuple):
    """Pixels of a cell that are read: sides as in `cell_row_bounds`, step from pixel to pixel and from row to row."""

    sides: NDArray[np.float64]
    across: int
    down: int


class _LensMeasurements(NamedTuple):
    """Of every lens: light, number of pixels it is worth, correlation with the shape, contrast of the shape there, mean
    and maximum of the pixels, standard deviation of the light from pixel to pixel; (n,) float32 each."""

    light: NDArray[np.float32]
    weight: NDArray[np.float32]
    correlation: NDArray[np.float32]
    contrast: NDArray[np.float32]
    mean: NDArray[np.float32]
    largest: NDArray[np.float32]
    scatter: NDArray[np.float32]


@njit(error_model="numpy")
def _median(values, count):
    """Median of the first values and half their interquartile range; sorts them in place."""
    for k in range(1, count):
        value, place = values[k], k
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2]), 0.5 * (values[3 * count // 4] - values[count // 4])


@njit(error_model="numpy")
def _copy_pixels(picture, y, x, dx, dy, pixels, count):
    """Copy a few adjacent pixels, as in `_read_pixels`."""
    # Unsigned indices need no check for counting from the end, so that several pixels are moved at once.
    row, start, at, across, down, light = (
        np.uintp(y), np.uintp(x), np.uintp(count), np.uintp(0), np.uintp(1), np.uintp(2)
    )  # fmt: skip
    first, beside = np.float32(dx), np.float32(dy)
    for k in range(np.uintp(LIGHT_KERNEL.together)):
        pixels[across, at + k] = first + np.float32(np.int32(k))
        pixels[down, at + k] = beside
        pixels[light, at + k] = picture[row, start + k] * picture[row, start + k]


@njit(error_model="numpy")
def _read_pixels(picture, cx, cy, grid, pixels):
    """Write offset x, y from the centre and luminance of the pixels of a cell into `pixels` (3, k); their number."""
    height, width = picture.shape
    sides, across, down = grid.sides, grid.across, grid.down
    most, together = LIGHT_KERNEL.most_across, LIGHT_KERNEL.together
    count = 0
    for y in range(max(0, math.ceil(cy + sides[6, 0])), min(height - 1, math.floor(cy + sides[6, 1])) + 1, down):
        dy = y - cy
        low, high = row_interval(dy, sides)
        start = max(0, math.ceil(cx + low))
        stop = min(min(width - 1, math.floor(cx + high)) + 1, start + across * most)
        if across == 1 and stop + together <= width:
            for x in range(start, stop, together):
                _copy_pixels(picture, y, x, x - cx, dy, pixels, count + x - start)
            count += max(stop - start, 0)
        else:
            for x in range(start, stop, across):
                pixels[0, count], pixels[1, count], pixels[2, count] = x - cx, dy, picture[y, x] * picture[y, x]
                count += 1
        if count > pixels.shape[1] - most - together:
            break
    return count


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _sum_pixels(pixels, count, shape, sums):
    """Sums of shape, light, their squares and product; of the ratios of bright pixels, their squares, and number.

    Then the brightest light, and the sum of the factors by which ratios have more variance than the light. The rim is
    left out of the ratios: it depends more on the place of the lens than on its light.
    """
    one, none, rim = np.float32(1), np.float32(0), np.float32(LIGHT_KERNEL.rim_light)
    ms = mv = mss = msv = mvv = mr = mrr = bright = most = more = none
    for k in range(count):
        s, v = shape[k], pixels[2, k]
        ms += s
        mv += v
        mss += s * s
        msv += s * v
        mvv += v * v
        most = max(most, v)
        inside = one if s > rim else none
        over = inside / max(s, rim)
        ratio = v * over
        mr += ratio
        mrr += ratio * ratio
        bright += inside
        more += over * over
    sums[0], sums[1], sums[2], sums[3], sums[4] = ms, mv, mss, msv, mvv
    sums[5], sums[6], sums[7], sums[8], sums[9] = mr, mrr, bright, most, more


@kernel(error_model="numpy", share=lambda picture, top, chosen, *_: len(chosen))
def _measure_lenses(begin, end, picture, top, chosen, centres, grid, noise, shape, tables, out):
    """Write `_LensMeasurements` of the `chosen` lenses into `out` (7, n).

    `picture` begins at row `top` of the flat; `tables` are `make_profile_tables`. The light is the mean if it scatters
    by no more than `noise` (n,).
    """
    most = LIGHT_KERNEL.most_pixels
    powers, lens, ratios = np.empty(64), np.empty(RIM_START + shape.rim.shape[0]), np.empty(most)
    pixels, light, sums = np.empty((3, most), np.float32), np.empty(most, np.float32), np.empty(10)
    ring, work = np.empty(most, np.int32), np.empty((5, most), np.float32)
    for k in range(begin, end):
        n = chosen[k]
        cx, cy = centres[n, 0], centres[n, 1]
        evaluate_shape(cx, cy, shape, powers, lens)
        count = _read_pixels(picture, cx, cy - top, grid, pixels)
        relative_light_at(pixels, count, lens, shape, tables, work, light, ring)
        _sum_pixels(pixels, count, light, sums)
        bright = sums[7]
        if bright == 0:
            out[:, n] = 0.0
            continue
        mean = sums[5] / bright
        scatter = math.sqrt(max(sums[6] / bright - mean * mean, 0.0))
        steady = bright / sums[9]
        if scatter <= noise[n] * mean:
            out[0, n], out[1, n], out[6, n] = mean, bright * steady, scatter / _TO_SIGMA
        else:
            # Dust and hot pixels do not move the median, which has the variance of two thirds of the pixels.
            number = 0
            for m in range(count):
                if light[m] > np.float32(LIGHT_KERNEL.rim_light):
                    ratios[number] = pixels[2, m] / light[m]
                    number += 1
            out[0, n], out[6, n] = _median(ratios, number)
            out[1, n] = number * steady / 1.5
        ms, mv = sums[0] / count, sums[1] / count
        spread_s, spread_v = sums[2] / count - ms * ms, sums[4] / count - mv * mv
        least = LIGHT_KERNEL.flat_variance
        even = spread_s < least * ms * ms or spread_v < least * mv * mv
        out[2, n] = 0.0 if even else (sums[3] / count - ms * mv) / math.sqrt(spread_s * spread_v)
        out[3, n] = math.sqrt(max(spread_s, 0.0)) / max(ms, 1e-9)
        out[4, n], out[5, n] = mv, sums[8]


def _measure(
    picture: NDArray[np.float32] | ReadCrop, lattice: Lattice, gain: GainMap, centres: NDArray[np.float64],
    noise: NDArray[np.float32], settings: LensLightSettings,
) -> _LensMeasurements:  # fmt: skip
    sides = cell_row_bounds(cell_normals(lattice)[0])
    area = abs(float(np.linalg.det(lattice.basis)))
    out = np.zeros((7, len(centres)), np.float32)
    each = area / (settings.samples if len(centres) < settings.many_lenses else settings.few_samples)
    across = max(1, round(math.sqrt(each / settings.row_preference)))
    grid = _PixelGrid(sides, across, max(1, round(each / across)))
    shape = gain.shape(lattice)
    kinds = _types_of(gain, lattice)

    def measure(part: NDArray[np.float32], top: int, chosen: NDArray[np.int64]) -> None:
        for kind, profile in enumerate(gain.profiles):
            own = chosen[kinds[chosen] == kind] if len(gain.profiles) > 1 else chosen
            tables = make_profile_tables(profile)
            _measure_lenses(part, top, own, centres, grid, noise, shape._replace(profile=profile), tables, out)

    if not callable(picture):
        measure(picture, 0, np.arange(len(centres)))
        return _LensMeasurements(*out)
    width, height = lattice.image_size
    rows = settings.band
    band = np.clip(centres[:, 1] // rows, 0, (height - 1) // rows).astype(np.uint16)
    order = np.argsort(band, kind="stable")
    ends = np.cumsum(np.bincount(band))
    for number, (start, stop) in enumerate(zip(np.append(0, ends[:-1]).tolist(), ends.tolist(), strict=True)):
        top = max(0, math.floor(number * rows + sides[6, 0]) - 1)
        bottom = min(height, math.ceil((number + 1) * rows + sides[6, 1]) + 1)
        measure(picture(0, top, width, bottom - top), top, order[start:stop])
    return _LensMeasurements(*out)


def _types_of(gain: GainMap, lattice: Lattice) -> NDArray[np.int8]:
    """(n,) row of `gain.profiles` of each lens."""
    if not gain.type_cell.size:
        return np.zeros(len(lattice), np.int8)
    i, j = lattice.indices().T % len(gain.type_cell)
    return gain.type_cell[i, j]


def measure_lens_lights(
    picture: NDArray[np.float32] | ReadCrop, lattice: Lattice, fit: GainFit, settings: LensLightSettings = LIGHTS
) -> LensLights:
    """Light of all lenses of a white image, given the shape of its microimages.

    Parameters
    ----------
    picture : (h, w) float32, or a function that reads crops of it
        Square root of the luminance (`images.preprocessing`).
    lattice : Lattice [px]
    fit : GainFit
    settings : LensLightSettings
    """
    centres = lattice.centres()
    single = _pixel_errors(fit, centres, lattice)
    noise = np.float32(settings.unevenness) * np.sqrt(single * single + np.float32(settings.difference**2))
    found = _measure(picture, lattice, fit.gain, centres, noise, settings)
    seen = found.weight > 0
    few = slice(None, None, max(1, len(centres) // settings.typical_lenses))
    lit = _find_lit(found, seen, few, settings)
    if not lit[few].any():
        return LensLights(fit.gain, 1.0, np.zeros(0, np.int64))
    reliable = lit & (found.weight > 0.3 * np.median(found.weight[few][seen[few]]))
    level = _fit_level(found.light, reliable, centres, lattice, settings)
    smooth = np.empty(len(centres), np.float32)
    evaluate_levels(centres, field_frame(lattice), level, smooth)
    # Far from all light a polynomial can be close to 0; squares of the ratio stay finite.
    np.maximum(smooth, np.float32(1e-9) * np.max(found.light), out=smooth)
    # Dust darkens parts of a lens: the lens itself has the light of the polynomial. Rims scatter the light of all.
    scatter = np.float32(_TO_SIGMA) * found.scatter / np.where(lit, found.light, np.float32(1))
    uneven = scatter > np.maximum(noise, np.float32(settings.unevenness) * np.median(scatter[few][lit[few]]))
    # Where the map does not fit, its errors are larger than the noise of the light of a lens.
    error = np.minimum(single, scatter) / np.sqrt(np.maximum(found.weight, 1e-9))
    ratio = found.light / smooth
    ratio[uneven] = 1
    own = _shrink_lens_gain(ratio, error, lit, few, settings)
    # 1 at the brightest part of the field that has lenses.
    brightest = float(np.percentile((smooth[few] * own[few])[lit[few]], 99.5))
    level = level.copy()
    level[0] -= math.log(brightest)
    if np.all(own == 1):
        own = np.zeros(0, np.float32)
    return LensLights(replace(fit.gain, level=level, lens_gain=own), brightest, np.flatnonzero(seen & ~lit))


def _find_lit(
    found: _LensMeasurements, seen: NDArray[np.bool_], few: slice, settings: LensLightSettings
) -> NDArray[np.bool_]:
    """Lenses with light that looks like a microimage, as far as the shape of microimages has contrast."""
    light, correlation = found.light, found.correlation
    top = float(np.percentile(light[few][seen[few]], 95)) if seen[few].any() else 1.0
    lit = seen & (light > settings.unlit * top)
    shaped = found.contrast > settings.least_contrast
    both = lit[few] & shaped[few]
    typical = float(np.median(correlation[few][both])) if both.any() else 0.0
    dim = light < settings.dim * top
    lit &= ~(shaped & (correlation < min(settings.least_correlation, 0.6 * typical)) & dim)
    lit &= ~(shaped & (correlation < min(settings.least_correlation_bright, 0.4 * typical)))
    return lit


def _fit_level(
    lights: NDArray[np.float32], use: NDArray[np.bool_], centres: NDArray[np.float64], lattice: Lattice,
    settings: LensLightSettings,
) -> NDArray[np.float64]:  # fmt: skip
    """Robust polynomial through the logarithms of the lights of lenses, of the lowest sufficient degree (IRLS)."""
    rows = np.flatnonzero(use)
    rows = rows[:: max(1, len(rows) // settings.fitted_lenses)]
    log = np.log(np.maximum(lights[rows], 1e-12))
    best, least = np.array([float(np.median(log))]) if len(rows) else np.zeros(1), np.inf
    for degree in range(0, settings.largest_degree + 1, settings.degree_step):
        if len(rows) < 12 * count_terms(degree):
            break
        table = field_monomials(centres[rows], lattice, degree)
        weight = np.ones(len(rows))
        for _ in range(5):
            weighted = weight[:, None] * table
            level = np.linalg.solve(weighted.T @ table + 1e-9 * len(rows) * np.eye(table.shape[1]), weighted.T @ log)
            miss = np.abs(log - table @ level)
            spread = _TO_SIGMA * float(np.median(miss)) + 1e-9
            weight = np.clip(1 - (miss / (settings.outlier * spread)) ** 2, 0, None) ** 2
        if spread < (1 - settings.improvement) * least:
            best, least = level, spread
    return best


def _pixel_errors(fit: GainFit, centres: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float32]:
    """(n,) noise of a single pixel in the bright part of each lens, as a share of the light of the lens."""
    inner = np.arange(len(fit.spread)) * fit.gain.step < 0.6 * fit.gain.radius
    rows, columns = fit.windows.shape
    x, y = (
        np.clip((centres[:, axis] + 0.5) * (number / lattice.image_size[axis]), 0, number - 1).astype(np.uint8)
        for axis, number in ((0, columns), (1, rows))
    )
    return (float(np.median(fit.spread[inner])) * fit.windows).astype(np.float32)[y, x]


def _shrink_lens_gain(
    ratio: NDArray[np.floating], error: NDArray[np.floating], lit: NDArray[np.bool_], few: slice,
    settings: LensLightSettings,
) -> NDArray[np.float32]:  # fmt: skip
    """Light of lenses over the polynomial: 1 if not significantly different, 0 if unlit.

    If the lenses scatter by more than their errors, differences are shrunk by their errors (James and Stein 1961).
    """
    miss = ratio - 1
    spread = _TO_SIGMA * float(np.median(np.abs(miss[few][lit[few]])))
    noise = float(np.median(error[few][lit[few]]))
    true = max(spread**2 - noise**2, 0.0)
    scatters = true > max(settings.own_scatter, 0.5 * noise) ** 2
    variance, square = np.float32(true) + error * error, miss * miss
    kept = np.float32(true) / variance if scatters else np.zeros_like(miss)
    significant = square > np.float32(settings.significance**2) * variance
    kept[significant & (square > np.float32(settings.difference**2))] = 1
    return np.where(lit, np.maximum(1 + kept * miss, np.float32(0.01)), np.float32(0))


def find_unlit_in_scene(
    picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, settings: LensLightSettings = LIGHTS
) -> NDArray[np.int64]:
    """(m,) rows of the lenses of a scene capture that have no light while all their neighbours have some."""
    centres = lattice.centres()
    found = _measure(picture, lattice, gain, centres, np.full(len(centres), np.inf, np.float32), settings)
    indices = lattice.indices()
    low = indices.min(0) - 1
    span = indices.max(0) - low + 2
    grid = np.full((span[1], span[0]), np.inf)
    column, row = (indices - low).T
    grid[row, column] = found.mean
    least = np.full(len(indices), np.inf)
    neighbours = np.zeros(len(indices), int)
    for i, j in lattice.steps:
        beside = grid[row + j, column + i]
        neighbours += np.isfinite(beside)
        least = np.minimum(least, beside)
    return np.flatnonzero((neighbours == len(lattice.steps)) & (found.largest < settings.missing * least))
