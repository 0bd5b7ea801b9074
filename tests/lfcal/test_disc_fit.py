"""White images of the benchmark: whole, cut and distorted microimages against their true centres."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import lfcal

_PATH = Path(__file__).parents[2] / "benchmarks" / "white_images.py"
_SPEC = importlib.util.spec_from_file_location("benchmarks.white_images", _PATH)


@pytest.fixture(scope="module")
def drawn():
    import sys

    module = importlib.util.module_from_spec(_SPEC)
    sys.modules[_SPEC.name] = module
    _SPEC.loader.exec_module(module)
    return module.WhiteImage


def _error(camera, truth):
    found = camera.lattice.centres()
    return float(np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()))


@pytest.mark.parametrize("decibels", [40, 26, 18])
def test_whole_microimages_are_placed_within_three_times_the_bound(drawn, decibels):
    truth = drawn("hexagonal", 14.3, 11.0, decibels, size=(900, 700))
    camera = lfcal.calibrate(truth.image())
    assert camera.lattice.distortion is None
    assert _error(camera, truth) < 3 * truth.bound()


@pytest.mark.parametrize("strength", [0.3, -0.3])
def test_cut_microimages_are_placed_by_their_whole_discs(drawn, strength):
    truth = drawn("hexagonal", 20.3, 5.0, 26.0, strength=strength, size=(1000, 800))
    assert _error(lfcal.calibrate(truth.image()), truth) < 0.1


def test_distorted_lattice_is_followed(drawn):
    truth = drawn("square", 20.3, 5.0, 26.0, k1=0.005, size=(1000, 800))
    camera = lfcal.calibrate(truth.image())
    assert camera.lattice.distortion is not None
    assert _error(camera, truth) < 0.02
