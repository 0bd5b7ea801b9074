"""Relative light at many places of one lens: `kernel.relative_light` as long loops over single-precision arrays.

Loops that only read and write in order become vector instructions; table look-ups have loops of their own.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..runtime.fastmath import FAST
from .kernel import RIM_START, ROOT_HALF
from .settings import KERNEL

__all__ = [
    "make_edge_table", "make_profile_tables", "relative_light_at", "relative_light_general", "relative_light_round",
]  # fmt: skip


@cache
def make_edge_table() -> NDArray[np.float32]:
    """Light through the edge of a cutting disc, from `edge` standard deviations outside to as many inside."""
    places = np.arange(2 * round(KERNEL.edge) * KERNEL.edge_steps + 2) / KERNEL.edge_steps - KERNEL.edge
    table = np.array([0.5 * (1 + math.erf(place * ROOT_HALF)) for place in places], np.float32)
    table[0], table[-2], table[-1] = 0.0, 1.0, 1.0
    return table


def make_profile_tables(
    profile: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Samples of the profile (k,), or profiles (t, k), differences, and `make_edge_table`, for `relative_light_at`."""
    return profile[..., :-1].astype(np.float32), np.diff(profile).astype(np.float32), make_edge_table()


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def relative_light_round(pixels, count, lens, profile, rise, scale, light, ring):
    """Relative light of a round uncut lens at `count` places (2, k) float32, and the `ring` of the profile there.

    `profile` and the `rise` from ring to ring are float32, `scale` is in rings per px.
    """
    one, most, last = np.float32(1), np.float32(len(rise)), np.int32(len(rise) - 1)
    p, q = np.float32(lens[0]), np.float32(lens[1])
    uu, uv, vv = np.float32(lens[2]), np.float32(lens[3]), np.float32(lens[4])
    for k in range(count):
        light[k] = min(np.sqrt(pixels[0, k] * pixels[0, k] + pixels[1, k] * pixels[1, k]) * scale, most)
    for k in range(count):
        here = min(np.int32(light[k]), last)
        ring[k] = here
        light[k] = profile[here] + rise[here] * (light[k] - np.float32(here))
    for k in range(count):
        x, y = pixels[0, k], pixels[1, k]
        light[k] *= one + x * (p + uu * x + uv * y) + y * (q + vv * y)


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def relative_light_general(pixels, count, lens, profile, rise, step, cut, table, work, light, ring):
    """`relative_light_round` of a lens that is cut (`table`: `make_edge_table`) or whose rim varies with the direction.

    `work` (5, k) float32 is working memory.
    """
    one, none, tiny = np.float32(1), np.float32(0), np.float32(1e-6)
    most, last = np.float32(len(rise)), np.int32(len(rise) - 1)
    scale, harmonics = np.float32(1 / step), (len(lens) - RIM_START) // 2
    p, q = np.float32(lens[0]), np.float32(lens[1])
    uu, uv, vv = np.float32(lens[2]), np.float32(lens[3]), np.float32(lens[4])
    even = one - np.float32(lens[RIM_START])
    far, cos, sin, cosine, sine = work[0], work[1], work[2], work[3], work[4]
    for k in range(count):
        far[k] = np.sqrt(pixels[0, k] * pixels[0, k] + pixels[1, k] * pixels[1, k])
        light[k] = even
    if harmonics > 0:
        for k in range(count):
            over = one / max(far[k], tiny)
            cos[k], sin[k] = pixels[0, k] * over, pixels[1, k] * over
            cosine[k], sine[k] = cos[k], sin[k]
    for m in range(harmonics):
        a, b = np.float32(lens[RIM_START + 1 + 2 * m]), np.float32(lens[RIM_START + 2 + 2 * m])
        for k in range(count):
            light[k] -= a * cosine[k] + b * sine[k]
        if m + 1 < harmonics:
            for k in range(count):
                turned = cosine[k] * cos[k] - sine[k] * sin[k]
                sine[k] = sine[k] * cos[k] + cosine[k] * sin[k]
                cosine[k] = turned
    for k in range(count):
        light[k] = min(max(far[k] * light[k], none) * scale, most)
    for k in range(count):
        here = min(np.int32(light[k]), last)
        ring[k] = here
        light[k] = profile[here] + rise[here] * (light[k] - np.float32(here))
    if cut[4] > 0:
        mx, my, stray = np.float32(lens[5]), np.float32(lens[6]), np.float32(cut[5])
        steps = KERNEL.edge_steps
        inside, per = np.float32(cut[3] / cut[4] + KERNEL.edge) * steps, np.float32(steps / cut[4])
        end = np.float32(len(table) - 2)
        for k in range(count):
            ex, ey = pixels[0, k] - mx, pixels[1, k] - my
            far[k] = min(max(np.float32(inside) - np.sqrt(ex * ex + ey * ey) * per, none), end)
        for k in range(count):
            here = np.int32(far[k])
            far[k] = table[here] + (table[here + 1] - table[here]) * (far[k] - np.float32(here))
        for k in range(count):
            light[k] = stray + (light[k] - stray) * far[k]
    for k in range(count):
        x, y = pixels[0, k], pixels[1, k]
        light[k] *= one + x * (p + uu * x + uv * y) + y * (q + vv * y)


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def relative_light_at(pixels, count, lens, shape, tables, work, light, ring):
    """`relative_light_round` for most lenses, `relative_light_general` for the others; `tables`: `make_profile_tables`.

    The rims of most cameras neither vary with the direction nor are cut.
    """
    profile, rise, edge = tables
    if shape.rim.shape[0] == 1 and not shape.cut[4] > 0:
        scale = np.float32((1 - lens[RIM_START]) / shape.step)
        relative_light_round(pixels, count, lens, profile, rise, scale, light, ring)
    else:
        relative_light_general(pixels, count, lens, profile, rise, shape.step, shape.cut, edge, work, light, ring)
