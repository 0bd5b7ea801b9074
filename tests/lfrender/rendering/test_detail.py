"""Detail is restored where it is, with the same bits in any part; noise falls, and there are no halos."""

from __future__ import annotations

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures, resample
from lfcal import load
from lfrender.cli.main import main
from lfrender.detail.settings import RESTORE
from lfrender.rendering.render import make_plan


@functools.cache
def capture(scene="plane", noise=(4000, 5)):
    camera = Camera.design(size=(380, 320), pitch=27.0, rotation=1.3)
    shot = simulate(SCENES[scene](camera, seed=3), camera, samples=24, seed=5, noise=noise)
    return shot, lfrender.analyze(shot.flat, shot.truth.calibration)


def picture(detail, scene="plane", **options):
    shot, depth = capture(scene)
    return lfrender.render(shot.flat, shot.truth.calibration, depth, detail=detail, **options)


def psnr(detail, scene="plane", **options):
    truth, made = capture(scene)[0].truth, picture(detail, scene, **options)
    wanted, inside = resample(truth.reference, truth.reference_affine, made.image.shape[:2], made.affine)
    return compare_pictures(made.image / 255.0, wanted, inside & made.valid).psnr


@pytest.mark.parametrize(("scene", "gain"), [("plane", 0.9), ("slope", 1.8), ("clutter", 0.0), ("house", 0.0)])
def test_pictures_gain_and_none_loses(scene, gain):
    assert psnr("natural", scene) > psnr("off", scene) + gain
    assert psnr("natural", scene, scale=4.0) > psnr("off", scene, scale=4.0) - 0.02


def test_detail_is_restored_by_default_and_not_beside_another_sharpening():
    shot, depth = capture()
    plain = lfrender.render(shot.flat, shot.truth.calibration, depth)
    np.testing.assert_array_equal(plain.image, picture("natural").image)
    assert lfrender.render(shot.flat, shot.truth.calibration, depth, sharpen=1.5).defocus is None
    assert lfrender.render(shot.flat, shot.truth.calibration, patch_size=-6.0).defocus is None


