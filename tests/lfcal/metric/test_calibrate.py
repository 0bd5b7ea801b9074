"""Metric calibration of the ray-traced boards beside the repository, and what it says to flats that
tell nothing.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

import lfcal
from lfcal import Board, BoardError, Calibration, FlatError, Lattice, calibrate_metric, locate_board
from lfcal.boards.detection import FocusSweep
from lfcal.metric.calibrate import _first
from lfcal.metric.observe import BoardFlat, prepare

from ._cameras import camera, detect, poses

LATTICE = Lattice((10, 10), [[28.3, 0], [0, 28.3]], (1600, 1200), 13.0)


@pytest.fixture(scope="module")
def boards(shared):
    """Truth, camera and a reader of the flats."""
    folder = shared("boards")
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    known = truth["camera"]
    lattice = Lattice(
        known["origin_px"],
        [known["a1_px"], known["a2_px"]],
        (known["width"], known["height"]),
        14.1,
    )
    return (
        truth,
        Calibration(lattice),
        lambda k: lfcal.read_flat(folder / truth["poses"][k]["file"]),
    )


@pytest.fixture(scope="module")
def measured(boards):
    _, camera, flat = boards
    return calibrate_metric(
        [flat(k) for k in (1, 5, 8, 11)], camera, board=(9, 6), square=7.0, pixel=0.0055
    )


def test_optics_of_a_ray_traced_camera_lie_within_the_stated_errors(boards, measured):
    known = boards[0]["camera"]
    true = [
        known["F_mm"],
        known["mainlens_to_mla_mm"],
        known["mla_to_sensor_mm"],
        *known["principal_point_px"],
    ]
    off = measured.optics.parameters[:6] - [*true, known["k1"]]
    errors = measured.optics.standard_errors[:6]
    assert (np.abs(off) < 3.5 * errors).all()
    assert errors[0] < 0.1  # mm
    assert measured.rms < 0.03  # px
    assert measured.board == Board(9, 6, 7.0)
    assert any("hardly separate" in note for note in measured.degeneracies)


def test_boards_tell_aperture_and_focus_of_the_microlenses(boards, measured):
    known = boards[0]["camera"]
    near = known["mla_to_sensor_mm"]
    slope = near / known["mainlens_to_mla_mm"]
    focus = (near / known["microlens_f_mm"][0] - 1 - slope) / (1 + slope)
    aperture = known["microlens_aperture_mm"] / known["microlens_pitch_mm"] * known["D_px"]
    blur = measured.calibration.lens_blur
    assert blur.tells_aperture
    assert abs(blur.aperture - aperture) < blur.aperture_error < 0.2 * aperture
    assert abs(blur.focus[0] - focus) < blur.focus_error[0] < 0.05
    truth = aperture * np.abs(blur.ratios - focus)
    assert np.abs(blur.discs - truth).max() < 0.15  # px


def test_boards_are_placed_to_a_tenth_of_a_degree_and_three_thousandths_in_depth(boards, measured):
    for pose, k in zip(measured.poses, (1, 5, 8, 11), strict=True):
        true = boards[0]["poses"][k]
        turn = np.rad2deg(
            np.arccos(np.clip((np.trace(pose.rotation @ np.transpose(true["R"])) - 1) / 2, -1, 1))
        )
        off = pose.translation - true["t_mm"]
        assert turn < 0.1
        assert np.abs(off[:2]).max() < 0.2  # mm
        assert abs(off[2]) < 0.003 * true["t_mm"][2]


def test_corners_of_a_pose_left_out_are_measured_in_depth(boards, measured):
    true = boards[0]["poses"][10]
    pose = locate_board(boards[2](10), measured.calibration, measured.board, name=true["file"])
    corners = np.array(true["corners_mm"])
    off = pose.place(measured.board.points) - corners
    assert np.median(np.abs(off[:, 2]) / corners[:, 2]) < 0.003
    assert np.median(np.hypot(*off[:, :2].T) / corners[:, 2]) < 0.001
    assert (np.abs(pose.translation - true["t_mm"]) < 3.5 * pose.standard_errors[3:]).all()


def test_distances_of_a_camera_file_have_errors(measured, tmp_path):
    measured.calibration.save(tmp_path / "camera.json")
    optics = lfcal.load(tmp_path / "camera.json").optics
    assert optics == measured.optics
    error = optics.distance_error([-0.3], [0.0])
    assert 0 < error[0] < 0.003 * optics.distance([-0.3])[0]
    assert optics.distance_error([-0.3], [0.001])[0] > error[0]


def test_poses_that_are_alike_are_named():
    rng = np.random.default_rng(1)
    where = poses(rng, 4, near=500, far=505, tilt=0.01)
    with pytest.raises(BoardError, match="are alike"):
        _first(detect(camera(), where, rng, 1e-4), Calibration(LATTICE), Board(9, 6, 7.0))


def test_another_number_of_squares_is_named(boards):
    flat = prepare(
        boards[2](11), "b.png", boards[1], Board(11, 7, 7.0), FocusSweep(boards[1].lattice)
    )
    assert flat.other == "9 x 6"
    assert (flat.detected is None) == ("9 x 6" in flat.reason)


def test_a_board_of_another_size_than_most_flats_show_is_refused(monkeypatch):
    blank = Calibration(Lattice((10, 10), [[20, 0], [0, 20]], (200, 160), 9.5))
    seen = lambda flat, name, **_: BoardFlat(name, flat, None, other="9 x 6")  # noqa: E731
    monkeypatch.setattr("lfcal.metric.calibrate.prepare", seen)
    with pytest.raises(
        BoardError, match="3 flats show a checkerboard of 9 x 6 corners, not of 8 x 6"
    ):
        calibrate_metric([np.zeros((160, 200))] * 3, blank, (8, 6), 7.0, pixel=0.0055)


def test_flats_without_a_board_are_named():
    blank = Calibration(Lattice((10, 10), [[20, 0], [0, 20]], (200, 160), 9.5))
    rng = np.random.default_rng(0)
    flats = [rng.integers(0, 255, (160, 200), dtype=np.uint8) for _ in range(3)]
    with pytest.raises(BoardError, match=r"found on 0 of 3 flats.*a\.png"):
        calibrate_metric(flats, blank, Board(9, 6, 7.0), names=["a.png", "b.png", "c.png"])
    with pytest.raises(BoardError, match="2 flats"):
        calibrate_metric(flats[:2], blank, Board(9, 6, 7.0))
    with pytest.raises(FlatError, match=r"c\.png"):
        calibrate_metric(
            [*flats[:2], flats[0][:100]], blank, Board(9, 6, 7.0), names=["a", "b", "c.png"]
        )


@pytest.mark.parametrize("arguments", [(1, 6, 7.0), (9, 6, -1.0), (9, 6, 7.0, "charuco", 8.0)])
def test_boards_that_cannot_be_are_refused(arguments):
    with pytest.raises(BoardError):
        Board(*arguments)
