"""Blur of lenses of known blur, and pictures coarser than the flat, which are neither blurred twice nor aliased."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, uniform_filter

import lfrender
from lfcal import Calibration, Lattice
from lfrender.flat.lens_blur import measure_lens_blur

SIZE, PITCH = (420, 330), 21.0
# Texels of the scene per flat pixel, and its margin [flat px].
FINE, MARGIN = 3, 40


@functools.cache
def scene():
    """Overlapping rectangles of all sizes: edges everywhere, as in photographs."""
    rng = np.random.default_rng(4)
    height, width = ((n + 2 * MARGIN) * FINE for n in SIZE[::-1])
    picture = np.zeros((height, width), np.float32)
    for _ in range(9000):
        w, h = np.minimum(8 / rng.uniform(0.02, 1, 2), 120).astype(int)
        x, y = rng.integers(0, width), rng.integers(0, height)
        picture[y : y + h, x : x + w] = rng.uniform(0.1, 0.9)
    return picture


@functools.cache
def camera():
    return Calibration(Lattice((209.3, 164.6), [[PITCH, 0.3], [PITCH / 2, PITCH * 0.75**0.5]], SIZE, 10.0))


@functools.cache
def flat_of(s, blur=0.0):
    """The flat of a plane at patch size `s`, whose lenses average the scene over `blur` flat px."""
    lattice = camera().lattice
    # Texels that a pixel averages.
    ratio = lattice.pitch / abs(s) * FINE
    texture = uniform_filter(uniform_filter(scene(), max(1, round(ratio))), max(1, round(blur * ratio)))
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    points = np.stack([x, y], -1).reshape(-1, 2)
    own = lattice.origin + np.rint(lattice.to_index(points)) @ lattice.basis
    where = own - (points - own) * lattice.pitch / s
    return map_coordinates(texture, ((where + MARGIN) * FINE + 1)[:, ::-1].T, order=1).reshape(y.shape)


def distance_from_scene(picture):
    """RMS difference from the mean of the scene over each output pixel, two pitches off the border."""
    side = picture.affine[0, 0]
    wide = uniform_filter(scene(), round(side * FINE))
    v, u = np.mgrid[: picture.image.shape[0], : picture.image.shape[1]]
    where = np.stack([v, u]) * side + picture.affine[0, 2]
    wanted = map_coordinates(wide, (where + MARGIN) * FINE + 1, order=1)
    border = int(np.ceil(2 * picture.scale))
    return np.sqrt(np.mean((picture.image - wanted)[border:-border, border:-border] ** 2))


@pytest.mark.parametrize("s", [-10.0, 6.0])
@pytest.mark.parametrize("blur", [0.0, 2.0, 3.0])
def test_blur_of_the_lenses_is_measured_to_half_a_pixel(s, blur):
    sizes = np.full(len(camera().lattice), s, np.float32)
    width = measure_lens_blur(flat_of(s, blur)[:, :, None], camera(), sizes) * abs(s)
    assert width == pytest.approx(blur, abs=0.5)


def test_blur_of_noise_and_of_an_even_flat_is_zero():
    sizes = np.full(len(camera().lattice), 8.0, np.float32)
    noise = np.random.default_rng(1).normal(0.5, 0.1, (*SIZE[::-1], 1)).astype(np.float32)
    assert measure_lens_blur(noise, camera(), sizes) == 0
    assert measure_lens_blur(np.full((*SIZE[::-1], 1), 0.5, np.float32), camera(), sizes) == 0


@pytest.mark.parametrize("blur", [0.0, 3.0])
def test_a_coarse_picture_is_the_mean_over_its_pixels_whether_lenses_blur_or_not(blur):
    s = -10.0
    coarse = [lfrender.render(flat_of(s, blur), camera(), patch_size=s, blend=True, scale=10 / n) for n in (3, 4, 5)]
    assert max(distance_from_scene(picture) for picture in coarse) < 0.02
