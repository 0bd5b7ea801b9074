"""The calibration as a whole: right on known lattices of all kinds, a clear refusal on everything
else.
"""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from skimage import data
from threadpoolctl import threadpool_info, threadpool_limits

import lfcal
from data_synth import SCENES, Camera, simulate
from lfcal.detection import downscale


@pytest.mark.parametrize(
    ("shape", "pitch", "degrees", "size"),
    [("HEXAGON", 6.4, 11, (400, 300)), ("SQUARE", 40, 30, (700, 600))],
)
def test_white_image_places_centres_within_a_hundredth_pixel(whites, shape, pitch, degrees, size):
    basis = whites.turned(getattr(whites, shape), pitch, degrees)
    image, origin = whites.white_image(basis, size)
    camera = lfcal.calibrate(image)
    assert camera.source == "white"
    assert camera.confidence > 0.9
    assert whites.rms(whites.centre_errors(camera.lattice, origin, basis)) < 0.01
    assert len(camera.lattice.steps) == (6 if shape == "HEXAGON" else 4)


@pytest.mark.parametrize("shape", [[[1, 0], [0, 2.0]], [[1, 0], [0.3, 1.1]]])
def test_rectangular_and_sheared_lattices_are_found(whites, shape):
    basis = whites.turned(np.array(shape, float), 20.3, 17)
    image, origin = whites.white_image(basis, (600, 500))
    camera = lfcal.calibrate(image)
    assert whites.rms(whites.centre_errors(camera.lattice, origin, basis)) < 0.01


@pytest.mark.parametrize(("shape", "fill"), [("HEXAGON", 0.5), ("SQUARE", 1.1)])
def test_lenses_are_never_taken_for_gaps_at_any_fill_factor(whites, shape, fill):
    basis = whites.turned(getattr(whites, shape), 20.3, 3)
    image, origin = whites.white_image(basis, (500, 400), fill=fill)
    assert whites.rms(whites.centre_errors(lfcal.calibrate(image).lattice, origin, basis)) < 0.02


@pytest.mark.parametrize("change", [{"soft": 8.0}, {"noise": 0.1}, {"gap": 0.9}])
def test_soft_noisy_or_faint_discs_are_found(whites, change):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (500, 400), **change)
    assert whites.rms(whites.centre_errors(lfcal.calibrate(image).lattice, origin, basis)) < 0.03


def test_three_lens_types_of_different_brightness_are_one_lattice(whites):
    basis = whites.turned(whites.HEXAGON, 23.2, 90)
    image, origin = whites.white_image(basis, (500, 400), noise=0.0)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    index = np.rint((np.stack([x, y], -1) - origin) @ np.linalg.inv(basis))
    gain = np.array([1.0, 0.9, 0.8])[((index[..., 0] - index[..., 1]) % 3).astype(int)]
    camera = lfcal.calibrate((image * gain).astype(np.uint16))
    assert whites.rms(whites.centre_errors(camera.lattice, origin, basis)) < 0.1


def test_usable_radius_is_where_light_falls_to_half(whites):
    basis = whites.turned(whites.HEXAGON, 40.0, 5)
    image, _ = whites.white_image(basis, (600, 500), fill=0.8)
    camera = lfcal.calibrate(image)
    assert camera.lattice.radius == pytest.approx(16.0, abs=0.15)
    assert camera.vignetting.at(8.0) == pytest.approx(1.0, abs=0.02)
    assert camera.vignetting.at(19.0) < 0.15


