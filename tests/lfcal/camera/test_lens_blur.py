"""The blur of microlenses is kept in the camera file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal import Calibration, CameraFileError, Lattice, LensBlur
from lfcal.cli.figures import describe, summarise

CAMERA = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (200, 100), 9))
BLUR = LensBlur(5.0, 0.5, [0.1, -0.1], [0.02, 0.03], [-0.3, -0.2, -0.1], np.ones((2, 3)), np.full((2, 3), 0.1))


def test_a_camera_file_keeps_it(tmp_path):
    replace(CAMERA, lens_blur=BLUR).save(tmp_path / "camera.json")
    read = lfcal.load(tmp_path / "camera.json").lens_blur
    assert read.to_dict() == BLUR.to_dict()
    assert not read.discs.flags.writeable


def test_wrong_ones_are_refused():
    with pytest.raises(ValueError, match="discs"):
        LensBlur(5.0, 0.5, [0.1], [0.02], [-0.3], np.ones((2, 3)), np.ones((2, 3)))
    with pytest.raises(ValueError, match="positive"):
        LensBlur(0.0, 0.5, [0.1], [0.02], [-0.3], [[1.0]], [[1.0]])
    data = replace(CAMERA, lens_blur=BLUR).to_dict()
    del data["lens_blur"]["discs"]
    with pytest.raises(CameraFileError, match="lens_blur"):
        Calibration.from_dict(data)


def test_it_is_printed_in_a_plain_sentence():
    assert len(summarise(CAMERA)) == 2
    assert summarise(replace(CAMERA, lens_blur=BLUR))[2] == (
        "Microlenses blur over discs of 1.0 to 1.0 px at s / D from -0.30 to -0.10."
    )
    assert describe(replace(CAMERA, lens_blur=BLUR))["lens_blur"]["aperture"] == 5.0
