"""The start of the adjustment: no focal length given, no pose mirrored."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lfcal.metric.start import first_camera

from ._cameras import BOARD, camera, detect, poses


@pytest.mark.parametrize("seed", [5, 6])
def test_poses_of_a_cold_start_are_not_mirrored(seed):
    rng = np.random.default_rng(seed)
    where = poses(rng, 5)
    start = first_camera(detect(camera(k1=-0.3), where, rng), BOARD, (1600, 1200))
    assert start is not None
    for found, true in zip(start[1].rotation, where.rotation, strict=True):
        assert np.rad2deg(np.linalg.norm(cv2.Rodrigues(found @ true.T)[0])) < 8
    assert 0.7 < start[0][0] / camera()[0] < 1.4
