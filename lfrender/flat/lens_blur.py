"""The discs over which the microlenses of a capture blur, with its depth at hand."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from lfcal import Calibration, LensBlur, measure_lens_blur

from .gray_flat import grey_light, trusted_radius

__all__ = ["find_lens_blur", "has_blocks"]

# [px] Discs that the camera file tells to this at all depths are not measured anew.
_SURE = 0.5
# Rows and columns that blocks are looked for in.
_LINES = 200
# In both directions, the steps between blocks stand out by this many standard errors, and by so
# many times as much as any others: JPEG of quality 50 of 29 simulated flats has 5.2 and 2.6 at
# least. Captures that were not coded so have 4.2 and 1.5 at most (Boys2), 29 simulated ones 1.7.
_OUTSTANDING = 5.0
_TIMES = 1.6


def has_blocks(pixels: NDArray) -> bool:
    """Whether pixels (h, w, C) step every eight rows and columns, as blocks of JPEG do."""
    return min(pixels.shape[:2]) >= 80 and all(
        _steps_stand_out(one) for one in (pixels, pixels.swapaxes(0, 1))
    )


def _steps_stand_out(pixels: NDArray) -> bool:
    rows = np.linspace(0, len(pixels) - 1, min(_LINES, len(pixels))).astype(int)
    channels = pixels.shape[2]
    # A product with a vector takes a tenth of the time of a mean.
    grey = pixels[rows].astype(np.float32) @ np.full(channels, 1 / channels, np.float32)
    step = np.abs(np.diff(grey, axis=1))
    beyond = (step[:, 1:-1] - (step[:, :-2] + step[:, 2:]) / 2).mean(0)
    phases = beyond[: len(beyond) // 8 * 8].reshape(-1, 8)
    mean = phases.mean(0) - np.median(phases.mean(0))
    error = float((phases.std(0) / np.sqrt(len(phases))).mean())
    *_, second, first = np.sort(mean)
    return bool(first > _OUTSTANDING * error and first > _TIMES * second)


def find_lens_blur(
    pixels: NDArray,
    corner: tuple[int, int],
    calibration: Calibration,
    patch_size: NDArray[np.float32],
) -> LensBlur | None:
    """As `lfcal.measure_lens_blur`, from a part (h, w, C) of a flat that begins at `corner`.

    None where the camera file tells the discs well enough, and where compression has taken detail,
    which would pass for blur. `patch_size` (n,) [px] is NaN where unresolved, and for lenses that
    the part does not show whole.
    """
    sizes = patch_size[np.isfinite(patch_size)]
    known, (left, top) = calibration.lens_blur, corner
    if not sizes.size or has_blocks(pixels):
        return None
    if (
        known is not None
        and known.at(np.quantile(sizes, (0.05, 0.95)) / calibration.lattice.pitch)[1].max() < _SURE
    ):
        return None

    def light(corners: NDArray[np.int64], side: int) -> NDArray[np.float32]:
        x, y = (corners - (left, top)).T
        windows = sliding_window_view(pixels, (side, side), (0, 1))[y, x]
        return grey_light(np.moveaxis(windows, 1, -1), calibration)

    return measure_lens_blur(light, calibration, patch_size, trusted_radius(calibration))
