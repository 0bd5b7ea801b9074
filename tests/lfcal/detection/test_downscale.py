"""Large flats are calibrated on averages of blocks; the calibration is that of the flat."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.detection import downscale


def test_large_white_image_is_placed_within_a_hundredth_pixel(whites, set_downscale):
    set_downscale(large=3e5)
    basis = whites.turned(whites.HEXAGON, 45.3, 17)
    image, origin = whites.white_image(basis, (1103, 905))
    assert downscale.choose_block_size(image, False) == 3
    camera = lfcal.calibrate(image)
    assert camera.image_size == (1103, 905)
    assert whites.rms(whites.centre_errors(camera.lattice, origin, basis)) < 0.01
    assert camera.lattice.radius == pytest.approx(0.92 * 45.3 / 2, abs=1)


def test_distorted_lattice_is_scaled_from_averages_to_the_flat():
    from lfcal.lattice.distortion import Distortion

    bend = Distortion([150.0, 120.0], 0.01, 0.0, 200.0)
    small = lfcal.Calibration(
        lfcal.Lattice([100.0, 90.0], [[20.0, 0.3], [10.0, 17.0]], (320, 240), 9.0, bend)
    )
    large = downscale.upscale_calibration(small, 4, (1283, 961))
    index = small.lattice.indices()
    np.testing.assert_allclose(
        large.lattice.points(index), 4 * small.lattice.points(index) + 1.5, atol=1e-9
    )


def test_small_flat_is_not_averaged():
    assert downscale.choose_block_size(np.zeros((1000, 1000), np.uint8), False) == 1
