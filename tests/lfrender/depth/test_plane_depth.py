"""One plane for the lenses of a flat: which ones may be believed."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.depth.plane_depth import fit_regular_plane
from lfrender.flat.lens_graph import opposite_neighbours

_PITCH, _ERROR = 20.0, 0.05


def _plane(slope: float, count_over_lenses: float):
    """What `fit_regular_plane` finds where all lenses lie on a plane, `1 / s` of which falls by the share `slope`."""
    lattice = Lattice(np.array([15.0, 15.0]), _PITCH * np.array([[1, 0], [0.5, 0.75**0.5]]), (800, 600), 9.5)
    centres = lattice.centres()
    across = centres[:, 0] / centres[:, 0].max() - 0.5
    sizes = 6 / (1 + slope * across) + np.random.default_rng(2).normal(0, _ERROR, len(centres))
    return fit_regular_plane(
        centres,
        int(len(centres) * count_over_lenses),
        _PITCH,
        sizes.astype(np.float32),
        np.full(len(centres), _ERROR, np.float32),
        np.zeros(len(centres), np.int8),
        np.zeros(len(centres)),
        np.hstack(opposite_neighbours(lattice)),
    )


@pytest.mark.parametrize("count_over_lenses", [1, 5])
def test_a_plane_that_faces_the_camera_is_accepted_from_few_lenses(count_over_lenses):
    found = _plane(0, count_over_lenses)
    assert found is not None and not found.slanted
    assert found.at(np.array([[400.0, 300.0]])) == pytest.approx(6, abs=0.01)


def test_a_slanted_plane_is_accepted_only_from_most_lenses():
    found = _plane(0.3, 1)
    assert found is not None and found.slanted
    assert found.at(np.array([[10.0, 300.0]])) == pytest.approx(6 / 0.85, abs=0.05)
    assert _plane(0.3, 5) is None
