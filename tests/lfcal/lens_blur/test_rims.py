"""The blur of rims is that of an edge at `s = 0`: aperture times focus."""

from __future__ import annotations

import pytest

import lfcal
from data_synth import SCENES, Camera, simulate


@pytest.mark.parametrize("focus", [0.04, -0.25])
def test_rims_of_a_white_image_tell_aperture_times_focus(focus):
    camera = Camera.design(size=(600, 480), pitch=40.0, rotation=1.3, focus=focus, fill=0.25)
    shot = simulate(SCENES["plane"](camera), camera, samples=16, seed=5)
    found = lfcal.calibrate(shot.white, kind="white").lens_blur
    discs, errors = found.at([0.0])
    assert abs(discs[0, 0] - 0.25 * 40.0 * abs(focus)) < 2 * errors[0, 0] < 1.2
    # Rims alone do not tell the disc at any other depth.
    assert not found.tells_aperture
    discs, errors = found.at([-0.3, 0.3])
    assert (discs < errors).all()


def test_gaps_of_a_scene_tell_the_same_as_the_white_image():
    camera = Camera.design(size=(600, 480), pitch=40.0, rotation=1.3, focus=-0.25, fill=0.25)
    shot = simulate(SCENES["house"](camera, seed=2), camera, samples=24, seed=5)
    discs, errors = lfcal.calibrate(shot.flat, kind="scene").lens_blur.at([0.0])
    assert abs(discs[0, 0] - 0.25 * 40.0 * 0.25) < 2 * errors[0, 0] < 1.2


@pytest.mark.parametrize("name", ["s2_sq", "s4b_tspc"])
def test_rims_are_seen_on_ray_traced_scenes(shared, name):
    camera = lfcal.calibrate(lfcal.read_flat(shared("truth", name, "flat.png")))
    assert camera.lens_blur is not None
