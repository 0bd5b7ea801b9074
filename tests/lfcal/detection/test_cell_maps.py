"""Average cells of a flat with a known lattice."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.detection.cell_maps import CellMaps, CellParts, estimate_explained, measure_classes
from lfcal.detection.features import FlatFeatures
from lfcal.detection.folding import BINS

_PITCH = 21.4


@pytest.fixture
def basis(whites):
    return whites.turned(whites.HEXAGON, _PITCH, 7)


@pytest.fixture
def white(whites, basis):
    image, origin = whites.white_image(basis, (420, 360))
    return FlatFeatures(np.sqrt(np.asarray(image, np.float32) / image.mean())), origin


def test_cell_is_brightest_at_the_centre_of_the_lenses(white, basis):
    features, origin = white
    maps = CellMaps.measure(features, basis)
    parts = CellParts.about(origin @ np.linalg.inv(basis) % 1, basis)
    assert maps.light[parts.middle].min() > 1.5 * maps.light[parts.border].mean()
    assert maps.brightness[parts.middle].mean() > maps.brightness[parts.border].mean() + 1
    # Rims lie between the middle and the border.
    assert maps.edges.argmax() not in np.flatnonzero(parts.middle & (parts.distance < 0.4))
    assert maps.repeats > 0.95


def test_parts_of_a_cell_are_about_its_centre():
    basis = np.array([[20.0, 0.0], [0.0, 20.0]])
    parts = CellParts.about(np.array([0.25, 0.5]), basis)
    row, column = np.unravel_index(parts.distance.argmin(), parts.distance.shape)
    assert (column + 0.5) / BINS == pytest.approx(0.25, abs=1 / BINS)
    assert (row + 0.5) / BINS == pytest.approx(0.5, abs=1 / BINS)
    # A disc of 0.6 of the inradius in a square.
    assert parts.middle.mean() == pytest.approx(np.pi / 4 * 0.6**2, abs=0.03)
    assert parts.distance.max() == pytest.approx(np.sqrt(2), abs=0.1)
    assert not (parts.middle & parts.border).any()


def test_the_true_lattice_explains_most_of_a_scene(basis, white):
    features, origin = white
    rng = np.random.default_rng(2)
    # Lenses of random brightness with dark gaps, as of a scene.
    y, x = np.mgrid[:360, :420]
    index = np.rint((np.stack([x, y], -1) - origin) @ np.linalg.inv(basis)).astype(int)
    tones = rng.uniform(0.2, 1, (80, 80))[index[..., 1] + 40, index[..., 0] + 40]
    scene = FlatFeatures((features.picture * tones).astype(np.float32))
    own = estimate_explained(scene, basis)
    for other in (1.13 * basis, basis * [[1.0], [0.5]], basis @ [[0.99, -0.1], [0.1, 0.99]]):
        assert own > 1.5 * max(estimate_explained(scene, np.asarray(other)), 0.02)
    assert CellMaps.measure(scene, basis).explained() == pytest.approx(own, rel=0.3)


def test_half_a_cell_shows_lenses_and_gaps_in_turn(basis, white):
    features, _ = white
    assert measure_classes(features, basis).share < 0.02
    half = basis * [[0.5], [1.0]]
    found = measure_classes(features, half)
    assert found.share > 0.2
    # One class has the cells of the array again.
    assert abs(np.linalg.det(found.basis)) == pytest.approx(abs(np.linalg.det(basis)))
