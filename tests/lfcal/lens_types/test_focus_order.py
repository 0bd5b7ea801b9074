"""Order of lens types by their focus, from sharpness over depth."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.lens_types.focus_order import find_focus_order
from lfcal.lens_types.lens_sample import sample_lenses

_FOCI = (-0.5, -0.35, -0.22)
_MOSAIC = np.array([[0, 1, 2], [2, 0, 1], [1, 2, 0]])


@pytest.mark.parametrize("foci", [_FOCI, (0.45, 0.3, 0.2)])
def test_focus_of_each_type_follows_from_its_sharpness_over_depth(whites, foci):
    basis = whites.turned(whites.HEXAGON, 20.0, 3)
    sample = sample_lenses(lfcal.Lattice((3.0, 5.0), basis, (1500, 1200), 9.5))
    rng = np.random.default_rng(0)
    types = _MOSAIC[tuple(np.moveaxis(sample.index % 3, -1, 0))]
    disparity = np.sign(foci[0]) * (0.15 + 0.45 * (sample.centre[..., 0] / 1500))
    sharpness = -np.log1p(
        ((disparity - np.array(foci)[types]) / 0.15) ** 2
    ) + 0.3 * rng.standard_normal(types.shape)
    inner = disparity[:, 1:-1, 1:-1].ravel()
    nothing = np.full(len(inner), np.nan)
    order = find_focus_order(
        sample, _MOSAIC, sample.subtract_neighbours(sharpness), inner, nothing, nothing, 1.0
    )
    assert order.known
    np.testing.assert_array_equal(order.sequence, [0, 1, 2])
    assert order.focus == pytest.approx(foci, abs=0.02)


def test_faint_order_confirmed_by_the_foci_is_given_and_never_wrong(whites):
    sample = sample_lenses(
        lfcal.Lattice((3.0, 5.0), whites.turned(whites.HEXAGON, 20.0, 3), (1500, 1200), 9.5)
    )
    types = _MOSAIC[tuple(np.moveaxis(sample.index % 3, -1, 0))]
    disparity = -(0.15 + 0.45 * (sample.centre[..., 0] / 1500))
    sharpness = -np.log1p(((disparity - np.array([-0.45, -0.3, -0.2])[types]) / 0.15) ** 2)
    inner = disparity[:, 1:-1, 1:-1].ravel()
    nothing = np.full(len(inner), np.nan)
    orders = []
    for seed in range(40):
        noisy = sharpness + 4 * np.random.default_rng(seed).standard_normal(types.shape)
        orders.append(
            find_focus_order(
                sample, _MOSAIC, sample.subtract_neighbours(noisy), inner, nothing, nothing, 1.0
            )
        )
    known = [order.sequence.tolist() for order in orders if order.known]
    # A limit of four standard errors would give 22 of them.
    assert 24 <= len(known) < 40
    assert all(sequence == [0, 1, 2] for sequence in known)


def test_no_order_is_given_for_a_scene_far_from_all_foci(whites):
    sample = sample_lenses(
        lfcal.Lattice((3.0, 5.0), whites.turned(whites.HEXAGON, 20.0, 3), (1500, 1200), 9.5)
    )
    types = _MOSAIC[tuple(np.moveaxis(sample.index % 3, -1, 0))]
    disparity = -0.02 - 0.2 * sample.centre[..., 0] / 1500
    # Blur of many pixels: all types fade alike, the most blurred ones last.
    sharpness = -np.log1p(((disparity - np.array(_FOCI)[types]) / 0.03) ** 2)
    inner = disparity[:, 1:-1, 1:-1].ravel()
    nothing = np.full(len(inner), np.nan)
    order = find_focus_order(
        sample, _MOSAIC, sample.subtract_neighbours(sharpness), inner, nothing, nothing, 1.0
    )
    assert not order.known and np.isnan(order.focus).all()
