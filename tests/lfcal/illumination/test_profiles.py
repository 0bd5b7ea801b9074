"""Profiles of microimages from scene captures, and of types of lenses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lfcal import Lattice, LensTypes
from lfcal.gain.gain_map import GainMap
from lfcal.gain.rows import RegionGain
from lfcal.illumination.profiles import (
    ProfilePixels,
    SceneProfiles,
    average_vignetting,
    fit_scene_profiles,
    fit_type_profiles,
    order_by_rims,
)
from lfcal.illumination.residuals import draw_sample

_TYPES = LensTypes([[0, 1, 2], [2, 0, 1], [1, 2, 0]])
_LATTICE = Lattice([10, 10], [[20, 0], [10, 17.3]], (600, 400), 9)
_STEP = 0.25


def _typed(difference: float) -> GainMap:
    radii = np.arange(60) * _STEP
    ramp = np.clip((radii - 5) / 2, 0, 1)
    gain = GainMap.round(np.ones(60), _STEP, 9)
    light = np.array([1 - difference * ramp, np.ones(60), 1 + difference * ramp])
    return replace(gain, type_light=light, type_cell=_TYPES.cell)


def _flat(gain: GainMap, contrast: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    scene = np.kron(1 + contrast * rng.standard_normal((40, 60)), np.ones((10, 10)))
    return np.sqrt(
        np.maximum(0.5 * scene * RegionGain(gain, _LATTICE).at(0, 0, *_LATTICE.image_size), 0)
    ).astype(np.float32)


def _fit_types(picture: np.ndarray) -> GainMap:
    gain = GainMap.round(np.ones(60), _STEP, 9)
    pixels = ProfilePixels.of(draw_sample(_LATTICE, picture, 1e6, True, 2), gain)
    return fit_type_profiles(pixels, _LATTICE.radius, gain, _TYPES)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_profile_from_a_scene_is_even_in_the_middle(seed):
    lattice = Lattice((201.3, 160.2), ((46.0, 0.8), (22.2, 39.9)), (420, 340), 20.0)
    scene = gaussian_filter(np.random.default_rng(seed).normal(0, 1, (340, 420)), 3.0)
    picture = (0.5 + 0.12 * scene / scene.std()).clip(0.05, 1).astype(np.float32)
    gain = GainMap.round(np.ones(100), 0.25, 20.0)
    pixels = ProfilePixels.of(draw_sample(lattice, picture, 1e6, True, 2), gain)
    profile, light, shown = fit_scene_profiles(pixels, gain)
    assert shown and np.diff(light).max() < 1e-12
    # Pixel by pixel, the few in the middle of these 80 lenses are up to 40 % off.
    np.testing.assert_allclose(profile[:6] / np.median(profile[:60]), 1, atol=0.06)


def _fit_profiles(rise: float, fill: float, begin: float = 0.0) -> SceneProfiles:
    """Of a scene whose light rises towards the rims, which are at a share of the radius.

    It begins to rise at another share of it.
    """
    y, x = np.mgrid[:400, :600]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    nearest = np.rint(_LATTICE.to_index(points)).astype(int)
    distance = np.hypot(*(points - _LATTICE.points(nearest)).T).reshape(x.shape) / _LATTICE.radius
    light = (1 + rise * np.maximum(distance - begin, 0) ** 2) * np.clip(
        (fill - distance) * 5, 0.02, 1
    )
    noise = np.random.default_rng(0).normal(1, 0.05, light.shape)
    picture = np.sqrt(0.3 * light * noise).astype(np.float32)
    gain = GainMap.round(np.ones(60), _STEP, 9)
    pixels = ProfilePixels.of(draw_sample(_LATTICE, picture, 1e6, True, 2), gain)
    return fit_scene_profiles(pixels, gain)


@pytest.mark.parametrize("fill", [0.9, 2.0])
def test_scene_that_is_brighter_at_the_rims_shows_no_light_before_them(fill):
    profile = _fit_profiles(2.0, fill).light
    before_rim = np.arange(60) * _STEP < (fill - 0.25) * 9
    np.testing.assert_array_equal(profile[before_rim], 1)
    # Objects in the middles are nothing that lenses have in common.
    np.testing.assert_array_equal(_fit_profiles(2.0, fill).mean, profile)
    assert not _fit_profiles(2.0, fill).shown
    # The rim itself is seen.
    assert (profile[40] < 0.1) == (fill < 1)


@pytest.mark.parametrize("rise", [-0.2, 0.0, 0.05])
def test_profile_of_a_scene_never_rises_towards_the_rim(rise):
    _, profile, shown = _fit_profiles(rise, 1.0)
    assert shown
    assert profile[0] == 1 and np.diff(profile).max() < 1e-12
    expected = 1 + min(rise, 0) * (np.arange(60) * _STEP / 9) ** 2
    np.testing.assert_allclose(profile[:24], expected[:24], atol=0.02)


def test_light_of_neighbours_at_the_rims_is_in_the_mean_but_not_in_the_light_of_lenses():
    found = _fit_profiles(2.0, 2.0, begin=0.6)
    inside = np.arange(60) * _STEP < 8
    expected = 1 + 2 * np.maximum(np.arange(60) * _STEP / 9 - 0.6, 0) ** 2
    assert not found.shown
    np.testing.assert_array_equal(found.light[inside], 1)
    np.testing.assert_allclose(found.mean[inside], expected[inside], atol=0.02)


@pytest.mark.parametrize(("contrast", "error"), [(0.02, 0.005), (0.1, 0.015)])
def test_light_of_three_types_is_told_apart_to_one_and_a_half_per_cent_on_scenes(contrast, error):
    typed = _typed(0.1)
    found = _fit_types(_flat(typed, contrast))
    inside = (np.arange(60) * _STEP < 9) & (np.abs(np.arange(60) * _STEP - 6) > 1.5)
    assert np.abs(found.type_light - typed.type_light)[:, inside].max() < error


def test_types_that_are_lit_alike_have_one_profile():
    found = _fit_types(_flat(_typed(0), 0.1))
    assert found.type_light.size == 0


def test_types_of_white_images_are_numbered_from_soft_rims_to_hard_ones():
    gain = _typed(0.1)
    shuffled = np.array([2, 0, 1], np.int8)[_TYPES.cell]
    types, found = order_by_rims(
        LensTypes(shuffled, True),
        replace(gain, type_cell=shuffled, type_light=gain.type_light[[1, 2, 0]]),
        9,
    )
    assert (
        types.ordered
        and np.array_equal(types.cell, _TYPES.cell)
        and np.array_equal(found.type_light, gain.type_light)
    )


def test_vignetting_of_lenses_that_are_only_seen_at_their_rims_is_finite():
    radii = np.arange(60) * _STEP
    gain = GainMap.round(np.where(radii < 6, 0.0, np.clip(9 - radii, 0, 1)), _STEP, 9)
    vignetting, radius = average_vignetting(gain, _LATTICE)
    assert np.isfinite(vignetting.profile).all() and vignetting.profile.max() == 2
    assert abs(radius - 8.5) < 0.1
