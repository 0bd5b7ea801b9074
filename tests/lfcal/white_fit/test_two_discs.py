"""Two discs that cut each other: both are found whatever blurs their edges, and which of them is
the lens.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from benchmarks.calibration_bound import centre_error
from benchmarks.white_images import WhiteImage
from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lattice.lens_subset import StackedCrops
from lfcal.microimage.fit import converge
from lfcal.white_fit.disc_light import COUNT, RADIUS, SHADING
from lfcal.white_fit.find_cut import fit_two_discs
from lfcal.white_fit.lenses import cut_out
from lfcal.white_fit.microimages import Microimages
from lfcal.white_fit.two_discs import choose_lens, interchange

SIZE = (640, 480)


def test_distorted_cut_lenses_are_located_where_their_overlap_is_blurred():
    truth = WhiteImage(
        "hexagonal",
        16.3,
        4.0,
        34.0,
        8,
        strength=-0.3,
        ratio=1.05,
        fill=0.92,
        inner=0.02,
        edges="overlap",
        blur=0.7,
        cut_blur=1.0,
        k1=-0.003,
        size=SIZE,
    )
    camera = lfcal.calibrate(truth.image(), "white")
    assert centre_error(camera, truth) < 0.02
    assert not any("overlap of two discs" in text for text in camera.warnings)


def test_two_equal_discs_without_shading_are_doubtful_and_said_so():
    truth = WhiteImage(
        "square", 18.3, 2.0, 30.0, 8, strength=0.3, edges="product", inner=0.0, size=SIZE
    )
    camera = lfcal.calibrate(truth.image(), "white")
    (doubt,) = (text for text in camera.warnings if "overlap of two discs" in text)
    assert "close the aperture" in doubt
    assert "constant in the disparity" in doubt


def test_centres_of_blurred_cut_microimages_are_right_to_0_004_px_and_pass_the_check():
    truth = WhiteImage(
        "hexagonal", 18.9, 5.0, strength=0.3, ratio=1.04, soft=1.1, gap=0.03, size=(700, 520)
    )
    image = truth.image()
    camera = lfcal.calibrate(image)
    assert centre_error(camera, truth) < 0.004
    # Rims of cut microimages are up to half a pixel off the lattice, which the calibration allows
    # for.
    assert lfcal.check_fit(camera, image).max_offset < 0.15
    assert centre_error(camera, truth) < 5 * np.sqrt(
        (camera.errors.of_centres(camera.lattice) ** 2).mean()
    )


@pytest.fixture(scope="module")
def found():
    truth = WhiteImage(
        "square",
        19.7,
        3.0,
        34.0,
        16,
        strength=-0.3,
        ratio=1.05,
        inner=0.08,
        edges="product",
        size=SIZE,
    )
    lattice = lfcal.Lattice(truth.origin, truth.basis, truth.size, 9.0)
    lenses = cut_out(StackedCrops.of(sqrt_luminance(truth.image())), lattice, 1e5, 150)
    fit = converge(lattice, Microimages.of(lenses), ())
    discs = fit_two_discs(lenses, fit)
    assert discs is not None
    return truth, discs


def _choose(fit, shape):
    return choose_lens(replace(fit.lenses, shape=shape), fit.step.covariance[-COUNT:, -COUNT:])


def test_radii_and_blur_of_both_discs_are_measured(found):
    truth, fit = found
    discs = fit.lenses
    radius = truth.fill * truth.pitch / 2
    np.testing.assert_allclose(discs.radius, [radius, 1.05 * radius], atol=0.03)
    np.testing.assert_allclose(discs.blur, 0.6, atol=0.02)
    assert discs.cut[2] == pytest.approx(-0.3 * radius, abs=0.03)
    assert _choose(fit, discs.shape) == (True, None)


def test_light_of_interchanged_discs_is_the_same(found):
    fit = found[1]
    lattice, other = interchange(fit.lattice, fit.lenses)
    np.testing.assert_allclose(other.radius, fit.lenses.radius[::-1])
    np.testing.assert_allclose(other.blur, fit.lenses.blur[::-1])
    one, two = (discs.compare().table[:, -1] for discs in (fit.lenses, other))
    # Fields of the two lattices differ by the growth over the reach.
    np.testing.assert_allclose(one, two, atol=0.02)
    assert np.abs(one - fit.lenses.at(lattice).compare().table[:, -1]).max() > 0.3


def test_derivatives_of_the_light_are_those_of_differences(found):
    discs = found[1].lenses.draw(3000)
    seen = discs.compare()
    for place in range(COUNT):
        step = np.zeros(COUNT)
        step[place] = 1e-4
        light = [
            replace(discs, shape=discs.shape + sign * step).compare().table[:, -1]
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(
            (light[0] - light[1]) / 2e-4, seen.table[:, 2 + place], atol=2e-3
        )


def test_the_smaller_disc_is_the_lens_and_shading_decides_between_equal_ones(found):
    fit = found[1]
    _, other = interchange(fit.lattice, fit.lenses)
    assert _choose(fit, other.shape) == (False, None)
    shape = fit.lenses.shape.copy()
    shape[RADIUS] = shape[RADIUS][0]
    assert _choose(fit, shape) == (True, None)
    shape[SHADING] = shape[SHADING][::-1]
    assert _choose(fit, shape) == (False, None)


def test_radii_and_shading_that_contradict_each_other_are_doubtful(found):
    fit = found[1]
    shape = fit.lenses.shape.copy()
    shape[SHADING] = shape[SHADING][::-1]
    first, doubt = _choose(fit, shape)
    assert first and "shading is centred on" in doubt
