"""The mode that a scene is captured in."""

from __future__ import annotations

import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from lfcal.lens_types.coarse_disparity import find_scene_mode


@pytest.mark.parametrize("ratio, mode", [(0.35, "telescopic"), (-0.3, "binocular")])
def test_mode_of_a_plane_is_found(ratio, mode):
    camera = Camera.design(size=(400, 400), pitch=20)
    flat = simulate(SCENES["plane"](camera, ratio=ratio), camera, samples=4).flat
    assert find_scene_mode(flat, camera.lattice) == mode


def test_blank_flat_has_no_mode():
    camera = Camera.design(size=(400, 400), pitch=20)
    assert find_scene_mode(np.full((400, 400), 90, np.uint8), camera.lattice) is None
