"""Colour from filter mosaics of known colour flats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfrender
from data_synth.metrics import compare_pictures, resample
from lfcal import Calibration, FlatError
from lfrender.flat.demosaicing import demosaic

MOSAICS = ("RGGB", "BGGR", "GRBG", "GBRG")


def filtered_flat(flat, mosaic):
    """The values that a sensor with these filters stores."""
    out = np.empty(flat.shape[:2], flat.dtype)
    for k, letter in enumerate(mosaic):
        phase = np.s_[k // 2 :: 2, k % 2 :: 2]
        out[phase] = flat[phase][..., "RGB".index(letter)]
    return out


def psnr(shot, picture):
    shape = picture.image.shape[:2]
    wanted, inside = resample(
        shot.truth.reference, shot.truth.reference_affine, shape, picture.affine
    )
    inner = np.zeros(shape, bool)
    inner[10:-10, 10:-10] = True
    return compare_pictures(picture.image / 255.0, wanted, inside & inner & picture.valid).psnr


def test_a_mosaic_flat_is_analysed_and_drawn_nearly_as_well_as_a_colour_flat(house):
    camera = house.truth.calibration
    filtered = replace(camera, mosaic="RGGB")
    raw = filtered_flat(house.flat, "RGGB")
    colour = lfrender.render(house.flat, camera, scale=6.0)
    found = lfrender.render(raw, filtered, scale=6.0)
    assert found.image.shape == colour.image.shape
    # Its depth is as good; two thirds of the values of a picture are interpolated.
    other = lfrender.render(house.flat, camera, lfrender.analyze(raw, filtered), scale=6.0)
    assert psnr(house, other) > psnr(house, colour) - 0.3
    assert psnr(house, found) > psnr(house, colour) - 2.7
    gray = lfrender.render(raw, camera, scale=6.0)
    assert gray.image.ndim == 2
    assert lfrender.traditional(raw, filtered).image.shape[2] == 3


@pytest.mark.parametrize("mosaic", MOSAICS)
def test_colours_are_kept_for_each_filter_order(house, mosaic):
    camera = replace(house.truth.calibration, mosaic=mosaic)
    found = demosaic(filtered_flat(house.flat, mosaic), camera)
    assert found.dtype == np.uint8
    # Own colours stay as stored, and the means of all three are kept to 1 %.
    np.testing.assert_array_equal(filtered_flat(found, mosaic), filtered_flat(house.flat, mosaic))
    np.testing.assert_allclose(found.mean((0, 1)), house.flat.mean((0, 1)), rtol=0.01)


def test_no_colour_crosses_from_one_microimage_into_the_next(house):
    lattice = house.truth.calibration.lattice
    height, width = house.flat.shape[:2]
    y, x = np.mgrid[:height, :width]
    points = np.stack([x, y], -1).reshape(-1, 2)
    reach = np.arange(-1, 2)
    index = np.rint(lattice.to_index(points))
    around = [index + step for step in np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2)]
    nearest = np.argmin(
        [np.linalg.norm(lattice.points(k) - points, axis=1) for k in around], axis=0
    )
    own = np.array(around)[nearest, np.arange(len(points))]
    # Neighbouring lenses show evenly one of three colours.
    palette = np.array([[200, 40, 30], [20, 180, 60], [50, 30, 190]], np.uint8)
    flat = palette[((own[:, 0] - own[:, 1]) % 3).astype(int)].reshape(height, width, 3)
    found = demosaic(filtered_flat(flat, "GRBG"), replace(house.truth.calibration, mosaic="GRBG"))
    wrong = np.abs(found.astype(int) - flat).max(2) > 1
    inner = wrong[30:-30, 30:-30]
    assert inner.mean() < 0.001


def test_a_flat_of_a_camera_without_a_mosaic_is_returned_unchanged(house):
    gray = house.flat[:, :, 1]
    assert demosaic(gray, house.truth.calibration) is gray
    camera = replace(house.truth.calibration, mosaic="RGGB")
    assert demosaic(house.flat, camera) is house.flat
    assert lfrender.render(gray, house.truth.calibration, patch_size=5).image.ndim == 2


def test_a_mosaic_flat_with_nan_is_refused(house):
    raw = filtered_flat(house.flat, "RGGB").astype(np.float32) / 255
    raw[7, 9] = np.nan
    camera: Calibration = replace(house.truth.calibration, mosaic="RGGB")
    with pytest.raises(FlatError, match="x=9, y=7"):
        lfrender.analyze(raw, camera)
