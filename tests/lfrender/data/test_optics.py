"""Distances from patch sizes are those at which the simulator placed the scenes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile

import lfcal
import lfrender
from data_synth import Camera, simulate
from data_synth.scenes import plane
from lfcal import CalibrationError, CameraFileError
from lfrender import DepthMap, Optics
from lfrender.data.dense_depth import DenseDepth, dense_distance, write_dense
from lfrender.data.surface import Surface
from lfrender.output.point_cloud import point_cloud, write_points

CAMERA = Camera.design(size=(420, 340), pitch=23.2, rotation=2.0)


def optics_of(camera):
    return Optics(camera.focal_length, camera.mla_distance, camera.sensor_distance, camera.pixel)


def test_distances_are_those_that_the_simulator_places_scenes_at():
    ratios = np.array([-0.7, -0.3, -0.1, 0.15, 0.3, 0.7])
    np.testing.assert_allclose(
        optics_of(CAMERA).distance(ratios), CAMERA.depth_at(ratios) / 1000, rtol=1e-9
    )


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
    for wrong, message in (
        ({"focal_length_mm": 50}, "mla_distance_mm"),
        ([], "JSON"),
        (None, "JSON"),
    ):
        path.write_text(json.dumps(wrong))
        with pytest.raises(CameraFileError, match=message):
            Optics.load(path)
    with pytest.raises(CameraFileError, match="cannot be read"):
        Optics.load(tmp_path / "none.json")
    with pytest.raises(ValueError, match="pixel"):
        Optics(50, 58, 0.7, -1)


def test_distances_of_a_tilted_camera_have_errors_of_its_calibration():
    calibration = CAMERA.calibration()
    plain = optics_of(CAMERA)
    covariance = np.zeros((14, 14))
    covariance[0, 0], covariance[10, 10] = 0.02**2, 0.0005**2
    tilted = replace(
        plain, principal_point=CAMERA.principal_point, tilt=(0.003, 0.0), covariance=covariance
    )
    n = len(calibration.lattice)
    surface = Surface(np.full((3, 3), -5, np.float32), (0.0, 0.0), 200.0)
    size = np.full(n, -0.3 * CAMERA.pitch)
    error = np.full(n, 0.05)
    depth = DepthMap(
        size, error, np.ones(n), size, surface, CAMERA.pitch, CAMERA.lattice.image_size
    )
    camera = replace(calibration, optics=tilted)
    away = depth.distance(camera)
    stated = depth.distance_error(camera)
    y = calibration.lattice.centres()[:, 1]
    # The lower part of a flat that lies farther back shows, with the same patch size, what is
    # nearer or farther.
    assert abs(np.corrcoef(y, away)[0, 1]) > 0.999
    np.testing.assert_allclose(np.median(away), np.median(depth.distance(plain)), rtol=2e-3)
    # By differences: of s, of F and of the tilt.
    parts = [
        depth.distance(
            replace(camera, optics=replace(tilted, focal_length=tilted.focal_length + 0.01))
        )
        - away
    ]
    parts[0] *= 2
    parts.append(
        5 * (depth.distance(replace(camera, optics=replace(tilted, tilt=(0.0031, 0.0)))) - away)
    )
    parts.append(
        tilted.distance((size + 0.05) / CAMERA.pitch, calibration.lattice.centres()) - away
    )
    np.testing.assert_allclose(stated, np.sqrt(sum(part**2 for part in parts)), rtol=0.02)
    with pytest.raises(CalibrationError, match="lfcal metric"):
        depth.distance(calibration)


def test_dense_depth_is_written_in_metres(tmp_path):
    dense = DenseDepth(
        np.full((4, 5), -0.3 * CAMERA.pitch, np.float32),
        np.array([[2.0, 0, 0], [0, 2.0, 0]]),
        CAMERA.pitch,
        np.full((4, 5), 255, np.uint8),
        np.full((4, 5), 0.01, np.float32),
    )
    distance = dense_distance(dense, optics_of(CAMERA))
    np.testing.assert_allclose(distance, CAMERA.depth_at(-0.3) / 1000, rtol=1e-6)
    write_dense(tmp_path / "depth.tif", dense, distance)
    with tifffile.TiffFile(tmp_path / "depth.tif") as tiff:
        assert "[m]" in tiff.pages[0].description


@pytest.mark.parametrize("field", ["focal_length_mm", "pupil_mm", "curvature", "radial", "tilt"])
def test_numbers_of_many_digits_are_refused_in_one_short_line(tmp_path, field):
    path = tmp_path / "optics.json"
    data = optics_of(CAMERA).to_dict()
    number = 10**400
    data[field] = [number] * len(data[field]) if isinstance(data[field], list) else number
    path.write_text(json.dumps(data))
    with pytest.raises(CameraFileError, match=f"{field.removesuffix('_mm')} must be") as caught:
        Optics.load(path)
    assert len(str(caught.value)) < 400 and "\n" not in str(caught.value)


def test_distances_of_lengths_that_are_not_known_have_infinite_errors():
    covariance = np.zeros((14, 14))
    covariance[1, 1] = 1e12
    optics = replace(optics_of(CAMERA), covariance=covariance)
    errors = optics.distance_error([-0.3, np.nan], [0.01, 0.01])
    np.testing.assert_array_equal(errors, [np.inf, np.nan])


def test_a_covariance_that_is_none_gives_infinite_errors_instead_of_negative_lengths():
    covariance = np.eye(14)
    covariance[0, 1] = covariance[1, 0] = 1e12
    optics = lfcal.Optics(50, 58, 0.7, 0.005, covariance=covariance)
    assert np.isinf(optics.distance_error(np.array([0.3]), np.array([0.001])))
