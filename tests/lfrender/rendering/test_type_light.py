"""Types of lenses that are lit unlike leave no dots on a blank wall."""

from dataclasses import replace

import numpy as np
import pytest

import lfrender
from lfcal import Calibration, Lattice, LensTypes
from lfcal.gain.gain_map import GainMap, Vignetting
from lfcal.gain.rows import RegionGain
from lfrender.flat.gray_flat import make_gray_flat
from lfrender.rendering.traditional import traditional


@pytest.fixture(scope="module")
def wall():
    """Camera and flat of a wall of value 150; its types differ by a tenth of light at the rim."""
    types = LensTypes([[0, 1, 2], [2, 0, 1], [1, 2, 0]])
    lattice = Lattice([10, 10], [[20, 0], [10, 17.3]], (400, 300), 9)
    ramp = np.clip((np.arange(60) * 0.25 - 5) / 4, 0, 1)
    gain = replace(
        GainMap.round(np.ones(60), 0.25, 9),
        type_light=1 + 0.1 * np.array([[-1], [0], [1]]) * ramp,
        type_cell=types.cell,
    )
    camera = Calibration(lattice, Vignetting(np.ones(60), 0.25), lens_types=types, gain_map=gain)
    return camera, np.rint(150 * RegionGain(gain, lattice).at(0, 0, *lattice.image_size)).astype(
        np.uint8
    )


@pytest.mark.parametrize("kind", [np.uint8, np.float32])
@pytest.mark.parametrize("blend", [True, False])
def test_wall_is_even_to_two_levels_where_patches_reach_the_rims(wall, kind, blend):
    camera, flat = wall
    if kind == np.float32:
        flat = (flat / 255).astype(kind)
    picture = lfrender.render(flat, camera, patch_size=14.0, scale=10, blend=blend)
    image = picture.image.astype(float) * (255 if kind == np.float32 else 1)
    inside = np.zeros(picture.valid.shape, bool)
    inside[20:-20, 20:-20] = True
    assert np.ptp(image[inside]) <= 2.5
    assert np.abs(image[inside] - 150).max() <= 1.5


def test_gray_flat_and_traditional_picture_are_even_to_one_level(wall):
    camera, flat = wall
    gray = make_gray_flat(flat[:, :, None], camera)
    pixels = gray.image[30:-30, 30:-30]
    assert np.ptp(traditional(flat, camera).image[2:-2, 2:-2].astype(float)) <= 1
    assert np.mean(np.abs(pixels * 255 - 150) < 1.5) > 0.7
