"""How much of the flat's sampling is left in a picture: less, the more the lenses differ in where their pixels lie.

Where a picture is finer than the flat, interpolated pixels show images of the scene's spectrum about the multiples of
the flat's sampling. Lenses that see a place sample it with phases of their own, so that images cancel in their mean;
but at depths where all phases are alike, as in rows of an upright lattice, they add up to stripes.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..flat.lens_type_weights import focus_weights

__all__ = ["image_power"]

# Of the flat's sampling: along the axes, and diagonal.
_MULTIPLES = np.array([[1, 0], [0, 1], [1, 1], [1, -1]])


def image_power(calibration: Calibration, ratios: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Share of the power of images that is left in the mean over the lenses: 0 if they cancel, 1 if phases are alike.

    A lens is read at `c (1 + s / D) - X s / D` (docs/geometry.md), which gives its phase.

    Parameters
    ----------
    calibration : Calibration
    ratios : (n,) float64
        `s / D` of places.
    reach : float [pitch]
        Lenses farther from a place are not averaged.

    Returns
    -------
    (2, n) float64
        Mean of the images along the axes, and of the diagonal ones, over places.

    Examples
    --------
    >>> from data_synth import Camera
    >>> upright = Camera.design(size=(400, 400), pitch=24.0, lattice="square").calibration()
    >>> image_power(upright, np.array([-0.25, -0.23]), 1.7)[0].round(2)
    array([1., 0.])
    """
    lattice = calibration.lattice
    limit = np.minimum(lattice.radius / np.abs(ratios), reach * lattice.pitch)
    most = int(np.ceil(2 * limit.max() * np.linalg.norm(np.linalg.inv(lattice.basis), axis=0).max()))
    steps = np.stack(np.meshgrid(*[np.arange(-most, most + 1)] * 2), -1).reshape(-1, 2)
    apart = steps @ lattice.basis
    far = np.linalg.norm(apart, axis=1)
    # Each pair counts once; a lens and itself make half a pair.
    some = (far < 2 * limit.max()) & ((steps @ [1, 3 * most] > 0) | (far == 0))
    steps, apart, far = steps[some], apart[some], far[some]
    shared = np.interp(far / limit[:, None], *_overlap()) * _both(calibration, ratios, steps)
    shared *= np.where(far > 0, 1.0, 0.5)
    phases = 2 * np.pi * (1 + ratios[:, None]) * (apart @ _MULTIPLES.T).T[:, None]
    left = (shared * np.cos(phases)).sum(2) / shared.sum(1)
    return np.maximum(left.reshape(2, 2, -1).mean(1), 0)


@lru_cache(1)
def _overlap() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean product of the weights of two lenses, over places, by how far they are apart [reach]."""
    apart = np.linspace(0, 2, 41)
    x = np.linspace(-1, 1, 81)
    own = np.maximum(1 - x[:, None] ** 2 - x**2, 0)
    other = np.maximum(1 - (x[:, None] - apart[:, None, None]) ** 2 - x**2, 0)
    return apart, (own * other).sum((1, 2))


def _both(calibration: Calibration, ratios: NDArray[np.float64], steps: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n, m) mean product of the weights of the types of two lenses `steps` (m, 2) apart."""
    cell, weights = focus_weights(calibration.lens_types)
    if not cell.size:
        return np.ones((1, 1))
    at = np.rint((np.clip(ratios, -1, 1) + 1) / 2 * (weights.shape[1] - 1)).astype(int)
    of_lens = weights[:, at][cell]  # (side, side, n)
    side = len(cell)
    moved = [[np.roll(of_lens, (-i, -j), (0, 1)) for j in range(side)] for i in range(side)]
    return np.asarray((of_lens * moved).mean((2, 3))[tuple((steps % side).T)].T)
