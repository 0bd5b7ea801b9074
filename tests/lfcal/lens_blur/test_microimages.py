"""The model of blurred discs that rims of microimages are measured with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal import Calibration, Lattice, LensTypes
from lfcal.lens_blur.microimages import _Model, _Tile

_LATTICE = Lattice((50, 50), ((20, 0.5), (10, 17)), (300, 300), 9)
_TYPES = LensTypes([[0, 1, 2], [2, 0, 1], [1, 2, 0]])


@pytest.mark.parametrize("straight", [False, True])
@pytest.mark.parametrize("types", [None, _TYPES], ids=["one", "three"])
@pytest.mark.parametrize("cut", [(), (0.3, 0.2, 2.0, 8.5, 0.7)], ids=["whole", "cut"])
def test_slopes_of_the_light_are_those_of_differences(straight, types, cut):
    camera = Calibration(_LATTICE, lens_types=types)
    model = replace(_Model.of(camera), straight=straight, cut=np.array(cut))
    rng = np.random.default_rng(0)
    squares = 500
    kind = rng.integers(0, model.count, squares)
    offset = rng.uniform(-12, 12, (squares, 2))
    one = np.ones(squares)
    tile = _Tile(np.array([0.2, 0.3]), 1.0, kind, 0.5, offset, one, one)
    radii = rng.uniform(7, 9, model.count)
    blurs = rng.uniform(1, 2.5, model.count)
    lights = rng.uniform(0.8, 1.2, model.count)
    values = np.concatenate([radii, blurs, lights, [-0.15, 0.03]])
    _, slopes = model.light(tile, values)
    for number, step in enumerate(1e-6 * np.eye(len(values))):
        differ = model.light(tile, values + step)[0] - model.light(tile, values - step)[0]
        np.testing.assert_allclose(slopes[:, number], differ / 2e-6, atol=1e-7)
