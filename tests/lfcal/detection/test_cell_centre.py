"""Where in an average cell a microimage may have its centre."""

from __future__ import annotations

import numpy as np

from lfcal.detection.cell_centre import find_round_centres
from lfcal.lattice.cell import bin_offsets

_SQUARE = np.array([[30.0, 0.0], [0.0, 30.0]])


def test_round_centre_is_found_to_a_bin():
    offsets = bin_offsets(_SQUARE, 36, np.array([0.5, 0.5]) / 36)
    disc = (np.linalg.norm(offsets, axis=2) < 12).astype(float)
    best = find_round_centres([np.roll(disc, (7, 20), axis=(0, 1))], _SQUARE)[0]
    np.testing.assert_allclose(best, np.array([20.5, 7.5]) / 36)
