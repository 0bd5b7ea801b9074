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
        lambda wrong: lfcal.check_camera(FLAT, wrong),
        lambda wrong: lfcal.check_fit(wrong, FLAT),
        lambda wrong: lfcal.show(wrong, FLAT),
        lambda wrong: lfcal.compare(CAMERA, wrong),
        lambda wrong: lfcal.calibrate_metric([FLAT] * 3, wrong, Board(9, 6, 7.0)),
        lambda wrong: lfcal.locate_board(FLAT, wrong, Board(9, 6, 7.0)),
        lambda wrong: lfrender.analyze(FLAT, wrong),
        lambda wrong: lfrender.refocus(FLAT, wrong, 5.0),
        lambda wrong: lfrender.traditional(FLAT, wrong),
        lambda wrong: list(lfrender.views(FLAT, wrong, None, offsets=[(0, 0)])),
    ],
)
def test_what_is_no_camera_is_named(call, wrong):
    with pytest.raises(
        TypeError, match=rf"must be a Calibration, got {type(wrong).__name__}; lfcal.calibrate"
    ):
        call(wrong)


BOARD = Board(9, 6, 7.0)
FIGURES = {"origin": [10, 10], "basis": [[20, 0], [0, 20]], "image_size": (400, 300), "radius": 9}


@pytest.mark.parametrize("wrong", [None, "text", object()], ids=["None", "str", "object"])
@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("image|^text: cannot be read", lfcal.calibrate),
        ("image", lambda wrong: lfcal.check_camera(wrong, CAMERA)),
        ("image", lambda wrong: lfcal.check_fit(CAMERA, wrong)),
        ("image", lambda wrong: lfcal.show(CAMERA, wrong)),
        ("kind", lambda wrong: lfcal.calibrate(FLAT, wrong)),
        ("mosaic", lambda wrong: lfcal.calibrate(FLAT, mosaic=wrong or 5)),
        ("pitch", lambda wrong: lfcal.calibrate(FLAT, pitch=wrong or [])),
        ("rotation", lambda wrong: lfcal.calibrate(FLAT, pitch=20, rotation=wrong or [])),
        ("flat", lambda wrong: lfcal.calibrate_metric(wrong, CAMERA, BOARD)),
        ("flat", lambda wrong: lfcal.calibrate_metric([wrong] * 3, CAMERA, BOARD)),
        (
            "pixel",
            lambda wrong: lfcal.calibrate_metric([FLAT] * 3, CAMERA, BOARD, pixel=wrong or []),
        ),
        ("board", lambda wrong: lfcal.calibrate_metric([FLAT] * 3, CAMERA, wrong)),
        ("board", lambda wrong: lfcal.locate_board(FLAT, CAMERA, wrong)),
        ("path", lambda wrong: lfcal.load(0 if wrong == "text" else wrong)),
        ("path", lambda wrong: lfcal.read_flat(0 if wrong == "text" else wrong)),
        ("path", lambda wrong: lfcal.count_pages(0 if wrong == "text" else wrong)),
        ("path", lambda wrong: lfcal.open_flat(0 if wrong == "text" else wrong)),
        ("path", lambda wrong: lfcal.Optics.load(0 if wrong == "text" else wrong)),
        ("path", lambda wrong: CAMERA.save(0 if wrong == "text" else wrong)),
        ("flat", lambda wrong: lfcal.subtract_dark(wrong, FLAT)),
        ("dark", lambda wrong: lfcal.subtract_dark(FLAT, wrong)),
        ("flat", CAMERA.flatten),
        ("image_size", lambda wrong: lfcal.state_lattice(wrong, 20)),
        ("pitch", lambda wrong: lfcal.state_lattice((400, 300), wrong)),
        ("arrangement", lambda wrong: lfcal.state_lattice((400, 300), 20, wrong)),
        ("rotation", lambda wrong: lfcal.state_lattice((400, 300), 20, rotation=wrong or [])),
        *((name, lambda wrong, name=name: Lattice(**FIGURES | {name: wrong})) for name in FIGURES),
        ("lattice", Calibration),
        ("white_level", lambda wrong: Calibration(CAMERA.lattice, white_level=wrong or [])),
        ("columns", lambda wrong: Board(wrong, 6, 7.0)),
        ("square", lambda wrong: Board(9, 6, wrong)),
        ("pattern", lambda wrong: Board(9, 6, 7.0, wrong)),
        ("lens types", lfcal.LensTypes),
        ("focus", lambda wrong: lfcal.LensTypes([[0]], focus=wrong or "a")),
        ("aperture", lambda wrong: lfcal.LensBlur(wrong, 1, [0.1], [0.1], [-0.3], [[1]], [[1]])),
        ("focus", lambda wrong: lfcal.LensBlur(5, 1, wrong, [0.1], [-0.3], [[1]], [[1]])),
        ("focal_length", lambda wrong: lfcal.Optics(wrong, 50, 0.7, 0.005)),
        ("covariance", lambda wrong: lfcal.Optics(50, 50, 0.7, 0.005, covariance=wrong or "a")),
    ],
)
def test_wrong_objects_are_refused_by_the_name_of_their_argument(name, call, wrong):
    with pytest.raises((TypeError, ValueError), match=name):
        call(wrong)


def test_what_is_no_depth_map_and_no_flat_is_named():
    with pytest.raises(TypeError, match="must be a DepthMap, got str"):
        lfrender.render(FLAT, CAMERA, "depth.npz")
    with pytest.raises(TypeError, match="must be a FlatSource, got NoneType"):
        lfrender.analyze_large(None, CAMERA)
    for call in (
        lfcal.calibrate,
        lambda flat: lfrender.analyze(flat, CAMERA),
        lambda flat: lfcal.subtract_dark(FLAT, flat),
    ):
        with pytest.raises(lfcal.FlatError):
            call(None)
