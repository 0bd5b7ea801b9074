"""Normalised pictures and edge strengths match their definitions, also at borders and with several
threads.
"""

from __future__ import annotations

import numba
import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from lfcal.images.preprocessing import edge_strength, interpolate_linear, normalise_locally


@pytest.mark.parametrize(
    ("shape", "window"),
    [((70, 90), 7.9), ((300, 41), 18.6), ((41, 300), 200.0), ((9, 12), 60.0), ((2, 3), 3.0)],
)
def test_pictures_are_normalised_by_mean_and_standard_deviation_about_each_pixel(shape, window):
    picture = np.random.default_rng(2).gamma(4, 0.25, shape).astype(np.float32)
    side = max(3, int(window) | 1)
    exact = picture.astype(float)
    # That mode is SciPy's name for mirrored ends that are not repeated.
    mean, square = (uniform_filter(values, side, mode="mirror") for values in (exact, exact**2))
    expected = (exact - mean) / (np.sqrt(np.maximum(square - mean**2, 0)) + 0.02)
    levelled = normalise_locally(picture, window)
    np.testing.assert_allclose(levelled, np.clip(expected, -3, 3), atol=2e-5)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        np.testing.assert_array_equal(normalise_locally(picture, window), levelled)
    finally:
        numba.set_num_threads(threads)


def test_edge_strength_is_the_same_bits_wherever_a_picture_lies_in_memory():
    picture = np.random.default_rng(0).random((512, 509), dtype=np.float32) ** 4
    seen = set()
    for offset in range(17):
        copy = np.empty(picture.size + 17, np.float32)[offset : offset + picture.size].reshape(
            picture.shape
        )
        copy[:] = picture
        seen.add(edge_strength(copy).tobytes())
    assert len(seen) == 1


def test_edge_strength_is_the_square_root_of_the_sobel_gradient():
    y, x = np.mgrid[:9, :12].astype(np.float32)
    steep = edge_strength(np.ascontiguousarray(0.3 * x + 0.4 * y))
    # A slope of 0.5 per pixel, weighted 8 times; at the border the picture is mirrored.
    assert np.allclose(steep[1:-1, 1:-1], 2.0, atol=1e-5)
    assert np.allclose(steep[0, 1:-1] ** 2, 2.4, atol=1e-5)
    assert np.allclose(steep[1:-1, 0] ** 2, 3.2, atol=1e-5)
    assert np.allclose(steep[[0, 0, -1, -1], [0, -1, 0, -1]], 0, atol=1e-5)


def test_places_outside_are_those_on_the_border_and_nan_is_on_the_picture():
    picture = np.arange(12, dtype=np.float32).reshape(3, 4)
    places = np.array([[0.5, 0.5], [-3.0, 1.0], [1e300, -np.inf], [2.5, np.nan], [np.nan, 9.0]])
    assert interpolate_linear(picture, places) == pytest.approx([2.5, 4.0, 3.0, 2.5, 8.0])
