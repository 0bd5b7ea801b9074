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
from lfcal.runtime.fastmath import FAST

from ..runtime.cache import cached
from ..runtime.intrinsics import (
    GAIN_BITS,
    LEFT_BITS,
    TOGETHER,
    TURNED,
    prefetch,
    read_bytes,
    read_turned,
    read_turned_with_gain,
    read_with_gain,
)

__all__ = ["covers_all_patches", "render_patches"]

# Steps per pixel at which the gain is tabled: between them it changes by a fraction of a grey level.
_PHASES = 8
# Values are read in bunches of so many, bytes in such as intrinsics take, as vector instructions want it: those beyond
# the end of a run are overwritten by the next.
_BUNCH = 32
# Processors fetch so many bytes at once.
_LINE_OF_MEMORY = 64
# Memory takes as long to come as so many lenses take to read.
_LATER = 8


@njit(cache=True, nogil=True, error_model="numpy", fastmath=False, forceinline=True)
def _weights_of_bytes(fx, fy):
    """Weights of the four pixels about a place in whole 256ths, rounded so that their sum is 256 whatever they are."""
    right, low = np.rint(256 * fx), np.rint(256 * fy)
    corner = np.rint(right * low / 256)
    return (
        np.uint16(256 - right - low + corner), np.uint16(right - corner), np.uint16(low - corner), np.uint16(corner),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _read_turned_run(flat, at, across, down, fx, fy, gain, gain_at, out, start, size):
    """Pixels of three bytes as `_read_run_of_bytes`, the last first: those before the places `at` and `gain_at`."""
    weights = _weights_of_bytes(fx, fy)
    bunch = np.uint64(3 * TURNED)
    for k in range(np.uint64(0), size, bunch):
        # The last bunch begins within the one before it.
        into = min(k, size - bunch)
        place = at - into - bunch
        places = (place, place + across, place + down, place + down + across)
        if len(gain) == 0:
            read_turned(flat, places, weights, out, start + into)
        else:
            read_turned_with_gain(flat, places, weights, gain, gain_at - into - bunch, out, start + into)


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
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


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy", forceinline=True)
def _read_run_of_bytes(flat, at, across, down, fx, fy, gain, gain_at, out, start, size):
    """The same of bytes, with weights of whole 256ths: twice as many at a time."""
    at_b, at_c, at_d = at + across, at + down, at + down + across
    wa, wb, wc, wd = _weights_of_bytes(fx, fy)
    # The last bunch begins within the one before it; fewer bytes than one are read one by one.
    bunch = np.uint64(TOGETHER)
    bunched = size if size >= bunch else np.uint64(0)
    if len(gain) == 0:
        for n in range(np.uint64(0), bunched, bunch):
            k = min(n, size - bunch)
            read_bytes(flat, (at + k, at_b + k, at_c + k, at_d + k), (wa, wb, wc, wd), out, start + k)
        for k in range(bunched, size):
            value = np.uint16(wa * flat[at + k] + wb * flat[at_b + k] + wc * flat[at_c + k] + wd * flat[at_d + k])
            out[start + k] = np.uint16(value + np.uint16(128)) >> np.uint16(8)
    else:
        for n in range(np.uint64(0), bunched, bunch):
            k = min(n, size - bunch)
            read_with_gain(
                flat, (at + k, at_b + k, at_c + k, at_d + k), (wa, wb, wc, wd), gain, gain_at + k, out, start + k
            )
        for k in range(bunched, size):
            value = np.uint16(wa * flat[at + k] + wb * flat[at_b + k] + wc * flat[at_c + k] + wd * flat[at_d + k])
            value = np.uint16((np.uint32(value) * np.uint32(gain[gain_at + k])) >> np.uint32(16))
            value = np.uint16(value + np.uint16(1 << (LEFT_BITS - 1))) >> np.uint16(LEFT_BITS)
            out[start + k] = min(value, np.uint16(255))


@njit(cache=True, nogil=True, inline="always")
def _bunched(length, bunch, overlap):
    """How much is read of a run: as much as it has where bunches may `overlap`, but a whole one; else the next whole
    number of them."""
    return max(length, bunch) if overlap else (length + bunch - np.uint64(1)) // bunch * bunch


@njit(cache=True, nogil=True)
def _put(line, row, first, last, channels, turned):
    """Put the pixels of `line` from `first` to `last` into `row`, the last first where they are `turned`."""
    if not turned:
        for k in range(first * channels, last * channels):
            row[k] = line[k]
    elif channels == 3:
        one = np.uint64(1)
        # The compiler has better instructions for steps that it knows.
        for k in range(last - first):
            target, source = np.uint64(3 * (last - 1 - k)), np.uint64(3 * (first + k))
            row[target], row[target + one] = line[source], line[source + one]
            row[target + one + one] = line[source + one + one]
    else:
        for k in range(last - first):
            for c in range(channels):
                row[(last - 1 - k) * channels + c] = line[(first + k) * channels + c]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True, error_model="numpy")
