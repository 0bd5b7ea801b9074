"""Files of a capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lfcal
from data_synth import SCENES, Camera, Capture, load_capture, simulate


def test_save_and_load_keep_everything(house: Capture, tmp_path: Path) -> None:
    house.save(tmp_path / "capture")
    loaded = load_capture(tmp_path / "capture")
    assert np.array_equal(loaded.flat, house.flat)
    assert loaded.flat.dtype == house.flat.dtype
    assert np.array_equal(loaded.white, house.white)
    assert loaded.camera == house.camera
    assert loaded.recipe == house.recipe
    for name in vars(house.truth):
        if name != "calibration":
            assert np.array_equal(
                getattr(loaded.truth, name), getattr(house.truth, name), equal_nan=name != "mixed"
            )
    assert np.array_equal(
        loaded.truth.calibration.lattice.centres(), house.truth.calibration.lattice.centres()
    )
    assert sorted(p.name for p in (tmp_path / "capture").iterdir()) == [
        "camera.json",
        "flat.png",
        "reference.png",
        "truth.json",
        "truth.npz",
        "white.png",
    ]


def test_camera_file_is_one_that_lfcal_reads(house: Capture, tmp_path: Path) -> None:
    house.save(tmp_path)
    calibration = lfcal.load(tmp_path / "camera.json")
    assert calibration.source == "truth"
    assert calibration.lattice.pitch == pytest.approx(house.camera.pitch)
    assert calibration.vignetting is not None
    assert calibration.vignetting.at(0.0) > 0.97
    assert calibration.vignetting.at(house.camera.pitch / 2 + 1) < 0.3


def test_true_vignetting_is_that_of_the_stored_flat() -> None:
    camera = Camera.design((200, 200), 24.0)
    for gamma in (False, True):
        capture = simulate(SCENES["blank"](camera), camera, samples=64, bits=16, gamma=gamma)
        vignetting = capture.truth.calibration.vignetting
        assert vignetting is not None
        centres = capture.truth.calibration.lattice.centres()
        inner = centres[(np.abs(centres - 100) < 70).all(1)]
        light = [
            np.mean(
                [capture.flat[round(y), round(x + away), 1] for x, y in inner]
                + [capture.flat[round(y), round(x - away), 1] for x, y in inner]
            )
            for away in (0, 10)
        ]
        assert vignetting.at(10.0) / vignetting.at(0.0) == pytest.approx(
            light[1] / light[0], abs=0.002
        )


@pytest.mark.parametrize("damage", ["missing", "not json", "other json", "no arrays", "no picture"])
def test_damaged_folders_are_refused_with_the_place(
    house: Capture, tmp_path: Path, damage: str
) -> None:
    house.save(tmp_path)
    if damage == "missing":
        (tmp_path / "truth.json").unlink()
    elif damage == "not json":
        (tmp_path / "truth.json").write_text("{")
    elif damage == "other json":
        (tmp_path / "truth.json").write_text("[1]")
    elif damage == "no arrays":
        (tmp_path / "truth.npz").write_bytes(b"no")
    else:
        (tmp_path / "flat.png").write_bytes(b"no")
    with pytest.raises((OSError, ValueError), match=str(tmp_path)):
        load_capture(tmp_path)
