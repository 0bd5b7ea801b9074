"""Weights of the lens types of multi-focus arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures, resample
from lfcal import LensTypes
from lfrender.flat.lens_type_weights import WEIGHT_RATIOS, focus_weights

FOCUS = (-0.5, -0.33, -0.17)
CELL = [[(i - j) % 3 for j in range(3)] for i in range(3)]


@pytest.fixture(scope="module")
def three_types():
    camera = Camera.design(size=(420, 340), pitch=23.2, rotation=1.3, focus=FOCUS, fill=0.6)
    return simulate(SCENES["slope"](camera), camera, samples=24, seed=2)


def psnr(shot, calibration, depth):
    picture = lfrender.render(shot.flat, calibration, depth, scale=5.0, detail="off")
    shape = picture.image.shape[:2]
    wanted, inside = resample(
        shot.truth.reference, shot.truth.reference_affine, shape, picture.affine
    )
    inner = np.zeros(shape, bool)
    inner[10:-10, 10:-10] = True
    return compare_pictures(picture.image / 255.0, wanted, inside & inner & picture.valid).psnr


def test_weights_of_lens_types_raise_the_psnr_of_a_slope_by_2_5_db(three_types):
    plain = three_types.truth.calibration
    depth = lfrender.analyze(three_types.flat, plain)
    typed = replace(plain, lens_types=LensTypes(CELL, True, np.array(FOCUS)))
    wrong = replace(plain, lens_types=LensTypes(CELL, True, np.array(FOCUS[::-1])))
    without = psnr(three_types, plain, depth)
    assert psnr(three_types, typed, depth) > without + 2.5
    assert psnr(three_types, wrong, depth) < without


def test_types_of_unknown_focus_have_equal_weights(three_types):
    plain = three_types.truth.calibration
    for types in (LensTypes(CELL, True), LensTypes([[0]])):
        cell, _ = focus_weights(types)
        assert cell.size == 0
        given = lfrender.render(
            three_types.flat, replace(plain, lens_types=types), patch_size=-7, blend=True
        )
        without = lfrender.render(three_types.flat, plain, patch_size=-7, blend=True)
        np.testing.assert_array_equal(given.image, without.image)


def test_a_type_has_weight_1_where_it_is_in_focus():
    _, shares = focus_weights(LensTypes(CELL, True, np.array(FOCUS)))
    at = [round((f + 1) * (len(WEIGHT_RATIOS) - 1) / 2) for f in FOCUS]
    assert np.diag(shares[:, at]) == pytest.approx(1)
    assert (shares[:, at] - np.eye(3) < 0.2).all()
