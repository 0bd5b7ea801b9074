"""Pictures of a depth map: the magnification in colours and the modes, lens by lens, each with its legend."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Lattice

from .metrics import nearest_lens

if TYPE_CHECKING:
    from PIL import ImageDraw

    from ..data.depth_map import DepthMap

__all__ = ["MODE_COLOURS", "depth_picture", "magnification_picture", "mode_picture"]

#: Colours of the modes 1 (telescopic), -1 (binocular) and 0 (unresolved); apart for colour-blind eyes too.
MODE_COLOURS = {1: (230, 126, 34), -1: (41, 112, 201), 0: (150, 150, 150)}
_MODE_NAMES = {1: "telescopic", -1: "binocular", 0: "unresolved"}
_STRIP = 56
# Five numbers of the legend beside each other [px].
_LEAST_WIDTH = 240
_MARGIN = 14


def depth_picture(depth: DepthMap, lattice: Lattice) -> NDArray[np.uint8]:
    """The magnification in colours on the grid of the picture that `render` draws, at least wide enough for a legend.

    Returns
    -------
    (h + 56, w, 3) uint8
    """
    from ..rendering.dense import dense_depth
    from ..rendering.render import default_scale

    scale = max(default_scale(depth), _LEAST_WIDTH * depth.pitch / depth.image_size[0])
    grid = dense_depth(depth, min(scale, 4 * depth.pitch))
    return magnification_picture(depth.patch_size, depth.mode, lattice, grid.affine, grid.patch_size.shape)


def magnification_picture(
    patch_size: ArrayLike,
    mode: ArrayLike,
    lattice: Lattice,
    affine: ArrayLike,
    shape: tuple[int, int],
    limits: tuple[float, float] | None = None,
) -> NDArray[np.uint8]:
    """Magnification `M = D / |s|` of the lens at each pixel, from blue (low) to red (high) on a logarithmic scale.

    Parameters
    ----------
    patch_size : (n,) [px]
        Signed `s` per lens in the order of `lattice.centres()`.
    mode : (n,)
        1, -1, or 0 for lenses to be drawn grey.
    lattice : Lattice
    affine : (2, 3) array_like
        From pixel to scene coordinates.
    shape : (int, int)
        Height and width of the map; a legend of 56 px is added below.
    limits : (float, float), optional
        Lowest and highest magnification of the scale; by default the range of 98 % of the lenses.

    Returns
    -------
    (h + 56, w, 3) uint8
    """
    import cv2

    known = np.asarray(mode) != 0
    with np.errstate(divide="ignore", invalid="ignore"):
        m = np.where(known, lattice.pitch / np.abs(np.asarray(patch_size, dtype=float)), np.nan)
    seen = m[np.isfinite(m)]
    if limits is None:
        low, high = np.percentile(seen, [1, 99]) if seen.size else (1.0, 10.0)
    else:
        low, high = limits
    high = max(high, low * 1.2)
    with np.errstate(invalid="ignore"):
        share = np.clip(np.log(m / low) / np.log(high / low), 0, 1)
    ramp = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[None], cv2.COLORMAP_TURBO)[0, :, ::-1]
    colours = ramp[np.nan_to_num(share * 255).astype(np.uint8)]
    colours[~np.isfinite(m)] = MODE_COLOURS[0]
    picture, draw = _with_strip(colours[_lens_of_pixels(lattice, affine, shape)])
    top, width = shape[0], shape[1]
    scale = ramp[np.linspace(0, 255, width - 2 * _MARGIN).astype(int)]
    image = np.array(picture)
    image[top + 10 : top + 24, _MARGIN : width - _MARGIN] = scale
    picture.paste(_pillow(image))
    for tick in np.geomspace(low, high, 5):
        x = _MARGIN + (width - 2 * _MARGIN - 1) * float(np.log(tick / low) / np.log(high / low))
        anchor = "lm" if tick == low else "rm" if np.isclose(tick, high) else "mm"
        draw.text((x, top + 38), f"M = {tick:.1f}" if anchor == "lm" else f"{tick:.1f}", (40, 40, 40), _font(), anchor)
    return np.array(picture)


def mode_picture(mode: ArrayLike, lattice: Lattice, affine: ArrayLike, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """The mode of the lens at each pixel, with the share of each in the legend.

    Parameters
    ----------
    mode : (n,)
        1 telescopic, -1 binocular, 0 unresolved, in the order of `lattice.centres()`.
    lattice, affine, shape
        As in `magnification_picture`.

    Returns
    -------
    (h + 56, w, 3) uint8
    """
    modes = np.asarray(mode)
    colours = np.array([MODE_COLOURS[int(np.sign(code))] for code in modes], np.uint8).reshape(-1, 3)
    picture, draw = _with_strip(colours[_lens_of_pixels(lattice, affine, shape)])
    top, step = shape[0], (shape[1] - 2 * _MARGIN) / len(_MODE_NAMES)
    for n, (code, name) in enumerate(_MODE_NAMES.items()):
        x = _MARGIN + n * step
        draw.rounded_rectangle((x, top + 20, x + 16, top + 36), 4, fill=MODE_COLOURS[code])
        share = float(np.mean(modes == code)) if modes.size else 0.0
        draw.text((x + 24, top + 28), f"{name} {share:.0%}", (40, 40, 40), _font(), "lm")
    return np.array(picture)


def _lens_of_pixels(lattice: Lattice, affine: ArrayLike, shape: tuple[int, int]) -> NDArray[np.int64]:
    v, u = np.mgrid[: shape[0], : shape[1]]
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ np.asarray(affine, dtype=float).T
    return nearest_lens(lattice, points).reshape(shape)


def _with_strip(image: NDArray[np.uint8]) -> tuple[Any, ImageDraw.ImageDraw]:
    """The picture with a white strip below it, and something to draw on it with."""
    from PIL import ImageDraw

    strip = np.full((_STRIP, image.shape[1], 3), 255, np.uint8)
    picture = _pillow(np.vstack([image, strip]))
    return picture, ImageDraw.Draw(picture)


def _pillow(image: NDArray[np.uint8]) -> Any:
    from PIL import Image

    return Image.fromarray(np.ascontiguousarray(image))


def _font() -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(14)
