"""Pixels of several lenses are fused into the depth of a scene point."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.depth.edges.fusion import fuse_pixel_depths
from lfrender.depth.surface.scene_grid import PointGrid, lens_array

PITCH = 20.0
LATTICE = Lattice([10.0, 10.0], [[PITCH, 0], [0, PITCH]], (200, 160), 9.0)
LENSES = lens_array(LATTICE, 0.05 * PITCH, 8.0)
GRID = PointGrid(-0.5, PITCH / 7)
NEAR = 9.0
FAR = 5.0


def _fuse(pixels, surface):
    out = np.full((2 * surface.shape[0], 2 * surface.shape[1]), np.nan, np.float32)
    fuse_pixel_depths(pixels, LENSES, surface, GRID, np.ones(surface.shape, bool), 10, out)
    return out


@pytest.fixture
def surface():
    """Near right of x = 100 px."""
    values = np.full((57, 71), FAR, np.float32)
    values[:, 36:] = NEAR
    return values


@pytest.mark.parametrize("size", [NEAR, FAR])
def test_points_have_the_depth_that_all_pixels_show(surface, size):
    fused = _fuse(np.full((160, 200), size, np.float32), surface)
    # The list of depths of a place far from the other surface has one entry.
    np.testing.assert_allclose(fused[20:-20, 60:90], size, atol=1e-5)


def test_without_pixels_nothing_is_changed(surface):
    fused = _fuse(np.full((160, 200), np.nan, np.float32), surface)
    assert np.isnan(fused).all()


def test_two_surfaces_of_equal_votes_are_mirrored_with_the_flat(surface):
    pixels = np.random.default_rng(0).choice([NEAR, FAR], (160, 200)).astype(np.float32)
    # The mirrored scene has its first grid value where the last one was.
    last = GRID.first + GRID.spacing * (surface.shape[1] - 1)
    mirrored_grid = PointGrid(199 - last, GRID.spacing)
    out = np.full((114, 142), np.nan, np.float32)
    fuse_pixel_depths(
        np.ascontiguousarray(pixels[:, ::-1]),
        lens_array(
            Lattice([9.0, 10.0], [[PITCH, 0], [0, PITCH]], (200, 160), 9.0), 0.05 * PITCH, 8.0
        ),
        np.ascontiguousarray(surface[:, ::-1]),
        mirrored_grid,
        np.ones(surface.shape, bool),
        10,
        out,
    )
    same = np.isclose(out[:, ::-1], _fuse(pixels, surface), atol=1e-4)
    # Four points of a row share a list of depths, which begins elsewhere in a mirrored row.
    assert same[20:-20, 20:-20].mean() > 0.95
