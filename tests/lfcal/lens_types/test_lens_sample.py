"""Features of single lenses."""

from __future__ import annotations

import numba
import numpy as np

from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lens_types.lens_sample import measure_lens_features, sample_lenses


def test_lens_features_do_not_depend_on_the_number_of_threads(house):
    picture = sqrt_luminance(house.flat)
    sample = sample_lenses(house.truth.calibration.lattice)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = measure_lens_features(picture, sample)
    finally:
        numba.set_num_threads(threads)
    for name in ("sharpness", "outer_light", "inner_loss", "level", "gradient"):
        np.testing.assert_array_equal(
            getattr(measure_lens_features(picture, sample), name), getattr(one, name)
        )
