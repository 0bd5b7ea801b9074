"""Photographs of boards: rays through tilted arrays and distorting lenses, and the files of a
shoot.
"""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import data_synth.cli
from data_synth import SCENES, Camera, shoot_board, simulate
from data_synth.tracing import _bent, _camera_vector
from lfcal.metric.camera_model import project, to_internal

BENT = Camera.design(size=(400, 320), pitch=24.0, rotation=1.0).replace(
    k1=-0.3, tilt=(0.003, -0.002)
)


def test_rays_through_a_tilted_array_meet_the_points_that_the_model_of_the_calibration_projects():
    values = np.zeros(14)
    lengths = np.array([BENT.focal_length, BENT.mla_distance, BENT.sensor_distance])
    values[:3] = to_internal(lengths, BENT.pixel)[0]
    values[3:5], values[5], values[10:12] = BENT.principal_point, BENT.k1, BENT.tilt
    rng = np.random.default_rng(0)
    depth = BENT.depth_at(rng.uniform(0.2, 0.4, 40))
    points = np.column_stack([rng.uniform(-6, 6, (40, 2)), depth])
    scene = values[0] * points[:, :2] / points[:, 2:] + values[3:5]
    centres = scene + rng.uniform(-24, 24, (40, 2))
    seen = project(values, BENT.pixel, points, centres)
    vector = _camera_vector(BENT)
    for point, centre, position in zip(points, centres, seen, strict=True):
        x, y = (centre - BENT.principal_point) * BENT.pixel / BENT.spread
        u, v = (position - BENT.principal_point) * BENT.pixel - BENT.sensor_distance * vector[25:27]
        _, _, ax, ay, sx, sy = _bent(
            vector, x, y, (x - u) / BENT.sensor_distance, (y - v) / BENT.sensor_distance
        )
        met = -np.array([ax + sx * point[2], ay + sy * point[2]])
        # A tenth of a pixel of the scene: each takes distortion to be linear, about another ray.
        np.testing.assert_allclose(met, point[:2], atol=0.1 * point[2] / values[0])


def test_a_shoot_of_boards_is_written_with_its_truth(tmp_path):
    words = [
        "board",
        "-o",
        str(tmp_path),
        "--size",
        "560x440",
        "--pitch",
        "22",
        "--poses",
        "1",
        "--samples",
        "4",
    ]
    done = CliRunner().invoke(
        data_synth.cli.main, [*words, "--range", "0.25,0.3", "--tilt", "0.1,0", "--json"]
    )
    assert done.exit_code == 0, done.output
    truth = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    assert truth["board"]["square_mm"] == json.loads(done.output)["square_mm"]
    assert truth["poses"][0]["file"] == "flat_00.png"
    assert cv2.imread(str(tmp_path / "flat_00.png"), cv2.IMREAD_UNCHANGED).shape == (440, 560)
    assert (tmp_path / "camera.json").exists()


def test_scenes_of_bent_cameras_are_refused():
    with pytest.raises(ValueError, match="shoot_board"):
        simulate(SCENES["blank"](BENT), BENT, samples=1)
    with pytest.raises(ValueError, match="one sign"):
        shoot_board(BENT, 1, ratios=(-0.2, 0.2))
