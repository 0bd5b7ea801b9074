"""Discs are possible between the smallest and the expected one; output pixels are averaged over
what is left of their area.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data_synth import Camera
from lfcal import LensBlur, LensTypes
from lfrender.detail.blur import (
    averaged_squares,
    choose_blur,
    possible_discs,
    shows_both_modes,
    squares_to_average,
)

RATIOS = np.array([-0.4, -0.2])
BLUR = LensBlur(8.0, 1.0, [0.0], [0.1], [-0.2, -0.4], [[1.0, 3.0]], [[0.5, 0.5]])


def camera(types=None):
    return replace(Camera.design(size=(480, 400), pitch=30.0).calibration(), lens_types=types)


def test_a_measured_disc_is_at_least_what_its_error_leaves():
    smallest, expected = possible_discs(BLUR, RATIOS)
    np.testing.assert_allclose(smallest, [[2.5, 0.5]])
    np.testing.assert_allclose(expected, [[3.0, 1.0]])
    assert not possible_discs(None, RATIOS).any()


def test_a_blur_of_rims_alone_or_of_another_number_of_types_is_not_taken():
    class Depth:
        lens_blur = BLUR

    assert choose_blur(camera(), Depth) is BLUR
    rims = LensBlur(9.0, 30.0, [-0.1], [0.1], [0.0], [[0.9]], [[0.2]])
    Depth.lens_blur = rims
    assert choose_blur(camera(), Depth) is None
    Depth.lens_blur = BLUR
    i, j = np.mgrid[:3, :3]
    assert choose_blur(camera(LensTypes((i - j) % 3)), Depth) is None


def test_an_output_pixel_is_averaged_over_its_own_area_less_what_the_lens_averaged():
    sharp = LensBlur(9.0, 0.1, [-0.3], [0.01], [-0.3], [[0.0]], [[0.05]])
    blurred = LensBlur(9.0, 0.1, [0.04], [0.01], [-0.3], [[4.0]], [[0.05]])
    # At s = -9 px, four pixels of the flat lie along a pixel of 2.25 per pitch.
    ratio = np.array([-0.3])
    whole, less = (
        float(squares_to_average(camera(), blur, ratio, 2.25)[0]) for blur in (sharp, blurred)
    )
    assert whole == pytest.approx(4**2 - 1, abs=0.4)
    # A disc of 4 px counts as a square of 11.2 px^2.
    assert 4.0 < less < 5.5


def test_what_is_averaged_changes_steadily_with_the_scale():
    scales = np.geomspace(2, 9, 200)
    left = [
        float(squares_to_average(camera(), None, np.array([-0.3]), scale)[0]) for scale in scales
    ]
    assert np.abs(np.diff(left)).max() < 0.6
    assert left[-1] == 0


def test_rims_tell_the_side_of_the_focus_only_of_scenes_on_one_side():
    rims = LensBlur(9.0, 30.0, [0.1], [0.1], [0.0], [[3.0]], [[0.2]])
    known = replace(camera(), lens_blur=rims)
    # At 0.5 D, a usual aperture of 0.2 D leaves no disc on the side of the focus, and 6 px on the
    # other.
    ratio = np.array([-0.5])
    assert averaged_squares(known, None, ratio)[0] < 0.6
    assert averaged_squares(known, None, ratio, both_modes=True)[0] == pytest.approx(12.95, abs=0.1)
    sizes = np.full((10, 10), -9.0, np.float32)
    assert not shows_both_modes(sizes)
    sizes[:5] = 9
    assert shows_both_modes(sizes)
