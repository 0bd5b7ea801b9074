"""Lenses cut out of white images, against what was drawn."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lattice.lattice import Lattice
from lfcal.lattice.lens_subset import StackedCrops
from lfcal.runtime.errors import CalibrationError
from lfcal.white_fit.lenses import cut_out, measure_centroid_offset


@pytest.fixture(scope="module")
def truth():
    from benchmarks.white_images import WhiteImage

    return WhiteImage("hexagonal", 20.3, 5.0, 30.0, size=(640, 500))


def _lattice(truth):
    origin = truth.centres(np.zeros((1, 2)))[0]
    return Lattice(origin, truth.basis, truth.size, truth.pitch / 2)


@pytest.fixture(scope="module")
def lenses(truth):
    return cut_out(StackedCrops.of(sqrt_luminance(truth.image())), _lattice(truth), 1e6, 0)


def test_centroids_lie_on_the_centres(truth, lenses):
    assert measure_centroid_offset(lenses) < 0.05
    lattice = _lattice(truth)
    beside = Lattice(lattice.origin + np.array([0.6, 0.0]), lattice.basis, lattice.image_size, 10.0)
    assert measure_centroid_offset(lenses.at(beside)) == pytest.approx(0.6, abs=0.1)


def test_dark_flats_have_too_few_microimages(truth):
    picture = np.zeros((500, 640), np.float32)
    picture[200:300, 200:260] = sqrt_luminance(truth.image())[200:300, 200:260]
    with pytest.raises(CalibrationError, match="are needed"):
        cut_out(StackedCrops.of(picture), _lattice(truth), 1e6, 0)
