"""Taking back the blur of the microlenses, as far as the noise of the picture allows.

The picture is blurred by the microlenses (Lumsdaine and Georgiev 2008, section 5, propose to deconvolve it). A Wiener
filter undoes a blur `H` where the power spectrum of the picture exceeds that of its noise: `(1 - N / P) / H` (N. Wiener
1949, with the spectra of the picture at hand).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..flat.gray_flat import trusted_radius

__all__ = ["estimate_noise", "power_spectrum", "wiener_deconvolve"]

# Side of the blocks that spectra are averaged over [px]; the filter is half as wide.
_BLOCK = 64
# Blocks that are looked at: their mean tells a spectrum to some per cent.
_MOST_BLOCKS = 400
# No frequency is raised by more: the shape of the blur is not known so well.
_MOST_GAIN = 4.0
# A standard deviation over the median size of what is normally distributed.
_OVER_MEDIAN = 1.4826
# Rows of a flat that are looked at for its noise.
_ROWS = 400


def estimate_noise(pixels: NDArray, calibration: Calibration) -> float:
    """Standard deviation of the noise of a flat, in its own units.

    From second differences along both directions, which smooth things do not have (J. Immerkaer, *Fast noise variance
    estimation*, 1996), within the trusted part of the microimages; their median ignores edges.

    Parameters
    ----------
    pixels : (H, W, C) array
    calibration : Calibration
    """
    lattice = calibration.lattice
    height, width, _ = pixels.shape
    # Whole strips of pixels, evenly spread.
    rows = np.unique(np.linspace(1, height - 2, min(_ROWS, max(height - 2, 1))).astype(int))
    strips = [pixels[rows + shift].astype(np.float32).mean(2) * np.sqrt(pixels.shape[2]) for shift in (-1, 0, 1)]
    second = [strip[:, :-2] - 2 * strip[:, 1:-1] + strip[:, 2:] for strip in strips]
    both = second[0] - 2 * second[1] + second[2]
    points = np.stack(np.meshgrid(np.arange(1, width - 1), rows), -1).reshape(-1, 2).astype(float)
    away = np.linalg.norm(points - lattice.points(np.rint(lattice.to_index(points))), axis=1)
    inside = away < trusted_radius(calibration) - 1
    rounding = 1 / 12 if pixels.dtype.kind in "ui" else 0.0
    if not inside.any():
        return float(np.sqrt(rounding))
    # The weights 1, -2, 1 times themselves have squares that add up to 36.
    found = _OVER_MEDIAN * float(np.median(np.abs(both.ravel()[inside]))) / 6
    return float(np.sqrt(max(found * found, rounding)))


def power_spectrum(image: NDArray[np.float32]) -> NDArray[np.float64]:
    """(64, 64) float64: power spectrum of a picture (h, w, C), the same in all directions, frequency 0 first.

    Blocks that overlap by half are tapered and averaged (P. D. Welch 1967).
    """
    window = np.hanning(_BLOCK + 1)[:-1].astype(np.float32)
    window = window[:, None] * window
    places = [
        (v, u)
        for v in range(0, image.shape[0] - _BLOCK + 1, _BLOCK // 2)
        for u in range(0, image.shape[1] - _BLOCK + 1, _BLOCK // 2)
    ]
    total = np.zeros((_BLOCK, _BLOCK))
    places = places[:: max(1, len(places) // _MOST_BLOCKS)]
    for v, u in places:
        block = image[v : v + _BLOCK, u : u + _BLOCK]
        block = (block - block.mean((0, 1))) * window[..., None]
        total += (np.abs(np.fft.fft2(block, axes=(0, 1))) ** 2).mean(2)
    total /= max(len(places), 1) * float((window**2).sum())
    ring = np.rint(_frequency() * _BLOCK).astype(int)
    mean = np.bincount(ring.ravel(), total.ravel()) / np.maximum(np.bincount(ring.ravel()), 1)
    return np.asarray(mean[ring])


def wiener_deconvolve(
    image: NDArray[np.float32], width: float, noise: NDArray[np.float64], valid: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """A picture with its blur taken back.

    Parameters
    ----------
    image : (h, w, C) float32
    width : float [px]
        Side of the square that the blur averages over.
    noise : (64, 64) float64
        Spectrum of the picture's noise, as `power_spectrum` gives it.
    valid : (h, w) bool
        Pixels that are part of the picture; the others stay.

    Returns
    -------
    (h, w, C) float32
    """
    import cv2

    if width <= 0 or min(image.shape[:2]) < _BLOCK:
        return image
    known = power_spectrum(image)
    signal = np.clip(1 - noise / np.maximum(known, 1e-30), 0, 1)
    # A normal blur of the same variance: it has no zeros, whatever the shape of the true one.
    blur = np.exp(-2 * (np.pi * _frequency()) ** 2 * width * width / 12)
    gain = np.maximum(signal, blur) / np.maximum(blur, 1 / _MOST_GAIN)
    gain[0, 0] = 1
    kernel = np.fft.fftshift(np.fft.ifft2(gain).real)[1:, 1:]
    taper = np.hanning(_BLOCK + 1)[1:-1]
    kernel *= taper[:, None] * taper
    kernel /= kernel.sum()
    sharp = cv2.filter2D(image, -1, kernel.astype(np.float32), borderType=cv2.BORDER_REFLECT_101)
    return np.where(valid[..., None], sharp.reshape(image.shape), image)


def _frequency() -> NDArray[np.float64]:
    """(64, 64) periods per pixel."""
    along = np.fft.fftfreq(_BLOCK)
    return np.asarray(np.hypot(along[:, None], along))
