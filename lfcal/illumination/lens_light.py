"""Light of every lens of a white image: a smooth fall over the field, and lenses that differ from it or are missing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..gain.gain_map import GainMap, count_terms, field_frame
from ..gain.kernel import evaluate_levels, evaluate_shape
from ..gain.vectorized import make_edge_table, relative_light_general, relative_light_round
from ..lattice.cell import cell_normals, cell_row_bounds, row_interval
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import ReadCrop
from ..runtime.fastmath import FAST
from .gain_fit import GainFit
from .gain_terms import field_monomials

__all__ = ["LensLights", "dark_in_scene", "lens_lights"]

# Pixels of a lens that are looked at, and lenses looked at together.
_SAMPLES, _TOGETHER = 48, 256
# Room for the pixels of a lens and for those of a row of them: cells are compact, four times as many are never needed.
_MOST, _ACROSS = 6 * _SAMPLES, 2 * _SAMPLES
# Where every pixel of a row is looked at, so many are read at once, and more than there are if need be.
_AT_ONCE = 8
# Rows are left out rather than pixels of them, which lie side by side: so many times as many.
_ROWS_FIRST = 1.5
# Share of the brightest light of a lens above which pixels tell its light.
_RIM = 0.8
# Standard deviation of normal values over half the range between their quartiles.
_TO_SIGMA = 1.4826
# Share of its mean squared below which single precision shows no variance.
_EVEN = 1e-6
# Degrees of the polynomial tried in turn; each must lower the scatter of the lenses by this share.
_DEGREES = (0, 2, 4, 6)
_LOWERS = 0.03
# Of so many lenses and more, each is looked at in fewer pixels.
_MANY, _FEW_SAMPLES = 1_000_000, 12
# Rows of a flat that are looked at together where it is not held as a whole.
_ROWS = 128
# The polynomial is fitted to so many lenses at most.
_LENSES = 4000
# So many lenses tell what the typical one is like.
_TELLING = 20_000
_OUTLIER = 4.685
# A lens differs where it is so many standard errors off, and by so much.
_SURE, _DIFFERS = 5.0, 0.01
# Pixels of an evenly lit lens scatter by no more than so many times their noise: three standard errors of the scatter.
_UNEVEN = 1.6
# Scatter of lenses below this, or below half their noise, may well be the model's own.
_SCATTERS = 0.003
# Lenses have no light below this share of the brightest ones, or below the second share where the light they have
# is not that of a microimage: its correlation with the shape is below the third.
_DARK, _DIM, _ALIKE = 0.03, 0.25, 0.5
# Lenses with light look like the rest at least so well; below, something else is there. Only where shapes show at all.
_SHAPED = 0.25
# A lens of a scene is missing where its brightest pixel is below this share of the least mean of its neighbours.
_ABSENT = 0.05


@dataclass(frozen=True)
class LensLights:
    """A white image's gain map with the light of all lenses.

    Parameters
    ----------
    gain : GainMap
    brightest : float
        Luminance where the map is 1.
    dark : (m,) int64
        Rows of `lattice.centres()`: lenses in the dark, or where no microimage is.
    """

    gain: GainMap
    brightest: float
    dark: NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def _middle(values, count):
    """Median of the first values and half the range between their quartiles; they are put in order."""
    for k in range(1, count):
        value, place = values[k], k
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2]), 0.5 * (values[3 * count // 4] - values[count // 4])


@njit(cache=True, nogil=True, error_model="numpy")
def _read(picture, y, x, dx, dy, pixels, count):
    """Put distances from the centre and light of a few pixels beside each other into `pixels` (3, k)."""
    # Indices without a sign need no look at it, so that several pixels are moved at once.
    row, start, at, across, down, light = (
        np.uintp(y), np.uintp(x), np.uintp(count), np.uintp(0), np.uintp(1), np.uintp(2)
    )  # fmt: skip
    first, beside = np.float32(dx), np.float32(dy)
    for k in range(np.uintp(_AT_ONCE)):
        pixels[across, at + k] = first + np.float32(np.int32(k))
        pixels[down, at + k] = beside
        pixels[light, at + k] = picture[row, start + k] * picture[row, start + k]


@njit(cache=True, nogil=True, error_model="numpy")
def _pixels(picture, cx, cy, sides, across, down, pixels):
    """Put distances from the centre and light of every so many pixels of a cell into `pixels` (3, k); their number."""
    height, width = picture.shape
    count = 0
    for y in range(max(0, math.ceil(cy + sides[6, 0])), min(height - 1, math.floor(cy + sides[6, 1])) + 1, down):
        dy = y - cy
        low, high = row_interval(dy, sides)
        start = max(0, math.ceil(cx + low))
        stop = min(min(width - 1, math.floor(cx + high)) + 1, start + across * _ACROSS)
        if across == 1 and stop + _AT_ONCE <= width:
            for x in range(start, stop, _AT_ONCE):
                _read(picture, y, x, x - cx, dy, pixels, count + x - start)
            count += max(stop - start, 0)
        else:
            for x in range(start, stop, across):
                pixels[0, count], pixels[1, count], pixels[2, count] = x - cx, dy, picture[y, x] * picture[y, x]
                count += 1
        if count > pixels.shape[1] - _ACROSS - _AT_ONCE:
            break
    return count


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _sums(pixels, count, shape, sums):
    """Sums of shape, light, their squares and product; of their ratios in the bright part, these squared, and number.

    Then the brightest light, and how much more the variances of the ratios are than those of the light.

    The rim tells more of the place of the lens than of its light.
    """
    one, none, rim = np.float32(1), np.float32(0), np.float32(_RIM)
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


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _look(
    picture, top, chosen, centres, sides, across, down, noise, out, field, radius, profile, step, shade, rim, cut
):
    """Per lens: light, pixels it rests on, correlation with the shape, contrast of it, mean, brightest, scatter.

    Only of the `chosen` rows of `centres` and columns of `out`. The first row of `picture` is the row `top` of the
    flat. Where pixels of a lens scatter by no more than by `noise`, as a share of their light, their mean is its light.
    """
    lenses = chosen.shape[0]
    plain = rim.shape[0] == 1 and not cut[4] > 0
    level, rise, table = profile[:-1].astype(np.float32), np.diff(profile).astype(np.float32), make_edge_table()
    for block in prange((lenses + _TOGETHER - 1) // _TOGETHER):
        powers, lens, ratios = np.empty(64), np.empty(7 + rim.shape[0]), np.empty(_MOST)
        pixels, shape, sums = np.empty((3, _MOST), np.float32), np.empty(_MOST, np.float32), np.empty(10)
        ring, spare = np.empty(_MOST, np.int32), np.empty((5, _MOST), np.float32)
        for k in range(block * _TOGETHER, min((block + 1) * _TOGETHER, lenses)):
            n = chosen[k]
            cx, cy = centres[n, 0], centres[n, 1]
            evaluate_shape(cx, cy, field, radius, shade, rim, cut, powers, lens)
            count = _pixels(picture, cx, cy - top, sides, across, down, pixels)
            if plain:
                relative_light_round(pixels, count, lens, level, rise, np.float32((1 - lens[7]) / step), shape, ring)
            else:
                relative_light_general(pixels, count, lens, level, rise, step, cut, table, spare, shape, ring)
            _sums(pixels, count, shape, sums)
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
                # Dust and hot pixels have no say in the median, which is worth two thirds of the pixels.
                number = 0
                for m in range(count):
                    if shape[m] > np.float32(_RIM):
                        ratios[number] = pixels[2, m] / shape[m]
                        number += 1
                out[0, n], out[6, n] = _middle(ratios, number)
                out[1, n] = number * steady / 1.5
            ms, mv = sums[0] / count, sums[1] / count
            spread_s, spread_v = sums[2] / count - ms * ms, sums[4] / count - mv * mv
            even = spread_s < _EVEN * ms * ms or spread_v < _EVEN * mv * mv
            out[2, n] = 0.0 if even else (sums[3] / count - ms * mv) / math.sqrt(spread_s * spread_v)
            out[3, n] = math.sqrt(max(spread_s, 0.0)) / max(ms, 1e-9)
            out[4, n], out[5, n] = mv, sums[8]


def _looked(
    picture: NDArray[np.float32] | ReadCrop, lattice: Lattice, gain: GainMap, centres: NDArray[np.float64],
    noise: NDArray[np.float32],
) -> NDArray[np.float32]:  # fmt: skip
    sides = cell_row_bounds(cell_normals(lattice)[0])
    cell = abs(float(np.linalg.det(lattice.basis)))
    out = np.zeros((7, len(centres)), np.float32)
    each = cell / (_SAMPLES if len(centres) < _MANY else _FEW_SAMPLES)
    across = max(1, round(math.sqrt(each / _ROWS_FIRST)))
    down = max(1, round(each / across))
    shape = gain.shape(lattice)
    if not callable(picture):
        _look(picture, 0, np.arange(len(centres)), centres, sides, across, down, noise, out, *shape)
        return out
    width, height = lattice.image_size
    band = np.clip(centres[:, 1] // _ROWS, 0, (height - 1) // _ROWS).astype(np.uint16)
    order = np.argsort(band, kind="stable")
    ends = np.cumsum(np.bincount(band))
    for number, (start, stop) in enumerate(zip(np.append(0, ends[:-1]).tolist(), ends.tolist(), strict=True)):
        top = max(0, math.floor(number * _ROWS + sides[6, 0]) - 1)
        rows = min(height, math.ceil((number + 1) * _ROWS + sides[6, 1]) + 1) - top
        strip = picture(0, top, width, rows)
        _look(strip, top, order[start:stop], centres, sides, across, down, noise, out, *shape)
    return out


def lens_lights(picture: NDArray[np.float32] | ReadCrop, lattice: Lattice, fit: GainFit) -> LensLights:
    """Light of all lenses of a white image, given the shape of its microimages.

    Parameters
    ----------
    picture : (h, w) float32, or a look at such
        Square root of the luminance (`features.tone`).
    lattice : Lattice [px]
    fit : GainFit
    """
    centres = lattice.centres()
    single = _errors(fit, centres, lattice)
    noise = np.float32(_UNEVEN) * np.sqrt(single * single + np.float32(_DIFFERS**2))
    found = _looked(picture, lattice, fit.gain, centres, noise)
    lights, weight, alike, contrast = found[:4]
    seen = weight > 0
    few = slice(None, None, max(1, len(centres) // _TELLING))
    top = float(np.percentile(lights[few][seen[few]], 95)) if seen[few].any() else 1.0
    lit = seen & (lights > _DARK * top)
    shaped = contrast > 0.1
    both = lit[few] & shaped[few]
    typical = float(np.median(alike[few][both])) if both.any() else 0.0
    lit &= ~(shaped & (alike < min(_ALIKE, 0.6 * typical)) & (lights < _DIM * top))
    lit &= ~(shaped & (alike < min(_SHAPED, 0.4 * typical)))
    if not lit[few].any():
        return LensLights(fit.gain, 1.0, np.zeros(0, np.int64))
    surely = lit & (weight > 0.3 * np.median(weight[few][seen[few]]))
    level = _level(lights, surely, centres, lattice)
    smooth = np.empty(len(centres), np.float32)
    evaluate_levels(centres, field_frame(lattice), level, smooth)
    # Far from all light a polynomial may fall to nothing.
    np.maximum(smooth, np.float32(1e-30), out=smooth)
    error = single / np.sqrt(np.maximum(weight, 1e-9))
    # Dust makes a lens darker in parts, which is no light of the lens.
    uneven = np.float32(_TO_SIGMA) * found[6] > noise * lights
    own = _own(np.where(uneven, np.float32(1), lights / smooth), error, lit, few)
    # 1 at the brightest part of the field, taken where lenses are.
    brightest = float(np.percentile((smooth[few] * own[few])[lit[few]], 99.5))
    level = level.copy()
    level[0] -= math.log(brightest)
    dark = np.flatnonzero(seen & ~lit)
    if np.all(own == 1):
        own = np.zeros(0, np.float32)
    return LensLights(replace(fit.gain, level=level, lens_gain=own), brightest, dark)


def _level(
    lights: NDArray[np.float32], use: NDArray[np.bool_], centres: NDArray[np.float64], lattice: Lattice
) -> NDArray[np.float64]:
    """Robust polynomial through the logarithms of the lights of lenses, of the lowest degree that does."""
    rows = np.flatnonzero(use)
    rows = rows[:: max(1, len(rows) // _LENSES)]
    log = np.log(np.maximum(lights[rows], 1e-12))
    best, least = np.array([float(np.median(log))]) if len(rows) else np.zeros(1), np.inf
    for degree in _DEGREES:
        if len(rows) < 12 * count_terms(degree):
            break
        table = field_monomials(centres[rows], lattice, degree)
        weight = np.ones(len(rows))
        for _ in range(5):
            weighted = weight[:, None] * table
            level = np.linalg.solve(weighted.T @ table + 1e-9 * len(rows) * np.eye(table.shape[1]), weighted.T @ log)
            miss = np.abs(log - table @ level)
            spread = 1.4826 * float(np.median(miss)) + 1e-9
            weight = np.clip(1 - (miss / (_OUTLIER * spread)) ** 2, 0, None) ** 2
        if spread < (1 - _LOWERS) * least:
            best, least = level, spread
    return best


def _errors(fit: GainFit, centres: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float32]:
    """Noise of a single pixel in the bright part of each lens, as a share of the light of the lens."""
    inner = np.arange(len(fit.spread)) * fit.gain.step < 0.6 * fit.gain.radius
    rows, columns = fit.windows.shape
    x, y = (
        np.clip((centres[:, axis] + 0.5) * (number / lattice.image_size[axis]), 0, number - 1).astype(np.uint8)
        for axis, number in ((0, columns), (1, rows))
    )
    return (float(np.median(fit.spread[inner])) * fit.windows).astype(np.float32)[y, x]


def _own(
    ratio: NDArray[np.float32], error: NDArray[np.float32], lit: NDArray[np.bool_], few: slice
) -> NDArray[np.float32]:
    """Light of lenses over the polynomial: 1 where not significantly different, 0 where there is none.

    If lenses scatter by more than their errors, which a `few` tell, each is taken as far as it can be told (James and
    Stein 1961).
    """
    miss = ratio - 1
    spread = 1.4826 * float(np.median(np.abs(miss[few][lit[few]])))
    noise = float(np.median(error[few][lit[few]]))
    true = max(spread**2 - noise**2, 0.0)
    scatters = true > max(_SCATTERS, 0.5 * noise) ** 2
    variance, square = np.float32(true) + error * error, miss * miss
    believed = np.float32(true) / variance if scatters else np.zeros_like(miss)
    differs = (square > np.float32(_SURE**2) * variance) & (square > np.float32(_DIFFERS**2))
    believed[differs] = 1
    return np.where(lit, np.maximum(1 + believed * miss, np.float32(0.01)), np.float32(0))


def dark_in_scene(picture: NDArray[np.float32], lattice: Lattice, gain: GainMap) -> NDArray[np.int64]:
    """(m,) rows of lenses without any light amid neighbours that have some, on a scene capture."""
    centres = lattice.centres()
    found = _looked(picture, lattice, gain, centres, np.full(len(centres), np.inf, np.float32))
    mean, most = found[4:6]
    indices = lattice.indices()
    low = indices.min(0) - 1
    span = indices.max(0) - low + 2
    grid = np.full((span[1], span[0]), np.inf)
    column, row = (indices - low).T
    grid[row, column] = mean
    least = np.full(len(indices), np.inf)
    around = np.zeros(len(indices), int)
    for i, j in lattice.steps:
        beside = grid[row + j, column + i]
        around += np.isfinite(beside)
        least = np.minimum(least, beside)
    return np.flatnonzero((around == len(lattice.steps)) & (most < _ABSENT * least))
