"""Cameras are confirmed by the average cells of a flat, but only right ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal.display.confirmation import match_gain
from lfcal.images.preprocessing import sqrt_luminance

_SIZE = (600, 500)
_MIDDLE = (np.array(_SIZE) - 1) / 2
_PITCH = 20.3


@pytest.fixture(scope="module")
def white(whites):
    """The picture of a white image, and the camera that was calibrated on it."""
    basis = whites.turned(whites.HEXAGON, _PITCH, 3)
    image = whites.white_image(basis, _SIZE)[0]
    return sqrt_luminance(image), lfcal.calibrate(image, kind="white")


def _confirms(camera, picture, basis=None, shift=(0.0, 0.0), change=None):
    """Whether a camera with another basis, or moved about the middle of the flat, is confirmed."""
    own = camera.lattice
    change = np.eye(2) if change is None else change
    origin = _MIDDLE + (own.origin - _MIDDLE) @ change + shift
    basis = own.basis @ change if basis is None else basis
    lattice = lfcal.Lattice(origin, basis, _SIZE, min(own.radius, np.hypot(*basis.T).min() / 2))
    return match_gain(replace(camera, lattice=lattice), lattice, picture) is not None


def test_right_camera_is_confirmed_and_one_without_gain_map_is_not(white):
    picture, camera = white
    assert _confirms(camera, picture)
    assert match_gain(replace(camera, gain_map=None), camera.lattice, picture) is None


def test_right_camera_is_confirmed_on_a_downscaled_scene(shared):
    flat = lfcal.read_flat(shared("captures", "Wall.png"))
    camera = lfcal.calibrate(flat)
    small = np.ascontiguousarray(
        flat[: len(flat) // 2 * 2].reshape(len(flat) // 2, 2, -1, 2, 3).mean((1, 3))
    )
    found = match_gain(camera, camera.lattice.downscaled(2), sqrt_luminance(small))
    assert found is not None and found.distance < 0.03


@pytest.mark.parametrize("pitches", [0.05, 0.1, 0.5])
def test_shifted_camera_is_not_confirmed(white, pitches):
    picture, camera = white
    assert not _confirms(camera, picture, shift=(pitches * _PITCH, 0.0))


def test_gaps_are_not_taken_for_lenses(white):
    picture, camera = white
    basis = camera.lattice.basis
    assert not _confirms(camera, picture, shift=(basis[0] + basis[1]) / 3)


@pytest.mark.parametrize("scale", [1.005, 0.995, 1 + 0.045 * _PITCH / np.hypot(*_MIDDLE)])
def test_wrong_pitch_is_not_confirmed(white, scale):
    picture, camera = white
    assert not _confirms(camera, picture, change=scale * np.eye(2))


@pytest.mark.parametrize("parts", [(1, 2), (2, 2), (2, 1), (3, 1), (3, 3)])
def test_parts_of_the_cell_are_not_confirmed(white, parts):
    picture, camera = white
    finer = camera.lattice.basis / np.array(parts)[:, None]
    assert not _confirms(camera, picture, basis=finer)


def test_twice_the_cell_is_not_confirmed(white):
    picture, camera = white
    assert not _confirms(camera, picture, basis=2 * camera.lattice.basis)
