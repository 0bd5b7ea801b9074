"""The final fit is kept only where it stays with the first lattice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal


def test_fit_that_leaves_the_first_lattice_is_discarded(whites, monkeypatch):
    from lfcal.white_fit import fit as white_fit

    true_fit = white_fit.fit_white

    def astray(light, lattice):
        found = true_fit(light, lattice)
        return replace(found, lattice=replace(found.lattice, basis=found.lattice.basis * 1.03))

    monkeypatch.setattr(white_fit, "fit_white", astray)
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (500, 400))
    assert whites.rms(whites.centre_errors(lfcal.calibrate(image).lattice, origin, basis)) < 0.1


@pytest.mark.parametrize("pitch", [75.0, 16.0])
def test_masks_of_hard_discs_are_placed_without_a_doubt(pitch):
    y, x = np.mgrid[:600, :800]
    far = np.hypot(
        (x - 51.3 + pitch / 2) % pitch - pitch / 2, (y - 54.2 + pitch / 2) % pitch - pitch / 2
    )
    found = lfcal.calibrate(np.where(far < 0.453 * pitch, 255, 0).astype(np.uint8))
    apart = found.lattice.points(np.rint(found.lattice.to_index([[51.3, 54.2]]))) - [51.3, 54.2]
    assert found.confidence > 0.85 and found.warnings == ()
    assert abs(found.lattice.pitch - pitch) < 0.005 and np.abs(apart).max() < 0.15


def test_an_even_scene_that_no_white_image_explains_is_calibrated_as_a_scene(shared):
    camera = lfcal.calibrate(lfcal.read_flat(shared("captures", "AntLeg.png")))
    assert camera.source == "scene" and camera.lattice.pitch == pytest.approx(27.561, abs=0.01)
