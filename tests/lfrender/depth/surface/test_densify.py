"""Depth edges between lenses are located on the pixels, to the grid of the surface."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import lfrender
from benchmarks.stress.plane_flats import PlaneFlat
from lfrender.depth.surface.densify import densify

NEAR = 9.0
FAR = 5.0
EDGE = 214.0
CELLS = 7


@pytest.fixture(scope="module")
def edged_flat(drawn_flat):
    """A plane before another, for scene points right of `EDGE`, and the patch sizes at the centres
    of lenses.
    """
    near, lattice, _, _ = drawn_flat(NEAR, seed=1)
    far, *_ = drawn_flat(FAR, seed=2)
    height, width = near.image.shape
    y, x = np.mgrid[:height, :width].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    own = lattice.origin + np.rint(lattice.to_index(points)) @ lattice.basis
    seen = own[:, 0] - (points[:, 0] - own[:, 0]) * lattice.pitch / NEAR
    image = np.where(seen.reshape(height, width) > EDGE, near.image, far.image)
    values = np.where(lattice.centres()[:, 0] > EDGE, NEAR, FAR).astype(np.float32)
    return dataclasses.replace(near, image=image), lattice, values


def _edges(surface):
    """Scene coordinate x of the step in every row of the surface, off the border."""
    steps = np.abs(np.diff(surface.patch_size[3 * CELLS : -3 * CELLS], axis=1))
    return surface.first[0] + surface.spacing * (steps.argmax(1) + 0.5)


def test_a_depth_edge_lies_where_the_pixels_have_it(edged_flat):
    gray, lattice, values = edged_flat
    nothing = np.full(len(values), np.nan, np.float32)
    found = densify(gray, lattice, values, nothing, np.ones_like(values), 0.001, CELLS)
    # The lenses alone put it anywhere within half a pitch, values of twice the spacing within a
    # whole cell.
    assert np.median(np.abs(_edges(found) - EDGE)) <= 0.5 * found.spacing
    assert np.mean(np.abs(_edges(found) - EDGE) > 1.5 * found.spacing) < 0.1


def test_no_depth_lies_between_those_of_two_surfaces(edged_flat):
    gray, lattice, values = edged_flat
    nothing = np.full(len(values), np.nan, np.float32)
    found = densify(gray, lattice, values, nothing, np.ones_like(values), 0.001, CELLS).patch_size
    apart = np.minimum(np.abs(found - NEAR), np.abs(found - FAR))
    assert apart.max() < 1.0


def test_values_far_from_an_edge_are_those_of_the_lenses_about_them(edged_flat):
    gray, lattice, _ = edged_flat
    values = (6 + 0.004 * lattice.centres()[:, 0]).astype(np.float32)
    nothing = np.full(len(values), np.nan, np.float32)
    found = densify(gray, lattice, values, nothing, np.ones_like(values), 0.001, CELLS)
    inside = slice(2 * CELLS, -2 * CELLS)
    x = found.first[0] + found.spacing * np.arange(found.patch_size.shape[1])
    assert np.abs(found.patch_size - (6 + 0.004 * x))[inside, inside].max() < 0.02


def test_lenses_of_no_confidence_leave_no_point_without_depth(edged_flat):
    gray, lattice, values = edged_flat
    nothing = np.full(len(values), np.nan, np.float32)
    found = densify(
        gray, lattice, values, nothing, np.where(values == FAR, np.float32(0), 1), 0.001, CELLS
    )
    assert np.isfinite(found.patch_size).all()


def test_a_coarse_grid_beyond_all_lenses_leaves_no_point_without_depth():
    # In the corners of a small flat of long cells no lens lies near.
    flat = PlaneFlat(
        ratio=1.0,
        slant=(0.0095, 0.051),
        cell="oblong",
        pitch=6.0,
        degrees=137.14443558389954,
        size=(80, 40),
        contrast=0.05,
        noise=0.0,
        grain=0.9,
        period=0.0,
        exposure=0.35651357544053813,
        fill=0.8,
        kind="f4",
        seed=60016,
    )
    depth = lfrender.analyze(flat.flat(), flat.calibration)
    assert np.isfinite(depth.surface.patch_size).all()
