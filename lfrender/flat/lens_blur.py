"""The discs over which the microlenses of a capture blur, with its depth at hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LensBlur, measure_lens_blur

from .gray_flat import grey_light, trusted_radius

__all__ = ["find_lens_blur"]

# [px] Discs that the camera file tells to this at all depths are not measured anew.
_SURE = 0.5


def find_lens_blur(
    look: Callable[[tuple[int, int, int, int]], NDArray], calibration: Calibration, patch_size: NDArray[np.float32]
) -> LensBlur | None:
    """As `lfcal.measure_lens_blur`; None where the camera file tells the discs well enough.

    `look` gives pixels (h, w, C) of a part of the flat, `patch_size` (n,) [px] is NaN where unresolved.
    """
    sizes = patch_size[np.isfinite(patch_size)]
    known = calibration.lens_blur
    if not sizes.size:
        return None
    if known is not None and known.at(np.quantile(sizes, (0.05, 0.95)) / calibration.lattice.pitch)[1].max() < _SURE:
        return None
    return measure_lens_blur(
        lambda part: grey_light(look(part), calibration), calibration, patch_size, trusted_radius(calibration)
    )
