"""Blending pixel by pixel: each output pixel is the robust mean over the lenses that show its scene
point.

The general kernel: any type of values, up to four channels, several samples per output pixel, or
the nearest lens alone. `blend_rows` computes the same mean several times as fast where one sample
per output pixel is enough.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import kernel

from ...data.surface import patch_size_at
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


@njit(error_model="numpy", forceinline=True)
def _interpolate(line, at, across, down, fx, fy, gain, channels, value):
    """Write `gain` times the values of the flat at place (`fx`, `fy`) from the pixel at `at`."""
    one = np.float32(1)
    w01 = gain * fx * (one - fy)
    w11 = gain * fx * fy
    w00 = gain * (one - fy) - w01
    w10 = gain * fy - w11
    for c in range(channels):
        upper = w00 * np.float32(line[at + c]) + w01 * np.float32(line[at + across + c])
        lower = w10 * np.float32(line[at + down + c])
        lower += w11 * np.float32(line[at + down + across + c])
        value[c] = upper + lower


@njit(error_model="numpy", forceinline=True)
def _add_agreeing(values, weights, found, t2, channels, mean, total):
    """Add the mean of the readings, each weighted by how far its colour is from their plain `mean`
    (Geman-McClure).
    """
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
    """Draw the pixels of a `Grid` into an `Output`, with the patch sizes `surface` (h, w) on a
    `DepthGrid`.

    The bits do not depend on the part that is drawn.
    """
    line = flat.pixels.reshape(-1)
    shown = flat.depth
    corner = flat.corner
    stride = flat.pixels.shape[1]
    width = flat.size[0]
    height = flat.size[1]
    across = flat.pixels.shape[2]
    down = stride * flat.pixels.shape[2]
    gains = light.gains
    last_entry = light.gains.shape[1] - 1
    per_step = 1 / light.step
    applied = light.applied
    centres = lenses.centres
    types = lenses.types
    tables = lenses.tables
    rows = lenses.rows
    low = lenses.low
    origin = lenses.origin
    inverse = lenses.inverse
    bend = lenses.displacements
    lowest = lenses.lowest
    offsets = lenses.offsets
    steps = lenses.steps
    shares = lenses.shares
    pitch = lenses.pitch
    first = grid.first
    start = grid.start
    spacing = grid.spacing
    wanted = grid.wanted
    image = output.image
    valid = output.valid
    view_x = weighting.viewpoint[0]
    view_y = weighting.viewpoint[1]
    radius2 = weighting.viewpoint[2]
    channels = image.shape[2]
    last_ratio = shares.shape[1] - 1
    edged = lenses.edged
    t2 = weighting.tolerance * weighting.tolerance
    zero = np.float32(0)
    one = np.float32(1)
    values = np.empty((_MOST, 4), np.float32)
    weights = np.empty(_MOST, np.float32)
    mean = np.zeros(4, np.float32)
    total = np.zeros(4, np.float32)
    for v in range(begin, end):
        for u in range(image.shape[1]):
            if wanted.size > 0 and not wanted[v, u]:
                continue
            centre_x = first[0] + (start[0] + u) * spacing
            centre_y = first[1] + (start[1] + v) * spacing
            s = patch_size_at(surface, depth, np.float32(centre_x), np.float32(centre_y))
            samples, apart = count_samples(
                surface, depth, centre_x, centre_y, s, grid, pitch, weighting.squares
            )
            middle = 0.5 * (samples - 1)
            total[:] = 0
            seen = 0
            for sample in range(samples * samples):
                x = centre_x + (sample % samples - middle) * apart
                y = centre_y + (sample // samples - middle) * apart
                if samples > 1:
                    s = patch_size_at(surface, depth, np.float32(x), np.float32(y))
                slope = s / pitch
                limit = min(weighting.widest / max(abs(slope), np.float32(1e-6)), weighting.reach)
                limit2 = limit * limit
                ratio = min(
                    max(int((slope + one) * np.float32(0.5 * last_ratio) + np.float32(0.5)), 0),
                    last_ratio,
                )
                i, j = nearest_index(x, y, origin, inverse, bend, lowest)
                i = int(i) - low[0]
                j = int(j) - low[1]
                # A point is nearer than three quarters of a pitch to its nearest lens.
                farthest = limit + np.float32(0.75) * pitch
                found = 0
                best = np.float32(np.inf)
                best_at = 0
                norm = zero
                mean[:] = 0
                for o in range(len(offsets)):
                    if offsets[o] > farthest or found == _MOST:
                        break
                    column = i + steps[o, 0]
                    row = j + steps[o, 1]
                    if column < 0 or row < 0 or column >= rows.shape[1] or row >= rows.shape[0]:
                        continue
                    lens = rows[row, column]
                    if lens < 0:
                        continue
                    ex = np.float32(x - centres[lens, 0])
                    ey = np.float32(y - centres[lens, 1])
                    d2 = ex * ex + ey * ey
                    dx = view_x - ex * slope
                    dy = view_y - ey * slope
                    delta2 = dx * dx + dy * dy
                    if d2 > limit2 or delta2 > radius2 or (t2 <= 0 and d2 >= best):
                        continue
                    px = centres[lens, 0] + dx
                    py = centres[lens, 1] + dy
                    if not (px >= 0 and py >= 0 and px <= width - 1 and py <= height - 1):
                        continue
                    ix = min(int(px), width - 2)
                    iy = min(int(py), height - 2)
                    fx = np.float32(px - ix)
                    fy = np.float32(py - iy)
                    ix = ix - corner[0]
                    iy = iy - corner[1]
                    gain = gains[tables[lens], min(int(delta2 * per_step), last_entry)]
                    weight = (RIM - max(d2 / limit2, delta2 / radius2)) / (gain * gain)
                    gain = one + applied * (gain - one)
                    weight *= shares[types[lens], ratio]
                    if (
                        edged[lens]
                        and abs(shown[iy + (fy >= 0.5), ix + (fx >= 0.5)] - s) > 2 * depth.edge
                    ):
                        weight *= OCCLUDED
                        d2 += limit2
                    if d2 < best:
                        best = d2
                        best_at = found
                        if t2 <= 0:
                            farthest = min(farthest, np.sqrt(best) + np.float32(0.75) * pitch)
                    at = iy * down + ix * across
                    value = values[found]
                    _interpolate(line, at, across, down, fx, fy, gain, channels, value)
                    for c in range(channels):
                        mean[c] += weight * value[c]
                    weights[found] = weight
                    norm += weight
                    found += 1
                if found == 0:
                    continue
                seen += 1
                if t2 <= 0:
                    total += values[best_at]
                    continue
                mean /= norm
                _add_agreeing(values, weights, found, t2, channels, mean, total)
            valid[v, u] = seen > 0
            for c in range(channels):
                image[v, u, c] = total[c] / max(seen, 1)
