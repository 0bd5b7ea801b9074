"""Depth edges of a surface on the pixels of the flat."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ...data.depth_map import DepthMap
from ...data.surface import Surface
from ...flat.gray_flat import GrayFlat
from ...flat.texture import sample_statistics
from ..same_surface import TOLERANCE
from ..surface.scene_grid import LensArray, PointGrid, lens_array
from .candidates import mark_levels
from .fusion import fuse_pixel_depths
from .pixel_depths import measure_pixel_depths

__all__ = ["FINER", "locate_edges", "places_of_lenses", "refine_grid"]

#: The grid of the surface becomes so many times as fine: outlines to half of 1/7 pitch.
FINER = 2
# A pixel may show a depth that the surface has within this distance of the place it would be at
# [pitches]; within the second one of a jump, places are contested. Nine scenes lose 0.22 dB more
# with one pitch for both; two pitches take 6 % more time for 0.02 dB.
_REACH = 1.5
_BESIDE = 1.3
# Compression and uneven light add to the noise of a pixel: so many times its variance are no
# mismatch of two lenses.
_NOISES = 8.0
# Regions of the surface up to this area are specks [square pitches]. With twice the area, thin rods
# of s5b_tspc are lost (0.3 dB).
_SPECK = 0.1
# Lenses of which this share of the pixels leaves the surface are measured again.
_MOVED = 0.05


def locate_edges(
    gray: GrayFlat, lattice: Lattice, depth: DepthMap, where: NDArray[np.bool_] | None = None
) -> DepthMap:
    """The depth map with the edges of its surface where the pixels have them, about the lenses
    `where` (n,), or all.
    """
    surface = depth.surface
    pitch = lattice.pitch
    values = surface.patch_size
    spacing = surface.spacing
    gap = TOLERANCE * pitch
    reach = int(_REACH * pitch / spacing)
    apart = 0.1 * pitch
    several = spread(values, int(_BESIDE * pitch / spacing)) > apart
    # Depths that hardly another lens shows cannot be proven wrong: two lenses must show a place in
    # the mean.
    cell = abs(np.linalg.det(lattice.basis))
    shown = np.pi * (lattice.radius * pitch) ** 2
    several &= 2 * cell * values * values < shown
    if where is not None:
        several &= places_of_lenses(where, lattice, surface)
    if not several.any():
        return depth
    noise2 = np.float32(_NOISES * sample_statistics(gray).noise ** 2)
    lenses = lens_array(lattice, gap, float(lattice.radius) - 1.0)
    grid = PointGrid(float(surface.first[0]), float(spacing))
    # The nine lenses nearest to a scene point lie within 1.3 pitches of it.
    wanted = _at_lenses(_spread_out(several, int(1.3 * pitch / spacing)), lenses.centres, surface)
    levels = mark_levels(values, pitch, reach)
    first = np.full(gray.image.shape, np.nan, np.float32)
    moved = np.zeros(len(wanted), np.float32)
    nothing = np.zeros((1, 1), np.float32)
    shared = lenses, values, grid, levels
    measure_pixel_depths(gray.image, *shared, wanted, nothing, noise2, apart, first, moved)
    pixels = first.copy()
    again = moved > _MOVED
    # Elsewhere the pixels show the surface as it is.
    several &= places_of_lenses(moved > 0, lattice, surface)
    measure_pixel_depths(gray.image, *shared, again, first, noise2, apart, pixels, moved)
    fused = refine_grid(values, FINER, gap)
    fuse_pixel_depths(pixels, lenses, values, grid, several, reach, fused)
    np.copyto(fused, cv2.medianBlur(fused, 5), where=_repeat(several, FINER))
    fused = _remove_specks(fused, _SPECK * (FINER * pitch / spacing) ** 2, 2 * gap)
    corner = surface.first[0] - 0.5 * (1 - 1 / FINER) * spacing
    sure = np.minimum(depth.confidence, _share_of_pixels(pixels, lenses, depth.filled_patch_size))
    return replace(
        depth, surface=Surface(fused, (corner, corner), spacing / FINER), confidence=sure
    )


def _remove_specks(values: NDArray[np.float32], area: float, apart: float) -> NDArray[np.float32]:
    """The grid without regions of up to this area [grid values] that differ by more than `apart`
    [px] from all around.

    Regions take the largest patch size beside them.
    """
    none = np.iinfo(np.int16).min
    # Steps of an eighth of the difference: patch sizes of many pitches fit into 16 bits.
    levels = np.rint(values * (8 / apart)).astype(np.int16)
    cv2.filterSpeckles(levels, none, int(area), 8)
    specks = levels == none
    if specks.all():
        return values
    lowest = np.finfo(np.float32).min
    filled = np.where(specks, lowest, values)
    around = np.ones((3, 3), np.uint8)
    while specks.any():
        # The values about a region grow into it.
        grown = cv2.dilate(filled, around)
        np.copyto(filled, grown, where=specks)
        specks &= grown == lowest
    return filled


def _share_of_pixels(
    shown: NDArray[np.float32], lenses: LensArray, sizes: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(n,) share of the pixels of each lens, of patch sizes `shown` (H, W), that show the one it
    has; 1 where none is known.
    """
    along = np.linspace(-0.6, 0.6, 9) * lenses.radius
    x, y = (np.rint(lenses.centres[:, k, None] + along).astype(int) for k in (0, 1))
    x = np.clip(x, 0, shown.shape[1] - 1)
    y = np.clip(y, 0, shown.shape[0] - 1)
    some = shown[y[:, :, None], x[:, None]].reshape(len(sizes), -1)
    known = np.isfinite(some).sum(1)
    same = (np.abs(some - sizes[:, None]) < lenses.gap).sum(1)
    return np.where(known > 0, same / np.maximum(known, 1), 1).astype(np.float32)


