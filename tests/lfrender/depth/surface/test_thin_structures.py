"""Thin structures before a far surface are propagated from lens to lens."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from lfrender.depth.matching.shortcuts import Shortcuts
from lfrender.depth.pipeline import estimate_depth_map
from lfrender.depth.surface.thin_structures import find_thin_structures
from lfrender.flat.lens_graph import opposite_neighbours

WALL, ROD = -15.0, -5.0
# A point of the rod, the direction in which it runs on, and its width [pitches].
MIDDLE, ALONG, WIDTH = np.array([210.0, 190.0]), np.array([0.6, 0.8]), 0.4


@pytest.fixture(scope="module")
def rod_before_a_wall(drawn_flat):
    """A rod that widens beyond 90 px before its middle: the flat and its lattice."""
    wall, lattice, _, _ = drawn_flat(WALL)
    rod, *_ = drawn_flat(ROD, seed=6)
    height, width = wall.image.shape
    y, x = np.mgrid[:height, :width].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    own = lattice.origin + np.rint(lattice.to_index(points)) @ lattice.basis
    away = own - (points - own) * lattice.pitch / ROD - MIDDLE
    across, along = np.abs(away @ np.array([ALONG[1], -ALONG[0]])), away @ ALONG
    seen = across < 0.5 * WIDTH * lattice.pitch + 0.5 * np.maximum(-along - 90, 0)
    image = np.where(seen.reshape(height, width), rod.image, wall.image)
    return dataclasses.replace(wall, image=image), lattice


def propagated(rod_before_a_wall, size):
    """What lenses find if one in the middle of the rod has `size` as second layer, how far they are from the rod
    [pitches], and which of them are off its wide end and the border."""
    gray, lattice = rod_before_a_wall
    centres = lattice.centres()
    away = centres - MIDDLE
    first = np.full(len(centres), WALL, np.float32)
    others = np.full((len(centres), 2), np.nan, np.float32)
    others[np.linalg.norm(away, axis=1).argmin(), 1] = size
    every = np.ones(len(centres), bool)
    texture = SimpleNamespace(flat=gray, noise=0.002, clear=every, faint=~every)
    found = find_thin_structures(texture, *opposite_neighbours(lattice), first, others, every, 1.2)
    narrow = (away @ ALONG > -60) & (away @ ALONG < 130)
    return found, np.abs(away @ np.array([ALONG[1], -ALONG[0]])) / lattice.pitch, narrow


def test_a_rod_is_propagated_from_one_lens_to_all_along_it(rod_before_a_wall):
    found, across, narrow = propagated(rod_before_a_wall, ROD + 0.2)
    beside = narrow & (across < 0.5)
    assert np.isfinite(found[beside]).mean() > 0.8
    assert np.abs(found[np.isfinite(found)] - ROD).max() < 0.5
    # A microimage shows the scene as far as its radius over |s|.
    assert np.isfinite(found[narrow & (across > 0.5 * WIDTH + 10.2 / abs(ROD) + 0.1)]).mean() < 0.02


def test_a_depth_without_content_is_not_propagated(rod_before_a_wall):
    assert not np.isfinite(propagated(rod_before_a_wall, -9.0)[0]).any()


def test_a_thin_rod_before_a_far_wall_is_in_the_dense_map(rod_before_a_wall):
    gray, lattice = rod_before_a_wall
    depth = estimate_depth_map(gray, lattice, "balanced", Shortcuts())
    places = MIDDLE + np.linspace(-50, 120, 60)[:, None] * ALONG
    assert (np.abs(depth.surface.at(places) - ROD) < 1).mean() > 0.6
    assert (np.abs(depth.patch_size - WALL) < 0.5).mean() > 0.85
