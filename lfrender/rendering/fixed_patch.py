"""Full-resolution rendering at one patch size: a patch of each microimage, laid side by side.

After Lumsdaine and Georgiev 2008, section 4. An output pixel is as large as a pixel of the flat, so that neighbours
from one lens lie a whole pixel apart: along a row they share their interpolation weights, and one loop reads them all.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels.jit import kernel

from ..runtime.cache import cached
from ..runtime.run_interpolation import (
    BUNCH,
    GAIN_BITS,
    TOGETHER,
    copy_run,
    padded_length,
    read_run,
    read_run_of_bytes,
)

__all__ = ["covers_all_patches", "render_patches"]

# Steps per pixel at which the gain is tabled: between them it changes by a fraction of a grey level.
_PHASES = 8


class _Source(NamedTuple):
    """A part of a flat."""

    pixels: Any  # (h w C,) values
    width: Any  # pixels per row
    channels: Any
    corner: Any  # (2,) int [px]: flat coordinates of the first pixel
    size: Any  # (2,) int [px]: of the whole flat


class _Lattice(NamedTuple):
    """A straight lattice."""

    origin: Any  # (2,) float64 [px]
    inverse: Any  # (2, 2) float64: of the basis
    basis: Any  # (2, 2) float64 [px]
    steps: Any  # (k, 2) int: lattice steps to the neighbours
    beside: Any  # (k + 1, 2) float64 [px]: the same on the flat, and the lens itself


class _Gain(NamedTuple):
    """Gain over the squared distance from a centre."""

    gains: Any  # (k,) float32
    per_step: Any  # [1/px^2]
    line: Any  # (n,): the same on a grid of `_PHASES` steps per pixel, one row for each phase; empty if all are 1
    line_size: Any  # uint64: values per row
    reach: Any  # [px] of the grid to each side


class _Picture(NamedTuple):
    """The picture and the part of it that is drawn."""

    slope: Any  # s / D
    first: Any  # [px] scene coordinates of pixel (0, 0)
    spacing: Any  # [px]
    radius2: Any  # [px^2] squared distance up to which a lens replaces a missing one
    half: Any  # float32: added to values before they are truncated
    top: Any  # float32: the largest value
    part: Any  # (4,) int: left, top, right, bottom


class _Borders(NamedTuple):
    """The half-way lines to the neighbours at which a row leaves the cell of a lens to the right [output px]."""

    around: Any  # (k, 2) to the neighbour
    room: Any  # (k,) the line is x = room + tilt * y from the centre
    tilt: Any  # (k,)


class _Run(NamedTuple):
    """Pixels of a row that one lens shows: they lie a whole number of pixels from the one next to its centre."""

    x: Any  # [px] lens centre on the flat
    y: Any
    middle: Any  # column of the picture next to the centre
    dx: Any  # [px] where that is read, from the centre
    dy: Any
    column: Any  # whole pixels of that place on the flat
    row: Any
    low: Any  # columns of the picture that can be read, `high` not included
    high: Any


@njit
def _find_nearest(x, y, lattice):
    """Index of the lens whose centre is nearest to (x, y)."""
    origin, inverse, basis, steps = lattice.origin, lattice.inverse, lattice.basis, lattice.steps
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


@njit(error_model="numpy")
def _read_beside(source, gain, picture, x, y, lenses, row, at):
    """One pixel of the picture from the nearest of some `lenses` (k, 2) that shows the point (x, y) on the flat."""
    size, slope, flat, corner = source.size, picture.slope, source.pixels, source.corner
    nearest, lens = np.inf, -1
    for k in range(len(lenses)):
        ex, ey = x - lenses[k, 0], y - lenses[k, 1]
        away = ex * ex + ey * ey
        on_x = -0.5 <= lenses[k, 0] < size[0] - 0.5 and 0 <= lenses[k, 0] - ex * slope <= size[0] - 1
        on_y = -0.5 <= lenses[k, 1] < size[1] - 0.5 and 0 <= lenses[k, 1] - ey * slope <= size[1] - 1
        if on_x and on_y and away < nearest and away * slope * slope <= picture.radius2:
            nearest, lens = away, k
    for c in range(source.channels):
        row[at + c] = 0
    if lens < 0:
        return False
    px, py = lenses[lens, 0] * (1 + slope) - x * slope, lenses[lens, 1] * (1 + slope) - y * slope
    ix, iy = min(int(px), size[0] - 2), min(int(py), size[1] - 2)
    fx, fy = np.float32(px - ix), np.float32(py - iy)
    factor = gain.gains[min(int(nearest * slope * slope * gain.per_step), len(gain.gains) - 1)]
    across, down = source.channels, source.width * source.channels
    for c in range(source.channels):
        place = (iy - corner[1]) * down + (ix - corner[0]) * across + c
        upper = flat[place] * (1 - fx) + flat[place + across] * fx
        lower = flat[place + down] * (1 - fx) + flat[place + down + across] * fx
        row[at + c] = min(factor * (upper * (1 - fy) + lower * fy) + picture.half, picture.top)
    return True


@njit(error_model="numpy", forceinline=True)
def _find_run(picture, size, v, u, end, cx, cy, slope):
    """The run of the columns `u` to `end` of row `v`, read from the lens at (cx, cy) [output px]."""
    middle = int(np.rint(cx))
    dx, dy = (middle - cx) * slope, (v - cy) * slope
    lens_x, lens_y = cx * picture.spacing + picture.first, cy * picture.spacing + picture.first
    column, row = int(np.floor(lens_x + dx)), int(np.floor(lens_y + dy))
    low, high = u, end
    leftmost = column + (middle - end + 1 if slope < 0 else u - middle)
    inside = (leftmost >= 0) & (leftmost + end - u < size[0]) & (row >= 0) & (row < size[1] - 1)
    inside &= (lens_x >= 0) & (lens_x < size[0] - 1) & (lens_y >= 0) & (lens_y < size[1] - 1)
    # Only those with all four pixels that they are read from.
    if not inside:
        low, high = middle - column, middle - column + size[0] - 1
        if slope < 0:
            low, high = middle + column - size[0] + 2, middle + column + 1
        if not (-0.5 <= lens_x < size[0] - 0.5 and -0.5 <= lens_y < size[1] - 0.5):
            high = low
        if not 0 <= row < size[1] - 1:
            high = low
        low = min(max(low, u), end)
        high = min(max(high, low), end)
    return _Run(lens_x, lens_y, middle, dx, dy, column, row, low, high)


@njit(error_model="numpy", forceinline=True)
def _gain_place(gain, run, from_middle, across):
    """Where the gains of a run begin in the line of the table."""
    if len(gain.line) == 0:
        return np.uint64(0)
    phases = np.uint64(_PHASES)
    step = np.uint64(int((run.dx + gain.reach) * _PHASES + 0.5) + from_middle * _PHASES)
    gain_row = np.uint64((run.dy + gain.reach) * _PHASES + 0.5) * phases + step % phases
    return gain_row * gain.line_size + step // phases * across + np.uint64(BUNCH)


@njit(error_model="numpy", forceinline=True)
def _draw_run(source, gain, picture, run, end, row, line):
    """Read a run into `row`, as far as it can be read; `line` is memory for a row."""
    flat, slope = source.pixels, -1 if picture.slope > 0 else 1
    turned, of_bytes = picture.slope > 0, flat.itemsize == 1
    across, down = np.uint64(source.channels), np.uint64(source.width * source.channels)
    low, high, left = run.low, run.high, picture.part[0]
    fx = np.float32(run.x + run.dx - run.column)
    fy = np.float32(run.y + run.dy - run.row)
    from_middle = ((high - 1 if turned else low) - run.middle) * slope
    at = np.uint64(run.row - source.corner[1]) * down
    at += np.uint64(run.column + from_middle - source.corner[0]) * across
    into, length = np.uint64(low - left) * across, np.uint64(high - low) * across
    # What is read beyond a run must exist, though it is not used.
    bunched = padded_length(length, np.uint64(TOGETHER if of_bytes else BUNCH), of_bytes)
    gain_at = _gain_place(gain, run, from_middle, across)
    # Writing beyond the end of a run must neither leave the row nor overwrite pixels, reading must not leave the flat.
    last_place, room = np.uint64(len(flat) - (source.width + 1) * source.channels), np.uint64(len(row))
    if at + bunched <= last_place:
        length = bunched
    direct = not turned and high == end and into + length <= room
    to = row if direct else line
    if of_bytes:
        read_run_of_bytes(flat, at, across, down, fx, fy, gain.line, gain_at, to, into, length)
    else:
        read_run(
            flat, at, across, down, fx, fy, gain.line, gain_at, picture.half, picture.top, to, into, length
        )  # fmt: skip
    if not direct:
        copy_run(line, row, low - left, high - left, source.channels, turned)


@njit(error_model="numpy")
def _draw_row(source, lattice, gain, picture, borders, v, row, valid):
    """Draw row `v` of the picture, cell by cell from its first column on, whatever part of it is drawn."""
    part, first, slope = picture.part, picture.first, -1 if picture.slope > 0 else 1
    valid[:] = True
    line, lenses = np.empty(len(row) + BUNCH, row.dtype), np.empty(lattice.beside.shape)
    per_spacing, y, u = 1 / picture.spacing, first + v * picture.spacing, 0
    i, j = _find_nearest(first, y, lattice)
    origin, basis = lattice.origin, lattice.basis
    # In output pixels from here on.
    cx = (origin[0] + i * basis[0, 0] + j * basis[1, 0] - first) * per_spacing
    cy = (origin[1] + i * basis[0, 1] + j * basis[1, 1] - first) * per_spacing
    while u < part[2]:
        away, following = np.inf, 0
        for n in range(len(borders.room)):
            meets = borders.room[n] + borders.tilt[n] * (v - cy)
            if meets < away:
                away, following = meets, n
        step_x, step_y = borders.around[following, 0], borders.around[following, 1]
        end = min(int(np.ceil(cx + away)), part[2])
        u = max(u, min(end, part[0]))
        if end > u:
            run = _find_run(picture, source.size, v, u, end, cx, cy, slope)
            if run.low > u or run.high < end:
                for n in range(len(lenses)):
                    lenses[n, 0], lenses[n, 1] = run.x + lattice.beside[n, 0], run.y + lattice.beside[n, 1]
                for k in range(u, end):
                    if not run.low <= k < run.high:
                        x, at = first + k * picture.spacing, k - part[0]
                        valid[at] = _read_beside(source, gain, picture, x, y, lenses, row, at * source.channels)
            if run.high > run.low:
                _draw_run(source, gain, picture, run, end, row, line)
            u = end
        cx, cy = cx + step_x, cy + step_y


# Without fastmath: sums in any order would differ between a process that compiles this and one that loads it.
@kernel(error_model="numpy", share=lambda *given: len(given[5]))
def _draw_patches(begin, end, source, lattice, borders, gain, picture, out, valid):
    """Fill `out` (rows, columns C), which is the `part` of the picture; all bits are those of the whole picture."""
    for at in range(begin, end):
        _draw_row(source, lattice, gain, picture, borders, picture.part[1] + at, out[at], valid[at])


def _cell(lattice: Lattice) -> NDArray[np.float64]:
    """(6, 2) corners of the Voronoi cell of a lens, from its centre [px]; those of a square may coincide."""
    return cached(lattice, "cell", lambda: _corners(*lattice.basis))


def _corners(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    if a @ b < 0:
        b = -b
    # Each is as far from the centre as from two neighbours.
    around = [a, b, b - a, -a]
    corners = [np.linalg.solve(np.array(pair), np.square(pair).sum(1) / 2) for pair in itertools.pairwise(around)]
    return np.concatenate([corners, np.negative(corners)])


def covers_all_patches(lattice: Lattice, patch_size: float, radius: float) -> bool:
    """Whether microimages of this `radius` [px] hold whole patches, to the corners of the cells."""
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
    """Read each pixel of a picture of `|patch_size|` pixels per pitch from the nearest lens.

    Where that lens or some of its pixels are missing at the border of the flat, the next nearest replaces it.

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
        Up to here a lens may replace a missing one.
    gains : (k,) float32
        Gain over the squared distance from the centre, as `gain_table`.
    gain_step : float [px^2]
    part : (int, int, int, int)
        Columns and rows `left, top, right, bottom` of the picture.

    Returns
    -------
    image : (rows, columns, C) array of the type of `pixels`
    valid : (rows, columns) bool
        Pixels that some lens shows.
    """
    spacing = lattice.pitch / abs(patch_size)
    steps = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
    steps = np.concatenate([steps, -steps])
    beside = np.concatenate([steps @ lattice.basis, np.zeros((1, 2))])
    reach = int(np.ceil(np.abs(_cell(lattice)).max() / spacing)) + 2
    table = _tabulate_gain(gains, gain_step, reach, pixels.shape[2], pixels.dtype)
    whole = pixels.dtype.kind in "ui"
    half, top = (0.5, np.iinfo(pixels.dtype).max) if whole else (0.0, np.inf)
    rows, columns = part[3] - part[1], part[2] - part[0]
    image, valid = np.empty((rows, columns, pixels.shape[2]), pixels.dtype), np.empty((rows, columns), bool)
    size, borders = np.array(lattice.image_size), _find_borders(beside[:-1], spacing)
    _draw_patches(
        _Source(np.ascontiguousarray(pixels).reshape(-1), pixels.shape[1], pixels.shape[2], np.array(corner), size),
        _Lattice(lattice.origin, np.linalg.inv(lattice.basis), lattice.basis, steps, beside), borders,
        _Gain(gains, 1 / gain_step, table.reshape(-1), np.uint64(table.shape[2]), reach),
        _Picture(
            patch_size / lattice.pitch, first, spacing, radius * radius, np.float32(half), np.float32(top),
            np.array(part),
        ), image.reshape(rows, -1), valid,
    )  # fmt: skip
    return image, valid


def _find_borders(beside: NDArray[np.float64], spacing: float) -> _Borders:
    """The borders of a cell to its right, from the steps to the neighbours [px]."""
    steps = beside * (1 / spacing)
    right = steps[steps[:, 0] > 1e-9]
    x, y = right.T
    return _Borders(right, 0.5 * (x * x + y * y) / x, -y / x)


def _tabulate_gain(
    gains: NDArray[np.float32], gain_step: float, reach: int, channels: int, dtype: np.dtype
) -> NDArray[Any]:
    """Gains on a grid of `_PHASES` steps per pixel, each once for every channel; of size 0 if all are 1."""
    if (gains == gains[0]).all() and gains[0] == 1:
        return np.empty((0, 0, 0), np.uint16 if dtype == np.uint8 else np.float32)
    along = np.arange(-reach * _PHASES, (reach + 1) * _PHASES) / _PHASES
    squared = along[:, None] ** 2 + along**2
    table = gains[np.minimum((squared / gain_step).astype(int), len(gains) - 1)]
    # One row for each phase, so that gains of pixels that follow each other do so too.
    table = np.repeat(table.reshape(len(along), -1, _PHASES).transpose(0, 2, 1), channels, 2)
    table = np.pad(table, ((0, 0), (0, 0), (BUNCH, BUNCH)))
    if dtype == np.uint8:
        table = np.minimum(np.rint(table * (1 << GAIN_BITS)), np.iinfo(np.uint16).max).astype(np.uint16)
    return np.ascontiguousarray(table)