def test_any_pixel_type_gives_the_same_lattice(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, _ = whites.white_image(basis, (300, 240))
    reference = lfcal.calibrate(image).lattice
    rgb = np.repeat(image[..., None], 3, axis=2)
    for same in (image.astype(np.float64) / 65535, rgb, rgb.astype(np.float32)):
        np.testing.assert_allclose(
            lfcal.calibrate(same).lattice.origin, reference.origin, atol=1e-3
        )


def test_a_scene_that_is_lit_in_a_corner_is_doubted(house):
    dark = house.flat.copy()
    dark[dark.shape[0] // 2 :], dark[:, 3 * dark.shape[1] // 4 :] = 0, 0
    camera = lfcal.calibrate(dark, kind="scene")
    assert camera.confidence <= 0.4
    assert any("light lies on" in warning for warning in camera.warnings)


def test_few_bright_places_of_a_linear_scene_do_not_move_the_lattice(whites):
    camera = Camera.design((560, 440), 23.2, rotation=1.3)
    capture = simulate(SCENES["house"](camera), camera, samples=12, seed=3, noise=(12000.0, 5.0))
    light = capture.flat / 255 / np.maximum(capture.white / capture.white.max(), 0.3)[..., None]
    linear = np.rint(65535 * np.clip(light, 0, 1) ** 3.5).astype(np.uint16)
    true = capture.truth.calibration.lattice
    errors = whites.centre_errors(lfcal.calibrate(linear).lattice, true.origin, true.basis)
    assert whites.rms(errors) < 0.06


@pytest.mark.parametrize("name", ["coins", "brick"])
def test_photograph_is_refused_in_one_line(name):
    with pytest.raises(lfcal.CalibrationError) as error:
        lfcal.calibrate(getattr(data, name)())
    assert "\n" not in str(error.value) and "give" in str(error.value)


def _patterns():
    rng = np.random.default_rng(1)
    x = np.arange(600)
    yield "noise", rng.integers(0, 255, (500, 600)).astype(np.uint8)
    yield (
        "noisy grating",
        np.clip(127 + 100 * np.sin(x / 4.0) + 20 * rng.standard_normal((500, 600)), 0, 255),
    )
    yield "even grey", np.full((300, 300), 90, np.uint8)
    yield "black", np.zeros((300, 300), np.uint16)


@pytest.mark.parametrize(("name", "image"), list(_patterns()))
def test_image_without_a_lattice_is_refused(name, image):
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(image)


def test_flat_of_fewer_than_four_pitches_is_refused(whites):
    image, _ = whites.white_image(whites.turned(whites.SQUARE, 60.0, 3), (200, 180))
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(image)


def test_unknown_kind_is_an_error():
    with pytest.raises(ValueError, match="kind"):
        lfcal.calibrate(np.zeros((64, 64)), kind="grey")


@pytest.mark.parametrize(
    ("folder", "picture", "limit"),
    [("s3_r5", "flat.png", 0.02), ("s2_sq", "flat.png", 0.02), ("s3_r5", "white.png", 0.002)],
)
def test_ray_traced_camera_is_calibrated(shared, whites, folder, picture, limit):
    truth = json.loads(shared("truth", folder, "truth.json").read_text())["camera"]
    camera = lfcal.calibrate(lfcal.read_flat(shared("truth", folder, picture)))
    assert camera.source == picture.split(".")[0].replace("flat", "scene")
    assert (
        whites.rms(whites.centre_errors(camera.lattice, truth["origin_px"], truth["basis_px"]))
        < limit
    )


def test_raytrix_scene_agrees_with_its_published_calibration(shared, whites):
    flat = lfcal.read_flat(shared("captures", "Fujita2.png"))
    published = lfcal.load(shared("captures", "Fujita2.published.xml"), (2048, 2048)).lattice
    found = lfcal.calibrate(flat).lattice
    assert np.abs(whites.centre_errors(found, published.origin, published.basis)).max() < 0.5


def test_lattice_of_a_flattened_capture_is_found_by_its_edges_alone(shared, whites):
    flat = lfcal.read_flat(shared("captures", "TempleBoatGiantR32.webp"))
    published = lfcal.load(
        shared("captures", "TempleBoatGiantR32.published.xml"), (6464, 4852)
    ).lattice
    corner = np.array([1632, 1226])
    camera = lfcal.calibrate(flat[1226:3626, 1632:4832].copy())
    assert camera.lattice.pitch == pytest.approx(published.pitch, rel=1e-3)
    # The angle in the published file contradicts the pixels toward the corners: compared in the
    # middle only.
    offset = whites.centre_errors(camera.lattice, published.origin - corner, published.basis)
    middle = np.abs(camera.lattice.centres() + corner - [3232, 2426]).max(1) < 300
    assert np.abs(offset[middle]).max() < 1.0
    assert (
        camera.vignetting.profile[
            : int(0.95 * camera.lattice.radius / camera.vignetting.step)
        ].min()
        > 0.9
    )


def test_repeating_detail_of_a_plane_is_not_taken_for_the_lattice():
    """Its detail comes back every (1 + s / D) pitches, and stands out more than rims that are only
    half as bright.
    """
    size = (900, 700)
    pitch = 30.0
    patch_size = 4.5
    angles = np.radians(2.5) + np.array([0, np.pi / 3])
    lattice = lfcal.Lattice(
        (450.3, 349.8), pitch * np.stack([np.cos(angles), np.sin(angles)], 1), size, 11.0
    )
    y, x = np.mgrid[: size[1], : size[0]]
    places = np.column_stack([x.ravel(), y.ravel()])
    centres = lattice.centres()
    distance, lens = cKDTree(centres).query(places)
    scene = centres[lens] - (places - centres[lens]) * pitch / patch_size
    rng = np.random.default_rng(5)
    picture = np.zeros(len(places))
    for _ in range(120):
        angle = rng.uniform(0, 2 * np.pi)
        detail = 0.6 * patch_size / pitch * np.sqrt(rng.random())
        picture += np.cos(
            scene @ [detail * np.cos(angle), detail * np.sin(angle)] + rng.uniform(0, 2 * np.pi)
        )
    rims = 1 - 0.33 * np.minimum(2 * distance / pitch, 1.2) ** 6
    light = np.maximum(0.45 + 0.15 * picture / picture.std(), 0.02) * rims
    light = cv2.GaussianBlur(light.reshape(size[::-1]), (0, 0), 1.0)
    camera = lfcal.calibrate(
        np.clip(255 * light + rng.normal(0, 2, light.shape), 0, 255).astype(np.uint8)
    )
    assert camera.lattice.pitch == pytest.approx(pitch, rel=2e-3)
    inner = ((centres > pitch) & (centres < np.array(size) - pitch)).all(1)
    assert cKDTree(camera.lattice.centres()).query(centres[inner])[0].max() < 0.05 * pitch


def test_quarter_of_a_capture_has_the_lattice_of_all_of_it(shared):
    flat = lfcal.read_flat(shared("captures", "Boys2.webp"))[428:2528, 588:3388]
    whole = lfcal.calibrate(flat).lattice
    found = lfcal.calibrate(flat[525:1575, 700:2100].copy()).lattice
    apart = cKDTree(whole.centres()).query(found.centres() + np.array([700, 525]))[0]
    assert apart.max() < 0.1 * whole.pitch


def _blas_threads():
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_calibrate_works_with_one_blas_thread_and_leaves_two(monkeypatch):
    seen = []
    choose_block_size = downscale.choose_block_size

    def record_threads(image, has_mosaic):
        seen.append(_blas_threads())
        return choose_block_size(image, has_mosaic)

    monkeypatch.setattr(downscale, "choose_block_size", record_threads)
    with threadpool_limits(2, "blas"):
        if _blas_threads() != {2}:
            pytest.skip("no BLAS here whose threads can be set")
        with pytest.raises(lfcal.CalibrationError):
            lfcal.calibrate(np.full((64, 64), 7, np.uint8))
        assert seen == [{1}]
        assert _blas_threads() == {2}
