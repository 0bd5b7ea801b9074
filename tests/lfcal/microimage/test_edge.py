"""Light of blurred edges in closed form, beside numerical integrals and differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from lfcal.microimage.edge import blurred_edge, gaussian_edge

_WIDTH = 1.1


def _integrate(depth, blur, curvature):
    """Mean light [1] over even places in the blurring disc and across the pixel."""
    number = np.arange(20000) + 0.5
    place = blur * np.sqrt(number / len(number)) * np.exp(1j * np.pi * (1 + 5**0.5) * number)
    across = _WIDTH * (np.arange(50) + 0.5) / 50 - 0.5 * _WIDTH
    radius = 1 / curvature
    out = []
    for one in depth:
        far = np.hypot(radius - one - across[:, None] - place.real, place.imag)
        out.append((far < radius).mean())
    return np.array(out)


@pytest.mark.parametrize(("blur", "curvature", "most"), [(1.1, 1e-3, 0.001), (2.0, 0.1, 0.0015)])
def test_light_is_that_of_overlapping_circles(blur, curvature, most):
    depth = np.linspace(-3, 3, 25)
    light = blurred_edge(depth, blur, _WIDTH, curvature).light
    assert np.abs(light - _integrate(depth, blur, curvature)).max() < most
    # Without the curvature it is off by more.
    straight = blurred_edge(depth, blur, _WIDTH).light
    assert np.abs(straight - light).max() == pytest.approx(blur * curvature / (3 * np.pi), rel=0.25)


def test_edge_of_a_small_blur_is_the_ramp_of_the_pixel():
    depth = np.array([-2, -0.55, -0.275, 0, 0.275, 0.55, 2])
    light = blurred_edge(depth, 1e-6, _WIDTH).light
    np.testing.assert_allclose(light, [0, 0, 0.25, 0.5, 0.75, 1, 1], atol=1e-6)


@pytest.mark.parametrize("blur", [0.2, 1.1, 4.0])
def test_slopes_are_those_of_differences(blur):
    rng = np.random.default_rng(0)
    given = np.array([rng.uniform(-3, 3, 300), np.full(300, blur), np.full(300, 0.08)])
    seen = blurred_edge(given[0], given[1], _WIDTH, given[2])
    for number, slope in enumerate(seen[1:]):
        step = 1e-6 * (np.arange(3) == number)[:, None]
        (d1, b1, c1), (d2, b2, c2) = given - step, given + step
        high = blurred_edge(d2, b2, _WIDTH, c2).light
        low = blurred_edge(d1, b1, _WIDTH, c1).light
        np.testing.assert_allclose(slope, (high - low) / 2e-6, atol=1e-6)


def test_gaussian_edge_is_the_mean_of_a_normal_distribution_over_a_pixel():
    depth = np.linspace(-3, 3, 25)
    across = _WIDTH * ((np.arange(400) + 0.5) / 400 - 0.5)
    light = norm.cdf((depth[:, None] + across) / 0.6).mean(1)
    np.testing.assert_allclose(gaussian_edge(depth, 1.2, _WIDTH).light, light, atol=1e-6)


@pytest.mark.parametrize("blur", [0.2, 1.1, 4.0])
def test_slopes_of_a_gaussian_edge_are_those_of_differences(blur):
    depth = np.linspace(-3, 3, 100)
    seen = gaussian_edge(depth, blur, _WIDTH)
    by_depth = gaussian_edge(depth + 1e-6, blur, _WIDTH).light
    by_depth = (by_depth - gaussian_edge(depth - 1e-6, blur, _WIDTH).light) / 2e-6
    np.testing.assert_allclose(seen.by_depth, by_depth, atol=1e-6)
    by_blur = gaussian_edge(depth, blur + 1e-6, _WIDTH).light
    by_blur = (by_blur - gaussian_edge(depth, blur - 1e-6, _WIDTH).light) / 2e-6
    np.testing.assert_allclose(seen.by_blur, by_blur, atol=1e-6)
