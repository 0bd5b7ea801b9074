"""Features of flats that do not depend on how bright a flat is."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.detection.features import FlatFeatures


@pytest.fixture
def picture(whites):
    image, _ = whites.white_image(whites.turned(whites.HEXAGON, 17.3, 4), (260, 220))
    return np.sqrt(np.asarray(image, np.float32) / np.float32(image.mean()))


def test_brightness_and_edges_are_levelled_over_two_pitches(picture):
    # A slope of the light over the flat, which a lattice does not make.
    sloped = (picture * np.linspace(0.5, 1.5, picture.shape[1])).astype(np.float32)
    for even, uneven in zip(
        FlatFeatures(picture).levelled(17.3), FlatFeatures(sloped).levelled(17.3), strict=True
    ):
        assert abs(float(uneven.mean())) < 0.2 and 0.6 < float(uneven.std()) < 1.2
        assert np.corrcoef(even.ravel(), uneven.ravel())[0, 1] > 0.98


def test_pitches_of_one_octave_share_their_features(picture):
    features = FlatFeatures(picture)
    assert features.levelled(17.3) is features.levelled(16.1)
    assert features.levelled(17.3)[0] is not features.levelled(35.0)[0]


def test_every_step_counts_alike():
    rng = np.random.default_rng(4)
    picture = (1 + 0.001 * rng.standard_normal((120, 200))).astype(np.float32)
    picture[:, 60:] += 0.2
    picture[:, 140:] += 2.0
    across = FlatFeatures(picture).steps[:, 40:160].mean(0)
    weak, strong = across[[59 - 40, 60 - 40]].max(), across[[139 - 40, 140 - 40]].max()
    assert weak > 1 and weak == pytest.approx(strong, rel=0.2)
    # Edges themselves differ by the root of the steps.
    edges = FlatFeatures(picture).edges.mean(0)
    assert edges[140] / edges[60] == pytest.approx(np.sqrt(10), rel=0.05)
