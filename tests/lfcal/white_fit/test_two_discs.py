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
from lfcal.white_fit.disc_light import RADIUS, SHADING
from lfcal.white_fit.fit import converge
from lfcal.white_fit.fit_discs import fit_two_discs
from lfcal.white_fit.microimages import cut_out
from lfcal.white_fit.two_discs import choose_lens

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
    crops = StackedCrops.of(sqrt_luminance(truth.image()))
    fit = converge(lattice, cut_out(crops, lattice, 1e5, 150), ())
    discs = fit_two_discs(fit.lenses, fit.lattice)
    assert discs is not None
    return truth, discs


def test_radii_and_blur_of_both_discs_are_measured(found):
    truth, discs = found
    radius = truth.fill * truth.pitch / 2
    np.testing.assert_allclose(discs.radius, [radius, 1.05 * radius], atol=0.03)
    np.testing.assert_allclose(discs.blur, 0.6, atol=0.02)
    assert discs.cut[2] == pytest.approx(-0.3 * radius, abs=0.03)
    assert discs.doubt is None


def test_the_smaller_disc_is_the_lens_and_shading_decides_between_equal_ones(found):
    discs = found[1]
    assert choose_lens(discs.interchanged()).radius[0] == discs.radius[0]
    parameters = discs.parameters.copy()
    parameters[RADIUS] = discs.radius[0]
    equal = replace(discs, parameters=parameters)
    chosen = choose_lens(equal.interchanged())
    assert chosen.parameters[SHADING][0] > chosen.parameters[SHADING][1] and chosen.doubt is None


def test_radii_and_shading_that_contradict_each_other_are_doubtful(found):
    discs = found[1]
    parameters = discs.parameters.copy()
    parameters[SHADING] = parameters[SHADING][::-1]
    other = replace(discs, parameters=parameters)
    assert "shading is centred on" in choose_lens(other).doubt
    assert choose_lens(other).radius[0] == discs.radius[0]