def _read_beside(
    flat, width, channels, corner, size, x, y, lenses, slope, radius2, gains, per_step, half, top, row, at
):
    """One pixel of the picture from the nearest of some `lenses` (k, 2) that shows the point (x, y) on the flat."""
    nearest, lens = np.inf, -1
    for k in range(len(lenses)):
        ex, ey = x - lenses[k, 0], y - lenses[k, 1]
        away = ex * ex + ey * ey
        on_x = -0.5 <= lenses[k, 0] < size[0] - 0.5 and 0 <= lenses[k, 0] - ex * slope <= size[0] - 1
        on_y = -0.5 <= lenses[k, 1] < size[1] - 0.5 and 0 <= lenses[k, 1] - ey * slope <= size[1] - 1
        if on_x and on_y and away < nearest and away * slope * slope <= radius2:
            nearest, lens = away, k
    for c in range(channels):
        row[at + c] = 0
    if lens < 0:
        return False
    px, py = lenses[lens, 0] * (1 + slope) - x * slope, lenses[lens, 1] * (1 + slope) - y * slope
    ix, iy = min(int(px), size[0] - 2), min(int(py), size[1] - 2)
    fx, fy = np.float32(px - ix), np.float32(py - iy)
    gain = gains[min(int(nearest * slope * slope * per_step), len(gains) - 1)]
    across, down = channels, width * channels
    for c in range(channels):
        place = (iy - corner[1]) * down + (ix - corner[0]) * across + c
        upper = flat[place] * (1 - fx) + flat[place + across] * fx
        lower = flat[place + down] * (1 - fx) + flat[place + down + across] * fx
        row[at + c] = min(gain * (upper * (1 - fy) + lower * fy) + half, top)
    return True


