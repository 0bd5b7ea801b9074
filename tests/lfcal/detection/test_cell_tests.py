"""What repeats and is no array of microimages is refused; arrays that look like little are not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import lfcal


def _turned(degrees, size=(800, 600)):
    y, x = np.mgrid[0 : size[1], 0 : size[0]].astype(float)
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return cos * x + sin * y, cos * y - sin * x


def _photographed(picture, blur=0.7):
    picture = cv2.GaussianBlur(picture, (0, 0), blur)
    return np.clip(picture + np.random.default_rng(0).normal(0, 3, picture.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("period", "degrees"), [(9, 7), (14.7, 7), (30, 7), (60, 33.3)])
@pytest.mark.parametrize("square", [False, True])
def test_grating_whose_lines_meet_the_pixel_rows_again_and_again_is_refused(period, degrees, square):
    u, _ = _turned(degrees)
    wave = np.sin(2 * np.pi * u / period)
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(_photographed(128 + 100 * (np.sign(wave) if square else wave)))


@pytest.mark.parametrize("degrees", [0, 5, 31])
@pytest.mark.parametrize(("width", "height", "mortar"), [(40, 15, 2), (60, 20, 3), (30, 15, 1.5), (48, 24, 4)])
def test_brick_wall_is_refused(width, height, mortar, degrees):
    u, v = _turned(degrees)
    row = np.floor(v / height)
    joint = ((u + row % 2 * width / 2) % width < mortar) | (v % height < mortar)
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(_photographed(np.where(joint, 200.0, 90.0)))


@pytest.mark.parametrize(("period", "degrees"), [(14, 0), (14, 9), (24, 45)])
def test_plain_weave_and_twill_are_refused(period, degrees):
    u, v = _turned(degrees)
    i, j = np.floor(u / period), np.floor(v / period)
    along, across = np.cos(np.pi * (u / period - i - 0.5)), np.cos(np.pi * (v / period - j - 0.5))
    for over in ((i + j) % 2 > 0, (i - j) % 4 < 2):
        thread = np.where(over, across * (0.75 + 0.25 * along), along * (0.75 + 0.25 * across))
        with pytest.raises(lfcal.CalibrationError):
            lfcal.calibrate(_photographed(30 + 180 * thread))


@pytest.mark.parametrize("degrees", [0, 11])
@pytest.mark.parametrize("period", [20, 45])
def test_crossed_waves_are_refused(period, degrees):
    u, v = _turned(degrees)
    a, b = np.sin(2 * np.pi * u / period), np.sin(2 * np.pi * v / period)
    for picture in (128 + 100 * a * b, 128 + 50 * (a + b), 20 + 50 * (1 + a) * (1 + b)):
        with pytest.raises(lfcal.CalibrationError, match="waves"):
            lfcal.calibrate(_photographed(picture))


def _touching(whites, basis, size, *, shading=0.0, line=0.0, noise=0.01):
    """Lenses without gaps: light falls with the square of the distance, and along a line of a pixel at the border."""
    _, origin = whites.white_image(basis, (8, 8))
    origin = origin + np.array(size) / 2
    y, x = np.mgrid[: size[1] * 2, : size[0] * 2] / 2 - 0.25
    offset = np.stack([x - origin[0], y - origin[1]], -1)
    index = np.rint(offset @ np.linalg.inv(basis))
    steps = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    far = np.sort([np.hypot(*np.moveaxis(offset - (index + step) @ basis, -1, 0)) for step in steps], axis=0)
    reach = np.hypot(*basis.T).min() / 2
    light = (1 - shading * (far[0] / reach) ** 2) * np.where(far[1] - far[0] < 1, 1 - line, 1)
    light = light.reshape(size[1], 2, size[0], 2).mean((1, 3))
    light += noise * np.random.default_rng(1).standard_normal(light.shape)
    return np.rint(np.clip(0.8 * light, 0, 1) * 65535).astype(np.uint16), origin


@pytest.mark.parametrize(
    "shape", [[[1, 0], [0, 1]], [[1, 0], [0, 1.8]], [[1, 0], [0.5, 0.75**0.5]], [[1, 0], [0.2, 1.2]]]
)
@pytest.mark.parametrize("light", [{"shading": 0.3}, {"line": 0.4}])
def test_touching_lenses_are_one_lattice_whatever_parts_them(whites, shape, light):
    basis = whites.turned(np.array(shape, float), 21.4, 2.2)
    image, origin = _touching(whites, basis, (360, 300), **light)
    found = lfcal.calibrate(image)
    assert whites.rms(whites.centre_errors(found.lattice, origin, basis)) < 0.1


@pytest.mark.parametrize("stray", [0.0, 0.05])
def test_array_that_fills_a_part_of_the_sensor_is_found_inside_its_dark_border(whites, stray):
    basis = whites.turned(whites.HEXAGON, 20.3, 17)
    image, origin = whites.white_image(basis, (700, 500), noise=0)
    y, x = np.mgrid[:500, :700]
    inside = (np.abs(0.95 * (x - 330) + 0.3 * (y - 260)) < 210) & (np.abs(0.95 * (y - 260) - 0.3 * (x - 330)) < 130)
    light = np.where(inside, image / 65535, stray * 0.8) + np.random.default_rng(2).normal(0, 0.01, image.shape)
    found = lfcal.calibrate(np.rint(np.clip(light, 0, 1) * 65535).astype(np.uint16))
    offset = whites.centre_errors(found.lattice, origin, basis)
    lit = inside[tuple(np.rint(found.lattice.centres()).astype(int).clip(0, [699, 499]).T[::-1])]
    assert lit.sum() > 200
    assert whites.rms(offset[lit]) < 0.05
