"""Profiles of microimages from sums over pixels."""

from __future__ import annotations

import numpy as np

from lfcal.lattice.cell import Cell
from lfcal.microimage.average import (
    LensPixels,
    ProfilePlaces,
    average_profile,
    estimate_variance,
)

from ._dots import LATTICE


def test_pixels_of_cells_are_each_pixel_of_a_flat_once():
    picture = np.arange(240 * 300, dtype=np.float32).reshape(240, 300)
    # With the lenses beside the flat.
    i, j = np.mgrid[-30:60, -30:60].reshape(2, -1)
    centres = LATTICE.points(np.column_stack([i, j]))
    pixels = LensPixels.of(picture, centres, Cell.of(LATTICE))
    np.testing.assert_array_equal(np.sort(pixels.value), np.arange(picture.size))
    x, y = centres[pixels.lens].T
    np.testing.assert_allclose(pixels.value, np.rint(y + pixels.y) * 300 + np.rint(x + pixels.x))


def test_strides_leave_out_rows_and_columns_and_wider_borders_take_more():
    picture = np.ones((240, 300), np.float32)
    _, centres = LATTICE.select_whole(20)
    cell = Cell.of(LATTICE)
    whole, fewer, wider = (
        len(LensPixels.of(picture, centres, cell, stride, border).lens)
        for stride, border in (((1, 1), 0.5), ((2, 3), 0.5), ((1, 1), 0.6))
    )
    assert abs(fewer / whole - 1 / 6) < 0.005
    assert abs(wider / whole - 1.2**2) < 0.02


def test_reading_a_profile_is_the_adjoint_of_adding_to_it():
    rng = np.random.default_rng(0)
    places = ProfilePlaces.of(rng.uniform(0, 12, 300), 10)
    values = rng.normal(size=300)
    profile = rng.normal(size=10)
    assert abs(places.add(values, 10) @ profile - places.read(profile) @ values) < 1e-9


def test_places_beyond_a_profile_have_its_last_value():
    places = ProfilePlaces.of(np.array([0.0, 2.25, 40.0]), 4)
    np.testing.assert_allclose(places.read(np.array([1.0, 2, 4, 8])), [1, 5, 8])


def test_several_profiles_are_added_side_by_side():
    places = ProfilePlaces.of(np.array([1.5, 0.0]), 3)
    sums = places.add(np.array([2.0, 5.0]), 6, np.array([0, 3]))
    np.testing.assert_array_equal(sums, [0, 1, 1, 5, 0, 0])


def test_samples_with_hardly_a_pixel_are_interpolated():
    number = np.array([1000.0, 0, 0.5, 1000])
    profile = average_profile(np.array([4000.0, 0, 50, 1000]), number)
    np.testing.assert_allclose(profile, [4, 3, 2, 1])


def test_variance_of_samples_is_that_of_their_pixels():
    number = np.full(40, 500.0)
    truth = np.repeat([1.0, 4.0], 20)
    found = estimate_variance(truth * number, number)
    np.testing.assert_allclose(found[[10, 30]], [1, 4], rtol=0.02)
