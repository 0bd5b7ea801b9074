"""Refocused pictures: sharp at their own depth, and only there."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures
from data_synth.simulator import true_view
from lfrender.rendering.refocus import stack_depths

SIZE = (420, 340)
PITCH = 23.2


@functools.cache
def capture(scene, **arguments):
    camera = Camera.design(size=SIZE, pitch=PITCH, rotation=1.3)
    return simulate(SCENES[scene](camera, **arguments), camera, samples=24, seed=2)


@functools.cache
def depth_of(scene, **arguments):
    shot = capture(scene, **arguments)
    return lfrender.analyze(shot.flat, shot.truth.calibration)


def difference(picture, other, part=np.s_[:, :]):
    """RMS difference [grey levels] of two pictures on one grid, without two pitches of border."""
    border = int(np.ceil(2 * picture.scale))
    inner = np.s_[border:-border, border:-border]
    return np.sqrt(np.mean((picture.image.astype(float) - other.image)[inner][part] ** 2))


@pytest.mark.parametrize("ratio", [-0.35, 0.3])
def test_a_plane_is_as_sharp_as_all_in_focus_at_its_own_depth_only(ratio):
    shot = capture("plane", ratio=ratio)
    s = ratio * PITCH
    camera = shot.truth.calibration
    sharp = lfrender.render(
        shot.flat, camera, depth_of("plane", ratio=ratio), scale=abs(s), detail="off"
    )
    assert difference(lfrender.refocus(shot.flat, camera, s), sharp) < 2
    assert difference(lfrender.refocus(shot.flat, camera, 0.8 * s, scale=abs(s)), sharp) > 8


def test_a_focal_stack_moves_the_focus_across_a_slope_on_one_grid():
    shot = capture("slope")
    camera = shot.truth.calibration
    sharp = lfrender.render(shot.flat, camera, depth_of("slope"), scale=8, detail="off")
    far, near = lfrender.focal_stack(shot.flat, camera, [-0.45 * PITCH, -0.2 * PITCH], scale=8)
    np.testing.assert_array_equal(far.affine, sharp.affine)
    np.testing.assert_array_equal(near.affine, sharp.affine)
    left = np.s_[:, :20]
    right = np.s_[:, -20:]
    assert difference(far, sharp, left) < 0.6 * difference(near, sharp, left)
    assert difference(near, sharp, right) < 0.6 * difference(far, sharp, right)


def test_a_smaller_aperture_leaves_more_detail_out_of_focus():
    shot = capture("slope")
    pictures = [
        lfrender.refocus(shot.flat, shot.truth.calibration, -0.2 * PITCH, aperture=part, scale=8)
        for part in (1.0, 0.6, 0.35)
    ]
    # The left border lies at s = -0.55 D.
    detail = [
        np.abs(np.diff(picture.image[10:-10, 5:25].astype(float), axis=0)).mean()
        for picture in pictures
    ]
    assert detail[2] > 1.15 * detail[1] > 1.3 * detail[0]


def test_a_position_is_focused_at_its_depth():
    shot = capture("plane", ratio=-0.35)
    camera = shot.truth.calibration
    depth = depth_of("plane", ratio=-0.35)
    picture = lfrender.refocus(shot.flat, camera, position=(200.0, 150.0), depth=depth)
    assert picture.scale == pytest.approx(0.35 * PITCH, rel=0.09)


def test_a_stack_spans_a_slope_evenly_in_virtual_depth():
    depth = depth_of("slope")
    ratios = PITCH / np.array(stack_depths(depth, 5))
    np.testing.assert_allclose(np.diff(ratios), np.diff(ratios).mean(), rtol=1e-6)
    # The slope runs from s / D = -0.55 to -0.15; the nearest has the smallest |s|.
    assert -2.2 < ratios[0] < -1.6 and -7.5 < ratios[-1] < -4.5
    (middle,) = stack_depths(depth, 1)
    assert PITCH / middle == pytest.approx(ratios[2], rel=1e-6)
    with pytest.raises(ValueError, match="at least one"):
        stack_depths(depth, 0)


def test_blur_is_even_where_lenses_are_too_few_for_it():
    shot = capture("house")
    camera = shot.truth.calibration
    design = shot.camera
    depth = depth_of("house")
    # In focus near the branches; the house behind them is blurred over several pitches.
    focus = -0.5 * PITCH
    light_field = lfrender.refocus(shot.flat, camera, focus, scale=6.0)
    blurred = lfrender.refocus(shot.flat, camera, focus, depth=depth, scale=6.0)
    # The true picture is the mean of those through all places of the main lens.
    number = np.arange(60)
    radius = camera.lattice.radius * np.sqrt((number + 0.5) / 60)
    angle = number * np.pi * (3 - 5**0.5)
    truth = np.zeros(blurred.image.shape)
    scene = SCENES["house"](design)
    for offset in np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]):
        affine = np.array(blurred.affine)
        affine[:, 2] += offset * PITCH / focus
        size = blurred.image.shape[1::-1]
        truth += true_view(scene, design, tuple(offset), affine, size, samples=2) / 60
    where = np.zeros(truth.shape[:2], bool)
    where[12:-12, 12:-12] = True
    mesh, even = (
        compare_pictures(picture.image / 255, truth, where) for picture in (light_field, blurred)
    )
    assert even.psnr > mesh.psnr + 6
    assert even.ssim > 0.8 > 0.5 > mesh.ssim


def test_a_depth_map_changes_nothing_where_the_light_field_is_dense():
    shot = capture("plane", ratio=-0.35)
    camera = shot.truth.calibration
    focus = -0.35 * PITCH
    plain = lfrender.refocus(shot.flat, camera, focus, scale=8.0)
    known = depth_of("plane", ratio=-0.35)
    (stacked,) = lfrender.focal_stack(shot.flat, camera, [focus], depth=known, scale=8.0)
    assert difference(plain, stacked) < 1


def test_wrong_arguments_are_refused():
    shot = capture("plane", ratio=-0.35)
    camera = shot.truth.calibration
    for arguments in (
        {},
        {"patch_size": 5.0, "position": (1.0, 1.0)},
        {"patch_size": 0.0},
        {"patch_size": float("nan")},
        {"patch_size": 5.0, "aperture": 0.0},
        {"patch_size": 5.0, "scale": -1.0},
        {"position": (-20.0, 5.0)},
    ):
        with pytest.raises(ValueError):
            lfrender.refocus(shot.flat, camera, **arguments)
    with pytest.raises(ValueError, match="at least one"):
        lfrender.focal_stack(shot.flat, camera, [])
