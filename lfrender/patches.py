"""The paper's picture of one patch size at full resolution: a patch of each microimage, laid side by side.

An output pixel is as large as a pixel of the flat there (Lumsdaine and Georgiev 2008, section 4), so that neighbours
from one lens lie a whole pixel apart: along a row they share their weights, and one loop over bytes that follow each
other reads them all.
"""

from __future__ import annotations

import itertools

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice

from .fastmath import FAST

__all__ = ["lay_patches", "whole_patches"]

# Steps per pixel at which the gain is tabled: between them it changes by a fraction of a grey level.
_PHASES = 8
# Values are read in bunches of so many, as vector instructions want it: those beyond the end of a run are overwritten
# by the next.
_BUNCH = 32


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _read_run(flat, at, across, down, fx, fy, gain, gain_at, half, top, out, start, size):
    """Values between four rows of values, times the gain where there is one, rounded by adding `half`.

    Places are unsigned: signed ones are looked at for being counted from the end.
    """
    at_b, at_c, at_d = at + across, at + down, at + down + across
    wa, wb, wc = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy
    wd = fx * fy
    for k in range(size):
        value = wa * np.float32(flat[at + k]) + wb * np.float32(flat[at_b + k])
        value += wc * np.float32(flat[at_c + k]) + wd * np.float32(flat[at_d + k])
        if len(gain) > 0:
            value *= gain[gain_at + k]
        out[start + k] = min(value + half, top)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", inline="always")
def _read_run_of_bytes(flat, at, across, down, fx, fy, gain, gain_at, half, top, out, start, size):
    """The same of bytes, with weights of whole 256ths: twice as many at a time."""
    at_b, at_c, at_d = at + across, at + down, at + down + across
    # Rounded so that their sum is 256 whatever they are.
    right, low = np.rint(256 * fx), np.rint(256 * fy)
    corner = np.rint(right * low / 256)
    wb, wc, wd = np.uint16(right - corner), np.uint16(low - corner), np.uint16(corner)
    wa = np.uint16(256 - right - low + corner)
    if len(gain) == 0:
        for k in range(size):
            value = np.uint16(wa * flat[at + k] + wb * flat[at_b + k] + wc * flat[at_c + k] + wd * flat[at_d + k])
            out[start + k] = np.uint16(value + np.uint16(128)) >> np.uint16(8)
    else:
        for k in range(size):
            value = np.uint16(wa * flat[at + k] + wb * flat[at_b + k] + wc * flat[at_c + k] + wd * flat[at_d + k])
            out[start + k] = min(np.float32(value) * (gain[gain_at + k] * np.float32(1 / 256)) + half, top)


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
    flat, width, channels, corner, origin, inverse, basis, steps, turned, first, spacing, left, gains, reach, half, top,
    part, start, out,
):  # fmt: skip
    """Fill the columns and rows of `part` (left, top, right, bottom) of the picture from `flat` (h w C).

    `flat` begins at the pixel `corner` (2,) of the whole flat, `out` (rows, columns C) at the pixel `start` (2,) of the
    picture. Every row is followed from column `left` on, and all weights belong to a lens and not to a part, so that
    parts are the same bit for bit as the whole.
    """
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
    slope = -1 if turned else 1
    bunch, one, phases = np.uint64(_BUNCH), np.uint64(1), np.uint64(_PHASES)
    across, down = np.uint64(channels), np.uint64(width * channels)
    gain = gains.reshape(-1)
    gain_line = np.uint64(gains.shape[2])
    # What is written beyond the end of a run must not leave the row.
    direct = not turned and (part[2] - start[0]) * channels + _BUNCH <= out.shape[1]
    for v in prange(part[1], part[3]):
        row = out[v - start[1]]
        line = row if direct else np.empty(out.shape[1] + _BUNCH, out.dtype)
        y = first + v * spacing
        u = left
        i, j = _start(first + u * spacing, y, origin, inverse, basis, steps)
        # In output pixels from here on.
        cx = (origin[0] + i * basis[0, 0] + j * basis[1, 0] - first) * per_spacing
        cy = (origin[1] + i * basis[0, 1] + j * basis[1, 1] - first) * per_spacing
        while u < part[2]:
            away, following = np.inf, 0
            for n in range(count):
                meets = room[n] + tilt[n] * (v - cy)
                if meets < away:
                    away, following = meets, n
            end = min(int(np.ceil(cx + away)), part[2])
            u = max(u, min(end, part[0]))
            if end > u:
                # All pixels of a run lie a whole number of pixels from the one next to the centre.
                middle = int(np.rint(cx))
                dx, dy = (middle - cx) * slope, (v - cy) * slope
                px, py = cx * spacing + first + dx, cy * spacing + first + dy
                fx, fy = np.float32(px - np.floor(px)), np.float32(py - np.floor(py))
                beside = ((end - 1 if turned else u) - middle) * slope
                ix, iy = np.uint64(int(np.floor(px)) + beside - corner[0]), np.uint64(int(np.floor(py)) - corner[1])
                into = np.uint64(u - start[0]) * across
                size = (np.uint64(end - u) * across + bunch - one) // bunch * bunch
                gain_at = np.uint64(0)
                if len(gain) > 0:
                    column = np.uint64(int((dx + reach) * _PHASES + 0.5) + beside * _PHASES)
                    gain_row = np.uint64((dy + reach) * _PHASES + 0.5) * phases + column % phases
                    gain_at = gain_row * gain_line + column // phases * across
                at = iy * down + ix * across
                if flat.itemsize == 1:
                    _read_run_of_bytes(flat, at, across, down, fx, fy, gain, gain_at, half, top, line, into, size)
                else:
                    _read_run(flat, at, across, down, fx, fy, gain, gain_at, half, top, line, into, size)
                first_k, last_k = u - start[0], end - start[0]
                if turned and channels == 3:
                    # The compiler has better instructions for steps that it knows.
                    for k in range(last_k - first_k):
                        to, at = np.uint64(3 * (last_k - 1 - k)), np.uint64(3 * (first_k + k))
                        row[to] = line[at]
                        row[to + np.uint64(1)] = line[at + np.uint64(1)]
                        row[to + np.uint64(2)] = line[at + np.uint64(2)]
                elif turned:
                    for k in range(last_k - first_k):
                        for c in range(channels):
                            row[(last_k - 1 - k) * channels + c] = line[(first_k + k) * channels + c]
                elif not direct:
                    for k in range(first_k * channels, last_k * channels):
                        row[k] = line[k]
                u = end
            cx, cy = cx + around[following, 0], cy + around[following, 1]


