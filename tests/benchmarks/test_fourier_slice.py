"""Refocusing by a slice of the spectrum gives the picture that the mean over lenses gives."""

from __future__ import annotations

import numpy as np
import pytest

import lfrender
from benchmarks.fourier_slice import refocus_fourier
from data_synth import SCENES, Camera, simulate


@pytest.mark.parametrize(("lattice", "ratio"), [("hex", -0.3), ("square", 0.3)])
def test_a_slice_of_the_spectrum_is_the_mean_over_lenses(lattice, ratio):
    camera = Camera.design(size=(420, 320), pitch=20.3, lattice=lattice, rotation=2.0)
    shot = simulate(SCENES["plane"](camera, ratio=ratio), camera, samples=8)
    calibration = shot.truth.calibration
    s = ratio * calibration.lattice.pitch
    mean = lfrender.refocus(shot.flat, calibration, s)

    def off(picture):
        assert picture.image.shape == mean.image.shape
        np.testing.assert_allclose(picture.affine, mean.affine)
        difference = (picture.image.astype(float) - mean.image)[12:-12, 12:-12]
        return 10 * np.log10(255**2 / np.mean(difference**2))

    assert off(refocus_fourier(shot.flat, calibration, s)) > 30
    assert off(refocus_fourier(shot.flat, calibration, -s, scale=abs(s))) < 16
    with pytest.raises(ValueError, match="patch_size"):
        refocus_fourier(shot.flat, calibration, 0.0)
