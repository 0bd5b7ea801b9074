"""Periods that are slightly wrong are refined to those of the flat."""

from __future__ import annotations

import numpy as np

from lfcal.detection.folding import fold_tiles
from lfcal.detection.period_refinement import refine_basis


def test_basis_off_by_a_thousandth_is_refined_over_the_whole_flat(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 11)
    image, _ = whites.white_image(basis, (700, 560))
    wrong = basis * 1.001 + [[0.01, 0.0], [0.0, -0.01]]
    found, coherence = refine_basis(fold_tiles([image.astype(np.float32)], wrong, 100, 36))
    # Lenses across the flat, each with this error.
    assert np.abs((found - basis) * 700 / 14.3).max() < 0.1
    assert coherence > 0.9
