"""Lattices of unusual arrays are found; checkerboards and too short pitches are refused."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from benchmarks.calibration_speed import drawn
from benchmarks.white_images import WhiteImage
from lfcal.detection.first_lattice import find_first_lattices
from lfcal.images.preprocessing import sqrt_luminance


@pytest.mark.parametrize(("side", "degrees", "blur"), [(15, 4, 0.5), (20, 0, 0.8)])
def test_photograph_of_a_checkerboard_is_refused(patterns, side, degrees, blur):
    board = 40 + 160 * patterns.board(degrees, side, (340, 280))
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(patterns.photograph(board, blur))


def test_small_noisy_picture_of_a_checkerboard_is_refused(patterns):
    board = 127.5 + 115 * (2 * patterns.board(33, 7.1, (250, 160)) - 1)
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(patterns.photograph(board, 1.0, 4, seed=3))


def test_pitch_below_six_pixels_is_refused_with_its_value(whites):
    image, _ = whites.white_image(whites.turned(whites.SQUARE, 5.0, 0), (240, 200))
    with pytest.raises(lfcal.CalibrationError, match=r"5\.0 px"):
        lfcal.calibrate(image)


@pytest.mark.parametrize(("shape", "pitch", "fill", "soft", "gap"), [
    ("SQUARE", 6.0, 0.92, 1, 0.03), ("HEXAGON", 20.3, 0.75, 1, 0.0), ("SQUARE", 20.3, 1, 3, 0.3),
])  # fmt: skip
def test_whole_pitches_wide_gaps_and_soft_discs_are_found(whites, shape, pitch, fill, soft, gap):
    basis = whites.turned(getattr(whites, shape), pitch, 0)
    image, origin = whites.white_image(basis, (500, 400), fill=fill, soft=soft, gap=gap)
    found = lfcal.calibrate(image)
    assert whites.rms(whites.centre_errors(found.lattice, origin, basis)) < 0.05


@pytest.mark.parametrize(("pitch", "half"), [(44.2, 2), (14.1, 1)])
def test_first_lattice_of_large_microimages_is_found_at_half_size(pitch, half):
    truth = WhiteImage("hexagonal", pitch, 7.0, 26.0, size=(2201, 1400))
    start = next(find_first_lattices(sqrt_luminance(drawn(truth, 1))))
    assert start.brightness.shape == (1400 // half, 2201 // half)
    found = start.lattice.centres()
    assert start.lattice.image_size == truth.size
    assert np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()) < 0.02 * pitch
