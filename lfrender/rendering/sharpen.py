"""Sharper pictures: which blur there is to take back, how much noise they hold, and where two surfaces meet."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..data.dense_depth import sample_surface
from ..data.surface import Surface
from ..flat.lens_blur import measure_lens_blur
from .deconvolution import estimate_noise, power_spectrum, wiener_deconvolve
from .render import render_plan

__all__ = ["sharpen_picture"]

# Measured blur is right to about a quarter, and taking back too much costs more than too little.
_SURE = 0.75
# Depths that differ by this share of the pitch within the blur: two surfaces mix there, and each has its own error.
_EDGE = 0.06
# A noise small enough that no two lenses are taken to disagree, over white.
_FAINT = 1e-3


def sharpen_picture(
    image: NDArray[np.float32],
    valid: NDArray[np.bool_],
    sharpen: float | Literal["auto"],
    pixels: NDArray,
    calibration: Calibration,
    surface: Surface,
    sizes: NDArray[np.float32],
    scale: float,
    full: float,
    blend: bool,
    averaged: float,
) -> NDArray[np.float32]:
    """A picture without the blur of the microlenses, as far as its noise allows, but for what surrounds depth edges.

    Parameters
    ----------
    image : (h, w, C) float32
        As `render_plan` has made it from `pixels`, `calibration`, `surface`, `scale` and `blend`.
    valid : (h, w) bool
    sharpen : float [output px] or "auto"
        Side of the square that is blurred over, or measure it.
    sizes : (n,) float32 [px]
        Patch sizes of the lenses.
    full : float
        Scale of full resolution.
    averaged : float
        Blur that the picture has been drawn for, over `|s|`; 0 where it is not coarser than the flat.
    """
    width = _width(pixels, calibration, sizes, scale, full, averaged) if sharpen == "auto" else float(sharpen)
    if width <= 0:
        return image
    rng = np.random.default_rng(0)
    # What becomes of the noise of the flat is seen on noise alone, drawn the same way.
    grain = rng.standard_normal((*pixels.shape[:2], 1), np.float32) * np.float32(_FAINT)
    drawn, _, _ = render_plan(grain, calibration, surface, scale, blend, averaged)
    noise = power_spectrum(drawn) * (estimate_noise(pixels, calibration) / _FAINT) ** 2
    sharp = wiener_deconvolve(image, width, noise, valid)
    if surface.patch_size.size == 1:
        return sharp
    return image + (sharp - image) * _off_edges(surface, calibration, image.shape[:2], scale, width)[..., None]


def _width(
    pixels: NDArray, calibration: Calibration, sizes: NDArray[np.float32], scale: float, full: float, averaged: float
) -> float:
    """Side [output px] of the square that the microlenses blur a picture over, beyond its pixels."""
    blur = _SURE * (averaged or measure_lens_blur(pixels, calibration, sizes))
    # In a picture coarser than the flat, the blur has counted as a part of the footprint of its pixels.
    excess = (blur * scale) ** 2 + (min((scale / full) ** 2 - 1, 0.0) if averaged else 0.0)
    return float(np.sqrt(max(excess, 0.0)))


def _off_edges(
    surface: Surface, calibration: Calibration, shape: tuple[int, int], scale: float, width: float
) -> NDArray[np.float32]:
    """(h, w) float32: 1 on one surface, falling to 0 toward depth edges."""
    import cv2

    pitch = calibration.lattice.pitch
    depth = sample_surface(surface, pitch, shape, pitch / scale)
    side = 2 * int(np.ceil(width)) + 1
    around = np.ones((side, side), np.uint8)
    level = cv2.dilate(depth, around) - cv2.erode(depth, around) <= _EDGE * pitch
    return np.asarray(cv2.blur(level.astype(np.float32), (side, side)), np.float32)
