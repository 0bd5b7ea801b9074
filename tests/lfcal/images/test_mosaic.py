"""Flats with a colour filter mosaic: centres as good as without, for every mosaic, stated or detected."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal

_COLOURS = {"R": 0.45, "G": 1.0, "B": 0.6}


def _filtered(image, mosaic):
    """`image` (h, w) or (h, w, 3) behind colour filters, a mono image under reddish light."""
    out = np.empty(image.shape[:2], image.dtype)
    for place, colour in enumerate(mosaic):
        phase = np.s_[place // 2 :: 2, place % 2 :: 2]
        out[phase] = image[phase] * _COLOURS[colour] if image.ndim == 2 else image[(*phase, "RGB".index(colour))]
    return out


@pytest.mark.parametrize("mosaic", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("stated", [True, False])
def test_white_image_behind_a_mosaic_places_centres_within_three_thousandths(whites, mosaic, stated):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    image, origin = whites.white_image(basis, (501, 401))
    camera = lfcal.calibrate(_filtered(image, mosaic), mosaic=mosaic if stated else None)
    assert camera.source == "white"
    assert whites.rms(whites.centre_errors(camera.lattice, origin, basis)) < 0.003
    assert camera.mosaic == (mosaic if stated else None)
    assert any("mosaic" in warning for warning in camera.warnings) == (not stated)


@pytest.mark.parametrize(("shape", "pitch"), [("SQUARE", 10.0), ("SQUARE", 12.0), ("HEXAGON", 14.3)])
def test_a_lattice_of_whole_pixels_is_no_mosaic(whites, shape, pitch):
    basis = whites.turned(getattr(whites, shape), pitch, 0)
    image, _ = whites.white_image(basis, (500, 400))
    assert not lfcal.calibrate(image).warnings


def test_scene_behind_a_mosaic_places_centres_within_a_twentieth_pixel(house):
    colour = house.flat.astype(np.float64) * [0.5, 1.0, 0.7]
    camera = lfcal.calibrate(_filtered(colour, "GRBG"), mosaic="GRBG")
    truth = house.truth.calibration.lattice
    index = np.rint(truth.to_index(camera.lattice.centres()))
    miss = camera.lattice.centres() - truth.points(index)
    assert np.sqrt((miss**2).sum(1).mean()) < 0.05
    assert camera.source == "scene"


def test_a_mosaic_is_kept_in_the_camera_file(whites, tmp_path):
    image, _ = whites.white_image(whites.turned(whites.HEXAGON, 14.3, 3), (300, 260))
    camera = lfcal.calibrate(_filtered(image, "BGGR"), mosaic="BGGR")
    camera.save(tmp_path / "camera.json")
    assert lfcal.load(tmp_path / "camera.json").mosaic == "BGGR"
    assert lfcal.calibrate(image).to_dict()["mosaic"] is None


def test_a_mosaic_of_a_colour_picture_or_of_unknown_name_is_refused(whites):
    image, _ = whites.white_image(whites.turned(whites.HEXAGON, 14.3, 3), (300, 260))
    with pytest.raises(lfcal.FlatError, match="in colour"):
        lfcal.calibrate(np.dstack([image] * 3), mosaic="RGGB")
    with pytest.raises(ValueError, match="RGGB"):
        lfcal.calibrate(image, mosaic="RGBG")
