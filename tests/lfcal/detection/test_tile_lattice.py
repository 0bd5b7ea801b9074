"""The lattice through the tiles of a flat: periods that are slightly wrong are refined, the place
is found.
"""

from __future__ import annotations

import numpy as np

from lfcal.detection.folding import fold_tiles
from lfcal.detection.tile_lattice import fit_harmonics, refine_basis


def test_basis_off_by_a_thousandth_is_refined_over_the_whole_flat(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 11)
    image, _ = whites.white_image(basis, (700, 560))
    wrong = basis * 1.001 + [[0.01, 0.0], [0.0, -0.01]]
    found = refine_basis(fold_tiles([image.astype(np.float32)], wrong, 100, 36))
    # Lenses across the flat, each with this error.
    assert np.abs((found - basis) * 700 / 14.3).max() < 0.1


def test_origin_and_basis_are_found_from_a_start_off_by_half_a_pixel(whites):
    basis = whites.turned(whites.SQUARE, 16.4, 7)
    image, origin = whites.white_image(basis, (640, 520))
    start = basis * 1.0005
    folds = fold_tiles([image.astype(np.float32)], start, 110, 36)
    middle = np.array([320.0, 260.0])
    near = origin + np.rint((middle - origin) @ np.linalg.inv(basis)) @ basis
    fit = fit_harmonics(folds, near + np.array([0.4, -0.3]))
    index = (fit.origin - origin) @ np.linalg.inv(basis)
    assert np.abs((index - np.rint(index)) @ basis).max() < 0.02
    assert np.abs((fit.basis - basis) * 640 / 16.4).max() < 0.05
    assert fit.half_difference < 0.05


def test_noise_has_no_lattice():
    noise = np.random.default_rng(0).standard_normal((300, 300)).astype(np.float32)
    fit = fit_harmonics(
        fold_tiles([noise], np.diag([15.0, 15.0]), 100, 36), np.array([150.0, 150.0])
    )
    assert not fit.half_difference < 0.3
