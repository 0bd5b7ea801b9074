"""Bases of lattices from the peaks of power spectra."""

from __future__ import annotations

from itertools import islice

import cv2
import numpy as np
import pytest

from lfcal.detection.features import FlatFeatures
from lfcal.detection.spectrum import find_periods, is_same_lattice

SIZE = (420, 360)


def spots(basis, noise=0.02, seed=0):
    """A picture of round spots on the points of a lattice, of different brightness."""
    basis = np.asarray(basis, float)
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    index = np.stack([x, y], -1) @ np.linalg.inv(basis)
    away = np.hypot(*np.moveaxis((index - np.rint(index)) @ basis, -1, 0))
    radius = 0.4 * np.sqrt(abs(np.linalg.det(basis)))
    light = 0.2 + 0.6 * cv2.GaussianBlur(rng.random(x.shape), (0, 0), 15)
    picture = np.where(away < radius, light, 0.05) + rng.normal(0, noise, x.shape)
    return FlatFeatures(picture.astype(np.float32))


@pytest.mark.parametrize(
    "basis",
    [
        [[14.3, 0.0], [0.0, 14.3]],
        [[23.2, 0.4], [11.25, 20.3]],
        [[11.0, 2.1], [-2.5, 13.0]],
        [[31.0, -5.0], [5.0, 31.0]],
    ],
    ids=["square", "hexagonal", "oblique", "turned"],
)
def test_the_first_basis_is_that_of_the_spots(basis):
    found = next(find_periods(spots(basis)))
    assert is_same_lattice(found, np.asarray(basis), 0.02), found


def test_a_mirrored_picture_has_the_mirrored_basis():
    features = spots([[11.0, 2.1], [-2.5, 13.0]])
    mirrored = FlatFeatures(np.ascontiguousarray(features.picture[:, ::-1]))
    found = next(find_periods(mirrored))
    assert is_same_lattice(found, np.array([[-11.0, 2.1], [2.5, 13.0]]), 0.02), found


def test_no_lattice_is_given_twice():
    found = list(islice(find_periods(spots([[14.3, 0.0], [0.0, 14.3]])), 6))
    for k, basis in enumerate(found):
        assert not any(is_same_lattice(basis, other) for other in found[:k])


def test_noise_and_small_pictures_have_no_periods():
    noise = np.random.default_rng(2).random((300, 400)).astype(np.float32)
    assert list(find_periods(FlatFeatures(noise))) == []
    assert list(find_periods(FlatFeatures(noise[:12, :12].copy()))) == []


def test_bases_that_span_the_same_points_are_one_lattice():
    basis = np.array([[20.0, 1.0], [9.0, 17.0]])
    whole = np.array([[2.0, 1.0], [1.0, 1.0]])
    assert is_same_lattice(whole @ basis, basis)
    assert is_same_lattice(1.01 * basis, basis)
    assert not is_same_lattice(1.05 * basis, basis)
    # Every second point is another lattice.
    assert not is_same_lattice(np.diag([2.0, 1.0]) @ basis, basis)
