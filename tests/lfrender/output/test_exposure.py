"""Brightness, tone and white balance of pictures in files: what each format gets by itself, and on
request.
"""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from PIL.ImageCms import ImageCmsProfile, createProfile

import lfcal
import lfrender
from lfcal.runtime.light.tone import apply_tone, encode_srgb, exposure_gain, linear_light
from lfrender.cli.main import main
from lfrender.data.rendering import Rendering
from lfrender.output.formats import EmbeddedMetadata, read_metadata
from lfrender.output.views import write_grid
from lfrender.runtime.colour_profile import colour_profile, is_linear_profile


def dim(brightest=0.04, kind=np.uint16):
    """A rendering of a ramp up to a share of white."""
    top = 1.0 if np.dtype(kind).kind == "f" else np.iinfo(kind).max
    image = np.tile(np.linspace(0, brightest * top, 400), (50, 1)).astype(kind)
    return Rendering(image, np.eye(2, 3), np.ones(image.shape, bool), 1.0)


def test_dim_pictures_are_exposed_by_their_content_those_of_8_bits_on_request():
    assert exposure_gain(dim(0.04).image) == pytest.approx(0.9 / 0.04, rel=0.02)
    assert exposure_gain(dim(0.04).image, 4095) == pytest.approx(
        0.9 * 4095 / (0.04 * 65535), rel=0.02
    )
    assert exposure_gain(dim(0.04, np.float32).image, 4095) == pytest.approx(0.9 / 0.04, rel=0.02)
    assert exposure_gain(dim(0.95).image) == 1
    # Values of 8 bits are encoded: 0.22 of the largest is 0.04 of its light.
    eight = dim(float(encode_srgb(np.array(0.04))), np.uint8).image
    assert exposure_gain(eight, exposure=None) == 1
    assert exposure_gain(eight) == pytest.approx(0.9 / 0.04, rel=0.03)
    assert exposure_gain(dim(0.04).image, exposure=3.0) == 8
    assert exposure_gain(np.zeros((9, 9), np.uint16)) == 1000


def test_a_gain_keeps_the_type_and_stops_at_white():
    bright = apply_tone(dim(0.5).image, np.uint16, False, white=40_000, gain=4.0)
    assert bright.dtype == np.uint16 and bright.max() == 40_000
    eight = dim(0.5, np.uint8).image
    assert apply_tone(eight, np.uint8, True, white=4095, gain=8.0).max() == 255
    floats = dim(0.5, np.float32).image
    assert apply_tone(floats, np.float32, False, gain=4.0).max() == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("suffix", "brightened"), [(".jpg", True), (".webp", True), (".png", False), (".tif", False)]
)
def test_jpeg_and_webp_show_dim_pictures_and_files_for_work_keep_their_values(
    tmp_path, suffix, brightened
):
    path = tmp_path / f"picture{suffix}"
    lfrender.write_picture(path, dim())
    pixels = lfcal.read_flat(path)
    top = np.iinfo(pixels.dtype).max
    assert (pixels.max() > 0.85 * top) == brightened and (pixels.max() < 0.05 * top) != brightened
    lfrender.write_picture(path, dim(), exposure=2.0)
    light = linear_light(lfcal.read_flat(path))
    assert light.max() == pytest.approx(0.16, rel=0.06)


def test_views_of_a_grid_have_one_gain(tmp_path):
    first = dim(0.04)
    second = dim(0.02)
    paths = write_grid(tmp_path, [first, second], 2, ".jpg")
    bright, half = (linear_light(lfcal.read_flat(path)).max() for path in paths)
    assert half == pytest.approx(bright / 2, rel=0.05)