def test_the_blur_is_measured_once_for_a_depth_map_and_its_flat(monkeypatch):
    from lfrender.rendering import render as rendering

    shot, depth = capture()
    measure, measured = rendering.measure_defocus, []

    def counted(*given):
        measured.append(1)
        return measure(*given)

    monkeypatch.setattr(rendering, "measure_defocus", counted)
    again = replace(depth)
    for flat, scale, times in ((shot.flat, None, 1), (shot.flat, 4.0, 1), (shot.flat // 2, None, 2)):
        lfrender.render(flat, shot.truth.calibration, again, scale=scale)
        assert len(measured) == times


def test_a_smooth_ramp_has_less_noise_and_stays_else_as_it_is():
    off, natural = (picture(detail, "ramp").image.astype(np.float32) for detail in ("off", "natural"))
    grain = [(one - cv2.GaussianBlur(one, (0, 0), 3))[12:-12, 12:-12].std() for one in (off, natural)]
    assert grain[1] < 0.75 * grain[0]
    assert np.abs(cv2.blur(natural - off, (9, 9))).max() < 0.5


def test_no_pixel_leaves_the_range_about_it_by_more_than_the_overshoot():
    off, natural = (picture(detail, "slope").image for detail in ("off", "natural"))
    around = np.ones((3, 3), np.uint8)
    low, high = (cut(off, around).astype(int) for cut in (cv2.erode, cv2.dilate))
    # Both are rounded.
    beyond = RESTORE.overshoot * (high - low) + 2
    assert (natural >= low - beyond).all()
    assert (natural <= high + beyond).all()


def test_light_that_is_encoded_is_filtered_as_light():
    # One scene in 8 bits and in linear 16 bits: what is restored is the same, once both are encoded.
    camera = Camera.design(size=(380, 320), pitch=27.0, rotation=1.3)
    scene, made = SCENES["plane"](camera, seed=3), []
    for form in ({}, {"bits": 16, "gamma": False}):
        shot = simulate(scene, camera, samples=24, seed=5, **form)
        depth = lfrender.analyze(shot.flat, shot.truth.calibration)
        drawn = lfrender.render(shot.flat, shot.truth.calibration, depth, detail="natural", scale=8.0).image
        made.append(drawn / 255 if drawn.dtype == np.uint8 else (drawn / 65535.0) ** (1 / 2.2))
    assert np.median(np.abs(made[0] - made[1])) < 0.01


@pytest.mark.parametrize("scene", ["slope", "clutter"])
def test_parts_have_the_bits_of_the_whole(scene):
    whole, part = picture("natural", scene), picture("natural", scene, roi=(120, 90, 251, 207))
    left, top = np.rint((part.affine[:, 2] - whole.affine[:, 2]) / whole.affine[0, 0]).astype(int)
    rows, columns = part.valid.shape
    np.testing.assert_array_equal(part.image, whole.image[top : top + rows, left : left + columns])


def test_tiles_have_the_bits_of_the_whole():
    shot, depth = capture("clutter")
    flat = shot.flat
    whole = picture("natural", "clutter")
    plan = make_plan(
        lambda p: flat[p[1] : p[3], p[0] : p[2]], shot.truth.calibration, depth, None, None, None, "natural"
    )
    for tile in plan.tiles((50, 37)):
        left, top, right, bottom = needed = plan.required_part(tile)
        image, _ = plan.draw(flat[top:bottom, left:right], needed[:2], tile, stored=True)
        np.testing.assert_array_equal(image, whole.image[tile[1] : tile[3], tile[0] : tile[2]])


def test_a_still_next_frame_keeps_its_picture_and_a_change_is_drawn_as_anew():
    shot, depth = capture("slope")
    camera, first = shot.truth.calibration, picture("natural", "slope")
    moved = shot.flat.copy()
    moved[150:190, 180:230] = 255 - moved[150:190, 180:230]
    same = lfrender.render(shot.flat, camera, depth, previous=(shot.flat, depth, first))
    np.testing.assert_array_equal(same.image, first.image)
    plan = make_plan(lambda p: moved[p[1] : p[3], p[0] : p[2]], camera, depth, None, None, None, "natural")
    plan = replace(plan, defocus=first.defocus)
    wanted = np.zeros(first.valid.shape, bool)
    reached = 2.0 * camera.lattice.pitch / plan.spacing
    left, top = (np.array([180, 150]) / plan.spacing - reached).astype(int)
    right, bottom = (np.array([230, 190]) / plan.spacing + reached).astype(int)
    wanted[max(top, 0) : bottom, max(left, 0) : right] = True
    image, _ = plan.render_changed(moved, wanted, first.image, first.valid)
    np.testing.assert_array_equal(image, plan.draw(moved, stored=True)[0])


def test_detail_needs_a_depth_map_and_no_other_sharpening():
    shot, depth = capture()
    with pytest.raises(ValueError, match="needs a depth map"):
        lfrender.render(shot.flat, shot.truth.calibration, patch_size=-6.0, detail="natural")
    with pytest.raises(ValueError, match="detail"):
        lfrender.render(shot.flat, shot.truth.calibration, depth, detail="much")
    with pytest.raises(ValueError, match="either"):
        lfrender.render(shot.flat, shot.truth.calibration, depth, detail="natural", sharpen="auto")


def test_the_command_restores_detail(tmp_path):
    shot, depth = capture()
    cv2.imwrite(str(tmp_path / "flat.png"), shot.flat[..., ::-1])
    shot.truth.calibration.save(tmp_path / "camera.json")
    depth.save(tmp_path / "depth.npz")
    out = tmp_path / "picture.png"
    given = ["render", str(tmp_path / "flat.png"), "-c", str(tmp_path / "camera.json"), "-o", str(out), "--quiet"]
    known = tmp_path / "known.json"
    more = ["--depth", str(tmp_path / "depth.npz"), "--detail", "natural", "--save-blur", str(known)]
    result = CliRunner().invoke(main, [*given, *more])
    assert result.exit_code == 0, result.output
    np.testing.assert_array_equal(cv2.imread(str(out))[..., ::-1], picture("natural").image)
    assert load(known).lens_blur.discs.shape[0] == 1


def test_a_blur_that_cannot_be_measured_is_an_error_and_nothing_is_written(tmp_path):
    shot, depth = capture()
    cv2.imwrite(str(tmp_path / "flat.png"), shot.flat[..., ::-1])
    shot.truth.calibration.save(tmp_path / "camera.json")
    few = np.where(np.arange(len(depth.patch_size)) < 3, depth.patch_size, np.nan)
    reason = np.where(np.isfinite(few), 0, 1).astype(np.int8)
    replace(depth, patch_size=few, reason=reason).save(tmp_path / "depth.npz")
    out, known = tmp_path / "picture.png", tmp_path / "known.json"
    given = ["render", str(tmp_path / "flat.png"), "-c", str(tmp_path / "camera.json"), "-o", str(out), "--quiet"]
    result = CliRunner().invoke(main, [*given, "--depth", str(tmp_path / "depth.npz"), "--save-blur", str(known)])
    assert result.exit_code == 2 and "could not be measured" in result.output
    assert not out.exists() and not known.exists()


def test_sixteen_bits_that_are_encoded_are_restored_as_eight():
    shot, depth = capture("slope")
    camera = replace(shot.truth.calibration, encoded=True)
    deep = lfrender.render(shot.flat.astype(np.uint16) * 257, camera, depth)
    assert np.mean(np.abs(deep.image / 257 - picture("natural", "slope").image) > 1.5) < 1e-3
    plain = lfrender.render(shot.flat.astype(np.uint16) * 257, shot.truth.calibration, depth)
    assert np.abs(deep.image / 257 - plain.image / 257).max() > 10


def test_eight_bits_that_are_linear_are_restored_as_light():
    camera = Camera.design(size=(380, 320), pitch=27.0, rotation=1.3)
    shot = simulate(SCENES["slope"](camera, seed=3), camera, samples=24, seed=5, noise=(4000, 5), gamma=False)
    known, truth, error = shot.truth.calibration, shot.truth, {}
    depth = lfrender.analyze(shot.flat, known)
    for encoded in (None, False):
        made = lfrender.render(shot.flat, replace(known, encoded=encoded), depth)
        wanted, inside = resample(truth.reference, truth.reference_affine, made.image.shape[:2], made.affine)
        error[encoded] = compare_pictures(made.image / 255.0, wanted, inside & made.valid).psnr
    assert error[False] > error[None] + 0.5
