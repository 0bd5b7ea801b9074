"""White images of the benchmark: whole, cut and distorted microimages, and true centres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

import lfcal

CAPTURES = Path(__file__).resolve().parents[3].parent / "shared" / "captures"


def _error(camera, truth):
    found = camera.lattice.centres()
    return float(np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()))


def test_error_of_whole_microimages_is_within_three_times_the_cramer_rao_bound(drawn):
    truth = drawn("hexagonal", 14.3, 11.0, 18, size=(500, 400))
    camera = lfcal.calibrate(truth.image())
    assert camera.lattice.distortion is None
    assert _error(camera, truth) < 3 * truth.bound()


def test_radial_distortion_is_fitted(drawn):
    truth = drawn("square", 20.3, 5.0, 26.0, k1=0.005, size=(700, 560))
    camera = lfcal.calibrate(truth.image())
    assert camera.lattice.distortion is not None
    assert _error(camera, truth) < 0.02


def test_shading_centred_below_the_microlens_does_not_move_centres(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 32.0, size=(600, 480), inner=0.0)
    image = truth.image()
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    places = np.column_stack([x.ravel(), y.ravel()])
    centres = truth.centres(lfcal.Lattice(truth.origin, truth.basis, truth.size, 9.0).indices())
    centres = centres[cKDTree(centres).query(places)[1]]
    # cos^4 of the angle at 100 px from a microlens that lies 1 % nearer to the axis than its
    # microimage.
    aside = places - centres + 0.01 * (centres - np.array(truth.size) / 2)
    fall = (1 + (aside**2).sum(1) / 100**2) ** -2
    camera = lfcal.calibrate(np.rint(image * fall.reshape(image.shape)).astype(image.dtype))
    assert _error(camera, truth) < 0.001


def test_light_of_neighbours_that_is_shaded_the_other_way_does_not_move_centres():
    # The gaps of touching lenses are filled with the light of both and stray light, as in Raytrix
    # cameras.
    lattice = lfcal.Lattice(
        np.array([3.3, 4.7]), 23.4 * np.array([[1.0, 0.0], [0.5, 0.75**0.5]]), (700, 600), 11.0
    )
    y, x = np.mgrid[:600, :700]
    light = np.full(x.shape, 80.0)
    for cx, cy in lattice.points(np.argwhere(np.ones((70, 45))) - (25, 5)):
        if not (-20 < cx < 720 and -20 < cy < 620):
            continue
        box = np.s_[
            max(round(cy) - 18, 0) : round(cy) + 19, max(round(cx) - 18, 0) : round(cx) + 19
        ]
        dx = x[box] - cx
        dy = y[box] - cy
        shade = 1 - 0.014 / 350 * ((cx - 350) * dx + (cy - 300) * dy)
        light[box] += 100 * shade / (1 + np.exp((np.hypot(dx, dy) - 11.5) / 1.1))
    image = np.random.default_rng(0).poisson(light * 20) // 20
    camera = lfcal.calibrate(image.astype(np.uint8), kind="white")
    found = camera.lattice.centres()
    near = lattice.points(np.rint(lattice.to_index(found)))
    assert np.sqrt(((found - near) ** 2).sum(1).mean()) < 0.06


def test_stated_errors_of_centres_match_true_ones(drawn):
    ratios = []
    for seed in range(2):
        truth = drawn("hexagonal", 14.3, 11.0, 26.0, size=(480, 360), seed=10 * seed)
        camera = lfcal.calibrate(truth.image())
        stated = np.sqrt((camera.errors.of_centres(camera.lattice) ** 2).mean())
        ratios.append(_error(camera, truth) / stated)
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.8


def test_general_distortion_of_scanned_film_is_fitted(drawn):
    truth = drawn("square", 20.3, 5.0, 26.0, size=(700, 560))
    y, x = np.mgrid[:560, :700].astype(np.float32)
    bent = (x - 350) * (y - 280) / 150_000 * 4, ((x - 350) / 350) ** 3 * 3
    import cv2

    image = cv2.remap(
        truth.image(),
        x + bent[0].astype(np.float32),
        y + bent[1].astype(np.float32),
        cv2.INTER_CUBIC,
    )
    camera = lfcal.calibrate(image)
    centres = camera.lattice.centres()
    back = centres.copy()
    back[:, 0] += (centres[:, 0] - 350) * (centres[:, 1] - 280) / 150_000 * 4
    back[:, 1] += ((centres[:, 0] - 350) / 350) ** 3 * 3
    inside = ((back > 5) & (back < np.array([695, 555]))).all(1)
    miss = back[inside] - truth.centres(truth.index_of(back[inside]))
    assert camera.lattice.distortion.general is not None
    assert np.sqrt((miss**2).sum(1).mean()) < 0.05


def test_clipped_middles_of_microimages_do_not_move_centres(drawn):
    truth = drawn("square", 24.3, 31.0, 34.0, size=(560, 400), outer=0.6)
    light = truth.light() + truth.noise * np.random.default_rng(1).standard_normal((400, 560))
    image = np.rint(np.clip(2.2 * light, 0, 1) * 255).astype(np.uint8)
    assert (image == 255).mean() > 0.15
    assert _error(lfcal.calibrate(image, "white"), truth) < 0.004


def test_missing_lenses_do_not_make_a_white_image_a_scene(drawn):
    truth = drawn("hexagonal", 20.3, 17.0, 34.0, gap=0.0, size=(560, 400))
    y, x = np.mgrid[:400, :560].astype(float)
    index = truth.index_of(np.column_stack([x.ravel(), y.ravel()]))
    gone = (index[:, 0] * 7 + index[:, 1] * 3) % 19 == 0
    light = 0.06 + np.where(gone.reshape(400, 560), 0, 0.9 * truth.light())
    light += truth.noise * np.random.default_rng(1).standard_normal(light.shape)
    camera = lfcal.calibrate(np.rint(np.clip(0.8 * light, 0, 1) * 65535).astype(np.uint16))
    assert camera.source == "white"
    assert _error(camera, truth) < 0.003


def test_soft_discs_of_an_oblong_array_are_no_checkerboard(whites):
    basis = whites.turned(np.array([[1.0, 0.0], [0.0, 1.37]]), 13.88, 53.5)
    image, origin = whites.white_image(
        basis, (600, 500), fill=0.945, soft=4.0, gap=0.093, noise=0.02
    )
    found = lfcal.calibrate(image)
    assert whites.rms(whites.centre_errors(found.lattice, origin, basis)) < 0.02


def test_values_beyond_single_precision_raise_a_flat_error():
    with pytest.raises(lfcal.FlatError, match="scale them"):
        lfcal.calibrate(np.random.default_rng(0).random((100, 120)) * 1e300)


@pytest.mark.filterwarnings("error")
def test_meshes_and_waves_give_a_calibration_or_a_light_field_error(pitch=20.0):
    x, y = np.meshgrid(np.arange(300), np.arange(220))
    waves = 128 + 50 * (np.sin(2 * np.pi * x / pitch) + np.sin(2 * np.pi * y / pitch))
    mesh = np.where((x % pitch < 3) | (y % pitch < 3), 190, 60)
    for image in (np.rint(waves).astype(np.uint8), mesh.astype(np.uint8)):
        try:
            assert lfcal.calibrate(image).lattice.pitch == pytest.approx(pitch, rel=0.02)
        except lfcal.LightFieldError as error:
            assert "give" in str(error)


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="no captures beside the repository")
def test_white_image_and_capture_of_a_raytrix_with_colour_filters_agree():
    flats = (
        lfcal.read_flat(CAPTURES / name)[700:1300, 700:1400]
        for name in ("R5b.white.png", "R5b.png")
    )
    white, scene = (lfcal.calibrate(flat).lattice for flat in flats)
    centres = scene.centres()
    apart = white.points(np.rint(white.to_index(centres))) - centres
    assert white.pitch == pytest.approx(23.37, abs=0.01)
    assert np.sqrt((apart**2).sum(1).mean()) < 0.3


@pytest.mark.parametrize("slope, said", [(0.0, False), (0.015, True)])
def test_plain_centroids_beside_the_lattice_are_said(drawn, slope, said):
    truth = drawn("hexagonal", 23.3, 2.0, 32.0, size=(500, 380), inner=0.0)
    image = truth.image()
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    places = np.column_stack([x.ravel(), y.ravel()])
    centres = truth.centres(truth.index_of(places).round())
    shade = 1 + slope * (places - centres)[:, 0].reshape(image.shape)
    camera = lfcal.calibrate((image * shade * 0.7).astype(image.dtype), kind="white")
    # The light is shaded alike in all microimages: their centroids lie 0.015 R^2 / 4 px to the
    # right.
    assert any("plain centroids" in warning for warning in camera.warnings) == said
    assert _error(camera, truth) < 0.05
