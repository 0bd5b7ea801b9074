"""Detail is restored where it is, with the same bits in any part; noise falls, and there are no
halos.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest

import lfrender
from benchmarks.coarse import average_areas
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures, resample
from lfcal import LensBlur
from lfrender.rendering.render import make_renderer


@functools.cache
def capture(scene="plane", noise=(4000, 5)):
    camera = Camera.design(size=(380, 320), pitch=27.0, rotation=1.3)
    shot = simulate(SCENES[scene](camera, seed=3), camera, samples=24, seed=5, noise=noise)
    return shot, lfrender.analyze(shot.flat, shot.truth.calibration)


def picture(detail, scene="plane", camera=None, **options):
    shot, depth = capture(scene)
    return lfrender.render(
        shot.flat, camera or shot.truth.calibration, depth, detail=detail, **options
    )


def psnr(detail, scene="plane", **options):
    truth = capture(scene)[0].truth
    made = picture(detail, scene, **options)
    wanted, inside = resample(
        truth.reference, truth.reference_affine, made.image.shape[:2], made.affine
    )
    return compare_pictures(made.image / 255.0, wanted, inside & made.valid).psnr


@pytest.mark.parametrize(
    ("scene", "gain"), [("plane", 0.05), ("slope", 0.6), ("clutter", 0.0), ("house", 0.0)]
)
def test_pictures_gain_and_none_loses(scene, gain):
    assert psnr("natural", scene) > psnr("off", scene) + gain
    assert psnr("natural", scene, scale=4.0) > psnr("off", scene, scale=4.0) - 0.02


def test_detail_is_restored_by_default_and_not_with_one_patch_size():
    shot, depth = capture()
    plain = lfrender.render(shot.flat, shot.truth.calibration, depth)
    np.testing.assert_array_equal(plain.image, picture("natural").image)
    assert lfrender.render(shot.flat, shot.truth.calibration, patch_size=-6.0).noise is None


@pytest.mark.parametrize(("scene", "gain"), [("plane", 0.9), ("slope", 1.5)])
def test_a_blur_that_the_camera_tells_is_undone(scene, gain):
    ratios = np.linspace(-0.6, -0.1, 6)
    # The aperture is that of the lens, and focus lies at s / D = 0.04.
    discs = 0.97 * 0.22 * 27.0 * np.abs(ratios - 0.04)
    blur = LensBlur(5.8, 0.5, [0.04], [0.1], ratios, discs[None], np.full((1, 6), 0.3))
    known = replace(capture(scene)[0].truth.calibration, lens_blur=blur)
    assert psnr("natural", scene, camera=known) > psnr("off", scene) + gain


def test_a_scene_that_is_soft_itself_is_not_taken_for_a_blurred_one():
    camera = Camera.design(size=(380, 320), pitch=27.0, rotation=1.3, fill=0.15)
    sharp = SCENES["plane"](camera, seed=3)
    (sheet,) = sharp.surfaces
    soft = replace(sheet, texture=cv2.GaussianBlur(sheet.texture, (0, 0), 6.0))
    shot = simulate(replace(sharp, surfaces=(soft,)), camera, samples=24, seed=5, noise=(8000, 5))
    truth = shot.truth
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    found = []
    for detail in ("off", "natural"):
        made = lfrender.render(shot.flat, truth.calibration, depth, detail=detail, scale=8.0)
        # The mean of the reference over each pixel: interpolated values are softer or sharper.
        wanted = average_areas(
            truth.reference, truth.reference_affine, made.image.shape[:2], made.affine
        )
        inside = made.valid.copy()
        inside[[0, -1]] = inside[:, [0, -1]] = False
        found.append(compare_pictures(made.image / 255.0, wanted, inside).psnr)
    assert found[1] > found[0] - 0.1


def test_a_smooth_ramp_has_less_noise_and_stays_else_as_it_is():
    off, natural = (
        picture(detail, "ramp").image.mean(2, dtype=np.float32) for detail in ("off", "natural")
    )
    grain = [
        (one - cv2.GaussianBlur(one, (0, 0), 3))[12:-12, 12:-12].std() for one in (off, natural)
    ]
    assert grain[1] < 0.75 * grain[0]
    assert np.abs(cv2.blur(natural - off, (9, 9))).max() < 0.5


def test_no_pixel_leaves_the_range_about_it_by_more_than_the_overshoot():
    off, natural = (picture(detail, "slope").image for detail in ("off", "natural"))
    around = np.ones((3, 3), np.uint8)
    low, high = (cut(off, around).astype(int) for cut in (cv2.erode, cv2.dilate))
    # Both are rounded.
    beyond = 0.25 * (high - low) + 2
    assert (natural >= low - beyond).all()
    assert (natural <= high + beyond).all()


def test_light_that_is_encoded_is_filtered_as_light():
    # One scene in 8 bits and in linear 16 bits: what is restored is the same, once both are
    # encoded.
    camera = Camera.design(size=(380, 320), pitch=27.0, rotation=1.3)
    scene = SCENES["plane"](camera, seed=3)
    made = []
    for form in ({}, {"bits": 16, "gamma": False}):
        shot = simulate(scene, camera, samples=24, seed=5, **form)
        depth = lfrender.analyze(shot.flat, shot.truth.calibration)
        drawn = lfrender.render(
            shot.flat, shot.truth.calibration, depth, detail="natural", scale=8.0
        ).image
        made.append(drawn / 255 if drawn.dtype == np.uint8 else (drawn / 65535.0) ** (1 / 2.2))
    assert np.median(np.abs(made[0] - made[1])) < 0.01


@pytest.mark.parametrize("scene", ["slope", "clutter"])
def test_parts_have_the_bits_of_the_whole(scene):
    whole = picture("natural", scene)
    part = picture("natural", scene, roi=(120, 90, 251, 207))
    left, top = np.rint((part.affine[:, 2] - whole.affine[:, 2]) / whole.affine[0, 0]).astype(int)
    rows, columns = part.valid.shape
    np.testing.assert_array_equal(part.image, whole.image[top : top + rows, left : left + columns])


def test_a_still_next_frame_keeps_its_picture_and_a_change_is_drawn_as_anew():
    shot, depth = capture("slope")
    camera = shot.truth.calibration
    first = picture("natural", "slope")
    moved = shot.flat.copy()
    moved[150:190, 180:230] = 255 - moved[150:190, 180:230]
    same = lfrender.render(shot.flat, camera, depth, previous=(shot.flat, depth, first))
    np.testing.assert_array_equal(same.image, first.image)
    after = lfrender.render(moved, camera, depth, previous=(shot.flat, depth, first))
    look = lambda p: moved[p[1] : p[3], p[0] : p[2]]  # noqa: E731
    afresh, _ = make_renderer(look, camera, depth, None, None, None, noise=first.noise).draw(
        moved, dtype=np.uint8
    )
    spacing = camera.lattice.pitch / first.scale
    left, top, right, bottom = (np.array([180, 150, 230, 190]) / spacing).astype(int)
    np.testing.assert_array_equal(
        after.image[top:bottom, left:right], afresh[top:bottom, left:right]
    )
    far = int(4.0 * first.scale)
    after.image[max(top - far, 0) : bottom + far, max(left - far, 0) : right + far] = 0
    kept = after.image.any(2)
    assert kept.mean() > 0.2
    np.testing.assert_array_equal(after.image[kept], first.image[kept])


def test_detail_needs_a_depth_map():
    shot, depth = capture()
    with pytest.raises(ValueError, match="needs a depth map"):
        lfrender.render(shot.flat, shot.truth.calibration, patch_size=-6.0, detail="natural")
    with pytest.raises(ValueError, match="detail must be one of natural, off"):
        lfrender.render(shot.flat, shot.truth.calibration, depth, detail="restored")


def test_sixteen_bits_that_are_encoded_are_restored_as_eight():
    shot, depth = capture("slope")
    camera = replace(shot.truth.calibration, encoded=True)
    deep = lfrender.render(shot.flat.astype(np.uint16) * 257, camera, depth)
    assert np.mean(np.abs(deep.image / 257 - picture("natural", "slope").image) > 1.5) < 1e-3
    plain = lfrender.render(shot.flat.astype(np.uint16) * 257, shot.truth.calibration, depth)
    assert np.abs(deep.image / 257 - plain.image / 257).max() > 10
