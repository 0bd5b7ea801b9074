"""Patterns whose average cell is no microimage are refused or doubted; unusual arrays are not."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from benchmarks.white_images import WhiteImage
from lfcal.detection.cell_tests import find_shape_doubt, measure_average_cell
from lfcal.images.preprocessing import sqrt_luminance

_SMALL, _LARGE = (300, 260), (500, 400)


def test_grating_whose_lines_meet_the_pixel_rows_regularly_is_refused(patterns):
    u, _ = patterns.rotate(7, _SMALL)
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(patterns.photograph(128 + 100 * np.sign(np.sin(2 * np.pi * u / 9))))


@pytest.mark.parametrize(("bricks", "contrast", "noise", "size"), [
    ((5, 48, 24, 4), 0.4, 0.02, _LARGE), ((26, 27.5, 14.8, 2.0), 0.12, 0.1, (330, 290)),
])  # fmt: skip
def test_brick_wall_is_refused_or_gets_a_low_confidence(patterns, bricks, contrast, noise, size):
    joint = np.where(patterns.bricks(*bricks, size), 1.0, -1.0)
    wall = 127.5 * (1 + contrast * joint + np.random.default_rng(25).normal(0, noise, joint.shape))
    try:
        camera = lfcal.calibrate(np.clip(wall, 0, 255).astype(np.uint8))
    except lfcal.CalibrationError:
        return
    assert camera.confidence < 0.5
    assert any("nothing on the flat proves" in warning for warning in camera.warnings)


@pytest.mark.parametrize(("period", "degrees", "twill"), [(14, 9, True), (24, 45, False)])
def test_plain_weave_and_twill_are_refused(patterns, period, degrees, twill):
    thread = patterns.weave(degrees, period, twill, (400, 320))
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(patterns.photograph(30 + 180 * thread))


def test_crossed_waves_are_refused(patterns, period=45, degrees=11):
    u, v = patterns.rotate(degrees, _LARGE)
    a, b = np.sin(2 * np.pi * u / period), np.sin(2 * np.pi * v / period)
    for picture in (128 + 100 * a * b, 128 + 50 * (a + b), 20 + 50 * (1 + a) * (1 + b)):
        with pytest.raises(lfcal.CalibrationError):
            lfcal.calibrate(patterns.photograph(picture))


def test_crossed_waves_of_a_short_period_are_refused(patterns, period=9.0):
    u, v = patterns.rotate(17, _SMALL)
    a, b = np.sin(2 * np.pi * u / period), np.sin(2 * np.pi * v / period)
    for wave in (a * b, (a + b) / 2):
        with pytest.raises(lfcal.CalibrationError):
            lfcal.calibrate(patterns.photograph(127.5 + 120 * wave, 0, 4.0))


def test_blurred_checkerboard_is_refused_by_the_shape_of_its_dark_places(patterns, side=9.5):
    board = 127.5 + 120 * (2 * patterns.board(13, side, _SMALL) - 1)
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(patterns.photograph(board, 1.8, 4.0))


def _shape_doubt(truth, exposure=1.0):
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
def test_shape_of_a_white_image_is_never_doubted(shape, case):
    assert _shape_doubt(WhiteImage(shape, degrees=19.0, size=(320, 260), seed=5, **case)) is None


def test_unexplained_share_of_the_cell_is_not_raised_by_noise_but_by_a_bar(patterns):
    truth = WhiteImage("square", 18.0, 8.0, 10.0, size=(320, 260), seed=2)
    lattice = lfcal.Lattice(truth.origin, truth.basis, truth.size, 9.0)
    cell = measure_average_cell(sqrt_luminance(truth.image(1.0)), lattice)
    assert abs(cell.unexplained) < 0.02
    # A bar across each lens.
    _, v = patterns.rotate(8.0, truth.size)
    cos, sin = np.cos(np.radians(8)), np.sin(np.radians(8))
    middle = cos * truth.origin[1] - sin * truth.origin[0]
    bar = np.abs((v - middle + 9) % 18 - 9) < 2.5
    marked = measure_average_cell(sqrt_luminance(truth.image(1.0) * np.where(bar, 0.3, 1.0)), lattice)
    assert marked.unexplained > 0.1


def test_shape_of_faint_or_few_lenses_is_doubted():
    truth = WhiteImage("hexagonal", 8.0, 3.0, 10.0, gap=0.6, size=(48, 40), seed=1)
    assert "shape" in _shape_doubt(truth, 0.03) or "checkerboard" in _shape_doubt(truth, 0.03)
    assert "too few" in _shape_doubt(WhiteImage(pitch=20.0, size=(50, 40)))


def test_flattened_scene_without_dark_gaps_is_proved_by_its_parallax(house):
    white = np.maximum(house.white.astype(float), 0.02 * house.white.max())
    flat = (house.flat / 255.0) ** 2.2 / white[..., None]
    camera = lfcal.calibrate(flat)
    assert camera.source == "scene"
    assert camera.confidence > 0.7
    assert not any("proves" in warning for warning in camera.warnings)


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


@pytest.mark.parametrize(("shape", "light"), [
    ([[1, 0], [0, 1]], {"line": 0.4}), ([[1, 0], [0, 1.8]], {"shading": 0.3}),
    ([[1, 0], [0.5, 0.75**0.5]], {"shading": 0.3}), ([[1, 0], [0.2, 1.2]], {"line": 0.4}),
])  # fmt: skip
def test_touching_lenses_are_one_lattice_whatever_separates_them(whites, shape, light):
    basis = whites.turned(np.array(shape, float), 21.4, 2.2)
    image, origin = _touching(whites, basis, (360, 300), **light)
    found = lfcal.calibrate(image)
    assert whites.rms(whites.centre_errors(found.lattice, origin, basis)) < 0.1


def test_array_smaller_than_the_sensor_is_found_inside_its_dark_border(whites, stray=0.05):
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
