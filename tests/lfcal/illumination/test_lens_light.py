"""Light of single lenses."""

from __future__ import annotations

import numpy as np

import lfcal


def test_missing_lens_is_a_defect_without_gain(drawn):
    truth = drawn("square", 24.0, 2.0, 30.0, size=(700, 500))
    image = truth.image()
    index = truth.index_of(np.array([[350.0, 250.0]]))
    x, y = np.rint(truth.centres(index)[0]).astype(int)
    image[y - 12 : y + 13, x - 12 : x + 13] = image.min()
    camera = lfcal.calibrate(image, kind="white")
    lenses = camera.defects.lenses
    assert len(lenses) == 1
    np.testing.assert_allclose(camera.lattice.points(lenses)[0], (x, y), atol=1)
    assert np.isnan(camera.gain()[y - 8 : y + 9, x - 8 : x + 9]).all()
    assert (camera.usable_radius() == 0).sum() == 1
