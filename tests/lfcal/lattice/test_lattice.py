"""Lattices: reduction to one canonical basis, neighbours, and the lenses on a flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfcal import Lattice
from lfcal.lattice import lattice
from lfcal.lattice.distortion import Distortion
from lfcal.lattice.lattice import irregularity, nearest_regular_ratio, reduce_basis, shorten_bases

_UNIMODULAR = st.sampled_from(
    [[[1, 0], [0, 1]], [[2, 1], [1, 1]], [[1, -3], [0, 1]], [[0, 1], [1, 0]], [[-1, 0], [5, 1]]]
)


def _turn(basis, degrees):
    c = np.cos(np.radians(degrees))
    s = np.sin(np.radians(degrees))
    return np.asarray(basis) @ np.array([[c, s], [-s, c]])


@given(
    st.floats(0, 360),
    st.floats(-0.5, 0.5),
    st.floats(0.8, 3.0),
    st.floats(3.0, 200.0),
    _UNIMODULAR,
)
def test_reduced_basis_spans_the_same_lattice_at_60_to_90_degrees(
    degrees, lean, height, pitch, mixture
):
    basis = _turn([[pitch, 0], [lean * pitch, height * pitch]], degrees)
    reduced = reduce_basis(np.array(mixture) @ basis)
    index = reduced @ np.linalg.inv(basis)
    assert np.abs(index - np.rint(index)).max() < 1e-6
    assert np.linalg.det(reduced) == pytest.approx(abs(np.linalg.det(basis)), rel=1e-9)
    cosine = reduced[0] @ reduced[1] / np.prod(np.hypot(*reduced.T))
    assert -1e-3 < cosine < 0.51


@pytest.mark.parametrize("basis", [[[1, 0], [2, 0]], [[0, 0], [1, 1]], [[1, np.nan], [0, 1]]])
def test_degenerate_basis_is_refused(basis):
    with pytest.raises(ValueError, match="basis"):
        reduce_basis(basis)


_TIE = [[0.016881795122772672, -0.03378560257288819], [0.03378560257288819, -0.016881795122772672]]


@pytest.mark.parametrize(
    "pair",
    [
        _TIE,
        [[1.0, 0.0], [2.0, 0.0]],
        [[0.3, 0.1], [0.9, 0.3]],
        [[0.0, 0.0], [0.0, 0.0]],
        [[0.0, 0.0], [1.0, 2.0]],
        [[np.nan, 1.0], [1.0, 0.0]],
        [[np.inf, 1.0], [1.0, 0.0]],
    ],
)
def test_reduction_ends_at_ties_and_for_degenerate_vectors(pair):
    plain = [[20.0, 0.0], [50.0, 20.0]]
    found = shorten_bases([pair, plain])
    assert found.shape == (2, 2, 2)
    np.testing.assert_allclose(np.abs(found[1]), [[20, 0], [10, 20]], atol=1e-12)


@given(st.floats(0, 360), st.sampled_from([0.5, np.nextafter(0.5, 1), -0.5]), _UNIMODULAR)
def test_shortest_vectors_of_hexagons_are_found_from_any_basis(degrees, lean, mixture):
    basis = _turn([[20, 0], [20 * lean, 20 * np.sqrt(0.75)]], degrees)
    found = shorten_bases([np.array(mixture) @ basis])[0]
    np.testing.assert_allclose(np.hypot(*found.T), 20, rtol=1e-9)


@given(st.floats(0, 90))
def test_hexagons_have_six_neighbours_and_squares_four(degrees):
    for basis, count in (([[20, 0], [10, 20 * np.sqrt(0.75)]], 6), ([[20, 0], [0, 20]], 4)):
        lattice = Lattice((3, 4), reduce_basis(_turn(basis, degrees)), (100, 100), 9)
        assert len(lattice.steps) == count
        assert lattice.pitch == pytest.approx(20)


def test_every_lens_on_the_flat_is_listed_once():
    lattice = Lattice((50.2, 40.1), _turn([[10, 0], [5, 9]], 20), (100, 80), 4)
    centres = lattice.centres()
    wide = (
        lattice.origin
        + np.array([(i, j) for i in range(-30, 31) for j in range(-30, 31)]) @ lattice.basis
    )
    inside = ((wide >= -0.5) & (wide < [99.5, 79.5])).all(1)
    assert len(lattice) == len(centres) == inside.sum()
    np.testing.assert_allclose(lattice.to_index(centres), lattice.indices(), atol=1e-9)


def test_a_downscaled_lattice_has_the_same_lenses_in_larger_pixels():
    distortion = Distortion(
        (300.0, 250.0), 0.01, -0.004, 400.0, np.full((2, 7), 0.3), (320.0, 240.0)
    )
    lattice = Lattice((301.2, 233.7), [[23.2, 0.4], [11.3, 20.1]], (641, 479), 11.0, distortion)
    small = lattice.downscaled(3)
    assert small.image_size == (213, 159)
    assert (small.indices() == lattice.indices()).all()
    # Pixel 0 of three covers pixels 0 to 2 of the flat, and its centre is that of pixel 1.
    np.testing.assert_allclose(small.centres() * 3 + 1, lattice.centres(), atol=1e-9)
    assert small.pitch == pytest.approx(lattice.pitch / 3)


@pytest.mark.parametrize("basis", [[[20.1, 11.6], [0.0, 23.2]], [[23.2, 0.3], [11.9, 20.0]]])
def test_lenses_come_from_top_to_bottom_each_once(basis):
    lattice = Lattice([301.3, 222.2], basis, (640, 480), 9.0)
    indices = lattice.indices()
    centres = lattice.centres()
    np.testing.assert_allclose(centres, lattice.points(indices))
    i, j = np.mgrid[-60:60, -60:60].reshape(2, -1)
    all_centres = lattice.points(np.column_stack([i, j]))
    inside = ((all_centres >= -0.5) & (all_centres < [639.5, 479.5])).all(1)
    assert {*map(tuple, indices.tolist())} == {
        *zip(i[inside].tolist(), j[inside].tolist(), strict=True)
    }
    assert len(indices) == inside.sum()
    # Lenses of one row may differ by what the lattice is turned.
    assert np.diff(centres[:, 1]).min() > -lattice.pitch


def test_lattice_with_another_radius_has_the_same_lenses():
    lattice = Lattice([3.0, 2.0], [[6.1, 0.2], [2.9, 5.4]], (400, 300), 3.0)
    other = lattice.with_radius(2.5)
    assert (lattice.radius, other.radius) == (3.0, 2.5)
    np.testing.assert_array_equal(other.indices(), lattice.indices())
    np.testing.assert_array_equal(other.basis, lattice.basis)


@pytest.mark.parametrize(
    "basis", [[[9.1, 0.4], [4.2, 8.3]], [[0.0, 11.0], [9.0, 0.0]], [[7.0, -7.0], [7.0, 7.0]]]
)
def test_lenses_of_a_large_lattice_are_gathered_piece_by_piece(basis, monkeypatch):
    x, y = np.mgrid[-200:201, -200:201].reshape(2, -1)
    straight = Lattice([400.3, 300.2], basis, (800, 600), 4.0)
    points = straight.points(np.column_stack([x, y]))
    on = ((points >= -0.5) & (points < [799.5, 599.5])).all(1)
    monkeypatch.setattr(lattice, "_CHUNK", 500)
    pieces = replace(straight)
    assert {tuple(ij) for ij in pieces.indices().tolist()} == set(
        zip(x[on].tolist(), y[on].tolist(), strict=True)
    )
    assert len(pieces) == on.sum()
    np.testing.assert_allclose(pieces.centres(), pieces.points(pieces.indices()), atol=1e-9)


@pytest.mark.parametrize("degrees", [0, 11, 44, -29])
def test_irregularity_of_turned_and_stretched_arrays(degrees):
    hexagonal = [(20.0, 0.0), (10.0, 20 * 0.75**0.5)]
    assert irregularity(reduce_basis(_turn(hexagonal, degrees))) < 1e-9
    stretched = reduce_basis(_turn([(20.0, 0.0), (0.0, 20.6)], degrees))
    assert irregularity(stretched) == pytest.approx(0.03, abs=0.001)
    assert nearest_regular_ratio(stretched) == 1j
