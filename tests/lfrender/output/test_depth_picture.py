"""Maps of depth maps: the right colour at the right lens."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import lfrender
from lfcal import Lattice
from lfcal.runtime.light.tone import decode_srgb
from lfrender.data.depth_map import MODE_COLOURS
from lfrender.data.depth_order import depth_limits, depth_order, name_depth, name_ends
from lfrender.output.depth_picture import (
    add_legend,
    colour_scale,
    depth_picture,
    lens_maps,
    uncertainty_picture,
)


def test_each_pixel_shows_the_mode_and_depth_of_its_nearest_lens():
    lattice = Lattice((20.0, 20.0), [[40.0, 0.0], [0.0, 40.0]], (320, 240), 18.0)
    mode = np.array([1, -1, 0])[lattice.indices().sum(1) % 3]
    x, y = lattice.centres().T
    mode[y < 40] = 0
    patch_size = np.where(x < 160, 4.0, -10.0)
    depth = SimpleNamespace(
        mode=mode, patch_size=patch_size, pitch=40.0, confidence=np.where(x < 160, 0.1, 0.9)
    )
    maps = lens_maps(depth, lattice, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], (240, 320))
    for (x, y), code in zip(lattice.centres().astype(int), mode, strict=True):
        assert tuple(maps["modes"][y + 15, x - 15]) == MODE_COLOURS[code]
    resolved = mode[mode != 0], lattice.centres()[mode != 0].astype(int)
    shown = {}
    for code, (x, y) in zip(*resolved, strict=True):
        shown[x < 160] = maps["depth"][y, x].astype(int).sum()
        assert code in (1, -1)
    assert shown[True] < shown[False], "far is dark, near is light"
    assert tuple(maps["depth"][10, 100]) == MODE_COLOURS[0]
    assert maps["confidence"][200, 100].sum() < maps["confidence"][200, 250].sum(), (
        "from dark to light"
    )


def test_colours_of_depth_and_errors_are_perceptually_even():
    """Equal steps on the scale are equal steps of lightness (CIE L*), for eyes of all kinds."""
    for name, most in (("viridis", 0.25), ("cividis", 0.25)):
        light = decode_srgb(colour_scale(name) / 255) @ [0.2126, 0.7152, 0.0722]
        steps = np.diff(116 * np.cbrt(light[::16]))
        assert steps.min() > 0
        assert np.std(steps) < most * np.mean(steps)


def test_depth_is_ordered_from_far_to_near_over_both_modes():
    sizes = np.array([2.0, 8.0, -15.0, -3.0, np.nan])
    order = depth_order(sizes, 20.0)
    assert np.all(np.diff(order[:4]) > 0) and np.isnan(order[4])
    assert name_depth(0.2) == "M 5.0, telescopic" and name_depth(1.9) == "M 10.0, binocular"


@pytest.mark.parametrize("scale", [16.0, 60.0])
def test_a_legend_is_below_the_picture_and_changes_nothing_in_it(scale):
    depth = lfrender.data.example()[2]
    picture = depth_picture(depth, scale)
    shown = add_legend(picture, name_ends(depth_limits(depth)))
    height = len(picture.image)
    np.testing.assert_array_equal(shown.image[:height], picture.image)
    np.testing.assert_array_equal(shown.affine, picture.affine)
    below = shown.image[height:].astype(int)
    far, near = below[0, 0].sum(), below[0, -1].sum()
    assert far < near
    # Black letters at both ends, which do not meet in the middle of a narrow picture.
    ink = (below.sum(2) < 200)[below.shape[0] // 2 :]
    half = ink.shape[1] // 2
    assert ink[:, :half].any() and ink[:, half:].any()
    assert not ink[:, half - 2 : half + 2].any()


def test_the_picture_of_uncertainty_is_light_where_errors_are_large():
    depth = lfrender.data.example()[2]
    picture, (low, high) = uncertainty_picture(depth, 6.0)
    error = depth.dense(6.0, fill=False).standard_error
    known = picture.valid & (error > low) & (error < high)
    light = picture.image[known].astype(float).sum(1)
    assert np.corrcoef(np.log(error[known]), light)[0, 1] > 0.9
    assert np.all(picture.image[~picture.valid] == MODE_COLOURS[0])
