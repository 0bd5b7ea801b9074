"""White images of very many small lenses: what is common to them is measured on some, what is not on all."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from benchmarks.calibration_speed import drawn
from benchmarks.white_images import WhiteImage
from lfcal.lattice.lattice import Lattice
from lfcal.lattice.lens_subset import sample_lenses, select_whole_lenses
from lfcal.white_fit import fit as white_fit


def test_orders_are_chosen_on_8000_of_82000_lenses_and_a_missing_one_is_still_told(monkeypatch):
    truth = WhiteImage("hexagonal", 6.05, 3.0, 26.0, size=(1860, 1400))
    image = drawn(truth, 1)
    index = np.rint(truth.index_of(np.array([[400.0, 1100.0]])))
    x, y = np.rint(truth.centres(index)[0]).astype(int)
    image[y - 3 : y + 4, x - 3 : x + 4] = 0
    opened = []
    original = white_fit.cut_out_lenses

    def seen(*arguments):
        state, lit = original(*arguments)
        opened.append((len(state.indices), len(lit.indices)))
        return state, lit

    monkeypatch.setattr(white_fit, "cut_out_lenses", seen)
    camera = lfcal.calibrate(image)
    looked_at = [some for some, every in opened[:-1]]
    assert opened[-1][1] > 80_000
    assert max(looked_at) == pytest.approx(8000, rel=0.02)
    found = camera.lattice.centres()
    assert np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()) < 1e-3
    missing = camera.lattice.points(camera.defects.lenses)
    assert np.hypot(*(missing - truth.centres(index)).T).min(initial=np.inf) < 0.01


@pytest.mark.parametrize("size", [(400, 300), (2400, 1800)])
def test_some_lenses_are_whole_ones_of_every_period_alike(size):
    lattice = Lattice([3.0, 2.0], [[6.1, 0.2], [2.9, 5.4]], size, 3.0)
    every, _ = select_whole_lenses(lattice, 5.0)
    indices, centres = sample_lenses(lattice, 5.0, 2400.0)
    np.testing.assert_allclose(centres, lattice.points(indices), atol=1e-9)
    assert {tuple(ij) for ij in indices.tolist()} <= {tuple(ij) for ij in every.tolist()}
    assert len(indices) == pytest.approx(2400, rel=0.02)
    for period in (2, 3):
        kinds = np.bincount(indices[:, 0] % period * period + indices[:, 1] % period)
        np.testing.assert_allclose(kinds, len(indices) / period**2, rtol=0.1)


def test_lattice_with_another_radius_has_the_same_lenses():
    lattice = Lattice([3.0, 2.0], [[6.1, 0.2], [2.9, 5.4]], (400, 300), 3.0)
    other = lattice.with_radius(2.5)
    assert (lattice.radius, other.radius) == (3.0, 2.5)
    np.testing.assert_array_equal(other.indices(), lattice.indices())
    np.testing.assert_array_equal(other.basis, lattice.basis)
