"""The depths that a surface has about a place."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.depth.edges.candidates import list_depths, mark_levels
from lfrender.depth.edges.microimage import make_microimage
from lfrender.depth.surface.scene_grid import PointGrid, lens_array

PITCH = 20.0
LATTICE = Lattice([10.0, 10.0], [[PITCH, 0], [0, PITCH]], (200, 160), 9.0)


def _bit(size):
    return np.uint64(1) << np.uint64(int((size / PITCH + 0.8) * 40 + 0.37))


def test_levels_of_a_place_are_those_within_reach():
    surface = np.full((15, 20), 4.0, np.float32)
    surface[7, 9] = -6.0
    levels = mark_levels(surface, PITCH, 3)
    marked = (levels & _bit(-6.0)) != 0
    expected = np.zeros_like(marked)
    expected[4:11, 6:13] = True
    np.testing.assert_array_equal(marked, expected)
    assert ((levels & _bit(4.0)) != 0).all()
    assert ((levels & _bit(8.0)) == 0).all()


def test_levels_of_a_mirrored_surface_are_mirrored():
    surface = np.random.default_rng(0).uniform(-10, 10, (15, 20)).astype(np.float32)
    levels = mark_levels(surface, PITCH, 2)
    mirrored = mark_levels(np.ascontiguousarray(surface[:, ::-1]), PITCH, 2)
    np.testing.assert_array_equal(mirrored[:, ::-1], levels)


@pytest.mark.parametrize("size", [5.0, -5.0])
def test_depths_of_a_lens_are_those_of_the_surface_it_may_show(size):
    spacing = PITCH / 7
    surface = np.full((57, 71), size, np.float32)
    # Scene points right of x = 150 px: a lens at x = 30 px shows none of them.
    surface[:, 53:] = 9.0
    lenses = lens_array(LATTICE, 0.05 * PITCH, 8.0)
    work = make_microimage(19)
    grid = PointGrid(-0.5, spacing)
    assert list_depths(surface, grid, 30.0, 70.0, lenses, work) == 1
    assert work.depths[0] == pytest.approx(size, abs=1e-4)
    assert list_depths(surface, grid, 150.0, 70.0, lenses, work) == 2
    np.testing.assert_allclose(sorted(work.depths[:2]), sorted([size, 9.0]), atol=1e-4)


def test_rounding_errors_of_simple_patch_sizes_change_no_depth():
    spacing = PITCH / 7
    grid = PointGrid(-0.5, spacing)
    lenses = lens_array(LATTICE, 0.04 * PITCH, 8.0)
    found = []
    for error in (-1e-6, 1e-6):
        # Tenths and hundredths of a pitch, one after the other.
        sizes = np.float32(PITCH) * np.float32([0.2, 0.24, 0.26, 0.3, 0.31, 0.37])
        surface = np.tile(np.repeat(sizes * np.float32(1 + error), 4), (57, 3))[:, :71]
        work = make_microimage(19)
        number = list_depths(np.ascontiguousarray(surface), grid, 90.0, 70.0, lenses, work)
        found.append(work.depths[:number].copy())
        levels = mark_levels(np.ascontiguousarray(surface), PITCH, 2)
        found.append(levels)
    np.testing.assert_allclose(found[2], found[0], atol=1e-4)
    np.testing.assert_array_equal(found[3], found[1])
