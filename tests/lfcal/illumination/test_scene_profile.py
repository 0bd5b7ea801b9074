"""Profile of microimages from scene captures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lfcal.gain.gain_map import GainMap
from lfcal.illumination.profiles import fit_scene_profile
from lfcal.lattice.lattice import Lattice


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_profile_from_a_scene_is_even_in_the_middle(seed):
    lattice = Lattice((201.3, 160.2), ((46.0, 0.8), (22.2, 39.9)), (420, 340), 20.0)
    scene = gaussian_filter(np.random.default_rng(seed).normal(0, 1, (340, 420)), 3.0)
    picture = (0.5 + 0.12 * scene / scene.std()).clip(0.05, 1).astype(np.float32)
    profile = fit_scene_profile(picture, lattice, GainMap.round(np.ones(100), 0.25, 20.0))
    # Pixel by pixel, the few in the middle of these 80 lenses are up to 40 % off.
    np.testing.assert_allclose(profile[:6] / np.median(profile[:60]), 1, atol=0.06)
