"""The model of the camera: its derivatives, its closed form, its inverse."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Optics
from lfcal.metric.camera_model import INTERNAL, from_internal, project, project_derivatives

from ._cameras import PIXEL, camera

BENT = {
    "k1": -0.8,
    "k2": 0.3,
    "k3": 0.1,
    "p1": 0.01,
    "p2": -0.02,
    "tilt_x": 0.01,
    "tilt_y": -0.02,
    "curvature": 0.3,
    "pupil": 5.0,
}


def _points(values, seed=0, n=30):
    rng = np.random.default_rng(seed)
    points = rng.uniform([-50, -50, 400], [50, 50, 900], (n, 3))
    seen = points[:, :2] / points[:, 2:] * values[0] + values[3:5]
    return points, seen + rng.normal(0, 20, (n, 2))


def test_without_tilt_and_distortion_it_is_the_formula_of_the_rendering():
    values = camera()
    points, centres = _points(values)
    scene = values[3:5] + values[0] * points[:, :2] / points[:, 2:]
    ratio = 1 / (values[1] + values[2] / points[:, 2:])
    np.testing.assert_allclose(
        project(values, PIXEL, points, centres), centres - (scene - centres) * ratio, atol=1e-9
    )


@pytest.mark.parametrize("lengths", [(28.0, 27.8, 0.42), (50.0, 58.0, 0.7), (100.0, 104.0, 1.2)])
def test_derivatives_are_those_of_differences(lengths):
    values = camera(lengths, **BENT)
    points, centres = _points(values)
    by_camera, by_point = project_derivatives(values, PIXEL, points, centres)
    for number, name in enumerate(INTERNAL):
        step = 1e-3 if name in ("focal_px", "per_depth") else 1e-5 * max(1, abs(values[number]))
        ends = [
            project(values + sign * step * np.eye(14)[number], PIXEL, points, centres)
            for sign in (1, -1)
        ]
        expected = (ends[0] - ends[1]) / (2 * step)
        assert np.abs(by_camera[:, :, number] - expected).max() < 1e-4 * np.abs(expected).max(), (
            name
        )
    for axis in range(3):
        ends = [
            project(values, PIXEL, points + s * 1e-4 * np.eye(3)[axis], centres) for s in (1, -1)
        ]
        np.testing.assert_allclose(
            by_point[:, :, axis], (ends[0] - ends[1]) / 2e-4, rtol=1e-4, atol=1e-6
        )


def test_positions_of_the_optics_are_the_inverse_of_the_projection():
    values = camera((50.0, 58.0, 0.7), **BENT)
    points, _ = _points(values)
    optics = Optics(1, 1, 1, PIXEL, (0, 0)).with_parameters(
        [*from_internal(values[:3], PIXEL), *values[3:]]
    )
    for point in points:
        # The lens that shows the point at its own centre, by iteration, and the patch size about
        # it.
        centre = values[3:5] + values[0] * point[:2] / point[2]
        for _ in range(40):
            centre = centre - (
                project(values, PIXEL, point[None], centre[None])[0] - centre
            ) / ratio(values, point, centre)
        found = optics.positions(centre[None], [ratio(values, point, centre)])[0] * 1000
        np.testing.assert_allclose(found, point, atol=0.05)


def ratio(values, point, centre):
    """`s / D`: how fast the point moves in the microimages from lens to lens, without their own
    steps.
    """
    step = 1e-3
    moved = [
        project(values, PIXEL, point[None], centre[None] + [[sign * step, 0]])[0, 0]
        for sign in (1, -1)
    ]
    return (moved[0] - moved[1]) / (2 * step) - 1
