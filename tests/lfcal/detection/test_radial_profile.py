"""Radial profiles of microimages, and the lattice fitted by them."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.detection.radial_profile import fit_lattice, measure_radial_profile


@pytest.fixture
def white(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 5)
    image, origin = whites.white_image(basis, (640, 520), gap=0.1, noise=0.005)
    return image.astype(np.float32) / 65535, lfcal.Lattice(origin, basis, (640, 520), 9.0)


def test_profile_of_discs_falls_at_their_radius(white):
    picture, lattice = white
    profile = measure_radial_profile(picture, lattice)
    radii = np.arange(len(profile.mean)) * profile.step
    inside, gap = profile.mean[radii < 8].mean(), profile.mean[(radii > 10.2) & (profile.weight > 100)].mean()
    assert gap / inside == pytest.approx(0.1, abs=0.03)
    # Discs fill 0.92 of the pitch.
    assert radii[profile.slope.argmin()] == pytest.approx(0.92 * 20.3 / 2, abs=0.3)


def test_lattice_is_fitted_to_two_hundredths_of_a_pixel_from_a_start_off_by_half_a_pixel(whites, white):
    picture, lattice = white
    start = lfcal.Lattice(
        lattice.origin + np.array([0.4, -0.3]), lattice.basis * 1.0005, lattice.image_size, lattice.radius
    )
    fit = fit_lattice(picture, start, passes=6)
    found = lfcal.Lattice(fit.origin, fit.basis, lattice.image_size, lattice.radius)
    assert whites.rms(whites.centre_errors(found, lattice.origin, lattice.basis)) < 0.02
    assert fit.uncertainty < 0.02 and fit.half_difference < 0.02


def test_flat_with_too_few_whole_microimages_is_refused(white):
    picture, lattice = white
    small = lfcal.Lattice(lattice.origin, lattice.basis, (60, 50), lattice.radius)
    with pytest.raises(lfcal.CalibrationError, match="whole microimages"):
        fit_lattice(picture[:50, :60], small)
