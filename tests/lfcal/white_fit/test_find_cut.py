"""Cut microimages are told from whole ones."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lattice.lattice import Lattice
from lfcal.lattice.lens_subset import StackedCrops
from lfcal.white_fit.find_cut import measure_narrowing
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


def test_uncut_microimages_are_no_narrower_along_the_field(lenses):
    narrowing, error = measure_narrowing(lenses)
    assert abs(narrowing) < 4 * error and error < 0.05
