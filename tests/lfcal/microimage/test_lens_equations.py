"""Shifts of single microimages against their mean."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.lattice.cell import Cell
from lfcal.microimage.lens_equations import build_lens_equations
from lfcal.microimage.mean_cell import average_cells

from ._dots import LATTICE, draw_dots


@pytest.mark.parametrize(("stride", "error"), [(1, 0.06), (2, 0.08)])
def test_shifts_of_single_dots_are_found(stride, error):
    rng = np.random.default_rng(0)
    inside, centres = LATTICE.select_whole(15)
    shift = rng.normal(0, 0.2, (len(LATTICE), 2))
    light = rng.uniform(0.5, 1.5, len(LATTICE))
    picture = draw_dots(LATTICE.centres() + shift, light)
    cell = Cell.of(LATTICE)
    mean = average_cells(picture, LATTICE, centres, cell, 20)
    normal, right, _ = build_lens_equations(picture, LATTICE, centres, cell, mean, stride)
    found = np.linalg.solve(normal, right[..., None])[..., 0]
    rows = {tuple(index): row for row, index in enumerate(LATTICE.indices().tolist())}
    true = shift[[rows[tuple(index)] for index in inside.tolist()]]
    assert np.sqrt(((found - true) ** 2).mean()) < error


def test_a_blank_lens_has_no_equations():
    _, centres = LATTICE.select_whole(15)
    cell = Cell.of(LATTICE)
    picture = draw_dots(LATTICE.centres())
    mean = average_cells(picture, LATTICE, centres, cell, 20)
    blank = np.full_like(picture, 0.3)
    normal, right, noise = build_lens_equations(blank, LATTICE, centres, cell, mean)
    assert np.abs(normal).max() < 1e-6 and np.abs(right).max() < 1e-6 and noise.max() < 1e-6
