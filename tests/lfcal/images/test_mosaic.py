"""Flats with a colour filter mosaic, stated or found: centres as good as without."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import lfcal
from data_synth import SCENES, Camera, simulate
from lfcal.images.mosaic import balance_mosaic, find_mosaic

CAPTURES = Path(__file__).resolve().parents[3].parent / "shared" / "captures"
_COLOURS = {"R": 0.45, "G": 1.0, "B": 0.6}


def _filtered(image, mosaic):
    """`image` (h, w) or (h, w, 3) behind colour filters, a mono image under reddish light."""
    out = np.empty(image.shape[:2], image.dtype)
    for place, colour in enumerate(mosaic):
        phase = np.s_[place // 2 :: 2, place % 2 :: 2]
        out[phase] = (
            image[phase] * _COLOURS[colour]
            if image.ndim == 2
            else image[(*phase, "RGB".index(colour))]
        )
    return out


@pytest.mark.parametrize(("mosaic", "stated"), [("RGGB", True), ("GRBG", False)])
def test_white_image_behind_a_mosaic_places_centres_within_three_thousandths(
    whites, mosaic, stated
):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    image, origin = whites.white_image(basis, (501, 401))
    camera = lfcal.calibrate(_filtered(image, mosaic), mosaic=mosaic if stated else None)
    assert camera.source == "white"
    assert whites.rms(whites.centre_errors(camera.lattice, origin, basis)) < 0.003
    assert camera.mosaic_guessed != stated
    assert any("red and blue are a guess" in warning for warning in camera.warnings) != stated
    exchanged = mosaic.translate(str.maketrans("RB", "BR"))
    assert camera.mosaic in ((mosaic,) if stated else (mosaic, exchanged))
    assert find_mosaic(_filtered(image, exchanged)) in (mosaic, exchanged)


def test_scene_behind_a_mosaic_places_centres_within_a_twentieth_pixel(house):
    colour = house.flat.astype(np.float64) * [0.5, 1.0, 0.7]
    camera = lfcal.calibrate(_filtered(colour, "GRBG"), mosaic="GRBG")
    truth = house.truth.calibration.lattice
    index = np.rint(truth.to_index(camera.lattice.centres()))
    miss = camera.lattice.centres() - truth.points(index)
    assert np.sqrt((miss**2).sum(1).mean()) < 0.05
    assert camera.source == "scene"


def test_a_mosaic_of_a_colour_picture_or_of_unknown_name_is_refused(whites):
    image, _ = whites.white_image(whites.turned(whites.HEXAGON, 14.3, 3), (300, 260))
    with pytest.raises(lfcal.FlatError, match="in colour"):
        lfcal.calibrate(np.dstack([image] * 3), mosaic="RGGB")
    with pytest.raises(ValueError, match="RGGB"):
        lfcal.calibrate(image, mosaic="RGBG")


def test_filters_stated_against_the_measured_green_are_refused_with_the_two_that_fit(whites):
    image, _ = whites.white_image(whites.turned(whites.HEXAGON, 14.3, 3), (300, 260))
    with pytest.raises(lfcal.FlatError, match="stated as GRBG, but green lies as in"):
        lfcal.calibrate(_filtered(image, "RGGB"), mosaic="GRBG")


@pytest.mark.parametrize("mosaic", ["BGGR", "GRBG"])
def test_where_green_is_is_measured_on_a_scene_and_neither_noise_nor_jpeg_hide_it(mosaic):
    camera = Camera.design((300, 260), 23.0, "hex", 3.0).replace(
        mosaic=mosaic, filters=(0.9, 1.0, 0.9)
    )
    flat = simulate(SCENES["house"](camera), camera, samples=4, noise=(5000, 8)).flat
    assert find_mosaic(flat).index("G") == mosaic.index("G")
    packed = cv2.imdecode(
        cv2.imencode(".jpg", flat, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], cv2.IMREAD_GRAYSCALE
    )
    assert find_mosaic(packed).index("G") == mosaic.index("G")


@pytest.mark.parametrize("pitch", [6, 10, 24])
@pytest.mark.parametrize("origin", [(0.0, 0.0), (0.5, 0.5), (0.3, 0.2)])
def test_discs_on_whole_pixels_are_no_mosaic(pitch, origin):
    y, x = np.mgrid[:400, :400]
    dx, dy = (
        (value - start + pitch / 2) % pitch - pitch / 2
        for value, start in zip((x, y), origin, strict=True)
    )
    assert find_mosaic(np.where(np.hypot(dx, dy) < 0.43 * pitch, 200, 10).astype(np.uint8)) is None


@pytest.mark.parametrize("mosaic", ["RGGB", "GBRG"])
def test_in_warm_light_the_colour_as_bright_as_green_is_red_though_some_objects_are_blue(mosaic):
    rng = np.random.default_rng(3)
    grey = cv2.resize(rng.uniform(0.2, 1, (40, 40)), (400, 400))
    warm = grey[..., None] * [1.05, 1.0, 0.6] * 3000
    warm[:60] *= [0.4, 0.8, 1.5]
    assert find_mosaic(_filtered(warm, mosaic)) == mosaic


def test_a_guess_on_a_white_image_gives_way_to_what_a_scene_shows_and_to_what_is_stated(whites):
    camera = Camera.design((300, 260), 23.0, "hex", 3.0).replace(
        mosaic="GBRG", filters=(0.9, 1.0, 0.9)
    )
    capture = simulate(SCENES["house"](camera), camera, samples=4)
    found = lfcal.calibrate(capture.white)
    scene = found.with_mosaic_of(capture.flat)
    assert scene.mosaic == find_mosaic(capture.flat)
    assert sum("colour filters" in warning for warning in scene.warnings) == 1
    stated = scene.with_mosaic("GBRG")
    assert (stated.mosaic, stated.mosaic_guessed) == ("GBRG", False)
    assert not any("colour filters" in warning for warning in stated.warnings)
    assert stated.with_mosaic_of(capture.flat) is stated
    assert lfcal.Calibration.from_dict(scene.to_dict()).mosaic_guessed


def test_flats_that_disagree_on_red_and_blue_are_both_named_and_stated_filters_are_checked(whites):
    camera = Camera.design((300, 260), 23.0, "hex", 3.0).replace(mosaic="GBRG")
    flat = simulate(SCENES["house"](camera), camera, samples=4).flat
    found = find_mosaic(flat)
    other = {"GBRG": "GRBG", "GRBG": "GBRG"}[found]
    lattice = lfcal.Lattice([11, 10], [[23, 0], [0, 23]], (300, 260), 9.0)
    before = lfcal.Calibration(lattice).with_mosaic(other, guessed=True)
    after = before.with_mosaic_of(flat)
    assert after.mosaic == found and f"another flat of this camera was taken for {other}" in str(
        after.warnings
    )
    assert before.with_mosaic(found, flat=flat).mosaic == found
    with pytest.raises(lfcal.FlatError, match="green lies as in"):
        before.with_mosaic("RGGB", flat=flat)


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="no captures beside the repository")
def test_filters_of_a_raytrix_are_found_and_no_capture_without_is_taken_for_one():
    assert find_mosaic(lfcal.read_flat(CAPTURES / "R5b.png")) == "GBRG"
    assert find_mosaic(lfcal.read_flat(CAPTURES / "R5b.white.png")) in ("GBRG", "GRBG")
    for path in sorted(CAPTURES.glob("*")):
        if path.suffix not in (".png", ".tif", ".jpg") or path.name.startswith("R5b"):
            continue
        flat = lfcal.read_flat(path)
        for grey in [flat] if flat.ndim == 2 else np.moveaxis(flat, 2, 0):
            assert find_mosaic(grey) is None, path.name


@pytest.mark.parametrize(
    ("colours", "gains"), [((0.5, 1, 0.4), (2, 1, 2.5)), ((0.855, 0.813, 1), (1, 1, 1))]
)
def test_white_balance_makes_raw_light_grey_and_leaves_balanced_light_alone(colours, gains):
    white = np.full((200, 200), 0.6 * colours[1], np.float32)
    white[::2, ::2] = 0.6 * colours[0]
    white[1::2, 1::2] = 0.6 * colours[2]
    found = balance_mosaic(white, "RGGB", None, False)
    np.testing.assert_allclose(np.divide(found, found[1]), gains, rtol=1e-5)
