"""Full-resolution rendering at one patch size: a patch of each microimage, laid side by side.

After Lumsdaine and Georgiev 2008, section 4. An output pixel is as large as a pixel of the flat, so
that neighbours from one lens lie a whole pixel apart: along a row they share their interpolation
weights, and one loop reads them all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.runtime.kernels import FAST, kernel

from ..data.rendering import Part
from ..data.surface import Surface
from ..flat.gray_flat import correction_tables, has_uneven_lenses

__all__ = ["render_patches", "shows_patches"]


class _Patches(NamedTuple):
    """A straight lattice, and where its patches lie in a picture."""

    origin: Any  # (2,) float64 [px]
    inverse: Any  # (2, 2) float64: of the basis
    basis: Any  # (2, 2) float64 [px]
    steps: Any  # (k, 2) int: lattice steps to the neighbours
    slope: Any  # s / D
    first: Any  # [px] scene coordinates of pixel (0, 0)
    spacing: Any  # [px]
    part: Any  # (left, top, right, bottom) that is drawn


@njit
def _nearest(x, y, patches):
    """Centre of the lens nearest to (x, y)."""
    origin = patches.origin
    inverse = patches.inverse
    basis = patches.basis
    steps = patches.steps
    i = np.rint((x - origin[0]) * inverse[0, 0] + (y - origin[1]) * inverse[1, 0])
    j = np.rint((x - origin[0]) * inverse[0, 1] + (y - origin[1]) * inverse[1, 1])
    best = np.inf
    best_x = x
    best_y = y
    for n in range(len(steps)):
        near_i = i + steps[n, 0]
        near_j = j + steps[n, 1]
        cx = origin[0] + near_i * basis[0, 0] + near_j * basis[1, 0]
        cy = origin[1] + near_i * basis[0, 1] + near_j * basis[1, 1]
        away = (x - cx) * (x - cx) + (y - cy) * (y - cy)
        if away < best:
            best = away
            best_x = cx
            best_y = cy
    return best_x, best_y


@njit(fastmath=FAST, error_model="numpy", forceinline=True)
def _read_run(flat, at, across, down, fx, fy, size, line):
    """Interpolate `size` consecutive values of `flat`, from place `at` on, into `line`."""
    w11 = fx * fy
    w01 = fx - w11
    w10 = fy - w11
    w00 = np.float32(1) - fx - w10
    for k in range(size):
        upper = w00 * np.float32(flat[at + k]) + w01 * np.float32(flat[at + across + k])
        line[k] = upper + (
            w10 * np.float32(flat[at + down + k]) + w11 * np.float32(flat[at + down + across + k])
        )


@njit(inline="always")
def _store(out, at, value):
    """Store a value, truncated if those of `out` are integers; by way of 32 bits, which there are
    vectors for.
    """
    if out.itemsize < 4:
        out[at] = np.int32(value)
    else:
        out[at] = value


@njit(error_model="numpy", forceinline=True)
def _write_run(line, size, channels, half, top, turned, out, into):
    """Round `size` pixels and write them, in reverse order if `turned`."""
    one = np.uint64(1)
    two = np.uint64(2)
    three = np.uint64(3)
    for k in range(size * channels):
        line[k] = min(line[k] + half, top)
    if not turned:
        for k in range(size * channels):
            _store(out, into + k, line[k])
    elif channels == three:
        # The compiler uses vector instructions for strides it knows.
        for k in range(size):
            at = into + three * (size - one - k)
            of = three * k
            _store(out, at, line[of])
            _store(out, at + one, line[of + one])
            _store(out, at + two, line[of + two])
    else:
        for k in range(size):
            for c in range(channels):
                _store(out, into + (size - one - k) * channels + c, line[k * channels + c])


@kernel(error_model="numpy", share=lambda *given: len(given[8]))
def _draw_patches(begin, end, flat, size, corner, patches, gains, per_step, half, top, out, valid):
    """Fill `out` (rows, columns, C) with the pixels that the nearest lens shows, and mark them as
    `valid`.
    """
    values = flat.reshape(-1)
    channels = flat.shape[2]
    slope = patches.slope
    first = patches.first
    spacing = patches.spacing
    left = patches.part[0]
    turn = 1 if slope > 0 else -1
    per_spacing = 1 / spacing
    across = np.uint64(channels)
    down = np.uint64(flat.shape[1] * channels)
    line = np.empty(out.shape[1] * channels, np.float32)
    around = patches.steps.astype(np.float64) @ patches.basis
    # The half-way lines x = room + tilt * y to the neighbours at the right, at which a lens is no
    # longer the nearest.
    room = np.empty(len(around))
    tilt = np.empty(len(around))
    right = 0
    for n in range(len(around)):
        ex = around[n, 0]
        ey = around[n, 1]
        if ex > 1e-9:
            room[right], tilt[right] = 0.5 * (ex * ex + ey * ey) / ex, -ey / ex
            right += 1
    for row in range(begin, end):
        y = first + (patches.part[1] + row) * spacing
        u = left
        pixels = out[row].reshape(-1)
        seen = valid[row]
        seen[:] = False
        while u < patches.part[2]:
            cx, cy = _nearest(first + u * spacing, y, patches)
            border = np.inf
            for n in range(right):
                border = min(border, room[n] + tilt[n] * (y - cy))
            stop = max(
                min(int(np.ceil((cx + border - first) * per_spacing)), patches.part[2]), u + 1
            )
            # Column u is read at x - turn * u.
            x = cx + (cx - first) * slope
            py = cy - (y - cy) * slope
            ix = int(np.floor(x))
            iy = int(np.floor(py))
            low, high = (ix - size[0] + 2, ix + 1) if turn > 0 else (-ix, size[0] - 1 - ix)
            low = max(low, u)
            high = min(high, stop)
            on_flat = (
                -0.5 <= cx < size[0] - 0.5 and -0.5 <= cy < size[1] - 0.5 and 0 <= iy < size[1] - 1
            )
            if on_flat and high > low:
                start = ix - turn * (high - 1 if turn > 0 else low)
                fx = np.float32(x - ix)
                fy = np.float32(py - iy)
                at = np.uint64(iy - corner[1]) * down + np.uint64(start - corner[0]) * across
                length = np.uint64(high - low)
                into = np.uint64(low - left) * across
                _read_run(values, at, across, down, fx, fy, length * across, line)
                if len(gains) > 0:
                    dx = np.float32(start + (x - ix) - cx)
                    dy = np.float32(py - cy)
                    for k in range(length):
                        away = dx + np.float32(k)
                        gain = gains[min(int((away * away + dy * dy) * per_step), len(gains) - 1)]
                        for c in range(across):
                            line[k * across + c] *= gain
                _write_run(line, length, across, half, top, turn > 0, pixels, into)
                for k in range(low - left, high - left):
                    seen[k] = True
            u = stop


def shows_patches(
    calibration: Calibration, surface: Surface, scale: float, aperture: float
) -> bool:
    """Whether a picture read from the nearest lenses consists of whole patches of the flat, pixel
    by pixel.
    """
    lattice = calibration.lattice
    size = surface.patch_size[0, 0]
    if (
        surface.patch_size.size > 1
        or lattice.distortion is not None
        or has_uneven_lenses(calibration, types=True)
    ):
        return False
    # A patch is no wider than the way to the farthest of the nearest neighbours.
    farthest = float(np.linalg.norm(lattice.steps @ lattice.basis, axis=1).max()) * 0.5**0.5
    inside = farthest * abs(size) / lattice.pitch <= aperture * lattice.radius
    return bool(np.float32(scale) == abs(size) and min(lattice.image_size) > 1 and inside)


def render_patches(
    pixels: NDArray[Any],
    corner: tuple[int, int],
    calibration: Calibration,
    patch_size: float,
    part: Part,
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Read each pixel of a `part` of a picture of `|patch_size|` pixels per pitch from the nearest
    lens, on a straight lattice.

    `pixels` (h, w, C) are a part of the flat, `corner` x, y of its first one. Returns the image,
    and the pixels that it shows; others, at the border of the flat, are not set.
    """
    lattice: Lattice = calibration.lattice
    spacing = lattice.pitch / abs(patch_size)
    gains, step = correction_tables(calibration)
    known = np.empty(0, np.float32) if (gains == 1).all() else gains[0]
    per_step = np.float32(1 / step)
    whole = pixels.dtype.kind in "ui"
    half, top = (0.5, np.iinfo(pixels.dtype).max) if whole else (0.0, np.inf)
    shape = part[3] - part[1], part[2] - part[0]
    image = np.empty((*shape, pixels.shape[2]), pixels.dtype)
    valid = np.empty(shape, bool)
    patches = _Patches(
        lattice.origin,
        np.linalg.inv(lattice.basis),
        lattice.basis,
        np.concatenate([np.zeros((1, 2), np.int64), lattice.steps]),
        patch_size / lattice.pitch,
        0.5 * spacing - 0.5,
        spacing,
        np.array(part),
    )
    _draw_patches(
        np.ascontiguousarray(pixels),
        np.array(lattice.image_size),
        np.array(corner),
        patches,
        known,
        per_step,
        np.float32(half),
        np.float32(top),
        image,
        valid,
    )
    return image, valid
