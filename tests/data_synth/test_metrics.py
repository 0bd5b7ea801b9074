"""Figures of quality: known answers, and invariance to what they must not depend on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_synth.metrics import (
    centre_error,
    compare_pictures,
    magnification_error,
    mode_accuracy,
    resample,
)
from lfcal import Lattice

IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


@pytest.fixture
def picture():
    return np.random.default_rng(3).integers(20, 200, (40, 50, 3)).astype(np.uint8)


def lattice(origin=(100.0, 80.0), pitch=20.0):
    return Lattice(origin, [[pitch, 0], [pitch / 2, pitch * 0.75**0.5]], (400, 300), 9.0)


def test_equal_pictures_are_perfect(picture):
    quality = compare_pictures(picture, picture)
    assert quality.psnr == np.inf
    assert quality.ssim == pytest.approx(1)
    assert quality.pixels == 40 * 50


def test_psnr_of_known_noise(picture):
    truth = picture / 255.0
    sign = np.where(np.indices(truth.shape).sum(0) % 2, 1, -1)
    assert compare_pictures(truth + 0.01 * sign, truth).psnr == pytest.approx(40, abs=0.05)


def test_gain_per_channel_is_free_and_reported(picture):
    quality = compare_pictures(picture / 255.0 * [0.5, 1.0, 2.0], picture)
    assert quality.psnr > 100
    np.testing.assert_allclose(quality.gain, [2.0, 1.0, 0.5])


def test_pixel_types_are_compared_by_their_peak(picture):
    assert compare_pictures(picture.astype(np.uint16) * np.uint16(257), picture).psnr > 100


def test_only_chosen_pixels_count(picture):
    where = np.zeros(picture.shape[:2], bool)
    where[:, :30] = True
    spoiled = picture.copy()
    spoiled[:, 30:] = 255
    quality = compare_pictures(spoiled, picture, where)
    assert quality.psnr == np.inf
    assert quality.ssim == pytest.approx(1)
    assert compare_pictures(spoiled, picture).psnr < 20


def test_black_picture_has_a_finite_psnr(picture):
    assert np.isfinite(compare_pictures(np.zeros_like(picture), picture).psnr)


def test_nothing_to_compare_is_an_error(picture):
    with pytest.raises(ValueError, match="at least one pixel"):
        compare_pictures(picture, picture, np.zeros((40, 50), bool))
    with pytest.raises(ValueError, match="one shape"):
        compare_pictures(picture, picture[1:])


def test_resampling_onto_the_same_grid_changes_nothing(picture):
    same, inside = resample(picture, IDENTITY, (40, 50), IDENTITY)
    np.testing.assert_allclose(same, picture / 255.0, atol=1e-12)
    assert inside.all()


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_coarser_grid_gets_the_mean_of_its_footprint(picture, factor):
    # Pixel (u, v) of the coarse grid covers factor x factor reference pixels exactly.
    affine = [[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2]]
    h = 40 // factor
    w = 50 // factor
    coarse, inside = resample(picture, IDENTITY, (h, w), affine)
    blocks = picture[: h * factor, : w * factor].reshape(h, factor, w, factor, 3).mean((1, 3)) / 255
    assert inside.all()
    np.testing.assert_allclose(coarse, blocks, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    scale=st.floats(0.4, 4),
    dx=st.floats(-5, 5),
    dy=st.floats(-5, 5),
    ref_scale=st.floats(0.5, 2),
    off=st.floats(-9, 9),
)
def test_a_ramp_in_scene_coordinates_stays_that_ramp(scale, dx, dy, ref_scale, off):
    reference_affine = np.array([[ref_scale, 0, off], [0, ref_scale, -off]])
    v, u = np.mgrid[:60, :80]
    ramp = 0.01 * (ref_scale * u + off) + 0.003 * (ref_scale * v - off)
    affine = np.array([[scale, 0, 10 + dx], [0, scale, 5 + dy]])
    out, inside = resample(ramp, reference_affine, (12, 15), affine)
    y, x = np.mgrid[:12, :15]
    expected = 0.01 * (scale * x + 10 + dx) + 0.003 * (scale * y + 5 + dy)
    # In the outer half of a border pixel there is nothing to interpolate with.
    np.testing.assert_allclose(out[inside], expected[inside], atol=0.5 * 0.013 * ref_scale)
    i = (scale * x + 10 + dx - off) / ref_scale
    j = (scale * y + 5 + dy + off) / ref_scale
    margin = 1 + scale / ref_scale / 2
    deep = (i > margin) & (j > margin) & (i < 79 - margin) & (j < 59 - margin)
    assert inside[deep].all()
    np.testing.assert_allclose(out[deep], expected[deep], atol=1e-9)
    assert not out[~inside].any()


def test_outside_of_the_reference_is_marked(picture):
    out, inside = resample(picture, IDENTITY, (40, 50), [[1, 0, -10.0], [0, 1, 0]])
    assert not inside[:, :10].any()
    assert inside[:, 10:].all()
    assert not out[:, :10].any()
    np.testing.assert_allclose(out[:, 10:], picture[:, :40] / 255.0)


def test_centre_error_of_a_shifted_lattice_is_the_shift():
    assert centre_error(lattice(), lattice()) == pytest.approx(0, abs=1e-9)
    assert centre_error(lattice((100.3, 80.4)), lattice()) == pytest.approx(0.5, abs=0.03)


def test_centre_error_ignores_which_centre_is_called_the_origin():
    assert centre_error(lattice((120.0, 80.0)), lattice()) == pytest.approx(0, abs=1e-9)


def test_mode_accuracy_and_magnification_error():
    where = np.array([True, True, True, True, False])
    assert mode_accuracy([1, -1, 0, 1, 1], [1, -1, 1, 1, -1], where) == 0.75
    assert np.isnan(mode_accuracy([1], [1], np.array([False])))
    truth = np.array([4.0, -5.0, 8.0, 2.0, 1.0])
    assert magnification_error(truth / 1.1, truth, where) == pytest.approx(0.1)
    assert magnification_error(np.full(5, np.nan), truth, where) == 1
    assert magnification_error(-truth, truth, where) == 0
