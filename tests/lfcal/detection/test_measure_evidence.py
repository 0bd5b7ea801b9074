"""Figures of the evidence for a lattice."""

from __future__ import annotations

import numpy as np

from lfcal.detection.measure_evidence import Marks
from lfcal.hough.circle_vote import Circles


def test_circles_that_noise_shows_on_dark_parts_are_left_out():
    picture = np.full((300, 400), 0.05, np.float32)
    picture[:, :200] = 1.0
    x, y = np.meshgrid(np.arange(10.0, 400, 20), np.arange(10.0, 300, 20))
    centres = np.column_stack([x.ravel(), y.ravel()])
    marks = Marks.of(Circles(centres, np.full(len(centres), 9.0)), picture, 20.0)
    assert len(centres) / 2 <= len(marks.centres) < 0.6 * len(centres)
    assert marks.centres[:, 0].max() < 230
