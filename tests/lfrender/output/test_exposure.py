"""Dim pictures are brightened by one gain where they are made to be looked at, and in files for
work on request.
"""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
import lfrender
from lfcal.runtime.arrays import brighten, exposure_gain, to_eight_bits
from lfrender.cli.main import main
from lfrender.data.rendering import Rendering
from lfrender.output.views import write_grid


def dim(brightest=0.04, kind=np.uint16):
    """A rendering of a ramp up to a share of white."""
    top = 1.0 if np.dtype(kind).kind == "f" else np.iinfo(kind).max
    image = np.tile(np.linspace(0, brightest * top, 400), (50, 1)).astype(kind)
    return Rendering(image, np.eye(2, 3), np.ones(image.shape, bool), 1.0)


def test_only_dim_pictures_of_more_than_8_bits_are_exposed_by_their_content():
    assert exposure_gain(dim(0.04).image) == pytest.approx(0.9 / 0.04, rel=0.02)
    assert exposure_gain(dim(0.04).image, 4095) == pytest.approx(
        0.9 * 4095 / (0.04 * 65535), rel=0.02
    )
    assert exposure_gain(dim(0.04, np.float32).image, 4095) == pytest.approx(0.9 / 0.04, rel=0.02)
    assert exposure_gain(dim(0.95).image) == exposure_gain(dim(0.04, np.uint8).image) == 1
    assert exposure_gain(dim(0.04).image, exposure=3.0) == 8
    assert exposure_gain(np.zeros((9, 9), np.uint16)) == 1000


def test_a_gain_keeps_the_type_and_stops_at_white():
    bright = brighten(dim(0.5).image, 4.0, 40_000)
    assert bright.dtype == np.uint16 and bright.max() == 40_000
    assert brighten(dim(0.5, np.uint8).image, 4.0, 4095).max() == 255
    assert brighten(dim(0.5, np.float32).image, 4.0).max() == pytest.approx(2.0)
    # A camera of 12 bits does not darken flats of 8 bits.
    assert (to_eight_bits(dim(1.0, np.uint8).image, 4095) == dim(1.0, np.uint8).image).all()


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
    assert lfcal.read_flat(path).max() == pytest.approx(0.16 * top, rel=0.06)


def test_views_of_a_grid_have_one_gain(tmp_path):
    first = dim(0.04)
    second = dim(0.02)
    paths = write_grid(tmp_path, [first, second], 2, ".jpg")
    bright, half = (lfcal.read_flat(path).max() for path in paths)
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
    assert picture.max() < 20 and "Brightness" not in told
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
    assert second.mean() == pytest.approx(first.mean() / 2, rel=0.1)
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
