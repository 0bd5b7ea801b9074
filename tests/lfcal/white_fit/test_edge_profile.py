"""Edge of a microimage in its radial profile: blur, and shape of the blur."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from benchmarks.calibration_bound import centre_error
from benchmarks.white_images import WhiteImage
from lfcal.white_fit.edge_profile import edge_depths, estimate_edge_blur, find_edge

STEP, RADIUS, GAP = 0.125, 6.0, 0.05


def profile(kernel, shading=0.2):
    """Profile of a disc that is darker outwards, its edge blurred with weights at -3 to 3 px."""
    radii, offsets = np.arange(80) * STEP, np.linspace(-3, 3, 6001)
    through = np.interp(RADIUS - radii, offsets, np.cumsum(kernel(offsets)) / kernel(offsets).sum(), left=0, right=1)
    return GAP + (1 - GAP) * through * (1 - shading * radii**2 / RADIUS**2)


def normal(offsets):
    return np.exp(-0.5 * (offsets / 0.45) ** 2)


def uniform(offsets):
    return (np.abs(offsets) < 0.45 * np.sqrt(3)).astype(float)


def two_sided(offsets):
    return np.exp(-np.sqrt(2) * np.abs(offsets) / 0.45)


@pytest.mark.parametrize(
    ("kernel", "least", "most"), [(normal, -0.002, 0.002), (uniform, 0.03, 0.06), (two_sided, -0.03, -0.01)]
)
def test_blur_and_its_tails_are_measured(kernel, least, most):
    level = profile(kernel)
    edge = find_edge(level)
    soft, steep = estimate_edge_blur(edge_depths(level, edge, GAP, STEP), edge, STEP)
    assert least <= steep <= most
    assert soft == pytest.approx(0.45, rel=0.02 if kernel is normal else 0.2)


def test_depths_are_independent_of_shading():
    depths = [edge_depths(level, find_edge(level), GAP, STEP) for level in (profile(normal, 0.0), profile(normal, 0.3))]
    near = np.abs(depths[0]) < 2
    np.testing.assert_allclose(depths[0][near], depths[1][near], atol=0.04)
    # Normal scores are the distances themselves.
    np.testing.assert_allclose(depths[0][near], (RADIUS - np.arange(80)[near] * STEP) / 0.45, atol=0.04)


def test_profiles_without_an_edge_have_no_blur():
    level = np.full(80, 0.7)
    edge = np.zeros(80, dtype=bool)
    assert estimate_edge_blur(edge_depths(level, edge, 0.7, STEP), edge, STEP) is None


@pytest.mark.parametrize(
    ("shape", "pitch", "strength", "soft", "most"),
    [
        ("hexagonal", 22.4, -0.25, 0.97, 0.0025),
        ("hexagonal", 18.9, 0.3, 1.1, 0.004),
        ("square", 14.9, 0.26, 0.88, 0.006),
    ],
)
def test_centres_of_blurred_cut_microimages_are_within_a_few_thousandths_of_a_pixel(shape, pitch, strength, soft, most):
    truth = WhiteImage(shape, pitch, 5.0, strength=strength, ratio=1.04, soft=soft, gap=0.03, size=(1200, 900))
    camera = lfcal.calibrate(truth.image())
    assert centre_error(camera, truth) < most
    assert centre_error(camera, truth) < 5 * np.sqrt((camera.errors.of_centres(camera.lattice) ** 2).mean())
