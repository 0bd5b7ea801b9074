"""`lfcal metric` and `lfcal board` from the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
from lfcal.cli.main import main


def test_optics_are_added_to_the_camera_file(shared, tmp_path):
    folder = shared("boards")
    known = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["camera"]
    lattice = lfcal.Lattice(
        known["origin_px"], [known["a1_px"], known["a2_px"]], (1600, 1200), 14.1
    )
    camera = tmp_path / "camera.json"
    poses = tmp_path / "poses.json"
    pinhole = tmp_path / "camera.js"
    lfcal.Calibration(lattice).save(camera)
    flats = [str(folder / f"flat_{k:02d}.png") for k in (6, 8, 11)]
    words = [
        "metric",
        *flats,
        "-c",
        str(camera),
        "--board",
        "9x6",
        "--square",
        "7mm",
        "--pixel",
        "5.5",
        "--json",
    ]
    words += ["--focal-length", "50 mm"]
    done = CliRunner().invoke(
        main, [*words, "-o", str(camera), "--poses", str(poses), "--exchange", str(pinhole)]
    )
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    optics = figures["optics"]
    assert abs(optics["focal_length_mm"] - known["F_mm"]) < 4 * optics["focal_length_mm_error"]
    assert len(figures["cramer_rao_position_mm"]) == 3
    assert any(
        "mm, and not 50 mm as stated: --pixel is wrong" in warning
        for warning in figures["warnings"]
    )
    assert lfcal.load(camera).optics.focal_length == pytest.approx(
        optics["focal_length_mm"], rel=1e-6
    )
    stored = json.loads(poses.read_text(encoding="utf-8"))
    assert [pose["flat"] for pose in stored["poses"]] == [
        "flat_06.png",
        "flat_08.png",
        "flat_11.png",
    ]
    assert (tmp_path / "camera-poses.js").exists()


def test_flats_without_a_board_are_named_in_one_line(tmp_path):
    camera = tmp_path / "camera.json"
    lfcal.Calibration(lfcal.Lattice((10, 10), [[20, 0], [0, 20]], (200, 160), 9.5)).save(camera)
    import cv2

    flats = [str(tmp_path / f"{k}.png") for k in range(3)]
    for flat in flats:
        cv2.imwrite(flat, np.full((160, 200), 90, np.uint8))
    words = ["metric", *flats, "-c", str(camera), "--square", "7", "-o", str(tmp_path / "new.json")]
    done = CliRunner().invoke(main, [*words, "--board", "9x6"])
    assert done.exit_code == 2
    assert "0.png: the picture has no contrast" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "such as 9x6" in CliRunner().invoke(main, [*words, "--board", "9"]).stderr


def test_a_board_to_print_is_written(tmp_path):
    words = [
        "board",
        "--board",
        "9x6",
        "--square",
        "12",
        "-o",
        str(tmp_path / "board.pdf"),
        "--json",
    ]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
