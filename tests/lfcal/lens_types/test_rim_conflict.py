"""Whether the order of the types of a camera contradicts the light at their rims."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

import lfcal
from benchmarks.random_scenes import draw
from lfcal import LensTypes
from lfcal.gain.gain_map import GainMap
from lfcal.lens_types.type_check import find_rim_conflict

_CELL = np.array([[0, 1, 2], [2, 0, 1], [1, 2, 0]])


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_every_other_order_of_types_than_that_of_rims_3_per_cent_apart_is_noticed(order):
    ramp = np.clip(np.arange(60) * 0.25 - 5, 0, 1)
    light = 1 + 0.03 * np.array([[-1], [0], [1]]) * ramp
    gain = replace(GainMap.round(np.ones(60), 0.25, 9), type_light=light, type_cell=_CELL)
    found = find_rim_conflict(LensTypes(np.array(order)[_CELL], True), gain, 9)
    assert (found is None) == (order == (0, 1, 2))


def test_order_of_a_white_image_agrees_with_the_rims_of_its_scene():
    _, capture = draw(8107, 4)
    camera = lfcal.calibrate(capture.white, kind="white")
    assert camera.lens_types.ordered
    assert lfcal.check_camera(capture.flat, camera).problem is None
