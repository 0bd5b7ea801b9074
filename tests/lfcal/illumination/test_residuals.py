"""Residuals of gain maps on microimages whose light is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.gain.gain_map import GainMap
from lfcal.illumination.residuals import collect_residuals, draw_sample
from lfcal.lattice.lattice import Lattice

_STEP = 0.25


@pytest.fixture
def lattice():
    return Lattice(np.array([11.2, 9.7]), np.array([[20.0, 0.0], [0.0, 20.0]]), (400, 300), 8.0)


_FAR = _STEP * np.arange(80)


@pytest.fixture
def gain():
    none = np.zeros(0)
    profile = np.clip(9 - _FAR, 0, 1)
    return GainMap(profile, _STEP, 9.0, np.zeros(1), none, np.zeros((5, 1)), np.zeros((1, 1)), none)


def _draw(lattice, light=lambda index: 1.0, plane=(0.0, 0.0)):
    """Root of the light of discs as in `gain`, of a light by lens, with a slope [1/px] in each."""
    y, x = np.mgrid[: lattice.image_size[1], : lattice.image_size[0]]
    points = np.stack([x, y], -1).astype(float)
    index = np.rint((points - lattice.origin) @ np.linalg.inv(lattice.basis))
    away = points - (lattice.origin + index @ lattice.basis)
    disc = np.clip(9 - np.hypot(*np.moveaxis(away, -1, 0)), 0, 1)
    return np.sqrt(disc * light(index) * (1 + away @ plane)).astype(np.float32)


def _largest(gain, value=np.inf):
    return np.full(len(gain.profile), value)


def test_sample_is_spread_over_the_field(lattice):
    picture = _draw(lattice)
    sample = draw_sample(lattice, picture, 4e4, scene=False)
    assert len(sample.indices) == len(sample.field) >= 200
    assert np.ptp(sample.field, axis=0) == pytest.approx([1.44, 1.04], abs=0.1)
    assert np.bincount(sample.window, minlength=sample.windows).min() > 0
    # Every other row of a scene.
    half = draw_sample(lattice, picture, 4e4, scene=True, step=2)
    assert len(half.pixels.value) == pytest.approx(len(sample.pixels.value) / 2, rel=0.02)
    assert np.isinf(sample.clipping) and half.clipping == pytest.approx(0.995, abs=1e-3)


def test_light_of_each_lens_is_no_residual(lattice, gain):
    picture = _draw(lattice, light=lambda index: 1 + 0.3 * np.sin(index[..., 0] + index[..., 1]))
    sample = draw_sample(lattice, picture, 4e4, scene=False)
    found = collect_residuals(sample, gain, False, _largest(gain))
    # The profile is read between samples of a quarter of a pixel.
    assert np.abs(found.error).max() < 0.02
    # Darker lenses have less weight.
    assert 0.5 < found.weight.min() < 0.6 and found.weight.max() == 1
    assert (found.plane == 1).all()
    # Half of the light in the map is half of the light as residual.
    faint = replace(gain, profile=np.where(_FAR > 6, 0.5, 1) * gain.profile)
    error = collect_residuals(sample, faint, False, _largest(gain)).error
    ring = (sample.pixels.distance() > 6.5) & (sample.pixels.distance() < 7.8)
    assert error[ring] == pytest.approx(0.5, abs=0.02)


def test_slope_of_the_light_in_a_lens_is_a_residual_on_white_images_alone(lattice, gain):
    picture = _draw(lattice, plane=(0.03, -0.01))
    sample = draw_sample(lattice, picture, 4e4, scene=True)
    scene = collect_residuals(sample, gain, True, _largest(gain))
    white = collect_residuals(sample, gain, False, _largest(gain))
    # Level and slope are fitted by turns, so that some of the slope is left.
    assert np.std(scene.error) < 0.5 * np.std(white.error)
    assert np.std(white.error) > 0.08


def test_outliers_of_their_distance_are_left_out(lattice, gain):
    picture = _draw(lattice)
    # Beside the middle of a lens, in which its light is measured.
    picture[109:112, 216:219] = 0
    sample = draw_sample(lattice, picture, 1e6, scene=False)
    kept = collect_residuals(sample, gain, False, _largest(gain, 0.1))
    whole = collect_residuals(sample, gain, False, _largest(gain))
    assert 1 <= len(whole.error) - len(kept.error) <= 9
    assert np.abs(kept.error).max() <= 0.1
    some = kept.select(np.arange(0, len(kept.error), 3))
    assert len(some.error) == len(some.sample.pixels.value) == len(some.places.before)
