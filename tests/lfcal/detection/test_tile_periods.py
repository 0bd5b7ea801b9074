"""Periods that are slightly wrong are refined to those of the flat."""

from __future__ import annotations

import numpy as np

from lfcal.detection.folding import fold_tiles
from lfcal.detection.spectrum import is_same_lattice
from lfcal.detection.tile_lattice import finer_bases, refine_basis


def test_basis_off_by_a_thousandth_is_refined_over_the_whole_flat(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 11)
    image, _ = whites.white_image(basis, (700, 560))
    wrong = basis * 1.001 + [[0.01, 0.0], [0.0, -0.01]]
    found, coherence = refine_basis(fold_tiles([image.astype(np.float32)], wrong, 100, 36))
    # Lenses across the flat, each with this error.
    assert np.abs((found - basis) * 700 / 14.3).max() < 0.1
    assert coherence > 0.9


def test_finer_lattices_are_all_of_index_two_and_three():
    basis = np.array([[20.0, 1.0], [3.0, 17.0]])
    finer = finer_bases(basis)
    index = [round(abs(np.linalg.det(basis) / np.linalg.det(one)), 6) for one in finer]
    assert sorted(index) == [2, 2, 2, 3, 3, 3, 3]
    for one in finer:
        steps = basis @ np.linalg.inv(one)
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    assert not any(is_same_lattice(a, b, 0.04) for k, a in enumerate(finer) for b in finer[:k])
