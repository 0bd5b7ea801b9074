"""Lenses by their place, and counts of neighbours."""

from __future__ import annotations

import numpy as np

from data_synth import Camera
from lfrender.flat.lens_graph import (
    count_connected,
    count_neighbours,
    count_similar,
    dilate_mask,
    nearest_lens,
)


def test_nearest_lens_of_each_centre_is_itself():
    lattice = Camera.design((600, 450), 20.0, "hex").lattice
    centres = lattice.centres()
    offset = np.random.default_rng(0).uniform(-5, 5, centres.shape)
    np.testing.assert_array_equal(nearest_lens(centres, centres + offset), np.arange(len(centres)))


# Five lenses in a row, each with those on either side.
ROW = np.array([[1, -1], [0, 2], [1, 3], [2, 4], [3, -1]], np.int32)


def test_neighbours_are_counted_where_there_are_any():
    mask = np.array([True, True, False, False, True])
    np.testing.assert_array_equal(count_neighbours(mask, ROW), [1, 1, 1, 1, 0])
    np.testing.assert_array_equal(count_connected(mask, ROW), [1, 1, 0, 0, 0])
    np.testing.assert_array_equal(dilate_mask(mask, ROW), [True, True, True, True, True])
    np.testing.assert_array_equal(dilate_mask(np.arange(5) == 4, ROW), np.arange(5) >= 3)


def test_similar_neighbours_differ_by_the_gap_at_most():
    sizes = np.array([5.0, 5.5, 6.5, np.nan, 9.0], np.float32)
    everywhere = np.ones(5, bool)
    np.testing.assert_array_equal(count_similar(everywhere, sizes, ROW, 0.5), [1, 1, 0, 0, 0])
    np.testing.assert_array_equal(count_similar(everywhere, sizes, ROW, 1.0), [1, 2, 1, 0, 0])
    beside = np.arange(5) != 1
    np.testing.assert_array_equal(count_similar(beside, sizes, ROW, 1.0), [0, 2, 0, 0, 0])
