"""Defects of sensors and lenses; each function returns one that adds the defect to a flat."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .outcome import Harm

__all__ = ["dark_corners", "dust", "hot_pixels", "missing_lenses"]

_SPECK = 3.0
_SHADOW = 0.5


def _white(flat: NDArray[Any]) -> Any:
    return np.iinfo(flat.dtype).max if flat.dtype.kind == "u" else 1


def hot_pixels(share: float) -> Harm:
    """This share of the pixels is white."""

    def harm(flat: NDArray[Any]) -> NDArray[Any]:
        return np.where(
            np.random.default_rng(1).random(flat.shape) < share, _white(flat), flat
        ).astype(flat.dtype)

    return harm


def dust(share: float) -> Harm:
    """Specks of 6 px on the sensor, each of which takes half of the light, over about this share of
    the flat.
    """

    def harm(flat: NDArray[Any]) -> NDArray[Any]:
        rng = np.random.default_rng(2)
        light = flat.astype(float)
        y, x = np.mgrid[: flat.shape[0], : flat.shape[1]]
        for _ in range(round(share * flat.size / (np.pi * _SPECK**2))):
            u = rng.uniform(0, flat.shape[1])
            v = rng.uniform(0, flat.shape[0])
            light[np.hypot(x - u, y - v) < _SPECK] *= _SHADOW
        return light.astype(flat.dtype)

    return harm


def missing_lenses(centres: NDArray[np.float64], pitch: float, share: float) -> Harm:
    """This share of the microlenses, at `centres` (n, 2) [px], gives no light."""

    def harm(flat: NDArray[Any]) -> NDArray[Any]:
        dark = centres[np.random.default_rng(3).random(len(centres)) < share]
        out = flat.copy()
        reach = int(np.ceil(pitch))
        for u, v in dark:
            left = max(0, int(u) - reach)
            top = max(0, int(v) - reach)
            window = out[top : max(0, int(v) + reach + 2), left : max(0, int(u) + reach + 2)]
            y, x = np.mgrid[: window.shape[0], : window.shape[1]]
            window[np.hypot(x + left - u, y + top - v) < 0.5 * pitch] //= 50
        return out

    return harm


def dark_corners(loss: float) -> Harm:
    """The corners of the flat lose this share of the light, as a square of the distance from its
    middle.
    """

    def harm(flat: NDArray[Any]) -> NDArray[Any]:
        y, x = (np.linspace(-1, 1, side) ** 2 / 2 for side in flat.shape)
        return (flat * (1 - loss * (y[:, None] + x))).astype(flat.dtype)

    return harm
