"""Pixels of a pair of microimages: cut out, smoothed and interpolated, on a wave drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from lfrender.depth.refinement.pair_pixels import (
    COLUMN,
    LAPLACIAN,
    LIGHT,
    NO_STEP,
    ROW,
    SHIFTED,
    SLOPE_X,
    SLOPE_Y,
    Pair,
    cut_smoothed,
    first_pixel,
    pixel_raster,
    resample_shifted,
    work_memory,
)

RADIUS = np.float32(6.0)
PITCH = np.float32(20.0)
SIZE = (60, 90)
CENTRE = (30.2, 29.6)
WAVE = (0.31, -0.17)


def wave(x, y):
    return 0.5 + 0.2 * np.sin(WAVE[0] * x + WAVE[1] * y)


@njit
def cut(image, x, y, radius):
    raster = pixel_raster(radius)
    work = work_memory(raster)
    left = first_pixel(x, radius, raster.side, image.shape[1])
    top = first_pixel(y, radius, raster.side, image.shape[0])
    cut_smoothed(image.reshape(-1), image.shape[1], raster, (left, top), True, work)
    return raster, work, (left, top)


@njit
def shifted(image, pair, s, raster, work, corner):
    step = np.full(2, NO_STEP)
    flat = image.reshape(-1)
    return resample_shifted(flat, image.shape, raster, corner, pair, s, work, step)


def flat_of(shift=(0.0, 0.0)):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    return wave(x - shift[0], y - shift[1]).astype(np.float32)


def places(raster, work, corner):
    """Columns and rows of a cutout on the flat, and its used pixels."""
    count = raster.side * raster.stride
    column = work[COLUMN, :count]
    used = column < raster.side
    return column[used] + corner[0], work[ROW, :count][used] + corner[1], np.flatnonzero(used)


def test_a_cutout_has_the_smoothed_light_with_its_slopes_and_laplacian():
    raster, work, corner = cut(flat_of(), *CENTRE, RADIUS)
    x, y, used = places(raster, work, corner)
    phase = WAVE[0] * x + WAVE[1] * y
    smoothing = np.prod([(2 + np.cos(w)) / 3 for w in WAVE])
    np.testing.assert_allclose(work[LIGHT, used], 0.5 + 0.2 * smoothing * np.sin(phase), atol=1e-6)
    for row, w in ((SLOPE_X, WAVE[0]), (SLOPE_Y, WAVE[1])):
        expected = 0.2 * smoothing * np.sin(w) * np.cos(phase)
        np.testing.assert_allclose(work[row, used], expected, atol=1e-6)
    bend = sum(2 * np.cos(w) - 2 for w in WAVE)
    np.testing.assert_allclose(
        work[LAPLACIAN, used], 0.2 * smoothing * bend * np.sin(phase), atol=2e-6
    )


@pytest.mark.parametrize("s", [0.0, 3.0, 4.37, -5.81])
@pytest.mark.parametrize("apart", [(20.0, 0.0), (10.0, 17.3)])
def test_the_second_microimage_at_the_right_shift_is_the_first_one(s, apart):
    raster, work, corner = cut(flat_of(), *CENTRE, RADIUS)
    second = np.add(CENTRE, apart)
    move = (1 + s / float(PITCH)) * np.array(apart)
    pair = Pair(*map(np.float32, (*CENTRE, *second)), RADIUS, PITCH)
    overlap = shifted(flat_of(move), pair, np.float32(s), raster, work, corner)
    at = slice(overlap.start, overlap.start + overlap.places)
    x = work[COLUMN, at]
    y = work[ROW, at]
    both = (x - overlap.ax) ** 2 + (y - overlap.ay) ** 2 <= overlap.radius2
    both &= (x - overlap.qx) ** 2 + (y - overlap.qy) ** 2 <= overlap.radius2
    both &= (x >= overlap.low_x) & (x <= overlap.high_x)
    both &= (y >= overlap.low_y) & (y <= overlap.high_y)
    assert both.sum() > 10
    np.testing.assert_allclose(work[SHIFTED, at][both], work[LIGHT, at][both], atol=2e-3)


def test_lenses_at_the_border_are_cut_out_on_the_flat():
    for centre in (-3.0, 0.4, 58.9, 75.0):
        first = first_pixel(centre, RADIUS, 13, SIZE[0])
        assert first >= 1
        assert first + 13 <= SIZE[0] - 1


def test_microimages_too_far_apart_share_no_places():
    raster, work, corner = cut(flat_of(), *CENTRE, RADIUS)
    pair = Pair(*map(np.float32, (*CENTRE, CENTRE[0], CENTRE[1] + 20)), RADIUS, PITCH)
    assert shifted(flat_of(), pair, np.float32(15), raster, work, corner).places == 0
