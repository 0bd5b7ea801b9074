"""The noise of a flat is measured where it is smoothest, in light."""

from __future__ import annotations

import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from lfcal import Calibration, Lattice
from lfrender.detail.noise import measure_noise


def look_at(flat):
    return lambda part: flat[part[1] : part[3], part[0] : part[2]]


@pytest.mark.parametrize("form", [{"bits": 16, "gamma": False}, {}])
def test_noise_is_that_of_light_and_not_the_texture(form):
    camera = Camera.design(size=(420, 340), pitch=34.0)
    shot = simulate(
        SCENES["plane"](camera, seed=2), camera, samples=96, seed=4, noise=(2000, 5), **form
    )
    # Three channels of 2000 electrons have 0.013 of white together; the ray tracer adds some.
    assert 0.009 < measure_noise(look_at(shot.flat), shot.truth.calibration) < 0.026


def test_a_flat_without_a_whole_lens_has_none():
    camera = Calibration(Lattice([0, 0], [[60, 0], [0, 60]], (40, 30), 28))
    assert measure_noise(look_at(np.ones((30, 40, 1), np.float32)), camera) == 0
