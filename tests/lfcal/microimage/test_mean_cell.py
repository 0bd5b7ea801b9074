"""The mean microimage of a flat."""

from __future__ import annotations

import numpy as np

from lfcal.lattice.cell import Cell
from lfcal.microimage.mean_cell import average_cells

from ._dots import LATTICE, draw_dots

_BINS = 12


def _average(picture: np.ndarray) -> np.ndarray:
    _, centres = LATTICE.select_whole(15)
    mean = average_cells(picture, LATTICE, centres, Cell.of(LATTICE), _BINS)
    return mean.reshape(_BINS, _BINS, 4)


def test_mean_microimage_has_the_light_of_the_dots():
    level = _average(draw_dots(LATTICE.centres()))[..., 0]
    assert level.argmax() == 0
    # Half-way along the first and the second step, two dots of a width of 4 px meet.
    for middle, step in ((level[0, _BINS // 2], 20.06), (level[_BINS // 2, 0], 18.03)):
        assert abs(middle - 2 * np.exp(-((step / 2) ** 2) / 32)) < 0.05


def test_mean_microimage_is_symmetric_though_the_dots_are_displaced():
    level = _average(draw_dots(LATTICE.centres() + np.array([0.4, -0.3])))[..., 0]
    np.testing.assert_allclose(level, np.roll(level[::-1, ::-1], (1, 1), (0, 1)), atol=1e-5)


def test_slopes_are_those_of_the_level():
    mean = _average(draw_dots(LATTICE.centres()))
    along = (np.roll(mean[..., 0], -1, 1) - np.roll(mean[..., 0], 1, 1)) * _BINS / 2
    np.testing.assert_allclose(mean[..., 2:] @ LATTICE.basis[0], along, atol=1e-4)


def test_pixels_that_scatter_have_a_larger_variance():
    light = np.random.default_rng(0).uniform(0.5, 1.5, len(LATTICE))
    even, uneven = (_average(draw_dots(LATTICE.centres(), one)) for one in (1.0, light))
    assert even[0, 0, 1] > 5 * uneven[0, 0, 1]
