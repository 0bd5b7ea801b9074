"""Depth edges of a surface on the pixels of the flat, which `analyze` ends with if asked for `edges`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ...data.depth_map import DepthMap
from ...data.surface import Surface
from ...flat.gray_flat import white_level
from ..surface.settings import DensifySettings
from .fusion import fuse_pixel_depths
from .geometry import PointGrid, lens_array, mark_levels
from .pixel_depths import PixelCosts, measure_pixel_depths
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
    same = DensifySettings()
    gap = max(same.least_same_surface, same.same_surface * lattice.pitch)
    values = surface.patch_size
    if values.max() - values.min() < gap:
        return depth
    image = _colours(flat, calibration)
    lenses, grid = lens_array(lattice, gap), PointGrid(float(surface.first[0]), float(surface.spacing))
    reach = settings.reach * lattice.pitch / surface.spacing
    costs = PixelCosts(
        settings.foreign_cost, settings.absent_cost, 3 * settings.noise**2, settings.contrast_share,
        settings.same_colour**2, settings.open_share, settings.occluded_share, settings.jump, settings.edge_share,
        settings.edge_colour**2, settings.slant, settings.reach * lattice.pitch,
    )  # fmt: skip
    before: NDArray[np.float32] = np.zeros((1, 1), np.float32)
    for _ in range(2):
        pixels = np.full(image.shape[:2], np.nan, np.float32)
        measure_pixel_depths(image, lenses, values, grid, mark_levels(values, lattice.pitch, reach), before, costs,
                             pixels)  # fmt: skip
        fused = np.empty(values.shape, np.float32)
        width = settings.vote_width * lattice.pitch**2
        fuse_pixel_depths(pixels, lenses, values, grid, int(reach), width, settings.vote_share, fused)
        values, before = fused, pixels
        costs = costs._replace(open_share=settings.visible_share)
    return replace(depth, surface=Surface(values, surface.first, surface.spacing))


def _colours(flat: NDArray[Any], calibration: Calibration) -> NDArray[np.float32]:
    """(H, W, 3) the flat, divided by its gain, white = 1."""
    image = calibration.flatten(flat).astype(np.float32) / np.float32(white_level(flat, calibration))
    return np.ascontiguousarray(np.broadcast_to(image[..., :3] if image.shape[2] > 2 else image[..., :1],
                                                (*image.shape[:2], 3)))  # fmt: skip
