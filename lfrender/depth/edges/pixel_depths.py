"""The patch size that every pixel of a microimage shows, among those that the surface has nearby.

Each pixel is compared with the pixels that other lenses would show it at (multi-view stereo with
the microimage as the reference view), and semi-global matching (Hirschmueller 2008) inside the
microimage regularises the choice. In the second round, those views that the first one finds
occluded are left out (view selection, Schoenberger et al. 2016).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import kernel

from ...flat.microimages import copy_box
from ..same_surface import depth_order
from ..surface.scene_grid import LensArray, PointGrid
from .candidates import list_candidates, list_depths
from .comparison import allow_mismatch, compare_depth
from .microimage import OWN, box_stride, make_microimage

__all__ = ["measure_pixel_depths"]

# Price of a depth edge between pixels of one brightness, in units of the mismatch, and the
# difference of brightness [white] that halves it; with 0.08, scenes lose 0.04 dB more.
_JUMP = np.float32(0.3)
_EDGE_CONTRAST = np.float32(0.045)
# Mean mismatch of the pixels of a lens from which on no depth matches. Where AntLeg lies on the
# microlenses it is 0.63 to 0.83 in the first round and 0.51 to 0.73 in the second; beside true
# edges nine of ten lenses have less than 0.4. The first round compares with occluded lenses too.
_FIRST_UNRELATED = 0.6
_UNRELATED = 0.5
# A pixel on an outline shows what is behind if it differs from there by less than this share of
# what it differs from before. With 0.7 ten scenes lose 0.03 dB more.
_BEHIND = 0.5


@njit(error_model="numpy")
def _is_blank(light, size, stride, pitch, noise2):
    """Whether no patch within 0.3 pitches of the middle of a microimage, which no other lens shows,
    has contrast.
    """
    half = size // 2
    reach = int(0.3 * pitch)
    fifth = np.float32(0.2)
    seen2 = np.float32(0.25) * noise2
    for row in range(half - reach, half + reach + 1):
        for p in range(row * stride + half - reach, row * stride + half + reach + 1):
            a = light[p - stride]
            b = light[p - 1]
            d = light[p]
            e = light[p + 1]
            f = light[p + stride]
            mean = fifth * (a + b + d + e + f)
            a = a - mean
            b = b - mean
            d = d - mean
            e = e - mean
            f = f - mean
            if fifth * (a * a + b * b + d * d + e * e + f * f) > seen2:
                return False
    return True


@njit(error_model="numpy", forceinline=True)
def _aggregate_line(number, gap, p, step, steps, work):
    """Add one path of semi-global matching to the total: `steps` pixels `step` apart, from p on."""
    previous = work.path[0]
    current = work.path[1]
    value = work.value
    cost = work.cost
    total = work.total
    among = work.among
    light = work.light
    lowest = np.float32(0.0)
    for n in range(steps):
        if among[p] == 1 or n == 0:
            # Settled, or the first: nothing reaches it.
            for k in range(number):
                current[k] = cost[k, p]
        else:
            edge = (light[p] - light[p - step]) / _EDGE_CONTRAST
            jump = _JUMP / (1 + edge * edge)
            for k in range(number):
                best = jump
                s = value[k, p]
                for q in range(max(0, k - 1), min(number, k + 2)):
                    # Depths ascend: others than those beside it are a jump away.
                    if abs(s - value[q, p - step]) < gap:
                        best = min(best, previous[q] - lowest)
                current[k] = cost[k, p] + best
        lowest = current[0]
        for k in range(number):
            total[k, p] += current[k]
            previous[k] = current[k]
            lowest = min(lowest, current[k])
        p += step


@njit(error_model="numpy")
def _aggregate(size, stride, number, gap, work):
    """Semi-global matching along four directions inside a microimage, about the pixels that are not
    settled.
    """
    among = work.among
    upper = work.upper
    lower = work.lower
    work.total[:number] = 0
    upper[:], lower[:] = size, 0
    for line in range(2 * size):
        begin = size
        end = 0
        first = 0
        step = 1
        if line < size:
            row = line
            first = line * stride
            for column in range(work.left[row], work.right[row]):
                if among[row * stride + column] != 1:
                    begin = min(begin, column)
                    end = column + 1
                    upper[column], lower[column] = min(upper[column], row), row + 1
            if end:
                # With the settled pixel at either end.
                begin = max(begin - 1, work.left[row])
                end = min(end + 1, work.right[row])
        else:
            column = line - size
            step = stride
            first = column
            begin = upper[column]
            end = lower[column]
            if end:
                if begin > 0 and work.left[begin - 1] <= column < work.right[begin - 1]:
                    begin -= 1
                if end < size and work.left[end] <= column < work.right[end]:
                    end += 1
        # There and back. One call: each is compiled anew.
        for turn in range(2 if end else 0):
            start = first + (begin if turn == 0 else end - 1) * step
            _aggregate_line(number, gap, start, step if turn == 0 else -step, end - begin, work)


@njit(error_model="numpy")
def _choose_depths(number, size, stride, work):
    """Fill `work.chosen` with the depth of least cost of each pixel; returns the mean mismatch of
    those that have a choice.
    """
    among = work.among
    present = work.present
    total = work.total
    chosen = work.chosen
    chosen[:] = -1
    contested = 0
    mismatch = 0.0
    for row in range(size):
        for p in range(row * stride + work.left[row], row * stride + work.right[row]):
            best = 0
            if among[p] > 1:
                for k in range(1, number):
                    best = k if total[k, p] < total[best, p] else best
                contested = contested + 1
                mismatch += work.cost[best, p]
            else:
                # Settled at the only depth that is possible.
                for k in range(1, number):
                    best = k if present[k, p] > 0 else best
            chosen[p] = best
    return mismatch / max(contested, 1)


@njit(error_model="numpy", forceinline=True)
def _shown_depth(p, stride, gap, pitch, work):
    """The depth that a pixel has chosen, or that of a pixel beside it behind an outline between
    them, if most of the light of the pixel is from there.

    A pixel on an outline mixes light of both sides. It matches at the nearer depth, with which
    outlines move, whatever its shares are.
    """
    chosen = work.chosen
    light = work.light
    value = work.value
    own = chosen[p]
    shown = own
    if work.among[p] < 2:
        return shown
    nearness = depth_order(value[own, p], pitch)
    for step in (-1, 1, -stride, stride):
        behind = chosen[p + step]
        before = chosen[p - step]
        if behind < 0 or before < 0 or work.present[behind, p] == 0:
            continue
        if nearness - depth_order(value[behind, p], pitch) < gap:
            continue
        if abs(value[before, p - step] - value[own, p]) > gap:
            continue
        to_behind = light[p + step] - light[p]
        to_before = light[p] - light[p - step]
        if to_behind * to_before >= 0 and abs(to_behind) < _BEHIND * abs(to_before):
            shown = behind
    return shown


@njit(error_model="numpy")
def _measure_lens(
    lens, pixels, shape, lenses, surface, grid, levels, before, noise2, apart, size, work, out
):
    """Fill `out` with the patch sizes of the pixels of one lens; returns the share of them that
    leave the surface.
    """
    x = lenses.centres[lens, 0]
    y = lenses.centres[lens, 1]
    half = size // 2
    stride = box_stride(size)
    left = int(x + 0.5) - half
    top = int(y + 0.5) - half
    copy_box(pixels, shape[1], left, top, size, stride, work.light)
    for column in range(stride):
        work.x[column] = left + column - x
    number = 0
    if not _is_blank(work.light, size, stride, lenses.pitch, noise2):
        number = list_depths(surface, grid, x, y, lenses, work)
    if number == 0:
        return 0.0
    choice = list_candidates(
        x,
        y,
        left,
        top,
        size,
        stride,
        number,
        surface,
        grid,
        levels,
        lenses,
        before,
        apart,
        shape,
        work,
    )
    if choice:
        allow_mismatch(work.light, stride, size * stride, noise2, lenses.pitch, work.allowed)
        known = before.reshape(-1)
        for k in range(number):
            compare_depth(pixels, shape, lens, k, left, top, size, stride, lenses, known, work)
        _aggregate(size, stride, number, lenses.gap, work)
    limit = _UNRELATED
    if before.size == 1:
        limit = _FIRST_UNRELATED
    related = _choose_depths(number, size, stride, work) <= limit
    value = work.value
    present = work.present
    every = 0
    moved = 0
    for row in range(size):
        for column in range(work.left[row], work.right[row]):
            # Without a depth that matches, pixels cannot tell where the surface has edges.
            s = np.float32(np.nan)
            if related:
                p = row * stride + column
                k = _shown_depth(p, stride, lenses.gap, lenses.pitch, work)
                s = value[k, p]
                every = every + 1
                moved = moved + (present[k, p] != OWN)
            out[top + row, left + column] = s
    return moved / max(every, 1)


@kernel(error_model="numpy", share=lambda image, lenses, *_: len(lenses.centres))
def measure_pixel_depths(
    begin,
    end,
    image,
    lenses: LensArray,
    surface,
    grid: PointGrid,
    levels,
    wanted,
    before,
    noise2,
    apart,
    out,
    moved,
):
    """Fill `out` (H, W) with the patch size [px] that each pixel of the microimages shows, and
    `moved` (n,) with the share of the pixels of each lens that leave the surface.

    Of lenses that are not `wanted` (n,), and where the middle of a microimage is blank, `out` is
    left alone; in lenses that match at no depth it is NaN. `before` (H, W) is the result of the
    first round, (1, 1) in that; `levels` are those of `mark_levels`; a squared difference of
    `noise2` is no mismatch. Edges between patch sizes that are not `apart` [px] are left alone.
    """
    size = 2 * (int(lenses.radius) + 2) + 1
    work = make_microimage(size)
    pixels = image.reshape(-1)
    for lens in range(begin, end):
        if wanted[lens]:
            moved[lens] = _measure_lens(
                lens,
                pixels,
                image.shape,
                lenses,
                surface,
                grid,
                levels,
                before,
                noise2,
                apart,
                size,
                work,
                out,
            )
