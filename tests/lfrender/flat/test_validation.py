"""Flats as kernels read them: dim ones are measured against their own light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal import Calibration, CameraError, FlatError, Lattice
from lfrender import analyze
from lfrender.flat.validation import exposure_rows, match_exposure

_CAMERA = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (300, 240), 9.5))


def _plane():
    """A plane with a patch size of 6 px (docs/geometry.md), bright floats."""
    y, x = np.mgrid[:240, :300]
    u, v = (10 + p // 20 * 20 - (p % 20 - 10) * 20 / 6 for p in (x, y))
    return 0.5 + 0.2 * np.sin(u / 7 + 2 * np.sin(v / 31)) + 0.2 * np.sin(v / 8 + 3 * np.sin(u / 43))


def test_dim_flat_of_16_bits_resolves_what_the_bright_one_does():
    bright = analyze(_plane().astype(np.float32), _CAMERA, "fast")
    dim = analyze(np.rint(_plane() * 65535 / 60).astype(np.uint16), _CAMERA, "fast")
    assert np.isfinite(bright.patch_size).mean() > 0.9
    assert np.isfinite(dim.patch_size).sum() >= 0.95 * np.isfinite(bright.patch_size).sum()
    np.testing.assert_allclose(np.nanmedian(dim.patch_size), 6, atol=0.05)


def test_flat_of_28_levels_resolves_what_its_noise_and_rounding_allow():
    noisy = _plane() + np.random.default_rng(0).normal(0, 0.01, (240, 300))
    few = np.rint(noisy * 28).astype(np.uint16)
    same_noise = noisy + np.random.default_rng(1).uniform(-0.5, 0.5, noisy.shape) / 28
    bound = np.isfinite(
        analyze(same_noise.clip(0, 1).astype(np.float32), _CAMERA, "fast").patch_size
    )
    found = analyze(few, _CAMERA, "fast")
    assert bound.mean() > 0.9
    assert np.isfinite(found.patch_size).sum() >= 0.95 * bound.sum()
    np.testing.assert_allclose(np.nanmedian(found.patch_size), 6, atol=0.05)


def test_rounding_of_few_levels_is_no_texture():
    y, x = np.mgrid[:240, :300]
    slope = np.rint(12 + 4 * (x + y) / 540).astype(np.uint16)
    assert np.isfinite(analyze(slope, _CAMERA, "fast").patch_size).mean() < 0.01


def test_white_level_is_lowered_in_steps_for_dim_flats_alone():
    rows = np.full((4, 300, 3), 30000, np.uint16)
    assert match_exposure(rows, _CAMERA) is _CAMERA
    assert 1.1 * 500 <= match_exposure(rows // 60, _CAMERA).white_level < 1.1 * 500 * 2**0.25
    assert match_exposure(rows // 60, _CAMERA) is match_exposure(rows // 59, _CAMERA)
    assert match_exposure(
        np.full((4, 300), 0.01, np.float32), _CAMERA
    ).white_level == pytest.approx(2**-6.5)
    assert match_exposure(np.full((4, 300), 3, np.uint8), _CAMERA) is _CAMERA
    assert exposure_rows(240).max() < 240


def test_arrays_are_analysed_as_files_are():
    grey = np.rint(_plane() * 40000).astype(np.uint16)
    rgb = np.dstack([grey, grey, grey])
    expected = analyze(rgb, _CAMERA, "fast").patch_size
    alpha = np.random.default_rng(0).integers(0, 65536, grey.shape, np.uint16)
    for flat in (np.dstack([rgb, alpha]), rgb.astype(">u2"), rgb.astype(np.int64)):
        np.testing.assert_array_equal(analyze(flat, _CAMERA, "fast").patch_size, expected)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda flat: np.ma.masked_greater(flat, 0.8), "values are masked"),
        (lambda flat: -flat, "negative values only"),
        (lambda flat: flat * 300, "floats are 1 at white"),
    ],
)
def test_arrays_whose_light_is_unknown_are_refused(change, reason):
    with pytest.raises(FlatError, match=f"flat.*{reason}"):
        analyze(change(_plane()), _CAMERA, "fast")


def _changed(camera, shift, degrees):
    """A camera with its lattice shifted [pitch] and turned about the middle of the flat."""
    lattice = camera.lattice
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    turn = np.array([[cos, sin], [-sin, cos]])
    middle = (np.array(lattice.image_size) - 1) / 2
    origin = middle + (lattice.origin - middle) @ turn + [shift * lattice.pitch, 0]
    return replace(camera, lattice=replace(lattice, origin=origin, basis=lattice.basis @ turn))


@pytest.mark.parametrize(("shift", "degrees"), [(0.5, 0.0), (0.0, 5.0), (0.0, 15.0)])
def test_analysis_with_a_wrong_camera_is_an_error(house, shift, degrees):
    wrong = _changed(house.truth.calibration, shift, degrees)
    with pytest.raises(CameraError, match="check=False"):
        analyze(house.flat, wrong, "fast")
    assert analyze(house.flat, wrong, "fast", check=False).preset == "fast"


@pytest.mark.parametrize("corner", [-0.3, 0.1, 0.3])
def test_analysis_with_a_stretched_camera_warns_with_the_words_of_the_commands(house, corner):
    lattice = house.truth.calibration.lattice
    middle = (np.array(lattice.image_size) - 1) / 2
    scale = 1 + corner * lattice.pitch / float(np.hypot(*middle))
    origin = middle + (lattice.origin - middle) * scale
    stretched = replace(lattice, origin=origin, basis=lattice.basis * scale)
    camera = replace(house.truth.calibration, lattice=stretched)
    with pytest.warns(UserWarning, match="calibrate on") as caught:
        analyze(house.flat, camera, "fast")
    words = lfcal.check_camera(house.flat, camera).apply(camera, "camera.json").warnings[-1]
    assert [str(one.message) for one in caught] == [words]
    assert caught[0].filename == __file__
