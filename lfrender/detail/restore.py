"""Restore the detail of a picture: each place by the filter of its patch size and its power above
the noise.

Lenses blur light. Values that are encoded for display (`is_encoded`) are squared before they are
filtered. The filter works on the mean over the channels; all channels of a pixel change by the same
factor, so that no colours appear.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import DTypeLike, NDArray

from lfcal.runtime.kernels import kernel

from ..data.rendering import Part, PictureGrid
from ..data.surface import Surface
from .filters import SMOOTHING, DetailFilters
from .noise import DARKEST

__all__ = ["HALO", "Places", "choose_filters", "find_places", "restore_detail"]

# Distances of the outer taps of the smoothings over which the power of a band is averaged [px].
_AVERAGING = (1, 1)
#: [px] around a place that its detail depends on.
HALO = sum((*SMOOTHING, *_AVERAGING))
#: [px of the picture] Nothing is restored so near to depth edges. Houses and clutter gain 0.51 dB
#: with 2, 0.60 with 1, 0.58 with 0.5, 0.21 with 0 (nine random scenes at 0.3 pitches a pixel).
_BESIDE_EDGES = 1
# [pitch] Step of the patch size that counts as an edge.
_EDGE = 0.04
# Rows that are restored together.
_STRIP = 128


class Places(NamedTuple):
    """Which filter each pixel of a picture takes."""

    kinds: NDArray[
        np.uint16
    ]  # (r, c) index of the filter on a grid; the last of all restores nothing
    rows: NDArray[np.int64]  # (h,) row of the grid of each row of the picture
    columns: NDArray[np.int64]  # (w,) likewise


class _Lookup(NamedTuple):
    """What kernels look up, by power of the detail (p) and filter (n), as `DetailFilters`."""

    gains: NDArray[np.float32]  # (p, n, 4)
    noise: NDArray[
        np.float32
    ]  # (2, n) of the second band, and of the coarser ones, in the light of white
    per_power: NDArray[np.float32]  # (2, n) power of detail for each unit of power of these
    weakest: np.float32
    per_octave: np.float32
    overshoot: np.float32
    darkest: np.float32
    unit: np.float32  # 1 / white
    encoded: bool
    half: np.float32  # that is added before values are truncated to integers
    top: np.float32  # largest value


def choose_filters(
    filters: DetailFilters, surface: Surface, grid: PictureGrid
) -> NDArray[np.uint16]:
    """Index (r, c) of the filter of each value of the surface; none beside its edges."""
    import cv2

    sizes = surface.patch_size
    each = filters.count // 2
    side = 2 * max(1, round(_BESIDE_EDGES * grid.spacing / surface.spacing)) + 1
    around = np.ones((side, side), np.uint8)
    level = np.abs(sizes) * np.float32(filters.per_ratio / grid.pitch)
    kinds = (np.minimum(level, np.float32(each - 1)) + np.float32(0.5)).astype(np.uint16)
    kinds[sizes > 0] += np.uint16(each)
    kinds[cv2.dilate(sizes, around) - cv2.erode(sizes, around) > _EDGE * grid.pitch] = filters.count
    return kinds


def find_places(
    kinds: NDArray[np.uint16], surface: Surface, grid: PictureGrid, part: Part
) -> Places:
    """Which of the filters of `choose_filters` each pixel of a part of the picture takes."""
    nearest = []
    for k in (0, 1):
        at = np.arange(part[k], part[k + 2])
        node = np.rint(
            (grid.first + grid.spacing * at - surface.first[k]) / surface.spacing
        ).astype(np.int64)
        nearest.append(np.clip(node, 0, kinds.shape[1 - k] - 1))
    return Places(kinds, nearest[1], nearest[0])


def restore_detail(
    image: NDArray[np.float32],
    valid: NDArray[np.bool_],
    places: Places,
    filters: DetailFilters,
    white: float,
    encoded: bool,
    dtype: DTypeLike = np.float32,
    overshoot: float = 0.25,
) -> NDArray[Any]:
    """A picture (h, w, C) as sharp as noise allows, and less noisy. A part with `HALO` gets the
    whole's bits.

    Beside pixels that are not `valid` nothing is restored. Values are about the square root of
    light if they are `encoded`. A pixel may leave the range of the values about it by the share
    `overshoot` of that range: no halos.
    """
    import cv2

    height, _, channels = image.shape
    seen: NDArray[Any] = np.empty((0, 0), np.uint8)
    if not valid.all():
        reach = 2 * sum(SMOOTHING) + 1
        seen = cv2.erode(valid.view(np.uint8), np.ones((reach, reach), np.uint8))
    # No overshoot beside clipped values: lenses blurred more light than these show.
    rows = image.reshape(height, -1)
    unclipped = cv2.inRange(rows, -np.inf, white * (1 - 0.5 / 255))
    if not unclipped.all():
        reach = 2 * 3 + 1
        unclipped = cv2.erode(unclipped, np.ones((reach, (reach - 1) * channels + 1), np.uint8))
    kind = np.dtype(dtype)
    half, top = (0.5, float(np.iinfo(kind).max)) if kind.kind in "ui" else (0.0, np.inf)
    lookup = _Lookup(
        filters.gains,
        filters.noise,
        filters.per_power,
        np.float32(filters.weakest),
        np.float32(filters.per_octave),
        np.float32(overshoot),
        np.float32(DARKEST),
        np.float32(1 / white),
        encoded,
        np.float32(half),
        np.float32(top),
    )
    out = np.empty(image.shape, np.float32)
    steps = np.array((*SMOOTHING, *_AVERAGING))
    _restore_rows(
        rows,
        unclipped,
        out.reshape(height, -1),
        channels,
        seen,
        places,
        lookup,
        steps,
        len(SMOOTHING),
    )
    return out.astype(dtype, copy=False)


# Without fastmath: a part of a picture gets the same bits as the whole, whatever pixels a vector
# loop takes together.
@kernel(error_model="numpy", share=lambda image, *_: (len(image) + _STRIP - 1) // _STRIP)
def _restore_rows(begin, end, image, unclipped, out, channels, seen, places, lookup, steps, bands):
    """Restore strips of rows. Of each smoothing only the last rows are kept, which stay in the
    processor's cache.
    """
    height = len(image)
    width = image.shape[1] // channels
    halo = steps.sum()
    kept = halo + 1
    layers = np.zeros((bands + 1, kept, width), np.float32)
    powers = np.zeros((len(steps) - bands + 1, 2, kept, width), np.float32)
    scratch = np.empty(width + 2 * steps.max(), np.float32)
    kinds = np.empty(width, np.uint32)
    lines = np.empty((9, width), np.float32)
    wide = np.empty((5, width * channels), np.float32)
    for strip in range(begin, end):
        top = strip * _STRIP
        bottom = min((strip + 1) * _STRIP, height)
        first = max(top - halo, 0)
        for newest in range(first, bottom + halo):
            if newest < height:
                _to_light(image[newest], channels, lookup, layers[0, newest % kept])
            # Each smoothing lags behind the one before it by its step.
            y = newest
            for k in range(bands):
                y -= steps[k]
                if first <= y < height:
                    _smooth_at(layers[k], y, first, height, steps[k], scratch, layers[k + 1])
            if first <= y < height:
                _find_power(layers, y % kept, powers[0])
            for k in range(bands, len(steps)):
                y -= steps[k]
                if first <= y < height:
                    for n in range(2):
                        _smooth_at(
                            powers[k - bands, n],
                            y,
                            first,
                            height,
                            steps[k],
                            scratch,
                            powers[k - bands + 1, n],
                        )
            if top <= y < bottom:
                share = lines[0]
                at = y % kept
                _look_up(places, seen, y, lookup.gains.shape[1] - 1, kinds, share)
                _find_factors(layers[-1, at], powers[-1, :, at], share, lookup, kinds, lines)
                _find_ratio(layers, at, lookup, lines)
                above = image[max(y - 1, 0)]
                below = image[min(y + 1, height - 1)]
                _store_row(
                    above, image[y], below, unclipped[y], lines[0], channels, lookup, wide, out[y]
                )


@njit
def _to_light(row, channels, lookup, out):
    """Mean light over the channels of a row of the picture, with white as one."""
    width = len(out)
    unit = lookup.unit
    share = (unit * unit if lookup.encoded else unit) / np.float32(channels)
    # The compiler uses vector instructions for strides it knows.
    if channels == 3 and lookup.encoded:
        for x in range(width):
            r = row[3 * x]
            g = row[3 * x + 1]
            b = row[3 * x + 2]
            out[x] = (r * r + g * g + b * b) * share
    elif channels == 3:
        for x in range(width):
            out[x] = (row[3 * x] + row[3 * x + 1] + row[3 * x + 2]) * share
    else:
        for x in range(width):
            total = np.float32(0)
            for c in range(channels):
                value = row[x * channels + c]
                total += value * value if lookup.encoded else value
            out[x] = total * share


@njit
def _smooth_at(plane, y, first, height, step, scratch, out):
    """Row `y` of `out` (kept, w): the mean of `plane` with the weights 1, 2, 1 along each axis,
    `step` apart.
    """
    kept = len(plane)
    width = plane.shape[1]
    quarter = np.float32(0.25)
    two = np.float32(2)
    above = plane[max(y - step, first) % kept]
    here = plane[y % kept]
    below = plane[min(y + step, height - 1) % kept]
    before = scratch[:width]
    own = scratch[step : step + width]
    after = scratch[2 * step :]
    into = out[y % kept]
    for x in range(width):
        own[x] = quarter * (two * here[x] + above[x] + below[x])
    for k in range(step):
        scratch[k], scratch[step + width + k] = own[0], own[width - 1]
    for x in range(width):
        into[x] = quarter * (two * own[x] + before[x] + after[x])


@njit
def _find_power(layers, at, out):
    """Row `at` of `out` (2, kept, w): square of the second band, and of the two coarser ones
    together.
    """
    one = layers[1, at]
    two = layers[2, at]
    three = layers[3, at]
    last = layers[4, at]
    fine = out[0, at]
    coarse = out[1, at]
    for x in range(len(one)):
        difference = one[x] - two[x]
        fine[x] = difference * difference
    for x in range(len(one)):
        middle = two[x] - three[x]
        wide = three[x] - last[x]
        coarse[x] = middle * middle + wide * wide


@njit
def _look_up(places, seen, y, nothing, kinds, share):
    """Index of the filter of each pixel of row `y`, and how much of it is taken."""
    row = places.kinds[places.rows[y]]
    columns = places.columns
    for x in range(len(kinds)):
        kinds[x] = row[columns[x]]
    for x in range(len(kinds)):
        share[x] = np.float32(1) if kinds[x] < nothing else np.float32(0)
    if len(seen):
        line = seen[y]
        for x in range(len(kinds)):
            share[x] = share[x] if line[x] else np.float32(0)


@njit(error_model="numpy")
def _find_factors(coarsest, power, share, lookup, kinds, lines):
    """Lines 1 to 4: what is added of each band, from a row of the coarsest layer and of the power
    (2, w).
    """
    gains = lookup.gains
    width = len(share)
    darkest = lookup.darkest
    zero = np.float32(0)
    one = np.float32(1)
    tiny = np.float32(1e-20)
    half = np.float32(0.5)
    f0 = lines[1]
    f1 = lines[2]
    f2 = lines[3]
    f3 = lines[4]
    fine = lines[5]
    coarse = lines[6]
    strength = lines[7]
    light = lines[8]
    for x in range(width):
        light[x] = max(coarsest[x], darkest)
    for band in range(2):
        found = power[band]
        noise = lookup.noise[band]
        per_power = lookup.per_power[band]
        above, rest = (fine, f1) if band == 0 else (coarse, f2)
        for x in range(width):
            above[x] = max(found[x] - light[x] * noise[kinds[x]], zero)
        for x in range(width):
            rest[x] = above[x] / max(found[x], tiny) - one
        for x in range(width):
            above[x] *= per_power[kinds[x]]
    # Less of it where fine detail is weaker than the coarse predicts; there noise alone is taken
    # away.
    for x in range(width):
        strength[x] = max(max(fine[x], coarse[x]), tiny)
    for x in range(width):
        fine[x] = share[x] * fine[x] / strength[x]
    for x in range(width):
        strength[x] = max(strength[x] / light[x], tiny)
    # The bits of a number above zero grow with its logarithm.
    logarithm = strength.view(np.int32)
    per_bit = lookup.per_octave / np.float32(1 << 23)
    last = np.float32(len(gains) - 1)
    weakest = lookup.weakest
    for x in range(width):
        row = np.float32(logarithm[x]) * per_bit - weakest
        gain = gains[np.uint32(min(max(row, zero), last) + half), kinds[x]]
        taken = fine[x]
        rest = share[x] - fine[x]
        noise = rest * f1[x]
        wide = rest * f2[x]
        f0[x], f1[x], f2[x], f3[x] = (
            taken * gain[0] + noise,
            taken * gain[1] + noise,
            taken * gain[2] + wide,
            taken * gain[3] + wide,
        )


@njit(error_model="numpy")
def _find_ratio(layers, at, lookup, lines):
    """Line 0: by what each value of a row changes."""
    ratio = lines[0]
    f0 = lines[1]
    f1 = lines[2]
    f2 = lines[3]
    f3 = lines[4]
    own = layers[0, at]
    a = layers[1, at]
    b = layers[2, at]
    c = layers[3, at]
    d = layers[4, at]
    zero = np.float32(0)
    one = np.float32(1)
    tiny = np.float32(1e-7)
    # Loops over few arrays are vectorised.
    for x in range(len(ratio)):
        ratio[x] = f0[x] * (own[x] - a[x])
    for x in range(len(ratio)):
        ratio[x] += f1[x] * (a[x] - b[x])
    for x in range(len(ratio)):
        ratio[x] += f2[x] * (b[x] - c[x])
    for x in range(len(ratio)):
        ratio[x] += f3[x] * (c[x] - d[x])
    for x in range(len(ratio)):
        ratio[x] = max(one + ratio[x] / max(own[x], tiny), zero)
    if lookup.encoded:
        for x in range(len(ratio)):
            ratio[x] = np.sqrt(ratio[x])


@njit
def _store_row(above, here, below, unclipped, ratio, channels, lookup, wide, out):
    """A row with each pixel times its ratio, in the range of the neighbours in three rows but for
    the overshoot.
    """
    low = wide[0]
    high = wide[1]
    least = wide[2]
    most = wide[3]
    scaled = wide[4]
    size = len(here)
    zero = np.float32(0)
    if channels == 3:
        for x in range(len(ratio)):
            scaled[3 * x] = scaled[3 * x + 1] = scaled[3 * x + 2] = ratio[x]
    else:
        for x in range(len(ratio)):
            scaled[x * channels : (x + 1) * channels] = ratio[x]
    for i in range(size):
        low[i] = min(here[i], min(above[i], below[i]))
        high[i] = max(here[i], max(above[i], below[i]))
    low1 = low[channels:]
    low2 = low[2 * channels :]
    high1 = high[channels:]
    high2 = high[2 * channels :]
    into_low = least[channels:]
    into_high = most[channels:]
    for i in range(size - 2 * channels):
        into_low[i] = min(low[i], min(low1[i], low2[i]))
    for i in range(size - 2 * channels):
        into_high[i] = max(high[i], max(high1[i], high2[i]))
    for c in range(channels):
        for at, other in (
            (c, min(channels + c, size - channels + c)),
            (size - channels + c, max(size - 2 * channels, 0) + c),
        ):
            least[at], most[at] = min(low[at], low[other]), max(high[at], high[other])
    overshoot = lookup.overshoot
    half = lookup.half
    top = lookup.top
    for i in range(size):
        beyond = overshoot * (most[i] - least[i]) if unclipped[i] else zero
        scaled[i] = min(max(here[i] * scaled[i], least[i] - beyond), most[i] + beyond)
    for i in range(size):
        out[i] = min(max(scaled[i] + half, zero), top)
