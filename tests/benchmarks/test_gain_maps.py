"""Errors of gain maps, and counts of defects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from benchmarks.gain_maps import compare_gain, count_found
from benchmarks.white_images import WhiteImage
from lfcal.gain.gain_map import Defects

_TRUTH = WhiteImage(pitch=20.0, size=(400, 300), decibels=46, seed=3)


def test_light_that_rises_by_a_tenth_over_the_flat_is_an_error_of_its_scatter():
    camera = lfcal.calibrate(_TRUTH.image(), kind="white")
    light = _TRUTH.light()
    exact = compare_gain(camera, light, each_lens=False)
    rise = np.linspace(1, 1.1, light.shape[1])
    wrong = compare_gain(camera, light * rise, each_lens=False)
    assert exact.rms < 0.01
    assert wrong.rms == pytest.approx((1 / rise).std() / (1 / rise).mean(), abs=0.005)
    # The scale of each lens follows it.
    assert compare_gain(camera, light * rise, each_lens=True).rms < exact.rms + 0.001


def test_hot_pixels_and_specks_are_counted_with_those_that_are_listed():
    truth = replace(_TRUTH, hot=5, dust=2, seed=4)
    image = truth.image()
    rows, columns = np.nonzero(image == image.max())
    x, y, _ = truth.specks[0].astype(int)
    pixels = [*zip(columns[:3], rows[:3], strict=True), (x, y)]
    camera = replace(lfcal.calibrate(image, kind="white"), defects=Defects(pixels))
    assert count_found(camera, truth, image) == [3, 1, 0]
