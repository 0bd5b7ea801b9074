"""Pictures of depth maps: the right colour at the right lens."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.output.depth_picture import MODE_COLOURS, magnification_picture, mode_picture

SHAPE = (240, 320)
AFFINE = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


@pytest.fixture
def lattice():
    return Lattice((20.0, 20.0), [[40.0, 0.0], [0.0, 40.0]], (320, 240), 18.0)


def test_each_pixel_shows_the_mode_of_its_nearest_lens(lattice):
    mode = np.array([1, -1, 0])[lattice.indices().sum(1) % 3]
    picture = mode_picture(mode, lattice, AFFINE, SHAPE)
    for (x, y), code in zip(lattice.centres().astype(int), mode, strict=True):
        assert tuple(picture[y + 15, x - 15]) == MODE_COLOURS[code]


def test_magnification_runs_from_blue_to_red_and_unresolved_is_grey(lattice):
    x, y = lattice.centres().T
    magnification = np.where(y < 40, np.nan, np.where(x < 160, 2.0, 10.0))
    picture = magnification_picture(magnification, lattice, AFFINE, SHAPE).astype(int)
    low, high = picture[200, 100], picture[200, 250]
    assert low[2] > low[0]
    assert high[0] > high[2]
    assert tuple(picture[10, 100]) == MODE_COLOURS[0]
