"""Shading that microimages have in common is removed; the scene, which moves from lens to lens,
stays.
"""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.flat.gray_flat import GrayFlat
from lfrender.flat.microimages import allocate_strips
from lfrender.flat.shading import LARGEST_SHADING, remove_shading
from lfrender.flat.texture import measure_statistics

PITCH = 16.0
RADIUS = 7.0
LATTICE = Lattice((8.0, 8.0), ((PITCH, 0.0), (0.0, PITCH)), (208, 176), RADIUS + 1)


def flat_of(shading, scene):
    """A flat of this contrast of shading, a ramp across each lens, and of a scene of noise."""
    width, height = LATTICE.image_size
    x = np.arange(width) * np.ones((height, 1))
    away = (x - 8.0 + PITCH / 2) % PITCH - PITCH / 2
    ramp = away / np.sqrt(np.mean(away**2))
    texture = np.random.default_rng(3).normal(0, 1, (height, width))
    image = 0.5 + shading * ramp + scene * texture
    centres = LATTICE.centres().astype(np.float32)
    return GrayFlat(image.astype(np.float32), centres, RADIUS, PITCH)


def without_shading(gray, wanted=None):
    statistics = measure_statistics(gray)
    strips = allocate_strips(gray, statistics.mean, 1)
    wanted = np.ones(len(gray.centres), bool) if wanted is None else wanted
    return remove_shading(gray, LATTICE, strips, statistics.contrast, wanted)


def middle(gray):
    """Microimages of inner lenses (n, 9, 9)."""
    inner = gray.centres[(gray.centres > 40).all(1) & (gray.centres < 130).all(1)].astype(int)
    return np.array([gray.image[y - 4 : y + 5, x - 4 : x + 5] for x, y in inner])


def test_faint_shading_is_removed_and_the_mean_stays():
    gray = flat_of(0.004, 0.002)
    found = middle(without_shading(gray))
    left = found.mean(0)
    # A mean over the noise of so many lenses has 0.0003.
    assert middle(gray).mean(0).std() > 0.002
    assert left.std() < 0.0007
    assert left.mean() == pytest.approx(0.5, abs=5e-4)


def test_a_pattern_stronger_than_shading_mostly_stays():
    gray = flat_of(4 * LARGEST_SHADING, 0.002)
    kept = middle(without_shading(gray)).mean(0).std() / middle(gray).mean(0).std()
    assert kept > 0.9


def test_a_scene_that_differs_from_lens_to_lens_stays():
    gray = flat_of(0.0, 0.05)
    change = without_shading(gray).image - gray.image
    assert np.abs(change).max() < 0.002


def test_only_wanted_lenses_change():
    gray = flat_of(0.004, 0.002)
    wanted = gray.centres[:, 0] < 100
    changed = without_shading(gray, wanted).image != gray.image
    assert changed[:, :90].any()
    assert not changed[:, 112:].any()


def test_the_shading_of_a_mirrored_flat_is_mirrored():
    gray = flat_of(0.004, 0.02)
    # Lenses lie at 8, 24, ..., mirrored at 7, 23, ...: the lattice moves by a pixel.
    image = np.ascontiguousarray(np.roll(gray.image[:, ::-1], 1, 1))
    moved = GrayFlat(image, gray.centres, RADIUS, PITCH)
    one = without_shading(gray).image[40:-40, 40:-40]
    other = np.roll(without_shading(moved).image, -1, 1)[:, ::-1][40:-40, 40:-40]
    np.testing.assert_allclose(one, other, atol=2e-5)
