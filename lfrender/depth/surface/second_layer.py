"""A second depth inside a microimage: pixels that the first depth does not explain are matched
again on their own.

A thin branch fills too little of a microimage to show in the correlation of the whole. But its
pixels are those that no neighbour confirms at the first depth, and they correlate with the
neighbours at another one.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import FAST, kernel, square

from ...flat.lens_graph import dilate_mask
from ...flat.microimages import VECTOR_LENGTH, Strips, bilinear_weights, copy_box, row_of_disc
from ...flat.neighbours import Neighbours
from ...flat.texture import Texture
from ..matching.matcher import Matcher, fit_parabola
from ..matching.sgm import aggregate_costs
from ..presets import Preset
from ..refinement.lens_plane import fit_lenses
from ..refinement.smoothing import smooth_fits
from ..same_surface import TOLERANCE, same_surface

__all__ = ["find_second_layer"]

# A second depth costs less than the first one by this much, for the pixels that the first one does
# not explain.
_LOWER = 0.1

# A microimage with what lies about it, `stride` rows and columns; work memory of (stride^2,)
# float32 for this and another one, their squared differences, the differences that are none, and
# how many views show and confirm each pixel.
_Box = namedtuple("_Box", "stride light other squares limits showing confirming")


class _Lenses(NamedTuple):
    """Microimages of a flat."""

    image: NDArray[np.float32]  # (H, W)
    centres: NDArray[np.float32]  # (n, 2) [px]
    rows: NDArray[np.int32]  # (n, d) neighbours, -1 where there is none
    radius: np.float32  # [px]
    pitch: np.float32  # [px]
    first: NDArray[np.float32]  # (n,) [px] patch size
    floors: NDArray[np.float32]  # (n,) squared difference that needs no explanation


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _sum_window(values, p, stride):
    """Sum over 3 x 3 pixels about place `p`."""
    one = np.uint64(1)
    down = np.uint64(stride)
    a = p - down
    b = p + down
    return (
        (values[a - one] + values[a] + values[a + one])
        + (values[p - one] + values[p] + values[p + one])
    ) + (values[b - one] + values[b] + values[b + one])


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _square_differences(own, there, stride, fx, fy, out):
    """Squared difference of a microimage, `stride` pixels a row, from the bilinear interpolation of
    another.
    """
    one = np.uint64(1)
    down = np.uint64(stride)
    below = np.uint64(stride + 1)
    w00, w01, w10, w11 = bilinear_weights(fx, fy)
    # The last row and column have no pixel beyond them to interpolate with.
    for k in range(np.uint64(len(own) - stride - 1)):
        e = own[k] - (
            w00 * there[k] + w01 * there[k + one] + w10 * there[k + down] + w11 * there[k + below]
        )
        out[k] = e * e


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _count_views(squares, limits, start, count, stride, showing, confirming):
    """Count a view of `count` windows from place `start` on, and those that differ by no more than
    their limit.
    """
    first = np.uint64(start)
    one = np.float32(1)
    none = np.float32(0)
    for k in range(np.uint64(count)):
        p = first + k
        showing[p] += one
        confirming[p] += one if _sum_window(squares, p, stride) <= limits[p] else none


@njit(error_model="numpy", fastmath=False, forceinline=True)
def _make_box(radius):
    """Work memory for lenses of this radius [px]."""
    stride = 2 * (int(np.ceil(radius)) + 1) + 2
    work = np.zeros((6, stride * stride), np.float32)
    return _Box(stride, work[0], work[1], work[2], work[3], work[4], work[5])


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _find_unexplained(lenses: _Lenses, box, lens, first_row, row_step, xs, ys):
    """Gather columns and rows of those pixels of a lens that fewer than half of the neighbours that
    show them confirm at its first patch size, by windows of 3 x 3 pixels that differ by less than
    their variance and a floor; their number. Every `row_step`-th row counts, among them
    `first_row`.
    """
    flat = lenses.image
    centres = lenses.centres
    rows = lenses.rows
    pitch = lenses.pitch
    # Windows reach a pixel beyond their middle.
    radius = lenses.radius - np.float32(1.0)
    s = lenses.first[lens]
    floor = lenses.floors[lens]
    pixels, (height, width) = flat.reshape(-1), flat.shape
    stride, light, other, squares, limits, showing, confirming = box
    ax = centres[lens, 0]
    ay = centres[lens, 1]
    size = stride * stride
    ninth = np.float32(1 / 9)
    half = (stride - 2) // 2
    left = int(ax) - half
    top = int(ay) - half
    copy_box(pixels, width, left, top, stride, stride, light)
    # Relative to one of them, squares of similar values keep their digits.
    middle = light[size // 2]
    for k in range(np.uint64(size)):
        other[k] = light[k] - middle
        squares[k] = other[k] * other[k]
    begin = 1 + (first_row - top - 1) % row_step
    for v in range(begin, stride - 1, row_step):
        at = v * stride + 1
        for p in range(np.uint64(at), np.uint64(at + stride - 2)):
            mean = _sum_window(other, p, stride)
            limits[p] = _sum_window(squares, p, stride) + 9 * floor - ninth * mean * mean
            showing[p] = confirming[p] = np.float32(0)
    for d in range(rows.shape[1]):
        if rows[lens, d] < 0:
            continue
        bx = centres[rows[lens, d], 0]
        by = centres[rows[lens, d], 1]
        tx = (bx - ax) * (1 + s / pitch)
        ty = (by - ay) * (1 + s / pitch)
        x0 = int(np.floor(tx))
        y0 = int(np.floor(ty))
        copy_box(pixels, width, left + x0, top + y0, stride, stride, other)
        _square_differences(light, other, stride, np.float32(tx - x0), np.float32(ty - y0), squares)
        low = max(1, 1 - x0, left + 1)
        high = min(width - 2, width - 3 - x0, left + stride - 3)
        for v in range(begin, stride - 2, row_step):
            y = top + v
            if y < max(1, 1 - y0) or y > min(height - 2, height - 3 - y0):
                continue
            first, count = row_of_disc(y - by + ty, bx - tx, radius, low, high)
            if count > 0:
                _count_views(
                    squares, limits, v * stride + first - left, count, stride, showing, confirming
                )
    found = 0
    for v in range(begin, stride - 2, row_step):
        y = top + v
        if y < 1 or y > height - 2:
            continue
        first, count = row_of_disc(y - ay, ax, radius, 1, width - 2)
        for x in range(first, first + count):
            at = v * stride + x - left
            if showing[at] >= 2 and 2 * confirming[at] < showing[at]:
                xs[found], ys[found] = x, y
                found += 1
    return found


@kernel(error_model="numpy", share=lambda lenses, *_: len(lenses.rows))
def _mark_unexplained(begin, end, lenses: _Lenses, wanted, strips: Strips, marked):
    """Set `marked` to 1 at the unexplained pixels of each `wanted` lens (n,) in the first part of
    its strip.
    """
    step = strips.step
    width = strips.width
    middle = strips.middle
    half = strips.half
    size = strips.rows * width
    most = square(2 * int(lenses.radius) + 3)
    box = _make_box(lenses.radius)
    xs = np.empty(most, np.int64)
    ys = np.empty(most, np.int64)
    for lens in range(begin, end):
        if not wanted[lens]:
            continue
        left = middle[lens, 0] - half
        top = middle[lens, 1] - half
        for k in range(_find_unexplained(lenses, box, lens, top, step, xs, ys)):
            place = (ys[k] - top) // step * width + xs[k] - left
            marked[lens * size + place] = np.float32(1)


@kernel(error_model="numpy", share=lambda lenses, *_: len(lenses.rows))
def _show_unexplained(begin, end, lenses: _Lenses, layer, second, hidden):
    """Clear `hidden` (H, W) at the pixels of lenses that show a `layer` (n,): the unexplained ones
    where it is their `second` depth (n,), else all.
    """
    radius = lenses.radius
    height, width = hidden.shape
    most = square(2 * int(radius) + 3)
    box = _make_box(radius)
    xs = np.empty(most, np.int64)
    ys = np.empty(most, np.int64)
    for lens in range(begin, end):
        if not layer[lens]:
            continue
        if second[lens]:
            for k in range(_find_unexplained(lenses, box, lens, 0, 1, xs, ys)):
                hidden[ys[k], xs[k]] = False
            continue
        x = lenses.centres[lens, 0]
        y = lenses.centres[lens, 1]
        for row in range(max(0, int(np.ceil(y - radius))), min(height, int(y + radius) + 1)):
            first, count = row_of_disc(row - y, x, radius, 0, width - 1)
            hidden[row, first : first + count] = False


def find_second_layer(
    texture: Texture,
    neighbours: Neighbours,
    first: NDArray[np.float32],
    correlation: NDArray[np.float32],
    preset: Preset,
    occurring: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """(n,) [px] patch size of the pixels of each lens that its first one does not explain; NaN if
    there are none.

    They are correlated over all shifts between the patch sizes `occurring` (m,) [px], if given, and
    semi-global matching smooths the result: a branch runs through one lens after the other. Then
    they are fitted as first depths are. `correlation` (n,) is that of each lens at its `first`
    patch size (n,) [px].
    """
    second = np.full(len(first), np.nan, np.float32)
    # A lens that correlates more is explained by its first depth.
    wanted = (texture.clear | texture.faint) & (correlation < 0.8)
    if not wanted.any():
        return second
    # A rod of a tenth of a pitch of 50 px is five pixels wide.
    matcher = Matcher(
        texture, neighbours, replace(preset, search_pitch=max(preset.search_pitch, 50.0))
    )
    shifts = matcher.shifts
    factor = matcher.factor
    if occurring is not None and len(occurring):
        margin = TOLERANCE * matcher.gray.pitch
        inside = (shifts >= occurring.min() / factor - margin) & (
            shifts <= occurring.max() / factor + margin
        )
        shifts = shifts[inside]
    if len(shifts) < 3:
        # A minimum has a shift on either side.
        return second
    gray = matcher.gray
    noise2 = np.float32(texture.noise / factor) ** 2
    cost = np.ones((len(first), len(shifts)), np.float32)
    # A pixel is unexplained if it differs by more than the variance of its window, four times that
    # of the noise and a fifth of that of its lens. A neighbour that shows 1.5 % of a microimage
    # counts half.
    floors = 4 * noise2 + np.float32(0.2) * matcher.statistics.contrast**2
    half = 0.015 * np.pi * gray.radius**2
    small = (first / factor).astype(np.float32)
    lens = np.arange(len(first))
    at_first = np.abs(shifts - small[:, None]).argmin(1)
    lenses = _Lenses(
        gray.image,
        gray.centres,
        neighbours.all,
        np.float32(gray.radius),
        np.float32(gray.pitch),
        small,
        floors,
    )
    # A branch runs through one lens after the other: the lenses beside those of a sample that show
    # one are matched too.
    sample = wanted & (neighbours.indices % 2 == 0).all(1)
    tried = sample
    strips = matcher.extract(sample)
    marked = np.zeros(len(first) * strips.rows * strips.width + VECTOR_LENGTH, np.float32)
    for _ in range(2):
        _mark_unexplained(lenses, tried, strips, marked)
        cost[tried] = matcher.marked_costs(tried, marked, shifts, half)
        matched = cost.min(1) < cost[lens, at_first] - _LOWER
        tried = wanted & ~sample & dilate_mask(sample & matched, neighbours.all)
    total = aggregate_costs(cost, neighbours, matcher.slope_price, 0.35)
    best = total.argmin(1)
    matched = cost[lens, best] < cost[lens, at_first] - _LOWER
    found = shifts[best] + fit_parabola(total, best) * np.float32(matcher.step)
    gap = TOLERANCE * gray.pitch
    new = matched & ~same_surface(found, small, gap)
    own = np.where(new, found, np.float32(np.nan))
    new &= _occurs_beside(found, own, neighbours, gap) | _occurs_beside(
        found, small, neighbours, gap
    )
    if not new.any():
        return second
    own[~new] = np.nan
    # Neighbours that show the layer as their first depth take part in its fit.
    among = new | _occurs_beside(small, own, neighbours, gap)
    hidden = np.ones(gray.image.shape, bool)
    _show_unexplained(lenses, among, new, hidden)
    fits = fit_lenses(
        gray,
        neighbours,
        np.where(new, own, np.where(among, small, np.float32(np.nan))),
        matcher.statistics.contrast,
        texture.noise / factor,
        preset,
        hidden,
    )
    fits = smooth_fits(gray, neighbours, fits, among)
    # A fit that cannot tell two surfaces apart is no depth; nor is one that no neighbour shares.
    certain = new & (fits.standard_error < gap)
    own = np.where(certain, fits.patch_size, np.float32(np.nan))
    shared = _occurs_beside(own, own, neighbours, gap) | _occurs_beside(own, small, neighbours, gap)
    second = np.where(shared, own, np.float32(np.nan))
    return np.asarray(second * factor, np.float32)


def _occurs_beside(
    sizes: NDArray[np.float32], others: NDArray[np.float32], neighbours: Neighbours, gap: float
) -> NDArray[np.bool_]:
    """(n,) bool: lenses with a neighbour whose patch size in `others` (n,) is theirs in `sizes`."""
    rows = neighbours.all
    return np.asarray((same_surface(others[rows], sizes[:, None], gap) & (rows >= 0)).any(1))
