"""The middle of a flat confirms its camera, and no other one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal.display.flat_lattice import confirm_by_middle
from lfcal.images.preprocessing import sqrt_luminance


@pytest.mark.parametrize("name", ["Wall.png", "hard/elemental_16px.png"])
def test_camera_without_light_is_confirmed_by_the_middle_of_a_scene(shared, name):
    flat = lfcal.read_flat(shared("captures", *name.split("/")))
    lattice = lfcal.calibrate(flat).lattice
    found = confirm_by_middle(sqrt_luminance(flat), lattice)
    assert found is not None and found.is_negligible


@pytest.mark.parametrize("cells", [(0.5, 0.0), (0.0, 0.5), (1 / 3, 1 / 3), (0.1, 0.0)])
def test_shifted_camera_is_not_confirmed_by_the_middle(white, cells):
    lattice = white.camera.lattice
    picture = sqrt_luminance(white.image)
    assert confirm_by_middle(picture, lattice) is not None
    beside = replace(lattice, origin=lattice.origin + np.array(cells) @ lattice.basis)
    assert confirm_by_middle(picture, beside) is None


def test_stretched_and_turned_cameras_are_not_confirmed_by_the_middle(white):
    picture = sqrt_luminance(white.image)
    for change in (1.03 * np.eye(2), 1.005 * np.eye(2), white.turn(5), white.turn(0.3)):
        moved = white.moved(change=change).lattice
        assert confirm_by_middle(picture, moved) is None
