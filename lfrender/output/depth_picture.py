"""Maps of a depth map, one colour per lens: magnification, mode and confidence, with legends for the first two."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Lattice

from ..flat.lens_graph import nearest_lens

if TYPE_CHECKING:
    from PIL import ImageDraw

    from ..data.depth_map import DepthMap

__all__ = [
    "MODES", "MODE_COLOURS", "colour_scale", "confidence_picture", "depth_picture", "magnification_limits",
    "magnification_picture", "mode_picture",
]  # fmt: skip

#: Names of the codes of modes.
MODES = {1: "telescopic", -1: "binocular", 0: "unresolved"}
#: Colours of the modes, which colour-blind eyes can tell apart too.
MODE_COLOURS = {1: (230, 126, 34), -1: (41, 112, 201), 0: (150, 150, 150)}
# Height of a legend and its margin at both sides [px].
_LEGEND = 56
_MARGIN = 14


def depth_picture(depth: DepthMap, lattice: Lattice, least_width: int = 240) -> NDArray[np.uint8]:
    """(h + 56, w, 3) magnification in colours, on the grid of `render` if that is wide enough for a legend."""
    from ..data.dense_depth import dense_depth
    from ..data.depth_map import default_scale

    scale = max(default_scale(depth), least_width * depth.pitch / depth.image_size[0])
    grid = dense_depth(depth, min(scale, 4 * depth.pitch))
    return magnification_picture(depth.patch_size, depth.mode, lattice, grid.affine, grid.patch_size.shape)


def magnification_limits(magnification: NDArray[Any]) -> tuple[float, float]:
    """Ends of a scale of M that holds 98 % of the lenses with a finite one."""
    known = magnification[np.isfinite(magnification)]
    low, high = np.percentile(known, [1, 99]) if known.size else (1.0, 10.0)
    return float(low), float(max(high, 1.2 * low))


def colour_scale(name: Literal["turbo", "viridis"]) -> NDArray[np.uint8]:
    """(256, 3) colours from low to high."""
    import cv2

    code = {"turbo": cv2.COLORMAP_TURBO, "viridis": cv2.COLORMAP_VIRIDIS}[name]
    return np.asarray(cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], code)[0, :, ::-1], np.uint8)


def magnification_picture(
    patch_size: ArrayLike,
    mode: ArrayLike,
    lattice: Lattice,
    affine: ArrayLike,
    shape: tuple[int, int],
    limits: tuple[float, float] | None = None,
) -> NDArray[np.uint8]:
    """(h + 56, w, 3) magnification `M = D / |s|` of the lens at each pixel, from blue to red on a logarithmic scale.

    Parameters
    ----------
    patch_size, mode : (n,)
        Signed `s` [px] and mode per lens in the order of `lattice.centres()`; lenses of mode 0 are grey.
    affine : (2, 3) array_like
        From pixel to scene coordinates.
    shape : (int, int)
        Height and width of the map; a legend of 56 px is added below.
    limits : (float, float), optional
        Lowest and highest magnification of the scale; by default the range of 98 % of the lenses.
    """
    resolved = np.asarray(mode) != 0
    with np.errstate(divide="ignore", invalid="ignore"):
        m = np.where(resolved, lattice.pitch / np.abs(np.asarray(patch_size, dtype=float)), np.nan)
    low, high = magnification_limits(m) if limits is None else (limits[0], max(limits[1], limits[0] * 1.2))
    with np.errstate(invalid="ignore"):
        share = np.clip(np.log(m / low) / np.log(high / low), 0, 1)
    scale = colour_scale("turbo")
    colours = scale[np.nan_to_num(share * 255).astype(np.uint8)]
    colours[~np.isfinite(m)] = MODE_COLOURS[0]
    top, width = shape[0], shape[1] - 2 * _MARGIN
    image = _add_legend(colours[_lens_of_pixels(lattice, affine, shape)])
    image[top + 10 : top + 24, _MARGIN : _MARGIN + width] = scale[np.linspace(0, 255, width).astype(int)]
    picture, draw, font = _canvas(image)
    for tick in np.geomspace(low, high, 5):
        x = _MARGIN + (width - 1) * float(np.log(tick / low) / np.log(high / low))
        anchor = "lm" if tick == low else "rm" if np.isclose(tick, high) else "mm"
        draw.text((x, top + 38), f"M = {tick:.1f}" if anchor == "lm" else f"{tick:.1f}", (40, 40, 40), font, anchor)
    return np.array(picture)


def mode_picture(mode: ArrayLike, lattice: Lattice, affine: ArrayLike, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """(h + 56, w, 3) mode of the lens at each pixel, with its shares in the legend; as `magnification_picture`."""
    modes = np.asarray(mode)
    colours = np.array([MODE_COLOURS[int(np.sign(code))] for code in modes], np.uint8).reshape(-1, 3)
    picture, draw, font = _canvas(_add_legend(colours[_lens_of_pixels(lattice, affine, shape)]))
    top, step = shape[0], (shape[1] - 2 * _MARGIN) / len(MODES)
    for n, (code, name) in enumerate(MODES.items()):
        x = _MARGIN + n * step
        draw.rounded_rectangle((x, top + 20, x + 16, top + 36), 4, fill=MODE_COLOURS[code])
        share = float(np.mean(modes == code)) if modes.size else 0.0
        draw.text((x + 24, top + 28), f"{name} {share:.0%}", (40, 40, 40), font, "lm")
    return np.array(picture)


def confidence_picture(
    confidence: NDArray[np.floating], lattice: Lattice, affine: ArrayLike, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """(h, w, 3) confidence of the lens at each pixel, dark for 0 and light for 1 (colours of viridis)."""
    share = np.clip(np.nan_to_num(confidence), 0, 1)[_lens_of_pixels(lattice, affine, shape)]
    return colour_scale("viridis")[np.rint(255 * share).astype(np.uint8)]


def _lens_of_pixels(lattice: Lattice, affine: ArrayLike, shape: tuple[int, int]) -> NDArray[np.int64]:
    v, u = np.indices(shape)
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ np.asarray(affine, dtype=float).T
    return nearest_lens(lattice, points).reshape(shape)


def _add_legend(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The picture with a white strip below it."""
    return np.vstack([image, np.full((_LEGEND, image.shape[1], 3), 255, np.uint8)])


def _canvas(image: NDArray[np.uint8]) -> tuple[Any, ImageDraw.ImageDraw, Any]:
    """The picture as a Pillow image, what draws on it, and a font."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.fromarray(np.ascontiguousarray(image))
    return picture, ImageDraw.Draw(picture), ImageFont.load_default(14)
