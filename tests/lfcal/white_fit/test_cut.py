"""Cutting discs that are faint, large, or like the microimages."""

from __future__ import annotations

import cv2
import numpy as np

import lfcal


def _error(camera, truth):
    found = camera.lattice.centres()
    return float(np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()))


def test_faint_cut_is_found_in_strong_noise(drawn):
    truth = drawn("hexagonal", 13.8, 10.7, 18.0, 8, 0.14, fill=0.85, soft=1.0, size=(640, 480))
    assert _error(lfcal.calibrate(truth.image()), truth) < 0.05


def test_faint_shading_decides_which_of_two_equal_discs_is_the_microimage(drawn):
    truth = drawn(
        "square",
        40.0,
        3.0,
        26.0,
        strength=0.18,
        inner=0.06,
        outer=0.4,
        fill=0.975,
        soft=0.3,
        size=(520, 400),
    )
    # Light of neighbours spills over narrow gaps.
    light = cv2.GaussianBlur(truth.light(), (0, 0), 0.8)
    light += truth.noise * np.random.default_rng(1).standard_normal(light.shape)
    image = np.rint(np.clip(0.8 * light, 0, 1) * 65535).astype(np.uint16)
    assert _error(lfcal.calibrate(image), truth) < 0.02


def test_no_cut_is_searched_for_in_overexposed_microimages(drawn):
    truth = drawn(
        "hexagonal",
        19.493036445416724,
        281.5759199195825,
        11.996434898142741,
        8,
        0.2693987855563333,
        ratio=1.0,
        hot=26,
        dust=5,
        fill=0.7745966692414834,
        soft=1.2,
        gap=0.1369774370440833,
        inner=0.21510253900454906,
        outer=0.5232897673027422,
        size=(367, 188),
        seed=158278415,
    )
    # Most of the light is clipped: the profile does not fall from the middle to the rim.
    assert _error(lfcal.calibrate(truth.image(2.0)), truth) < 0.1 * truth.pitch


def test_cut_of_one_pixel_in_the_corners_is_in_the_gain_map(drawn):
    truth = drawn(
        "hexagonal",
        37.8,
        8.5,
        40.0,
        8,
        0.164,
        ratio=1.104,
        fill=0.886,
        soft=0.36,
        edges="ramp",
        size=(1200, 900),
    )
    camera = lfcal.calibrate(truth.image(), kind="white")
    light = truth.light()
    lit = light > 0.05 * light.max()
    ratio = (camera.gain() / light)[lit]
    assert np.nanmax(ratio) < 2 * np.nanmedian(ratio)
