"""Vignetting-corrected pictures of the flat that matching and drawing read from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration

__all__ = ["GrayFlat", "gain_table", "gray_flat"]

# A gain above this would lift more noise than picture at the rim of a microimage.
_MAX_GAIN = 4.0


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
    factor : int
        Flat pixels per pixel of `image`.
    """

    image: NDArray[np.float32]
    centres: NDArray[np.float32]
    radius: float
    pitch: float
    factor: int


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


def white_level(flat: NDArray) -> float:
    """Value of the flat's brightest representable (integers) or customary (floats) pixel."""
    return float(np.iinfo(flat.dtype).max) if flat.dtype.kind in "ui" else 1.0


@njit(cache=True, nogil=True, parallel=True, fastmath=True)
def _correct_gray(flat, scale, origin, inverse, basis, gains, step, factor, out):
    """Mean over channels and over factor x factor pixels, times the gain of the nearest lens."""
    height, width = out.shape
    channels = flat.shape[2]
    weight = np.float32(scale / (channels * factor * factor))
    last = len(gains) - 1
    for v in prange(height):
        for u in range(width):
            total = np.float32(0.0)
            for dy in range(factor):
                for dx in range(factor):
                    for k in range(channels):
                        total += np.float32(flat[v * factor + dy, u * factor + dx, k])
            x = (u + 0.5) * factor - 0.5 - origin[0]
            y = (v + 0.5) * factor - 0.5 - origin[1]
            i = np.rint(x * inverse[0, 0] + y * inverse[1, 0])
            j = np.rint(x * inverse[0, 1] + y * inverse[1, 1])
            dx0 = x - i * basis[0, 0] - j * basis[1, 0]
            dy0 = y - i * basis[0, 1] - j * basis[1, 1]
            nearest = dx0 * dx0 + dy0 * dy0
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    ex = dx0 - di * basis[0, 0] - dj * basis[1, 0]
                    ey = dy0 - di * basis[0, 1] - dj * basis[1, 1]
                    nearest = min(nearest, ex * ex + ey * ey)
            out[v, u] = total * weight * gains[min(int(nearest / step), last)]


def gray_flat(flat: NDArray, calibration: Calibration, factor: int = 1) -> GrayFlat:
    """Brightness of `flat`, corrected for vignetting, shrunk by the whole number `factor`.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array
    calibration : Calibration
    factor : int
        Each pixel of the result is the mean of `factor` x `factor` flat pixels.
    """
    lattice = calibration.lattice
    planes = flat[:, :, None] if flat.ndim == 2 else flat
    height, width = planes.shape[0] // factor, planes.shape[1] // factor
    image = np.empty((height, width), np.float32)
    gains, step = gain_table(calibration)
    _correct_gray(
        planes,
        1.0 / white_level(flat),
        lattice.origin,
        np.linalg.inv(lattice.basis),
        lattice.basis,
        gains,
        step,
        factor,
        image,
    )
    centres = (lattice.centres() + 0.5) / factor - 0.5
    # One pixel of the shrunken picture mixes light from beyond the rim.
    radius = lattice.radius / factor - 0.5 * (factor > 1)
    return GrayFlat(image, centres.astype(np.float32), radius, lattice.pitch / factor, factor)