def _cell(lattice: Lattice) -> NDArray[np.float64]:
    """(6, 2) corners of the places to which a centre is the nearest, from there [px]; a square's may coincide."""
    a, b = lattice.basis
    if a @ b < 0:
        b = -b
    # Each is as far from the centre as from two of its neighbours.
    around = [a, b, b - a, -a]
    corners = [np.linalg.solve(np.array(pair), np.square(pair).sum(1) / 2) for pair in itertools.pairwise(around)]
    return np.concatenate([corners, np.negative(corners)])


def whole_patches(
    lattice: Lattice, patch_size: float, size: tuple[int, int], first: float
) -> tuple[int, int, int, int]:
    """Columns and rows of a picture for which neither a lens nor any of its pixels is missing.

    Parameters
    ----------
    lattice : Lattice
        A straight one.
    patch_size : float [px]
    size : (int, int)
        Columns and rows of the picture, of `|patch_size|` pixels per pitch.
    first : float [px]
        Scene coordinates of output pixel (0, 0).

    Returns
    -------
    (int, int, int, int)
        The first ones and those after the last, order `left, top, right, bottom`.
    """
    columns, rows = size
    # Only telescopic patches reach beyond their lens.
    border = np.abs(_cell(lattice)).max() * (1 + max(patch_size, 0.0) / lattice.pitch) + 3
    inner = max(int(np.ceil((border - first) * abs(patch_size) / lattice.pitch)), 0)
    # What is read beyond the end of a run lies in the two rows of the flat that follow.
    if 2 * inner >= min(columns, rows) or lattice.image_size[0] < _BUNCH:
        return 0, 0, 0, 0
    return inner, inner, columns - inner, rows - inner


def lay_patches(
    pixels: NDArray,
    corner: tuple[int, int],
    lattice: Lattice,
    patch_size: float,
    first: float,
    gains: NDArray[np.float32],
    gain_step: float,
    left: int,
    part: tuple[int, int, int, int],
    start: tuple[int, int],
    out: NDArray,
) -> None:
    """Read each pixel of a picture of `|patch_size|` pixels per pitch from the lens whose centre is nearest.

    Parameters
    ----------
    pixels : (h, w, C) uint8, uint16 or float32
        Part of the flat.
    corner : (int, int) [px]
        Flat coordinates x, y of its first pixel.
    lattice : Lattice
        A straight one.
    patch_size : float [px]
    first : float [px]
        Scene coordinates of output pixel (0, 0).
    gains : (k,) float32
        Gain over the squared distance from the centre, as `gain_table`.
    gain_step : float [px^2]
    left : int
        First column of the picture that can be filled.
    part : (int, int, int, int)
        Columns and rows `left, top, right, bottom` of the picture to be filled, within `whole_patches`.
    start : (int, int)
        Column and row of the picture at which `out` begins.
    out : (rows, columns, C) array of the type of `pixels`
    """
    spacing = lattice.pitch / abs(patch_size)
    steps = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
    steps = np.concatenate([steps, -steps])
    channels = pixels.shape[2]
    reach = int(np.ceil(np.abs(_cell(lattice)).max() / spacing)) + 2
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
        np.ascontiguousarray(pixels).reshape(-1), pixels.shape[1], channels, np.array(corner), lattice.origin,
        np.linalg.inv(lattice.basis), lattice.basis, steps, patch_size > 0, first, spacing, left,
        np.ascontiguousarray(table), reach, np.float32(0.5 if whole else 0.0),
        np.float32(np.iinfo(pixels.dtype).max if whole else np.inf), np.array(part), np.array(start),
        out.reshape(len(out), -1),
    )  # fmt: skip
