"""Flats through a wider aperture of the main lens than that of the white image."""

from __future__ import annotations

from functools import cache

import pytest

import lfcal
from data_synth import SCENES, Camera, simulate

SIZE = (500, 420)


@cache
def _capture(fill):
    camera = Camera.design(SIZE, 23.0, "hex", 3.0, microimage_fill=fill)
    return simulate(SCENES["house"](camera), camera, samples=4, noise=(5000, 8))


@cache
def _camera(fill):
    return lfcal.calibrate(_capture(fill).white, kind="white")


@pytest.fixture(scope="module")
def wide():
    return _capture(0.97)


@pytest.mark.parametrize("fill", [0.3, 0.6])
def test_a_white_image_through_a_closed_aperture_gives_the_lattice_and_the_flat_the_radius(
    wide, fill
):
    camera = _camera(fill)
    wider = lfcal.widen_microimages(camera, wide.flat)
    assert camera.lattice.radius == pytest.approx(fill / 2 * 23, abs=0.2)
    assert wider.lattice.radius == pytest.approx(0.97 / 2 * 23, abs=0.35)
    assert (wider.lattice.centres() == camera.lattice.centres()).all()
    assert "the aperture of the main lens was wider" in wider.warnings[-1]
    assert lfcal.widen_microimages(wider, wide.flat) is wider


def test_a_camera_of_the_same_aperture_stays_the_same_object(wide):
    for fill in (0.97, 0.6):
        camera = _camera(fill)
        assert lfcal.widen_microimages(camera, _capture(fill).flat) is camera


def test_a_flat_of_another_size_is_refused(wide):
    camera = _camera(0.97)
    with pytest.raises(lfcal.FlatError, match="the camera is for 500 x 420 px"):
        lfcal.widen_microimages(camera, wide.flat[:-2])