@pytest.fixture(scope="module")
def dark_flat(house, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dark")
    cv2.imwrite(str(folder / "flat.png"), (house.flat[..., ::-1].astype(np.uint16) * 10))
    house.truth.calibration.save(folder / "camera.json")
    return folder


@pytest.mark.parametrize(
    "command", [["render"], ["refocus", "--patch-size", "-8"], ["views", "--stereo"]]
)
def test_commands_brighten_jpeg_by_themselves_and_tiff_on_request(dark_flat, tmp_path, command):
    given = [
        str(dark_flat / "flat.png"),
        "-c",
        str(dark_flat / "camera.json"),
        "--preset",
        "fast",
        "--scale",
        "4",
    ]

    def run(name, *words):
        done = CliRunner().invoke(main, [*command, *given, "-o", str(tmp_path / name), *words])
        assert done.exit_code == 0, done.output
        return lfcal.read_flat(tmp_path / name), done.stdout

    picture, told = run("p.jpg")
    assert picture.max() > 200 and "Brightness times" in told and "--exposure 0" in told
    picture, told = run("dark.jpg", "--exposure", "0")
    assert linear_light(picture).max() < 20 / 255 and "Brightness" not in told
    assert "by the curve of sRGB" in told
    plain, told = run("plain.tif")
    assert "Brightness" not in told
    bright, _ = run("bright.tif", "--exposure", "2")
    assert bright.mean() == pytest.approx(4 * plain.mean(), rel=0.01)
    with tifffile.TiffFile(tmp_path / "bright.tif") as tiff:
        assert json.loads(tiff.pages.first.description)["exposure_gain"] == 4


def test_frames_of_a_sequence_have_one_gain_which_a_continued_run_keeps(dark_flat, tmp_path):
    flat = lfcal.read_flat(dark_flat / "flat.png")
    (tmp_path / "frames").mkdir()
    for number, share in enumerate((1.0, 0.5)):
        cv2.imwrite(
            str(tmp_path / f"frames/f{number}.png"),
            np.rint(flat[..., ::-1] * share).astype(np.uint16),
        )
    given = [
        str(tmp_path / "frames"),
        "-c",
        str(dark_flat / "camera.json"),
        "--preset",
        "fast",
        "--scale",
        "4",
    ]

    def run(*words):
        words = ["batch", *given, "-o", str(tmp_path / "out"), "--format", "jpg", *words]
        done = CliRunner().invoke(main, words, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return [lfcal.read_flat(tmp_path / f"out/f{number}.jpg") for number in (0, 1)]

    first, second = run()
    assert np.percentile(first, 99.5) > 200
    light = [linear_light(picture).mean() for picture in (first, second)]
    assert light[1] == pytest.approx(light[0] / 2, rel=0.1)
    (tmp_path / "out/f1.jpg").unlink()
    np.testing.assert_array_equal(run()[1], second)


@pytest.mark.parametrize(
    ("text", "value"), [("auto", "auto"), ("2", 2.0), ("-1.5 EV", -1.5), ("+3ev", 3.0)]
)
def test_the_option_takes_ev_or_auto(text, value):
    from lfcal.runtime.command_line import ExposureValue

    assert ExposureValue().convert(text, None, None) == value
    done = CliRunner().invoke(main, ["render", "flat.png", "-o", "p.png", "--exposure", "bright"])
    assert done.exit_code == 2 and "a number of EV" in done.stderr


def forms_of(house):
    """One scene as its sensor sees it with 8 bits for a display, and linear in three forms."""
    light = linear_light(house.flat)
    camera = house.truth.calibration
    deep = np.rint(light * 4095).astype(np.uint16)
    twelve = replace(camera, white_level=4095.0)
    height, width = light.shape[:2]
    rows, columns = np.indices((height, width)) % 2
    raw = np.take_along_axis(deep, (rows + columns)[..., None], 2)[..., 0]
    filtered = replace(twelve, mosaic="RGGB", white_balance=(1.0, 1.0, 1.0))
    return {
        "8 bits": (house.flat, camera),
        "16 bits": (deep, twelve),
        "mosaic": (raw, filtered),
        "float": (light.astype(np.float32), camera),
    }


def test_all_forms_of_a_scene_give_jpegs_of_one_brightness(house, tmp_path):
    depth = lfrender.analyze(house.flat, house.truth.calibration, "balanced")
    means = {}
    for name, (flat, camera) in forms_of(house).items():
        picture = lfrender.render(flat, camera, depth, scale=6, detail="off")
        for suffix in (".jpg", ".webp"):
            lfrender.write_picture(tmp_path / f"p{suffix}", picture, exposure=0.0)
            means[name, suffix] = lfcal.read_flat(tmp_path / f"p{suffix}").mean((0, 1))
    wanted = means["8 bits", ".jpg"]
    for form, mean in means.items():
        np.testing.assert_allclose(mean, wanted, rtol=0.02, err_msg=str(form))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("tone", ["auto", "linear", "srgb"])
def test_files_say_whether_values_are_linear(tmp_path, kind, tone):
    picture = dim(1.0, kind)
    linear = tone == "linear" or (tone == "auto" and kind is not np.uint8)
    lfrender.write_picture(tmp_path / "p.tif", picture, tone=tone)
    embedded = read_metadata(tmp_path / "p.tif")
    assert is_linear_profile(embedded.icc) == linear
    with tifffile.TiffFile(tmp_path / "p.tif") as tiff:
        assert json.loads(tiff.pages.first.description)["tone"] == ("linear" if linear else "srgb")
    middle = lfcal.read_flat(tmp_path / "p.tif")
    before = linear_light(picture.image)
    np.testing.assert_allclose(linear_light(middle, encoded=not linear), before, atol=0.004)
    if kind is np.float32:
        return
    lfrender.write_picture(tmp_path / "p.png", picture, tone=tone)
    data = (tmp_path / "p.png").read_bytes()
    gamma = int.from_bytes(data[data.index(b"gAMA") + 4 :][:4], "big")
    assert (gamma == 100_000) == linear and (b"sRGB" in data) != linear


def test_profiles_are_read_by_another_program(tmp_path):
    from io import BytesIO

    from PIL import Image, ImageCms

    shown = {}
    for encoded in (False, True):
        profile = ImageCms.ImageCmsProfile(BytesIO(colour_profile(3, encoded)))
        change = ImageCms.buildTransform(profile, ImageCms.createProfile("sRGB"), "RGB", "RGB")
        shown[encoded] = ImageCms.applyTransform(Image.new("RGB", (1, 1), (128, 60, 200)), change)
    np.testing.assert_allclose(shown[True].getpixel((0, 0)), (128, 60, 200), atol=1)
    light = linear_light(np.array([128, 60, 200]) / 255, encoded=False)
    np.testing.assert_allclose(shown[False].getpixel((0, 0)), 255 * encode_srgb(light), atol=2)
    assert ImageCms.ImageCmsProfile(BytesIO(colour_profile(1, False))).profile.xcolor_space == (
        "GRAY"
    )


def test_a_flat_with_a_profile_keeps_values_and_profile(tmp_path):
    profile = ImageCmsProfile(createProfile("sRGB")).tobytes()
    embedded = EmbeddedMetadata(profile)
    lfrender.write_picture(tmp_path / "p.jpg", dim(0.5), embedded=embedded)
    assert lfcal.read_flat(tmp_path / "p.jpg").max() == pytest.approx(128, abs=3)
    assert read_metadata(tmp_path / "p.jpg").icc == profile
    lfrender.write_picture(tmp_path / "p.png", dim(0.5), embedded=embedded, tone="linear")
    assert is_linear_profile(colour_profile(1, False))
    assert read_metadata(tmp_path / "p.png").icc == b""


def test_a_lit_grey_card_behind_filters_is_grey_with_a_white_image(tmp_path):
    """Usual gains: a sensor sees half as much red, and two thirds as much blue, as green."""
    sensor = np.array([0.5, 1.0, 0.65])
    lattice = lfcal.Lattice((10, 10), ((20, 0), (0, 20)), (400, 300), 9.0)
    y, x = np.mgrid[:300, :400]
    lit = np.clip(9.5 - np.hypot(x % 20 - 10, y % 20 - 10), 0, 1)
    colours = sensor[y % 2 + x % 2]
    noise = np.random.default_rng(0).normal(0, 20, lit.shape)
    white, card = (
        np.clip(lit * colours * level + 40 + noise, 0, 65535).astype(np.uint16)
        for level in (52_000, 21_000)
    )
    camera = lfcal.calibrate(white, kind="white", mosaic="RGGB")
    assert camera.white_balance == pytest.approx(1 / sensor, rel=0.03)
    assert lfcal.Calibration.from_dict(camera.to_dict()).white_balance == camera.white_balance
    assert camera.with_mosaic("BGGR").white_balance == camera.white_balance[::-1]
    assert lattice.pitch == pytest.approx(camera.lattice.pitch, abs=0.05)
    picture = lfrender.render(card, camera, patch_size=6.0)
    for suffix in (".jpg", ".png", ".tif"):
        lfrender.write_picture(tmp_path / f"p{suffix}", picture)
        light = linear_light(lfcal.read_flat(tmp_path / f"p{suffix}"))[20:-20, 20:-20]
        mean = light.mean((0, 1))
        np.testing.assert_allclose(mean, mean.mean(), rtol=0.03, err_msg=suffix)
    lfrender.write_picture(tmp_path / "raw.tif", picture, white_balance="none")
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "raw.tif"), picture.image)
    # Without a white image, the average of the picture is made grey.
    guessed = lfrender.render(card, replace(camera, white_balance=None), patch_size=6.0)
    lfrender.write_picture(tmp_path / "g.jpg", guessed)
    mean = linear_light(lfcal.read_flat(tmp_path / "g.jpg")).mean((0, 1))
    np.testing.assert_allclose(mean, mean.mean(), rtol=0.03)
    lfrender.write_picture(tmp_path / "b.jpg", guessed, white_balance=(1.0, 1.0, 1.0))
    assert np.ptp(lfcal.read_flat(tmp_path / "b.jpg").mean((0, 1))) > 20


@pytest.mark.parametrize("value", ["red", (1.0, 2.0), (1.0, 0.0, 1.0)])
def test_a_wrong_white_balance_or_tone_of_python_is_named(tmp_path, value):
    with pytest.raises(ValueError, match="white_balance must be"):
        lfrender.write_picture(tmp_path / "p.png", dim(), white_balance=value)
    with pytest.raises(ValueError, match="tone must be one of auto, linear, srgb"):
        lfrender.write_picture(tmp_path / "p.png", dim(), tone="log")


@pytest.mark.parametrize("value", ["red", "1,2", "1,0,1", "1,2,3,4", "1,nan,1"])
def test_the_white_balance_is_three_gains_or_a_word(value):
    words = ["render", "flat.png", "-o", "p.png", "--white-balance", value]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2 and "three gains" in done.stderr
