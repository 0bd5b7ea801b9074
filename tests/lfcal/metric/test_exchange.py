"""Files of other programs: libpleno's, as published with the toolbox COMPOTE, and OpenCV's."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from lfcal import Board, BoardPose, Calibration, CameraFileError, Lattice, MetricCalibration, Optics
from lfcal.camera.optics import object_slopes
from lfcal.metric.bundle_adjustment import Observations
from lfcal.metric.exchange import equivalent_pinhole, read_libpleno, write_libpleno, write_pinhole

OPTICS = Optics(
    49.9,
    56.86,
    0.337,
    0.0055,
    principal_point=(410.0, 290.0),
    radial=(-0.8, 0.5, 0.0),
    tangential=(0.004, -0.002),
    tilt=(0.002, -0.001),
    microlens_focal_lengths=(0.58, 0.52, 0.56),
)
CAMERA = Calibration(Lattice((10, 10), [[20, 0], [0, 20]], (800, 600), 9.5), optics=OPTICS)


def _result():
    pose = BoardPose(
        "a.png",
        cv2.Rodrigues(np.array([0.1, 0.2, 0.3]))[0],
        np.array([1.0, 2, 400]),
        np.eye(6),
        0.1,
        9,
    )
    none = np.zeros((0, 2))
    seen = Observations(np.zeros(0), np.zeros(0), none, none, np.zeros(0))
    return MetricCalibration(
        CAMERA, Board(9, 6, 7.0), (pose,), (), seen, none, np.zeros(0, bool), 0.01, 1.0, (), ()
    )


def test_a_pinhole_of_opencv_sees_what_the_optics_see(tmp_path):
    pinhole = equivalent_pinhole(CAMERA)
    assert pinhole.error < 0.05  # px
    pixels = np.array([[20.0, 30.0], [700.0, 500.0]])
    focal = (OPTICS.mla_distance + OPTICS.sensor_distance) / OPTICS.pixel
    slopes = object_slopes(
        (pixels - OPTICS.principal_point) / focal, (*OPTICS.radial, *OPTICS.tangential)
    )
    points = np.column_stack([slopes, np.ones(2)]) * 400
    seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), pinhole.matrix, pinhole.distortion)[
        0
    ].reshape(-1, 2)
    np.testing.assert_allclose(seen, pixels, atol=0.05)
    for name in ("a.yml", "a.json"):
        write_pinhole(tmp_path / name, CAMERA)
        stored = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_READ)
        np.testing.assert_allclose(stored.getNode("camera_matrix").mat()[:2], pinhole.matrix[:2])


def test_a_camera_of_libpleno_is_written_and_read_back(tmp_path):
    write_libpleno(tmp_path / "camera.js", _result())
    found = read_libpleno(tmp_path / "camera.js")
    np.testing.assert_allclose(found.parameters[:10], OPTICS.parameters[:10], rtol=1e-9, atol=1e-12)
    assert found.microlens_focal_lengths == OPTICS.microlens_focal_lengths
    pose = json.loads((tmp_path / "camera-poses.js").read_text(encoding="utf-8"))["poses"][0][
        "pose"
    ]
    rotation = np.array(pose["rotation"], float)
    place = np.array(pose["translation"], float).ravel()
    # The camera in the frame of the board.
    np.testing.assert_allclose(-rotation.T @ place, [1, 2, 400], atol=1e-9)


def test_a_published_file_of_libpleno_is_read(tmp_path):
    path = tmp_path / "intrinsics.js"
    published = {
        "D": "56.859967077387466",
        "d": "0.33712571805114777",
        "distortions_inverse": {
            "radial": [
                ["-0.00024286960399023933", "2.9714668383971255e-06", "-1.0662185708637543e-08"]
            ],
            "tangential": [["0.00010892509120336487", "3.5396632437188866e-05"]],
        },
        "main_lens": {"f": "49.885285868753407"},
        "mla": {
            "focal_lengths": ["0.58266966865506242", "0.5240249316658897", "0.56057361553341034"]
        },
        "pp": [["2078.3472924350485", "1591.0025426088534"]],
        "sensor": {"scale": "0.0055"},
    }
    path.write_text(json.dumps(published))
    optics = read_libpleno(path)
    assert optics.focal_length == pytest.approx(49.885286)
    assert optics.radial[0] == pytest.approx(-0.7852, abs=1e-4)
    path.write_text(json.dumps({"D": "1"}))
    with pytest.raises(CameraFileError, match=r"intrinsics\.js"):
        read_libpleno(path)
    with pytest.raises(CameraFileError, match="lfcal metric"):
        equivalent_pinhole(replace(CAMERA, optics=None))
