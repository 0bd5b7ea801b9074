"""The offset between two lattices: what it is, when it is small, and where it leads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal import Lattice
from lfcal.display.misfit import MOST_SHIFT, MOST_STRETCH, Misfit

_PITCH = 20.0


@pytest.fixture
def lattice():
    return Lattice([13.0, 11.0], [[_PITCH, 0.0], [0.0, _PITCH]], (400, 300), 9.0)


def _changed(lattice, shift, change):
    middle = (np.array(lattice.image_size) - 1) / 2
    origin = middle + (lattice.origin - middle) @ change + shift
    return replace(lattice, origin=origin, basis=lattice.basis @ change)


def test_shift_and_map_between_two_lattices_lead_from_one_to_the_other(lattice):
    turn = np.radians(0.2)
    change = 1.001 * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    found = _changed(lattice, [1.5, -0.75], change)
    misfit = Misfit.between(lattice, found)
    # The shift is that of the centre nearest to the middle, at most half a cell away.
    half_cell = np.linalg.norm(change - np.eye(2), 2) * _PITCH / np.sqrt(2)
    np.testing.assert_allclose(misfit.shift, [1.5, -0.75], atol=half_cell)
    np.testing.assert_allclose(misfit.linear, change - np.eye(2), atol=1e-12)
    moved = misfit.applied(lattice)
    index = found.to_index(moved.centres())
    np.testing.assert_allclose(index, np.rint(index), atol=2 * half_cell / _PITCH)


def test_other_basis_of_the_same_points_is_no_offset(lattice):
    sheared = replace(lattice, basis=np.array([[1, 0], [1, 1]]) @ lattice.basis)
    misfit = Misfit.between(lattice, sheared)
    np.testing.assert_allclose(misfit.linear, 0, atol=1e-12)
    assert misfit.distance == pytest.approx(0, abs=1e-9) and misfit.is_negligible


@pytest.mark.parametrize("factor", [0.5, np.sqrt(2), 1.2])
def test_other_cells_have_no_offset(lattice, factor):
    turned = np.array([[1, 1], [-1, 1]]) / np.sqrt(2) if factor == np.sqrt(2) else np.eye(2)
    assert Misfit.between(lattice, replace(lattice, basis=factor * lattice.basis @ turned)) is None


def test_limits_of_shift_and_stretch(lattice):
    near = Misfit(np.array([0.9 * MOST_SHIFT * _PITCH, 0]), np.zeros((2, 2)), (400, 300), _PITCH)
    assert near.is_small and not near.is_negligible
    assert not near._replace(shift=near.shift / 0.8).is_small
    corner = np.hypot(200, 150)
    stretch = 1.1 * MOST_STRETCH * _PITCH / corner * np.eye(2)
    stretched = Misfit(np.zeros(2), stretch, (400, 300), _PITCH)
    assert stretched.stretch == pytest.approx(1.1 * MOST_STRETCH)
    assert stretched.is_stretched and not stretched._replace(error=1.2 * MOST_STRETCH).is_stretched


def test_offsets_in_pixels_of_the_flat_before_downscaling(lattice):
    small = lattice.downscaled(2)
    misfit = Misfit(np.array([1.0, 0.5]), 0.01 * np.eye(2), small.image_size, small.pitch)
    full = misfit.upscaled(lattice)
    np.testing.assert_allclose(full.shift, [2.0, 1.0])
    assert full.stretch == pytest.approx(misfit.stretch) and full.distance == misfit.distance
