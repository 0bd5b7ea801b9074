"""What repeats in two directions and yet is no array of microimages."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import lfcal


def _turned(degrees, size=(900, 700)):
    y, x = np.mgrid[0 : size[1], 0 : size[0]].astype(float)
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return cos * x + sin * y, cos * y - sin * x


def _photographed(picture, blur):
    picture = cv2.GaussianBlur(picture, (0, 0), blur)
    return np.clip(picture + np.random.default_rng(0).normal(0, 3, picture.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("side", "degrees", "blur"), [(15, 4, 0.5), (20, 0, 0.8), (33.3, 7, 1.2), (50, 30, 2.0)])
def test_photograph_of_a_checkerboard_is_refused(side, degrees, blur):
    u, v = _turned(degrees)
    board = 40 + 160 * ((np.floor(u / side) + np.floor(v / side)) % 2)
    with pytest.raises(lfcal.CalibrationError, match="checkerboard"):
        lfcal.calibrate(_photographed(board, blur))


@pytest.mark.parametrize(("side", "degrees", "noise"), [(24.4, 0, 8), (7.1, 33, 4), (8.4, 45, 5)])
def test_a_small_noisy_picture_of_a_checkerboard_is_refused(side, degrees, noise):
    u, v = _turned(degrees)
    board = cv2.GaussianBlur(127.5 + 115 * (2 * ((np.floor(u / side) + np.floor(v / side)) % 2) - 1), (0, 0), 1.0)
    board += np.random.default_rng(3).normal(0, noise, board.shape)
    with pytest.raises(lfcal.CalibrationError, match="checkerboard"):
        lfcal.calibrate(np.clip(board, 0, 255).astype(np.uint8)[:160, :250])


@pytest.mark.parametrize("shape", ["SQUARE", "HEXAGON"])
@pytest.mark.parametrize("pitch", [5.0, 5.4])
def test_pitch_below_six_pixels_is_named(whites, shape, pitch):
    image, _ = whites.white_image(whites.turned(getattr(whites, shape), pitch, 0), (700, 500))
    with pytest.raises(lfcal.CalibrationError, match=f"{pitch:.1f} px"):
        lfcal.calibrate(image)


@pytest.mark.parametrize("shape", ["SQUARE", "HEXAGON"])
@pytest.mark.parametrize(
    ("pitch", "fill", "soft", "gap"), [(6.0, 0.92, 1, 0.03), (20.3, 0.75, 1, 0.0), (20.3, 1, 3, 0.3)]
)
def test_whole_pitches_wide_gaps_and_soft_discs_are_found(whites, shape, pitch, fill, soft, gap):
    basis = whites.turned(getattr(whites, shape), pitch, 0)
    image, origin = whites.white_image(basis, (700, 500), fill=fill, soft=soft, gap=gap)
    found = lfcal.calibrate(image)
    assert whites.rms(whites.centre_errors(found.lattice, origin, basis)) < 0.05
