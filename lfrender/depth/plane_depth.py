"""Depth map of a flat on which everything with texture lies on one plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ..data.depth_map import DepthMap
from ..data.surface import Surface
from ..flat.lens_graph import count_neighbours
from .estimate import LensEstimates, LensSet
from .planes.plane_fit import Plane, fit_plane, has_outlier_cluster
from .planes.settings import PLANE
from .presets import PRESETS
from .same_surface import TOLERANCE, same_surface
from .surface.scene_grid import grid_shape
from .validity.settings import CLASSIFY

__all__ = ["confirm_on_plane", "fit_regular_plane", "plane_depth_map"]


def plane_depth_map(
    plane: Plane, lattice: Lattice, preset: str, reason: NDArray, confidence: NDArray, saved: dict[str, float]
) -> DepthMap:
    """The depth of a scene that is one plane, for the lenses whose `reason` (n,) is 0."""
    centres = lattice.centres()
    sizes = plane.at(centres)
    shape, first, spacing = grid_shape(lattice, PRESETS[preset].surface_cells)
    return DepthMap(
        patch_size=np.where(reason == 0, sizes, np.nan),
        standard_error=np.where(reason == 0, plane.standard_error(centres), np.inf),
        confidence=confidence,
        filled_patch_size=sizes.astype(np.float32),
        surface=Surface(plane.over_grid(shape, first, spacing), first, spacing),
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=preset,
        reason=reason,
        saved=saved,
    )


def fit_regular_plane(
    centres: NDArray[np.float64],
    count: int,
    pitch: float,
    sizes: NDArray[np.float32],
    errors: NDArray[np.float32],
    reason: NDArray[np.int8],
    systematic: NDArray,
    neighbours: NDArray[np.int32],
) -> Plane | None:
    """The plane that all lenses with texture lie on within their noise; None if there is none.

    `sizes`, `errors` and `reason` (n,) are as in `DepthMap`, `systematic` (n,) [px] the part of the errors that pairs
    do not show. If few of the `count` lenses of the flat are resolved, the plane must face the camera: a slant would
    be extrapolated too far.
    """
    known = (reason == 0) & np.isfinite(errors)
    if known.sum() < PLANE.min_textured_share * (reason != 1).sum():
        return None
    own = sizes.astype(np.float64)
    # Lenses with a blank neighbour have few pairs.
    inner = known & (count_neighbours(reason != 1, neighbours) == (neighbours >= 0).sum(1))
    if inner.sum() < PLANE.fewest_lenses:
        return None
    plane = fit_plane(centres[inner], own[inner], pitch, facing=bool(known.sum() < PLANE.min_textured_share * count))
    if plane is None:
        return None
    residual = np.where(known, own - plane.at(centres), np.nan)
    if has_outlier_cluster(residual, errors.astype(float), neighbours):
        return None
    return replace(plane, systematic_error=float(np.median(systematic[known])))


def confirm_on_plane(plane: Plane, estimates: LensEstimates, lenses: LensSet) -> LensEstimates:
    """Resolve lenses at the border of the flat that match on the plane of all others, but with too few pairs."""
    own, reason = plane.at(lenses.centres), estimates.reason
    on_plane = same_surface(estimates.patch_size, own, TOLERANCE * lenses.pitch)
    on_plane &= np.abs(own) <= CLASSIFY.resolvable * lenses.pitch
    sure = on_plane & (estimates.match.confidence >= CLASSIFY.sure)
    return replace(estimates, reason=np.where((reason == 3) & sure, 0, reason).astype(np.int8))
