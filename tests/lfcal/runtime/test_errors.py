"""Arguments of another kind are named in one sentence."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
import lfrender
from lfcal import Board, Calibration, Lattice

FLAT = np.full((300, 400), 100, np.uint8)
CAMERA = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9))


@pytest.mark.parametrize("wrong", [None, "camera.json"])
@pytest.mark.parametrize(
    "call",
    [
        lambda wrong: lfcal.check_camera(wrong, FLAT),
        lambda wrong: lfcal.check_fit(wrong, FLAT),
        lambda wrong: lfcal.show(wrong, FLAT),
        lambda wrong: lfcal.compare(CAMERA, wrong),
        lambda wrong: lfcal.calibrate_metric([FLAT] * 3, wrong, Board(9, 6, 7.0)),
        lambda wrong: lfcal.locate_board(FLAT, wrong, Board(9, 6, 7.0)),
        lambda wrong: lfrender.analyze(FLAT, wrong),
        lambda wrong: lfrender.render(FLAT, wrong, patch_size=5),
        lambda wrong: lfrender.refocus(FLAT, wrong, 5.0),
        lambda wrong: lfrender.traditional(FLAT, wrong),
        lambda wrong: list(lfrender.views(FLAT, wrong, None, offsets=[(0, 0)])),
    ],
)
def test_what_is_no_camera_is_named(call, wrong):
    with pytest.raises(TypeError, match=rf"must be a Calibration, got {type(wrong).__name__}; lfcal.calibrate"):
        call(wrong)


def test_what_is_no_depth_map_no_flat_and_no_board_is_named():
    with pytest.raises(TypeError, match="must be a DepthMap, got str"):
        lfrender.render(FLAT, CAMERA, "depth.npz")
    with pytest.raises(TypeError, match="must be a FlatSource, got NoneType"):
        lfrender.analyze_large(None, CAMERA)
    with pytest.raises(TypeError, match="must be a Board, got NoneType"):
        lfcal.calibrate_metric([FLAT] * 3, CAMERA, None)
    for call in (
        lfcal.calibrate,
        lambda flat: lfrender.analyze(flat, CAMERA),
        lambda flat: lfcal.subtract_dark(FLAT, flat),
    ):
        with pytest.raises(lfcal.FlatError):
            call(None)