# Sums of places in any order would differ between a process that compiles this and one that loads it.
@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _lay(
    flat, width, channels, corner, size, origin, inverse, basis, steps, patch_slope, first, spacing, radius2, gains,
    per_gain_step, tabled, reach, half, top, part, out, valid,
):  # fmt: skip
    """Fill `out` (rows, columns C), which is the `part` (left, top, right, bottom) of the picture, from `flat` (h w C).

    `flat` begins at the pixel `corner` (2,) of the whole flat of `size` (2,). Every row is followed from the first
    column of the picture on, and all weights belong to a lens and not to a part, so that parts are the same bit for bit
    as the whole.
    """
    # To the right a row leaves the cell of a lens where it meets the nearest half-way line x = room + tilt * y to one
    # of those, from the centre and in output pixels.
    around, room, tilt = np.empty((len(steps), 2)), np.empty(len(steps)), np.empty(len(steps))
    beside = np.zeros((len(steps) + 1, 2))
    count = 0
    per_spacing = 1 / spacing
    for n in range(len(steps)):
        beside[n, 0] = steps[n, 0] * basis[0, 0] + steps[n, 1] * basis[1, 0]
        beside[n, 1] = steps[n, 0] * basis[0, 1] + steps[n, 1] * basis[1, 1]
        ex, ey = beside[n, 0] * per_spacing, beside[n, 1] * per_spacing
        if ex > 1e-9:
            around[count, 0], around[count, 1] = ex, ey
            room[count], tilt[count] = 0.5 * (ex * ex + ey * ey) / ex, -ey / ex
            count += 1
    turned, of_bytes = patch_slope > 0, flat.itemsize == 1
    slope = -1 if turned else 1
    bunch, turned_bunch = np.uint64(TOGETHER if of_bytes else _BUNCH), np.uint64(3 * TURNED)
    phases, line_of_memory = np.uint64(_PHASES), np.uint64(_LINE_OF_MEMORY // flat.itemsize)
    at_once = turned and of_bytes and channels == 3
    across, down = np.uint64(channels), np.uint64(width * channels)
    gain = tabled.reshape(-1)
    gain_line = np.uint64(tabled.shape[2])
    # Two rows from a place on, with what is read beyond the end of a run.
    last_place = np.uint64(len(flat) - (width + 1) * channels)
    # The first row of a patch lies farther above the centre than this.
    nearest = np.inf
    for n in range(len(steps)):
        nearest = min(nearest, np.sqrt(beside[n, 0] ** 2 + beside[n, 1] ** 2))
    above = 0.5 * nearest * per_spacing - 1
    for v in prange(part[1], part[3]):
        row, seen = out[v - part[1]], valid[v - part[1]]
        seen[:] = True
        room_in_row = np.uint64(len(row))
        line = np.empty(len(row) + _BUNCH, out.dtype)
        lenses = np.empty(beside.shape)
        y = first + v * spacing
        u = 0
        i, j = _start(first, y, origin, inverse, basis, steps)
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
                lens_x, lens_y = cx * spacing + first, cy * spacing + first
                px, py = lens_x + dx, lens_y + dy
                column, line_at = int(np.floor(px)), int(np.floor(py))
                # The lens shows those from `low` to `high` with all four pixels that they are read from: mostly all.
                low, high = u, end
                leftmost = column + (middle - end + 1 if turned else u - middle)
                inside = (leftmost >= 0) & (leftmost + end - u < size[0]) & (line_at >= 0) & (line_at < size[1] - 1)
                inside &= (lens_x >= 0) & (lens_x < size[0] - 1) & (lens_y >= 0) & (lens_y < size[1] - 1)
                if not inside:
                    low, high = middle - column, middle - column + size[0] - 1
                    if turned:
                        low, high = middle + column - size[0] + 2, middle + column + 1
                    if not (-0.5 <= lens_x < size[0] - 0.5 and -0.5 <= lens_y < size[1] - 0.5):
                        high = low
                    if not 0 <= line_at < size[1] - 1:
                        high = low
                    low = min(max(low, u), end)
                    high = min(max(high, low), end)
                if low > u or high < end:
                    for n in range(len(beside)):
                        lenses[n, 0], lenses[n, 1] = lens_x + beside[n, 0], lens_y + beside[n, 1]
                    for k in range(u, end):
                        if low <= k < high:
                            continue
                        seen[k - part[0]] = _read_beside(
                            flat, width, channels, corner, size, first + k * spacing, y, lenses, patch_slope, radius2,
                            gains, per_gain_step, half, top, row, (k - part[0]) * channels,
                        )  # fmt: skip
                if high > low:
                    fx, fy = np.float32(px - column), np.float32(py - line_at)
                    from_middle = ((high - 1 if turned else low) - middle) * slope
                    at = np.uint64(line_at - corner[1]) * down + np.uint64(column + from_middle - corner[0]) * across
                    into = np.uint64(low - part[0]) * across
                    length = np.uint64(high - low) * across
                    # The next row of the picture reads one more row here: lenses lie at too odd steps to be foreseen.
                    ahead = at - down if turned else at + down + down
                    # What is read beyond a run must be there as well, though it is not used.
                    bunched, turned_length = _bunched(length, bunch, of_bytes), max(length, turned_bunch)
                    begin, beyond = ahead, ahead + bunched + across
                    if at_once:
                        begin, beyond = ahead + length - turned_length, ahead + length + across
                    prefetch(flat, begin)
                    prefetch(flat, beyond)
                    for k in range(begin + line_of_memory, beyond, line_of_memory):
                        prefetch(flat, k)
                    # Before the first row of a patch there is none to have it fetched; lenses are looked up ahead.
                    if cy - v > above:
                        later_x, later_y = cx + _LATER * around[following, 0], cy + _LATER * around[following, 1]
                        y_there = int(later_y * spacing + first + (v - later_y) * slope) - corner[1]
                        x_there = int(later_x * spacing + first) + from_middle - corner[0]
                        later = np.uint64(y_there) * down + np.uint64(x_there) * across
                        for k in range(np.uint64(0), length + line_of_memory, line_of_memory):
                            prefetch(flat, later + k)
                            prefetch(flat, later + down + k)
                    gain_at = np.uint64(0)
                    if len(gain) > 0:
                        step = np.uint64(int((dx + reach) * _PHASES + 0.5) + from_middle * _PHASES)
                        gain_row = np.uint64((dy + reach) * _PHASES + 0.5) * phases + step % phases
                        gain_at = gain_row * gain_line + step // phases * across + np.uint64(_BUNCH)
                    # What is written beyond the end of a run must neither leave the row nor cover what is written, nor
                    # may what is read leave the flat.
                    spare = high == end and turned_length < min(at + length, room_in_row - into)
                    if at_once and spare and at + length < last_place:
                        _read_turned_run(
                            flat, at + length, across, down, fx, fy, gain, gain_at + length, row, into, turned_length
                        )
                    else:
                        if at + bunched <= last_place:
                            length = bunched
                        direct = not turned and high == end and into + length <= room_in_row
                        to = row if direct else line
                        if of_bytes:
                            _read_run_of_bytes(flat, at, across, down, fx, fy, gain, gain_at, to, into, length)
                        else:
                            _read_run(flat, at, across, down, fx, fy, gain, gain_at, half, top, to, into, length)
                        if not direct:
                            _put(line, row, low - part[0], high - part[0], channels, turned)
                u = end
            cx, cy = cx + around[following, 0], cy + around[following, 1]


def _cell(lattice: Lattice) -> NDArray[np.float64]:
    """(6, 2) corners of the places to which a centre is the nearest, from there [px]; a square's may coincide."""
    return cached(lattice, "cell", lambda: _corners(*lattice.basis))


def _corners(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    if a @ b < 0:
        b = -b
    # Each is as far from the centre as from two of its neighbours.
    around = [a, b, b - a, -a]
    corners = [np.linalg.solve(np.array(pair), np.square(pair).sum(1) / 2) for pair in itertools.pairwise(around)]
    return np.concatenate([corners, np.negative(corners)])


def covers_all_patches(lattice: Lattice, patch_size: float, radius: float) -> bool:
    """Whether microimages of this `radius` [px] hold whole patches, to the corners between three lenses."""
    corner = float(np.linalg.norm(_cell(lattice), axis=1).max())
    return corner * abs(patch_size) / lattice.pitch <= radius


def render_patches(
    pixels: NDArray,
    corner: tuple[int, int],
    lattice: Lattice,
    patch_size: float,
    first: float,
    radius: float,
    gains: NDArray[np.float32],
    gain_step: float,
    part: tuple[int, int, int, int],
) -> tuple[NDArray, NDArray[np.bool_]]:
    """Read each pixel of a picture of `|patch_size|` pixels per pitch from the lens whose centre is nearest.

    At the border of the flat, where that lens or some of its pixels is missing, the nearest beside it takes its place.

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
    radius : float [px]
        So far from its centre a lens takes the place of a missing one.
    gains : (k,) float32
        Gain over the squared distance from the centre, as `gain_table`.
    gain_step : float [px^2]
    part : (int, int, int, int)
        Columns and rows `left, top, right, bottom` of the picture.

    Returns
    -------
    image : (rows, columns, C) array of the type of `pixels`
    valid : (rows, columns) bool
        Pixels that some lens has seen.
    """
    spacing = lattice.pitch / abs(patch_size)
    steps = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
    steps = np.concatenate([steps, -steps])
    channels = pixels.shape[2]
    reach = int(np.ceil(np.abs(_cell(lattice)).max() / spacing)) + 2
    table = np.empty((0, 0, 0), np.uint16 if pixels.dtype == np.uint8 else np.float32)
    if not (gains == gains[0]).all() or gains[0] != 1:
        along = np.arange(-reach * _PHASES, (reach + 1) * _PHASES) / _PHASES
        squared = along[:, None] ** 2 + along**2
        table = gains[np.minimum((squared / gain_step).astype(int), len(gains) - 1)]
        # One line for each phase, and each value once for every channel.
        table = np.repeat(table.reshape(len(along), -1, _PHASES).transpose(0, 2, 1), channels, 2)
        table = np.pad(table, ((0, 0), (0, 0), (_BUNCH, _BUNCH)))
        if pixels.dtype == np.uint8:
            table = np.minimum(np.rint(table * (1 << GAIN_BITS)), np.iinfo(np.uint16).max).astype(np.uint16)
    whole = pixels.dtype.kind in "ui"
    rows, columns = part[3] - part[1], part[2] - part[0]
    image, valid = np.empty((rows, columns, channels), pixels.dtype), np.empty((rows, columns), bool)
    _lay(
        np.ascontiguousarray(pixels).reshape(-1), pixels.shape[1], channels, np.array(corner),
        np.array(lattice.image_size), lattice.origin, np.linalg.inv(lattice.basis), lattice.basis, steps,
        patch_size / lattice.pitch, first, spacing, radius * radius, gains, 1 / gain_step,
        np.ascontiguousarray(table), reach, np.float32(0.5 if whole else 0.0),
        np.float32(np.iinfo(pixels.dtype).max if whole else np.inf), np.array(part), image.reshape(rows, -1), valid,
    )  # fmt: skip
    return image, valid
