"""Depth in colours, from far to near on one perceptually even scale: pictures and maps of lenses."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Lattice
from lfcal.runtime.arrays import MOST, Array, Booleans

from ..data.dense_depth import dense_depth
from ..data.depth_map import MODE_COLOURS, DepthMap, default_scale
from ..data.depth_order import depth_limits, depth_order
from ..data.rendering import Rendering, scene_points
from ..flat.lens_graph import nearest_lens
from ..runtime.types import Size

__all__ = [
    "DEPTH_SCALE",
    "ERROR_SCALE",
    "add_legend",
    "colour_scale",
    "depth_picture",
    "lens_maps",
    "uncertainty_picture",
]

#: Colours of depth, dark for far and light for near, and of errors; both are perceptually even.
DEPTH_SCALE: Literal["viridis"] = "viridis"
ERROR_SCALE: Literal["cividis"] = "cividis"
# Ends of the scale of a depth map without errors [px].
_ERRORS_OF_NONE = (0.001, 1.0)
# Height of the letters of a legend over the width of the picture, and its bounds [px]; height of
# its bar of colours over that of the letters.
_LETTERS = 1 / 32
_SMALLEST_LETTERS = 10
_LARGEST_LETTERS = 40
_BAR = 1.2


def depth_picture(
    depth: DepthMap, scale: float | None = None, limits: tuple[float, float] | None = None
) -> Rendering:
    """The depth of every pixel of the picture of `render`, in colours: dark is far, light is near.

    The scale lies between these `limits` (as of `depth_limits`) if they are given; valid are pixels
    whose nearest lens has a depth, all others are grey.
    """
    if scale is None:
        scale = default_scale(depth)
    dense = dense_depth(depth, scale, fill=False)
    order = depth_order(dense.patch_size, depth.pitch)
    image = _colours(order, *(limits or depth_limits(depth)), DEPTH_SCALE)
    return Rendering(image, dense.affine, dense.resolved, scale)


def uncertainty_picture(
    depth: DepthMap, scale: float | None = None
) -> tuple[Rendering, tuple[float, float]]:
    """The standard error of the patch size of every pixel, in colours, and the ends of the scale.

    The scale is logarithmic [px] and holds 98 % of the pixels: dark is sure, light is unsure, and
    grey has no depth.
    """
    if scale is None:
        scale = default_scale(depth)
    dense = dense_depth(depth, scale, fill=False)
    known = dense.resolved & np.isfinite(dense.standard_error) & (dense.standard_error > 0)
    low, high = _ERRORS_OF_NONE
    if known.any():
        low, high = np.percentile(dense.standard_error[known], MOST, method="nearest").tolist()
    error = np.where(known, dense.standard_error, np.nan)
    image = _colours(np.log(error), np.log(low), np.log(max(high, 1.01 * low)), ERROR_SCALE)
    return Rendering(image, dense.affine, known, scale), (low, high)


def add_legend(
    picture: Rendering, ends: tuple[str, str], name: Literal["viridis", "cividis"] = DEPTH_SCALE
) -> Rendering:
    """A picture with its scale of colours below, and the words at its ends.

    Of narrow pictures, words before a colon alone.
    """
    from PIL import Image, ImageDraw, ImageFont

    width = picture.image.shape[1]
    letters = int(np.clip(width * _LETTERS, _SMALLEST_LETTERS, _LARGEST_LETTERS))
    font = ImageFont.load_default(letters)
    short = [words.partition(":")[0] for words in ends]
    # On narrow pictures, less is written.
    for middle, shown in (("grey: no depth", ends), ("", ends), ("", short)):
        lengths = [font.getlength(words) for words in (shown[0], middle, shown[1])]
        if sum(lengths) + 2 * letters <= width:
            break
    bar = int(_BAR * letters)
    height = bar + 2 * letters
    strip = Image.new("RGB", (width, height), "white")
    shades = np.linspace(0, 255, width).astype(np.uint8)
    scale = np.broadcast_to(colour_scale(name)[shades], (bar, width, 3))
    strip.paste(Image.fromarray(np.ascontiguousarray(scale)), (0, 0))
    pen = ImageDraw.Draw(strip)
    line = bar + letters // 3
    pen.text((letters // 3, line), shown[0], "black", font)
    pen.text(((width - lengths[1]) / 2, line), middle, MODE_COLOURS[0], font)
    pen.text((width - letters // 3 - lengths[2], line), shown[1], "black", font)
    image = np.concatenate([picture.image, np.asarray(strip)])
    below: Booleans = np.zeros((height, width), bool)
    return replace(picture, image=image, valid=np.concatenate([picture.valid, below]))


def colour_scale(name: Literal["viridis", "cividis"]) -> NDArray[np.uint8]:
    """(256, 3) colours from low to high."""
    import cv2

    code = {"viridis": cv2.COLORMAP_VIRIDIS, "cividis": cv2.COLORMAP_CIVIDIS}[name]
    return np.asarray(
        cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], code)[0, :, ::-1], np.uint8
    )


def lens_maps(
    depth: DepthMap, lattice: Lattice, affine: ArrayLike, shape: Size
) -> dict[str, NDArray[np.uint8]]:
    """Colours (h, w, 3) of the lens at each pixel: `"depth"`, `"modes"`, `"confidence"`.

    Depth is dark where far and light where near, between the ends `depth_limits`, and grey where
    unresolved; confidence is dark for 0 and light for 1. `affine` (2, 3) leads from pixel to scene
    coordinates.
    """
    points = scene_points(shape, np.asarray(affine, np.float64))
    lens = nearest_lens(lattice.centres(), points.reshape(-1, 2)).reshape(shape)
    order = np.where(depth.mode != 0, depth_order(depth.patch_size, depth.pitch), np.nan)
    confidence = np.clip(np.nan_to_num(depth.confidence), 0, 1)
    return {
        "depth": _colours(order, *depth_limits(depth), DEPTH_SCALE)[lens],
        "modes": np.array([MODE_COLOURS[code] for code in (0, 1, -1)], np.uint8)[depth.mode][lens],
        "confidence": _colours(confidence, 0.0, 1.0, ERROR_SCALE)[lens],
    }


def _colours(
    values: Array, low: float, high: float, name: Literal["viridis", "cividis"]
) -> NDArray[np.uint8]:
    """Colours of values between both ends, grey for NaN."""
    share = np.clip((values - low) / (high - low), 0, 1)
    colours = colour_scale(name)[np.rint(np.nan_to_num(share) * 255).astype(np.uint8)]
    colours[np.isnan(values)] = MODE_COLOURS[0]
    return colours
