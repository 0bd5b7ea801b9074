"""Share of the depth edges of a scene that a depth map places correctly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import lfrender

__all__ = ["RESOLVABLE", "edge_share"]

#: Patch sizes beyond this share of the pitch cannot be told (docs/geometry.md).
RESOLVABLE = 0.75
# Depths that differ by this share of the pitch lie on two sides of an edge.
_EDGE = 0.05


def edge_share(
    depth: lfrender.DepthMap, wanted: NDArray[np.floating], affine: NDArray[np.float64]
) -> float:
    """Share of the places on both sides of depth edges whose depth occurs within one pitch.

    One pitch is one pixel of the traditional picture. The share is 1 if there is no edge.

    `wanted` (h, w) [px] are true patch sizes, `affine` (2, 3) maps their pixels to scene
    coordinates.
    """
    wanted = wanted.astype(np.float64)
    limit = _EDGE * depth.pitch
    edge = np.zeros(wanted.shape, bool)
    for axis in (0, 1):
        jump = np.abs(np.diff(wanted, axis=axis)) > limit
        edge |= np.insert(jump, 0, False, axis) | np.insert(jump, jump.shape[axis], False, axis)
    v, u = np.nonzero(edge & (np.abs(wanted) < RESOLVABLE * depth.pitch))
    here = np.column_stack([u, v, np.ones(len(u))]) @ affine.T
    size = np.array(depth.image_size)
    inside = np.all((here > depth.pitch) & (here < size - depth.pitch), axis=1)
    here = here[inside]
    s = wanted[v, u][inside]
    reach = np.arange(-10, 11) / 10
    around = np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2)
    found = np.zeros(len(s), bool)
    for offset in around[np.linalg.norm(around, axis=1) <= 1]:
        found |= np.abs(depth.surface.at(here + offset * depth.pitch) - s) < limit
    return float(found.mean()) if len(found) else 1.0
