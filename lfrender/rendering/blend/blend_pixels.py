"""Blending pixel by pixel: each output pixel is the robust mean over the lenses that show its scene
point.

The general kernel: any type of values, up to four channels, several samples per output pixel, or
the nearest lens alone. `blend_rows` computes the same mean several times as fast where one sample
per output pixel is enough.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lfcal.runtime.kernels import kernel

from ...data.surface import patch_size_at
from ...depth.surface.scene_grid import lens_at
from ...flat.lens_graph import nearest_index
from .records import AT_EDGES, FARTHEST_SAMPLE, OCCLUDED, ONE_SAMPLE, RIM

__all__ = ["blend_pixels", "count_samples"]

# Most lenses that are mixed at one scene point; the nearest come first.
_MOST = 37


@njit
def _largest_at_edge(surface, depth, x, y, s, half):
    """Largest `|s|` at the corners of the output pixel at (x, y), `half` its side away.

    Zero if none of the corners belongs to another surface than `s`.
    """
    largest = abs(s)
    crosses = False
    for to_y in (-half, half):
        for to_x in (-half, half):
            other = patch_size_at(surface, depth, np.float32(x + to_x), np.float32(y + to_y))
            largest = max(largest, abs(other))
            crosses |= abs(other - s) > depth.edge
    return largest * crosses


@njit(error_model="numpy")
def count_samples(surface, depth, x, y, s, grid, pitch, squares):
    """Samples along a side of an output pixel, and how far they are apart [px of the scene].

    Their variance about the middle is that of the square that is left to average
    (`Weighting.squares`), whatever their number. At depth edges they fill the whole pixel, since
    the outline is not blurred.
    """
    side = abs(s) / grid.scale
    if side <= 1:
        return 1, 0.0
    largest = _largest_at_edge(surface, depth, x, y, s, 0.5 * grid.spacing)
    if largest > 0:
        samples = int(np.ceil(largest / grid.scale / AT_EDGES))
        return samples, grid.spacing / samples
    last = len(squares) - 1
    left = squares[min(max(int((s / pitch + 1) * (0.5 * last) + 0.5), 0), last)]
    if left < ONE_SAMPLE:
        return 1, 0.0
    samples = int(np.ceil(np.sqrt(left / FARTHEST_SAMPLE + 1)))
    apart = np.sqrt(left / (samples * samples - 1))
    return samples, apart * grid.spacing / side


class _Reading(NamedTuple):
    """Where a lens is read for a scene point."""

    away2: Any  # float32 [px^2]: from its centre to the scene point
    delta2: Any  # float32 [px^2]: from the viewpoint to the place that is read
    x: Any  # float64 [px]: that place on the flat
    y: Any


class _Place(NamedTuple):
    """A place on the flat: pixel to the upper left of it in the part that is read, and float32 [px]
    from there on.
    """

    x: Any
    y: Any
    right: Any
    below: Any


@njit(error_model="numpy", inline="always")
def _limits(s, pitch, weighting, last):
    """Slope s / D of a scene point, distance up to which lenses are read for it and its square, and
    column of the weights of lens types.
    """
    one = np.float32(1)
    slope = s / pitch
    limit = min(weighting.widest / max(abs(slope), np.float32(1e-6)), weighting.reach)
    ratio = int((slope + one) * np.float32(0.5 * last) + np.float32(0.5))
    return slope, limit, limit * limit, min(max(ratio, 0), last)


@njit(error_model="numpy", inline="always")
def _read_at(x, y, centre_x, centre_y, slope, view):
    away_x = np.float32(x - centre_x)
    away_y = np.float32(y - centre_y)
    dx = view[0] - away_x * slope
    dy = view[1] - away_y * slope
    return _Reading(
        away_x * away_x + away_y * away_y, dx * dx + dy * dy, centre_x + dx, centre_y + dy
    )


@njit(error_model="numpy", inline="always")
def _is_on_flat(reading, size):
    x = reading.x
    y = reading.y
    return x >= 0 and y >= 0 and x <= size[0] - 1 and y <= size[1] - 1


@njit(error_model="numpy", inline="always")
def _place_of(reading, size, corner):
    column = min(int(reading.x), size[0] - 2)
    row = min(int(reading.y), size[1] - 2)
    return _Place(
        column - corner[0],
        row - corner[1],
        np.float32(reading.x - column),
        np.float32(reading.y - row),
    )


@njit(error_model="numpy", inline="always")
def _is_hidden(shown, place, s, edge):
    """Whether the pixel at a place shows another surface than `s`."""
    at = place.y + (place.below >= 0.5), place.x + (place.right >= 0.5)
    return abs(shown[at] - s) > 2 * edge


@njit(error_model="numpy", forceinline=True)
def _interpolate(line, across, down, place, gain, weight, value, total):
    """Write `gain` times the values of the flat at a place, and add them, weighted, to the `total`;
    values of the pixels to the right and below lie `across` and `down` farther in the `line`.
    """
    one = np.float32(1)
    right = place.right
    below = place.below
    w01 = gain * right * (one - below)
    w11 = gain * right * below
    w00 = gain * (one - below) - w01
    w10 = gain * below - w11
    at = place.y * down + place.x * across
    for c in range(len(total)):
        upper = w00 * np.float32(line[at + c]) + w01 * np.float32(line[at + across + c])
        lower = w10 * np.float32(line[at + down + c])
        lower += w11 * np.float32(line[at + down + across + c])
        value[c] = upper + lower
        total[c] += weight * value[c]


@njit(error_model="numpy", forceinline=True)
def _add_agreeing(values, weights, found, tolerance, channels, mean, total):
    """Add the mean of the readings, each weighted by how far its colour is from their plain `mean`
    (Geman-McClure).
    """
    t2 = tolerance * tolerance
    per_channel = np.float32(1 / channels)
    norm = np.float32(0)
    for n in range(found):
        difference = np.float32(0)
        for c in range(channels):
            difference += (values[n, c] - mean[c]) * (values[n, c] - mean[c])
        agree = t2 / (t2 + difference * per_channel)
        weights[n] *= agree * agree
        norm += weights[n]
    for n in range(found):
        for c in range(channels):
            total[c] += weights[n] / norm * values[n, c]


# Numba counts references each time that an array is taken out of a tuple: they are taken out once,
# before the loop over pixels.
@kernel(error_model="numpy", share=lambda *given: len(given[7].image))
def blend_pixels(begin, end, flat, light, lenses, surface, depth, grid, weighting, output):
    """Draw the pixels of a `Grid` into an `Output`; their bits do not depend on the part drawn."""
    pixels, shown, corner, size = flat
    gains, light_step, applied = light
    centres = lenses.centres
    types = lenses.types
    tables = lenses.tables
    edged = lenses.edged
    rows = lenses.rows
    low = lenses.low
    origin = lenses.origin
    inverse = lenses.inverse
    bend = lenses.displacements
    offsets = lenses.offsets
    steps = lenses.steps
    shares = lenses.shares
    pitch = lenses.pitch
    image, valid, _ = output
    per_step = 1 / light_step
    wanted = grid.wanted
    view = weighting.viewpoint
    tolerance = weighting.tolerance
    squares = weighting.squares
    line = pixels.reshape(-1)
    across = pixels.shape[2]
    down = pixels.shape[1] * across
    channels = image.shape[2]
    # A point is nearer than three quarters of a pitch to its nearest lens.
    beside = np.float32(0.75) * pitch
    nearest_alone = tolerance <= 0
    one = np.float32(1)
    values = np.empty((_MOST, channels), np.float32)
    weights = np.empty(_MOST, np.float32)
    mean = np.zeros(channels, np.float32)
    total = np.zeros(channels, np.float32)
    for v in range(begin, end):
        for u in range(image.shape[1]):
            if wanted.size > 0 and not wanted[v, u]:
                continue
            at_x = grid.first[0] + (grid.start[0] + u) * grid.spacing
            at_y = grid.first[1] + (grid.start[1] + v) * grid.spacing
            s = patch_size_at(surface, depth, np.float32(at_x), np.float32(at_y))
            samples, apart = count_samples(surface, depth, at_x, at_y, s, grid, pitch, squares)
            middle = 0.5 * (samples - 1)
            total[:] = 0
            seen = 0
            for sample in range(samples * samples):
                x = at_x + (sample % samples - middle) * apart
                y = at_y + (sample // samples - middle) * apart
                if samples > 1:
                    s = patch_size_at(surface, depth, np.float32(x), np.float32(y))
                slope, limit, limit2, ratio = _limits(s, pitch, weighting, shares.shape[1] - 1)
                i, j = nearest_index(x, y, origin, inverse, bend, lenses.lowest)
                farthest = limit + beside
                found = 0
                best = np.float32(np.inf)
                norm = np.float32(0)
                mean[:] = 0
                for o in range(len(offsets)):
                    if offsets[o] > farthest or found == _MOST:
                        break
                    lens = lens_at(rows, low, int(i) + steps[o, 0], int(j) + steps[o, 1])
                    if lens < 0:
                        continue
                    reading = _read_at(x, y, centres[lens, 0], centres[lens, 1], slope, view)
                    away2 = reading.away2
                    delta2 = reading.delta2
                    is_seen = away2 <= limit2 and delta2 <= view[2] and _is_on_flat(reading, size)
                    if not is_seen or (nearest_alone and away2 >= best):
                        continue
                    place = _place_of(reading, size, corner)
                    gain = gains[tables[lens], min(int(delta2 * per_step), gains.shape[1] - 1)]
                    weight = (RIM - max(away2 / limit2, delta2 / view[2])) / (gain * gain)
                    weight *= shares[types[lens], ratio]
                    if edged[lens] and _is_hidden(shown, place, s, depth.edge):
                        weight *= OCCLUDED
                        away2 += limit2
                    if nearest_alone:
                        if away2 >= best:
                            continue
                        best = away2
                        farthest = min(farthest, np.sqrt(best) + beside)
                        found = 0
                    gain = one + applied * (gain - one)
                    _interpolate(line, across, down, place, gain, weight, values[found], mean)
                    weights[found] = weight
                    norm += weight
                    found += 1
                if found == 0:
                    continue
                seen += 1
                if nearest_alone:
                    total += values[0]
                    continue
                mean /= norm
                _add_agreeing(values, weights, found, tolerance, channels, mean, total)
            valid[v, u] = seen > 0
            for c in range(channels):
                image[v, u, c] = total[c] / max(seen, 1)
