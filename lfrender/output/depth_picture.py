"""Depth in colours, from far to near on one perceptually even scale: pictures and maps of lenses."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Lattice
from lfcal.runtime.arrays import MOST, Array

from ..data.dense_depth import dense_depth
from ..data.depth_map import MODE_COLOURS, DepthMap, default_scale
from ..data.depth_order import DepthLimits, depth_limits, depth_order
from ..data.rendering import Rendering, scene_points
from ..flat.lens_graph import nearest_lens
from ..runtime.types import Place, Size

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
ColourScale = Literal["viridis", "cividis"]
DEPTH_SCALE: ColourScale = "viridis"
ERROR_SCALE: ColourScale = "cividis"
# Ends of the scale of a depth map without errors [px].
_ERRORS_OF_NONE = (0.001, 1.0)
# Height of the letters of a legend over the width of the picture, and its bounds [px]; height of
# its bar of colours over that of the letters.
_LETTERS = 1 / 32
_SMALLEST_LETTERS = 10
_LARGEST_LETTERS = 40
_BAR = 1.2


def depth_picture(
    depth: DepthMap, scale: float | None = None, limits: DepthLimits | None = None
) -> Rendering:
    """The depth of every pixel of the picture of `render`, in colours: dark is far, light is near.

    The scale lies between these `limits` (as of `depth_limits`) if they are given; valid are pixels
    whose nearest lens has a depth, all others are grey.
    """
    scale = scale or default_scale(depth)
    dense = dense_depth(depth, scale, fill=False)
    order = depth_order(dense.patch_size, depth.pitch)
    image = _colours(order, limits or depth_limits(depth), DEPTH_SCALE)
    return Rendering(image, dense.affine, dense.resolved, scale)


def uncertainty_picture(depth: DepthMap, scale: float | None = None) -> tuple[Rendering, Place]:
    """The standard error of the patch size of every pixel, in colours, and the ends of the scale.

    The scale is logarithmic [px] and holds 98 % of the pixels: dark is sure, light is unsure, and
    grey has no depth.
    """
    scale = scale or default_scale(depth)
    dense = dense_depth(depth, scale, fill=False)
    error = np.where(dense.standard_error > 0, dense.standard_error, np.inf)
    known = dense.resolved & np.isfinite(error)
    ends = _ERRORS_OF_NONE
    if known.any():
        ends = tuple(np.percentile(error[known], MOST, method="nearest").tolist())
    low, high = ends
    shown = np.log(np.where(known, error, np.nan))
    image = _colours(shown, (np.log(low), np.log(max(high, 1.01 * low))), ERROR_SCALE)
    return Rendering(image, dense.affine, known, scale), (low, high)


def add_legend(
    picture: Rendering, ends: tuple[str, str], name: ColourScale = DEPTH_SCALE
) -> Rendering:
    """A picture with its scale of colours below, and the words at its ends.

    Of narrow pictures, words before a colon alone.
    """
    from PIL import Image, ImageDraw, ImageFont

    width = picture.image.shape[1]
    letters = int(np.clip(width * _LETTERS, _SMALLEST_LETTERS, _LARGEST_LETTERS))
    font = ImageFont.load_default(letters)
    far, near = ends
    short = [words.partition(":")[0] for words in ends]
    # On narrow pictures, less is written.
    for words in ((far, "grey: no depth", near), (far, "", near), (short[0], "", short[1])):
        if font.getlength("".join(words)) + 2 * letters <= width:
            break
    far, middle, near = words
    bar = int(_BAR * letters)
    shades = np.broadcast_to(np.linspace(0, 255, width).astype(np.uint8), (bar, width))
    strip = Image.new("RGB", (width, bar + 2 * letters), "white")
    strip.paste(Image.fromarray(colour_scale(name)[shades]))
    pen = ImageDraw.Draw(strip)
    margin = letters // 3
    line = bar + margin
    pen.text((margin, line), far, "black", font)
    pen.text((width / 2, line), middle, MODE_COLOURS[0], font, "ma")
    pen.text((width - margin, line), near, "black", font, "ra")
    below = np.asarray(strip)
    valid = np.vstack([picture.valid, np.zeros(below.shape[:2], bool)])
    return replace(picture, image=np.concatenate([picture.image, below]), valid=valid)


def colour_scale(name: ColourScale) -> NDArray[np.uint8]:
    """(256, 3) colours from low to high."""
    import cv2

    code = {"viridis": cv2.COLORMAP_VIRIDIS, "cividis": cv2.COLORMAP_CIVIDIS}[name]
    shades = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], code)
    return np.asarray(shades[0, :, ::-1], np.uint8)


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
        "depth": _colours(order, depth_limits(depth), DEPTH_SCALE)[lens],
        "modes": np.array([MODE_COLOURS[code] for code in (0, 1, -1)], np.uint8)[depth.mode][lens],
        "confidence": _colours(confidence, (0.0, 1.0), ERROR_SCALE)[lens],
    }


def _colours(values: Array, ends: DepthLimits, name: ColourScale) -> NDArray[np.uint8]:
    """Colours of values between both ends, grey for NaN."""
    low, high = ends
    share = np.clip((values - low) / (high - low), 0, 1)
    colours = colour_scale(name)[np.rint(np.nan_to_num(share) * 255).astype(np.uint8)]
    colours[np.isnan(values)] = MODE_COLOURS[0]
    return colours
