"""A flat of Gaussian dots for the tests of this folder."""

from __future__ import annotations

import numpy as np

from lfcal import Lattice

__all__ = ["LATTICE", "draw_dots"]

LATTICE = Lattice((11.3, 9.8), ((20.0, 1.5), (-1.0, 18.0)), (300, 240), 8.0)
_WIDTH = 4.0


def draw_dots(centres: np.ndarray, light: np.ndarray | float = 1.0) -> np.ndarray:
    """Dots (240, 300) float32 at centres (n, 2), each with its light (n,) in the middle."""
    y, x = np.mgrid[:240, :300]
    far = (x - centres[:, 0, None, None]) ** 2 + (y - centres[:, 1, None, None]) ** 2
    dots = np.exp(-far / (2 * _WIDTH**2))
    return (np.reshape(light, (-1, 1, 1)) * dots).sum(0).astype(np.float32)
