"""Deconvolution of a picture by a Wiener filter, as far as its noise allows, and not across depth edges.

The picture is blurred by the microlenses (Lumsdaine and Georgiev 2008, section 5, propose to deconvolve it). A Wiener
filter undoes a blur `H` where the power spectrum of the picture exceeds that of its noise: `(1 - N / P) / H` (N. Wiener
1949, with the spectra of the picture at hand).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..data.surface import sample_surface
from ..flat.gray_flat import trusted_radius
from ..flat.lens_blur import measure_lens_blur
from .plan import RenderPlan
from .settings import SHARPENING, SharpenSettings

__all__ = ["estimate_noise", "power_spectrum", "sharpen_picture", "wiener_deconvolve"]


def sharpen_picture(
    image: NDArray[np.float32],
    valid: NDArray[np.bool_],
    sharpen: float | Literal["auto"],
    plan: RenderPlan,
    pixels: NDArray,
    sizes: NDArray[np.float32],
    full: float,
    settings: SharpenSettings = SHARPENING,
) -> NDArray[np.float32]:
    """A picture without the blur of the microlenses, as far as its noise allows, except around depth edges.

    Parameters
    ----------
    image : (h, w, C) float32
        As `plan` has drawn it from `pixels`.
    valid : (h, w) bool
    sharpen : float [output px] or "auto"
        Side of the square that the blur averages over, or measure it.
    plan : RenderPlan
    pixels : (H, W, C) array
    sizes : (n,) float32 [px]
        Patch sizes of the lenses.
    full : float
        Scale of full resolution.
    """
    width = _blur_width(plan, pixels, sizes, full, settings) if sharpen == "auto" else float(sharpen)
    if width <= 0:
        return image
    # The spectrum of the picture's noise is that of noise rendered the same way.
    rng = np.random.default_rng(0)
    grain = rng.standard_normal((*pixels.shape[:2], 1), np.float32) * np.float32(settings.probe_noise)
    drawn, _ = replace(plan, reach=RenderPlan.reach).draw(grain)
    noise = power_spectrum(drawn, settings) * (estimate_noise(pixels, plan.calibration) / settings.probe_noise) ** 2
    sharp = wiener_deconvolve(image, width, noise, valid, settings)
    if plan.surface.patch_size.size == 1:
        return sharp
    return image + (sharp - image) * _weights_off_edges(plan, image.shape[:2], width, settings.edge_share)[..., None]


def _blur_width(
    plan: RenderPlan, pixels: NDArray, sizes: NDArray[np.float32], full: float, settings: SharpenSettings
) -> float:
    """Side [output px] of the square that the microlenses blur a picture over, beyond its pixels."""
    blur = settings.blur_share * (plan.blur or measure_lens_blur(pixels, plan.calibration, sizes))
    # In a picture coarser than the flat, the blur is a part of the footprint of its pixels already.
    excess = (blur * plan.scale) ** 2 + (min((plan.scale / full) ** 2 - 1, 0.0) if plan.blur else 0.0)
    return float(np.sqrt(max(excess, 0.0)))


def _weights_off_edges(
    plan: RenderPlan, shape: tuple[int, int], width: float, edge_share: float
) -> NDArray[np.float32]:
    """(h, w) float32: 1 on one surface, falling to 0 toward depth edges."""
    import cv2

    pitch = plan.calibration.lattice.pitch
    depth = sample_surface(plan.surface, pitch, shape, pitch / plan.scale)
    side = 2 * int(np.ceil(width)) + 1
    around = np.ones((side, side), np.uint8)
    level = cv2.dilate(depth, around) - cv2.erode(depth, around) <= edge_share * pitch
    return np.asarray(cv2.blur(level.astype(np.float32), (side, side)), np.float32)


def estimate_noise(pixels: NDArray, calibration: Calibration, settings: SharpenSettings = SHARPENING) -> float:
    """Standard deviation of the noise of a flat, in its own units.

    From second differences along both directions, in which smooth image content cancels (J. Immerkaer, *Fast noise
    variance estimation*, 1996), within the trusted part of the microimages; their median ignores edges.

    Parameters
    ----------
    pixels : (H, W, C) array
    calibration : Calibration
    """
    lattice = calibration.lattice
    height, width, _ = pixels.shape
    rows = np.unique(np.linspace(1, height - 2, min(settings.noise_rows, max(height - 2, 1))).astype(int))
    strips = [pixels[rows + shift].astype(np.float32).mean(2) * np.sqrt(pixels.shape[2]) for shift in (-1, 0, 1)]
    second = [strip[:, :-2] - 2 * strip[:, 1:-1] + strip[:, 2:] for strip in strips]
    both = second[0] - 2 * second[1] + second[2]
    points = np.stack(np.meshgrid(np.arange(1, width - 1), rows), -1).reshape(-1, 2).astype(float)
    away = np.linalg.norm(points - lattice.points(np.rint(lattice.to_index(points))), axis=1)
    inside = away < trusted_radius(calibration) - 1
    rounding = 1 / 12 if pixels.dtype.kind in "ui" else 0.0
    if not inside.any():
        return float(np.sqrt(rounding))
    # 1.4826 makes the median absolute deviation a standard deviation; the squared weights 1, -2, 1 times themselves
    # add up to 36.
    found = 1.4826 * float(np.median(np.abs(both.ravel()[inside]))) / 6
    return float(np.sqrt(max(found * found, rounding)))


def power_spectrum(image: NDArray[np.float32], settings: SharpenSettings = SHARPENING) -> NDArray[np.float64]:
    """(64, 64) float64: power spectrum of a picture (h, w, C), averaged over directions, frequency 0 first.

    Blocks that overlap by half are tapered and averaged (P. D. Welch 1967).
    """
    block = settings.block
    window = np.hanning(block + 1)[:-1].astype(np.float32)
    window = window[:, None] * window
    places = [
        (v, u)
        for v in range(0, image.shape[0] - block + 1, block // 2)
        for u in range(0, image.shape[1] - block + 1, block // 2)
    ]
    total = np.zeros((block, block))
    places = places[:: max(1, len(places) // settings.most_blocks)]
    for v, u in places:
        part = image[v : v + block, u : u + block]
        part = (part - part.mean((0, 1))) * window[..., None]
        total += (np.abs(np.fft.fft2(part, axes=(0, 1))) ** 2).mean(2)
    total /= max(len(places), 1) * float((window**2).sum())
    ring = np.rint(_frequency(block) * block).astype(int)
    mean = np.bincount(ring.ravel(), total.ravel()) / np.maximum(np.bincount(ring.ravel()), 1)
    return np.asarray(mean[ring])


def wiener_deconvolve(
    image: NDArray[np.float32],
    width: float,
    noise: NDArray[np.float64],
    valid: NDArray[np.bool_],
    settings: SharpenSettings = SHARPENING,
) -> NDArray[np.float32]:
    """Undo a blur by a Wiener filter.

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

    block = settings.block
    if width <= 0 or min(image.shape[:2]) < block:
        return image
    signal = np.clip(1 - noise / np.maximum(power_spectrum(image, settings), 1e-30), 0, 1)
    # A Gaussian blur of the same variance: it has no zeros, whatever the shape of the true one.
    blur = np.exp(-2 * (np.pi * _frequency(block)) ** 2 * width * width / 12)
    gain = np.maximum(signal, blur) / np.maximum(blur, 1 / settings.most_gain)
    gain[0, 0] = 1
    kernel = np.fft.fftshift(np.fft.ifft2(gain).real)[1:, 1:]
    taper = np.hanning(block + 1)[1:-1]
    kernel *= taper[:, None] * taper
    kernel /= kernel.sum()
    sharp = cv2.filter2D(image, -1, kernel.astype(np.float32), borderType=cv2.BORDER_REFLECT_101)
    return np.where(valid[..., None], sharp.reshape(image.shape), image)


def _frequency(block: int) -> NDArray[np.float64]:
    """(block, block) periods per pixel."""
    along = np.fft.fftfreq(block)
    return np.asarray(np.hypot(along[:, None], along))
