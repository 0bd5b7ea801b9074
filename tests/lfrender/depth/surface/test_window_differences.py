"""Differences of 3 x 3 windows between two microimages, compared with the same written out pixel by pixel."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.ndimage import map_coordinates, uniform_filter

from lfrender.depth.refinement.pair_pixels import flat_pixels
from lfrender.depth.surface.window_differences import copy_windows, count_views, new_windows, set_limits

IMAGE = np.random.default_rng(5).random((50, 60)).astype(np.float32)
RADIUS, PITCH, SIZE = np.float32(7.5), np.float32(18.0), np.float32(5.3)
A, B = np.float32([20.2, 24.7]), np.float32([37.9, 26.1])


@njit
def differences(image, centres, radius, s, pitch, windows, floor):
    flat = flat_pixels(image)
    copy_windows(flat, centres[0, 0], centres[0, 1], windows)
    set_limits(windows, 1, 1, floor)
    count_views(flat, windows, centres, 0, radius, s, pitch, np.array([[1], [0]]), 1, 1)


def test_window_differences_are_sums_of_squared_differences_over_3_x_3_pixels():
    windows = new_windows(RADIUS)
    differences(IMAGE, np.stack([A, B]), RADIUS, SIZE, PITCH, windows, np.float32(0.1))
    found, limits, showing, confirming = (
        values[: (windows.stride - 2) * windows.stride].reshape(-1, windows.stride)
        for values in (windows.differences, windows.limits, windows.showing, windows.confirming)
    )
    np.testing.assert_array_equal(showing, np.isfinite(found))
    np.testing.assert_array_equal(confirming, found <= limits)
    left, top = windows.corner
    y, x = np.mgrid[top + 1 : top + windows.stride - 1, left : left + windows.stride]
    step = (B - A).astype(float) * (1 + float(SIZE) / float(PITCH))
    v, u = np.mgrid[: IMAGE.shape[0], : IMAGE.shape[1]]
    moved = map_coordinates(IMAGE.astype(float), [v + step[1], u + step[0]], order=1, mode="nearest")
    expected = 9 * uniform_filter((IMAGE - moved) ** 2, 3)[y, x]
    # Beyond the first microimage windows are cut by the copy.
    shown = np.isfinite(found) & (np.hypot(x - A[0], y - A[1]) <= RADIUS)
    assert 50 < shown.sum() < np.pi * RADIUS**2
    np.testing.assert_allclose(found[shown], expected[shown], rtol=2e-4)
    away = np.hypot(x - (B[0] - step[0]), y - (B[1] - step[1]))
    assert not shown[away > RADIUS + 0.01].any()


def test_limits_are_the_variance_of_the_3_x_3_pixels_and_a_floor():
    windows = new_windows(RADIUS)
    differences(IMAGE, np.stack([A, B]), RADIUS, SIZE, PITCH, windows, np.float32(0.1))
    left, top = windows.corner
    found = windows.limits[(30 - top - 1) * windows.stride + 20 - left]
    assert np.isclose(found, 9 * (IMAGE[29:32, 19:22].var() + 0.1), rtol=1e-4)
