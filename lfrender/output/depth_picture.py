"""Maps of a depth map, one colour per lens: magnification, mode and confidence."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Lattice
from lfcal.runtime.arrays import Array

from ..data.dense_depth import dense_depth
from ..data.depth_map import MODE_COLOURS, DepthMap, default_scale, finite, magnification_range
from ..data.rendering import Rendering, scene_points
from ..flat.lens_graph import nearest_lens
from ..runtime.types import Size

__all__ = ["colour_scale", "depth_picture", "lens_maps", "magnification_limits"]

# Ends of the scale of a depth map without depth.
_LIMITS_OF_NONE = (1.0, 10.0)


def depth_picture(
    depth: DepthMap, scale: float | None = None, limits: tuple[float, float] | None = None
) -> Rendering:
    """The magnification of every pixel of the picture of `render`, in colours.

    They lie between these `limits` if they are given; valid are pixels whose nearest lens has a
    depth.
    """
    if scale is None:
        scale = default_scale(depth)
    dense = dense_depth(depth, scale, fill=False)
    with np.errstate(divide="ignore"):
        ends = limits or magnification_limits(depth.magnification)
        image = _colours(depth.pitch / np.abs(dense.patch_size), *ends)
    return Rendering(image, dense.affine, dense.resolved, scale)


def magnification_limits(magnification: Array) -> tuple[float, float]:
    """Ends of a scale of M that holds 98 % of the lenses with a finite one."""
    known = finite(magnification)
    if not known.size:
        return _LIMITS_OF_NONE
    return magnification_range(known)


def colour_scale(name: Literal["turbo", "viridis"]) -> NDArray[np.uint8]:
    """(256, 3) colours from low to high."""
    import cv2

    code = {"turbo": cv2.COLORMAP_TURBO, "viridis": cv2.COLORMAP_VIRIDIS}[name]
    return np.asarray(
        cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], code)[0, :, ::-1], np.uint8
    )


def lens_maps(
    depth: DepthMap, lattice: Lattice, affine: ArrayLike, shape: Size
) -> dict[str, NDArray[np.uint8]]:
    """Colours (h, w, 3) of the lens at each pixel: `"magnification"`, `"modes"`, `"confidence"`.

    Magnification is blue to red on a logarithmic scale with the ends `magnification_limits`, grey
    where unresolved; confidence is dark for 0 and light for 1. `affine` (2, 3) leads from pixel to
    scene coordinates.
    """
    points = scene_points(shape, np.asarray(affine, np.float64))
    lens = nearest_lens(lattice.centres(), points.reshape(-1, 2)).reshape(shape)
    limits = magnification_limits(depth.magnification)
    confidence = np.rint(255 * np.clip(np.nan_to_num(depth.confidence), 0, 1)).astype(np.uint8)
    return {
        "magnification": _colours(depth.magnification, *limits)[lens],
        "modes": np.array([MODE_COLOURS[code] for code in (0, 1, -1)], np.uint8)[depth.mode][lens],
        "confidence": colour_scale("viridis")[confidence][lens],
    }


def _colours(magnification: NDArray[np.floating], low: float, high: float) -> NDArray[np.uint8]:
    share = np.clip(np.log(magnification / low) / np.log(high / low), 0, 1)
    colours = colour_scale("turbo")[np.nan_to_num(share * 255).astype(np.uint8)]
    colours[~np.isfinite(magnification)] = MODE_COLOURS[0]
    return colours
