"""Vignetting-corrected pictures of the flat that matching and drawing read from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration

from .bending import bent_by, lattice_bend, nearest_index
from .fastmath import FAST

__all__ = ["GrayFlat", "gain_table", "gray_flat", "lens_by_lens", "shrink", "white_level"]

# A gain above this would lift more noise than picture at the rim of a microimage.
_MAX_GAIN = 4.0
# Light that departs from one radial profile for all lenses by less than this share is as even as eyes can tell.
_EVEN = 0.01
# Where a lens delivers less than this share of its light, the correction is as uncertain as weak texture.
_TRUSTED_LIGHT = 0.9
# No microimage is trusted over less than this share of the pitch: nothing would be left to compare.
_LEAST_TRUSTED = 0.3


@dataclass(frozen=True)
class GrayFlat:
    """Brightness of the flat, vignetting-corrected, 1 at white, with the lens centres in its own pixels.

    Parameters
    ----------
    image : (H, W) float32
        Brightness; every pixel is corrected for the lens whose centre is nearest.
    centres : (n, 2) float32 [px of `image`]
        Lens centres, in the order of `lattice.centres()`.
    radius : float [px of `image`]
        Radius up to which a microimage is trusted.
    pitch : float [px of `image`]
    """

    image: NDArray[np.float32]
    centres: NDArray[np.float32]
    radius: float
    pitch: float


def gain_table(calibration: Calibration) -> tuple[NDArray[np.float32], float]:
    """Gain that undoes the vignetting, over the squared distance from the lens centre.

    Returns
    -------
    gains : (k,) float32
        Gain at squared radii `0, step, 2*step, ...`.
    step : float [px^2]
    """
    reach = (0.75 * calibration.lattice.pitch) ** 2
    squared = np.linspace(0.0, reach, 512)
    if calibration.vignetting is None:
        return np.ones(len(squared), np.float32), float(squared[1])
    light = calibration.vignetting.at(np.sqrt(squared))
    return (1.0 / np.maximum(light, 1.0 / _MAX_GAIN)).astype(np.float32), float(squared[1])


def lens_by_lens(calibration: Calibration) -> bool:
    """Whether lenses differ in their light, so that its radial profile alone would not make a flat even."""
    known = calibration.gain_map
    if known is None:
        return False
    uneven = max(np.abs(known.shade).max(), np.abs(known.level[1:]).max(initial=0.0))
    return bool(known.own.size or known.cut.size or uneven > _EVEN)


def white_level(flat: NDArray) -> float:
    """Value of the flat's brightest representable (integers) or customary (floats) pixel."""
    return float(np.iinfo(flat.dtype).max) if flat.dtype.kind in "ui" else 1.0


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _correct_gray(flat, scale, origin, inverse, basis, bend, low, inner, gains, step, out):
    """Mean over channels times the gain of the nearest lens."""
    height, width = out.shape
    channels = flat.shape[2]
    weight = np.float32(scale / channels)
    last = len(gains) - 1
    bent = bend.size > 0
    for y in prange(height):
        for x in range(width):
            total = np.float32(0.0)
            for k in range(channels):
                total += np.float32(flat[y, x, k])
            i, j = nearest_index(x, y, origin, inverse, bend, low)
            dx = x - origin[0] - i * basis[0, 0] - j * basis[1, 0]
            dy = y - origin[1] - i * basis[0, 1] - j * basis[1, 1]
            if bent:
                here_x, here_y = bent_by(bend, low, i, j)
                nearest = (dx - here_x) ** 2 + (dy - here_y) ** 2
            else:
                nearest = dx * dx + dy * dy
            if nearest > inner:
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        ex = dx - di * basis[0, 0] - dj * basis[1, 0]
                        ey = dy - di * basis[0, 1] - dj * basis[1, 1]
                        if bent:
                            bend_x, bend_y = bent_by(bend, low, i + di, j + dj)
                            ex, ey = ex - bend_x, ey - bend_y
                        nearest = min(nearest, ex * ex + ey * ey)
            out[y, x] = total * weight * gains[min(int(nearest / step), last)]


def gray_flat(flat: NDArray, calibration: Calibration) -> GrayFlat:
    """Brightness of `flat` (H, W, C), corrected for vignetting."""
    lattice = calibration.lattice
    image = np.empty(flat.shape[:2], np.float32)
    gains, step = gain_table(calibration)
    inverse = np.linalg.inv(lattice.basis)
    bend, low = lattice_bend(lattice)
    # Within half of the shortest lattice vector no other centre is nearer, with room for what a distortion takes of it.
    inner = 0.2 * float(((lattice.steps @ lattice.basis) ** 2).sum(1).min())
    _correct_gray(
        flat, 1.0 / white_level(flat), lattice.origin, inverse, lattice.basis, bend, low, inner, gains, step, image
    )
    return GrayFlat(image, lattice.centres().astype(np.float32), trusted_radius(calibration), lattice.pitch)


def trusted_radius(calibration: Calibration) -> float:
    """Radius [px] inside which microimages can be compared: off the rim, and where shading needs little correction."""
    lattice = calibration.lattice
    # Interpolation reads one pixel further.
    radius = lattice.radius - 1.0
    if calibration.vignetting is not None:
        distance = np.arange(0.0, lattice.radius, 0.25)
        dim = distance[calibration.vignetting.at(distance) < _TRUSTED_LIGHT]
        if dim.size:
            radius = min(radius, float(dim[0]))
    return max(radius, _LEAST_TRUSTED * lattice.pitch)


def shrink(gray: GrayFlat, factor: int) -> GrayFlat:
    """`gray` at a whole fraction of its resolution: each pixel is the mean of `factor` x `factor`."""
    import cv2

    if factor == 1:
        return gray
    height, width = (n // factor for n in gray.image.shape)
    image = cv2.resize(gray.image[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    centres = ((gray.centres + 0.5) / factor - 0.5).astype(np.float32)
    # Half a pixel at the rim mixes light from beyond it.
    return GrayFlat(image.astype(np.float32, copy=False), centres, gray.radius / factor - 0.5, gray.pitch / factor)
