"""Remove the shading that nearby microimages have in common, found as their weighted average.

Residual vignetting, or vignetting correction of a flat whose black level was not subtracted, makes
neighbouring microimages alike without any shift, so that smooth lenses match at patch size 0. The
scene moves from lens to lens and averages out. The average is removed as far as it exceeds that of
unrelated pictures (shrinkage after James and Stein 1961) and is no stronger than shading can be: a
scene without disparity stays.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import FAST, kernel, square

from .gray_flat import GrayFlat
from .lens_graph import count_neighbours
from .microimages import Strips, extract_strips, row_of_disc
from .neighbours import neighbours_of

__all__ = ["LARGEST_SHADING", "remove_shading"]

#: [white] contrast of shading; a stronger common pattern is more likely the scene's.
LARGEST_SHADING = 0.02


@kernel(error_model="numpy", fastmath=FAST, share=lambda centres, *_: len(centres))
def _subtract_shading(begin, end, centres, wanted, near, weights, contrast, radius, strips, out):
    """Subtract the common pattern from the `wanted` lenses in the image `out`; `near` (n, k) are
    rows of the lenses that share theirs.

    `strips` are read in one part. They are laid over each other by whole pixels: shading is smooth.
    """
    height, across = out.shape
    values = strips.values
    middle = strips.middle
    whole = strips.whole
    half = strips.half
    pixels = out.reshape(-1)
    width = strips.width
    size = np.uint64(width * width)
    shade = np.empty(size, np.float32)
    for lens in range(begin, end):
        if not wanted[lens]:
            continue
        shade[:] = 0
        total = expected = np.float32(0)
        for r in range(near.shape[1]):
            other = near[lens, r]
            # Lenses cut by the border of the flat hold only part of the microimage.
            if other >= 0 and whole[other]:
                weight = weights[other]
                at = np.uint64(other) * size
                total += weight
                expected += square(weight * contrast[other])
                for k in range(size):
                    shade[k] += weight * values[at + k]
        if total == 0:
            continue
        left = middle[lens, 0] - half
        top = middle[lens, 1] - half
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        low_x = max(left, 0)
        high_x = min(left + width, across) - 1
        low_y = max(top, 0, int(np.ceil(cy - radius)))
        end_y = min(top + width, height, int(np.floor(cy + radius)) + 1)
        energy = np.float32(0)
        count = 0
        for y in range(low_y, end_y):
            first, number = row_of_disc(np.float32(y) - cy, cx, radius, low_x, high_x)
            at = np.uint64((y - top) * width + first - left)
            for k in range(np.uint64(number)):
                energy += shade[at + k] * shade[at + k]
            count += number
        energy = energy / (max(count, 1) * total * total) + np.float32(1e-9)
        # An average must have twice the energy of one of unrelated pictures to be common.
        share = max(np.float32(0), 1 - np.float32(2) * expected / (total * total * energy))
        largest2 = np.float32(LARGEST_SHADING * LARGEST_SHADING)
        share *= largest2 / (largest2 + energy) / total
        if share == 0:
            continue
        for y in range(low_y, end_y):
            first, number = row_of_disc(np.float32(y) - cy, cx, radius, low_x, high_x)
            at = np.uint64((y - top) * width + first - left)
            place = np.uint64(y * across + first)
            for k in range(np.uint64(number)):
                pixels[place + k] -= share * shade[at + k]


def _steps_to_same_type(lattice: Lattice) -> NDArray[np.int64]:
    """(k, 2) index steps to the lenses within 4.2 pitches that have the same type."""
    span = np.arange(-6, 7)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    distance = np.linalg.norm(steps @ lattice.basis, axis=1)
    # Three interleaved lens types lie at (i - j) mod 3; on other arrays this is any third of the
    # lenses.
    return steps[
        (distance > 0) & (distance < 4.2 * lattice.pitch) & ((steps[:, 0] - steps[:, 1]) % 3 == 0)
    ]


def remove_shading(
    gray: GrayFlat,
    lattice: Lattice,
    strips: Strips,
    contrast: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    others: GrayFlat | None = None,
) -> GrayFlat:
    """`gray` without the pattern that the lenses of its type around each `wanted` lens (n,) have in
    common.

    `strips` are the microimages of `gray` in one part, those that are needed are cut out; `contrast`
    (n,) is that of each. `others` is `gray` without the shading of other lenses: it is changed and
    returned.
    """
    if others is not None and not wanted.any():
        return others
    # Lenses of less contrast than one per cent of white have equal weight.
    weights = (0.01**2 / (0.01**2 + contrast**2)).astype(np.float32)
    near = neighbours_of(lattice).rows(_steps_to_same_type(lattice))
    # The lenses to be read; for every step there is the opposite one.
    extract_strips(strips, gray, count_neighbours(wanted, near) > 0)
    out = gray.image.copy() if others is None else others.image
    _subtract_shading(
        gray.centres, wanted, near, weights, contrast, np.float32(gray.radius), strips, out
    )
    return dataclasses.replace(gray, image=out)
