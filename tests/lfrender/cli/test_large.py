"""The lfrender command on large flats: tiles, interrupted runs, refusals."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import tifffile

import lfcal
import lfrender
from lfrender.output.tiled_picture import TileWriter


@pytest.fixture
def everything_is_large(monkeypatch):
    for command in ("render", "analyze"):
        monkeypatch.setattr(f"lfrender.cli.{command}.is_large", lambda flat: flat.suffix == ".tif")


def as_tiff(house_files, tmp_path):
    path = tmp_path / "flat.tif"
    tifffile.imwrite(path, lfcal.read_flat(house_files / "flat.png"), photometric="rgb")
    return path


def test_a_large_flat_is_rendered_in_tiles_to_the_same_picture(
    house_files, tmp_path, everything_is_large, figures_of
):
    flat = as_tiff(house_files, tmp_path)
    camera = house_files / "camera.json"
    options = ("-c", camera, "--patch-size", "7.5")
    large = figures_of("render", flat, *options, "-o", tmp_path / "large.tif", "--tile", "60")
    small = figures_of("render", house_files / "flat.png", *options, "-o", tmp_path / "small.tif")
    assert large["tiles"] > 4
    assert {name: large[name] for name in ("size", "affine", "scale")} == {
        name: small[name] for name in ("size", "affine", "scale")
    }
    assert (tmp_path / "large.tif").read_bytes() == (tmp_path / "small.tif").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["flat.tif", "large.tif", "small.tif"]


def test_a_large_flat_is_calibrated_analysed_and_rendered_and_an_interrupted_run_is_continued(
    house_files, tmp_path, everything_is_large, monkeypatch, run, figures_of, assert_refused
):
    flat = as_tiff(house_files, tmp_path)
    camera = house_files / "camera.json"
    ask = (
        "render",
        flat,
        "-c",
        camera,
        "-o",
        tmp_path / "picture.tif",
        "--preset",
        "fast",
        "--tile",
        "60",
    )
    writer = TileWriter
    written = writer.write

    def stopped(self, tile, pixels):
        if tile[:2] != (0, 0):
            raise lfcal.OutputError("the disk is full")
        written(self, tile, pixels)

    with monkeypatch.context() as patch:
        patch.setattr(writer, "write", stopped)
        assert_refused(run(*ask), "the disk is full")
    assert not (tmp_path / "picture.tif").exists()
    monkeypatch.setattr(lfrender, "analyze_large", None)
    figures = figures_of(*ask)
    assert figures["tiles_kept"] == 1
    assert figures["modes"]["telescopic"] > 0.3
    assert lfcal.read_flat(tmp_path / "picture.tif").std() > 20
    assert sorted(os.listdir(tmp_path)) == ["flat.tif", "picture.tif"]


def test_depth_of_a_large_flat_needs_nothing_but_the_flat(
    house_files, tmp_path, everything_is_large, figures_of
):
    flat = as_tiff(house_files, tmp_path)
    found = figures_of("analyze", flat, "-o", tmp_path / "depth.npz", "--preset", "fast")
    assert found["camera_source"] == "scene"
    assert found["modes"]["telescopic"] > 0.3


def test_refusals_in_tiles_leave_nothing_behind(house_files, tmp_path, run, assert_refused):
    flat = as_tiff(house_files, tmp_path)
    camera = house_files / "camera.json"
    ask = ("render", flat, "-c", camera, "--tile", "60", "--patch-size")
    assert_refused(
        run(*ask, "900", "-o", tmp_path / "a.tif"), "--patch-size must lie between", "got 900."
    )
    assert_refused(run(*ask, "7", "-o", flat), "is an input")
    assert_refused(run(*ask, "7", "-o", tmp_path / "a.gif"), "unknown output format")
    assert os.listdir(tmp_path) == ["flat.tif"]


def test_a_second_process_with_the_same_output_ends_with_2_and_names_the_first(
    house_files, tmp_path, everything_is_large, run, assert_refused, figures_of
):
    flat = as_tiff(house_files, tmp_path)
    output = tmp_path / "picture.tif"
    ask = ("render", flat, "-c", house_files / "camera.json", "--patch-size", "7.5", "-o", output)
    hold = "import sys; from lfcal.runtime.output_file import claim\n"
    hold += "with claim(sys.argv[1]): print('claimed', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", hold, str(output)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as one:
        assert one.stdout.readline() == "claimed\n"
        assert_refused(run(*ask), f"is being written by process {one.pid} on ")
        one.kill()
    assert not output.exists()
    # The lock of a killed process is taken over.
    assert (tmp_path / ".picture.tif.lock").exists()
    assert figures_of(*ask)["tiles"] >= 1
    assert sorted(os.listdir(tmp_path)) == ["flat.tif", "picture.tif"]
