"""Gain, flattening and storage of gain maps of white images of known light; fits of the light."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
from lfcal import Lattice
from lfcal.cli.main import main
from lfcal.gain.gain_map import GainMap, fit_light, fit_light_slope
from lfcal.gain.rows import RegionGain


def inside_discs(truth, camera, margin):
    """Pixels of whole uncut discs, at least `margin` px off the rim."""
    y, x = np.mgrid[: truth.size[1], : truth.size[0]]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    far = np.hypot(*(points - truth.centres(truth.index_of(points))).T)
    return (far < truth.fill * truth.pitch / 2 - margin).reshape(x.shape) & np.isfinite(
        camera.gain()
    )


def test_flattened_white_image_is_even_and_keeps_its_type(drawn, calibrated_white):
    truth, camera = calibrated_white
    inside = inside_discs(truth, camera, 1.5)
    clean = np.rint(40000 * truth.light()).astype(np.uint16)
    even = camera.flatten(clean)
    assert even.dtype == np.uint16 and even.shape == clean.shape
    assert (
        even[inside].std() / even[inside].mean()
        < 0.005
        < 0.05
        < clean[inside].std() / clean[inside].mean()
    )
    unknown = np.isnan(camera.gain())
    np.testing.assert_array_equal(even[unknown], clean[unknown])
    colour = camera.flatten(np.repeat(clean[..., None], 3, axis=2).astype(np.float32))
    np.testing.assert_allclose(colour[inside, 2], even[inside], atol=0.51)
    with pytest.raises(lfcal.FlatError, match="800 x 600"):
        camera.flatten(clean[1:])


def test_integers_are_clipped_at_the_top(calibrated_white):
    truth, camera = calibrated_white
    even = camera.flatten(np.full((truth.size[1], truth.size[0]), 255, np.uint8))
    assert even[np.isfinite(camera.gain())].min() >= 254


def test_gain_map_and_defects_are_saved_and_loaded(calibrated_white, tmp_path):
    _, camera = calibrated_white
    camera.save(tmp_path / "camera.json")
    back = lfcal.load(tmp_path / "camera.json")
    np.testing.assert_array_equal(back.defects.pixels, camera.defects.pixels)
    np.testing.assert_allclose(back.gain(), camera.gain(), rtol=2e-3)
    assert (tmp_path / "camera.json").stat().st_size < 30000
    data = json.loads((tmp_path / "camera.json").read_text())
    data["gain_map"]["profile"] = "x"
    with pytest.raises(lfcal.CameraFileError):
        lfcal.Calibration.from_dict(data)


def test_gain_of_a_camera_without_gain_map_is_an_error():
    camera = lfcal.Calibration(lfcal.Lattice((10, 10), np.eye(2) * 20, (100, 80), 9.0))
    with pytest.raises(lfcal.CalibrationError, match="gain map"):
        camera.gain()


def test_command_writes_the_flattened_flat(calibrated_white, tmp_path):

    truth, camera = calibrated_white
    camera.save(tmp_path / "camera.json")
    image = truth.image()
    cv2.imwrite(str(tmp_path / "flat.png"), image)
    arguments = ["flatten", str(tmp_path / "flat.png"), "-c", str(tmp_path / "camera.json")]
    result = CliRunner().invoke(
        main, [*arguments, "-o", str(tmp_path / "even.tif")], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    written = lfcal.read_flat(tmp_path / "even.tif")
    np.testing.assert_array_equal(written, lfcal.load(tmp_path / "camera.json").flatten(image))


def test_lenses_have_the_profile_of_their_type_also_after_saving():
    lattice = Lattice([10, 10], [[20, 0], [0, 20]], (200, 160), 9)
    cell = np.array([[0, 1], [1, 0]], np.int8)
    typed = replace(
        GainMap.round(np.ones(60), 0.25, 9),
        type_light=[np.full(60, 0.9), np.full(60, 1.1)],
        type_cell=cell,
    )
    gain = RegionGain(GainMap.from_dict(typed.to_dict()), lattice).at(0, 0, *lattice.image_size)
    assert (
        np.abs(gain[10, 10] - 0.9) < 1e-6
        and np.abs(gain[10, 30] - 1.1) < 1e-6
        and np.abs(gain[30, 30] - 0.9) < 1e-6
    )


def test_light_of_types_without_their_places_is_refused():
    with pytest.raises(ValueError, match="type_light"):
        replace(GainMap.round(np.ones(60), 0.25, 9), type_light=np.ones((2, 60)))


@pytest.mark.parametrize("radius, share", [(13.0, 0.919), (16.0, 1.0), (9.0, 0.636)])
def test_lit_cell_is_the_largest_square_inside_the_light(radius, share):
    lattice = Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9.5)
    distance = np.arange(80) * 0.25
    gain = GainMap.round(np.clip(radius + 0.5 - distance, 0, 1), 0.25, 9.5)
    assert gain.lit_cell(lattice) == pytest.approx(share, abs=0.02)


_LATTICE = Lattice([10, 10], [[20, 0], [0, 20]], (1000, 800), 9)


def _light(points):
    x, y = _LATTICE.field_place(points).T
    return np.exp(0.3 * x - 0.2 * y - 0.8 * (x * x + y * y) + 0.1 * x * y * y)


def test_slope_is_that_of_the_light_even_if_a_tenth_of_the_lenses_are_dusty():
    centres = _LATTICE.centres()
    light = _light(centres)
    rng = np.random.default_rng(5)
    dusty = rng.random(len(light)) < 0.1
    light[dusty] *= rng.uniform(0.1, 0.9, dusty.sum())
    slope = fit_light_slope(light, _LATTICE.field_place(centres), _LATTICE.reach)
    for axis, step in enumerate(np.eye(2)):
        true = np.log(_light(centres + step) / _light(centres - step)) / 2
        assert np.abs(slope[:, axis] - true).max() < 1e-6


def test_few_lenses_have_no_slope():
    centres = _LATTICE.centres()[:20]
    field = _LATTICE.field_place(centres)
    assert len(fit_light(np.ones(20), field)) == 1
    assert not fit_light_slope(_light(centres), field, _LATTICE.reach).any()


def test_light_of_lenses_in_a_corner_of_the_field_has_factors_that_a_camera_file_can_hold():
    rng = np.random.default_rng(2)
    field = rng.uniform(0.5, 0.6, (600, 2))
    light = np.exp(rng.normal(0, 0.3, 600))
    assert np.abs(fit_light(light, field)[1:]).max(initial=0) <= 10


def test_map_with_impossible_values_is_limited_to_those_that_can_be_read():
    wild = replace(
        GainMap.round(np.full(60, 1e3), 0.25, 9),
        level=[0, 26, 0],
        lens_gain=np.full(len(_LATTICE), 1e4),
        shading=np.full((5, 1), -1e5),
    )
    camera = lfcal.Calibration(_LATTICE, source="white", gain_map=wild)
    with pytest.raises(lfcal.CameraFileError, match="is not between"):
        lfcal.Calibration.from_dict(camera.to_dict())
    readable = replace(camera, gain_map=wild.limited(_LATTICE))
    assert lfcal.Calibration.from_dict(readable.to_dict()).gain_map == readable.gain_map
