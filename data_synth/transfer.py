"""From radiance to stored numbers: exposure, noise, transfer curve, quantisation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["EXPOSURE", "develop", "from_srgb", "to_srgb"]

# White lies this far below saturation, so that noise is not clipped.
EXPOSURE = 0.9


def to_srgb(linear: NDArray[Any]) -> NDArray[Any]:
    """The sRGB curve (IEC 61966-2-1) for values in 0..1."""
    return np.where(
        linear <= 0.0031308,
        12.92 * linear,
        1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055,
    )


def from_srgb(encoded: NDArray[Any]) -> NDArray[Any]:
    """Inverse of `to_srgb`."""
    return np.where(
        encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    )


def develop(
    radiance: NDArray[np.float32],
    *,
    noise: tuple[float, float] | None,
    bits: int,
    gamma: bool,
    rng: np.random.Generator,
) -> NDArray[Any]:
    """Stored picture, `round((2**bits - 1) * T(clip(exposure * radiance + noise)))`, uint8 or
    uint16.

    Parameters
    ----------
    noise : (full_well, read) or None
        Electrons at saturation, and standard deviation of the read-out in electrons.
    """
    exposed = EXPOSURE * radiance
    if noise is not None:
        full_well, read = noise
        electrons = rng.poisson(np.maximum(exposed, 0) * full_well) + read * rng.standard_normal(
            exposed.shape
        )
        exposed = electrons / full_well
    exposed = np.clip(exposed, 0, 1)
    top = (1 << bits) - 1
    return np.rint(top * (to_srgb(exposed) if gamma else exposed)).astype(
        np.uint8 if bits == 8 else np.uint16
    )