def spread(values: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Difference between the largest and the least value within `reach` grid values each way."""
    around = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return np.asarray(cv2.dilate(values, around) - cv2.erode(values, around))


def _repeat(values: NDArray, times: int) -> NDArray:
    return np.repeat(np.repeat(values, times, 0), times, 1)


def refine_grid(values: NDArray[np.float32], finer: int, gap: float) -> NDArray[np.float32]:
    """A grid that is `finer` by a whole factor; between values that differ by more than a `gap` the
    nearest one.
    """
    fine = np.asarray(cv2.resize(values, None, None, finer, finer, cv2.INTER_LINEAR), np.float32)
    np.copyto(fine, _repeat(values, finer), where=_repeat(spread(values, 1) > gap, finer))
    return fine


def places_of_lenses(
    lenses: NDArray[np.bool_], lattice: Lattice, surface: Surface
) -> NDArray[np.bool_]:
    """(rows, columns) bool: grid values of a `surface` within 1.6 pitches, each way, of some of the
    `lenses` (n,).
    """
    rows, columns = surface.patch_size.shape
    marks = np.zeros((rows, columns), bool)
    u, v = np.rint((lattice.centres()[lenses] - surface.first) / surface.spacing).astype(int).T
    marks[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)] = True
    return _spread_out(marks, int(1.6 * lattice.pitch / surface.spacing))


def _spread_out(marks: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    return np.asarray(
        cv2.dilate(marks.view(np.uint8), np.ones((2 * side + 1, 2 * side + 1), np.uint8)) > 0
    )


def _at_lenses(
    marks: NDArray[np.bool_], centres: NDArray[np.float64], surface: Surface
) -> NDArray[np.bool_]:
    """(n,) bool: the grid values nearest to lens `centres` (n, 2)."""
    u, v = np.rint((centres - surface.first) / surface.spacing).astype(int).T
    return marks[np.clip(v, 0, len(marks) - 1), np.clip(u, 0, marks.shape[1] - 1)]
