"""Discs that cut each other, found from the distances of their common rim."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.illumination.rim_fit import fit_best_rim, fit_rims

_ANGLES = np.arange(24) * 2 * np.pi / 24


def _rims(own, whole, growth, radius, shift):
    """Rims (48, 24) over the field, found by walking outwards until one of the discs ends, and the field (48, 2)."""
    x, y = np.meshgrid(np.linspace(-0.75, 0.75, 8), np.linspace(-0.55, 0.55, 6))
    field = np.column_stack([x.ravel(), y.ravel()])
    far = np.linspace(0, 2 * whole, 4001)
    rays = far[:, None, None] * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)
    rims = np.empty((len(field), 24))
    for k, place in enumerate(field):
        inside = np.hypot(*np.moveaxis(rays - own * place, -1, 0)) < whole
        inside &= np.hypot(*np.moveaxis(rays - growth * place - shift, -1, 0)) < radius
        rims[k] = far[np.argmin(inside, axis=0)]
    return rims, field


@pytest.mark.parametrize(("own", "growth", "radius"), [(-1.2, 2.4, 10.9), (0.9, -2.9, 10.4), (-0.8, 2.0, 10.0)])
def test_both_discs_are_found_from_their_common_rim(own, growth, radius):
    rims, field = _rims(own, 10.0, growth, radius, np.array([0.15, -0.1]))
    found = fit_rims(rims, np.ones_like(rims), field)[0]
    discs = sorted([(found.disc_radius, found.lattice_growth), (found.radius, found.growth)])
    if radius > 10.0:
        np.testing.assert_allclose(discs, [(10.0, own), (radius, growth)], atol=0.2)
    assert sorted(way for _, way in discs) == pytest.approx(sorted([own, growth]), abs=0.2)
    assert np.sqrt(found.residual) < 0.1


def test_discs_of_one_size_are_found_once():
    rims, field = _rims(-0.8, 10.0, 2.0, 10.0, np.zeros(2))
    assert len(fit_rims(rims, np.ones_like(rims), field)) == 1


def test_circular_rims_have_no_cut():
    rims = 10 + np.random.default_rng(0).normal(0, 0.02, (48, 24))
    assert fit_best_rim(rims, np.ones_like(rims), _rims(0.0, 10.0, 0.0, 20.0, np.zeros(2))[1]) is None


def test_rims_without_weight_have_no_cut():
    # As of white images so overexposed that all is clipped.
    rims, field = _rims(0.0, 10.0, 0.0, 20.0, np.zeros(2))
    assert fit_best_rim(rims, np.zeros_like(rims), field) is None
