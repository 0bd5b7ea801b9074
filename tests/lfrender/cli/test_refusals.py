"""What commands refuse: they say why in one line, and leave no file."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from importlib.util import find_spec

import cv2
import numpy as np
import pytest
import tifffile

import lfcal
from lfcal.runtime import packages
from lfrender.cli.inputs import CaptureInput


@pytest.mark.parametrize(
    "words",
    [
        "--traditional --patch-size 5",
        "--scale 0",
        "--patch-size much",
        "--preset best",
        "--patch-size 5 --scale nan",
        "--patch-size 5 --scale 1e9",
        "--patch-size 0",
    ],
)
def test_options_that_make_no_sense_are_one_line(ask, tmp_path, words, run, assert_refused):
    assert_refused(run(*ask("render", *words.split(), "-o", tmp_path / "picture.png")))
    assert os.listdir(tmp_path) == []


def test_white_image_of_another_camera_is_refused(
    house, house_files, tmp_path, run, assert_refused
):
    white = house.white
    height, width = white.shape[:2]
    scaled = cv2.resize(white, None, fx=1.3, fy=1.3, interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(tmp_path / "other.png"), scaled[:height, :width])
    words = ("--white", tmp_path / "other.png", "-o", tmp_path / "p.png", "--preset", "fast")
    refused = run("render", house_files / "flat.png", *words)
    assert_refused(refused, "other.png", "not made with this camera")


@pytest.mark.parametrize("command", ["render", "analyze"])
def test_a_camera_is_checked_against_the_flat_before_that_is_analysed(
    command, house, house_files, moved, tmp_path, run, assert_refused
):
    camera = house.truth.calibration
    flat = house_files / "flat.png"
    replace(camera, lattice=replace(camera.lattice, basis=1.3 * camera.lattice.basis)).save(
        tmp_path / "other.json"
    )
    cv2.imwrite(str(tmp_path / "part.png"), house.flat[:-10, :-20])
    output = tmp_path / ("depth.npz" if command == "analyze" else "picture.png")
    told = run(command, flat, "-c", moved, "-o", output, "--preset", "fast")
    assert told.exit_code == 0
    assert "warning: the microimages lie 5.0 px beside those of the camera" in told.stderr
    assert "was moved onto the microimages" in told.stderr
    output.unlink()
    other = run(command, flat, "-c", tmp_path / "other.json", "-o", output, "--preset", "fast")
    assert_refused(other, "other.json", "not made with this camera")
    words = ("-c", tmp_path / "other.json", "-o", output, "--preset", "fast", "--no-check")
    known = run(command, flat, *words)
    assert known.exit_code == 0 and "not made with" not in known.stderr
    output.unlink()
    part = run(command, tmp_path / "part.png", "-c", house_files / "camera.json", "-o", output)
    assert_refused(part, "420 x 330", "400 x 320")
    white = run(command, tmp_path / "part.png", "--white", house_files / "white.png", "-o", output)
    assert_refused(white, "one size")
    both = run(command, flat, "-c", moved, "--white", house_files / "white.png", "-o", output)
    assert_refused(both, "exclude each other")
    assert not output.exists()


def test_depth_of_another_camera_or_no_depth_at_all_is_refused(
    house, ask, tmp_path, run, figures_of, assert_refused
):
    (tmp_path / "text.npz").write_text("no depth")
    (tmp_path / "empty.npz").touch()
    (tmp_path / "depth.json").touch()
    for name in ("text.npz", "empty.npz", "missing.npz", "depth.json", ""):
        assert_refused(run(*ask("render", "--depth", tmp_path / name, "-o", tmp_path / "p.png")))
    figures_of(*ask("analyze", "-o", tmp_path / "depth.npz", "--preset", "fast"))
    cv2.imwrite(str(tmp_path / "part.png"), house.flat[:-10, :-20])
    lattice = house.truth.calibration.lattice
    lfcal.Calibration(replace(lattice, image_size=(400, 320))).save(tmp_path / "part.json")
    words = (
        "-c",
        tmp_path / "part.json",
        "--depth",
        tmp_path / "depth.npz",
        "-o",
        tmp_path / "p.png",
    )
    assert_refused(run("render", tmp_path / "part.png", *words))
    assert not (tmp_path / "p.png").exists()


@pytest.mark.parametrize(
    "name", ["missing.png", "empty.png", "truncated.png", "nan.tif", "tiny.png"]
)
def test_bad_flats_are_one_line_and_leave_no_file(
    house, house_files, tmp_path, name, run, assert_refused
):
    data = (house_files / "flat.png").read_bytes()
    (tmp_path / "empty.png").touch()
    (tmp_path / "truncated.png").write_bytes(data[: len(data) // 2])
    tifffile.imwrite(
        tmp_path / "nan.tif", np.full(house.flat.shape, np.inf, np.float32), photometric="rgb"
    )
    cv2.imwrite(str(tmp_path / "tiny.png"), house.flat[:40, :40])
    before = sorted(os.listdir(tmp_path))
    assert_refused(run("render", tmp_path / name, "-o", tmp_path / "picture.png"))
    assert_refused(
        run(
            "analyze",
            tmp_path / name,
            "-c",
            house_files / "camera.json",
            "-o",
            tmp_path / "depth.npz",
        )
    )
    assert sorted(os.listdir(tmp_path)) == before


@pytest.mark.parametrize(
    "command", ["render", "analyze", "refocus", "views", "view", "report", "batch"]
)
def test_outputs_of_a_suffix_that_a_command_does_not_write_are_refused_by_all_alike(
    ask, tmp_path, command, run, assert_refused
):
    more = ("--patch-size", "6") if command == "refocus" else ()
    output = ("--export" if command == "view" else "-o", tmp_path / "scene.obj")
    assert_refused(run(*ask(command, *more, *output)), "scene.obj: unknown output format '.obj'; ")
    if command not in ("views", "view", "batch"):
        assert_refused(run(*ask(command, *more, "-o", tmp_path / "no" / "scene.tif")))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("trimesh", "analyze -o scene.glb"),
        ("trimesh", "analyze -o depth.npz --mesh scene.ply"),
        ("OpenEXR", "analyze -o depth.npz --dense depth.exr"),
        ("zarr", "render -o picture.ome.zarr"),
        ("zarr", "volume -o volume.ome.zarr"),
        ("av", "views -o scene --poses rvs"),
        ("av", "refocus -o focus.mp4"),
        ("OpenEXR", "batch -o pictures --format exr"),
        ("distributed", "batch -o pictures --workers 2"),
        ("distributed", "render -o picture.tif --workers 2"),
    ],
)
def test_a_missing_package_is_told_before_the_flat_is_read(
    ask, tmp_path, monkeypatch, package, words, run, assert_refused
):
    def installed(name):
        return None if name == package else find_spec(name)

    def read(*_):
        raise AssertionError("the flat was read before the outputs were checked")

    monkeypatch.setattr(packages, "find_spec", installed)
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setattr(CaptureInput, "read_pixels", read)
    monkeypatch.setattr(CaptureInput, "open_frames", read)
    monkeypatch.chdir(tmp_path)
    told = f"the package '{package}': pip install '{package}>="
    assert_refused(run(*ask(*words.split())), told)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "words",
    [
        "analyze -o depth.npz --dense no/depth.tif",
        "analyze -o cloud.ply --mesh cloud.ply",
        "render -o no/picture.tif",
        "refocus --stack 3 -o no/stack.tif",
        "views -o no/views",
        "view --export no/page.html",
        "batch -o no/pictures",
        "batch -o pictures --depth-maps no/depth",
        "batch -o film.mkv --depth-maps ./film.mkv",
        "volume -o no/volumes",
    ],
)
def test_places_and_doubled_names_are_checked_before_the_flat_is_read(
    ask, tmp_path, monkeypatch, words, run, assert_refused
):
    def read(_):
        raise AssertionError("the flat was read before the outputs were checked")

    monkeypatch.setattr(CaptureInput, "read_pixels", read)
    monkeypatch.chdir(tmp_path)
    assert_refused(run(*ask(*words.split())))
    assert os.listdir(tmp_path) == []


def test_inputs_are_never_replaced(house, tmp_path, run, assert_refused):
    for name in ("flat.png", "white.png"):
        cv2.imwrite(str(tmp_path / name), house.flat)
    before = (tmp_path / "flat.png").read_bytes()
    os.symlink(tmp_path / "flat.png", tmp_path / "link.png")
    for output in ("flat.png", "white.png", "link.png"):
        words = ("--white", tmp_path / "white.png", "-o", tmp_path / output)
        assert_refused(run("render", tmp_path / "flat.png", *words), "input")
    assert_refused(
        run("render", tmp_path / "flat.png", "--alpha", "-o", tmp_path / "picture.jpg"), "alpha"
    )
    assert (tmp_path / "flat.png").read_bytes() == before


def test_a_folder_in_the_place_of_a_flat_points_to_batch(
    house_files, tmp_path, run, assert_refused
):
    refused = run("render", house_files, "-o", tmp_path / "p.png")
    assert_refused(refused, f"{house_files}: is a folder", "'lfrender batch'")
