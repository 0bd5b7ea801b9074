"""One order of all depths, from far to near, for scales of colours and sliders."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lfcal.runtime.arrays import MOST, Array

from ..runtime.types import Place

if TYPE_CHECKING:
    from .depth_map import DepthMap

__all__ = [
    "DepthLimits",
    "depth_limits",
    "depth_order",
    "describe_scale",
    "magnification_at",
    "name_depth",
    "name_ends",
    "slider_limits",
]

#: Ends of a scale of depths in the order of `depth_order`: far and near.
DepthLimits = Place
# Ends of the scale of a depth map without depth.
_LIMITS_OF_NONE = (0.1, 1.9)
# Least difference of both ends: on a scale of one plane, errors would look like depth.
_NARROWEST = 0.05
# Smallest patch that a slider of depths reaches [pitches].
_LEAST_PATCH = 0.04
# Room beyond the depths of the lenses at both ends of a slider, and the least range of depths that
# it is a share of.
_ROOM = 0.15
_LEAST_RANGE = 0.2


def depth_order(patch_size: Array, pitch: float) -> Array:
    """Place of depths between far (0) and near (2): `s / D`, of binocular places `s / D + 2`.

    It grows toward the camera, and evenly with disparity. NaN stays NaN.
    """
    ratio = np.asarray(patch_size) / pitch
    return np.where(ratio < 0, ratio + 2, ratio)


def depth_limits(depth: DepthMap) -> DepthLimits:
    """Far and near end of a scale that holds 98 % of the lenses with a depth."""
    known = depth_order(depth.patch_size[depth.mode != 0].astype(np.float64), depth.pitch)
    if not known.size:
        return _LIMITS_OF_NONE
    far, near = np.percentile(known, MOST, method="nearest").tolist()
    missing = max(_NARROWEST - (near - far), 0.0)
    return far - missing / 2, near + missing / 2


def slider_limits(depth: DepthMap) -> DepthLimits:
    """Far and near end of a slider of depths, with some room beyond those of 98 % of the lenses.

    Depths that were filled in count if there are no others.
    """
    resolved = np.isfinite(depth.patch_size)
    resolved |= not resolved.any()
    known = depth_order(depth.filled_patch_size[resolved].astype(np.float64), depth.pitch)
    far, near = np.percentile(known, MOST, method="nearest").tolist()
    more = _ROOM * max(near - far, _LEAST_RANGE)
    return max(far - more, _LEAST_PATCH), min(near + more, 2 - _LEAST_PATCH)


def describe_scale(limits: DepthLimits | None) -> str:
    """What the colours of a depth picture mean."""
    told = "depth from far (dark) to near (light)"
    if limits is None:
        return told
    far, near = name_ends(limits)
    return f"{told}; {far}; {near}; grey: no depth"


def name_ends(limits: DepthLimits) -> tuple[str, str]:
    """Both ends of a scale in words."""
    far, near = map(name_depth, limits)
    return f"far: {far}", f"near: {near}"


def name_depth(order: float) -> str:
    """A depth in words: its magnification `M` and its mode."""
    mode = "binocular" if order > 1 else "telescopic"
    return f"M {magnification_at(order):.1f}, {mode}"


def magnification_at(order: float) -> float:
    """The magnification `M` of a depth, at most a thousand."""
    return 1 / max(min(order, 2 - order), 1e-3)
