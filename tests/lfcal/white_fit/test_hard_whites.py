"""White images that are clipped, gappy, faintly cut or oblong: found as what they are, and placed as well as others."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import lfcal


def _error(camera, truth):
    found = camera.lattice.centres()
    return float(np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()))


@pytest.mark.parametrize("exposure", [1.3, 2.2])
def test_clipped_middles_of_microimages_do_not_move_centres(drawn, exposure):
    truth = drawn("square", 24.3, 31.0, 34.0, size=(700, 500), outer=0.6)
    light = truth.light() + truth.noise * np.random.default_rng(1).standard_normal((500, 700))
    image = np.rint(np.clip(exposure * light, 0, 1) * 255).astype(np.uint8)
    assert (image == 255).mean() > 0.15
    assert _error(lfcal.calibrate(image, "white"), truth) < 0.004


def test_faint_cut_is_seen_through_strong_noise(drawn):
    truth = drawn("hexagonal", 13.8, 10.7, 18.0, 8, 0.14, fill=0.85, soft=1.0, size=(1100, 800))
    assert _error(lfcal.calibrate(truth.image()), truth) < 0.05


def test_cut_by_a_larger_disc_is_seen_in_small_microimages_through_strong_noise(drawn):
    truth = drawn(
        "square", 8.16, 50.0, 18.0, strength=-0.28, ratio=1.18, fill=0.89, inner=0.01, outer=0.5, size=(1600, 1200)
    )
    assert _error(lfcal.calibrate(truth.image()), truth) < 0.02


def test_faint_shading_tells_which_of_two_like_discs_is_the_microimage(drawn):
    truth = drawn(
        "square", 40.0, 3.0, 26.0, strength=0.18, inner=0.06, outer=0.4, fill=0.975, soft=0.3, size=(800, 600)
    )
    # Light of neighbours spills over narrow gaps.
    light = cv2.GaussianBlur(truth.light(), (0, 0), 0.8)
    light += truth.noise * np.random.default_rng(1).standard_normal(light.shape)
    image = np.rint(np.clip(0.8 * light, 0, 1) * 65535).astype(np.uint16)
    assert _error(lfcal.calibrate(image), truth) < 0.02


def test_missing_lenses_do_not_make_a_white_image_a_scene(drawn):
    truth = drawn("hexagonal", 20.3, 17.0, 34.0, gap=0.0, size=(700, 500))
    y, x = np.mgrid[:500, :700].astype(float)
    index = truth.index_of(np.column_stack([x.ravel(), y.ravel()]))
    gone = (index[:, 0] * 7 + index[:, 1] * 3) % 19 == 0
    light = 0.06 + np.where(gone.reshape(500, 700), 0, 0.9 * truth.light())
    light += truth.noise * np.random.default_rng(1).standard_normal(light.shape)
    camera = lfcal.calibrate(np.rint(np.clip(0.8 * light, 0, 1) * 65535).astype(np.uint16))
    assert camera.source == "white"
    assert _error(camera, truth) < 0.003


def test_soft_discs_of_an_oblong_array_are_no_checkerboard(whites):
    basis = whites.turned(np.array([[1.0, 0.0], [0.0, 1.37]]), 13.88, 53.5)
    image, origin = whites.white_image(basis, (600, 500), fill=0.945, soft=4.0, gap=0.093, noise=0.02)
    found = lfcal.calibrate(image)
    assert whites.rms(whites.centre_errors(found.lattice, origin, basis)) < 0.02


def test_values_beyond_single_precision_are_named():
    with pytest.raises(lfcal.FlatError, match="scale them"):
        lfcal.calibrate(np.random.default_rng(0).random((100, 120)) * 1e300)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("pitch", [7.0, 20.0])
def test_meshes_and_waves_end_in_a_camera_or_an_error_of_the_family(pitch):
    x, y = np.meshgrid(np.arange(400), np.arange(300))
    waves = 128 + 50 * (np.sin(2 * np.pi * x / pitch) + np.sin(2 * np.pi * y / pitch))
    mesh = np.where((x % pitch < 3) | (y % pitch < 3), 190, 60)
    for image in (np.rint(waves).astype(np.uint8), mesh.astype(np.uint8)):
        try:
            assert lfcal.calibrate(image).lattice.pitch == pytest.approx(pitch, rel=0.02)
        except lfcal.LightFieldError as error:
            assert "give" in str(error)


def test_a_cut_that_overexposure_hides_is_not_looked_for(drawn):
    truth = drawn(
        "hexagonal", 19.493036445416724, 281.5759199195825, 11.996434898142741, 8, 0.2693987855563333, ratio=1.0,
        hot=26, dust=5, fill=0.7745966692414834, soft=1.2, gap=0.1369774370440833, inner=0.21510253900454906,
        outer=0.5232897673027422, size=(367, 188), seed=158278415,
    )  # fmt: skip
    # Most of the light is clipped: what is left has no fall from the middle to the rim.
    assert _error(lfcal.calibrate(truth.image(2.0)), truth) < 0.1 * truth.pitch
