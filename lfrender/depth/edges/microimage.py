"""Work space of the kernels that look at the pixels of one microimage."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

__all__ = [
    "BINS",
    "DEPTHS",
    "NEARBY",
    "OWN",
    "Microimage",
    "box_stride",
    "make_microimage",
]

#: Patch sizes of a lens, at most.
DEPTHS = 16
#: Bins of patch sizes that the surface has near a lens.
BINS = 512
#: A depth that the surface has near the place that a pixel shows at it; one that it has there.
NEARBY = 1
OWN = 2


class Microimage(NamedTuple):
    """Work space for the pixels of one lens in a box; k counts its depths, p is `row * stride +
    column`.
    """

    left: Any  # (size,) first column of each row of the microimage
    right: Any  # (size,) end of its columns
    upper: Any  # (stride,) first row of each column with pixels that are not settled
    lower: Any  # (stride,) end of its rows
    depths: Any  # (k,) [px]
    # (size,) [pitch] mean patch size of the pixels of each row at the depth that is compared
    slopes: Any
    bins: Any  # (2, BINS) number and sum of the patch sizes in each
    x: Any  # (stride,) [px] place of each column, from the middle of the microimage
    light: Any  # (p,) brightness
    chosen: Any  # (p,) int8: k of its depth, -1 outside the microimage
    among: Any  # (p,) uint8: depths that are possible; pixels with one are settled
    allowed: Any  # (p,) mismatch that noise and blur explain
    apart: Any  # (p,) squared difference to another lens
    mismatch: Any  # (p,) with it, of a patch
    seen: Any  # (p,) 1: pixels that the other lens shows
    count: Any  # (p,) lenses that a pixel has been compared with, the most where it is not compared
    sum: Any  # (p,) of their mismatch
    value: Any  # (k, p) [px] patch size that each depth has there
    cost: Any  # (k, p)
    total: Any  # (k, p) sum of the paths of semi-global matching
    present: Any  # (k, p) uint8: 0, `NEARBY` or `OWN`
    path: Any  # (2, k) costs of the last and this pixel of a path


@njit(inline="always")
def box_stride(size):
    """Pixels from row to row of a box that is `size` pixels wide: whole vectors, and one pixel more
    at least.
    """
    return (size + 8) // 8 * 8


@njit(error_model="numpy")
def make_microimage(size):
    """Work space for microimages of `size` pixels each way."""
    stride = box_stride(size)
    # Bilinear interpolation reads a row and a pixel further.
    n = (size + 2) * stride
    line = np.zeros(stride, np.int64)
    box = np.zeros(n, np.float32)
    boxes = np.zeros((DEPTHS, n), np.float32)
    return Microimage(
        np.zeros(size, np.int64),
        np.zeros(size, np.int64),
        line,
        line.copy(),
        np.zeros(DEPTHS),
        np.zeros(size),
        np.zeros((2, BINS)),
        np.zeros(stride, np.float32),
        box,
        np.zeros(n, np.int8),
        np.zeros(n, np.uint8),
        box + np.float32(1),
        box.copy(),
        box.copy(),
        box.copy(),
        box.copy(),
        box.copy(),
        boxes,
        boxes.copy(),
        boxes.copy(),
        np.zeros((DEPTHS, n), np.uint8),
        np.zeros((2, DEPTHS), np.float32),
    )
