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
from ..same_surface import TOLERANCE
from .agreement import measure_agreement
from .fusion import fuse_pixel_depths
from .geometry import LensArray, PointGrid, lens_array, mark_levels
from .microimage import PixelCosts
from .pixel_depths import measure_pixel_depths
from .rims import keep_proven, spread
from .settings import DEFAULT, EdgeSettings

__all__ = ["locate_edges", "places_of_lenses", "refine_grid"]

# [pitch] a scene point is no farther from the lenses around the one at whose place it is.
_AROUND = 1.6
# [pitch] nor are the lenses farther that have most say about it.
_FARTHEST = 1.3


def locate_edges(
    gray: GrayFlat,
    lattice: Lattice,
    depth: DepthMap,
    where: NDArray[np.bool_] | None = None,
    settings: EdgeSettings = DEFAULT,
) -> DepthMap:
    """The depth map with the edges of its surface where the pixels have them, on a finer grid; as it is if it has none.

    Parameters
    ----------
    gray : GrayFlat
    lattice : Lattice
    depth : DepthMap
        Of this flat.
    where : (n,) bool, optional
        Lenses about whose places edges are located; all by default.
    settings : EdgeSettings
    """
    surface = depth.surface
    values, spacing = surface.patch_size, surface.spacing
    gap, reach = TOLERANCE * lattice.pitch, int(settings.reach * lattice.pitch / spacing)
    several = spread(values, reach) > settings.least_jump * lattice.pitch
    # Depths that hardly another lens shows cannot be proven wrong.
    cell, shown = abs(np.linalg.det(lattice.basis)), np.pi * (lattice.radius * lattice.pitch) ** 2
    several &= settings.shown * cell * values * values < shown
    if where is not None:
        several &= places_of_lenses(where, lattice, surface)
    if not several.any():
        return depth
    agreement = measure_agreement(gray, lattice, depth, gap, settings)
    lenses, grid = (
        lens_array(lattice, gap, float(lattice.radius) - 1.0),
        PointGrid(float(surface.first[0]), float(spacing)),
    )
    wanted = _lenses_about(several, lenses, grid)
    costs = PixelCosts(
        noise2=np.float32(agreement.fixed**2), noise_share2=np.float32(agreement.share**2),
        seen2=np.float32(settings.seen**2), contrast=np.float32(settings.contrast_share),
        visible_share=settings.visible_share, unseen=np.float32(settings.unseen), leave=np.float32(settings.leave),
        least_jump=settings.least_jump * lattice.pitch,
        jump=np.float32(settings.jump), edge2=np.float32(settings.edge_contrast**2),
        reach=settings.reach * lattice.pitch, views=settings.views,
    )  # fmt: skip
    finer = settings.finer
    before = refine_grid(values, finer, gap)
    pixels, size = _locate(gray.image, lenses, values, grid, several, wanted, costs, settings, before.copy())
    corner = surface.first[0] - 0.5 * (1 - 1 / finer) * spacing
    found = Surface(size, (corner, corner), spacing / finer)
    proven = keep_proven(found, before, gray, lattice, agreement, gap, settings)
    sure = np.minimum(depth.confidence, _share_of_pixels(pixels, lenses, depth.filled_patch_size))
    return replace(depth, surface=replace(found, patch_size=proven), confidence=sure)


def _share_of_pixels(shown: NDArray[np.float32], lenses: LensArray, sizes: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) float32: share of the pixels of each lens that show the patch size that it has, `sizes` (n,) [px]; 1 where
    none is known.

    `shown` (H, W) is the patch size of each pixel, NaN where it is not known; some pixels of each lens are looked at.
    """
    along = np.linspace(-0.6, 0.6, 9) * lenses.radius
    x, y = (np.rint(lenses.centres[:, k, None] + along).astype(int) for k in (0, 1))
    x, y = np.clip(x, 0, shown.shape[1] - 1), np.clip(y, 0, shown.shape[0] - 1)
    some = shown[y[:, :, None], x[:, None]].reshape(len(sizes), -1)
    known = np.isfinite(some).sum(1)
    same = (np.abs(some - sizes[:, None]) < lenses.gap).sum(1)
    return np.where(known > 0, same / np.maximum(known, 1), 1).astype(np.float32)


def _locate(
    image: NDArray[np.float32], lenses: LensArray, values: NDArray[np.float32], grid: PointGrid,
    several: NDArray[np.bool_], wanted: NDArray[np.bool_], costs: PixelCosts, settings: EdgeSettings,
    fused: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:  # fmt: skip
    """Patch size that each pixel of the lenses `wanted` (n,) shows (H, W), NaN for others, and `fused`
    (rows * finer, columns * finer) [px] with them."""
    finer, reach = settings.finer, int(costs.reach / grid.spacing)
    levels = mark_levels(values, lenses.pitch, reach)
    first, moved = np.full(image.shape, np.nan, np.float32), np.zeros(len(wanted), np.float32)
    measure_pixel_depths(image, lenses, values, grid, levels, wanted, np.zeros((1, 1), np.float32), costs, first, moved)
    second, wanted = first.copy(), moved > settings.moved
    measure_pixel_depths(image, lenses, values, grid, levels, wanted, first, costs, second, moved)
    fuse_pixel_depths(second, lenses, values, grid, several, reach, settings.voters, fused)
    usual = cv2.medianBlur(fused, settings.speck)
    np.copyto(fused, usual, where=np.repeat(np.repeat(several, finer, 0), finer, 1))
    return second, fused


def refine_grid(values: NDArray[np.float32], finer: int, gap: float) -> NDArray[np.float32]:
    """A grid that is `finer` by a whole factor; between values that differ by more than a `gap` the nearest one."""
    fine = np.asarray(cv2.resize(values, None, None, finer, finer, cv2.INTER_LINEAR), np.float32)
    plain = spread(values, 1) > gap
    nearest = np.repeat(np.repeat(values, finer, 0), finer, 1)
    np.copyto(fine, nearest, where=np.repeat(np.repeat(plain, finer, 0), finer, 1))
    return fine


def places_of_lenses(lenses: NDArray[np.bool_], lattice: Lattice, surface: Surface) -> NDArray[np.bool_]:
    """(rows, columns) bool: grid values of a `surface` about some of the `lenses` (n,)."""
    rows, columns = surface.patch_size.shape
    out = np.zeros((rows, columns), np.uint8)
    u, v = np.rint((lattice.centres()[lenses] - surface.first) / surface.spacing).astype(int).T
    out[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)] = 1
    return _spread_out(out, int(_AROUND * lattice.pitch / surface.spacing))


def _spread_out(marks: NDArray[np.uint8], side: int) -> NDArray[np.bool_]:
    return np.asarray(cv2.dilate(marks, np.ones((2 * side + 1, 2 * side + 1), np.uint8)) > 0)


def _lenses_about(several: NDArray[np.bool_], lenses: LensArray, grid: PointGrid) -> NDArray[np.bool_]:
    """(n,) bool: lenses near enough to points with several depths to be among the nearest ones to these."""
    side = int(_FARTHEST * lenses.pitch / grid.spacing)
    near = _spread_out(several.astype(np.uint8), side)
    u, v = np.rint((lenses.centres - grid.first) / grid.spacing).astype(int).T
    rows, columns = several.shape
    return np.asarray(near[np.clip(v, 0, rows - 1), np.clip(u, 0, columns - 1)])
