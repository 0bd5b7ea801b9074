"""Mismatch that noise and blur explain, against its definition."""

from __future__ import annotations

import numpy as np

from lfrender.depth.edges.comparison import allow_mismatch

STRIDE = 16


def allowed(light, noise2=0.01, pitch=30.0):
    out = np.zeros(light.size, np.float32)
    allow_mismatch(light.ravel(), STRIDE, light.size, np.float32(noise2), pitch, out)
    return out.reshape(light.shape)


def test_a_pixel_may_differ_by_the_scatter_of_the_five_about_it_and_noise():
    light = np.random.default_rng(0).random((12, STRIDE), np.float32)
    found = allowed(light)
    for row in range(1, 11):
        for column in range(1, STRIDE - 1):
            five = [
                light[row + v, column + u] for v, u in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
            ]
            expected = 0.01 + 0.4 * 5 * np.var(five)
            np.testing.assert_allclose(found[row, column], expected, rtol=1e-4)


def test_half_a_turn_turns_what_is_allowed():
    light = np.random.default_rng(1).random((12, STRIDE), np.float32)
    inner = (slice(2, -2), slice(2, -2))
    first = allowed(light)[inner]
    second = allowed(np.ascontiguousarray(light[::-1, ::-1]))[::-1, ::-1][inner]
    np.testing.assert_allclose(second, first, rtol=1e-5)


def test_even_light_allows_noise_only():
    np.testing.assert_allclose(
        allowed(np.full((8, STRIDE), 0.3, np.float32))[1:-1], 0.01, rtol=1e-5
    )


def test_microimages_of_half_the_pitch_are_allowed_half_of_the_scatter():
    light = np.random.default_rng(2).random((12, STRIDE), np.float32)
    inner = (slice(1, -1), slice(1, -1))
    whole = allowed(light, pitch=25.0)[inner]
    half = allowed(light, pitch=12.5)[inner]
    np.testing.assert_allclose(half - 0.01, 0.5 * (whole - 0.01), rtol=1e-3)
    np.testing.assert_array_equal(allowed(light, pitch=70.0)[inner], whole)
