"""Richardson-Lucy deconvolution (Richardson 1972, Lucy 1974) down to the noise of the flat.

The volume that makes the flat most likely under photon noise is approached in steps that keep it
positive:

    V <- V * A^T(w y / (w A V)) / A^T(w),

with the flat y, the forward model A and the light w of its pixels. Later steps fit noise. They end
where the misfit is that of the noise (discrepancy principle of Morozov), or where it hardly falls
any more, since the model has errors too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from lfcal.runtime.arrays import Singles
from lfcal.runtime.progress import Step

from .pixels import FlatPixels
from .projection import Projector

__all__ = ["Fit", "deconvolve"]

# Stop if a step lowers the misfit (in variances of the noise) by less than this share. Ray-traced
# shells: correlation with the truth 0.88 at 0.02, 0.89 at 0.01, which takes twice the steps.
_LEAST_GAIN = 0.01
# Steps after which the light of directions is balanced; later it stays as it is.
_BALANCED_STEPS = range(2, 7)
# Voxels that get less light than this share of the best lit voxel of their plane stay 0.
_LEAST_SEEN = 1e-3
# Light that is added to both sides of the ratio of a direction, as a share of the mean light of
# all directions: it keeps the ratio of dark directions near 1.
_PRIOR = 0.1


@dataclass(frozen=True)
class Fit:
    """How well the flat that a volume predicts agrees with the flat that was taken.

    Parameters
    ----------
    residual : float
        RMS of the difference, over the RMS of the flat.
    noise : float
        RMS of the noise of the flat, over the RMS of the flat.
    steps : int
    reason : str
        Why the iteration stopped.

    Examples
    --------
    >>> from lfrender.volume.richardson_lucy import Fit
    >>> Fit(0.05, 0.04, 30, "the residual hardly falls any more").steps
    30
    """

    residual: float
    noise: float
    steps: int
    reason: str


def deconvolve(
    projector: Projector,
    pixels: FlatPixels,
    variance: Callable[[Singles], Singles],
    steps: int,
    start: Singles | None = None,
    progress: Step | None = None,
) -> tuple[Singles, Fit]:
    """The volume (n, h, w) that the pixels show, not yet smoothed by the null space, and the fit.

    `variance` maps values of pixels to the variance of their noise. `start` is the volume before
    the first step, an even one by default. `progress` is called after each of at most `steps`
    steps.
    """
    values = pixels.values
    light = pixels.light
    norm = _seen(projector, light)
    mean = float(values.sum(dtype=float) / light.sum(dtype=float))
    volume = np.full(norm.shape, max(mean, 1e-12) / len(norm), np.float32)
    if start is not None:
        np.maximum(start, _LEAST_SEEN * volume, out=volume)
    volume[norm == 0] = 0
    floor = np.float32(1e-6 * max(mean, 1e-12))
    reason = f"{steps} steps were done"
    before = np.inf
    done = 0
    for done in range(1, steps + 1):
        predicted = np.maximum(light * projector.forward(volume), floor)
        if done in _BALANCED_STEPS:
            balance = _balance_directions(pixels, predicted)
            light = light * balance
            predicted *= balance
            norm = _seen(projector, light)
        misfit = float(np.mean((values - predicted) ** 2 / variance(predicted), dtype=float))
        if misfit <= 1:
            reason = "the residual is that of the noise"
            break
        if done > _BALANCED_STEPS.stop and misfit > (1 - _LEAST_GAIN) * before:
            reason = "the residual hardly falls any more"
            break
        before = misfit
        projector.multiply(volume, light * values / predicted, norm)
        if progress is not None:
            progress(done, steps)
    else:
        predicted = light * projector.forward(volume)
    size = _root_mean(values**2)
    residual = _root_mean((values - predicted) ** 2)
    noise = _root_mean(variance(predicted))
    return volume, Fit(residual / size, noise / size, done, reason)


def _root_mean(squares: Singles) -> float:
    return float(np.sqrt(np.mean(squares, dtype=float)))


def _seen(projector: Projector, light: Singles) -> Singles:
    """Light that each voxel gives to the flat; negligible light is set to 0."""
    norm = projector.adjoint(light)
    least = _LEAST_SEEN * norm.max(axis=(1, 2), keepdims=True)
    norm[norm < least] = 0
    return norm


def _balance_directions(pixels: FlatPixels, predicted: Singles) -> Singles:
    """(p,) factor for the light of each pixel, the same in all microimages.

    Summed over all lenses, every direction sees the same light of a specimen. If the flat and its
    prediction differ in that sum, the white image lit the aperture in another way than the specimen
    does: slanted rays, for example, have a longer way through a volume.
    """
    count = pixels.side**2
    shape = (pixels.side, pixels.side)
    taken = np.bincount(pixels.bins, pixels.values, count).reshape(shape)
    expected = np.bincount(pixels.bins, predicted, count).reshape(shape)
    used = np.bincount(pixels.bins, minlength=count) > 0
    evidence = _PRIOR * expected.sum() / used.sum()
    ratio = (uniform_filter(taken, 3) + evidence) / (uniform_filter(expected, 3) + evidence)
    return ratio.ravel()[pixels.bins].astype(np.float32)
