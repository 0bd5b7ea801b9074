"""Differences of 3 x 3 windows between two microimages, compared with the same written out pixel by pixel."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.ndimage import map_coordinates, uniform_filter

from lfrender.depth.refinement.pair_pixels import flat_pixels
from lfrender.depth.surface.window_differences import copy_windows, new_windows, window_differences, window_variance

IMAGE = np.random.default_rng(5).random((50, 60)).astype(np.float32)
RADIUS, PITCH, SIZE = np.float32(7.5), np.float32(18.0), np.float32(5.3)
A, B = np.float32([20.2, 24.7]), np.float32([37.9, 26.1])


@njit
def differences(image, a, b, radius, s, pitch, windows, out):
    flat = flat_pixels(image)
    copy_windows(flat, a[0], a[1], windows)
    window_differences(flat, windows, a[0], a[1], b[0], b[1], radius, s, pitch, 1, 1, out, 0)


def test_window_differences_are_sums_of_squared_differences_over_3_x_3_pixels():
    windows = new_windows(RADIUS)
    out = np.empty(windows.stride**2, np.float32)
    differences(IMAGE, A, B, RADIUS, SIZE, PITCH, windows, out)
    found = out[: (windows.stride - 2) * windows.stride].reshape(-1, windows.stride)
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


def test_window_variance_is_that_of_the_3_x_3_pixels():
    assert np.isclose(window_variance(IMAGE, 12, 30), IMAGE[29:32, 11:14].var(), rtol=1e-4)
