"""Borders of microimages without gaps, on flats whose cells hold noise of their own."""

import cv2
import numpy as np
import pytest

import lfcal
from lfcal.detection.borders import (
    LineProfile,
    find_line_periods,
    fit_touching_cells,
)
from lfcal.detection.features import FlatFeatures
from lfcal.detection.spectrum import is_same_lattice
from lfcal.images.preprocessing import sqrt_luminance


def elemental_images(basis, origin, size=(420, 360), seed=0):
    """Steps of a flat whose cells about origin + whole numbers @ basis have tones, and noise."""
    width, height = size
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    index = np.rint((np.stack([x, y], -1) - origin) @ np.linalg.inv(basis)).astype(int)
    tones = rng.uniform(0.3, 0.7, (200, 200))[index[..., 1] % 200, index[..., 0] % 200]
    flat = tones + rng.normal(0, 0.03, (height, width))
    return FlatFeatures(flat.astype(np.float32)).steps


@pytest.mark.parametrize("degrees", [0.0, 0.4, 11.0, -28.0])
@pytest.mark.parametrize("sides", [(16.0, 16.0), (23.7, 27.2)])
def test_touching_cells_are_found_at_any_angle_to_a_third_of_a_pixel(degrees, sides):
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    basis = np.diag(sides) @ turn
    origin = np.array([211.3, 178.6])
    steps = elemental_images(basis, origin)
    (found,) = find_line_periods(steps)
    assert is_same_lattice(found, basis, 0.01)
    fit = fit_touching_cells(steps, found)
    index = (np.array([[40, 40], [380, 50], [200, 310]]) - origin) @ np.linalg.inv(basis)
    centres = origin + np.rint(index) @ basis
    beside = (centres - fit.origin) @ np.linalg.inv(fit.basis)
    assert np.abs((beside - np.rint(beside)) @ fit.basis).max() < 0.3
    assert fit.half_difference < 0.5


def test_lines_of_two_periods_at_once_are_less_clear_than_those_of_one(shared):
    """Thin lines lie 63.80 px apart; steps at multiples of 8 px are blocks of JPEG."""
    flat = lfcal.read_flat(shared("captures", "hard", "touching_cells.jpg"))
    height, width = (length // 2 for length in flat.shape[:2])
    half = cv2.resize(sqrt_luminance(flat), (width, height), interpolation=cv2.INTER_AREA)
    (found,) = find_line_periods(FlatFeatures(half).steps)
    assert np.abs(np.hypot(*found.T) - 31.90).max() < 0.01


def test_contrast_tells_borders_from_multiples_fractions_and_shifts_of_their_period():
    steps = elemental_images(np.diag([18.0, 18.0]), np.array([200.0, 150.0]))
    right = LineProfile.measure(steps, np.array([1 / 18, 0]))
    border = right.strongest
    assert right.contrast(border) > 0.7
    assert right.contrast(border + 0.5) <= 0
    for wrong in (1 / 9, 1 / 36, 1 / 17.3):
        profile = LineProfile.measure(steps, np.array([wrong, 0]))
        assert profile.contrast(profile.strongest) < 0.3


def test_noise_has_no_lines():
    noise = np.random.default_rng(3).normal(0.5, 0.1, (300, 400)).astype(np.float32)
    assert list(find_line_periods(FlatFeatures(noise).steps)) == []


def test_lines_farther_apart_than_asked_for_are_left_out():
    steps = elemental_images(np.diag([30.0, 30.0]), np.array([200.0, 150.0]))
    assert len(list(find_line_periods(steps, 32.0))) == 1
    assert list(find_line_periods(steps, 20.0)) == []
