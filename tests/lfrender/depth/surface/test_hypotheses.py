"""Mismatch of the views of a scene point, on five lenses drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.depth.surface.hypotheses import view_mismatch

PITCH = 24.0
NEAR_X = np.array([60, 84, 60, 36, 60], np.float32)
NEAR_Y = np.array([60, 60, 84, 60, 36], np.float32)


def cross(s):
    """A flat of the five lenses before waves on a plane."""
    y, x = np.mgrid[:121, :121].astype(float)
    away = (x[..., None] - NEAR_X) ** 2 + (y[..., None] - NEAR_Y) ** 2
    lens = away.argmin(-1)
    u = NEAR_X[lens] - (x - NEAR_X[lens]) * PITCH / s
    v = NEAR_Y[lens] - (y - NEAR_Y[lens]) * PITCH / s
    waves = np.sin(0.23 * u + np.sin(0.09 * v)) + np.sin(0.19 * v - np.sin(0.11 * u))
    return (0.5 + 0.2 * waves).astype(np.float32)


def mismatch(image, x, y, s, count=5, near_x=NEAR_X, near_y=NEAR_Y):
    samples = np.empty((5, 11), np.float32)
    costs = np.empty(5, np.float32)
    numbers = (np.float32(v) for v in (x, y, s / PITCH, 11.0, 1e-4))
    return view_mismatch(image, near_x, near_y, count, *numbers, samples, costs)


@pytest.mark.parametrize("s", [-9.0, 8.0])
def test_views_match_at_the_depth_of_the_scene_and_not_beside_it(s):
    image = cross(s)
    right, views = mismatch(image, 64.3, 57.2, s)
    assert views >= 4
    assert right < 0.1
    assert mismatch(image, 64.3, 57.2, 0.5 * s)[0] > 3 * right
    assert mismatch(image, 64.3, 57.2, -s)[0] > 0.4


def test_a_point_that_one_lens_shows_has_an_unknown_mismatch():
    assert mismatch(cross(8.0), 60.0, 60.0, 8.0, count=1) == (0.5, 1)


@pytest.mark.parametrize(
    ("across", "down"), [(True, False), (False, True), (True, True)], ids=["x", "y", "half a turn"]
)
def test_a_mirrored_or_turned_flat_matches_as_well(across, down):
    image = cross(-9.0)
    turned = np.ascontiguousarray(image[:: -1 if down else 1, :: -1 if across else 1])
    near_x = 120 - NEAR_X if across else NEAR_X
    near_y = 120 - NEAR_Y if down else NEAR_Y
    x = 120 - 64.3 if across else 64.3
    y = 120 - 57.2 if down else 57.2
    for s in (-9.0, -5.0, 6.0):
        first = mismatch(image, 64.3, 57.2, s)
        second = mismatch(turned, x, y, s, near_x=near_x, near_y=near_y)
        assert second[1] == first[1]
        assert second[0] == pytest.approx(first[0], rel=0.02, abs=1e-3)


def test_one_occluded_view_among_five_does_not_count():
    image = cross(8.0)
    # The lens on the right shows something else.
    image[48:73, 73:97] = np.random.default_rng(0).random((25, 24), np.float32)
    assert mismatch(image, 62.0, 59.0, 8.0)[0] < 0.1
