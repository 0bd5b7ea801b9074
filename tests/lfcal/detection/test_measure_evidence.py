"""Figures of the evidence for a lattice."""

from __future__ import annotations

import numpy as np

from lfcal.detection.cell_maps import CellMaps
from lfcal.detection.features import FlatFeatures
from lfcal.detection.measure_evidence import Marks, half_cell_likeness
from lfcal.hough.circle_vote import Circles


def test_circles_that_noise_shows_on_dark_parts_are_left_out():
    picture = np.full((300, 400), 0.05, np.float32)
    picture[:, :200] = 1.0
    x, y = np.meshgrid(np.arange(10.0, 400, 20), np.arange(10.0, 300, 20))
    centres = np.column_stack([x.ravel(), y.ravel()])
    marks = Marks.of(Circles(centres, np.full(len(centres), 9.0)), picture, 20.0)
    assert len(centres) / 2 <= len(marks.centres) < 0.6 * len(centres)
    assert marks.centres[:, 0].max() < 230


def test_a_multiple_of_the_cell_shows_the_same_twice():
    y, x = np.indices((200, 240))
    waves = np.cos(2 * np.pi * x / 8) + np.cos(2 * np.pi * y / 10)
    features = FlatFeatures((1 + np.exp(waves)).astype(np.float32))
    repeated = [
        max(half_cell_likeness(CellMaps.measure(features, np.diag(cell)).brightness))
        for cell in ([8.0, 10.0], [16.0, 10.0], [16.0, 20.0])
    ]
    assert repeated[0] < 0.9
    assert min(repeated[1:]) > 0.99
