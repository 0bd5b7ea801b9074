"""Depth edges of a surface on the pixels of the flat, which `analyze` ends with if asked for `edges`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ...data.depth_map import DepthMap
from ...data.surface import Surface
from ...flat.gray_flat import white_level
from ..same_surface import TOLERANCE
from .fusion import fuse_pixel_depths
from .geometry import LensArray, PointGrid, lens_array, mark_levels
from .microimage import PixelCosts
from .pixel_depths import measure_pixel_depths
from .settings import DEFAULT, EdgeSettings

__all__ = ["locate_edges"]


def locate_edges(
    flat: NDArray[Any], calibration: Calibration, depth: DepthMap, settings: EdgeSettings = DEFAULT
) -> DepthMap:
    """The depth map with the edges of its surface where the pixels have them.

    Parameters
    ----------
    flat : (H, W, C) array
    calibration : Calibration
    depth : DepthMap
        Of this flat.
    settings : EdgeSettings
    """
    lattice, surface = calibration.lattice, depth.surface
    gap = TOLERANCE * lattice.pitch
    values = surface.patch_size
    if values.max() - values.min() < gap:
        return depth
    image = _colours(flat, calibration)
    lenses, grid = lens_array(lattice, gap), PointGrid(float(surface.first[0]), float(surface.spacing))
    first = _measure(image, lenses, values, grid, np.zeros((1, 1), np.float32), settings)
    values = _fuse(first, lenses, values, grid, settings, 1)
    second = _measure(image, lenses, values, grid, first, settings)
    finer = settings.finer
    values = _fuse(second, lenses, values, grid, settings, finer)
    cv2.medianBlur(values, settings.speck, values)
    corner = grid.first - 0.5 * (1 - 1 / finer) * grid.spacing
    return replace(depth, surface=Surface(values, (corner, corner), grid.spacing / finer))


def _measure(
    image: NDArray[np.float32], lenses: LensArray, surface: NDArray[np.float32], grid: PointGrid,
    before: NDArray[np.float32], settings: EdgeSettings,
) -> NDArray[np.float32]:  # fmt: skip
    """(H, W) [px] the patch size of each pixel, NaN between the microimages."""
    reach = settings.reach * lenses.pitch
    costs = PixelCosts(
        noise2=3 * settings.noise**2, contrast=settings.contrast_share, visible_share=settings.visible_share,
        jump=settings.jump, edge2=settings.edge_colour**2, reach=reach, unseen=settings.unseen_cost,
        around=settings.settled,
    )  # fmt: skip
    pixels = np.full(image.shape[:2], np.nan, np.float32)
    levels = mark_levels(surface, lenses.pitch, int(reach / grid.spacing))
    measure_pixel_depths(image, lenses, surface, grid, levels, before, costs, pixels)
    return pixels


def _fuse(
    pixels: NDArray[np.float32], lenses: LensArray, surface: NDArray[np.float32], grid: PointGrid,
    settings: EdgeSettings, finer: int,
) -> NDArray[np.float32]:  # fmt: skip
    """(rows * finer, columns * finer) [px] the surface that the pixels show."""
    reach = int(settings.reach * lenses.pitch / grid.spacing)
    around = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    several = cv2.dilate(surface, around) - cv2.erode(surface, around) > lenses.gap
    fused: NDArray[np.float32] = np.empty((finer * len(surface), finer * surface.shape[1]), np.float32)
    cv2.resize(surface, fused.shape[::-1], fused, interpolation=cv2.INTER_LINEAR)
    fuse_pixel_depths(pixels, lenses, surface, grid, several, reach, settings.voters, fused)
    return fused


def _colours(flat: NDArray[Any], calibration: Calibration) -> NDArray[np.float32]:
    """(H, W, 3) the flat in three colours, divided by its gain, white = 1."""
    image = calibration.flatten(flat)[..., :3]
    white = np.float32(white_level(flat, calibration))
    return np.ascontiguousarray(np.broadcast_to(image / white, (*image.shape[:2], 3)), np.float32)
