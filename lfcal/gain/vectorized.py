"""Light at many places of a lens at once: long loops that become vector instructions."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ..runtime.fastmath import FAST
from .kernel import CUT_EDGE_SIGMAS, RIM_START, ROOT_HALF

__all__ = ["make_edge_table", "relative_light_general", "relative_light_round"]

# So many entries for each standard deviation in a table of the edge of the cut.
_PER_SIGMA = 32


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def relative_light_round(pixels, count, lens, profile, rise, scale, shape, ring):
    """`light` of a described round uncut lens at `count` places (2, k) float32, and its `ring` of the profile there.

    `profile` and the `rise` from ring to ring are float32, `scale` is rings per px. Long loops that read and write in
    order become vector instructions; what is looked up in between does not.
    """
    one, most, last = np.float32(1), np.float32(len(rise)), np.int32(len(rise) - 1)
    p, q = np.float32(lens[0]), np.float32(lens[1])
    uu, uv, vv = np.float32(lens[2]), np.float32(lens[3]), np.float32(lens[4])
    for k in range(count):
        shape[k] = min(np.sqrt(pixels[0, k] * pixels[0, k] + pixels[1, k] * pixels[1, k]) * scale, most)
    for k in range(count):
        here = min(np.int32(shape[k]), last)
        ring[k] = here
        shape[k] = profile[here] + rise[here] * (shape[k] - np.float32(here))
    for k in range(count):
        x, y = pixels[0, k], pixels[1, k]
        shape[k] *= one + x * (p + uu * x + uv * y) + y * (q + vv * y)


@njit(cache=True, nogil=True, error_model="numpy")
def make_edge_table():
    """Light through the edge of a cutting disc from so many standard deviations outside of it to as many inside."""
    table = np.empty(2 * round(CUT_EDGE_SIGMAS) * _PER_SIGMA + 2, np.float32)
    for k in range(len(table)):
        table[k] = 0.5 * (1 + math.erf((k / _PER_SIGMA - CUT_EDGE_SIGMAS) * ROOT_HALF))
    table[0], table[-2], table[-1] = 0.0, 1.0, 1.0
    return table


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def relative_light_general(pixels, count, lens, profile, rise, step, cut, table, spare, shape, ring):
    """`relative_light_round` of a lens whose rim differs with the direction, or is cut (`table`: `make_edge_table`).

    `spare` (5, k) float32 is room to calculate in.
    """
    one, none, tiny = np.float32(1), np.float32(0), np.float32(1e-6)
    most, last = np.float32(len(rise)), np.int32(len(rise) - 1)
    scale, around = np.float32(1 / step), (len(lens) - RIM_START) // 2
    p, q = np.float32(lens[0]), np.float32(lens[1])
    uu, uv, vv = np.float32(lens[2]), np.float32(lens[3]), np.float32(lens[4])
    even = one - np.float32(lens[RIM_START])
    far, cos, sin, cosine, sine = spare[0], spare[1], spare[2], spare[3], spare[4]
    for k in range(count):
        far[k] = np.sqrt(pixels[0, k] * pixels[0, k] + pixels[1, k] * pixels[1, k])
        shape[k] = even
    if around > 0:
        for k in range(count):
            over = one / max(far[k], tiny)
            cos[k], sin[k] = pixels[0, k] * over, pixels[1, k] * over
            cosine[k], sine[k] = cos[k], sin[k]
    for m in range(around):
        a, b = np.float32(lens[RIM_START + 1 + 2 * m]), np.float32(lens[RIM_START + 2 + 2 * m])
        for k in range(count):
            shape[k] -= a * cosine[k] + b * sine[k]
        if m + 1 < around:
            for k in range(count):
                turned = cosine[k] * cos[k] - sine[k] * sin[k]
                sine[k] = sine[k] * cos[k] + cosine[k] * sin[k]
                cosine[k] = turned
    for k in range(count):
        shape[k] = min(max(far[k] * shape[k], none) * scale, most)
    for k in range(count):
        here = min(np.int32(shape[k]), last)
        ring[k] = here
        shape[k] = profile[here] + rise[here] * (shape[k] - np.float32(here))
    if cut[4] > 0:
        mx, my, dark = np.float32(lens[5]), np.float32(lens[6]), np.float32(cut[5])
        inside, per = np.float32(cut[3] / cut[4] + CUT_EDGE_SIGMAS) * _PER_SIGMA, np.float32(_PER_SIGMA / cut[4])
        end = np.float32(len(table) - 2)
        for k in range(count):
            ex, ey = pixels[0, k] - mx, pixels[1, k] - my
            far[k] = min(max(np.float32(inside) - np.sqrt(ex * ex + ey * ey) * per, none), end)
        for k in range(count):
            here = np.int32(far[k])
            far[k] = table[here] + (table[here + 1] - table[here]) * (far[k] - np.float32(here))
        for k in range(count):
            shape[k] = dark + (shape[k] - dark) * far[k]
    for k in range(count):
        x, y = pixels[0, k], pixels[1, k]
        shape[k] *= one + x * (p + uu * x + uv * y) + y * (q + vv * y)
