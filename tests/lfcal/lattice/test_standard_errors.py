"""Standard errors of a lattice: kept in camera files, and how far its parameters are correlated."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.lattice.standard_errors import LatticeErrors, equal_weight_errors


def test_camera_file_keeps_the_standard_errors(tmp_path):
    lattice = lfcal.Lattice([10.0, 9.0], [[14.3, 0.2], [6.9, 12.4]], (300, 200), 6.0)
    camera = lfcal.Calibration(lattice, errors=equal_weight_errors(lattice, 0.02))
    camera.save(tmp_path / "camera.json")
    kept = lfcal.load(tmp_path / "camera.json").errors.of_centres(lattice)
    np.testing.assert_allclose(np.sqrt((kept**2).mean()), 0.02, rtol=1e-9)
    middle, corner = lattice.centres() - [150, 100], np.hypot(150, 100)
    assert kept[np.hypot(*middle.T) < 20].max() < 0.7 * kept[np.hypot(*middle.T) > 0.85 * corner].min()


def test_the_condition_of_a_fit_is_larger_for_strips_and_independent_of_the_unit():
    def condition(size, origin):
        return equal_weight_errors(lfcal.Lattice(origin, [[10.0, 0.0], [0.0, 10.0]], size, 4.0), 0.02).condition

    assert 1 <= condition((300, 300), (150.0, 150.0)) < 1.2
    # With the origin in a corner, origin and basis are correlated.
    assert 4 < condition((300, 300), (5.0, 5.0)) < 6
    assert condition((900, 20), (455.0, 5.0)) > 2
    errors = equal_weight_errors(lfcal.Lattice((5.0, 5.0), [[10.0, 0.0], [0.0, 10.0]], (300, 300), 4.0), 0.02)
    assert errors.scaled(8.0).condition == pytest.approx(errors.condition)
    # All parameters are fully correlated.
    assert LatticeErrors(errors.names, np.full((6, 6), 1e-6)).condition > 1e6
