"""Coarse disparity of single lenses, against the depth of a simulated plane, and the mode of a
scene.
"""

from __future__ import annotations

import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lens_types.coarse_disparity import estimate_coarse_disparity, find_scene_mode
from lfcal.lens_types.lens_sample import sample_lenses


@pytest.mark.parametrize("ratio", [-0.35, 0.25])
def test_disparity_of_a_plane_is_found_to_a_step_of_the_grid(ratio):
    camera = Camera.design((520, 440), 20.3, "hex", 3.0)
    taken = simulate(SCENES["plane"](camera, ratio=ratio, seed=3), camera, samples=8)
    sample = sample_lenses(taken.truth.calibration.lattice)
    found = estimate_coarse_disparity(sqrt_luminance(taken.flat), sample)
    known = found[np.isfinite(found)]
    assert len(known) > 0.3 * sample.whole[:, 1:-1, 1:-1].sum()
    assert np.median(known) == pytest.approx(ratio, abs=0.051)
    assert (np.abs(known - ratio) < 0.08).mean() > 0.9


@pytest.mark.parametrize("ratio, mode", [(0.35, "telescopic"), (-0.3, "binocular")])
def test_mode_of_a_plane_is_found(ratio, mode):
    camera = Camera.design(size=(400, 400), pitch=20)
    flat = simulate(SCENES["plane"](camera, ratio=ratio), camera, samples=4).flat
    assert find_scene_mode(flat, camera.lattice) == mode


def test_blank_flat_has_no_mode():
    camera = Camera.design(size=(400, 400), pitch=20)
    assert find_scene_mode(np.full((400, 400), 90, np.uint8), camera.lattice) is None
