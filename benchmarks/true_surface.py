"""A depth map whose surface is replaced by the truth, to draw pictures with the true depth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

import lfrender
from lfrender.data.surface import Surface

__all__ = ["with_true_surface"]


def with_true_surface(
    depth: lfrender.DepthMap, patch_size: NDArray[Any], affine: NDArray[np.float64]
) -> lfrender.DepthMap:
    """The depth map with the true patch size (h, w) [px]; NaN takes the nearest known value.

    `affine` (2, 3) maps pixels of `patch_size` to scene coordinates.
    """
    nearest = distance_transform_edt(
        ~np.isfinite(patch_size), return_distances=False, return_indices=True
    )
    filled = np.ascontiguousarray(patch_size[tuple(nearest)])
    first = float(affine[0, 2]), float(affine[1, 2])
    return replace(depth, surface=Surface(filled, first, float(affine[0, 0])))
