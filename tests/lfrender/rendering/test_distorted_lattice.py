"""Flats with a distorted lattice are analysed and rendered as well as undistorted ones."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import compare_pictures
from lfcal.lattice.distortion import Distortion

SIZE = (420, 340)
REACH = float(np.hypot(*SIZE)) / 2
# 2.6 px in the corners.
BENT = Distortion(np.array([200.0, 180.0]), 0.02, 0.0, REACH)


@functools.cache
def capture(scene):
    camera = Camera.design(size=SIZE, pitch=23.2, rotation=1.3)
    return simulate(SCENES[scene](camera), camera, samples=24, seed=2)


def warped(flat, distortion):
    """The flat as imaged through a relay lens with this distortion."""
    y, x = np.mgrid[: flat.shape[0], : flat.shape[1]]
    source = (
        distortion.remove(np.stack([x, y], -1).reshape(-1, 2))
        .reshape(*y.shape, 2)
        .astype(np.float32)
    )
    return cv2.remap(
        flat, source[..., 0], source[..., 1], cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT
    )


def camera_with(calibration, distortion):
    return replace(calibration, lattice=replace(calibration.lattice, distortion=distortion))


def psnr(shot, picture, distortion):
    """PSNR [dB] against the reference, distorted as the flat is, one pitch off the border."""
    truth = shot.truth
    height, width = picture.image.shape[:2]
    v, u = np.mgrid[:height, :width]
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ picture.affine.T
    if distortion is not None:
        points = distortion.remove(points)
    place = ((points - truth.reference_affine[:, 2]) / truth.reference_affine[0, 0]).reshape(
        height, width, 2
    )
    place = place.astype(np.float32)
    # As wide as an output pixel.
    smooth = cv2.GaussianBlur(
        truth.reference, (0, 0), 0.35 * picture.affine[0, 0] / truth.reference_affine[0, 0]
    )
    wanted = cv2.remap(smooth, place[..., 0], place[..., 1], cv2.INTER_LINEAR)
    inner = np.zeros((height, width), bool)
    border = int(np.ceil(1.5 * picture.scale))
    inner[border:-border, border:-border] = True
    return compare_pictures(picture.image, wanted, inner & picture.valid).psnr


@pytest.mark.parametrize("scene", ["plane", "slope"])
def test_a_distorted_lattice_is_analysed_and_rendered_as_well_as_an_undistorted_one(scene):
    shot = capture(scene)
    straight = shot.truth.calibration
    bent = camera_with(straight, BENT)
    flat = warped(shot.flat, BENT)
    plain = psnr(shot, lfrender.render(shot.flat, straight, detail="off"), None)
    depth = lfrender.analyze(flat, bent)
    found = psnr(shot, lfrender.render(flat, bent, depth, detail="off"), BENT)
    assert found > plain - 0.5
    # Depth of the same lenses, within a few hundredths of a pixel of the straight camera's.
    truth = np.sort(shot.truth.patch_size[shot.truth.mode != 0])
    resolved = depth.mode != 0
    assert resolved.mean() > 0.9 * (shot.truth.mode != 0).mean()
    assert np.median(depth.patch_size[resolved]) == pytest.approx(np.median(truth), abs=0.1)


def test_the_traditional_and_the_one_patch_picture_follow_the_distortion():
    shot = capture("plane")
    straight = shot.truth.calibration
    bent = camera_with(straight, BENT)
    flat = warped(shot.flat, BENT)
    s = float(np.nanmedian(shot.truth.patch_size))
    plain = psnr(shot, lfrender.render(shot.flat, straight, patch_size=s), None)
    assert psnr(shot, lfrender.render(flat, bent, patch_size=s), BENT) > plain - 0.5
    assert (
        psnr(shot, lfrender.traditional(flat, bent), BENT)
        > psnr(shot, lfrender.traditional(shot.flat, straight), None) - 0.5
    )
