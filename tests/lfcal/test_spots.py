"""White images of spots of few pixels."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal


@pytest.mark.parametrize(("pitch", "size"), [(10.4147, 0.6), (13.2, 0.9)])
def test_spots_of_few_pixels_are_placed_by_their_centroids(pitch, size):
    rng = np.random.default_rng(3)
    lattice = lfcal.Lattice(
        [4.3, 5.1], pitch * np.array([[np.sqrt(0.75), 0.5], [0, 1]]), (260, 240), 3.0
    )
    y, x = np.mgrid[:240, :260]
    light = np.zeros((240, 260))
    for cx, cy in lattice.centres():
        light += np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * size**2))
    found = lfcal.calibrate(np.clip(rng.normal(230 * light, 1.5), 0, 255).astype(np.uint8))
    apart = lattice.centres() - found.lattice.points(
        np.rint(found.lattice.to_index(lattice.centres()))
    )
    assert found.source == "white" and found.confidence > 0.9
    assert np.sqrt((apart**2).sum(1).mean()) < 0.02
