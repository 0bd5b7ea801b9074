"""Blending pixel by pixel: each output pixel is the robust mean over the lenses that show its scene point.

The general kernel: any type of values, up to four channels, several samples per output pixel, viewpoints off the
middle, or the nearest lens alone. `blend_rows` computes the same mean several times as fast where one sample per output
pixel is enough.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lfcal.runtime.kernels.jit import kernel

from ...data.surface import patch_size_at
from ...flat.distorted_lookup import displacement_at, nearest_index
from ..settings import WEIGHTS

__all__ = ["Flat", "Grid", "Lenses", "Light", "Output", "Weighting", "blend_pixels", "put_value"]

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

    gains: Any  # (t, k) float32: correction of the vignetting
    lights: Any  # (t, k) float32: the illumination, of which a weight is the square
    step: Any  # float32 [px^2]: distance between table entries
    cell: Any  # (m, m) int8: lens (i, j) has table `cell[i % m, j % m]`


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

    image: Any  # (h, w, C, bytes) uint8: values of one byte or two, the lower first, or floats of four
    valid: Any  # (h, w) bool: some lens shows the pixel
    half: Any  # float32: added to values before they are truncated
    top: Any  # float32: the largest value


# Numba counts references each time that an array is taken out of a tuple. Kernels that run for every pixel hence take
# arrays one by one, and the loop over a row is one long function.


@njit(inline="always")
def _crosses_edge(surface, depth, x, y, s, half):
    """Whether a corner of the output pixel at (x, y), `half` its side away, belongs to another surface than `s`."""
    for corner in range(4):
        corner_x = np.float32(x + (half if corner % 2 else -half))
        corner_y = np.float32(y + (half if corner // 2 else -half))
        if abs(patch_size_at(surface, depth, corner_x, corner_y) - s) > depth.edge:
            return True
    return False


@njit(inline="always")
def _interpolate(line, at, across, down, w00, w01, w10, w11):
    """Weighted sum of four values about place `at`."""
    return (w00 * np.float32(line[at]) + w01 * np.float32(line[at + across])) + (
        w10 * np.float32(line[at + down]) + w11 * np.float32(line[at + down + across])
    )


@njit(inline="always")
def put_value(out, u, channel, value):
    """Store a value in its bytes, the lowest first: truncated to one or two, or as a float of four."""
    low = np.uint32(0xFF)
    if out.shape[2] == 1:
        out[u, channel, 0] = value
    elif out.shape[2] == 2:
        number = np.uint32(value)
        out[u, channel, 0], out[u, channel, 1] = number & low, number >> np.uint32(8)
    else:
        bits = np.float32(value).view(np.uint32)
        for k in range(np.uint32(4)):
            out[u, channel, k] = (bits >> np.uint32(8 * k)) & low


@njit(error_model="numpy")
def _blend_row(
    v, channels, flat, light, lenses, surface, depth, grid, weighting, output, types_about, rings_about, squares
):
    """Fill row `v` as `blend_pixels` does.

    `types_about` and `rings_about` (m, m, k) are the types of the lenses about one, and where their light tables begin,
    since integer divisions are slow; `squares` (t k,) are those of the lights.
    """
    pixels, shown_depth, corner = flat.pixels, flat.depth, flat.corner
    width, height, line = flat.size[0], flat.size[1], flat.pixels.reshape(-1)
    gains, last_ring, per_light_step = light.gains.reshape(-1), light.gains.shape[1] - 1, 1 / light.step
    lit_cells = len(light.cell)
    origin, inverse, basis, bend, low = lenses.origin, lenses.inverse, lenses.basis, lenses.displacements, lenses.low
    offsets, steps, shares, radius, pitch = lenses.offsets, lenses.steps, lenses.shares, lenses.radius, lenses.pitch
    first, start, spacing, scale, wanted = grid.first, grid.start, grid.spacing, grid.scale, grid.wanted
    out, valid, half, top = output.image, output.valid, output.half, output.top
    reach, blurred, edge = weighting.reach, weighting.blurred, depth.edge
    known, bent, typed, cells = shown_depth.size > 0, bend.size > 0, lenses.types.size > 0, max(len(lenses.types), 1)
    last_ratio = shares.shape[1] - 1
    half_ratios = np.float32(0.5 * last_ratio)
    t2, half_step = weighting.tolerance * weighting.tolerance, 0.5 * spacing
    view_x, view_y = weighting.viewpoint[0], weighting.viewpoint[1]
    aside = np.sqrt(view_x * view_x + view_y * view_y)
    # Off the middle, rims often show a place alone; their last pixel mixes in light of the next microimage.
    radius2 = (radius - 1) * (radius - 1)
    # Farther from the border than this, every lens in reach and all it shows lie on the flat.
    margin = reach + radius + 1
    zero, per_channel = np.float32(0.0), np.float32(1 / output.image.shape[2])
    across, down = np.uint64(pixels.shape[2]), np.uint64(pixels.shape[1] * pixels.shape[2])
    values, weights = np.empty((_MAX_LENSES, 4), np.float32), np.empty(_MAX_LENSES, np.float32)
    members = np.empty(len(offsets) + 1, np.int64)
    away_x, away_y = np.empty(len(offsets) + 1, np.float32), np.empty(len(offsets) + 1, np.float32)
    away_2 = np.empty(len(offsets) + 1, np.float32)
    for u in range(out.shape[1]):
        if wanted.size > 0 and not wanted[v, u]:
            continue
        centre_x, centre_y = first[0] + (start[0] + u) * spacing, first[1] + (start[1] + v) * spacing
        s_here = patch_size_at(surface, depth, np.float32(centre_x), np.float32(centre_y))
        # Side of the output pixel on the flat; samples cover what microlenses and pixels have not averaged already.
        side = abs(s_here) / scale
        n_sub = max(int(np.ceil(side - WEIGHTS.one_sample)), 1)
        apart = np.float32(1.0)
        if n_sub > 1 and not _crosses_edge(surface, depth, centre_x, centre_y, s_here, half_step):
            left = np.float32(1.0) - blurred - 1 / (side * side)
            apart = np.sqrt(max(left, np.float32(0.0)))
            n_sub = max(int(np.ceil(side * apart - WEIGHTS.one_sample)), 1)
        apart *= spacing / n_sub
        total0 = total1 = total2 = total3 = zero
        total_weight = np.float32(0.0)
        for sub in range(n_sub * n_sub):
            x = centre_x + (sub % n_sub - np.float32(0.5) * (n_sub - 1)) * apart
            y = centre_y + (sub // n_sub - np.float32(0.5) * (n_sub - 1)) * apart
            s = s_here if n_sub == 1 else patch_size_at(surface, depth, np.float32(x), np.float32(y))
            slope = s / pitch
            grown = np.float32(1.0) + slope
            i, j = nearest_index(x, y, origin, inverse, bend, low)
            base_x = np.float32(x - origin[0] - (i * basis[0, 0] + j * basis[1, 0]))
            base_y = np.float32(y - origin[1] - (i * basis[0, 1] + j * basis[1, 1]))
            limit = min((radius + aside) / max(abs(slope), np.float32(1e-6)), reach)
            limit2 = limit * limit
            ratio, types, rings = 0, types_about[0, 0], rings_about[0, 0]
            if lit_cells > 1:
                rings = rings_about[int(i) % lit_cells, int(j) % lit_cells]
            if typed:
                ratio = min(max(int((slope + 1) * half_ratios + 0.5), 0), last_ratio)
                types = types_about[int(i) % cells, int(j) % cells]
            per_limit2 = 1 / limit2
            # Distance of the nearest lens, of which a distorted lattice has only a bound.
            nearest = np.float32(0.75) * pitch if bent else np.sqrt(base_x * base_x + base_y * base_y)
            farthest = limit + nearest
            inside = x > margin and y > margin and x < width - 1 - margin and y < height - 1 - margin
            found, best, best_at = 0, np.float32(np.inf), 0
            norm = np.float32(0.0)
            mean0 = mean1 = mean2 = mean3 = zero
            near = 0
            # Offsets are sorted. No branch on the distance: it could not be predicted.
            for o in range(len(offsets)):
                if offsets[o, 2] > farthest:
                    break
                ex, ey = base_x - offsets[o, 0], base_y - offsets[o, 1]
                if bent:
                    bend_x, bend_y = displacement_at(bend, low, i + steps[o, 0], j + steps[o, 1])
                    ex, ey = ex - bend_x, ey - bend_y
                d2 = ex * ex + ey * ey
                members[near], away_x[near], away_y[near], away_2[near] = o, ex, ey, d2
                near += int(d2 <= limit2)
            near = min(near, _MAX_LENSES)
            whole_x, whole_y = np.floor(x), np.floor(y)
            left_x, left_y = np.float32(x - whole_x) + view_x, np.float32(y - whole_y) + view_y
            column, line_at = np.int64(whole_x), np.int64(whole_y)
            for m in range(near):
                ex, ey, d2 = away_x[m], away_y[m], away_2[m]
                if t2 <= 0 and d2 >= best:
                    continue
                if offsets[members[m], 2] > farthest:
                    break
                dx, dy = view_x - ex * slope, view_y - ey * slope
                delta2 = dx * dx + dy * dy
                if aside > 0 and delta2 > radius2:
                    continue
                rx, ry = left_x - ex * grown, left_y - ey * grown
                step_x, step_y = np.floor(rx), np.floor(ry)
                fx, fy = rx - step_x, ry - step_y
                ix, iy = column + np.int64(step_x), line_at + np.int64(step_y)
                if not inside:
                    if not (ix >= 0 and iy >= 0 and ix + fx <= width - 1 and iy + fy <= height - 1):
                        continue
                    if x - ex < -0.5 or y - ey < -0.5 or x - ex >= width - 0.5 or y - ey >= height - 0.5:
                        continue
                    if ix > width - 2:
                        ix, fx = width - 2, np.float32(1.0)
                    if iy > height - 2:
                        iy, fy = height - 2, np.float32(1.0)
                ring = np.uint64(min(int(delta2 * per_light_step), last_ring) + rings[members[m]])
                gain = gains[ring]
                # Unsigned places: signed ones are checked for being counted from the end.
                row_at, column_at = np.uint64(iy - corner[1]), np.uint64(ix - corner[0])
                upper = row_at * down + column_at * across
                gx, gy = gain * fx, np.float32(1.0) - fy
                w01, w11 = gx * gy, gx * fy
                w00, w10 = gain * gy - w01, gain * fy - w11
                value1 = value2 = value3 = zero
                value0 = _interpolate(line, upper, across, down, w00, w01, w10, w11)
                if len(channels) > 1:
                    value1 = _interpolate(line, upper + np.uint64(1), across, down, w00, w01, w10, w11)
                if len(channels) > 2:
                    value2 = _interpolate(line, upper + np.uint64(2), across, down, w00, w01, w10, w11)
                if len(channels) > 3:
                    value3 = _interpolate(line, upper + np.uint64(3), across, down, w00, w01, w10, w11)
                off_axis = d2 * per_limit2
                if aside > 0:
                    # Off the middle, the first alone grows toward the rim of a microimage.
                    off_axis = max(off_axis, delta2 / radius2)
                weight = (WEIGHTS.rim - off_axis) * squares[ring]
                if typed:
                    weight *= shares[types[members[m]], ratio]
                if known:
                    below, right = np.uint64(fy + np.float32(0.5)), np.uint64(fx + np.float32(0.5))
                    shown = shown_depth[row_at + below, column_at + right]
                    if abs(shown - s) > 2 * edge:
                        weight *= WEIGHTS.occluded
                        if aside > 0:
                            # The warped surface is what is visible from there: prefer lenses that look from nearby.
                            beside = d2 / (pitch * pitch) + WEIGHTS.occluded_near
                            weight /= beside * beside
                        d2 += limit2
                if d2 < best:
                    best, best_at = d2, found
                    if t2 <= 0:
                        # No other lens is nearer than half the distance to the next one; and all lie farther from the
                        # point than from its nearest lens, less the distance of that one.
                        away = np.sqrt(best)
                        farthest = min(farthest, nearest + away) if 2 * away > offsets[1, 2] else zero
                norm += weight
                mean0 += weight * value0
                mean1 += weight * value1
                mean2 += weight * value2
                mean3 += weight * value3
                weights[found] = weight
                values[found, 0], values[found, 1] = value0, value1
                values[found, 2], values[found, 3] = value2, value3
                found += 1
            if found == 0:
                continue
            if t2 <= 0:
                total0 += values[best_at, 0]
                total1 += values[best_at, 1]
                total2 += values[best_at, 2]
                total3 += values[best_at, 3]
                total_weight += 1
                continue
            # Reweighted once by how far the colour of a lens is from the plain mean (Geman-McClure).
            norm = 1 / norm
            mean0, mean1, mean2, mean3 = mean0 * norm, mean1 * norm, mean2 * norm, mean3 * norm
            norm = mixed0 = mixed1 = mixed2 = mixed3 = zero
            for n in range(found):
                value0, value1, value2, value3 = values[n, 0], values[n, 1], values[n, 2], values[n, 3]
                difference = (value0 - mean0) ** 2 + (value1 - mean1) ** 2
                difference += (value2 - mean2) ** 2 + (value3 - mean3) ** 2
                agree = t2 / (t2 + difference * per_channel)
                weight = weights[n] * agree * agree
                norm += weight
                mixed0 += weight * value0
                mixed1 += weight * value1
                mixed2 += weight * value2
                mixed3 += weight * value3
            norm = 1 / norm
            total0 += mixed0 * norm
            total1 += mixed1 * norm
            total2 += mixed2 * norm
            total3 += mixed3 * norm
            total_weight += 1
        valid[v, u] = total_weight > 0
        per_sample = 1 / total_weight if total_weight > 0 else zero
        row = out[v]
        put_value(row, u, 0, min(total0 * per_sample + half, top))
        if len(channels) > 1 and out.shape[2] > 1:
            put_value(row, u, 1, min(total1 * per_sample + half, top))
        if len(channels) > 2 and out.shape[2] > 2:
            put_value(row, u, 2, min(total2 * per_sample + half, top))
        if len(channels) > 3 and out.shape[2] > 3:
            put_value(row, u, 3, min(total3 * per_sample + half, top))


@njit
def _look_up_about(cell, steps):
    """(m, m, k) values of a repeating `cell` (m, m) at `steps` (k, 2) from each of its lenses; 0 if it is empty."""
    size = max(len(cell), 1)
    about = np.zeros((size, size, len(steps)), np.int64)
    if cell.size > 0:
        for a in range(size):
            for b in range(size):
                for o in range(len(steps)):
                    about[a, b, o] = cell[(a + steps[o, 0]) % size, (b + steps[o, 1]) % size]
    return about


@kernel(share=lambda *given: len(given[8].image))
def blend_pixels(begin, end, channels, flat, light, lenses, surface, depth, grid, weighting, output):
    """Draw the pixels of a `Grid` into an `Output`, with the patch sizes `surface` (h, w) on a `DepthGrid`.

    `channels` is any tuple of at least C numbers: its length belongs to its type, so that code for other channels is
    left out; those of the flat beyond C are 0. The bits do not depend on the part that is drawn.
    """
    types_about = _look_up_about(lenses.types, lenses.steps)
    rings_about = light.gains.shape[1] * _look_up_about(light.cell, lenses.steps)
    squares = (light.lights * light.lights).reshape(-1)
    for v in range(begin, end):
        _blend_row(
            v, channels, flat, light, lenses, surface, depth, grid, weighting, output, types_about,
            rings_about, squares,
        )  # fmt: skip
