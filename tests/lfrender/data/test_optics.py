"""Distances from patch sizes are those at which the simulator placed the scenes."""

from __future__ import annotations

import json

import numpy as np
import pytest

import lfrender
from data_synth import Camera, simulate
from data_synth.scenes import plane
from lfcal import CameraFileError
from lfrender import Optics
from lfrender.output.point_cloud import point_cloud, write_points

CAMERA = Camera.design(size=(420, 340), pitch=23.2, rotation=2.0)


def optics_of(camera):
    return Optics(camera.focal_length, camera.mla_distance, camera.sensor_distance, camera.pixel)


def test_distances_are_those_that_the_simulator_places_scenes_at():
    ratios = np.array([-0.7, -0.3, -0.1, 0.15, 0.3, 0.7])
    np.testing.assert_allclose(optics_of(CAMERA).distance(ratios), CAMERA.depth_at(ratios) / 1000, rtol=1e-9)


def test_image_points_without_an_object_have_no_distance():
    camera = CAMERA
    limit = camera.patch_size(1e12) / camera.pitch
    found = optics_of(camera).distance([limit + 1e-3, limit - 1e-3, np.nan])
    assert found[0] > 0
    assert np.isnan(found[1:]).all()


def test_a_plane_is_measured_in_metres_and_its_points_lie_on_it(tmp_path):
    shot = simulate(plane(CAMERA, ratio=-0.3), CAMERA, samples=24, seed=1)
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    optics = optics_of(CAMERA)
    true = float(CAMERA.depth_at(-0.3)) / 1000
    assert abs(np.nanmedian(depth.distance(optics)) / true - 1) < 0.003
    assert (np.isnan(depth.distance(optics)) == (depth.mode == 0)).all()
    points = point_cloud(shot.flat, shot.truth.calibration, depth, optics)
    assert np.abs(points["z"] / true - 1).max() < 0.01
    corners = CAMERA.place([(0, 0), (419, 339)], true * 1000) / 1000
    for name, axis in (("x", 0), ("y", 1)):
        assert abs(np.ptp(points[name]) / np.ptp(corners[:, axis]) - 1) < 0.1
    write_points(tmp_path / "cloud.ply", points, metres=True)
    assert b"comment metres" in (tmp_path / "cloud.ply").read_bytes()[:200]


def test_optics_are_kept_in_a_file_and_wrong_ones_refused(tmp_path):
    path = tmp_path / "optics.json"
    optics = optics_of(CAMERA)
    optics.save(path)
    assert Optics.load(path) == optics
    for wrong, message in (({"focal_length_mm": 50}, "mla_distance_mm"), ([], "JSON"), (None, "JSON")):
        path.write_text(json.dumps(wrong))
        with pytest.raises(CameraFileError, match=message):
            Optics.load(path)
    with pytest.raises(CameraFileError, match="cannot be read"):
        Optics.load(tmp_path / "none.json")
    with pytest.raises(ValueError, match="pixel"):
        Optics(50, 58, 0.7, -1)
