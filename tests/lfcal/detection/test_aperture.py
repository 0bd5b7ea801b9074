"""Confidence is earned: by the shape of the light in the cells, or by what neighbours show."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import lfcal
from benchmarks.white_images import WhiteImage
from lfcal.detection.aperture import find_shape_doubt, measure_average_cell
from lfcal.images.preprocessing import sqrt_luminance


def _turned(degrees, size=(300, 260)):
    y, x = np.mgrid[0 : size[1], 0 : size[0]].astype(float)
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return cos * x + sin * y, cos * y - sin * x


def _photographed(picture, blur, noise=4.0):
    picture = cv2.GaussianBlur(picture, (0, 0), blur) if blur else picture
    return np.clip(picture + np.random.default_rng(0).normal(0, noise, picture.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("side", [9.5, 16.0, 24.0])
def test_blurred_checkerboard_is_refused_for_its_dark_places(side):
    u, v = _turned(13)
    board = 127.5 + 120 * (2 * ((np.floor(u / side) + np.floor(v / side)) % 2) - 1)
    with pytest.raises(lfcal.CalibrationError, match="checkerboard"):
        lfcal.calibrate(_photographed(board, 1.8))


@pytest.mark.parametrize(("period", "ratio"), [(9.0, 1.0), (12.5, 1.0), (10.0, 1.6)])
def test_crossed_waves_of_few_pixels_are_refused(period, ratio):
    u, v = _turned(17)
    a, b = np.sin(2 * np.pi * u / period), np.sin(2 * np.pi * v / (ratio * period))
    for wave in (a * b, (a + b) / 2):
        with pytest.raises(lfcal.CalibrationError, match=r"waves|checkerboard"):
            lfcal.calibrate(_photographed(127.5 + 120 * wave, 0))


def _wall(height, width, mortar, contrast, seed, degrees):
    u, v = _turned(degrees, (330, 290))
    row = np.floor(v / height)
    joint = ((u + row % 2 * width / 2) % width < mortar) | (v % height < mortar)
    noise = np.random.default_rng(seed).normal(0, 0.1, u.shape)
    return np.clip(127.5 * (1 + contrast * np.where(joint, 1.0, -1.0) + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("wall", [(14.8, 27.5, 2.0, 0.12, 25, 26), (16.9, 32.0, 2.5, 0.13, 34, 79)])
def test_faint_brick_wall_is_never_a_sure_lattice(wall):
    try:
        camera = lfcal.calibrate(_wall(*wall))
    except lfcal.CalibrationError:
        return
    assert camera.confidence < 0.5
    assert any("nothing on the flat proves" in warning for warning in camera.warnings)


@pytest.mark.parametrize(("period", "twill"), [(12.0, False), (26.0, False), (20.0, True)])
def test_threads_of_a_weave_are_two_kinds_of_cells(period, twill):
    u, v = _turned(9)
    i, j = np.floor(u / period), np.floor(v / period)
    along, across = np.cos(np.pi * (u / period - i - 0.5)), np.cos(np.pi * (v / period - j - 0.5))
    over = (i - j) % 4 < 2 if twill else (i + j) % 2 > 0
    thread = np.where(over, across * (0.75 + 0.25 * along), along * (0.75 + 0.25 * across))
    light = _photographed(20 + 200 * thread, 0.8)
    cos, sin = np.cos(np.radians(9)), np.sin(np.radians(9))
    turn = np.array([[cos, sin], [-sin, cos]])
    lattice = lfcal.Lattice(8.5 * period * turn.sum(0), period * turn, (300, 260), period / 2)
    found = measure_average_cell(sqrt_luminance(light), lattice)
    assert found.two_kinds > 0.15
    assert find_shape_doubt(sqrt_luminance(light), lattice) is not None


def _doubt_of(truth, exposure=1.0):
    lattice = lfcal.Lattice(truth.origin, truth.basis, truth.size, truth.pitch / 2)
    return find_shape_doubt(sqrt_luminance(truth.image(exposure)), lattice)


@pytest.mark.parametrize("shape", ["hexagonal", "square"])
@pytest.mark.parametrize(
    "case",
    [
        {"pitch": 6.3, "soft": 1.5, "fill": 0.9, "gap": 0.3},
        {"pitch": 7.0, "soft": 2.5, "fill": 0.8},
        {"pitch": 14.3, "strength": 0.3},
        {"pitch": 14.3, "decibels": 12.0, "hot": 40, "dust": 5},
        {"pitch": 30.0, "fill": 1.0, "soft": 0.3, "gap": 0.0},
        {"pitch": 30.0, "fill": 0.6, "soft": 3.0, "gap": 0.6, "outer": 0.8},
    ],
)
def test_no_white_image_is_in_doubt_for_its_shape(shape, case):
    assert _doubt_of(WhiteImage(shape, degrees=19.0, size=(320, 260), seed=5, **case)) is None


def test_share_of_the_cell_that_is_no_lens_is_told_apart_from_noise():
    truth = WhiteImage("square", 18.0, 8.0, 10.0, size=(320, 260), seed=2)
    lattice = lfcal.Lattice(truth.origin, truth.basis, truth.size, 9.0)
    found = measure_average_cell(sqrt_luminance(truth.image(1.0)), lattice)
    assert found.alike > 0.9
    assert abs(found.unexplained) < 0.02
    # Each lens marked by a bar across it.
    _, v = _turned(8.0, truth.size)
    cos, sin = np.cos(np.radians(8)), np.sin(np.radians(8))
    middle = cos * truth.origin[1] - sin * truth.origin[0]
    bar = np.abs((v - middle + 9) % 18 - 9) < 2.5
    marked = measure_average_cell(sqrt_luminance(truth.image(1.0) * np.where(bar, 0.3, 1.0)), lattice)
    assert marked.unexplained > 0.1


def test_faint_and_few_lenses_leave_the_shape_in_doubt():
    truth = WhiteImage("hexagonal", 8.0, 3.0, 10.0, gap=0.6, size=(48, 40), seed=1)
    assert "shape" in _doubt_of(truth, 0.03) or "checkerboard" in _doubt_of(truth, 0.03)
    assert "too few" in _doubt_of(WhiteImage(pitch=20.0, size=(50, 40)))


def test_scenes_prove_themselves_by_what_neighbours_share(house):
    """Flattened, as some cameras write them: joints are as bright as anything."""
    white = np.maximum(house.white.astype(float), 0.02 * house.white.max())
    flat = (house.flat / 255.0) ** 2.2 / white[..., None]
    camera = lfcal.calibrate(flat)
    assert camera.source == "scene"
    assert camera.confidence > 0.7
    assert not any("proves" in warning for warning in camera.warnings)
