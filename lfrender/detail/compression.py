"""What compression in blocks left of each spatial frequency: how many coefficients of the blocks are zero tells it.

JPEG rounds the cosine coefficients of blocks of 8 x 8 pixels to steps that only the file knows; most of fine detail
becomes zero. Blocks beside those of the file have far more coefficients that are not: so compression is seen (Fan and
de Queiroz 2003). Coefficients have a Laplace distribution (Lam and Goodman 2000), of which the share that was rounded
to zero tells the step, and so the share of the power that is left.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from .settings import COMPRESSION, CompressionSettings

__all__ = ["Look", "find_blocks", "kept_power"]

#: Pixels (h, w, C) of the part `left, top, right, bottom` of a flat.
Look = Callable[[tuple[int, int, int, int]], NDArray]

_SIDE = 8
# Those of a block, orthonormal: as of `scipy.fft`, which takes long to import.
_COSINES = np.cos(np.pi / _SIDE * np.outer(np.arange(_SIDE), np.arange(_SIDE) + 0.5)).astype(np.float32)
_COSINES *= np.where(np.arange(_SIDE) > 0, 0.5, 0.5**1.5)[:, None].astype(np.float32)
# Of each coefficient of a block [cycles / px].
_FREQUENCY = np.hypot.outer(np.arange(_SIDE), np.arange(_SIDE)) / (2 * _SIDE)
_FINE = _FREQUENCY > 0.25
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


def find_blocks(
    look: Look, places: NDArray[np.float64], settings: CompressionSettings = COMPRESSION
) -> tuple[int, int] | None:
    """Where the first whole block begins (x, y < 8) on a flat that was compressed in blocks; None on others.

    Parameters
    ----------
    look : function
        Gives a part of the flat.
    places : (n, 2) float64 [px]
        About which blocks are looked at, 8 px or more from the border.
    """
    low = np.floor(places).astype(int) - _SIDE + 1
    boxes = _read(look, low, 2 * _SIDE - 1)
    # (n, rows, columns, 8, 8): of all blocks that hold the place.
    every = _coefficients(sliding_window_view(_coefficients(sliding_window_view(boxes, _SIDE, 2)), _SIDE, 1))
    seen = (np.abs(every[..., _FINE]) > settings.zero).mean(-1)
    # By where the blocks begin, in x and y modulo 8.
    steps = np.arange(_SIDE)
    column, row = ((low[:, axis, None] + steps) % _SIDE for axis in (0, 1))
    share = np.zeros((_SIDE, _SIDE))
    np.add.at(share, (row[:, :, None], column[:, None]), seen / len(low))
    y, x = np.unravel_index(share.argmin(), share.shape)
    return (int(x), int(y)) if np.median(share) > settings.more_nonzero * share.min() else None


def kept_power(
    look: Look,
    places: NDArray[np.float64],
    blocks: tuple[int, int],
    frequency: NDArray[np.float64],
    settings: CompressionSettings = COMPRESSION,
) -> NDArray[np.float64]:
    """Share of the power of detail that compression left at each frequency (f,) [cycles / px], about places (n, 2)."""
    first = np.array(blocks)
    low = np.rint((places - (_SIDE - 1) / 2 - first) / _SIDE).astype(int) * _SIDE + first
    shown = np.abs(_coefficients(_coefficients(_read(look, low, _SIDE)).swapaxes(1, 2))) > settings.zero
    near = np.maximum(1 - np.abs(frequency[:, None] - _FREQUENCY.ravel()) * 2 * _SIDE, 0)
    near[:, 0] = 0
    return np.asarray(near @ _left(shown.mean(0)).ravel() / np.maximum(near.sum(1), 1e-9))


def _left(nonzero: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the power of Laplace distributions that is left if this share of their values is not rounded to zero."""
    tail = np.clip(nonzero, 1e-6, 1 - 1e-6)
    rate = -2 * np.log(tail)  # of the distribution, with the step for a unit
    beyond = tail / (1 - tail**2)
    common = beyond * (tail**2 / (1 - tail**2) + 0.5 + 1 / rate)  # mean product of values and rounded ones
    return np.asarray((rate**2 / 2 * common) ** 2)


def _read(look: Look, low: NDArray[np.int64], side: int) -> NDArray[np.float32]:
    """(n, side, side) luminance, from 0 to 255, of squares that begin at `low` (n, 2)."""
    boxes = np.stack([look((x, y, x + side, y + side)) for x, y in low.tolist()])
    channels, most = boxes.shape[3], np.iinfo(boxes.dtype).max if boxes.dtype.kind in "ui" else 1
    weight = _LUMA if channels == 3 else np.full(channels, 1 / channels, np.float32)
    return np.asarray(boxes @ (weight * np.float32(255 / most)))


def _coefficients(pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Cosine coefficients of rows of 8, along the last axis."""
    return (pixels.reshape(-1, _SIDE) @ _COSINES.T).reshape(pixels.shape)
