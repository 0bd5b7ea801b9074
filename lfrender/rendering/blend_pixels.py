"""Blending pixel by pixel: each output pixel is the robust mean over the lenses that show its scene point.

The general kernel: any type of values, up to four channels, several samples per output pixel, viewpoints off the
middle, or the nearest lens alone. `blend_rows` computes the same mean several times as fast where one sample per output
pixel is enough.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

from ..data.surface import patch_size_at
from ..flat.distorted_lookup import displacement_at, nearest_index
from ..runtime.scheduling import plan_chunks
from .settings import WEIGHTS

__all__ = ["Flat", "Grid", "Lenses", "Light", "Output", "Weighting", "blend_pixels"]

# Most lenses that may share one scene point; the nearest come first.
_MAX_LENSES = 37


class Flat(NamedTuple):
    """A part of a flat."""

    pixels: Any  # (h, w, C) array
    depth: Any  # (h, w) float32 [px]: patch size that each pixel shows, inf where unlit; (0, 0) if nothing occludes
    corner: Any  # (2,) int [px]: flat coordinates x, y of the first pixel
    size: Any  # (2,) int [px]: width and height of the whole flat


class Light(NamedTuple):
    """Gain and light of a lens over the squared distance from its centre."""

    gains: Any  # (k,) float32: correction of the vignetting
    lights: Any  # (k,) float32: the illumination, of which a weight is the square
    step: Any  # float32 [px^2]: distance between table entries


class Lenses(NamedTuple):
    """The lens lattice, as the kernel looks up the lenses about a scene point."""

    origin: Any  # (2,) float64 [px]
    inverse: Any  # (2, 2) float64: of the basis
    basis: Any  # (2, 2) float64 [px]
    displacements: Any  # of a distorted lattice, from its straight one; (0, 0, 0) if straight
    low: Any  # (2,) int64: lattice index of the first displacement
    offsets: Any  # (k, 3) float32 [px]: `lens_offsets`, the nearest first
    steps: Any  # (k, 2) int32: the same in lattice indices
    types: Any  # (m, m) int8: lens (i, j) is of type `types[i % m, j % m]`; (0, 0) if all are alike
    shares: Any  # (types, r) float32: weight of a type over s / D from -1 to 1
    radius: Any  # float32 [px]
    pitch: Any  # float32 [px]


class Grid(NamedTuple):
    """Pixels of the picture that are drawn."""

    first: Any  # (2,) float64 [px]: scene coordinates of pixel (0, 0) of the whole picture
    spacing: Any  # float [px]
    scale: Any  # float32: pixels per pitch
    start: Any  # (2,) int: column and row of the first pixel of the part that is drawn
    wanted: Any  # (h, w) bool: pixels to draw, (0, 0) for all


class Weighting(NamedTuple):
    """Which lenses count, and how much."""

    reach: Any  # [px] lenses farther from a scene point are not read
    tolerance: Any  # float32: difference from the mean colour at which a lens counts a quarter; 0: nearest lens alone
    blurred: Any  # float32: squared share of an output pixel's side over which microlenses average already
    viewpoint: Any  # (2,) float32 [px]: microimages are read about this point, relative to their centres


class Output(NamedTuple):
    """The picture."""

    image: Any  # (h, w, C) array
    valid: Any  # (h, w) bool: some lens shows the pixel
    half: Any  # float32: added to values before they are truncated
    top: Any  # float32: the largest value


class _Sample(NamedTuple):
    """A scene point that is read."""

    x: Any  # [px]
    y: Any
    size: Any  # patch size [px]
    limit: Any  # lenses farther away do not show it [px]
    inside: Any  # all lenses in reach lie on the flat with all that they show


class _Scene(NamedTuple):
    """What is read of the flat, by which lenses."""

    flat: Flat
    light: Light
    lenses: Lenses
    weighting: Weighting
    edge: Any  # patch sizes that differ by less belong to one surface [px]
    line: Any  # pixels of the flat, value by value
    squares: Any  # squared lights
    types_about: Any  # (m, m, k): type of each lens about one, since integer divisions are slow


class _Readings(NamedTuple):
    """Memory for the lenses about a scene point."""

    lens: Any  # (k + 1,) number of its offset
    away: Any  # (k + 1, 3) float32 [px]: scene point less lens centre, and its square
    values: Any  # (MAX_LENSES, 4) float32
    weights: Any  # (MAX_LENSES,) float64


@njit(cache=True, nogil=True, inline="always")
def _crosses_edge(depth, x, y, s, half):
    """Whether a corner of the output pixel at (x, y), `half` its side away, belongs to another surface than `s`."""
    for corner in range(4):
        corner_x = np.float32(x + (half if corner % 2 else -half))
        corner_y = np.float32(y + (half if corner // 2 else -half))
        if abs(patch_size_at(depth, corner_x, corner_y) - s) > depth.edge:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _samples_along(depth, x, y, s, grid, blurred):
    """Samples along a side of the output pixel at (x, y), and their distance [px]: what microlenses and pixels of the
    flat have not averaged already."""
    side = abs(s) / grid.scale
    count = max(int(np.ceil(side - WEIGHTS.one_sample)), 1)
    apart = np.float32(1.0)
    if count > 1 and not _crosses_edge(depth, x, y, s, 0.5 * grid.spacing):
        left = np.float32(1.0) - blurred - 1 / (side * side)
        apart = np.sqrt(max(left, np.float32(0.0)))
        count = max(int(np.ceil(side * apart - WEIGHTS.one_sample)), 1)
    return count, apart * (grid.spacing / count)


@njit(cache=True, nogil=True, inline="always")
def _interpolate(line, at, across, down, w00, w01, w10, w11):
    """Weighted sum of four values about place `at`."""
    return (w00 * np.float32(line[at]) + w01 * np.float32(line[at + across])) + (
        w10 * np.float32(line[at + down]) + w11 * np.float32(line[at + down + across])
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _find_lenses(lenses, i, j, base_x, base_y, limit2, farthest, readings):
    """Collect the lenses within reach of a scene point that is `base` from the undistorted centre of lens (i, j)."""
    offsets, bent = lenses.offsets, lenses.displacements.size > 0
    lens, away = readings.lens, readings.away
    near = 0
    for o in range(len(offsets)):
        # Offsets are sorted.
        if offsets[o, 2] > farthest:
            break
        ex, ey = base_x - offsets[o, 0], base_y - offsets[o, 1]
        if bent:
            bend_x, bend_y = displacement_at(
                lenses.displacements, lenses.low, i + lenses.steps[o, 0], j + lenses.steps[o, 1]
            )
            ex, ey = ex - bend_x, ey - bend_y
        d2 = ex * ex + ey * ey
        # Without a branch, which could not be predicted.
        lens[near], away[near, 0], away[near, 1], away[near, 2] = o, ex, ey, d2
        near += int(d2 <= limit2)
    return min(near, _MAX_LENSES)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _read(flat, line, channels, ix, iy, fx, fy, gain, out):
    """Interpolate all channels of a pixel, times the gain."""
    zero = np.float32(0.0)
    across, down = np.uint64(flat.pixels.shape[2]), np.uint64(flat.pixels.shape[1] * flat.pixels.shape[2])
    # Unsigned places: signed ones are checked for being counted from the end.
    upper = np.uint64(iy - flat.corner[1]) * down + np.uint64(ix - flat.corner[0]) * across
    gx, gy = gain * fx, np.float32(1.0) - fy
    w01, w11 = gx * gy, gx * fy
    w00, w10 = gain * gy - w01, gain * fy - w11
    out[0] = _interpolate(line, upper, across, down, w00, w01, w10, w11)
    out[1] = out[2] = out[3] = zero
    if len(channels) > 1:
        out[1] = _interpolate(line, upper + np.uint64(1), across, down, w00, w01, w10, w11)
    if len(channels) > 2:
        out[2] = _interpolate(line, upper + np.uint64(2), across, down, w00, w01, w10, w11)
    if len(channels) > 3:
        out[3] = _interpolate(line, upper + np.uint64(3), across, down, w00, w01, w10, w11)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _shows(sample, width, height, ex, ey, ix, iy, fx, fy):
    """Whether a lens and the place where it is read lie on the flat."""
    if not (ix >= 0 and iy >= 0 and ix + fx <= width - 1 and iy + fy <= height - 1):
        return False
    cx, cy = sample.x - ex, sample.y - ey
    return not (cx < -0.5 or cy < -0.5 or cx >= width - 0.5 or cy >= height - 0.5)


@njit(cache=True, nogil=True, error_model="numpy")
def _read_lenses(scene, channels, sample, near, nearest, types_about, ratio, readings):
    """Read the first `near` lenses of `readings`; returns how many show the point, and which of them is nearest."""
    flat, light, lenses, weighting = scene.flat, scene.light, scene.lenses, scene.weighting
    width, height = flat.size[0], flat.size[1]
    last_ring, per_light_step = len(light.gains) - 1, 1 / light.step
    slope, grown = sample.size / lenses.pitch, np.float32(1.0) + sample.size / lenses.pitch
    view_x, view_y = weighting.viewpoint[0], weighting.viewpoint[1]
    aside = view_x * view_x + view_y * view_y > 0
    # Off the middle, rims often show a place alone; their last pixel mixes in light of the next microimage.
    radius2 = (lenses.radius - 1) * (lenses.radius - 1)
    limit2, farthest = sample.limit * sample.limit, sample.limit + nearest
    per_limit2, single = 1 / limit2, weighting.tolerance <= 0
    whole_x, whole_y = np.floor(sample.x), np.floor(sample.y)
    left_x, left_y = np.float32(sample.x - whole_x) + view_x, np.float32(sample.y - whole_y) + view_y
    column, row = np.int64(whole_x), np.int64(whole_y)
    found = best_at = 0
    best = np.float32(np.inf)
    for m in range(near):
        ex, ey, d2 = readings.away[m, 0], readings.away[m, 1], readings.away[m, 2]
        if single and d2 >= best:
            continue
        if lenses.offsets[readings.lens[m], 2] > farthest:
            break
        dx, dy = view_x - ex * slope, view_y - ey * slope
        delta2 = dx * dx + dy * dy
        if aside and delta2 > radius2:
            continue
        rx, ry = left_x - ex * grown, left_y - ey * grown
        step_x, step_y = np.floor(rx), np.floor(ry)
        fx, fy = rx - step_x, ry - step_y
        ix, iy = column + np.int64(step_x), row + np.int64(step_y)
        if not sample.inside:
            if not _shows(sample, width, height, ex, ey, ix, iy, fx, fy):
                continue
            if ix > width - 2:
                ix, fx = width - 2, np.float32(1.0)
            if iy > height - 2:
                iy, fy = height - 2, np.float32(1.0)
        ring = np.uint64(min(int(delta2 * per_light_step), last_ring))
        _read(flat, scene.line, channels, ix, iy, fx, fy, light.gains[ring], readings.values[found])
        off_axis = d2 * per_limit2
        if aside:
            # Off the middle, the first alone grows toward the rim of a microimage.
            off_axis = max(off_axis, delta2 / radius2)
        weight = (WEIGHTS.rim - off_axis) * scene.squares[ring]
        if lenses.types.size > 0:
            weight *= lenses.shares[types_about[readings.lens[m]], ratio]
        if flat.depth.size > 0:
            below, right = np.uint64(fy + np.float32(0.5)), np.uint64(fx + np.float32(0.5))
            shown = flat.depth[np.uint64(iy - flat.corner[1]) + below, np.uint64(ix - flat.corner[0]) + right]
            if abs(shown - sample.size) > 2 * scene.edge:
                weight *= WEIGHTS.occluded
                if aside:
                    # The warped surface is what is visible from there: prefer lenses that look from nearby.
                    beside = d2 / (lenses.pitch * lenses.pitch) + WEIGHTS.occluded_near
                    weight /= beside * beside
                d2 += limit2
        if d2 < best:
            best, best_at = d2, found
            if single:
                # No other lens is nearer than half the distance to the next one; and all lie farther from the point
                # than from its nearest lens, less the distance of that one.
                away = np.sqrt(best)
                farthest = min(farthest, nearest + away) if 2 * away > lenses.offsets[1, 2] else np.float32(0.0)
        readings.weights[found] = weight
        found += 1
    return found, best_at


@njit(cache=True, nogil=True, error_model="numpy")
def _robust_mean(values, weights, found, tolerance, channels):
    """Mean over lenses, reweighted once by how far their colour is from the plain mean (Geman-McClure)."""
    t2, per_channel = tolerance * tolerance, np.float32(1 / len(channels))
    norm = mean0 = mean1 = mean2 = mean3 = np.float32(0.0)
    for n in range(found):
        weight = weights[n]
        norm += weight
        mean0 += weight * values[n, 0]
        mean1 += weight * values[n, 1]
        mean2 += weight * values[n, 2]
        mean3 += weight * values[n, 3]
    norm = 1 / norm
    mean0, mean1, mean2, mean3 = mean0 * norm, mean1 * norm, mean2 * norm, mean3 * norm
    norm = mixed0 = mixed1 = mixed2 = mixed3 = np.float32(0.0)
    for n in range(found):
        value0, value1, value2, value3 = values[n, 0], values[n, 1], values[n, 2], values[n, 3]
        difference = (value0 - mean0) ** 2 + (value1 - mean1) ** 2
        difference += (value2 - mean2) ** 2 + (value3 - mean3) ** 2
        agree = t2 / (t2 + difference * per_channel)
        weight = np.float32(weights[n]) * agree * agree
        norm += weight
        mixed0 += weight * value0
        mixed1 += weight * value1
        mixed2 += weight * value2
        mixed3 += weight * value3
    norm = 1 / norm
    return mixed0 * norm, mixed1 * norm, mixed2 * norm, mixed3 * norm


@njit(cache=True, nogil=True, error_model="numpy")
def _read_point(scene, channels, x, y, s, margin, readings):
    """Colour of the scene point (x, y) of patch size `s`, and whether some lens shows it."""
    lenses, weighting, zero = scene.lenses, scene.weighting, np.float32(0.0)
    origin, basis = lenses.origin, lenses.basis
    slope, view = s / lenses.pitch, weighting.viewpoint
    i, j = nearest_index(x, y, origin, lenses.inverse, lenses.displacements, lenses.low)
    base_x = np.float32(x - origin[0] - (i * basis[0, 0] + j * basis[1, 0]))
    base_y = np.float32(y - origin[1] - (i * basis[0, 1] + j * basis[1, 1]))
    aside = np.sqrt(view[0] * view[0] + view[1] * view[1])
    limit = min((lenses.radius + aside) / max(abs(slope), np.float32(1e-6)), weighting.reach)
    ratio, about = 0, scene.types_about[0, 0]
    if lenses.types.size > 0:
        cells, last_ratio = max(len(lenses.types), 1), lenses.shares.shape[1] - 1
        ratio = min(max(int((slope + 1) * np.float32(0.5 * last_ratio) + 0.5), 0), last_ratio)
        about = scene.types_about[int(i) % cells, int(j) % cells]
    # Distance of the nearest lens, of which a distorted lattice has only a bound.
    bent = lenses.displacements.size > 0
    nearest = np.float32(0.75) * lenses.pitch if bent else np.sqrt(base_x * base_x + base_y * base_y)
    width, height = scene.flat.size[0], scene.flat.size[1]
    inside = x > margin and y > margin and x < width - 1 - margin and y < height - 1 - margin
    near = _find_lenses(lenses, i, j, base_x, base_y, limit * limit, limit + nearest, readings)
    sample = _Sample(x, y, s, limit, inside)
    found, best_at = _read_lenses(scene, channels, sample, near, nearest, about, ratio, readings)
    if found == 0:
        return zero, zero, zero, zero, False
    values = readings.values
    if weighting.tolerance <= 0:
        return values[best_at, 0], values[best_at, 1], values[best_at, 2], values[best_at, 3], True
    mixed0, mixed1, mixed2, mixed3 = _robust_mean(values, readings.weights, found, weighting.tolerance, channels)
    return mixed0, mixed1, mixed2, mixed3, True


@njit(cache=True, nogil=True, error_model="numpy")
def _blend_row(v, scene, channels, depth, grid, output):
    """Fill row `v` of the picture."""
    columns, count = output.image.shape[1], len(scene.lenses.offsets) + 1
    # Farther than this from the border, every lens in reach and all it shows lie on the flat.
    margin = scene.weighting.reach + scene.lenses.radius + 1
    readings = _Readings(
        np.empty(count, np.int64), np.empty((count, 3), np.float32), np.empty((_MAX_LENSES, 4), np.float32),
        np.empty(_MAX_LENSES, np.float64),
    )  # fmt: skip
    zero = np.float32(0.0)
    for u in range(columns):
        if grid.wanted.size > 0 and not grid.wanted[v, u]:
            continue
        centre_x = grid.first[0] + (grid.start[0] + u) * grid.spacing
        centre_y = grid.first[1] + (grid.start[1] + v) * grid.spacing
        s_here = patch_size_at(depth, np.float32(centre_x), np.float32(centre_y))
        n_sub, apart = _samples_along(depth, centre_x, centre_y, s_here, grid, scene.weighting.blurred)
        total0 = total1 = total2 = total3 = total_weight = zero
        for sub in range(n_sub * n_sub):
            x = centre_x + (sub % n_sub - np.float32(0.5) * (n_sub - 1)) * apart
            y = centre_y + (sub // n_sub - np.float32(0.5) * (n_sub - 1)) * apart
            s = s_here if n_sub == 1 else patch_size_at(depth, np.float32(x), np.float32(y))
            value0, value1, value2, value3, shown = _read_point(scene, channels, x, y, s, margin, readings)
            if shown:
                total0 += value0
                total1 += value1
                total2 += value2
                total3 += value3
                total_weight += 1
        output.valid[v, u] = total_weight > 0
        per_sample = 1 / total_weight if total_weight > 0 else zero
        out = output.image[v, u]
        out[0] = min(total0 * per_sample + output.half, output.top)
        if len(channels) > 1:
            out[1] = min(total1 * per_sample + output.half, output.top)
        if len(channels) > 2:
            out[2] = min(total2 * per_sample + output.half, output.top)
        if len(channels) > 3:
            out[3] = min(total3 * per_sample + output.half, output.top)


@njit(cache=True, nogil=True, parallel=True)
def blend_pixels(channels, flat, light, lenses, depth, grid, weighting, output):
    """Draw the pixels of a `Grid` into an `Output`.

    `channels` is any tuple of C numbers: its length belongs to its type, so that code for other channels is left out;
    pixels of the flat may have more. The bits do not depend on the part that is drawn.
    """
    cells, types = max(len(lenses.types), 1), lenses.types
    types_about = np.zeros((cells, cells, len(lenses.offsets)), np.int64)
    if types.size > 0:
        for a in range(cells):
            for b in range(cells):
                for o in range(len(lenses.offsets)):
                    types_about[a, b, o] = types[(a + lenses.steps[o, 0]) % cells, (b + lenses.steps[o, 1]) % cells]
    squares, line = light.lights * light.lights, flat.pixels.reshape(-1)
    # Wanted pixels come in clusters, which all threads share.
    count, length, stride = plan_chunks(len(output.image))
    for number in prange(count):
        first_row = number * stride % count * length
        scene = _Scene(flat, light, lenses, weighting, depth.edge, line, squares, types_about)
        for v in range(first_row, min(first_row + length, len(output.image))):
            # The same type of number where this is compiled and where it is run: else the row is compiled twice.
            _blend_row(np.int64(v), scene, channels, depth, grid, output)
