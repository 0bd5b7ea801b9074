"""Microimages cut out into strips, and masks of the pixels that two of them share."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.flat.gray_flat import GrayFlat
from lfrender.flat.microimages import (
    VECTOR_LENGTH,
    allocate_strips,
    extract_strips,
    make_shift_masks,
)

# Four microimages; the last one is cut by the border of the flat.
CENTRES = np.array([[20.3, 19.8], [44.1, 20.4], [20.6, 43.7], [66.0, 44.0]], np.float32)
RADIUS = 9.4
WANTED = np.array([[0, 0], [5, -3], [-16, 4], [40, 0]])


def flat():
    image = np.random.default_rng(4).random((64, 72), np.float32)
    return GrayFlat(image, CENTRES, RADIUS, 23.8)


def cut(step, lenses=(True, True, True, True)):
    gray = flat()
    means = np.linspace(0.2, 0.5, 4).astype(np.float32)
    strips = allocate_strips(gray, means, step)
    extract_strips(strips, gray, np.array(lenses))
    return gray, strips


def rows_of_strip(strips, lens):
    """(height, width) microimage of a lens, put together from the parts of its strip."""
    size = strips.rows * strips.step * strips.width
    parts = strips.values[lens * size : (lens + 1) * size]
    parts = parts.reshape(strips.step, strips.rows, strips.width)
    return parts.transpose(1, 0, 2).reshape(-1, strips.width)[: strips.width]


@pytest.mark.parametrize("step", [1, 2, 3])
def test_a_strip_holds_the_microimage_less_its_mean(step):
    gray, strips = cut(step)
    np.testing.assert_array_equal(strips.whole, [True, True, True, False])
    for lens in range(3):
        x, y = strips.middle[lens]
        half = strips.half
        wanted = gray.image[y - half : y + half + 1, x - half : x + half + 1] - strips.means[lens]
        np.testing.assert_array_equal(rows_of_strip(strips, lens), wanted)


def test_only_wanted_microimages_are_cut_out_and_each_once():
    gray, strips = cut(1, (True, False, False, False))
    assert not rows_of_strip(strips, 1).any()
    gray.image[:] = 0
    extract_strips(strips, gray, np.array([True, True, False, False]))
    assert len(np.unique(rows_of_strip(strips, 0))) > 100
    np.testing.assert_array_equal(np.unique(rows_of_strip(strips, 1)), -strips.means[1])
    np.testing.assert_array_equal(strips.extracted, [True, True, False, False])


@pytest.mark.parametrize("step", [1, 2])
def test_a_mask_marks_the_pixels_of_two_discs_this_far_apart(step):
    _, strips = cut(step)
    slots, masks, ends, counts = make_shift_masks(strips, RADIUS, WANTED)
    reach = len(slots) // 2
    assert (slots >= 0).sum() == len(WANTED)
    y, x = np.mgrid[0 : strips.rows * step : step, : strips.width] - strips.half
    inner2 = (RADIUS - 0.25) ** 2
    for dx, dy in WANTED:
        slot = slots[dy + reach, dx + reach]
        inside = (x**2 + y**2 <= inner2) & ((x + dx + 0.5) ** 2 + (y + dy + 0.5) ** 2 <= inner2)
        np.testing.assert_array_equal(masks[slot, : inside.size], inside.ravel())
        assert counts[slot] == inside.sum() == masks[slot].sum()
        start, number = ends[slot, :2]
        assert number % VECTOR_LENGTH == 0
        assert masks[slot, start : start + number].sum() == counts[slot]
    # Nothing is shared by microimages two diameters apart.
    assert counts[slots[reach, 40 + reach]] == 0 == ends[slots[reach, 40 + reach], 1]


def test_the_partner_of_a_pixel_is_as_far_along_the_strip_as_the_shift():
    gray, strips = cut(2)
    slots, masks, ends, _ = make_shift_masks(strips, RADIUS, WANTED)
    reach = len(slots) // 2
    size = strips.rows * strips.step * strips.width
    for dx, dy in [(5, -3), (-16, 4)]:
        slot = slots[dy + reach, dx + reach]
        at = np.flatnonzero(masks[slot])
        line, column = np.divmod(at, strips.width)
        x = strips.middle[0, 0] + dx + column - strips.half
        y = strips.middle[0, 1] + dy + line * strips.step - strips.half
        values = strips.values[:size]
        for distance, below in zip(ends[slot, 2:], (0, 1), strict=True):
            partner = gray.image[y + below, x] - strips.means[0]
            np.testing.assert_array_equal(values[at + distance], partner)
