"""Microimages cut out of white images, against what was drawn."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lattice.lattice import Lattice
from lfcal.lattice.lens_subset import StackedCrops
from lfcal.white_fit.lenses import cut_out
from lfcal.white_fit.microimages import Microimages


@pytest.fixture(scope="module")
def truth():
    from benchmarks.white_images import WhiteImage

    return WhiteImage("hexagonal", 20.3, 5.0, 30.0, size=(640, 500))


def _lattice(truth):
    origin = truth.centres(np.zeros((1, 2)))[0]
    return Lattice(origin, truth.basis, truth.size, truth.pitch / 2)


@pytest.fixture(scope="module")
def lenses(truth):
    picture = StackedCrops.of(sqrt_luminance(truth.image()))
    return Microimages.of(cut_out(picture, _lattice(truth), 1e6, 0))


def test_profile_is_that_of_the_discs(truth, lenses):
    far = 0.125 * np.arange(len(lenses.profile))
    inside = lenses.profile[far < 0.8 * lenses.radius]
    assert lenses.profile[far > lenses.radius + 2].max() < 0.2 * inside.min()
    assert lenses.radius == pytest.approx(truth.fill * truth.pitch / 2, abs=0.15)
    assert lenses.core == pytest.approx(np.median(inside), rel=0.05)
    assert 0.8 * lenses.light.size < lenses.thin(1e9).light.size == lenses.light.size


def test_normal_equations_move_displaced_centres_back(truth, lenses):
    lattice = _lattice(truth)
    wrong = Lattice(lattice.origin + np.array([0.2, -0.1]), lattice.basis, lattice.image_size, 10.0)
    sums = lenses.at(wrong).sums()
    place = np.triu(sums.normal[:, :2, :2]) + np.triu(sums.normal[:, :2, :2], 1).swapaxes(1, 2)
    shift = np.linalg.solve(place, sums.right[:, :2, None])[..., 0]
    # Robust weights shorten the first step.
    share = np.median(shift, axis=0) / [-0.2, 0.1]
    assert (share > 0.5).all() and (share < 1.1).all()
    assert (
        np.abs(np.median(lenses.sums().right[:, :2], axis=0)).max()
        < np.abs(np.median(sums.right[:, :2], axis=0)).min()
    )


def test_residuals_are_those_of_noise(lenses):
    residual = lenses.learn_profile(lenses.sums()).residuals()
    assert np.sqrt((residual**2).mean()) < 0.05 * lenses.core
    assert lenses.in_cells().mean() == pytest.approx(
        np.sqrt(0.75) * 20.3**2 / lenses.light.shape[1] ** 2, rel=0.03
    )


def test_known_profile_is_taken_over(truth, lenses):
    picture = StackedCrops.of(sqrt_luminance(truth.image()))
    few = Microimages.of(cut_out(picture, _lattice(truth), 1e5, 50), lenses)
    assert 50 <= len(few.centres) < len(lenses.centres)
    np.testing.assert_array_equal(few.profile, lenses.profile)
    assert few.gain.mean() == pytest.approx(lenses.gain.mean(), rel=0.05)
