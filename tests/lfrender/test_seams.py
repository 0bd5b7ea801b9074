"""Pictures show no lattice, and are as bright as the flat they come from."""

import dataclasses
import functools

import numpy as np
import pytest

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from lfcal.gain_map import GainMap

SIZE = (520, 400)


@functools.cache
def capture(scene):
    camera = Camera.design(size=SIZE, pitch=23.2, rotation=1.3)
    return simulate(SCENES[scene](camera), camera, samples=32, seed=2)


def off_centre(lattice):
    """(H, W) distance [px] of each pixel from the centre of its microimage."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    points = np.stack([x, y], -1).reshape(-1, 2)
    centres = lattice.points(np.rint(lattice.to_index(points)))
    return np.hypot(*(points - centres).T).reshape(y.shape)


@functools.cache
def shaded_white():
    """A white image of lenses that lose half of the light toward their rim."""
    shot = capture("plane")
    distance = off_centre(shot.truth.calibration.lattice) / 11.6
    return np.rint(shot.white * (1 - 0.5 * np.minimum(distance, 1.2) ** 2)).astype(np.uint8)


@functools.cache
def camera_of(scene):
    white = shaded_white() if scene is None else capture(scene).white
    return lfcal.calibrate(white, kind="white")


def lattice_amplitude(picture, lattice):
    """RMS [grey levels] of what the picture holds at the frequencies of the lattice, up to the second order."""
    border = int(np.ceil(1.5 * picture.scale))
    image = picture.image.astype(float)
    image = image.mean(2) if image.ndim == 3 else image
    image = image[border:-border, border:-border]
    window = np.hanning(image.shape[0])[:, None] * np.hanning(image.shape[1])
    image = (image - image.mean()) * window
    spacing = picture.affine[0, 0]
    v, u = np.mgrid[: image.shape[0], : image.shape[1]] * spacing
    reciprocal = np.linalg.inv(lattice.basis).T
    power = 0.0
    for m in range(-2, 3):
        for n in range(-2, 3):
            k = np.array([m, n]) @ reciprocal
            # One of each pair of opposite frequencies, up to the finest that the picture holds.
            if (m, n) > (0, 0) and np.abs(k).max() * spacing < 0.5:
                amplitude = 2 * abs((image * np.exp(-2j * np.pi * (k[0] * u + k[1] * v))).sum()) / window.sum()
                power += amplitude**2 / 2
    return np.sqrt(power)


@pytest.mark.parametrize("s", [-12.0, -6.0, 6.0, 12.0])
@pytest.mark.parametrize("blend", [False, True])
def test_a_white_capture_gives_a_picture_without_lattice(s, blend):
    white, calibration = shaded_white(), camera_of(None)
    picture = lfrender.render(white, calibration, patch_size=s, blend=blend)
    assert lattice_amplitude(picture, calibration.lattice) < 0.01 * picture.image.mean()


def test_a_white_capture_drawn_without_correction_shows_the_lattice():
    white, calibration = shaded_white(), camera_of(None)
    dark = lfrender.render(white, lfcal.Calibration(calibration.lattice), patch_size=12.0)
    assert lattice_amplitude(dark, calibration.lattice) > 0.01 * dark.image.mean()


@pytest.mark.parametrize("s", [-8.0, 5.0])
def test_cats_eyes_and_a_dark_border_give_an_even_picture(s):
    lattice = Camera.design(size=SIZE, pitch=23.2, rotation=1.3).lattice
    round_lens = lfcal.Vignetting(1 / (1 + np.exp(3 * (np.arange(0, 16, 0.25) - 11.2))), 0.25)
    # A second disc, 6 px aside in the corners, cuts microimages, and light falls off to exp(-0.4) there.
    light = GainMap.round(round_lens.profile, round_lens.step, lattice.radius, [0.0, 0.0, 6.0, 11.2, 0.4])
    light = dataclasses.replace(light, level=[0, 0, 0, -0.4, 0, -0.4])
    camera = lfcal.Calibration(lattice, round_lens, gain_map=light)
    white = np.rint(40000 * np.nan_to_num(camera.gain(), nan=0.05)).astype(np.uint16)

    def unevenness(camera):
        picture = lfrender.render(white, camera, patch_size=s, blend=True)
        border = int(np.ceil(picture.scale))
        inner = picture.image[border:-border, border:-border]
        return inner.std() / inner.mean()

    assert unevenness(camera) < 0.003
    assert unevenness(dataclasses.replace(camera, gain_map=None)) > 0.05


def test_a_smooth_ramp_gives_a_picture_without_lattice():
    shot = capture("ramp")
    calibration = camera_of("ramp")
    picture = lfrender.render(shot.flat, calibration)
    assert lattice_amplitude(picture, calibration.lattice) < 0.01 * picture.image.std()
    # Drawn at a wrong depth, tiles do not meet.
    tiled = lfrender.render(shot.flat, calibration, patch_size=9.0)
    assert lattice_amplitude(tiled, calibration.lattice) > 0.01 * tiled.image.std()


@pytest.mark.parametrize("scene", ["plane", "ramp", "slope"])
def test_the_picture_is_as_bright_as_the_corrected_flat(scene):
    shot = capture(scene)
    calibration = camera_of(scene)
    picture = lfrender.render(shot.flat, calibration)
    known = np.isfinite(calibration.gain())
    known &= off_centre(calibration.lattice) < 0.4 * calibration.lattice.pitch
    corrected = calibration.flatten(shot.flat)[known].mean()
    assert picture.image[picture.valid].mean() == pytest.approx(corrected, rel=0.01)
