"""Work space of the kernels that look at the pixels of one microimage, and the settings that they use."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lfcal.runtime.kernels.jit import njit

__all__ = ["BINS", "DEPTHS", "LEFT_OUT", "Microimage", "PixelCosts", "make_microimage"]

#: Patch sizes of a lens, at most.
DEPTHS = 16
#: Lenses that a pixel need not agree with, at most.
LEFT_OUT = 4
#: Bins of patch sizes that the surface has near a lens.
BINS = 512


class PixelCosts(NamedTuple):
    """Values of `EdgeSettings` for the kernels, in squared units where they are compared with squares."""

    noise2: Any
    contrast: Any
    visible_share: Any
    jump: Any
    edge2: Any
    reach: Any  # [px]
    unseen: Any
    around: Any


class Microimage(NamedTuple):
    """Work space for the pixels of one lens, `size` each way; k counts its depths, p is `row * size + column`."""

    inside: Any  # (size, size) bool: pixels of the microimage
    value: Any  # (k, size, size) [px] patch size that each depth has there
    slope: Any  # (k, size, size) the same [pitch]
    cost: Any  # (k, size, size)
    open: Any  # (size, size) bool: pixels that several depths are possible for
    present: Any  # (k, size, size) bool: the surface has this depth nearby
    columns: Any  # (size, 2) first column and end of the pixels that are compared, and of those beside them
    wanted: Any  # (p,) bool: pixels that are compared with further lenses
    allowed: Any  # (p,) mismatch that noise and blur explain
    apart: Any  # (p,) squared difference to another lens
    mismatch: Any  # (p,) with it, of the patch
    seen: Any  # (p,) 1 where the other lens shows a pixel, else 0
    count: Any  # (p,) lenses that a pixel has been compared with
    sum: Any  # (p,) of their mismatch
    worst: Any  # (LEFT_OUT, p) the largest of these, the largest first
    total: Any  # (k, size, size) sum of the paths of semi-global matching
    jumps: Any  # (2, size, size) price of a depth edge to the next pixel of the row, of the column
    path: Any  # (2, k) costs of the last and this pixel of a path
    depths: Any  # (k,) [px]
    bins: Any  # (2, BINS) number and sum of the patch sizes in each


@njit(cache=True, nogil=True, error_model="numpy")
def make_microimage(size):
    """Work space for microimages of `size` pixels."""
    flat, deep, line = (size, size), (DEPTHS, size, size), size * size
    return Microimage(
        np.zeros(flat, np.bool_), np.zeros(deep, np.float32), np.zeros(deep, np.float32), np.zeros(deep, np.float32),
        np.zeros(flat, np.bool_), np.zeros(deep, np.bool_), np.zeros((size, 2), np.int64),
        np.zeros(line, np.bool_),
        np.ones(line, np.float32), np.zeros(line, np.float32), np.zeros(line, np.float32), np.zeros(line, np.float32),
        np.zeros(line, np.float32), np.zeros(line, np.float32), np.zeros((LEFT_OUT, line), np.float32),
        np.zeros(deep, np.float32), np.zeros((2, size, size), np.float32), np.zeros((2, DEPTHS), np.float32),
        np.zeros(DEPTHS), np.zeros((2, BINS)),
    )  # fmt: skip
