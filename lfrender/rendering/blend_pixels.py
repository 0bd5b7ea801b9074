"""Drawing kernels: every output pixel from the microimages that see its scene point."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from lfcal.runtime.fastmath import FAST

from ..data.surface import patch_size_at
from ..flat.distorted_lookup import displacement_at, nearest_index
from ..runtime.scheduling import plan_chunks

__all__ = ["OCCLUDED_WEIGHT", "blend_pixels"]

# Most lenses that may share one scene point; the nearest come first.
MAX_LENSES = 37
#: Weight of a lens that sees something else: it counts only where no lens sees the point.
OCCLUDED_WEIGHT = np.float32(1e-4)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _crosses_edge(surface, x, y, s, half, grid_x, grid_y, cell, edge):
    """Whether a corner of the output pixel at (x, y), `half` its side away, belongs to another surface than `s`."""
    for corner in range(4):
        corner_x = np.float32(x + (half if corner % 2 else -half))
        corner_y = np.float32(y + (half if corner // 2 else -half))
        if abs(patch_size_at(surface, corner_x, corner_y, grid_x, grid_y, cell, edge) - s) > edge:
            return True
    return False


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _read(line, at, across, down, w00, w01, w10, w11):
    """Weighted sum of four values about place `at`."""
    return (w00 * np.float32(line[at]) + w01 * np.float32(line[at + across])) + (
        w10 * np.float32(line[at + down]) + w11 * np.float32(line[at + down + across])
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_row(
    v, flat, marks, seen, gains, lights, light_step, origin, inverse, basis, bend, low, offsets, steps, types,
    shares, radius, pitch, surface, grid_x, grid_y, cell, edge, scale, first, spacing, blurred, reach, tolerance,
    view, corner, size, start, wanted, half, top, out, valid, kinds, squares
):  # fmt: skip
    """Fill row `v` as `blend_pixels` does; `kinds` are the types of lenses about one, `squares` those of the lights."""
    width, height, channels = size[0], size[1], len(marks)
    columns = out.shape[1]
    last_ring = len(gains) - 1
    known = seen.size > 0
    bent = bend.size > 0
    typed, cells = types.size > 0, max(len(types), 1)
    last_ratio = shares.shape[1] - 1
    half_ratios = np.float32(0.5 * last_ratio)
    t2 = tolerance * tolerance
    half_step = 0.5 * spacing
    view_x, view_y = view[0], view[1]
    aside = np.sqrt(view_x * view_x + view_y * view_y)
    # Beside the middle, rims often show a place alone: the last pixel mixes in light of the next microimage.
    radius2 = (radius - 1) * (radius - 1)
    # Farther from the border than this, every lens in reach and all it shows lies on the flat.
    margin = reach + radius + 1
    line = flat.reshape(-1)
    zero, per_channel = np.float32(0.0), np.float32(1 / channels)
    per_light_step = 1 / light_step
    across, down = np.uint64(flat.shape[2]), np.uint64(flat.shape[1] * flat.shape[2])
    values = np.empty((MAX_LENSES, 4), np.float32)
    weights = np.empty(MAX_LENSES, np.float32)
    members = np.empty(len(offsets) + 1, np.int64)
    away_x, away_y = np.empty(len(offsets) + 1, np.float32), np.empty(len(offsets) + 1, np.float32)
    away_2 = np.empty(len(offsets) + 1, np.float32)
    for u in range(columns):
        if wanted.size > 0 and not wanted[v, u]:
            continue
        centre_x, centre_y = first[0] + (start[0] + u) * spacing, first[1] + (start[1] + v) * spacing
        s_here = patch_size_at(surface, np.float32(centre_x), np.float32(centre_y), grid_x, grid_y, cell, edge)
        # Side of an output pixel in the flat, and how much of it lens and pixel have not averaged already.
        side = abs(s_here) / scale
        n_sub = max(int(np.ceil(side - np.float32(0.05))), 1)
        apart = np.float32(1.0)
        if n_sub > 1 and not _crosses_edge(surface, centre_x, centre_y, s_here, half_step, grid_x, grid_y, cell, edge):
            left = np.float32(1.0) - blurred - 1 / (side * side)
            apart = np.sqrt(max(left, np.float32(0.0)))
            n_sub = max(int(np.ceil(side * apart - np.float32(0.05))), 1)
        apart *= spacing / n_sub
        total0 = total1 = total2 = total3 = zero
        total_weight = np.float32(0.0)
        for sub in range(n_sub * n_sub):
            x = centre_x + (sub % n_sub - np.float32(0.5) * (n_sub - 1)) * apart
            y = centre_y + (sub // n_sub - np.float32(0.5) * (n_sub - 1)) * apart
            s = (
                s_here
                if n_sub == 1
                else patch_size_at(surface, np.float32(x), np.float32(y), grid_x, grid_y, cell, edge)
            )
            slope = s / pitch
            grown = np.float32(1.0) + slope
            i, j = nearest_index(x, y, origin, inverse, bend, low)
            base_x = np.float32(x - origin[0] - (i * basis[0, 0] + j * basis[1, 0]))
            base_y = np.float32(y - origin[1] - (i * basis[0, 1] + j * basis[1, 1]))
            limit = min((radius + aside) / max(abs(slope), np.float32(1e-6)), reach)
            limit2 = limit * limit
            ratio, kind_at = 0, kinds[0, 0]
            if typed:
                ratio = min(max(int((slope + 1) * half_ratios + 0.5), 0), last_ratio)
                kind_at = kinds[int(i) % cells, int(j) % cells]
            per_limit2 = 1 / limit2
            # The nearest lens lies `base` away; with a distortion that is not known so well.
            nearest = np.float32(0.75) * pitch if bent else np.sqrt(base_x * base_x + base_y * base_y)
            farthest = limit + nearest
            inside = x > margin and y > margin and x < width - 1 - margin and y < height - 1 - margin
            found = 0
            best = np.float32(np.inf)
            best_at = 0
            norm = np.float32(0.0)
            mean0 = mean1 = mean2 = mean3 = zero
            # Unpredictable branches cost more than what they leave out.
            near = 0
            for o in range(len(offsets)):
                # offsets are sorted: beyond this one none can be near enough
                if offsets[o, 2] > farthest:
                    break
                ex, ey = base_x - offsets[o, 0], base_y - offsets[o, 1]
                if bent:
                    bend_x, bend_y = displacement_at(bend, low, i + steps[o, 0], j + steps[o, 1])
                    ex, ey = ex - bend_x, ey - bend_y
                d2 = ex * ex + ey * ey
                members[near], away_x[near], away_y[near], away_2[near] = o, ex, ey, d2
                near += int(d2 <= limit2)
            near = min(near, MAX_LENSES)
            whole_x, whole_y = np.floor(x), np.floor(y)
            left_x, left_y = np.float32(x - whole_x) + view_x, np.float32(y - whole_y) + view_y
            column, line_at = np.int64(whole_x), np.int64(whole_y)
            for m in range(near):
                ex, ey, d2 = away_x[m], away_y[m], away_2[m]
                # The most central lens alone is read where none is averaged.
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
                ring = np.uint64(min(int(delta2 * per_light_step), last_ring))
                gain = gains[ring]
                # Unsigned: signed indices are looked at for being counted from the end.
                row_at, column_at = np.uint64(iy - corner[1]), np.uint64(ix - corner[0])
                upper = row_at * down + column_at * across
                gx, gy = gain * fx, np.float32(1.0) - fy
                w01, w11 = gx * gy, gx * fy
                w00, w10 = gain * gy - w01, gain * fy - w11
                value1 = value2 = value3 = zero
                value0 = _read(line, upper, across, down, w00, w01, w10, w11)
                if len(marks) > 1:
                    value1 = _read(line, upper + np.uint64(1), across, down, w00, w01, w10, w11)
                if len(marks) > 2:
                    value2 = _read(line, upper + np.uint64(2), across, down, w00, w01, w10, w11)
                if len(marks) > 3:
                    value3 = _read(line, upper + np.uint64(3), across, down, w00, w01, w10, w11)
                off_axis = d2 * per_limit2
                if aside > 0:
                    # From the middle, the first alone grows toward the rim of a microimage.
                    off_axis = max(off_axis, delta2 / radius2)
                weight = (np.float32(1.02) - off_axis) * squares[ring]
                if typed:
                    weight *= shares[kind_at[members[m]], ratio]
                if known:
                    below, right = np.uint64(fy + np.float32(0.5)), np.uint64(fx + np.float32(0.5))
                    depth = seen[row_at + below, column_at + right]
                    if abs(depth - s) > 2 * edge:
                        weight *= OCCLUDED_WEIGHT
                        if aside > 0:
                            # The surface is what `view` sees: there, something else is least likely in front.
                            beside = d2 / (pitch * pitch) + np.float32(0.05)
                            weight /= beside * beside
                        d2 += limit2
                if d2 < best:
                    best, best_at = d2, found
                    if t2 <= 0:
                        # No lens is nearer than half the way from this one to its neighbours; others lie farther
                        # from the point than from its nearest lens, less the distance of that one.
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
        out[v, u, 0] = min(total0 * per_sample + half, top)
        if len(marks) > 1:
            out[v, u, 1] = min(total1 * per_sample + half, top)
        if len(marks) > 2:
            out[v, u, 2] = min(total2 * per_sample + half, top)
        if len(marks) > 3:
            out[v, u, 3] = min(total3 * per_sample + half, top)


@njit(cache=True, nogil=True, parallel=True)
def blend_pixels(
    flat, marks, seen, gains, lights, light_step, origin, inverse, basis, bend, low, offsets, steps, types, shares,
    radius, pitch,
    surface, grid_x, grid_y, cell, edge, scale, first, spacing, blurred, reach, tolerance, view, corner, size, start,
    wanted, half, top, out, valid,
):  # fmt: skip
    """Fill `out` (h, w, C) with the mean over the lenses that see each point, `valid` (h, w) with whether there is one.

    `marks` is any tuple of C numbers: its length belongs to its type, so that code for other channels is left out;
    pixels of `flat` may have more.
    `gains` correct what a lens shows and `lights` are its illumination, over the squared distance from its centre.
    A lens counts with the square of its illumination, less toward its rim, and only as far as
    its colour agrees with the mean of all within `tolerance` (0: the most central lens alone).
    Lens (i, j) is of type `types[i % m, j % m]` and counts with the `shares` of that type, over s / D from -1 to 1;
    (0, 0) `types`: all count alike. A lens whose pixel sees another depth, by `seen` (H, W) [px], hardly counts, nor
    does one whose pixel is infinitely far, that is unlit; (0, 0) `seen` means not known. `blurred` is the square of
    the share of an output pixel's side over which lenses have averaged already. Microimages are read about `view`
    (2,) [px] beside their centres, which moves places as `warping.py` describes; output pixel (0, 0) lies at `first`
    (2,). `flat` and `seen` are the part from the pixel `corner` (2,) on of a flat of `size` (2,), and hold all that is
    read; `out` is the part of the picture from the pixel `start` (2,) on. The answers are those of the whole.
    Pixels of it that are not `wanted` (h, w) stay as they are; (0, 0) wants all. `half` is added to values, which are
    then `top` at most, so that cutting off rounds them.
    """
    # Type of each lens about one, by the indices of that: divisions of whole numbers are slow.
    cells = max(len(types), 1)
    kinds = np.zeros((cells, cells, len(offsets)), np.int64)
    if types.size > 0:
        for a in range(cells):
            for b in range(cells):
                for o in range(len(offsets)):
                    kinds[a, b, o] = types[(a + steps[o, 0]) % cells, (b + steps[o, 1]) % cells]
    squares = lights * lights
    # What is wanted comes in clusters.
    count, length, stride = plan_chunks(len(out))
    for number in prange(count):
        first_row = number * stride % count * length
        for v in range(first_row, min(first_row + length, len(out))):
            # The same type of number where this is compiled and where it is run: else the row is compiled twice.
            _draw_row(
                np.int64(v), flat, marks, seen, gains, lights, light_step, origin, inverse, basis, bend, low, offsets,
                steps, types, shares, radius, pitch, surface, grid_x, grid_y, cell, edge, scale, first,
                spacing, blurred, reach, tolerance, view, corner, size, start, wanted, half, top, out, valid,
                kinds, squares,
            )  # fmt: skip
