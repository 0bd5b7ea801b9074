"""The paper's picture of one patch size at full resolution: a patch of each microimage, laid side by side.

An output pixel is as large as a pixel of the flat there (Lumsdaine and Georgiev 2008, section 4), so that neighbours
from one lens lie a whole pixel apart: along a row they share their weights, and one loop over bytes that follow each
other reads them all.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice

from .fastmath import FAST

__all__ = ["lay_patches"]

# Steps per pixel at which the gain is tabled: between them it changes by less than a grey level.
_PHASES = 4
# Values are read in bunches of so many, as vector instructions want it: those beyond the end of a run are overwritten
# by the next.
_BUNCH = 32


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _read_run(flat, at, across, down, wa, wb, wc, wd, gain, gain_at, half, top, out, start, size):
    """Weighted sum of four rows of values, times the gain where there is one, rounded by adding `half`.

    Places are unsigned: signed ones are looked at for being counted from the end.
    """
    at_b, at_c, at_d = at + across, at + down, at + down + across
    if len(gain) == 0:
        for k in range(size):
            value = wa * np.float32(flat[at + k]) + wb * np.float32(flat[at_b + k])
            value += wc * np.float32(flat[at_c + k]) + wd * np.float32(flat[at_d + k])
            out[start + k] = value + half
    else:
        for k in range(size):
            value = wa * np.float32(flat[at + k]) + wb * np.float32(flat[at_b + k])
            value += wc * np.float32(flat[at_c + k]) + wd * np.float32(flat[at_d + k])
            out[start + k] = min(value * gain[gain_at + k] + half, top)


@njit(cache=True, nogil=True, fastmath=FAST)
def _start(x, y, origin, inverse, basis, steps):
    """Index of the lens whose centre is nearest to (x, y)."""
    i = np.rint((x - origin[0]) * inverse[0, 0] + (y - origin[1]) * inverse[1, 0])
    j = np.rint((x - origin[0]) * inverse[0, 1] + (y - origin[1]) * inverse[1, 1])
    best, best_i, best_j = np.inf, i, j
    for n in range(-1, len(steps)):
        near_i = i + (steps[n, 0] if n >= 0 else 0)
        near_j = j + (steps[n, 1] if n >= 0 else 0)
        ex = x - origin[0] - near_i * basis[0, 0] - near_j * basis[1, 0]
        ey = y - origin[1] - near_i * basis[0, 1] - near_j * basis[1, 1]
        if ex * ex + ey * ey < best:
            best, best_i, best_j = ex * ex + ey * ey, near_i, near_j
    return best_i, best_j


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _lay(
    flat, width, channels, origin, inverse, basis, steps, turned, first, spacing, gains, reach, half, top, box, out
):  # fmt: skip
    """Fill the rows and columns of `box` (left, top, right, bottom) of `out` (h, w C) from `flat` (H W C)."""
    # To the right a row leaves the cell of a lens where it meets the nearest half-way line x = room + tilt * y to one
    # of those, from the centre and in output pixels.
    around, room, tilt = np.empty((len(steps), 2)), np.empty(len(steps)), np.empty(len(steps))
    count = 0
    per_spacing = 1 / spacing
    for n in range(len(steps)):
        ex = (steps[n, 0] * basis[0, 0] + steps[n, 1] * basis[1, 0]) * per_spacing
        ey = (steps[n, 0] * basis[0, 1] + steps[n, 1] * basis[1, 1]) * per_spacing
        if ex > 1e-9:
            around[count, 0], around[count, 1] = ex, ey
            room[count], tilt[count] = 0.5 * (ex * ex + ey * ey) / ex, -ey / ex
            count += 1
    slope = -1.0 if turned else 1.0
    bunch, one, phases = np.uint64(_BUNCH), np.uint64(1), np.uint64(_PHASES)
    across, down = np.uint64(channels), np.uint64(width * channels)
    gain = gains.reshape(-1)
    gain_line = np.uint64(gains.shape[2])
    for v in prange(box[1], box[3]):
        row = out[v]
        # The border is wider than what is written beyond the end.
        line = np.empty_like(row) if turned else row
        y = first + v * spacing
        u = box[0]
        i, j = _start(first + u * spacing, y, origin, inverse, basis, steps)
        # In output pixels from here on.
        cx = (origin[0] + i * basis[0, 0] + j * basis[1, 0] - first) * per_spacing
        cy = (origin[1] + i * basis[0, 1] + j * basis[1, 1] - first) * per_spacing
        while u < box[2]:
            away, following = np.inf, 0
            for n in range(count):
                meets = room[n] + tilt[n] * (v - cy)
                if meets < away:
                    away, following = meets, n
            end = min(int(np.ceil(cx + away)), box[2])
            if end > u:
                place = end - 1 if turned else u
                dx, dy = (place - cx) * slope, (v - cy) * slope
                px, py = cx * spacing + first + dx, cy * spacing + first + dy
                ix, iy = np.uint64(px), np.uint64(py)
                fx, fy = np.float32(px - ix), np.float32(py - iy)
                start = np.uint64(u) * across
                size = (np.uint64(end - u) * across + bunch - one) // bunch * bunch
                gain_at = np.uint64(0)
                if len(gain) > 0:
                    column = np.uint64((dx + reach) * _PHASES + 0.5)
                    gain_row = np.uint64((dy + reach) * _PHASES + 0.5) * phases + column % phases
                    gain_at = gain_row * gain_line + column // phases * across
                _read_run(
                    flat, iy * down + ix * across, across, down,
                    (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy, gain, gain_at, half, top,
                    line, start, size,
                )  # fmt: skip
                if turned and channels == 3:
                    # The compiler has better instructions for steps that it knows.
                    for k in range(end - u):
                        into, at = np.uint64(3 * (end - 1 - k)), np.uint64(3 * (u + k))
                        row[into] = line[at]
                        row[into + np.uint64(1)] = line[at + np.uint64(1)]
                        row[into + np.uint64(2)] = line[at + np.uint64(2)]
                elif turned:
                    for k in range(end - u):
                        for c in range(channels):
                            row[(end - 1 - k) * channels + c] = line[(u + k) * channels + c]
                u = end
            cx, cy = cx + around[following, 0], cy + around[following, 1]


def _farthest(lattice: Lattice) -> float:
    """How far [px] places may lie from the nearest centre: the circle through three centres about one."""
    a, b = lattice.basis
    c = a - b if np.hypot(*(a - b)) < np.hypot(*(a + b)) else a + b
    return float(np.hypot(*a) * np.hypot(*b) * np.hypot(*c) / (2 * abs(a[0] * b[1] - a[1] * b[0])))


def lay_patches(
    pixels: NDArray,
    lattice: Lattice,
    patch_size: float,
    first: float,
    gains: NDArray[np.float32],
    gain_step: float,
    out: NDArray,
) -> tuple[int, int, int, int]:
    """Read each pixel of a picture of `|patch_size|` pixels per pitch from the lens whose centre is nearest.

    Parameters
    ----------
    pixels : (H, W, C) uint8, uint16 or float32
    lattice : Lattice
        A straight one.
    patch_size : float [px]
    first : float [px]
        Scene coordinates of output pixel (0, 0).
    gains : (k,) float32
        Gain over the squared distance from the centre, as `gain_table`.
    gain_step : float [px^2]
    out : (h, w, C) array of the type of `pixels`
        The picture.

    Returns
    -------
    (int, int, int, int)
        Columns and rows that have been filled: the first and the one after the last, order `left, top, right, bottom`.
        Beside them, at the border, lenses and pixels are missing.
    """
    _, width, channels = pixels.shape
    spacing = lattice.pitch / abs(patch_size)
    # Nearer to the border lenses or their pixels may be missing: only telescopic patches reach beyond their lens.
    border = _farthest(lattice) * (1 + max(patch_size, 0.0) / lattice.pitch) + 3
    inner = max(int(np.ceil((border - first) / spacing)), _BUNCH)
    rows, columns = out.shape[:2]
    box = (min(inner, columns), min(inner, rows), max(columns - inner, inner), max(rows - inner, inner))
    if box[2] > columns or box[3] > rows:
        return (columns, rows, columns, rows)
    steps = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
    steps = np.concatenate([steps, -steps])
    reach = int(np.ceil(_farthest(lattice) / spacing)) + 2
    table = np.empty((0, 0, 0), np.float32)
    if not (gains == gains[0]).all() or gains[0] != 1:
        along = np.arange(-reach * _PHASES, (reach + 1) * _PHASES) / _PHASES
        squared = along[:, None] ** 2 + along**2
        table = gains[np.minimum((squared / gain_step).astype(int), len(gains) - 1)]
        # One line for each phase, and each value once for every channel.
        table = np.repeat(table.reshape(len(along), -1, _PHASES).transpose(0, 2, 1), channels, 2)
        table = np.pad(table, ((0, 0), (0, 0), (0, _BUNCH)))
    whole = pixels.dtype.kind in "ui"
    _lay(
        pixels.reshape(-1), width, channels, lattice.origin, np.linalg.inv(lattice.basis), lattice.basis, steps,
        patch_size > 0, first, spacing, np.ascontiguousarray(table), reach, np.float32(0.5 if whole else 0.0),
        np.float32(np.iinfo(pixels.dtype).max if whole else np.inf), np.array(box), out.reshape(rows, -1),
    )  # fmt: skip
    return box
