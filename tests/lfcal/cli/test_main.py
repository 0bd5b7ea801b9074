"""The lfcal command: output, figures and refusals."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace

import cv2
import msgspec
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
from lfcal.cli.main import main
from lfcal.gain.gain_map import Defects


def run(*arguments):
    return CliRunner().invoke(
        main, [str(argument) for argument in arguments], catch_exceptions=False
    )


def figures_of(*arguments):
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    # The object has the keys and types that are documented.
    msgspec.json.decode(result.stdout, type=main.commands[arguments[0]].callback.result)
    return json.loads(result.stdout)


def assert_refused(result, *words):
    assert result.exit_code == 2, result.output
    assert result.stderr.count("\n") == 1
    assert all(word in result.stderr for word in words), result.stderr


@pytest.fixture
def moved(house, tmp_path):
    """A camera file whose centres lie 5 px beside those of the flat."""
    camera = house.truth.calibration
    lattice = replace(camera.lattice, origin=camera.lattice.origin + np.array([4, 3]))
    replace(camera, lattice=lattice).save(tmp_path / "moved.json")
    return tmp_path / "moved.json"


def test_white_image_becomes_a_camera_file_near_the_truth(house, house_files, tmp_path):
    camera = tmp_path / "camera.json"
    figures = figures_of("calibrate", house_files / "white.png", "--kind", "white", "-o", camera)
    truth = house.truth.calibration
    assert figures["pitch"] == pytest.approx(truth.lattice.pitch, abs=0.02)
    assert (figures["lattice"], figures["size"]) == ("hexagonal", list(truth.image_size))
    assert set(figures["seconds"]) == {"read", "calibrate"}
    assert lfcal.load(camera).lattice.pitch == figures["pitch"]
    assert os.listdir(tmp_path) == ["camera.json"]
    assert figures_of("info", camera) | {"seconds": 0} == figures | {"seconds": 0}
    assert "hexagonal" in run("info", camera).stdout
    assert run("info", camera, "--quiet").output == ""


def test_several_images_make_one_camera_and_the_mosaic_is_kept(house_files, tmp_path):
    white = house_files / "white.png"
    camera = tmp_path / "camera.json"
    assert (
        figures_of("calibrate", white, white, "--mosaic", "rggb", "-o", camera)["mosaic"] == "RGGB"
    )
    assert lfcal.load(camera).mosaic == "RGGB"
    cv2.imwrite(str(tmp_path / "other.png"), np.zeros((300, 310), np.uint8))
    result = run("calibrate", white, tmp_path / "other.png", "-o", tmp_path / "no.json")
    assert_refused(result, "flat 2 is 310 x 300 px", "420 x 330 px")
    assert not (tmp_path / "no.json").exists()


@pytest.mark.parametrize(("option", "encoded"), [("--linear", False), ("--quiet", None)])
def test_the_camera_file_keeps_how_values_are_stored(house_files, tmp_path, option, encoded):
    run("calibrate", house_files / "white.png", "-o", tmp_path / "camera.json", option)
    assert lfcal.load(tmp_path / "camera.json").encoded is encoded


def test_info_prints_lens_types_optics_with_their_errors_and_defects(house, tmp_path):
    optics = lfcal.Optics(
        50.0, 58.0, 0.7, 0.005, covariance=np.diag([0.09, 0.04, 0.0001] + [0.0] * 11)
    )
    types = lfcal.LensTypes([[0, 1], [1, 0]], True, [-0.4, float("nan")], 0.9)
    defects = Defects([[17, 4], [80, 31]], [[0, 1]])
    camera = tmp_path / "camera.json"
    truth = house.truth.calibration
    replace(truth, optics=optics, defects=defects, lens_types=types).save(camera)
    found = figures_of("info", camera)
    figures = found["optics"]
    assert (figures["focal_length_mm"], figures["focal_length_mm_error"]) == (50.0, 0.3)
    assert (figures["sensor_distance_mm"], figures["sensor_distance_mm_error"]) == (0.7, 0.01)
    expected = {
        "count": 2,
        "by_focus": True,
        "confidence": 0.9,
        "focus": [-0.4, None],
        "cell": [[0, 1], [1, 0]],
    }
    assert found["lens_types"] == expected
    told = " ".join(run("info", camera).stdout.split())
    assert (
        "Optics: focal length 50.00 +- 0.30 mm, main lens to microlenses 58.00 +- 0.20 mm, "
        "microlenses to sensor 0.700 +- 0.010 mm; pixels of 5 um."
    ) in told
    assert (
        "Lens types repeat as 0 1, 1 0, confidence 90 %; they are in focus at s = -0.400 D."
    ) in told
    assert f"{truth.lattice.pitch:.2f} px apart" in told
    for placeholder in ("None", "nan", "unknown", "by focus"):
        assert placeholder not in told
    assert (
        "2 defective pixels; 1 unlit lenses"
        in run("convert", camera, "-o", tmp_path / "camera.csv").stdout
    )


@pytest.mark.parametrize(
    ("basis", "words", "rotation"),
    [
        ([[20, 0], [10, 300**0.5]], ("hexagonal", "horizontal"), 0.0),
        ([[0, 20], [300**0.5, 10]], ("hexagonal", "vertical"), 0.0),
        ([[20, 0.3], [-0.3, 20]], ("square", "both ways"), 0.859),
        ([[20, 0], [0, 25]], ("rectangular", "both ways"), 0.0),
        ([[20, 0], [4, 20]], ("oblique", "both ways"), 0.0),
    ],
)
def test_info_names_the_shape_of_the_lattice_and_its_rotation(tmp_path, basis, words, rotation):
    lfcal.Calibration(lfcal.Lattice([100, 100], basis, (300, 200), 9)).save(
        tmp_path / "camera.json"
    )
    figures = figures_of("info", tmp_path / "camera.json")
    assert (figures["lattice"], figures["rows"]) == words
    assert figures["rotation_degrees"] == pytest.approx(rotation, abs=0.001)


def test_compare_tells_how_far_centres_are_from_each_other(house_files, moved):
    found = figures_of("compare", house_files / "camera.json", moved)
    assert [found["rms"], *found["mean_shift"], found["scale"]] == pytest.approx(
        [5.0, 4.0, 3.0, 1.0], abs=1e-5
    )
    assert found["field"]["top left"] == pytest.approx([4.0, 3.0], abs=1e-5)
    told = run("compare", house_files / "camera.json", moved).stdout
    assert "5.0000 px (RMS)" in told and "x +4.0000, y +3.0000 px on average" in told
    assert "bottom right x +4.0000, y +3.0000" in told


def test_bad_images_are_one_line_and_leave_no_file(house, tmp_path):
    png = cv2.imencode(".png", house.white)[1].tobytes()
    nan = house.white.astype(np.float32)
    nan[7, 9] = np.nan
    (tmp_path / "folder").mkdir()
    (tmp_path / "truncated.png").write_bytes(png[: len(png) // 2])
    (tmp_path / "text.png").write_text("no picture\n")
    tifffile.imwrite(tmp_path / "nan.tif", nan)
    cv2.imwrite(str(tmp_path / "constant.png"), np.full((300, 400), 90, np.uint8))
    files = sorted(os.listdir(tmp_path))
    for name in (*files, "missing.png"):
        assert_refused(run("calibrate", tmp_path / name, "-o", tmp_path / "camera.json"), name)
    assert sorted(os.listdir(tmp_path)) == files


def test_decoders_print_no_messages(tmp_path, house):
    tifffile.imwrite(tmp_path / "damaged.tif", house.white, metadata=None)
    data = bytearray((tmp_path / "damaged.tif").read_bytes())
    data[60:90] = bytes(range(60, 90))
    (tmp_path / "damaged.tif").write_bytes(data)
    command = [
        sys.executable,
        "-m",
        "lfcal.cli.main",
        "calibrate",
        "damaged.tif",
        "-o",
        "camera.json",
    ]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1 and "damaged.tif" in result.stderr


def test_bad_outputs_and_damaged_camera_files_are_refused(house_files, tmp_path):
    for output, word in [
        ("camera.txt", ".json"),
        ("nowhere/camera.json", "does not exist"),
        (".", ""),
    ]:
        assert_refused(run("calibrate", house_files / "white.png", "-o", tmp_path / output), word)
    for content in ("", "{", "[]", '{"schema": "lfcal-camera", "version": 1}', "\x00\xff"):
        (tmp_path / "camera.json").write_text(content)
        assert_refused(run("info", tmp_path / "camera.json"), "camera.json")
    assert_refused(run("info", house_files / "flat.png"), "is an image, not a camera file")


def test_lattice_is_stated_by_its_figures(tmp_path):
    camera = tmp_path / "camera.json"
    assert (
        run(
            "lattice",
            "--size",
            "436x436",
            "--pitch",
            "15.41",
            "--arrangement",
            "square",
            "-o",
            camera,
        ).exit_code
        == 0
    )
    stated = lfcal.load(camera)
    assert stated.lattice.pitch == pytest.approx(15.41) and "stated" in stated.warnings[0]


def test_show_and_flatten_say_that_a_camera_does_not_fit(house, house_files, moved, tmp_path):
    flat = house_files / "flat.png"
    for command in (
        ("show", moved, "--image", flat, "-o", tmp_path / "s.png"),
        ("flatten", flat, "-c", moved, "-o", tmp_path / "f.tif"),
    ):
        result = run(*command)
        assert result.exit_code == 0
        assert "warning: the microimages lie 5.0 px beside" in result.stderr
    lattice = house.truth.calibration.lattice
    replace(house.truth.calibration, lattice=replace(lattice, basis=1.3 * lattice.basis)).save(
        tmp_path / "other.json"
    )
    refused = run("flatten", flat, "-c", tmp_path / "other.json", "-o", tmp_path / "g.tif")
    assert_refused(refused, "not made with this camera")


def test_every_command_that_reads_flats_subtracts_the_dark_frame(house, house_files, tmp_path):
    camera = house_files / "camera.json"
    dark = np.full(house.flat.shape[:2], 16, np.uint8)
    cv2.imwrite(str(tmp_path / "dark.png"), dark)
    for name in ("flat", "white"):
        pixels = lfcal.read_flat(house_files / f"{name}.png")
        lifted = np.minimum(pixels, 239) + 16
        cv2.imwrite(
            str(tmp_path / f"{name}.png"), lifted[..., ::-1] if lifted.ndim == 3 else lifted
        )
        less = np.minimum(pixels, 239)
        cv2.imwrite(str(tmp_path / f"less_{name}.png"), less[..., ::-1] if less.ndim == 3 else less)
    for command in (
        ("show", camera, "--image", "FLAT", "-o", tmp_path / "result.png"),
        ("flatten", "FLAT", "-c", camera, "-o", tmp_path / "result.tif"),
        ("assess", "WHITE", "FLAT"),
    ):
        results = []
        for prefix, more in (("", ("--dark", tmp_path / "dark.png")), ("less_", ())):
            names = {"FLAT": f"{prefix}flat.png", "WHITE": f"{prefix}white.png"}
            words = [tmp_path / names[word] if word in names else word for word in command]
            found = figures_of(*words, *more) | {"seconds": 0}
            output = words[-1].read_bytes() if command[0] != "assess" else b""
            results.append((found, output))
        assert results[0] == results[1], command[0]
    cv2.imwrite(str(tmp_path / "small.png"), dark[:-2])
    words = ("--dark", tmp_path / "small.png", "-o", tmp_path / "not.png")
    refused = run("show", camera, "--image", tmp_path / "flat.png", *words)
    assert_refused(refused, "small.png: dark frame has shape")


def test_stated_lattices_have_no_confidence(tmp_path):
    camera = str(tmp_path / "camera.json")
    arguments = ["lattice", "--size", "400x300", "--pitch", "20", "--json", "-o", camera]
    stated = CliRunner().invoke(main, arguments, catch_exceptions=False)
    info = CliRunner().invoke(main, ["info", camera, "--json"], catch_exceptions=False)
    assert json.loads(stated.stdout)["confidence"] is None
    assert json.loads(info.stdout)["confidence"] is None
