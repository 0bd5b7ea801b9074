"""Where a person should look to check a calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import lfcal
from lfcal.display.places_to_check import find_places_to_check
from lfcal.lattice.residuals import Residuals


def test_circles_gap_and_worst_lens_are_named_at_their_places(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (700, 500))
    camera = lfcal.Calibration(lfcal.Lattice(origin, basis, (700, 500), 9.0))
    circles, gap = find_places_to_check(camera, image)
    assert circles.sentence.startswith("0 of ") and len(circles.circles) > 100
    assert "of the light" in gap.sentence
    index = camera.lattice.indices()[[40, 300]]
    offset = np.array([(0.01, 0.0), (0.0, -0.8)], np.float32)
    _, lens, _ = find_places_to_check(replace(camera, residuals=Residuals(index, offset)), image)
    np.testing.assert_allclose(lens.position, camera.lattice.points(index[1]))
    assert "0.80 px" in lens.sentence
    # Gaps taken for lenses: all circles lie beside the lattice, and gaps are the brighter ones.
    beside = lfcal.Calibration(lfcal.Lattice(origin + basis.sum(0) / 3, basis, (700, 500), 9.0))
    circles, gap = find_places_to_check(beside, image)
    off, count = (int(words) for words in circles.sentence.split(" circles")[0].split(" of "))
    assert off > 0.9 * count
