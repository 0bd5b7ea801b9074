"""Circles by Hough vote, and how well they agree with a lattice."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.hough.circle_vote import find_circles, find_marks
from lfcal.images.preprocessing import sqrt_luminance


@pytest.fixture(scope="module")
def white(drawn):
    truth = drawn("hexagonal", 17.3, 8.0, 26.0, 8, size=(700, 600))
    return truth, sqrt_luminance(truth.image())


def _share(circles, lattice):
    """Share of the circles within 0.15 pitches of a lattice point."""
    nearest = lattice.points(np.rint(lattice.to_index(circles.centres)))
    return (np.hypot(*(nearest - circles.centres).T) < 0.15 * lattice.pitch).mean()


def test_circles_agree_with_the_lattice_and_not_with_one_half_a_cell_beside(white):
    truth, picture = white
    lattice = lfcal.Lattice(truth.origin, truth.basis, truth.size, 8.0)
    assert _share(find_circles(picture, 17.3), lattice) > 0.95
    beside = lfcal.Lattice(truth.origin + truth.basis.sum(0) / 2, truth.basis, truth.size, 8.0)
    assert _share(find_circles(picture, 17.3), beside) < 0.05


def test_radius_of_circles_is_that_of_microimages(white):
    truth, picture = white
    assert np.median(find_circles(picture, 17.3).radii) == pytest.approx(
        truth.fill * truth.pitch / 2, abs=0.4
    )


def test_circles_in_noise_agree_with_nothing():
    noise = np.random.default_rng(0).random((400, 400)).astype(np.float32)
    lattice = lfcal.Lattice((200, 200), [[20, 0], [0, 20]], (400, 400), 9.0)
    # By chance 7 %.
    assert _share(find_circles(noise, 20), lattice) < 0.15


def test_a_crop_of_few_lenses_of_three_types_is_found(shared):
    flat = lfcal.read_flat(shared("captures", "R42_crop.png"))
    assert lfcal.calibrate(flat).lattice.pitch == pytest.approx(34.87, abs=0.02)


def test_peaks_are_the_centres_of_spots():
    y, x = np.mgrid[:400, :500]
    spots = np.exp(-(((x % 25 - 12) ** 2 + (y % 25 - 12) ** 2) / 5.0)).astype(np.float32)
    lattice = lfcal.Lattice([12, 12], [[25, 0], [0, 25]], (500, 400), 3)
    assert _share(find_marks(spots, 25.0)[1], lattice) > 0.95
