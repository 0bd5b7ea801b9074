"""The solution is sharper than the linear filter, and leaves what is not to be trusted."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures, resample
from lfrender.detail.predict import point_spread
from lfrender.rendering.render import make_plan


@functools.cache
def captured(scene):
    camera = Camera.design(size=(380, 320), pitch=27.0, rotation=1.3)
    shot = simulate(SCENES[scene](camera, seed=3), camera, samples=32, seed=5, noise=(8000, 5))
    return shot, lfrender.analyze(shot.flat, shot.truth.calibration)


def picture(scene, detail, **options):
    shot, depth = captured(scene)
    return lfrender.render(shot.flat, shot.truth.calibration, depth, detail=detail, **options)


def psnr(scene, detail):
    truth, made = captured(scene)[0].truth, picture(scene, detail)
    wanted, inside = resample(truth.reference, truth.reference_affine, made.image.shape[:2], made.affine)
    return compare_pictures(made.image / 255.0, wanted, inside & made.valid).psnr


@pytest.mark.parametrize(("scene", "beyond", "gain"), [("slope", 0.1, 3.0), ("clutter", -0.05, 0.2)])
def test_it_gains_over_the_linear_filter(scene, beyond, gain):
    assert psnr(scene, "restored") > psnr(scene, "natural") + beyond
    assert psnr(scene, "restored") > psnr(scene, "off") + gain


def test_coarse_pictures_are_those_of_the_linear_filter():
    coarse = [picture("slope", detail, scale=2.0).image for detail in ("restored", "natural")]
    np.testing.assert_array_equal(*coarse)


def test_a_smooth_ramp_is_that_of_the_linear_filter():
    natural, restored = (picture("ramp", detail).image.astype(int) for detail in ("natural", "restored"))
    assert np.abs(natural - restored).max() <= 1


def test_a_soft_noisy_plane_loses_nothing():
    assert psnr("plane", "restored") > psnr("plane", "off") + 1


def test_a_part_of_the_flat_gives_the_bits_of_the_whole():
    camera = Camera.design(size=(760, 130), pitch=19.0, rotation=0.7)
    shot = simulate(SCENES["slope"](camera, left=-0.35, right=-0.22), camera, samples=16, seed=2, noise=(8000, 5))
    flat, known = shot.flat, shot.truth.calibration
    depth = lfrender.analyze(flat, known)
    plan = make_plan(lambda p: flat[p[1] : p[3], p[0] : p[2]], known, depth, None, 5.0, None, "restored")
    whole, _ = plan.draw(flat, stored=True)
    tile = 0, 0, 30, plan.size[1]
    left, top, right, bottom = plan.required_part(tile)
    assert right < 600
    part, _ = plan.draw(flat[top:bottom, left:right], (left, top), tile, stored=True)
    np.testing.assert_array_equal(part, whole[:, :30])
    natural = lfrender.render(flat, known, depth, scale=5.0, detail="natural").image
    assert (part != natural[:, :30]).any()


def test_it_draws_whole_pictures_not_changes():
    shot, depth = captured("slope")
    first = picture("slope", "natural")
    with pytest.raises(ValueError, match="whole picture"):
        picture("slope", "restored", previous=(shot.flat, depth, first))


def test_point_spread_of_a_pixel_alone_and_of_a_disc():
    assert point_spread(0.0, 1.0)[1, 1] == pytest.approx(1.0, abs=0.01)
    wide = point_spread(4.0, 1.0)
    at = np.arange(len(wide)) - len(wide) // 2
    # A disc has a variance of d^2 / 16 along an axis, a pixel of 1 / 12.
    assert (wide.sum(0) * at**2).sum() == pytest.approx(4.0**2 / 16 + 1 / 12 + 1 / 12, abs=0.1)
