"""Light across the edge of an aperture, blurred by a lens out of focus and by pixels.

The share of a blurring disc inside a straight edge has a closed form, and so has its mean over the
width of a pixel. To first order in the curvature of the edge, the part of a disc inside a chord of
half length `h` loses `curvature * h ** 3 / 3`: beside the overlap of two circles, this is right to
0.001 of the light where the blurring disc has a fifth of the radius of the aperture.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..runtime.arrays import Array

__all__ = ["EdgeLight", "blurred_edge", "gaussian_edge"]


class EdgeLight(NamedTuple):
    """Light (m,) of pixels near an edge, from 0 to 1, and its derivatives."""

    light: Array
    by_depth: Array  # [1/px]
    by_blur: Array  # [1/px]
    by_curvature: Array  # [px]


def blurred_edge(
    depth: Array, blur: Array | float, width: float, curvature: Array | float = 0.0
) -> EdgeLight:
    """Light of pixels (m,) at a `depth` [px] inside the edge of an aperture.

    Parameters
    ----------
    depth : (m,) float64 [px]
        Distance of the middle of each pixel from the edge, positive inside.
    blur : (m,) float64 or float [px]
        Radius of the disc over which the edge is blurred, above 0.
    width : float [px]
        Width of a pixel across the edge.
    curvature : (m,) float64 or float [1/px]
        One over the radius of the aperture; 0 for a straight edge.
    """
    # Integrals over depth, at both sides of the pixel.
    side = np.stack([depth - width / 2, depth + width / 2])
    t = np.clip(side / blur, -1, 1)
    half = np.sqrt(1 - t**2)
    angle = np.arcsin(t)
    chord = half**3 / (3 * np.pi)
    share = 0.5 + (t * half + angle) / np.pi
    lost = blur**2 * (t * half * (5 - 2 * t**2) + 3 * angle) / (24 * np.pi)
    ends = (
        side * share + 2 * blur * chord - curvature * lost,
        share - curvature * blur * chord,
        2 * chord - curvature * (2 * lost / blur - blur * t * chord),
        -lost,
    )
    return EdgeLight(*((high - low) / width for low, high in ends))


def gaussian_edge(depth: Array, blur: Array | float, width: float) -> EdgeLight:
    """Light of pixels (m,) at a `depth` [px] inside a straight edge that a Gaussian blurs.

    Arguments are those of `blurred_edge`; the standard deviation of the Gaussian is half the `blur`,
    as that of a disc is.
    """
    from scipy.special import ndtr

    sigma = np.asarray(blur) / 2
    side = np.stack([depth - width / 2, depth + width / 2])
    share = ndtr(side / sigma)
    height = np.exp(-0.5 * (side / sigma) ** 2) / np.sqrt(2 * np.pi)
    ends = (side * share + sigma * height, share, height / 2, np.zeros_like(side))
    return EdgeLight(*((high - low) / width for low, high in ends))
