"""Distortion: centres and indices are inverse to each other; files keep it."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.lattice.distortion import Distortion

_BASIS = [[14.3, 0.2], [6.9, 12.4]]


def _bent(k1: float, k2: float = 0.0) -> lfcal.Lattice:
    return lfcal.Lattice(
        [100.0, 90.0], _BASIS, (800, 600), 6.0, Distortion([390.0, 310.0], k1, k2, 500.0)
    )


@pytest.mark.parametrize(("k1", "k2"), [(0.005, 0.0), (-0.02, 0.01), (0.05, -0.02)])
def test_indices_of_distorted_centres_are_whole(k1, k2):
    lattice = _bent(k1, k2)
    np.testing.assert_allclose(lattice.to_index(lattice.centres()), lattice.indices(), atol=1e-8)


def test_no_centre_on_the_flat_is_missed_under_distortion():
    lattice = _bent(0.05)
    every = np.stack(np.meshgrid(np.arange(-100, 100), np.arange(-100, 100)), -1).reshape(-1, 2)
    places = lattice.points(every)
    near = np.abs(every @ lattice.basis + lattice.origin - [400, 300]).max(1) < 700
    inside = near & ((places >= -0.5) & (places < [799.5, 599.5])).all(1)
    assert len(lattice) == inside.sum()


def test_distorted_centres_move_by_the_stated_share_of_their_distance():
    straight = Distortion([0, 0], 0.0, 0.0, 500.0)
    bent = Distortion([0, 0], 0.01, 0.0, 500.0)
    corner = np.array([[300.0, 400.0]])
    np.testing.assert_allclose(bent.apply(corner) - straight.apply(corner), corner * 0.005)


def test_camera_file_keeps_the_distortion(tmp_path):
    camera = lfcal.Calibration(_bent(-0.004, 0.001))
    camera.save(tmp_path / "camera.json")
    np.testing.assert_array_equal(
        lfcal.load(tmp_path / "camera.json").lattice.centres(), camera.lattice.centres()
    )


def test_camera_file_of_a_straight_lattice_has_no_distortion():
    straight = lfcal.Calibration(lfcal.Lattice([0, 0], _BASIS, (80, 60), 6.0))
    assert "distortion" not in straight.to_dict()["lattice"]


def test_general_distortion_is_inverted_and_kept(tmp_path):
    general = [[1.5, -2.0, 0.5, 1.0, 0.3, -0.7, 0.2], [0.1, 0.4, -1.0, 2.0, 0.0, 0.3, -1.5]]
    lattice = lfcal.Lattice(
        [100.0, 90.0],
        _BASIS,
        (800, 600),
        6.0,
        Distortion([390.0, 310.0], 0.002, 0.0, 500.0, general, [399.5, 299.5]),
    )
    np.testing.assert_allclose(lattice.to_index(lattice.centres()), lattice.indices(), atol=1e-6)
    lfcal.Calibration(lattice).save(tmp_path / "camera.json")
    np.testing.assert_array_equal(
        lfcal.load(tmp_path / "camera.json").lattice.centres(), lattice.centres()
    )


@pytest.mark.parametrize(
    "values", [([0, 0], 0.5, 0.0, 500.0), ([0, 0], 0.0, 0.0, 0.0), ([np.nan, 0], 0.0, 0.0, 1.0)]
)
def test_too_strong_distortion_is_refused(values):
    with pytest.raises(ValueError, match="distortion"):
        Distortion(*values)
