"""Drawing kernels: every output pixel from the microimages that see its scene point."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from .bending import bent_by, nearest_index
from .fastmath import FAST

__all__ = ["draw_rows", "patch_size_at"]

# Most lenses that may share one scene point; the nearest come first.
MAX_LENSES = 37
# Weight of a lens that sees something else: it counts only where no lens sees the point.
_HIDDEN = np.float32(1e-4)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def patch_size_at(surface, x, y, grid_x, grid_y, cell, edge):
    """Patch size at scene point (x, y): linear between grid values, nearest across a depth edge."""
    rows, columns = surface.shape
    gx = min(max((x - grid_x) / cell, np.float32(0.0)), np.float32(columns - 1))
    gy = min(max((y - grid_y) / cell, np.float32(0.0)), np.float32(rows - 1))
    i, j = min(int(gx), max(columns - 2, 0)), min(int(gy), max(rows - 2, 0))
    i1, j1 = min(i + 1, columns - 1), min(j + 1, rows - 1)
    fx, fy = gx - i, gy - j
    a, b, c, d = surface[j, i], surface[j, i1], surface[j1, i], surface[j1, i1]
    if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) < edge:
        return (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)
    return surface[j1 if fy > 0.5 else j, i1 if fx > 0.5 else i]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _crosses_edge(surface, x, y, s, half, grid_x, grid_y, cell, edge):
    """Whether a corner of the output pixel at (x, y), `half` its side away, belongs to another surface than `s`."""
    for corner in range(4):
        corner_x = np.float32(x + (half if corner % 2 else -half))
        corner_y = np.float32(y + (half if corner // 2 else -half))
        if abs(patch_size_at(surface, corner_x, corner_y, grid_x, grid_y, cell, edge) - s) > edge:
            return True
    return False


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def draw_rows(
    flat, seen, gains, lights, light_step, origin, inverse, basis, bend, low, offsets, steps, types, shares,
    radius, pitch,
    surface, grid_x, grid_y, cell, edge, scale, first, spacing, blurred, reach, tolerance, view, corner, size, start,
    out, weight_out,
):  # fmt: skip
    """Fill `out` (h, w, C) with the mean over the lenses that see each point, `weight_out` with their number.

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
    """
    width, height, channels = size[0], size[1], flat.shape[2]
    rows, columns, _ = out.shape
    last_ring = len(gains) - 1
    known = seen.size > 0
    bent = bend.size > 0
    typed = types.size > 0
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
    across, down = np.uint64(channels), np.uint64(flat.shape[1] * channels)
    for v in prange(rows):
        values = np.zeros((MAX_LENSES, 4), np.float32)
        weights = np.empty(MAX_LENSES, np.float32)
        total, mean, mixed = np.empty(4, np.float32), np.empty(4, np.float32), np.empty(4, np.float32)
        for u in range(columns):
            centre_x, centre_y = first[0] + (start[0] + u) * spacing, first[1] + (start[1] + v) * spacing
            s_here = patch_size_at(surface, np.float32(centre_x), np.float32(centre_y), grid_x, grid_y, cell, edge)
            # Side of an output pixel in the flat, and how much of it lens and pixel have not averaged already.
            side = abs(s_here) / scale
            n_sub = max(int(np.ceil(side - np.float32(0.05))), 1)
            apart = np.float32(1.0)
            if n_sub > 1 and not _crosses_edge(
                surface, centre_x, centre_y, s_here, half_step, grid_x, grid_y, cell, edge
            ):
                left = np.float32(1.0) - blurred - 1 / (side * side)
                apart = np.sqrt(max(left, np.float32(0.0)))
                n_sub = max(int(np.ceil(side * apart - np.float32(0.05))), 1)
            apart *= spacing / n_sub
            for k in range(4):
                total[k] = 0.0
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
                i, j = nearest_index(x, y, origin, inverse, bend, low)
                base_x = np.float32(x - origin[0] - (i * basis[0, 0] + j * basis[1, 0]))
                base_y = np.float32(y - origin[1] - (i * basis[0, 1] + j * basis[1, 1]))
                limit = min((radius + aside) / max(abs(slope), np.float32(1e-6)), reach)
                limit2 = limit * limit
                per_limit2 = 1 / limit2
                # The nearest lens lies `base` away; with a distortion that is not known so well.
                nearest = np.float32(0.75) * pitch if bent else np.sqrt(base_x * base_x + base_y * base_y)
                farthest = limit + nearest
                inside = x > margin and y > margin and x < width - 1 - margin and y < height - 1 - margin
                found = 0
                best = np.float32(np.inf)
                best_at = 0
                norm = np.float32(0.0)
                for k in range(4):
                    mean[k] = 0.0
                for o in range(len(offsets)):
                    # offsets are sorted: beyond this one none can be near enough
                    if offsets[o, 2] > farthest or found == MAX_LENSES:
                        break
                    ex, ey = base_x - offsets[o, 0], base_y - offsets[o, 1]
                    if bent:
                        bend_x, bend_y = bent_by(bend, low, i + steps[o, 0], j + steps[o, 1])
                        ex, ey = ex - bend_x, ey - bend_y
                    d2 = ex * ex + ey * ey
                    if d2 > limit2:
                        continue
                    dx, dy = view_x - ex * slope, view_y - ey * slope
                    delta2 = dx * dx + dy * dy
                    if aside > 0 and delta2 > radius2:
                        continue
                    px, py = x - ex + dx, y - ey + dy
                    if not inside:
                        if not (px >= 0 and py >= 0 and px <= width - 1 and py <= height - 1):
                            continue
                        if x - ex < -0.5 or y - ey < -0.5 or x - ex >= width - 0.5 or y - ey >= height - 0.5:
                            continue
                    ring = np.uint64(min(int(delta2 / light_step), last_ring))
                    gain = gains[ring]
                    ix, iy = min(int(px), width - 2), min(int(py), height - 2)
                    fx, fy = np.float32(px - ix), np.float32(py - iy)
                    # Unsigned: signed indices are looked at for being counted from the end.
                    upper = np.uint64(((iy - corner[1]) * flat.shape[1] + ix - corner[0]) * channels)
                    w00, w01 = (1 - fx) * (1 - fy), fx * (1 - fy)
                    w10, w11 = (1 - fx) * fy, fx * fy
                    for k in range(channels):
                        at = upper + np.uint64(k)
                        values[found, k] = gain * (
                            w00 * np.float32(line[at])
                            + w01 * np.float32(line[at + across])
                            + w10 * np.float32(line[at + down])
                            + w11 * np.float32(line[at + down + across])
                        )
                    away = d2 * per_limit2
                    if aside > 0:
                        # From the middle, the first alone grows toward the rim of a microimage.
                        away = max(away, delta2 / radius2)
                    weights[found] = (np.float32(1.02) - away) * lights[ring] * lights[ring]
                    if typed:
                        kind = types[int(i + steps[o, 0]) % len(types), int(j + steps[o, 1]) % len(types)]
                        share = shares[kind, min(max(int((slope + 1) * half_ratios + 0.5), 0), last_ratio)]
                        weights[found] *= share
                    if known:
                        depth = seen[np.uint64(int(py + 0.5) - corner[1]), np.uint64(int(px + 0.5) - corner[0])]
                        if abs(depth - s) > 2 * edge:
                            weights[found] *= _HIDDEN
                            if aside > 0:
                                # The surface is what `view` sees: there, something else is least likely in front.
                                beside = d2 / (pitch * pitch) + np.float32(0.05)
                                weights[found] /= beside * beside
                            d2 += limit2
                    if d2 < best:
                        best, best_at = d2, found
                    norm += weights[found]
                    for k in range(4):
                        mean[k] += weights[found] * values[found, k]
                    found += 1
                if found == 0:
                    continue
                if t2 <= 0:
                    for k in range(channels):
                        total[k] += values[best_at, k]
                    total_weight += 1
                    continue
                for k in range(4):
                    mean[k] /= norm
                    mixed[k] = 0.0
                norm = np.float32(0.0)
                for n in range(found):
                    difference = np.float32(0.0)
                    for k in range(4):
                        e = values[n, k] - mean[k]
                        difference += e * e
                    agree = t2 / (t2 + difference / channels)
                    weight = weights[n] * agree * agree
                    norm += weight
                    for k in range(4):
                        mixed[k] += weight * values[n, k]
                for k in range(4):
                    total[k] += mixed[k] / norm
                total_weight += 1
            weight_out[v, u] = total_weight / (n_sub * n_sub)
            for k in range(channels):
                out[v, u, k] = total[k] / total_weight if total_weight > 0 else np.float32(0.0)
